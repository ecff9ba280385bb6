# SPDX-License-Identifier: Apache-2.0
"""All drives on one port together: requests, what one drive's fault means for the others, emergency stop.

Pure like drive.py. `GripperController.step` is the control cycle; everything else is a request made between steps.
"""

from __future__ import annotations

import math
import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import partial

from softgrip_driver.faults import FAULTS
from softgrip_driver.tendon.backend import DriveReading
from softgrip_driver.tendon.drive import Drive
from softgrip_driver.tendon.homing import Homing
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.motions import (
    DriveObservation,
    DriveState,
    Follow,
    Hold,
    Motion,
    MoveOutcome,
    MoveToLength,
    MoveToTension,
)
from softgrip_driver.tendon.ownership import Lease, Ownership
from softgrip_driver.tendon.status import DriveActions, DriveSnapshot
from softgrip_driver.tendon.trajectory import TendonTrajectory

MotionFactory = Callable[[DriveObservation], Motion]


class MoveMode(IntEnum):
    """What a move's targets are (MoveTendon.Goal.mode)."""

    LENGTH = 1
    TENSION = 2


class StopPolicy(IntEnum):
    """What a stop does."""

    LET_GO = 0
    HOLD = 1


@dataclass(frozen=True)
class Policies:
    """What the whole gripper does when nobody commands it.

    Attributes:
        estop: torque off, so that springs open the fingers, or hold.
        unclean_end: the same for drives that a new process finds holding after the one before was killed.
        command_timeout: [s] without a command or heartbeat until a hold above the hold tension is reduced to it.
        release_after: [s] more until it releases slowly.
        stream_timeout: [s] without a message or heartbeat until a streamed motion stops.
        lease_max: [s] of the longest lease.
        continuous_tension: [N] that a drive may hold for ever.
    """

    estop: StopPolicy = StopPolicy.LET_GO
    unclean_end: StopPolicy = StopPolicy.HOLD
    command_timeout: float = 30.0
    release_after: float = 30.0
    stream_timeout: float = 0.5
    lease_max: float = 30.0
    continuous_tension: float = 20.0


@dataclass(frozen=True)
class Block:
    """Why nothing may move.

    Attributes:
        text: for whoever is refused.
        is_stop: an emergency stop, which is a fault of every drive; else hands are in the cell.
        lets_go: torque goes off; else what holds goes on holding.
        cause: of the stop, for a fault's text, which has the remedy by itself; empty = ``text``.
    """

    text: str
    is_stop: bool
    lets_go: bool
    cause: str = ""


def never_blocked() -> Block | None:
    """Return None: no emergency stop, no lock."""
    return None


@dataclass(frozen=True)
class MoveRequest:
    """A move of one or more tendons; see MoveTendon.action.

    Attributes:
        tendons: names; none = all.
        mode: what the targets are.
        targets: [m] or [N], one for each tendon, or one for all.
        speed: [m/s] of pulled length, above 0.
        tension_limit: [N] at which a move to a length stops, above 0; a move to a tension has none besides its target.
        lease: token of the owner; empty where nobody owns the tendons.
        deadline: [s] monotonic; the move is refused if it would begin later.
    """

    tendons: Sequence[str]
    mode: MoveMode
    targets: Sequence[float]
    speed: float
    tension_limit: float = math.nan
    lease: str = ""
    deadline: float = math.inf


@dataclass(frozen=True)
class Ticket:
    """A request that runs.

    Attributes:
        jobs: number of the drive's motion by tendon.
        refusal: why it did not start, empty when it did.
    """

    jobs: Mapping[str, int]
    refusal: str = ""

    def result(self, drives: Sequence[DriveSnapshot]) -> tuple[MoveOutcome | None, str]:
        """Return its outcome over all its tendons as snapshots of the drives show it; None while it runs."""
        if self.refusal:
            return MoveOutcome.REFUSED, self.refusal
        ends: dict[str, tuple[MoveOutcome | None, str]] = {}
        for drive in drives:
            job = self.jobs.get(drive.tendon)
            if job is None:
                continue
            if drive.job == job:
                ends[drive.tendon] = drive.outcome, drive.reason
            elif drive.job > job:
                ends[drive.tendon] = MoveOutcome.CANCELLED, "replaced by a newer command"
            else:  # the snapshot is older than the request
                ends[drive.tendon] = None, ""
        # The worst tells: a fault of one tendon ends the whole move.
        for outcome in (MoveOutcome.FAULT, MoveOutcome.CANCELLED):
            reasons = [f"{name}: {reason}" for name, (end, reason) in ends.items() if end is outcome]
            if reasons:
                return outcome, "; ".join(reasons)
        if any(end is None for end, _ in ends.values()):
            return None, ""
        limited = any(end is MoveOutcome.TENSION_LIMIT for end, _ in ends.values())
        text = "; ".join(f"{name}: {reason}" for name, (_, reason) in ends.items())
        return (MoveOutcome.TENSION_LIMIT if limited else MoveOutcome.REACHED), text


class GripperController:
    """State machine of all tendons.

    Args:
        limits: by tendon, in the order of the drives.
        policies: see Policies.
        grippers: which gripper each tendon belongs to, where several hang on one port; a fault concerns its own
            gripper only, the emergency stop all.
        period: [s] between steps.
        block: says whether anything may move now; asked at every order and in every step.
    """

    def __init__(
        self,
        limits: Mapping[str, TendonLimits],
        policies: Policies,
        grippers: Mapping[str, str] | None = None,
        period: float = 0.01,
        block: Callable[[], Block | None] = never_blocked,
    ) -> None:
        self._grippers = dict(grippers or {})
        self._block = block
        self.policies = policies
        self.drives = {name: Drive(name, row, policies.continuous_tension, period) for name, row in limits.items()}
        self.estop = False
        self.ownership = Ownership(list(limits), policies.lease_max, partial(secrets.token_urlsafe, 16))
        self._commanded_at: dict[str, float] = {}
        #: token under which each drive's last motion began; a release or a homing has none
        self._motion_lease: dict[str, str] = {}
        self._opened_for: set[str] = set()

    @property
    def is_blocked(self) -> bool:
        """Whether a stop or a lock stands."""
        return self._block() is not None

    @property
    def is_letting_go(self) -> bool:
        """Whether a stop or a lock stands that wants torque off."""
        block = self._block()
        return block is not None and block.lets_go

    @property
    def is_calm(self) -> bool:
        """Whether nobody owns a tendon, nothing is blocked, and no drive pulls, moves or is at fault."""
        is_owned = any(row.owner for row in self.ownership.rows())
        return not is_owned and not self.is_blocked and all(drive.is_calm for drive in self.drives.values())

    def hold_all(self, reason: str) -> None:
        """Stop what moves and hold, as a fault that the next order ends."""
        for drive in self.drives.values():
            if drive.busy:
                drive.set_fault("owner_lost", reason)

    # --- requests --------------------------------------------------------------------------------------------------

    def move(self, request: MoveRequest, now: float) -> Ticket:
        """Start a move, all tendons or none."""
        names = list(request.tendons) or list(self.drives)
        targets = list(request.targets) * len(names) if len(request.targets) == 1 else list(request.targets)
        refusal = self._refusal(names, now, request.lease) or self._wrong(request, names, targets)
        if not refusal and now > request.deadline:
            refusal = (
                f"expected to begin before its deadline, found it {now - request.deadline:.3f} s late; send it again"
            )
        if refusal:
            return Ticket({}, refusal)
        for name, target in zip(names, targets, strict=True):
            self._begin(name, self._motion(request, self.drives[name].limits, target), now, request.lease)
        return Ticket({name: self.drives[name].job for name in names})

    def follow(self, trajectories: Mapping[str, TendonTrajectory], now: float, lease: str = "") -> Ticket:
        """Follow streamed trajectories; one that runs is taken over without a step."""
        refusal = self._refusal(list(trajectories), now, lease)
        if refusal:
            return Ticket({}, refusal)
        for name, trajectory in trajectories.items():
            limits = self.drives[name].limits
            make = partial(Follow, trajectory, limits.tension_soft, limits=limits)
            self._begin(name, make, now, lease)
        return Ticket({name: self.drives[name].job for name in trajectories})

    def home(self, now: float, tendons: Sequence[str] = ()) -> Ticket:
        """Home tendons, all of them when none is named."""
        names = list(tendons) or list(self.drives)
        refusal = self._refusal(names, now, homed=False) or self._owned_refusal(names, now)
        if refusal:
            return Ticket({}, refusal)
        for name in names:
            self._begin(name, partial(Homing, limits=self.drives[name].limits), now)
        return Ticket({name: self.drives[name].job for name in names})

    def release(self, now: float, tendons: Sequence[str] = ()) -> Ticket:
        """Open powered tendons slowly to the zero, all when none is named.

        Refused by a stop and a lock alone: neither another's lease nor a latched fault keeps a product held.
        """
        block = self._block()
        if block is not None:
            return Ticket({}, block.text)
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

    def result(self, ticket: Ticket) -> tuple[MoveOutcome | None, str]:
        """Return the outcome of a request over all its tendons, None while it runs."""
        return ticket.result(self.snapshots())

    def enforce_block(self) -> dict[str, DriveActions]:
        """Do what an emergency stop or a lock asks for now; nothing when there is none."""
        block = self._block()
        actions: dict[str, DriveActions] = {}
        if block is None:
            return actions
        self.estop = self.estop or block.is_stop
        for name, drive in self.drives.items():
            was_powered = drive.powered
            if block.is_stop:
                drive.set_fault("estop", block.cause or block.text)
            elif drive.busy:
                drive.cancel_motion(block.text)
            if block.lets_go:
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
        for name in self.drives:
            self._commanded_at.setdefault(name, now)
        if self._violates_block():
            self.enforce_block()
        self._stop_orphans(now)
        actions = {name: drive.step(now, readings.get(name)) for name, drive in self.drives.items()}
        for name, drive in self.drives.items():
            self._propagate_fault(name, drive, now)
            self._check_command_timeout(name, drive, now)
        return actions

    def _violates_block(self) -> bool:
        """Whether a stop or a lock is not yet what the drives do."""
        block = self._block()
        if block is None:
            return False
        drives = self.drives.values()
        if block.is_stop and not self.estop:
            return True
        return any(drive.powered for drive in drives) if block.lets_go else any(drive.busy for drive in drives)

    def _stop_orphans(self, now: float) -> None:
        """Stop what moves for an owner that fell silent, and streams that nobody feeds any more."""
        for name, owner in self.ownership.end_lapsed(now).items():
            if self.drives[name].busy and self._motion_lease.get(name):
                self.drives[name].set_fault("owner_lost", f"no heartbeat of {owner} within its lease")
        for name, drive in self.drives.items():
            silent = now - max(self._commanded_at[name], self.ownership.last_heartbeat(name))
            if drive.is_following and silent > self.policies.stream_timeout:
                drive.set_fault("owner_lost", f"a stream without a message or a heartbeat for {silent:.2f} s")

    def lose_port(self, reason: str) -> None:
        """Record that the port is gone."""
        for drive in self.drives.values():
            drive.set_fault("port_lost", reason)

    def snapshots(self) -> tuple[DriveSnapshot, ...]:
        """Return every drive's state."""
        return tuple(drive.snapshot() for drive in self.drives.values())

    def _propagate_fault(self, name: str, drive: Drive, now: float) -> None:
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

    def _check_command_timeout(self, name: str, drive: Drive, now: float) -> None:
        limit = self.policies.command_timeout
        if not drive.powered or drive.busy or drive.state is not DriveState.HOLDING:
            return
        silent = now - max(self._commanded_at[name], self.ownership.last_heartbeat(name))
        if silent > limit and drive.fault == "" and drive.tension > drive.limits.tension_hold:
            drive.set_fault("command_timeout", f"none for {silent:.1f} s")
            drive.hold_now()
        elif silent > limit + self.policies.release_after and drive.fault == "command_timeout" and drive.homed:
            drive.start(self._release_motion(drive.limits), now)

    # --- helpers ---------------------------------------------------------------------------------------------------

    def _begin(self, name: str, make: MotionFactory, now: float, lease: str = "") -> None:
        self._commanded_at[name] = now
        self._motion_lease[name] = lease
        self.drives[name].start(make, now)

    def stop_taken(self, tendons: Sequence[str], lease: Lease, reason: str) -> None:
        """Stop what tendons do that were taken from another owner by force."""
        for name in tendons:
            if self.drives[name].busy:
                self.drives[name].cancel_motion(f"taken over by {lease.owner}: {reason}")

    def release_lease(self, token: str, now: float) -> tuple[str, ...]:
        """End a lease; what it moved stops and holds, a slow release goes on. Return its tendons."""
        tendons = self.ownership.release(token, now)
        for name in tendons:
            if self.drives[name].busy and self._motion_lease[name] == token:
                self.drives[name].cancel_motion("its owner released the lease; it holds where it is")
        return tendons

    def _refusal(self, names: Sequence[str], now: float, lease: str = "", *, homed: bool = True) -> str:
        unknown = [name for name in names if name not in self.drives]
        if unknown:
            return f"expected tendons out of {list(self.drives)}, found {unknown}"
        block = self._block()
        if block is not None:
            return block.text
        if homed:
            refusal = self.ownership.refusal(lease, names, now)
            if refusal:
                return refusal
        return "; ".join(text for name in names if (text := self.drives[name].refusal(homed=homed)))

    def _owned_refusal(self, names: Sequence[str], now: float) -> str:
        """Return why homing would disturb an owner: a tendon that moves or is taut for it.

        Slack ones may be homed, and released ones, whatever friction left in them.
        """
        for name in names:
            owner, drive = self.ownership.owner_of(name, now), self.drives[name]
            if owner and (drive.busy or (drive.holds_tension and not drive.is_released)):
                remedy = (
                    "release it first (tendon/release)"
                    if drive.homed
                    else f"without a zero it cannot be released slowly: have {owner} give its lease back "
                    "(tendon/lease_release), or switch the drives off (lifecycle: deactivate)"
                )
                return f"tendon '{name}' is owned by {owner} and taut or moving; {remedy}"
        return ""

    def _wrong(self, request: MoveRequest, names: Sequence[str], targets: Sequence[float]) -> str:
        if len(targets) != len(names):
            return f"expected one target or {len(names)}, found {len(targets)}"
        for name, target in zip(names, targets, strict=True):
            limits = self.drives[name].limits
            top, unit = (limits.travel, "m") if request.mode is MoveMode.LENGTH else (limits.tension_soft, "N")
            if not 0.0 <= target <= top:
                return f"tendon '{name}': expected a target between 0 and {top:g} {unit}, found {target:g} {unit}"
            if not 0.0 < request.speed <= limits.speed:
                return (
                    f"tendon '{name}': expected a speed above 0 and up to {limits.speed:g} m/s, "
                    f"found {request.speed:g} m/s"
                )
            limited = request.mode is MoveMode.LENGTH
            if limited and not 0.0 < request.tension_limit <= limits.tension_soft:
                return (
                    f"tendon '{name}': expected a tension limit above 0 and up to {limits.tension_soft:g} N, "
                    f"found {request.tension_limit:g} N"
                )
        return ""

    @staticmethod
    def _motion(request: MoveRequest, limits: TendonLimits, target: float) -> MotionFactory:
        if request.mode is MoveMode.LENGTH:
            return lambda view: MoveToLength(target, request.speed, request.tension_limit, view, limits)
        return lambda view: MoveToTension(target, request.speed, view, limits)

    @staticmethod
    def _release_motion(limits: TendonLimits) -> MotionFactory:
        return lambda view: MoveToLength(
            0.0, limits.release_speed, limits.tension_soft, view, limits, DriveState.RELEASING
        )


def _hold_here(view: DriveObservation, limits: TendonLimits) -> Motion:
    return Hold(view.pulled_length_m, limits.tension_soft)
