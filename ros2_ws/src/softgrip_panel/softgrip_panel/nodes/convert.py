# SPDX-License-Identifier: Apache-2.0
"""Between messages and the panel's values: the only place in this package that knows both."""

from __future__ import annotations

import importlib
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, ParameterValue
from sensor_msgs.msg import JointState

from softgrip_interfaces import msg as messages
from softgrip_interfaces.action import CalibrateFriction, Grasp, MoveTendon, SwapFingers
from softgrip_interfaces.msg import (
    CellState,
    FingerEvidence,
    FingerStates,
    FrictionModel,
    FrictionSample,
    GraspEvidence,
    MountedFinger,
    PredictedShape,
    PredictionResidual,
    SafetyState,
    TendonOwners,
    TendonStatus,
    TendonStatusArray,
)
from softgrip_interfaces.srv import ConfirmStep, ListFingers, ListFrictionModels, ListGrasps, ListProducts
from softgrip_model.friction.acceptance import accept
from softgrip_model.friction.errors import LawError
from softgrip_nodekit import seconds
from softgrip_panel.model.facts import (
    CellView,
    ComponentHealth,
    CountedView,
    FingerDecision,
    FingerRecordView,
    FingerView,
    MountedView,
    OwnerView,
    ProductView,
    ResidualView,
    SafetyView,
    TendonView,
    TensionView,
)
from softgrip_panel.model.friction import MAX_POINTS, FrictionModelView, RigPoint, RigProgress, intervals
from softgrip_panel.model.parameters import ParameterKind, ParameterView
from softgrip_panel.model.shapes import MAX_NODES, PanelShape
from softgrip_panel.model.swap import SwapPhase, SwapView

#: Bounds of a parameter beyond this are none: the largest double, or whole number, stands for them.
NO_BOUND = 9.2e18
DAY_S = 86400.0


def _names(kind: type[object], *names: str) -> dict[int, str]:
    """Return number -> name of constants of a message."""
    return {int(getattr(kind, name)): name for name in names}


MODES = _names(CellState, "UNKNOWN", "IDLE", "SWAPPING", "GRASPING", "HOLDING", "FAULT", "ESTOP")
SLOT_STATES = {
    MountedFinger.UNKNOWN: "unknown",
    MountedFinger.EMPTY: "empty",
    MountedFinger.TO_BE_VERIFIED: "to be verified",
    MountedFinger.VERIFIED: "verified",
}
TENDON_STATES = _names(
    TendonStatus, "DISCONNECTED", "IDENTIFIED", "HOLDING", "MOVING", "HOMING", "RELEASING", "STOPPED"
)
MOVE_OUTCOMES = _names(
    MoveTendon.Result, "UNSET", "REACHED", "TENSION_LIMIT", "TIMEOUT", "CANCELLED", "FAULT", "REFUSED"
)
GRASP_OUTCOMES = _names(Grasp.Result, "GRIPPED", "EMPTY", "SLIPPED", "TENDON_FAULT", "ABORTED")
SWAP_OUTCOMES = _names(SwapFingers.Result, "SUCCEEDED", "CANCELLED", "REFUSED", "FAILED")
SWAP_STEPS = {
    number: name.lower()
    for number, name in _names(
        SwapFingers.Feedback,
        "RELEASE", "LOCK", "OPEN_PALM", "REMOVE", "INSERT", "CLOSE_PALM", "UNLOCK", "HOME", "VERIFY",
    ).items()
}  # fmt: skip
RESIDUAL_VERDICTS = _names(PredictionResidual, "UNSET", "OK", "WATCH", "RECALIBRATE", "WORN")
SAMPLE_VERDICTS = _names(FrictionSample, "UNSET", "ACCEPTED", "REPEAT", "REJECTED")
MODEL_VERDICTS = _names(FrictionModel, "UNSET", "USABLE", "REPEAT_POINTS", "DO_NOT_USE")
RIG_OUTCOMES = _names(CalibrateFriction.Result, "SUCCEEDED", "CANCELLED", "FAILED")
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


def health_views(message: DiagnosticArray) -> list[ComponentHealth]:
    """Return a /diagnostics."""
    # the level is one byte: bytes of length 1 in rclpy
    return [
        ComponentHealth(
            one.name,
            one.level[0] if isinstance(one.level, bytes) else int(one.level),
            one.message,
            {pair.key: pair.value for pair in one.values},
        )
        for one in message.status
    ]


def grasp_decision(decision: GraspEvidence) -> tuple[FingerDecision, ...]:
    """Return what the verdict of a grasp knew of each finger."""
    return tuple(
        FingerDecision(one.finger, CONTACT_STATES.get(one.state, "?"), float(one.contact_tension), float(one.threshold))
        for one in decision.fingers
    )


def decided_stamp_s(decision: GraspEvidence) -> float:
    """Return the stamp of the tendon/state that decided [s]; NaN when none did."""
    return seconds(decision.stamp) or math.nan


def finger_views(message: FingerStates) -> tuple[FingerView, ...]:
    """Return joints, rounded to a degree's tenth: a resting finger changes nothing."""
    return tuple(
        FingerView(one.finger, tuple(round(float(angle), 3) for angle in one.joint_angles)) for one in message.fingers
    )


def residual_view(message: PredictionResidual) -> ResidualView:
    """Return finger/residual."""
    return ResidualView(
        message.finger,
        float(message.tip_error),
        float(message.tip_error_percent),
        float(message.cusum_friction),
        float(message.cusum_stiffness),
        RESIDUAL_VERDICTS.get(message.verdict, "?"),
        message.reason,
    )


def shape_view(message: PredictedShape, number: int) -> PanelShape | None:
    """Return shape/predicted, None where it is no mesh that a browser could show."""
    vertices = np.asarray(message.vertices, dtype="<f4")
    faces = np.asarray(message.faces, dtype=np.uint32)
    nodes = len(vertices) // 3
    if not 0 < nodes <= MAX_NODES or len(vertices) % 3 or len(faces) % 4 or (len(faces) and faces.max() >= nodes):
        return None
    strain = np.asarray(message.strain, dtype="<f4").tobytes()
    return PanelShape(
        number,
        message.finger,
        message.mesh,
        vertices.tobytes(),
        faces,
        strain,
        bool(message.converged),
        float(message.pulled_length),
        float(message.rate),
        message.reason,
    )


def rig_point(message: FrictionSample) -> RigPoint:
    """Return one judged attempt."""
    return RigPoint(
        int(message.index),
        float(message.angle),
        float(message.load),
        float(message.tension_low),
        float(message.tension_high),
        float(message.tension_high_stddev),
        SAMPLE_VERDICTS.get(message.verdict, "?"),
        message.reason,
    )


def rig_progress(message: messages.RigProgress) -> RigProgress:
    """Return rig/progress."""
    outcome = RIG_OUTCOMES.get(message.outcome, "")
    return RigProgress(
        is_running=bool(message.running),
        needs_confirmation=bool(message.confirmation),
        index=int(message.index),
        total=int(message.total),
        angle_rad=float(message.angle),
        load_kg=float(message.load),
        instruction=message.instruction,
        points=tuple(rig_point(one) for one in message.samples[-MAX_POINTS:]),
        message=f"{outcome}: {message.reason}" if outcome else message.reason,
        fitted=message.model,
    )


def swap_progress(message: messages.SwapProgress, ahead_s: float) -> SwapView:
    """Return cell/swap_progress.

    Args:
        message: of the manager.
        ahead_s: by how much this machine's clock is ahead of the cell's [s].
    """
    is_locked = message.step == ConfirmStep.Request.HANDS_OUT
    goal_id = bytes(bytearray(message.goal_id))
    if message.running:
        phase = SwapPhase.RUNNING
    elif is_locked:
        phase = SwapPhase.HANDS_INSIDE
    else:
        phase = SwapPhase.ENDED if message.outcome else SwapPhase.NONE
    since_s = seconds(message.since)
    return SwapView(
        phase,
        message.finger_set,
        SWAP_STEPS.get(message.step, ""),
        message.instruction,
        bool(message.confirmation),
        started_s=since_s + ahead_s if since_s else math.nan,
        success=SWAP_OUTCOMES.get(message.outcome) == "SUCCEEDED",
        message=message.reason,
        goal_id=goal_id.hex() if any(goal_id) else "",
    )


def friction_model_views(response: ListFrictionModels.Response) -> tuple[FrictionModelView, ...]:
    """Return the models of ListFrictionModels."""
    return tuple(
        _friction_model_view(one, float(age), one.id == response.active)
        for one, age in zip(response.models, response.ages, strict=False)
    )


def _friction_model_view(message: FrictionModel, age_s: float, is_active: bool) -> FrictionModelView:
    freedom = int(message.degrees_of_freedom)
    try:
        accepted = accept(message)
    except LawError:
        accepted = None
    covariance = accepted.covariance if accepted else None
    return FrictionModelView(
        message.id,
        message.law,
        intervals(
            message.coefficient_names, list(map(float, message.coefficients)), list(map(float, message.covariance)),
            freedom,
        ),
        float(message.average_error),
        float(message.maximum_error),
        int(message.points),
        DAY_S * (age_s // DAY_S),  # shown in days: a list that is another one each time is drawn again each time
        MODEL_VERDICTS.get(message.verdict, "?"),
        message.reason,
        is_active,
        message.cable,
        message.surface,
        accepted.law if accepted else None,
        () if covariance is None else tuple(float(one) for one in covariance.ravel()),
        freedom,
    )  # fmt: skip


def product_views(response: ListProducts.Response) -> tuple[ProductView, ...]:
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


def finger_record_views(response: ListFingers.Response) -> tuple[FingerRecordView, ...]:
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


def counted_views(response: ListGrasps.Response) -> tuple[CountedView, ...]:
    """Return the grasps of ListGrasps."""
    return tuple(
        CountedView(
            seconds(one.stamp),
            one.product,
            one.finger_set,
            one.outcome,
            one.reason,
            float(one.duration),
            tuple(one.serials),
            decided_stamp_s(one.decision),
            grasp_decision(one.decision),
        )
        for one in response.grasps
    )


def parameter_view(descriptor: ParameterDescriptor, value: ParameterValue) -> ParameterView:
    """Return a parameter by rcl_interfaces' descriptor and value."""
    kind = ParameterKind(value.type)
    found: Any = None if kind is ParameterKind.NOT_SET else getattr(value, kind.field)
    if kind is ParameterKind.BYTES:
        found = [int.from_bytes(one) for one in found]
    ranges: list[FloatingPointRange | IntegerRange] = [*descriptor.floating_point_range, *descriptor.integer_range]
    low, high = (ranges[0].from_value, ranges[0].to_value) if ranges else (-math.inf, math.inf)
    return ParameterView(
        descriptor.name,
        kind,
        list(found) if kind >= ParameterKind.BYTES else found,
        descriptor.description,
        -math.inf if low <= -NO_BOUND else float(low),
        math.inf if high >= NO_BOUND else float(high),
        descriptor.additional_constraints,
        not descriptor.read_only and kind is not ParameterKind.NOT_SET and kind is not ParameterKind.BYTES,
    )


def answer_of(response: object) -> tuple[bool, str]:
    """Return whether a service did what it was asked for, and its words."""
    if hasattr(response, "results"):  # of SetParameters
        return all(one.successful for one in response.results), "; ".join(
            filter(None, (r.reason for r in response.results))
        )
    message = getattr(response, "message", getattr(response, "status_message", ""))
    return bool(getattr(response, "success", True)), str(message)


def request_message(kind: Any, fields: Mapping[str, Any]) -> Any:
    """Return a request with its fields; a mapping is a message of its own."""
    return _filled(kind(), fields)


def _filled(message: Any, fields: Mapping[str, Any]) -> Any:
    types = message.get_fields_and_field_types()
    for name, value in fields.items():
        setattr(message, name, _field(types[name], value))
    return message


def _field(type_name: str, value: Any) -> Any:
    """Return a field's value; `type_name` as "rcl_interfaces/Parameter" or "sequence<rcl_interfaces/Parameter>"."""
    if isinstance(value, Mapping):
        package, _, name = type_name.partition("/")
        return _filled(ros_type(f"{package}/msg/{name}")(), value)
    if isinstance(value, list) and value and isinstance(value[0], Mapping):
        return [_field(type_name.removeprefix("sequence<").removesuffix(">"), one) for one in value]
    return value
