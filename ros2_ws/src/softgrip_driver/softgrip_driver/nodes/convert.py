# SPDX-License-Identifier: Apache-2.0
"""Between this package's values and messages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from builtin_interfaces.msg import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory

from softgrip_driver.errors import ConfigurationError
from softgrip_driver.tendon.gripper import MoveMode, MoveRequest
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.loop import LoopSnapshot
from softgrip_driver.tendon.ownership import OwnerRow
from softgrip_driver.tendon.safety_store import SafetyRecord
from softgrip_driver.tendon.status import DriveSnapshot
from softgrip_driver.tendon.trajectory import MAX_POINTS, TendonTrajectory
from softgrip_interfaces.action import MoveTendon
from softgrip_interfaces.msg import SafetyState, TendonOwner, TendonOwners, TendonStatus, TendonStatusArray
from softgrip_nodekit import seconds


def to_joint_state(drives: Sequence[DriveSnapshot], stamp: Time) -> JointState:
    """Return tendon/state: pulled lengths [m], speeds [m/s], tensions [N]."""
    return JointState(
        header=Header(stamp=stamp),
        name=[drive.tendon for drive in drives],
        position=[float(drive.pulled_length_m) for drive in drives],
        velocity=[float(drive.speed) for drive in drives],
        effort=[float(drive.tension) for drive in drives],
    )


def to_status(snapshot: LoopSnapshot, stamp: Time) -> TendonStatusArray:
    """Return tendon/status."""
    return TendonStatusArray(
        header=Header(stamp=stamp),
        tendons=[_to_tendon_status(drive) for drive in snapshot.drives],
        loop_rate=float(snapshot.rate),
        loop_jitter_p99=float(snapshot.jitter_p99),
        missed_cycles=int(snapshot.missed_cycles),
        estop=bool(snapshot.estop),
    )


def _to_tendon_status(drive: DriveSnapshot) -> TendonStatus:
    return TendonStatus(
        tendon=drive.tendon,
        state=int(drive.state),
        homed=bool(drive.homed),
        fault=drive.fault,
        reason=drive.fault_reason or "; ".join(drive.warnings),
        current=float(drive.current),
        temperature=float(drive.temperature),
        voltage=float(drive.voltage),
        tension_stddev=float(drive.tension_stddev),
        lost_replies=int(drive.lost_replies),
        hardware_error=int(drive.hardware_error),
    )


def to_safety_state(record: SafetyRecord, stamp: Time) -> SafetyState:
    """Return safety/state."""
    return SafetyState(
        header=Header(stamp=stamp),
        sequence=record.sequence,
        estop=record.is_stopped,
        estop_reason=record.stop_reason,
        locked=record.is_locked,
        lock_owner=record.lock_owner,
        lock_reason=record.lock_reason,
    )


def to_owners(rows: Sequence[OwnerRow], stamp: Time) -> TendonOwners:
    """Return tendon/owners."""
    return TendonOwners(
        header=Header(stamp=stamp),
        owners=[
            TendonOwner(tendon=row.tendon, owner=row.owner, duration=row.duration_s, requested_by=row.requested_by)
            for row in rows
        ],
    )


def from_move_goal(goal: MoveTendon.Goal, deadline_s: float) -> MoveRequest:
    """Return the request of an action goal.

    Args:
        goal: as it came.
        deadline_s: [s] its deadline, by the loop's clock.

    Raises:
        ConfigurationError: a mode that there is not.
    """
    try:
        mode = MoveMode(goal.mode)
    except ValueError as error:
        raise ConfigurationError(
            f"mode: expected {[f'{m.value} {m.name}' for m in MoveMode]}, found {goal.mode}"
        ) from error
    return MoveRequest(
        list(goal.tendons), mode, list(goal.targets), goal.speed, goal.tension_limit, goal.lease, deadline_s
    )


def to_move_feedback(drives: Sequence[DriveSnapshot]) -> MoveTendon.Feedback:
    """Return lengths [m] and tensions [N] of a move under way."""
    return MoveTendon.Feedback(
        tendons=[drive.tendon for drive in drives],
        pulled_lengths=[float(drive.pulled_length_m) for drive in drives],
        tensions=[float(drive.tension) for drive in drives],
    )


def to_move_result(outcome: int, reason: str, drives: Sequence[DriveSnapshot]) -> MoveTendon.Result:
    """Return how a move ended."""
    return MoveTendon.Result(
        outcome=int(outcome),
        reason=reason,
        tendons=[drive.tendon for drive in drives],
        pulled_lengths=[float(drive.pulled_length_m) for drive in drives],
        tensions=[float(drive.tension) for drive in drives],
    )


def from_trajectory(message: JointTrajectory, limits: Mapping[str, TendonLimits]) -> dict[str, TendonTrajectory]:
    """Return one trajectory for each tendon named.

    Args:
        message: pulled lengths [m], optionally speeds [m/s].
        limits: by tendon.

    Raises:
        ConfigurationError: unknown or repeated tendons, or points that do not fit.
    """
    names = list(message.joint_names)
    unknown = [name for name in names if name not in limits]
    if not names or unknown or len(set(names)) != len(names):
        raise ConfigurationError(f"trajectory: expected tendons out of {sorted(limits)}, each once, found {names[:8]}")
    if len(message.points) > MAX_POINTS:
        raise ConfigurationError(
            f"trajectory: expected at most {MAX_POINTS} points, found {len(message.points)}; stream it"
        )
    counts = {len(point.positions) for point in message.points} | {len(names)}
    if len(counts) > 1:
        raise ConfigurationError(
            f"trajectory: expected {len(names)} positions in every point, found {sorted(counts - {len(names)})}"
        )
    times = [seconds(point.time_from_start) for point in message.points]
    with_speeds = bool(message.points) and all(len(point.velocities) == len(names) for point in message.points)
    return {
        name: TendonTrajectory.checked(
            times,
            [point.positions[index] for point in message.points],
            [point.velocities[index] for point in message.points] if with_speeds else [],
            limits[name].travel,
            limits[name].speed,
        )
        for index, name in enumerate(names)
    }
