# SPDX-License-Identifier: Apache-2.0
"""What the cell can see of its fingers: exactly what the driver, the predictor and the camera of real hardware say.

All tuples are in slot order. Stamps are nanoseconds of the source's clock.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from typing import Final

#: Tendon samples kept while their prediction is on its way: a quarter of a second at 1 kHz.
PENDING_LIMIT: Final = 256


@dataclass(frozen=True)
class TendonSample:
    """One tendon/state: pulled length [m] (+ closes) and tension [N] of every slot."""

    stamp_ns: int
    pulled_m: tuple[float, ...]
    tension_n: tuple[float, ...]


@dataclass(frozen=True)
class FreeMotion:
    """One finger/predicted: what the fingers would do at these pulled lengths if they touched nothing.

    Attributes:
        tension_n: actuator tension [N]; NaN where the model has no solution.
        tip_m: (x, y) of the fingertip in the finger's base frame [m].
        friction_model: id of the friction model used.
        friction_digest: of its numbers.
        objection: why all of it must not be trusted, empty when it may.
        objections: the same per slot.
    """

    stamp_ns: int
    pulled_m: tuple[float, ...]
    tension_n: tuple[float, ...]
    tip_m: tuple[tuple[float, float], ...]
    friction_model: str = ""
    objection: str = ""
    objections: tuple[str, ...] = ("", "", "")
    friction_digest: str = ""


@dataclass(frozen=True)
class SeenTip:
    """One finger of a finger/measured: where the camera saw the fingertip.

    Attributes:
        tip_m: (x, y) in the finger's base frame [m].
        stddev_m: one standard deviation of either coordinate [m].
    """

    stamp_ns: int
    slot: str
    tip_m: tuple[float, float]
    stddev_m: float


@dataclass(frozen=True)
class TendonFault:
    """What tendon/status says is wrong with a tendon, or the e-stop."""

    tendon: str
    name: str
    reason: str


@dataclass(frozen=True)
class ObservedPair:
    """A tendon sample with the free motion predicted from it."""

    sample: TendonSample
    free: FreeMotion


class Pairing:
    """Brings predictions together with the samples they were computed from, by stamp, in whatever order they come."""

    def __init__(self) -> None:
        self._samples: OrderedDict[int, TendonSample] = OrderedDict()
        self._early: OrderedDict[int, FreeMotion] = OrderedDict()

    def add_sample(self, sample: TendonSample) -> ObservedPair | None:
        """Take a tendon sample; return its pair when the prediction was here first."""
        free = self._early.pop(sample.stamp_ns, None)
        if free is not None:
            return ObservedPair(sample, free)
        self._samples[sample.stamp_ns] = sample
        while len(self._samples) > PENDING_LIMIT:
            self._samples.popitem(last=False)
        return None

    def add_prediction(self, free: FreeMotion) -> ObservedPair | None:
        """Take a prediction; return its pair when the sample is here. Samples older than it are dropped."""
        if free.stamp_ns not in self._samples:
            self._early[free.stamp_ns] = free
            while len(self._early) > PENDING_LIMIT:
                self._early.popitem(last=False)
            return None
        while True:
            stamp_ns, sample = self._samples.popitem(last=False)
            if stamp_ns == free.stamp_ns:
                return ObservedPair(sample, free)


class StreamSilence:
    """Whether a sender went quiet, by looks at a steady pace.

    A clock would take the listener's own pause (a busy computer, a slow disk) for the sender's silence: what was sent
    meanwhile still waits to be taken. Looks that were missed are not made up for, so that a pause is one look at most.

    Args:
        looks: in so many looks in a row nothing was heard.
    """

    def __init__(self, checks: int) -> None:
        self._limit = checks
        self._checks_left = checks

    @property
    def reached(self) -> bool:
        """Whether the sender is quiet; true before it was heard first."""
        return self._checks_left >= self._limit

    def hear(self) -> None:
        """Take note of a message."""
        self._checks_left = 0

    def look(self) -> None:
        """Let one period pass."""
        self._checks_left += 1
