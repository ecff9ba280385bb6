# SPDX-License-Identifier: Apache-2.0
"""The load cell between the plant and whichever electronics read it: noise, gain, drift, sticking, its end of range."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from softgrip_emulator.rig.plant import RigPlant


class LoadCell:
    """Force as the electronics see it [N], pulling positive.

    Args:
        plant: what pulls at it.
        capacity: [N] above it the cell saturates.
        seed: of the noise.
    """

    def __init__(self, plant: RigPlant, capacity: float, seed: int) -> None:
        self.capacity = capacity
        #: Set to stick at the last value.
        self.stuck = False
        #: Zero drift [N/s], from the moment it is set.
        self.drift_rate = 0.0
        self._plant = plant
        self._rng = np.random.default_rng([seed, 0x4C43])
        self._lock = threading.Lock()
        self._offset = 0.0
        self._tare = 0.0
        self._last_s = 0.0
        self._last = 0.0

    def read(self, now_s: float) -> float:
        """Return the force now [N]; infinite beyond the capacity."""
        with self._lock:
            self._plant.advance(now_s)
            self._offset += self.drift_rate * max(now_s - self._last_s, 0.0)
            self._last_s = max(now_s, self._last_s)
            if not self.stuck:
                truth = self._plant.truth
                noise = float(self._rng.normal(0.0, truth.gauge_noise))
                self._last = self._plant.force * truth.gauge_gain + noise + self._offset
            return (
                self._last - self._tare if abs(self._last) < self.capacity else float(np.copysign(np.inf, self._last))
            )

    def tare(self, now_s: float) -> None:
        """Make the present force zero."""
        present = self.read(now_s)
        if np.isfinite(present):
            self._tare += present
