# SPDX-License-Identifier: Apache-2.0
"""Find the zero of the pulled length: where the tendon of the straight finger just becomes taut.

Let out until slack, then wind in slowly against a small tension until the drive stands. Force over length is flat while
the tendon is slack (the gears' friction) and rises once it is taut; the knee between the two is the zero. Go there.
A drive that was held up, by a computer or a bus that paused, has to get going again: the force that its inertia takes
is fitted together with the knee, as is the friction that a taut tendon overcomes at once.

That goes for short pauses. What happens in a long one nobody sees: the goal stands, the drive stops with what its gears
hold, which passes for a taut tendon, and gets going with a jerk, which passes for a knee. The tendon winds in by speed
times silence unseen, so this must stay below what a zero is right to: `ZERO_ACCURACY`. After a longer silence all that
the take-up showed is forgotten; it begins again from slack, `TRIES` times in all, and then the fault names the silence.
Silence itself is seen for certain: between any two readings the clock tells how long it was. A knee beside a pause that
is shorter than that, but hides a good part of it (`SEEN`), is a guess: it is taken once a second take-up agrees.
What has to last (standing, going evenly) is counted by what was seen: a step counts for two periods at most.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass
from enum import Enum, auto

import numpy as np
from numpy.typing import NDArray

from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.motions import DriveObservation, DriveState, MotionStep, MoveOutcome
from softgrip_driver.tendon.profile import SpeedProfile

#: fewest samples for a knee
MIN_SAMPLES = 8
#: [m] between places that the knee is looked for at, first everywhere, then near the best one
COARSE_STEP = 1e-4
FINE_STEP = 2e-5
#: [m] how far before and behind the knee without a step it may lie with one
STEP_BEFORE = 3e-4
STEP_BEHIND = 1.5e-3
#: residuals beyond so many standard deviations (by the median) count less, in so many rounds
OUTLIER = 1.5
ROUNDS = 4
#: [N] a residual that is usual at least: a count of the current
USUAL = 0.05
#: [m] that a zero is right to: no more may be wound in between two readings
ZERO_ACCURACY = 1e-3
#: share of it that may be wound in unseen while a knee is taken at once; and by which two knees may differ
SEEN = 0.3
AGREED = 0.5
#: times the usual time between two readings that is a silence: a slow adapter is none
UNUSUAL = 2.0

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HomingSample:
    """What a drive showed while it wound in: length [m], acceleration [m/s^2], force [N]."""

    pulled_length_m: float
    acceleration: float
    force: float


class _Phase(Enum):
    LET_OUT = auto()
    TAKE_UP = auto()
    GO_TO_ZERO = auto()


class _Lasting:
    """How long [s] something has been seen to hold; time in which nobody looked is no part of it."""

    def __init__(self) -> None:
        self._seconds: float | None = None

    def step(self, view: DriveObservation, *, holds: bool) -> float:
        """Return how long it has held with this step, 0 where it does not or begins to."""
        if not holds:
            self._seconds = None
        else:
            self._seconds = 0.0 if self._seconds is None else self._seconds + view.dt
        return self._seconds or 0.0


class Homing:
    """Homing by current and stall, with a cap on travel and time.

    Lengths here count from where the drive stood when homing began; `zero` is the result in that frame.
    """

    #: [s] of standing with tension that count as taut
    DWELL = 0.15
    #: [m/s] below this the drive stands
    STANDING = 1e-3
    #: share of the homing tension that counts as there
    TAUT = 0.7
    #: share of the homing tension from which the device's own limit may act
    SATURATED = 0.9
    #: [m] of winding in that are left out, while the motor gets up to speed
    RUN_UP = 2e-3
    #: a drive that turned round is being braked until its speed has been within so much [m/s] for so long [s], or until
    #: it has gone so far [m]: there are drives that never go more evenly
    EVEN = 1e-3
    EVEN_FOR = 0.05
    EVEN_BY = 5e-3
    #: what the samples have to show: [m] of slack, and samples on either side of the knee; [m] from it to the nearest
    #: ones; the share of the way from the slack's force to the homing tension that they rise. Else it is looked for
    #: again from further out, so many times
    MIN_SLACK = 1e-3
    MIN_SAMPLES = 3
    NEAR = 1e-3
    RISEN = 0.5
    AGAIN = 3
    #: take-ups that a silence may spoil until it is a fault
    TRIES = 6
    #: times the homing tension that letting out may take, but for so long [s]: beyond, the spool winds in meanwhile
    AGAINST = 2.0
    AGAINST_FOR = 0.1
    #: times the speed of homing that it lets out with, at most
    PAY_OUT_SPEED_FACTOR = 2.0

    state = DriveState.HOMING
    winding_in = False
    paying_out = True

    def __init__(self, view: DriveObservation, limits: TendonLimits) -> None:
        self._limits = limits
        # no faster than it needs to be: a goal that comes late is a jerk, the greater the faster
        self._pay_out_speed = min(limits.release_speed, self.PAY_OUT_SPEED_FACTOR * limits.homing_speed)
        self._started = view.now
        self._start = view.pulled_length_m
        self._phase = _Phase.LET_OUT
        self._profile = SpeedProfile(view.pulled_length_m)
        self._standing, self._even, self._against = _Lasting(), _Lasting(), _Lasting()
        self._stood_at = view.pulled_length_m
        self._steady = False
        self._again = self.AGAIN
        self._tries = self.TRIES
        #: [s] between the readings of this take-up
        self._silences: list[float] = []
        #: [m] a knee that a second one has to agree with
        self._guess: float | None = None
        #: [s] when it was heard last
        self._heard = view.now
        #: of the last take-up that was spoiled, in words
        self._silence = ""
        self._samples: list[HomingSample] = []
        self.zero: float | None = None

    def step(self, view: DriveObservation) -> MotionStep:
        """Advance."""
        limits = self._limits
        silent, self._heard = view.now - self._heard, view.now
        if self._is_seeking(view):
            self._silences.append(silent)
            if silent > self.max_silence:
                return self._begin_again_after(silent, view)
        if view.now - self._started > limits.homing_timeout:
            if self._silence:
                return self._interrupted(view)
            return self._failed(
                view,
                f"no taut tendon within {limits.homing_timeout:.0f} s; where the drive stood still, its gears may need "
                "more than friction_currents_a allows, or limited_currents is wrong: run calibrate_tension",
            )
        if self._phase is _Phase.LET_OUT:
            return self._let_out(view)
        if self._phase is _Phase.TAKE_UP:
            return self._take_up(view)
        return self._go_to_zero(view)

    def _is_seeking(self, view: DriveObservation) -> bool:
        """Whether the knee is looked for: not while the drive lets out or gets up to speed."""
        return self._phase is _Phase.TAKE_UP and view.pulled_length_m - self._stood_at > self.RUN_UP

    @property
    def max_silence(self) -> float:
        """[s] between two readings in which no more is wound in than a zero is right to."""
        return ZERO_ACCURACY / self._limits.homing_speed

    def _begin_again_after(self, silent: float, view: DriveObservation) -> MotionStep:
        """Forget what the take-up showed and begin from slack, or give up where that was tried often enough."""
        self._silence = (
            f"the bus was silent for {silent * 1e3:.0f} ms at {view.pulled_length_m * 1e3:.1f} mm; "
            f"at {self._limits.homing_speed * 1e3:.1f} mm/s no more than {self.max_silence * 1e3:.0f} ms are allowed"
        )
        return self._try_again(view)

    def _try_again(self, view: DriveObservation) -> MotionStep:
        self._tries -= 1
        return self._begin_again(view) if self._tries else self._interrupted(view)

    def _begin_again(self, view: DriveObservation) -> MotionStep:
        self._phase, self._profile = _Phase.LET_OUT, SpeedProfile(view.pulled_length_m)
        self._standing = _Lasting()
        self._samples.clear()
        self._silences.clear()
        return MotionStep(view.pulled_length_m, self._limits.homing_tension)

    def _let_out(self, view: DriveObservation) -> MotionStep:
        if self._is_pulled_against(view):
            return self._failed(
                view, f"letting out takes {-view.pull:.1f} N: does the spool wind the other way (parameter directions)?"
            )
        end = self._start - self._limits.slack_travel
        self._profile.step(end, self._pay_out_speed, self._limits.acceleration, view.dt)
        if self._profile.position == end:
            self._phase = _Phase.TAKE_UP
            self._stood_at = end
        return MotionStep(self._profile.position, self._limits.tension_hold)

    def _is_pulled_against(self, view: DriveObservation) -> bool:
        """Whether it takes force to let out, which no tendon does: a tendon can only pull."""
        pulls = view.speed <= -self.STANDING and -view.pull >= self.AGAINST * self._limits.homing_tension
        return self._against.step(view, holds=pulls) >= self.AGAINST_FOR

    def _take_up(self, view: DriveObservation) -> MotionStep:
        limits = self._limits
        tension = limits.homing_tension
        end = self._start - limits.slack_travel + limits.homing_travel
        if self._profile.position - view.pulled_length_m < limits.max_following_error:
            self._profile.step(end, limits.homing_speed, limits.acceleration, view.dt)
        self._sample(view)
        taut = abs(view.speed) <= self.STANDING and view.tension >= self.TAUT * tension
        if self._standing.step(view, holds=taut) >= self.DWELL:
            return self._taut(view)
        if (
            self._profile.position == end
            and self.zero is None
            and view.pulled_length_m > end - limits.position_tolerance
        ):
            return self._failed(
                view, f"{limits.homing_travel * 1e3:.0f} mm wound in without {tension:.1f} N: is the tendon attached?"
            )
        return MotionStep(self._profile.position, tension)

    def _sample(self, view: DriveObservation) -> None:
        gone = view.pulled_length_m - self._stood_at
        is_up = gone > self.RUN_UP
        evenly = is_up and abs(view.speed - self._limits.homing_speed) <= self.EVEN
        even = self._even.step(view, holds=evenly) >= self.EVEN_FOR
        self._steady = is_up and (self._steady or even or gone > self.EVEN_BY)
        if not self._steady:
            return
        # At the limit the device holds the current constant: such samples say nothing about the rise.
        if view.speed > self.STANDING and view.pull < self.SATURATED * self._limits.homing_tension:
            self._samples.append(HomingSample(view.pulled_length_m, view.acceleration, view.pull))

    def _shows(self, found: float) -> bool:
        """Whether the samples show a knee there: slack before it, samples on either side, a rise behind it."""
        lengths = np.array([sample.pulled_length_m for sample in self._samples])
        forces = np.array([sample.force for sample in self._samples])
        slack, rise = lengths < found, lengths >= found
        if min(slack.sum(), rise.sum()) < self.MIN_SAMPLES or found - lengths.min() < self.MIN_SLACK:
            return False
        usual = float(np.median(forces[slack]))
        risen = float(forces[rise].max()) >= usual + self.RISEN * (self._limits.homing_tension - usual)
        return risen and max(found - lengths[slack].max(), lengths[rise].min() - found) <= self.NEAR

    def _taut(self, view: DriveObservation) -> MotionStep:
        """Take the knee for the zero; where the samples do not show it, begin again from further out."""
        found = knee(self._samples, view.pulled_length_m)
        if found is not None and self._shows(found):
            if not self._is_sure_of(found):
                return self._try_again(view)
            self.zero = found
            self._phase, self._profile = _Phase.GO_TO_ZERO, SpeedProfile(view.pulled_length_m)
            return MotionStep(view.pulled_length_m, self._limits.homing_tension)
        if self._again == 0:
            return self._failed(view, "the force does not show where the tendon becomes taut")
        self._again -= 1
        self._start = min(
            self._start, view.pulled_length_m - self._limits.slack_travel / 2.0 if found is None else found
        )
        return self._begin_again(view)

    def _is_sure_of(self, found: float) -> bool:
        """Whether that knee [m] was seen well, or agrees with the one before; else it is kept for the next."""
        longest, seen = max(self._silences), SEEN * self.max_silence
        if longest <= max(seen, UNUSUAL * float(np.median(self._silences))):
            return True
        before, self._guess = self._guess, found
        self._silence = (
            f"the bus was silent for up to {longest * 1e3:.0f} ms in each take-up; at "
            f"{self._limits.homing_speed * 1e3:.1f} mm/s {seen * 1e3:.0f} ms show where a tendon becomes taut"
        )
        return before is not None and abs(found - before) <= AGREED * ZERO_ACCURACY

    def _go_to_zero(self, view: DriveObservation) -> MotionStep:
        assert self.zero is not None
        limits = self._limits
        self._profile.step(self.zero, self._pay_out_speed, limits.acceleration, view.dt)
        if self._profile.position == self.zero and view.pulled_length_m - self.zero <= limits.position_tolerance:
            return MotionStep(self.zero, limits.tension_hold, MoveOutcome.REACHED, "homed")
        return MotionStep(self._profile.position, limits.tension_hold)

    def _interrupted(self, view: DriveObservation) -> MotionStep:
        return self._failed(view, self._silence, "homing_interrupted")

    def _failed(self, view: DriveObservation, reason: str, fault: str = "homing_failed") -> MotionStep:
        return MotionStep(
            view.pulled_length_m, self._limits.homing_tension, MoveOutcome.FAULT, f"homing: {reason}", fault
        )


def knee(samples: Sequence[HomingSample], end: float) -> float | None:
    """Return the length [m] at which a tendon begins to pull: F = b + m a, from x0 on F = b + m a + c + s (x - x0).

    Least squares over b, m, c >= 0 (friction that is overcome at once), s > 0 and x0, where samples that stand out (a
    jerk of the motor, a late reading) count less: weights of Huber.

    Args:
        samples: while winding in.
        end: [m] where the drive stood in the end.

    Returns:
        x0, or None where the samples are too few to show one or show none.
    """
    if len(samples) < MIN_SAMPLES:
        return None
    x, acceleration, force = np.array([astuple(sample) for sample in samples]).T
    slack = np.column_stack([np.ones_like(x), acceleration])
    slack /= np.maximum(np.abs(slack).max(axis=0), 1e-9)
    everywhere = np.arange(x.min(), end, COARSE_STEP)
    # What is braked after the run-up looks like a step, too: the step is looked for where the rise begins.
    rough = _knee_among(everywhere, x, slack, force, stepped=False)
    if rough is None:
        return None
    near = np.arange(max(x.min(), rough - STEP_BEFORE), min(end, rough + STEP_BEHIND), FINE_STEP)
    return _knee_among(near, x, slack, force, stepped=True)


def _knee_among(places: Array, x: Array, slack: Array, force: Array, *, stepped: bool) -> float | None:
    """Return the best of the places [m], outliers weighed down in rounds."""
    weights = np.ones_like(x)
    for _ in range(ROUNDS):
        found = _best_place(places, x, slack, force, np.sqrt(weights), stepped=stepped)
        if found is None:
            return None
        best, residuals = found
        usual = OUTLIER * (1.4826 * float(np.median(np.abs(residuals))) + USUAL)
        weights = np.minimum(1.0, usual / np.maximum(np.abs(residuals), 1e-12))
    return float(places[best])


def _best_place(
    places: Array, x: Array, slack: Array, force: Array, scale: Array, *, stepped: bool
) -> tuple[int, Array] | None:
    """Return which place fits best as the knee, and the residuals [N] there.

    Args:
        places: (M,) candidates [m].
        x: (N,) lengths [m].
        slack: (N, 2) what the force may contain everywhere.
        force: (N,) [N].
        scale: (N,) square roots of the weights.
        stepped: whether the force may step up at the knee.
    """
    # of what varies only: an ideal drive is never held up
    directions, sizes, _ = np.linalg.svd(slack * scale[:, None], full_matrices=False)
    basis = directions[:, sizes > 1e-6 * sizes[0]]

    def rest(columns: Array) -> Array:
        weighted = (columns.T * scale).T
        return np.asarray(weighted - basis @ (basis.T @ weighted))

    beyond = x[:, None] - places
    left, rises, steps = rest(force), rest(np.maximum(0.0, beyond)), rest(np.where(beyond > 0.0, 1.0, 0.0))
    rr, ss, rs = (rises * rises).sum(axis=0), (steps * steps).sum(axis=0), (rises * steps).sum(axis=0)
    rf, sf = rises.T @ left, steps.T @ left
    both = rr * ss - rs**2
    solvable = both > 1e-9 * rr * ss
    both = np.where(solvable, both, 1.0)
    height, slope = (sf * rr - rf * rs) / both, (rf * ss - sf * rs) / both
    with_step = solvable & (height > 0.0) & (slope > 0.0) & stepped
    height = np.where(with_step, height, 0.0)
    slope = np.where(with_step, slope, rf / np.maximum(rr, 1e-18))
    gains = np.where(slope > 0.0, height * sf + slope * rf, -np.inf)
    best = int(np.argmax(gains))
    if not np.isfinite(gains[best]):
        return None
    return best, (left - slope[best] * rises[:, best] - height[best] * steps[:, best]) / scale
