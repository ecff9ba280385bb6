# SPDX-License-Identifier: Apache-2.0
"""What the cell can see of its fingers: exactly what the driver, the predictor and the camera of real hardware say.

All tuples are in slot order. Stamps are nanoseconds of the source's clock.
"""

from __future__ import annotations

import bisect
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, TypeVar

from softgrip_time.units import to_ns

Kept = TypeVar("Kept")

#: Tendon samples kept while their prediction is on its way: a quarter of a second at 1 kHz.
PENDING_LIMIT: Final = 256
#: A stamp so far before others is that of a source that has restarted [ns].
RESTART_NS: Final = 2_000_000_000


@dataclass(frozen=True)
class TendonSample:
    """One tendon/state: pulled length [m] (+ closes) and tension [N] of every slot."""

    stamp_ns: int
    pulled_length_m: tuple[float, ...]
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
    pulled_length_m: tuple[float, ...]
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


Observation = TendonSample | SeenTip | ObservedPair


class ObservationOrder:
    """Gives out what is observed in the order of its stamps, whatever order tendons, predictor and camera came in.

    Samples are given out one by one, each before its pair. A sample waits for its prediction; where none comes before
    samples are the allowed lateness ahead, or the prediction of a younger one comes, it goes without. A tip counts from
    the first pair on whose stamp is at least the tip's plus the allowed lateness. What comes later than that is late:
    it is given out when it comes.

    Args:
        allowed_lateness_s: 0 = nothing waits, and the order of arrival decides [s].

    Attributes:
        late: predictions and tips that were late.
    """

    def __init__(self, allowed_lateness_s: float) -> None:
        self._lateness_ns = to_ns(allowed_lateness_s)
        self._waiting: OrderedDict[int, TendonSample] = OrderedDict()
        self._gone: OrderedDict[int, TendonSample] = OrderedDict()  # without their predictions
        self._early: OrderedDict[int, FreeMotion] = OrderedDict()
        self._tips: list[SeenTip] = []
        self._newest_ns = 0
        self._paired_ns = 0
        self.late = 0

    def add_sample(self, sample: TendonSample) -> list[Observation]:
        """Take a tendon sample; return what can be given out by it."""
        if self._newest_ns - sample.stamp_ns > RESTART_NS:  # time only goes back so far when a source restarts
            self._waiting.clear()
            self._newest_ns = self._paired_ns = 0
        self._newest_ns = max(sample.stamp_ns, self._newest_ns)
        self._waiting[sample.stamp_ns] = sample
        free = self._early.pop(sample.stamp_ns, None)
        given = [] if free is None else self._pair(free)
        while self._waiting and self._newest_ns - next(iter(self._waiting)) >= self._lateness_ns:
            stamp_ns, alone = self._waiting.popitem(last=False)
            _keep(self._gone, stamp_ns, alone)
            given.append(alone)
        return given

    def add_prediction(self, free: FreeMotion) -> list[Observation]:
        """Take a prediction; return what can be given out by it."""
        if free.stamp_ns in self._waiting:
            return self._pair(free)
        if free.stamp_ns not in self._gone:
            _keep(self._early, free.stamp_ns, free)
            return []
        self.late += bool(self._lateness_ns)
        return [*self._tips_until(free.stamp_ns), ObservedPair(_take(self._gone, free.stamp_ns)[-1], free)]

    def add_tips(self, tips: Sequence[SeenTip]) -> list[Observation]:
        """Take what one frame shows; return what can be given out of it."""
        given: list[Observation] = []
        for tip in tips:
            if not self._lateness_ns or tip.stamp_ns + self._lateness_ns <= self._paired_ns:
                self.late += bool(self._lateness_ns)
                given.append(tip)
            else:
                bisect.insort(self._tips, tip, key=lambda each: each.stamp_ns)
        del self._tips[:-PENDING_LIMIT]
        return given

    def _pair(self, free: FreeMotion) -> list[Observation]:
        samples = _take(self._waiting, free.stamp_ns)
        return [*samples, *self._tips_until(free.stamp_ns), ObservedPair(samples[-1], free)]

    def _tips_until(self, stamp_ns: int) -> list[SeenTip]:
        """Return the tips that count from a pair on."""
        self._paired_ns = stamp_ns
        count = bisect.bisect_right(self._tips, stamp_ns - self._lateness_ns, key=lambda tip: tip.stamp_ns)
        tips, self._tips = self._tips[:count], self._tips[count:]
        return tips


def _keep(kept: OrderedDict[int, Kept], stamp_ns: int, one: Kept) -> None:
    kept[stamp_ns] = one
    while len(kept) > PENDING_LIMIT:
        kept.popitem(last=False)


def _take(kept: OrderedDict[int, Kept], stamp_ns: int) -> list[Kept]:
    """Take out all that is kept up to a stamp."""
    taken: list[tuple[int, Kept]] = []
    while not taken or taken[-1][0] != stamp_ns:
        taken.append(kept.popitem(last=False))
    return [one for _, one in taken]


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
        self.was_heard = False

    @property
    def reached(self) -> bool:
        """Whether the sender is quiet; true before it was heard first."""
        return self._checks_left >= self._limit

    def hear(self) -> None:
        """Record a message."""
        self._checks_left = 0
        self.was_heard = True

    def pass_period(self) -> None:
        """Let one period pass."""
        self._checks_left += 1
