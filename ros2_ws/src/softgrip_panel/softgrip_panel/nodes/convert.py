# SPDX-License-Identifier: Apache-2.0
"""Between messages and the panel's values: the only place in this package that knows both."""

from __future__ import annotations

import importlib
import math
from collections.abc import Mapping
from typing import Any

from sensor_msgs.msg import JointState

from softgrip_interfaces.action import Grasp, SwapFingers
from softgrip_interfaces.msg import (
    CellState,
    FingerEvidence,
    FingerStates,
    MountedFinger,
    SafetyState,
    TendonOwners,
    TendonStatus,
    TendonStatusArray,
)
from softgrip_panel.model.facts import (
    CellView,
    ComponentHealth,
    CountedView,
    FingerRecordView,
    MountedView,
    OwnerView,
    ProductView,
    SafetyView,
    TendonView,
    TensionView,
)
from softgrip_panel.model.grasps import FingerDecision


def _names(kind: Any, *names: str) -> dict[int, str]:
    """Return number -> name of constants of a message."""
    return {int(getattr(kind, name)): name for name in names}


MODES = _names(CellState, "UNKNOWN", "IDLE", "SWAPPING", "GRASPING", "HOLDING", "CALIBRATING", "FAULT", "ESTOP")
SLOT_STATES = {
    MountedFinger.UNKNOWN: "unknown",
    MountedFinger.EMPTY: "empty",
    MountedFinger.TO_BE_VERIFIED: "to be verified",
    MountedFinger.VERIFIED: "verified",
}
TENDON_STATES = _names(
    TendonStatus, "DISCONNECTED", "IDENTIFIED", "HOLDING", "MOVING", "HOMING", "RELEASING", "STOPPED"
)
GRASP_OUTCOMES = _names(Grasp.Result, "GRIPPED", "EMPTY", "SLIPPED", "TENDON_FAULT", "ABORTED")
SWAP_OUTCOMES = _names(SwapFingers.Result, "SUCCEEDED", "CANCELLED", "REFUSED", "FAILED")
CONTACT_STATES = _names(FingerEvidence, "UNKNOWN", "FREE", "CONTACT", "BLOCKED", "END_STOP")


def ros_type(type_name: str) -> Any:
    """Return the class of a type as `ros2` writes it, such as "std_srvs/srv/Trigger"."""
    package, kind, name = type_name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), name)


def cell_view(message: CellState) -> CellView:
    """Return cell/state."""
    return CellView(
        mode=MODES.get(message.mode, "UNKNOWN"),
        finger_set=message.finger_set,
        mounted=tuple(
            MountedView(one.finger, one.serial, one.profile, SLOT_STATES.get(one.state, "unknown"))
            for one in message.mounted
        ),
        product=message.product,
        picks=int(message.picks),
        gripped=int(message.gripped),
        empty=int(message.empty),
        slipped=int(message.slipped),
        tendon_faults=int(message.tendon_faults),
        aborted=int(message.aborted),
        swaps=int(message.swaps),
        mean_swap_s=float(message.mean_swap_time),
        availability=float(message.availability),
        fault=message.fault,
        reason=message.reason,
    )


def safety_view(message: SafetyState) -> SafetyView:
    """Return safety/state."""
    return SafetyView(
        bool(message.estop), message.estop_reason, bool(message.locked), message.lock_owner, message.lock_reason
    )


def tendon_views(message: TendonStatusArray) -> list[TendonView]:
    """Return tendon/status."""
    return [
        TendonView(
            one.tendon,
            TENDON_STATES.get(one.state, str(one.state)),
            bool(one.homed),
            one.fault,
            one.reason,
            float(one.temperature),
            float(one.voltage),
        )
        for one in message.tendons
    ]


def owner_views(message: TendonOwners) -> tuple[OwnerView, ...]:
    """Return tendon/owners."""
    return tuple(OwnerView(one.tendon, one.owner, one.requested_by) for one in message.owners)


def tension_views(state: JointState, predicted: FingerStates | None) -> list[TensionView]:
    """Return tendon/state beside what was predicted last."""
    free = {} if predicted is None else {one.finger: float(one.tension) for one in predicted.fingers}
    columns = zip(state.name, state.position, state.effort, strict=False)
    return [
        TensionView(name, float(position), float(effort), free.get(name, math.nan))
        for name, position, effort in columns
    ]


def health_views(message: Any) -> list[ComponentHealth]:
    """Return a /diagnostics."""
    # the level is one byte: bytes of length 1 in rclpy
    return [
        ComponentHealth(one.name, one.level[0] if isinstance(one.level, bytes) else int(one.level), one.message)
        for one in message.status
    ]


def grasp_decision(result: Any) -> tuple[FingerDecision, ...]:
    """Return what the verdict of a grasp knew of each finger."""
    return tuple(
        FingerDecision(one.finger, CONTACT_STATES.get(one.state, "?"), float(one.contact_tension), float(one.threshold))
        for one in result.decision.fingers
    )


def product_views(response: Any) -> tuple[ProductView, ...]:
    """Return the products of ListProducts."""
    return tuple(
        ProductView(
            one.id,
            one.name,
            one.grasp,
            float(one.mass),
            dict(zip(one.finger_sets, one.table_marks, strict=False)),
            dict(zip(one.finger_sets, map(float, one.expected_success), strict=False)),
            dict(zip(one.finger_sets, map(int, one.grasps), strict=False)),
        )
        for one in response.products
    )


def finger_record_views(response: Any) -> tuple[FingerRecordView, ...]:
    """Return the fingers of ListFingers."""
    return tuple(
        FingerRecordView(
            one.serial,
            one.profile,
            one.finger,
            one.printed,
            one.material,
            one.cable,
            one.state,
            int(one.cycles),
            int(one.cycle_limit),
            one.calibrated,
            one.objection,
            tuple(zip(map(float, one.check_lengths), map(float, one.check_tensions), strict=False)),
        )
        for one in response.fingers
    )


def counted_views(response: Any) -> tuple[CountedView, ...]:
    """Return the grasps of ListGrasps."""
    return tuple(
        CountedView(
            one.stamp.sec + one.stamp.nanosec * 1e-9,
            one.product,
            one.finger_set,
            one.outcome,
            one.reason,
            float(one.duration),
        )
        for one in response.grasps
    )


def request_message(kind: Any, fields: Mapping[str, Any]) -> Any:
    """Return a request with its fields."""
    return kind(**dict(fields))
