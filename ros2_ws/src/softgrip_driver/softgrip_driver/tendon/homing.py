# SPDX-License-Identifier: Apache-2.0
"""Find the zero of the pulled length: where the tendon of the straight finger just becomes taut.

Let out until slack, wind in slowly against a small tension until the drive stands, then pay out again steadily. While
paying out, force over length falls as long as the tendon is taut and is flat once it is slack (the gears'
friction); the knee between the two is the zero. It is read on the way out because there the motor neither starts up
nor runs into its current limit. Go to the zero from the slack side, as every closing does.
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

Array = NDArray[np.float64]


class _Phase(Enum):
    LET_OUT = auto()
    TAKE_UP = auto()
    PAY_OUT = auto()
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
    #: share of the homing speed from which a sample of paying out counts
    STEADY = 0.7

    state = DriveState.HOMING
    winding_in = False
    paying_out = True

    def __init__(self, view: View, limits: TendonLimits) -> None:
        self._limits = limits
        self._started = view.now
        self._start = view.length
        self._phase = _Phase.LET_OUT
        self._profile = SpeedProfile(view.length)
        self._taut_since: float | None = None
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
        if self._phase is _Phase.PAY_OUT:
            return self._pay_out(view)
        return self._go_to_zero(view)

    def _let_out(self, view: View) -> Step:
        end = self._start - self._limits.slack_travel
        self._profile.step(end, self._limits.homing_speed, self._limits.acceleration, view.dt)
        if self._profile.position == end:
            self._phase = _Phase.TAKE_UP
        return Step(self._profile.position, self._limits.tension_hold)

    def _take_up(self, view: View) -> Step:
        limits = self._limits
        tension = limits.homing_tension
        end = self._start - limits.slack_travel + limits.homing_travel
        if self._profile.position - view.length < limits.lead:
            self._profile.step(end, limits.homing_speed, limits.acceleration, view.dt)
        taut = abs(view.speed) <= self.STANDING and view.tension >= self.TAUT * tension
        if not taut:
            self._taut_since = None
        elif self._taut_since is None:
            self._taut_since = view.now
        elif view.now - self._taut_since >= self.DWELL:
            self._profile = SpeedProfile(view.length)
            self._start = view.length
            self._phase = _Phase.PAY_OUT
        at_end = self._profile.position == end and view.length > end - limits.position_tolerance
        if self._phase is _Phase.TAKE_UP and at_end:
            return self._failed(
                view, f"{limits.homing_travel * 1e3:.0f} mm wound in without {tension:.1f} N: is the tendon attached?"
            )
        return Step(self._profile.position, tension)

    def _pay_out(self, view: View) -> Step:
        limits = self._limits
        end = self._start - limits.slack_travel
        self._profile.step(end, limits.homing_speed, limits.acceleration, view.dt)
        if view.speed <= -self.STEADY * limits.homing_speed:
            self._samples.append((view.length, view.pull))
        if self._profile.position == end:
            self.zero = knee(self._samples, self._start)
            self._phase = _Phase.GO_TO_ZERO
        return Step(self._profile.position, limits.tension_hold)

    def _go_to_zero(self, view: View) -> Step:
        assert self.zero is not None
        limits = self._limits
        self._profile.step(self.zero, limits.homing_speed, limits.acceleration, view.dt)
        if self._profile.position == self.zero and self.zero - view.length <= limits.position_tolerance:
            return Step(self.zero, limits.tension_hold, Outcome.REACHED, "homed")
        return Step(self._profile.position, limits.tension_hold)

    def _failed(self, view: View, reason: str) -> Step:
        return Step(view.length, self._limits.homing_tension, Outcome.FAULT, f"homing: {reason}", "homing_failed")


def knee(samples: Sequence[tuple[float, float]], end: float) -> float:
    """Return the length [m] at which a force begins to rise: F = b + s max(0, x - x0), least squares over b, s and x0.

    Fitted twice: the second time without the samples that stand out from the first fit (a jerk of the motor, a late
    reading).

    Args:
        samples: (length [m], force [N]) at a steady speed, in any order.
        end: [m] where the drive stood against the tension; returned when the samples show no rise.
    """
    if len(samples) < MIN_SAMPLES:
        return end
    x, force = np.array(samples).T
    x0, residuals = _hinge(x, force, end)
    kept = np.abs(residuals) <= OUTLIER * max(float(np.median(np.abs(residuals))), 1e-9)
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
