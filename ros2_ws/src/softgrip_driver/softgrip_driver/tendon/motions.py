# SPDX-License-Identifier: Apache-2.0
"""What a drive can be busy with. A motion turns what is measured into the next setpoint and says when it is over.

Lengths are pulled lengths [m] from the homed zero; an unhomed drive counts from where it was switched on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

from softgrip_driver.tendon.guards import STEADY_ACCELERATION, StallGuard
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.profile import SpeedProfile
from softgrip_driver.tendon.trajectory import TendonTrajectory

#: [s] of its own motion that a servo is behind its setpoint: at full speed the whole voltage, which its proportional
#: gain needs an error for. 0.04 .. 0.06 s by the data sheets' no-load speeds and default gains
NATURAL_LAG = 0.06

#: position tolerances within which standing still is the error of the servo's own control; else something is in the way
STALL_TOLERANCE_FACTOR = 4.0


class DriveState(IntEnum):
    """State of a drive (TendonStatus.state)."""

    DISCONNECTED = 0
    IDENTIFIED = 1
    HOLDING = 2
    MOVING = 3
    HOMING = 4
    RELEASING = 5
    STOPPED = 6


class MoveOutcome(IntEnum):
    """How a motion ended (MoveTendon.Result.outcome)."""

    REACHED = 1
    TENSION_LIMIT = 2
    TIMEOUT = 3
    CANCELLED = 4
    FAULT = 5
    REFUSED = 6


@dataclass(frozen=True)
class DriveObservation:
    """What a motion sees of its drive.

    Attributes:
        now, dt: [s] monotonic time and the time since the last step.
        pulled_length_m, speed: [m], [m/s] pulled.
        tension: [N] median of three.
        pull: [N] single estimate with its sign.
        tension_cap: [N] the most that the guards allow now.
        stddev: [N] uncertainty of the tension.
        acceleration: [m/s^2] of the tendon.
        ahead: [m] the setpoint's length beyond the drive's: what makes the drive pull.
        is_gauged: the tension is a gauge's, see `DriveReading`.
    """

    now: float
    dt: float
    pulled_length_m: float
    speed: float
    tension: float
    pull: float
    tension_cap: float
    stddev: float = 0.0
    acceleration: float = 0.0
    ahead: float = 0.0
    is_gauged: bool = False

    @property
    def standing_ahead(self) -> float:
        """The part of `ahead` that is there without motion: the load's."""
        return self.ahead - NATURAL_LAG * self.speed

    @property
    def steady(self) -> bool:
        """Whether the tension is the tendon's and not what it takes to bring the motor up to speed."""
        return self.acceleration < STEADY_ACCELERATION


@dataclass(frozen=True)
class MotionStep:
    """What a motion wants.

    Attributes:
        pulled_length_m: [m] setpoint.
        tension_limit: [N]
        outcome: None while it goes on.
        reason: in words, with the outcome.
        fault: name of the fault that ended it.
    """

    pulled_length_m: float
    tension_limit: float
    outcome: MoveOutcome | None = None
    reason: str = ""
    fault: str = ""


class Motion(Protocol):
    """A motion."""

    @property
    def state(self) -> DriveState:
        """What the drive is in while this goes on."""

    @property
    def winding_in(self) -> bool:
        """Whether the setpoint moves inwards, so that a tension must build up."""

    @property
    def paying_out(self) -> bool:
        """Whether tension may vanish because the tendon is let out."""

    def step(self, view: DriveObservation) -> MotionStep:
        """Advance."""


class Hold:
    """Stand at a length with a tension limit."""

    state = DriveState.HOLDING
    winding_in = False
    paying_out = False

    def __init__(self, pulled_length_m: float, tension_limit: float, state: DriveState = DriveState.HOLDING) -> None:
        self.pulled_length_m = pulled_length_m
        self.tension_limit = tension_limit
        self.state = state

    def step(self, view: DriveObservation) -> MotionStep:
        """Keep the setpoint."""
        return MotionStep(self.pulled_length_m, min(self.tension_limit, view.tension_cap))


def _setpoint_now(view: DriveObservation, limits: TendonLimits) -> float:
    """Length [m] from which a motion goes on: where the setpoint stands, so that the pull goes on too."""
    return view.pulled_length_m + max(-limits.max_following_error, min(limits.max_following_error, view.ahead))


def _held(view: DriveObservation, limits: TendonLimits) -> float:
    """Length [m] of a setpoint that holds what is pulled now, once the drive stands."""
    return view.pulled_length_m + max(0.0, min(limits.max_following_error, view.standing_ahead))


def _stalled(view: DriveObservation, cap: float, target: float) -> MotionStep:
    """Step of a motion that something is in the way of."""
    off = abs(view.pulled_length_m - target)
    return MotionStep(
        view.pulled_length_m, cap, MoveOutcome.FAULT,
        f"stands at {view.pulled_length_m * 1e3:.2f} mm, {off * 1e3:.2f} mm from the target, "
        f"with {view.tension:.1f} N of {cap:.1f} N allowed", "stalled",
    )  # fmt: skip


class _TensionMet:
    """Tells a tension that is there and stays, once the motor had time to get up to speed."""

    #: [s]
    CONFIRM = 0.03

    def __init__(self, view: DriveObservation, speed: float, limits: TendonLimits) -> None:
        self._from = view.now + speed / limits.acceleration
        self._since: float | None = None

    def step(self, view: DriveObservation, tension: float) -> bool:
        """Return whether a tension [N] is met."""
        if view.now < self._from or view.tension < tension or not view.steady:
            self._since = None
        elif self._since is None:
            self._since = view.now
        return self._since is not None and view.now - self._since >= self.CONFIRM


class MoveToLength:
    """Move to a pulled length; stop at a tension limit on the way in."""

    #: share of the limit at which the tension counts as met: the servo itself holds it there and gets no closer
    MET = 0.95
    #: [m/s] below which the drive counts as arrived
    SETTLED_SPEED = 3e-3

    def __init__(
        self,
        target: float,
        speed: float,
        tension_limit: float,
        view: DriveObservation,
        limits: TendonLimits,
        state: DriveState = DriveState.MOVING,
        start: float | None = None,
    ) -> None:
        self.state = state
        self._target = target
        self._speed = speed
        self._limit = tension_limit
        self._limits = limits
        self._profile = SpeedProfile(_setpoint_now(view, limits) if start is None else start)
        self._stall = StallGuard(limits.stall_time)
        self._met = _TensionMet(view, speed, limits)
        self.winding_in = target > self._profile.position

    @property
    def paying_out(self) -> bool:
        """Whether the setpoint retreats."""
        return not self.winding_in

    def step(self, view: DriveObservation) -> MotionStep:
        """Advance the setpoint, unless the drive has fallen behind."""
        cap = min(self._limit, view.tension_cap)
        behind = self._profile.position - view.pulled_length_m
        blocked = (
            abs(behind) > self._limits.max_following_error and behind * (self._target - view.pulled_length_m) > 0.0
        )
        if blocked:
            self._profile.velocity = 0.0
        else:
            self._profile.step(self._target, self._speed, self._limits.acceleration, view.dt)
        at_target = self._profile.position == self._target
        setpoint = self._profile.position
        if self._met.step(view, self.MET * cap if self.winding_in else math.inf):
            held = _held(view, self._limits)
            return MotionStep(
                held, cap, MoveOutcome.TENSION_LIMIT, f"{view.tension:.1f} N met the limit of {cap:.1f} N before "
                f"{self._target * 1e3:.2f} mm, at {view.pulled_length_m * 1e3:.2f} mm",
            )  # fmt: skip
        close = abs(view.pulled_length_m - self._target) <= self._limits.position_tolerance
        if at_target and close and abs(view.speed) <= self.SETTLED_SPEED:
            return MotionStep(
                setpoint, cap, MoveOutcome.REACHED, f"at {view.pulled_length_m * 1e3:.2f} mm with {view.tension:.1f} N"
            )
        if self._stall.step(view.now, view.pulled_length_m, moving=blocked or at_target):
            return self._stalled(view, cap)
        return MotionStep(setpoint, cap)

    def _stalled(self, view: DriveObservation, cap: float) -> MotionStep:
        """Done where it is nearly there, else a fault."""
        off = abs(view.pulled_length_m - self._target)
        if off <= STALL_TOLERANCE_FACTOR * self._limits.position_tolerance:
            return MotionStep(
                self._target,
                cap,
                MoveOutcome.REACHED,
                f"at {view.pulled_length_m * 1e3:.2f} mm, {off * 1e3:.2f} mm off the target",
            )
        return _stalled(view, cap, self._target)


class MoveToTension:
    """Wind in, or pay out, until a tension is there and steady; keep pulling with it afterwards."""

    #: [s] that the tension must stay within tolerance
    SETTLED = 0.06

    state = DriveState.MOVING

    def __init__(self, target: float, speed: float, view: DriveObservation, limits: TendonLimits) -> None:
        self._target = target
        self._speed = speed
        self._limits = limits
        self._profile = SpeedProfile(_setpoint_now(view, limits))
        self._stall = StallGuard(limits.stall_time)
        self._since: float | None = None
        self.winding_in = view.tension < target

    @property
    def paying_out(self) -> bool:
        """Whether the setpoint retreats."""
        return not self.winding_in

    def step(self, view: DriveObservation) -> MotionStep:
        """Advance the setpoint towards more or less tension."""
        target = min(self._target, view.tension_cap)
        band = max(self._limits.tension_tolerance * target, 0.2)
        met = view.tension >= target - band if self.winding_in else view.tension <= target + band
        if not met or (self._since is None and not view.steady):
            self._since = None
            end = self._limits.travel if self.winding_in else 0.0
            if abs(self._profile.position - view.pulled_length_m) <= self._limits.max_following_error:
                self._profile.step(end, self._speed, self._limits.acceleration, view.dt)
        elif self._since is None:
            self._since = view.now
            self._profile.velocity = 0.0
        if self._since is not None and view.now - self._since >= self.SETTLED:
            ahead = min(self._profile.position, view.pulled_length_m + self._limits.max_following_error)
            if self.paying_out:
                # A setpoint that went further out than the drive would pull it along, and the tension away.
                ahead = max(ahead, view.pulled_length_m)
            return MotionStep(
                ahead, target, MoveOutcome.REACHED, f"{view.tension:.1f} N at {view.pulled_length_m * 1e3:.2f} mm"
            )
        at_end = self._profile.position in (0.0, self._limits.travel)
        standing = self._stall.step(view.now, view.pulled_length_m, moving=self._since is None)
        is_behind = abs(self._profile.position - view.pulled_length_m) > self._limits.max_following_error
        if standing and not met and (at_end or is_behind):
            return MotionStep(
                view.pulled_length_m, target, MoveOutcome.FAULT,
                f"{view.tension:.1f} N of {target:.1f} N at {view.pulled_length_m * 1e3:.2f} mm, "
                "and it moves no further",
                "stalled",
            )  # fmt: skip
        return MotionStep(self._profile.position, target)


class Follow:
    """Follow a trajectory within the drive's speed and acceleration; a streamed successor takes over at any time."""

    state = DriveState.MOVING

    def __init__(
        self, trajectory: TendonTrajectory, tension_limit: float, view: DriveObservation, limits: TendonLimits
    ) -> None:
        self._limits = limits
        self._limit = tension_limit
        self._profile = SpeedProfile(_setpoint_now(view, limits))
        self._started = view.now
        self._met = _TensionMet(view, limits.speed, limits)
        self._stall = StallGuard(limits.stall_time)
        self._given = trajectory
        self._trajectory = trajectory.starting_from(self._profile.position, view.speed)
        self.winding_in = self.paying_out = False

    def take_over(self, predecessor: Follow) -> None:
        """Go on from another trajectory's setpoint, without a step."""
        self._profile, self._met, self._stall = predecessor._profile, predecessor._met, predecessor._stall
        self._trajectory = self._given.starting_from(self._profile.position, self._profile.velocity)

    def step(self, view: DriveObservation) -> MotionStep:
        """Track the interpolated length."""
        cap = min(self._limit, view.tension_cap)
        elapsed = view.now - self._started
        before = self._profile.position
        # Between points that lie within the travel a cubic may leave it; a slack finger may begin outside.
        target = max(min(0.0, before), min(self._limits.travel, self._trajectory.length(elapsed)))
        # Tracking must not lag behind a ramp: aim as far beyond the target as the profile needs to brake.
        self._profile.step(target, self._limits.speed, 4.0 * self._limits.acceleration, view.dt)
        ahead = self._profile.position - view.pulled_length_m
        blocked = abs(ahead) > self._limits.max_following_error and ahead * (self._profile.position - before) > 0.0
        if blocked:
            self._profile.stop_at(before)
        self.winding_in, self.paying_out = self._profile.position > before, self._profile.position < before
        off = abs(view.pulled_length_m - target)
        inwards = self.winding_in or view.pulled_length_m < target - self._limits.position_tolerance
        if self._met.step(view, MoveToLength.MET * cap if inwards else math.inf):
            held = _held(view, self._limits)
            return MotionStep(
                held, cap, MoveOutcome.TENSION_LIMIT, f"{view.tension:.1f} N met the limit of {cap:.1f} N"
            )
        over = elapsed >= self._trajectory.duration and self._profile.position == target
        done = over and off <= self._limits.position_tolerance
        if not done and self._stall.step(view.now, view.pulled_length_m, moving=blocked or over):
            if off > STALL_TOLERANCE_FACTOR * self._limits.position_tolerance:
                return _stalled(view, cap, target)
            done = True
        if done:
            return MotionStep(
                target, cap, MoveOutcome.REACHED, f"trajectory done, at {view.pulled_length_m * 1e3:.2f} mm"
            )
        return MotionStep(self._profile.position, cap)
