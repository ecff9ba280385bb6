# SPDX-License-Identifier: Apache-2.0
"""Between messages and the cell's values: the only place in this package that knows both."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from builtin_interfaces.msg import Time
from sensor_msgs.msg import JointState

from softgrip_cell.finger_records import FingerRecord
from softgrip_cell.gates import DriverFacts, FrictionFacts, SafetyFacts
from softgrip_cell.grasp.contact import ContactState
from softgrip_cell.grasp.reference import FreeReference
from softgrip_cell.grasp.sequence import GraspStep
from softgrip_cell.grasp.values import GraspEvidence, GraspOutcome, GraspPhase, GraspVerdict
from softgrip_cell.observation import FreeMotion, SeenTip, TendonFault, TendonSample
from softgrip_cell.outcomes import SuccessEstimate
from softgrip_cell.planner import PlannedOrder
from softgrip_cell.products import Product
from softgrip_cell.storage.journal import CountedGrasp, MountedSlot, SlotState, SwapOutcome
from softgrip_cell.swap.sequence import CONFIRMED_STEPS, HANDS_OUT, SwapStep
from softgrip_interfaces.action import Grasp, SwapFingers
from softgrip_interfaces.msg import (
    CellState,
    FingerEvidence,
    FingerRecordEntry,
    FingerStates,
    FrictionModel,
    GraspEntry,
    MountedFinger,
    PlanStep,
    ProductEntry,
    SafetyState,
    TendonStatus,
    TendonStatusArray,
)
from softgrip_interfaces.msg import GraspEvidence as EvidenceMessage
from softgrip_interfaces.srv import ConfirmStep
from softgrip_model.friction.acceptance import accept
from softgrip_model.friction.errors import FrictionError
from softgrip_nodekit import nanoseconds, to_time_message
from softgrip_time.units import to_s

_SLOT_STATES = {
    SlotState.UNKNOWN: MountedFinger.UNKNOWN,
    SlotState.TO_BE_VERIFIED: MountedFinger.TO_BE_VERIFIED,
    SlotState.VERIFIED: MountedFinger.VERIFIED,
}

_OUTCOMES = {
    GraspOutcome.GRIPPED: Grasp.Result.GRIPPED,
    GraspOutcome.EMPTY: Grasp.Result.EMPTY,
    GraspOutcome.SLIPPED: Grasp.Result.SLIPPED,
    GraspOutcome.TENDON_FAULT: Grasp.Result.TENDON_FAULT,
    GraspOutcome.ABORTED: Grasp.Result.ABORTED,
}

#: In Grasp.Feedback and GraspEvidence, whose constants are the same.
GRASP_PHASES = {
    GraspPhase.APPROACH: EvidenceMessage.APPROACH,
    GraspPhase.CLOSE: EvidenceMessage.CLOSE,
    GraspPhase.HOLD: EvidenceMessage.HOLD,
    GraspPhase.LIFT: EvidenceMessage.LIFT,
    GraspPhase.DONE: EvidenceMessage.UNSET,
}

#: In SwapFingers.Feedback.
SWAP_STEPS = {
    SwapStep.RELEASE: SwapFingers.Feedback.RELEASE,
    SwapStep.LOCK: SwapFingers.Feedback.LOCK,
    SwapStep.OPEN_PALM: SwapFingers.Feedback.OPEN_PALM,
    SwapStep.REMOVE: SwapFingers.Feedback.REMOVE,
    SwapStep.INSERT: SwapFingers.Feedback.INSERT,
    SwapStep.CLOSE_PALM: SwapFingers.Feedback.CLOSE_PALM,
    SwapStep.UNLOCK: SwapFingers.Feedback.UNLOCK,
    SwapStep.HOME: SwapFingers.Feedback.HOME,
    SwapStep.VERIFY: SwapFingers.Feedback.VERIFY,
}
#: In ConfirmStep, whose constants are the same.
CONFIRMATIONS = {
    **{step.value: number for step, number in SWAP_STEPS.items() if step in CONFIRMED_STEPS},
    HANDS_OUT: ConfirmStep.Request.HANDS_OUT,
}

_CONTACT_STATES = {
    ContactState.UNKNOWN: FingerEvidence.UNKNOWN,
    ContactState.FREE: FingerEvidence.FREE,
    ContactState.CONTACT: FingerEvidence.CONTACT,
    ContactState.BLOCKED: FingerEvidence.BLOCKED,
    ContactState.END_STOP: FingerEvidence.END_STOP,
}

#: Verdicts of friction models that may be used.
_USABLE = {FrictionModel.USABLE, FrictionModel.REPEAT_POINTS}


def tendon_sample(message: JointState, slots: Sequence[str]) -> TendonSample | None:
    """Return a tendon/state as a sample, None when a slot, a number or a column is missing, or one is not finite."""
    where = {name: index for index, name in enumerate(message.name)}
    if not len(where) == len(message.name) == len(message.position) == len(message.effort):
        return None
    try:
        pulled = tuple(float(message.position[where[slot]]) for slot in slots)
        tension = tuple(float(message.effort[where[slot]]) for slot in slots)
    except (KeyError, IndexError):
        return None
    if not all(map(math.isfinite, (*pulled, *tension))):
        return None
    return TendonSample(nanoseconds(message.header.stamp), pulled, tension)


def free_motion(message: FingerStates, slots: Sequence[str], profiles: Sequence[str]) -> FreeMotion:
    """Return a finger/predicted as free motion; whatever is wrong with it becomes its objection.

    Args:
        message: the prediction.
        slots: names, in slot order.
        profiles: profile id that each slot holds; a prediction for another one is objected to. Empty: not compared.
    """
    fingers = {finger.finger: finger for finger in message.fingers}
    missing = [slot for slot in slots if slot not in fingers]
    stamp_ns = nanoseconds(message.header.stamp)
    if missing:
        nothing = tuple(math.nan for _ in slots)
        tips = tuple((math.nan, math.nan) for _ in slots)
        objection = f"finger/predicted lacks {', '.join(missing)}"
        return FreeMotion(stamp_ns, nothing, nothing, tips, message.friction_model, objection, ("",) * len(slots))
    ordered = [fingers[slot] for slot in slots]
    objections = tuple(
        f"{finger.finger}: {finger.reason or 'no solution'}"
        if finger.validity == finger.FAILED or not all(map(math.isfinite, (finger.tension, finger.pulled_length)))
        else ""
        for finger in ordered
    )
    other_profiles = [
        f"{finger.finger}: expected a prediction of profile '{profile}', found '{finger.profile}'"
        for finger, profile in zip(ordered, profiles, strict=True)
        if profile and finger.profile != profile
    ]
    return FreeMotion(
        stamp_ns=stamp_ns,
        pulled_length_m=tuple(float(finger.pulled_length) for finger in ordered),
        tension_n=tuple(float(finger.tension) for finger in ordered),
        tip_m=tuple((float(finger.tip.x), float(finger.tip.y)) for finger in ordered),
        friction_model=message.friction_model,
        objection="; ".join(other_profiles),
        objections=objections,
        friction_digest=message.friction_digest,
    )


def seen_tips(message: FingerStates) -> list[SeenTip]:
    """Return the fingertips of a finger/measured that were seen."""
    return [
        SeenTip(
            stamp_ns=nanoseconds(message.header.stamp),
            slot=finger.finger,
            tip_m=(float(finger.tip.x), float(finger.tip.y)),
            stddev_m=float(max(finger.tip_stddev)),
        )
        for finger in message.fingers
        if finger.validity != finger.FAILED and math.isfinite(finger.tip.x) and math.isfinite(finger.tip.y)
    ]


def tendon_faults(message: TendonStatusArray, slots: Sequence[str]) -> list[TendonFault]:
    """Return what tendon/status says is wrong with the slots' tendons."""
    if message.estop:
        return [TendonFault("all", "estop", "the emergency stop is latched")]
    faults = [
        TendonFault(tendon.tendon, tendon.fault, tendon.reason)
        for tendon in message.tendons
        if tendon.tendon in slots and tendon.fault
    ]
    present = {tendon.tendon for tendon in message.tendons if tendon.state != TendonStatus.DISCONNECTED}
    faults += [
        TendonFault(slot, "disconnected", "tendon/status does not show it as connected")
        for slot in slots
        if slot not in present and slot not in {fault.tendon for fault in faults}
    ]
    return faults


def is_moving(message: TendonStatusArray | None, slots: Sequence[str]) -> bool:
    """Return whether a slot's tendon is on its way somewhere, whoever ordered it."""
    under_way = (TendonStatus.MOVING, TendonStatus.HOMING, TendonStatus.RELEASING)
    tendons = [] if message is None else message.tendons
    return any(tendon.tendon in slots and tendon.state in under_way for tendon in tendons)


def driver_facts(message: TendonStatusArray | None, slots: Sequence[str], *, fresh: bool) -> DriverFacts:
    """Return what a tendon/status means for the gates; None when none ever came."""
    if message is None:
        return DriverFacts(is_heard=False, estop=False)
    faults = tuple(f"{fault.tendon}: {fault.name}: {fault.reason}" for fault in tendon_faults(message, slots))
    unhomed = tuple(tendon.tendon for tendon in message.tendons if tendon.tendon in slots and not tendon.homed)
    return DriverFacts(is_heard=fresh, estop=bool(message.estop), faults=faults, unhomed=unhomed)


def friction_facts(message: FrictionModel, now_ns: int) -> FrictionFacts:
    """Return what a friction/active means for the gates."""
    try:
        digest, objection = accept(message).digest, ""
    except FrictionError as error:
        digest, objection = "", str(error)
    if message.verdict == FrictionModel.UNSET:
        objection = "expected a verdict, found none; calibrate (rig/calibrate)"
    elif message.verdict not in _USABLE:
        objection = f"it says so of itself: {message.reason}"
    return FrictionFacts(
        id=message.id,
        digest=digest,
        age_s=to_s(now_ns - nanoseconds(message.header.stamp)),
        tension_high_n=float(message.tension_range[1]),
        is_usable=not objection,
        reason=objection,
    )


def safety_facts(message: SafetyState) -> SafetyFacts:
    """Return what a safety/state means for the gates."""
    return SafetyFacts(
        is_heard=True,
        estop=bool(message.estop),
        estop_reason=message.estop_reason,
        locked=bool(message.locked),
        lock_owner=message.lock_owner,
        lock_reason=message.lock_reason,
    )


def mounted_fingers(slots: Sequence[MountedSlot]) -> list[MountedFinger]:
    """Return slots as messages."""
    return [
        MountedFinger(finger=slot.name, serial=slot.serial, profile=slot.profile, state=_SLOT_STATES[slot.state])
        for slot in slots
    ]


def plan_step(step: PlannedOrder) -> PlanStep:
    """Return one order of a plan as a message."""
    return PlanStep(
        order=step.index,
        product=step.order.product,
        finger_set=step.finger_set,
        swap_before=step.swap_before,
        expected_success=step.expected_success,
        predicted_time=step.predicted_time_s,
        reason=step.reason,
    )


def product_entry(product: Product, estimates: Mapping[str, SuccessEstimate]) -> ProductEntry:
    """Return a product with what is known of it as a message."""
    marks = [product.marks.get(name) for name in estimates]
    return ProductEntry(
        id=product.id,
        name=product.name,
        grasp=product.grasp.value,
        mass=product.mass_kg,
        finger_sets=list(estimates),
        table_marks=["" if mark is None else mark.value for mark in marks],
        expected_success=[one.mean for one in estimates.values()],
        grasps=[one.grasps for one in estimates.values()],
    )


def finger_record_entry(record: FingerRecord, check: Mapping[str, object] | None) -> FingerRecordEntry:
    """Return a finger record as a message; ``check`` is the document of its last check, None before the first."""
    reference = None if check is None else FreeReference.from_document(check)
    return FingerRecordEntry(
        serial=record.serial,
        profile=record.profile,
        finger=record.finger,
        printed=record.printed.isoformat(),
        material=record.material,
        cable=record.cable,
        state=record.state.value,
        cycles=record.cycles,
        cycle_limit=record.cycle_limit,
        calibrated=record.calibrated.isoformat() if record.calibrated else "",
        objection=record.objection() or "",
        check_lengths=list(reference.pulled_length_m) if reference else [],
        check_tensions=list(reference.tension_n) if reference else [],
    )


def grasp_entry(grasp: CountedGrasp) -> GraspEntry:
    """Return a counted grasp as a message."""
    return GraspEntry(
        stamp=to_time_message(grasp.at_ns),
        product=grasp.product,
        finger_set=grasp.finger_set,
        outcome=grasp.outcome,
        reason=grasp.reason,
        duration=grasp.duration_s,
        serials=list(grasp.serials),
        decision=grasp_evidence(grasp.evidence) if grasp.evidence else EvidenceMessage(),
    )


def grasp_evidence(evidence: GraspEvidence) -> EvidenceMessage:
    """Return the numbers behind a verdict as a message."""
    return EvidenceMessage(
        stamp=to_time_message(evidence.decided_ns),
        phase=GRASP_PHASES[evidence.phase],
        fingers=[
            FingerEvidence(
                finger=each.finger,
                state=_CONTACT_STATES[each.state],
                contact_tension=float(each.contact_tension_n),
                contact_tension_stddev=float(each.stddev_n),
                threshold=float(each.threshold_n),
                peak_contact_tension=float(each.peak_contact_tension_n),
                max_force=float(each.max_force_n),
                tip_deviation=math.nan if each.tip_deviation_m is None else float(each.tip_deviation_m),
            )
            for each in evidence.fingers
        ],
    )


def grasp_feedback(step: GraspStep, sample: TendonSample | None) -> Grasp.Feedback:
    """Return where a grasp stands; ``sample`` is the last one, None before the first."""
    return Grasp.Feedback(
        phase=GRASP_PHASES[step.phase],
        pulled_lengths=list(sample.pulled_length_m) if sample else [],
        tensions=list(sample.tension_n) if sample else [],
        contact=step.contact,
    )


def grasp_result(verdict: GraspVerdict, sample: TendonSample | None, duration_s: float) -> Grasp.Result:
    """Return how a grasp ended as an action result."""
    return Grasp.Result(
        outcome=_OUTCOMES[verdict.outcome],
        reason=verdict.reason,
        decision=grasp_evidence(verdict.evidence) if verdict.evidence else EvidenceMessage(),
        latency=float(verdict.latency_s),
        duration=float(duration_s),
        pulled_lengths=list(sample.pulled_length_m) if sample else [],
        tensions=list(sample.tension_n) if sample else [],
    )


def swap_step(message: SwapFingers.Feedback) -> SwapStep:
    """Return the step of a swap that a feedback tells of.

    Raises:
        ValueError: its number is none of a step.
    """
    try:
        return next(step for step, number in SWAP_STEPS.items() if number == message.step)
    except StopIteration:
        raise ValueError(f"expected the number of a step of SwapFingers, found {message.step}") from None


def confirmed_step(request: ConfirmStep.Request) -> str:
    """Return what a person confirms: a value of SwapStep, or HANDS_OUT; "number 42" where it is neither."""
    named = (name for name, number in CONFIRMATIONS.items() if number == request.step)
    return next(named, f"number {request.step}")


def swap_result(
    outcome: SwapOutcome, reason: str, slots: Sequence[MountedSlot], duration_s: float
) -> SwapFingers.Result:
    """Return how a swap ended as an action result."""
    return SwapFingers.Result(
        outcome=outcome,
        reason=reason,
        mounted=mounted_fingers(slots),
        duration=float(duration_s),
    )


def cell_state(stamp: Time, mode: int, slots: Sequence[MountedSlot], numbers: Mapping[str, Any]) -> CellState:
    """Return the cell's state as a message; ``numbers`` holds its remaining fields by name."""
    message = CellState(mode=mode, mounted=mounted_fingers(slots), **numbers)
    message.header.stamp = stamp
    return message
