# SPDX-License-Identifier: Apache-2.0
"""The load cell between the plant and whichever electronics read it: noise, gain, drift, sticking, its end of range."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from softgrip_emulator.rig.truth import RigTruth


class ForceSource(Protocol):
    """A line with a force in it."""

    @property
    def truth(self) -> RigTruth:
        """The gauge's gain and noise."""
        ...

    @property
    def force(self) -> float:
        """In the line now [N]."""
        ...

    def advance(self, now_s: float) -> None:
        """Live until a time [s]."""
        ...


@dataclass(frozen=True)
class OtherLine:
    """A line that lives by itself, such as a finger's tendon: what `look` gives is the force [N]."""

    truth: RigTruth
    look: Callable[[], float]

    @property
    def force(self) -> float:
        """In the line now [N]."""
        return self.look()

    def advance(self, now_s: float) -> None:
        """It lives on its own clock."""


class LoadCell:
    """Force as the electronics see it [N], pulling positive.

    Args:
        line: what it hangs in.
        capacity: [N] above it the cell saturates.
        seed: of the noise.
        noise: standard deviation of a reading by these electronics [N]; None: `RigTruth.gauge_noise`.
    """

    def __init__(self, line: ForceSource, capacity: float, seed: int, noise: float | None = None) -> None:
        self.capacity = capacity
        #: Set to stick at the last value. cut: noise instead of the force. reversed: its signal wires are swapped.
        self.stuck = False
        self.cut = False
        self.reversed = False
        #: Zero drift [N/s], from the moment it is set.
        self.drift_rate = 0.0
        self._line = line
        self._noise = noise
        self._rng = np.random.default_rng([seed, 0x4C43])
        self._lock = threading.Lock()
        self._offset = 0.0
        self._tare = 0.0
        self._last_s = 0.0
        self._last = 0.0

    def hang(self, line: ForceSource) -> None:
        """Take it out of its line and put it into another."""
        with self._lock:
            self._line = line

    def read(self, now_s: float) -> float:
        """Return the force now [N]; infinite beyond the capacity."""
        with self._lock:
            self._line.advance(now_s)
            self._offset += self.drift_rate * max(now_s - self._last_s, 0.0)
            self._last_s = max(now_s, self._last_s)
            if not self.stuck:
                truth = self._line.truth
                stddev = truth.gauge_noise if self._noise is None else self._noise
                noise = float(self._rng.normal(0.0, stddev))
                sensed = 0.0 if self.cut else -self._line.force if self.reversed else self._line.force
                self._last = sensed * truth.gauge_gain + noise + self._offset
            return (
                self._last - self._tare if abs(self._last) < self.capacity else float(np.copysign(np.inf, self._last))
            )

    def tare(self, now_s: float) -> None:
        """Make the present force zero."""
        present = self.read(now_s)
        if np.isfinite(present):
            self._tare += present
