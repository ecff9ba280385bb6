# SPDX-License-Identifier: Apache-2.0
"""Find the zero of the pulled length: where the tendon of the straight finger just becomes taut.

Let out until slack, then wind in slowly against a small tension until the drive stands. Force over length is flat while
the tendon is slack (the gears' friction) and rises once it is taut; the knee between the two is the zero. Go there.
Only the winding in is slow: it is what is measured; letting out goes at the speed of a release.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum, auto

import numpy as np
from numpy.typing import NDArray

from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.motions import DriveState, Outcome, Step, View
from softgrip_driver.tendon.profile import SpeedProfile

#: fewest samples for a knee
MIN_SAMPLES = 8
#: [m] resolution of the knee
KNEE_STEP = 1e-4
#: times the median residual that makes a sample an outlier
OUTLIER = 3.0
#: share of the force's range by which the round of a real knee may differ from a sharp one
ROUND = 0.15

Array = NDArray[np.float64]


class _Phase(Enum):
    LET_OUT = auto()
    TAKE_UP = auto()
    GO_TO_ZERO = auto()


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
    #: times the speed of homing: a drive that turned round faster is being slowed down, which looks like a force
    TOO_FAST = 1.08
    #: times the speed of homing below which a drive that nothing holds was held up, by a bus that paused
    HELD_UP = 0.5
    #: [m] of slack that has to be seen before the knee, else it is looked for again from further out, so many times
    LEAST_SLACK = 1e-3
    AGAIN = 2
    #: times the speed of homing that it lets out with, at most
    SLACKENING = 2.0

    state = DriveState.HOMING
    winding_in = False
    paying_out = True

    def __init__(self, view: View, limits: TendonLimits) -> None:
        self._limits = limits
        # no faster than it needs to be: a goal that comes late is a jerk, the greater the faster
        self._slackening_speed = min(limits.release_speed, self.SLACKENING * limits.homing_speed)
        self._started = view.now
        self._start = view.length
        self._phase = _Phase.LET_OUT
        self._profile = SpeedProfile(view.length)
        self._taut_since: float | None = None
        self._steady = False
        self._stood_at = view.length
        self._again = self.AGAIN
        self._samples: list[tuple[float, float]] = []
        self.zero: float | None = None

    def step(self, view: View) -> Step:
        """Advance."""
        limits = self._limits
        if view.now - self._started > limits.homing_timeout:
            return self._failed(view, f"no taut tendon within {limits.homing_timeout:.0f} s")
        if self._phase is _Phase.LET_OUT:
            return self._let_out(view)
        if self._phase is _Phase.TAKE_UP:
            return self._take_up(view)
        return self._go_to_zero(view)

    def _let_out(self, view: View) -> Step:
        end = self._start - self._limits.slack_travel
        self._profile.step(end, self._slackening_speed, self._limits.acceleration, view.dt)
        if self._profile.position == end:
            self._phase = _Phase.TAKE_UP
            self._stood_at = end
        return Step(self._profile.position, self._limits.tension_hold)

    def _take_up(self, view: View) -> Step:
        limits = self._limits
        tension = limits.homing_tension
        end = self._start - limits.slack_travel + limits.homing_travel
        if self._profile.position - view.length < limits.lead:
            self._profile.step(end, limits.homing_speed, limits.acceleration, view.dt)
        if view.speed < self.HELD_UP * limits.homing_speed and view.pull < self.TAUT * tension:
            self._stood_at = view.length
            self._samples.clear()
        run_up = view.length <= self._stood_at + self.RUN_UP
        self._steady = not run_up and (self._steady or view.speed <= self.TOO_FAST * limits.homing_speed)
        # At the limit the device holds the current constant: such samples say nothing about the rise.
        if self._steady and view.speed > self.STANDING and view.pull < self.SATURATED * tension:
            self._samples.append((view.length, view.pull))
        taut = abs(view.speed) <= self.STANDING and view.tension >= self.TAUT * tension
        if not taut:
            self._taut_since = None
        elif self._taut_since is None:
            self._taut_since = view.now
        elif view.now - self._taut_since >= self.DWELL:
            return self._taut(view)
        if self._profile.position == end and self.zero is None and view.length > end - limits.position_tolerance:
            return self._failed(
                view, f"{limits.homing_travel * 1e3:.0f} mm wound in without {tension:.1f} N: is the tendon attached?"
            )
        return Step(self._profile.position, tension)

    def _taut(self, view: View) -> Step:
        """Take the knee for the zero; where little slack was seen before it, begin again from further out."""
        found = knee(self._samples, view.length)
        self._profile = SpeedProfile(view.length)
        seen = found is not None and found - self._samples[0][0] >= self.LEAST_SLACK
        if seen:
            self.zero = found
            self._phase = _Phase.GO_TO_ZERO
        elif self._again == 0:
            return self._failed(view, "the force does not show where the tendon becomes taut")
        else:
            self._again -= 1
            self._start = min(self._start, view.length if found is None else found)
            self._taut_since, self._phase = None, _Phase.LET_OUT
            self._samples.clear()
        return Step(view.length, self._limits.homing_tension)

    def _go_to_zero(self, view: View) -> Step:
        assert self.zero is not None
        limits = self._limits
        self._profile.step(self.zero, self._slackening_speed, limits.acceleration, view.dt)
        if self._profile.position == self.zero and view.length - self.zero <= limits.position_tolerance:
            return Step(self.zero, limits.tension_hold, Outcome.REACHED, "homed")
        return Step(self._profile.position, limits.tension_hold)

    def _failed(self, view: View, reason: str) -> Step:
        return Step(view.length, self._limits.homing_tension, Outcome.FAULT, f"homing: {reason}", "homing_failed")


def knee(samples: Sequence[tuple[float, float]], end: float) -> float | None:
    """Return the length [m] at which a force begins to rise: F = b + s max(0, x - x0), least squares over b, s and x0.

    Fitted twice: the second time without the samples that stand out from the first fit (a jerk of the motor, a late
    reading).

    Args:
        samples: (length [m], force [N]) while winding in at a steady speed.
        end: [m] where the drive stood in the end.

    Returns:
        x0, or None where the samples are too few to show one.
    """
    if len(samples) < MIN_SAMPLES:
        return None
    x, force = np.array(samples).T
    x0, residuals = _hinge(x, force, end)
    usual = max(OUTLIER * float(np.median(np.abs(residuals))), ROUND * float(np.ptp(force)))
    kept = np.abs(residuals) <= usual
    return _hinge(x[kept], force[kept], end)[0] if kept.sum() >= MIN_SAMPLES else x0


def _hinge(x: Array, force: Array, end: float) -> tuple[float, Array]:
    """Return the best x0 on a grid, and the residuals there."""
    best, best_residuals = end, force - force.mean()
    for x0 in np.arange(x.min(), end, KNEE_STEP):
        rise = np.maximum(0.0, x - x0)
        centred = rise - rise.mean()
        slope = float(centred @ force) / max(float(centred @ centred), 1e-18)
        residuals = force - force.mean() - slope * centred
        if slope > 0.0 and residuals @ residuals < best_residuals @ best_residuals:
            best, best_residuals = float(x0), residuals
    return best, best_residuals
