# SPDX-License-Identifier: Apache-2.0
"""All drives on one port together: requests, what one drive's fault means for the others, emergency stop.

Pure like drive.py. `GripperController.step` is the control cycle; everything else is a request made between steps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import partial

from softgrip_driver.errors import ConfigurationError
from softgrip_driver.faults import FAULTS
from softgrip_driver.tendon.backend import DriveReading
from softgrip_driver.tendon.drive import Drive
from softgrip_driver.tendon.homing import Homing
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.motions import (
    DriveState,
    Follow,
    Hold,
    Motion,
    MoveToLength,
    MoveToTension,
    Outcome,
    View,
)
from softgrip_driver.tendon.status import DriveActions, DriveSnapshot
from softgrip_driver.tendon.trajectory import Trajectory

MotionFactory = Callable[[View], Motion]

ESTOP_IS_ON = "emergency stop is on; call estop_reset"


class MoveMode(IntEnum):
    """What a move's targets are (MoveTendon.Goal.mode)."""

    LENGTH = 1
    TENSION = 2


class StopPolicy(IntEnum):
    """What an emergency stop does."""

    LET_GO = 0
    HOLD = 1


@dataclass(frozen=True)
class Policies:
    """What the whole gripper does when nobody tells it.

    Attributes:
        estop: torque off, so that springs open the fingers, or hold.
        command_timeout: [s] without a command until a holding drive reduces its tension; 0 = never.
        release_after: [s] more until it releases slowly.
        continuous_tension: [N] that a drive may hold for ever.
    """

    estop: StopPolicy = StopPolicy.LET_GO
    command_timeout: float = 0.0
    release_after: float = 30.0
    continuous_tension: float = 20.0


@dataclass(frozen=True)
class MoveRequest:
    """A move of one or more tendons; see MoveTendon.action."""

    tendons: Sequence[str]
    mode: MoveMode
    targets: Sequence[float]
    speed: float = 0.0
    tension_limit: float = 0.0


@dataclass(frozen=True)
class Ticket:
    """A request that runs.

    Attributes:
        jobs: number of the drive's motion by tendon.
        refusal: why it did not start, empty when it did.
    """

    jobs: Mapping[str, int]
    refusal: str = ""

    def result(self, drives: Sequence[DriveSnapshot]) -> tuple[Outcome | None, str]:
        """Return its outcome over all its tendons as snapshots of the drives show it; None while it runs."""
        if self.refusal:
            return Outcome.REFUSED, self.refusal
        ends: dict[str, tuple[Outcome | None, str]] = {}
        for drive in drives:
            job = self.jobs.get(drive.tendon)
            if job is None:
                continue
            if drive.job == job:
                ends[drive.tendon] = drive.outcome, drive.reason
            elif drive.job > job:
                ends[drive.tendon] = Outcome.CANCELLED, "replaced by a newer command"
            else:  # the snapshot is older than the request
                ends[drive.tendon] = None, ""
        # The worst tells: a fault of one tendon ends the whole move.
        for outcome in (Outcome.FAULT, Outcome.CANCELLED):
            reasons = [f"{name}: {reason}" for name, (end, reason) in ends.items() if end is outcome]
            if reasons:
                return outcome, "; ".join(reasons)
        if any(end is None for end, _ in ends.values()):
            return None, ""
        limited = any(end is Outcome.TENSION_LIMIT for end, _ in ends.values())
        text = "; ".join(f"{name}: {reason}" for name, (_, reason) in ends.items())
        return (Outcome.TENSION_LIMIT if limited else Outcome.REACHED), text


class GripperController:
    """State machine of all tendons.

    Args:
        limits: by tendon, in the order of the drives.
        policies: see Policies.
        grippers: which gripper each tendon belongs to, where several hang on one port; a fault concerns its own
            gripper only, the emergency stop all.
        period: [s] between steps.
    """

    def __init__(
        self,
        limits: Mapping[str, TendonLimits],
        policies: Policies,
        grippers: Mapping[str, str] | None = None,
        period: float = 0.01,
    ) -> None:
        self._grippers = dict(grippers or {})
        self.policies = policies
        self.drives = {name: Drive(name, row, policies.continuous_tension, period) for name, row in limits.items()}
        self.estop = False
        self._commanded_at = dict.fromkeys(limits, 0.0)
        self._opened_for: set[str] = set()

    # --- requests --------------------------------------------------------------------------------------------------

    def move(self, request: MoveRequest, now: float) -> Ticket:
        """Start a move, all tendons or none."""
        names = list(request.tendons) or list(self.drives)
        targets = list(request.targets) * len(names) if len(request.targets) == 1 else list(request.targets)
        refusal = self._refusal(names, homed=True) or self._wrong(request, names, targets)
        if refusal:
            return Ticket({}, refusal)
        for name, target in zip(names, targets, strict=True):
            self._begin(name, self._motion(request, self.drives[name].limits, target), now)
        return Ticket({name: self.drives[name].job for name in names})

    def follow(self, trajectories: Mapping[str, Trajectory], now: float) -> Ticket:
        """Follow streamed trajectories; one that runs is taken over without a step."""
        refusal = self._refusal(list(trajectories), homed=True)
        if refusal:
            return Ticket({}, refusal)
        for name, trajectory in trajectories.items():
            limits = self.drives[name].limits
            make = partial(Follow, trajectory, limits.tension_soft, limits=limits)
            self._begin(name, make, now)
        return Ticket({name: self.drives[name].job for name in trajectories})

    def home(self, now: float, tendons: Sequence[str] = ()) -> Ticket:
        """Home tendons, all of them when none is named."""
        names = list(tendons) or list(self.drives)
        refusal = self._refusal(names, homed=False)
        if refusal:
            return Ticket({}, refusal)
        for name in names:
            self._begin(name, partial(Homing, limits=self.drives[name].limits), now)
        return Ticket({name: self.drives[name].job for name in names})

    def release(self, now: float, tendons: Sequence[str] = ()) -> Ticket:
        """Open slowly to the zero, all tendons when none is named; also with a latched fault, as far as power is on."""
        if self.estop:
            return Ticket({}, ESTOP_IS_ON)
        names = [name for name in (tendons or self.drives) if self.drives[name].powered and self.drives[name].homed]
        if not names:
            return Ticket({}, "no tendon is powered and homed; there is nothing to release")
        for name in names:
            self._begin(name, self._release_motion(self.drives[name].limits), now)
        return Ticket({name: self.drives[name].job for name in names})

    def cancel(self, ticket: Ticket, now: float) -> None:
        """Stop what still runs of a request and hold."""
        for name, job in ticket.jobs.items():
            drive = self.drives[name]
            if drive.job == job and drive.outcome is None:
                self._begin(name, partial(_hold_here, limits=drive.limits), now)

    def result(self, ticket: Ticket) -> tuple[Outcome | None, str]:
        """Return the outcome of a request over all its tendons, None while it runs."""
        return ticket.result(self.snapshots())

    def stop_emergency(self) -> dict[str, DriveActions]:
        """Stop now; stays until `reset`."""
        self.estop = True
        actions: dict[str, DriveActions] = {}
        for name, drive in self.drives.items():
            was_powered = drive.powered
            drive.set_fault("estop", "asked for")
            if self.policies.estop is StopPolicy.LET_GO:
                actions[name] = drive.switch_off()
            elif was_powered:
                drive.hold_now()
        return actions

    def reset(self) -> None:
        """Leave the emergency stop and the latched faults; nothing moves and nothing is powered by it."""
        self.estop = False
        self._opened_for.clear()
        for drive in self.drives.values():
            drive.reset()

    # --- the control cycle -----------------------------------------------------------------------------------------

    def step(self, now: float, readings: Mapping[str, DriveReading]) -> dict[str, DriveActions]:
        """Take the readings of a cycle and return what each device shall do."""
        actions = {name: drive.step(now, readings.get(name)) for name, drive in self.drives.items()}
        for name, drive in self.drives.items():
            self._mind_the_others(name, drive, now)
            self._mind_the_commander(name, drive, now)
        return actions

    def lose_port(self, reason: str) -> None:
        """Take note that the port is gone."""
        for drive in self.drives.values():
            drive.set_fault("port_lost", reason)

    def snapshots(self) -> tuple[DriveSnapshot, ...]:
        """Return every drive's state."""
        return tuple(drive.snapshot() for drive in self.drives.values())

    def _mind_the_others(self, name: str, drive: Drive, now: float) -> None:
        """A drive at fault stops what moves together with it; where the table says so the others open."""
        row = FAULTS.get(drive.fault)
        if row is None or drive.fault == "estop" or drive.state not in (DriveState.STOPPED, DriveState.DISCONNECTED):
            self._opened_for.discard(name)
            return
        if name in self._opened_for:
            return
        self._opened_for.add(name)
        for other_name, other in self.drives.items():
            foreign = self._grippers.get(other_name) != self._grippers.get(name)
            if other_name == name or foreign or other.fault or not other.powered:
                continue
            if row.opens_others and other.homed:
                self._begin(other_name, self._release_motion(other.limits), now)
            elif other.busy and other.state is DriveState.MOVING:
                other.abort(f"stopped because tendon '{name}' has the fault {drive.fault}")

    def _mind_the_commander(self, name: str, drive: Drive, now: float) -> None:
        limit = self.policies.command_timeout
        if limit <= 0.0 or not drive.powered or drive.busy or drive.state is not DriveState.HOLDING:
            return
        silent = now - self._commanded_at[name]
        if silent > limit and drive.fault == "" and drive.holds_tension:
            drive.set_fault("command_timeout", f"none for {silent:.1f} s")
            drive.hold_now()
        elif silent > limit + self.policies.release_after and drive.fault == "command_timeout" and drive.homed:
            drive.start(self._release_motion(drive.limits), now)

    # --- helpers ---------------------------------------------------------------------------------------------------

    def _begin(self, name: str, make: MotionFactory, now: float) -> None:
        self._commanded_at[name] = now
        self.drives[name].start(make, now)

    def _refusal(self, names: Sequence[str], *, homed: bool) -> str:
        unknown = [name for name in names if name not in self.drives]
        if unknown:
            return f"expected tendons out of {list(self.drives)}, found {unknown}"
        if self.estop:
            return ESTOP_IS_ON
        return "; ".join(text for name in names if (text := self.drives[name].refusal(homed=homed)))

    def _wrong(self, request: MoveRequest, names: Sequence[str], targets: Sequence[float]) -> str:
        if len(targets) != len(names):
            return f"expected one target or {len(names)}, found {len(targets)}"
        for name, target in zip(names, targets, strict=True):
            limits = self.drives[name].limits
            top, unit = (limits.travel, "m") if request.mode is MoveMode.LENGTH else (limits.tension_soft, "N")
            if not 0.0 <= target <= top:
                return f"tendon '{name}': expected a target between 0 and {top:g} {unit}, found {target:g} {unit}"
            if not 0.0 <= request.speed <= limits.speed:
                return f"tendon '{name}': expected a speed up to {limits.speed:g} m/s, found {request.speed:g} m/s"
            if not 0.0 <= request.tension_limit <= limits.tension_soft:
                return (
                    f"tendon '{name}': expected a tension limit up to {limits.tension_soft:g} N, "
                    f"found {request.tension_limit:g} N"
                )
        return ""

    @staticmethod
    def _motion(request: MoveRequest, limits: TendonLimits, target: float) -> MotionFactory:
        speed = request.speed or limits.speed
        limit = request.tension_limit or limits.tension_soft
        if request.mode is MoveMode.LENGTH:
            return lambda view: MoveToLength(target, speed, limit, view, limits)
        return lambda view: MoveToTension(target, speed, view, limits)

    @staticmethod
    def _release_motion(limits: TendonLimits) -> MotionFactory:
        return lambda view: MoveToLength(
            0.0, limits.release_speed, limits.tension_soft, view, limits, DriveState.RELEASING
        )


def _hold_here(view: View, limits: TendonLimits) -> Motion:
    return Hold(view.length, limits.tension_soft)


def check_names(names: Sequence[str]) -> None:
    """Raise ConfigurationError unless tendon names are given and differ."""
    if not names or len(set(names)) != len(names) or not all(names):
        raise ConfigurationError(f"tendons: expected names that differ, found {list(names)}")
