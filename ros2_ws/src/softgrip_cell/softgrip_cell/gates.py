# SPDX-License-Identifier: Apache-2.0
"""What has to be true before the cell may grasp or swap; every refusal says what was expected and what was found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from softgrip_cell.errors import RefusedError
from softgrip_cell.finger_records import FingerRecord
from softgrip_cell.grasp.reference import FreeReference
from softgrip_cell.products import FingerSet, Product, ProductSurface, TableMark
from softgrip_cell.storage.journal import MountedSlot, SlotState


@dataclass(frozen=True)
class FrictionFacts:
    """What matters of the active friction model.

    Attributes:
        digest: of its numbers; what models are compared by.
        age_s: since its fit [s].
        tension_high_n: upper end of its calibrated range [N].
        is_usable: its own verdict allows use, and its numbers can be true.
        reason: why not, or what its verdict adds.
    """

    id: str
    digest: str
    age_s: float
    tension_high_n: float
    is_usable: bool
    reason: str


@dataclass(frozen=True)
class FrictionLimits:
    """How far a friction model is trusted.

    Attributes:
        age_s: oldest fit that is used [s].
        range_factor: how many times the calibrated tension a finger may need.
    """

    age_s: float
    range_factor: float


@dataclass(frozen=True)
class DriverFacts:
    """What the driver says now.

    Attributes:
        is_heard: tendon/state and tendon/status are coming in.
        estop: the emergency stop is latched.
        faults: in words, one per tendon that has any.
        unhomed: tendons whose zero is not known.
    """

    is_heard: bool
    estop: bool
    faults: tuple[str, ...] = ()
    unhomed: tuple[str, ...] = ()


@dataclass(frozen=True)
class SafetyFacts:
    """What safety/state says; a cell that has heard none does not move.

    Attributes:
        is_heard: there was one.
        estop: the emergency stop is latched.
        estop_reason: who or what stopped.
        locked: somebody's hands are in the cell.
        lock_owner: whose lock it is.
        lock_reason: what it is for.
    """

    is_heard: bool
    estop: bool = False
    estop_reason: str = ""
    locked: bool = False
    lock_owner: str = ""
    lock_reason: str = ""

    @property
    def lock_text(self) -> str:
        """Who locked the drives and what for, empty when nobody did."""
        return f"the drives are locked by '{self.lock_owner}': {self.lock_reason}" if self.locked else ""


GRAVITY_M_PER_S2: Final = 9.81

#: The arm accelerates: the product weighs this much more than at rest.
DYNAMIC_LOAD_FACTOR: Final = 1.15

#: Friction of printed TPU on a surface [1], low values of rough classes.
FRICTION: Final = {
    ProductSurface.SMOOTH: 0.5,
    ProductSurface.DIMPLED: 0.6,
    ProductSurface.RUGGED: 0.7,
    ProductSurface.FILM: 0.3,
    ProductSurface.FROST: 0.15,
}

#: Contact force per contact tension [1]. By virtual work it is dL/ds: a fingertip goes four to five times the pulled
#: length (profiles of the three sets); friction in the finger keeps a fifth of the rest.
FORCE_PER_CONTACT_TENSION: Final = 0.8 / 4.5

#: Fingers that press.
FINGERS: Final = 3


def carried_kg(product: Product, finger_set: str) -> float:
    """Return the mass that friction carries when every finger presses as the recipe asks [kg]."""
    pressing_n = FINGERS * product.recipe_for(finger_set).hold_contact_tension_n * FORCE_PER_CONTACT_TENSION
    return FRICTION[product.surface] * pressing_n / (DYNAMIC_LOAD_FACTOR * GRAVITY_M_PER_S2)


def check_safety(safety: SafetyFacts) -> None:
    """Refuse when nothing may move.

    Raises:
        RefusedError: with the reason.
    """
    if not safety.is_heard:
        raise RefusedError("expected safety/state, found none; nothing moves before; start or check tendon_driver")
    if safety.estop:
        why = f" ({safety.estop_reason})" if safety.estop_reason else ""
        raise RefusedError(f"the emergency stop is latched{why}; clear the cause, then call estop_reset")
    if safety.locked:
        raise RefusedError(f"{safety.lock_text}; wait until the owner releases them (tendon/unlock)")


def check_driver(driver: DriverFacts, *, homed: bool) -> None:
    """Refuse when the driver cannot move safely.

    Raises:
        RefusedError: with the reason.
    """
    if driver.estop:
        raise RefusedError("the emergency stop is latched; clear the cause, then call estop_reset")
    if not driver.is_heard:
        raise RefusedError("expected tendon/state and tendon/status, found silence; start or check tendon_driver")
    if driver.faults:
        raise RefusedError("the driver has a fault: " + "; ".join(driver.faults))
    if homed and driver.unhomed:
        raise RefusedError(f"tendons {', '.join(driver.unhomed)} are not homed; call tendon/home")


def check_friction(
    friction: FrictionFacts | None, limits: FrictionLimits, references: Sequence[FreeReference], pull_m: float
) -> None:
    """Refuse when free motion cannot be predicted well enough.

    Raises:
        RefusedError: with the reason.
    """
    if friction is None:
        raise RefusedError("no friction model is active; calibrate (rig/calibrate) or activate one (friction/activate)")
    if not friction.is_usable:
        raise RefusedError(f"friction model '{friction.id}' is not to be used: {friction.reason}")
    if friction.age_s > limits.age_s:
        raise RefusedError(
            f"friction model '{friction.id}' is {friction.age_s / 86400:.1f} days old, the limit is "
            f"{limits.age_s / 86400:.1f} days; calibrate again (rig/calibrate)"
        )
    for reference in references:
        if reference.friction_digest != friction.digest:
            raise RefusedError(
                f"the fingers were checked with {_model(reference.friction_model, reference.friction_digest)}, active "
                f"is {_model(friction.id, friction.digest)}; check them again (cell/swap with the same set)"
            )
        needed_n, allowed_n = reference.tension(pull_m), limits.range_factor * friction.tension_high_n
        if needed_n > allowed_n:
            raise RefusedError(
                f"closing to {pull_m * 1e3:.1f} mm needs {needed_n:.1f} N; friction model '{friction.id}' is trusted "
                f"up to {allowed_n:.1f} N; calibrate with a heavier weight"
            )


def _model(name: str, digest: str) -> str:
    """Name a friction model so that two of the same id are told apart."""
    return f"friction model '{name}' with digest {digest[:12] or 'unknown'}"


def check_finger_records(
    slots: Sequence[MountedSlot], finger_records: Mapping[str, FingerRecord], worn: Mapping[str, str]
) -> None:
    """Refuse when a mounted finger may not be used any more.

    Args:
        slots: what is mounted.
        finger_records: every known finger, by serial.
        worn: why fingers were found worn in this run, by serial.

    Raises:
        RefusedError: with the reason.
    """
    for slot in slots:
        finger_record = finger_records.get(slot.serial)
        objection = finger_record.objection() if finger_record is not None else None
        if objection is not None:
            why = f" ({worn[slot.serial]})" if slot.serial in worn else ""
            raise RefusedError(f"slot {slot.name}: {objection}{why}; swap it (cell/swap)")


def mounted_set(slots: Sequence[MountedSlot], finger_sets: Sequence[FingerSet]) -> FingerSet | None:
    """Return the set whose profile is in every slot, None when mixed or unknown."""
    if any(slot.state not in (SlotState.TO_BE_VERIFIED, SlotState.VERIFIED) for slot in slots):
        return None
    profiles = {slot.profile for slot in slots}
    return next((item for item in finger_sets if profiles == {item.profile}), None)


def check_fingers(
    slots: Sequence[MountedSlot],
    mounted: FingerSet | None,
    product: Product,
    mark: TableMark,
    *,
    trial: bool,
    confirm_lift: bool,
) -> FingerSet:
    """Refuse when the fingers in the slots are not known, not verified, or not up to the product.

    Args:
        slots: what is mounted.
        mounted: the set in all slots.
        product: what is to be grasped.
        mark: what table and counted grasps say of that set and the product; FAILURE where nothing is known.
        trial: grasp although the table says that it fails.
        confirm_lift: the lift will show whether it holds; without, that has to be known.

    Returns:
        the set in the slots.

    Raises:
        RefusedError: with the reason.
    """
    for slot in slots:
        if slot.state is not SlotState.VERIFIED:
            raise RefusedError(f"slot {slot.name} is {slot.state.value}; run cell/swap to have the fingers checked")
    if mounted is None:
        found = ", ".join(f"{slot.name} {slot.profile or 'nothing'}" for slot in slots)
        raise RefusedError(f"expected one finger set in all slots, found {found}; run cell/swap")
    if not trial and product.marks.get(mounted.id) is TableMark.FAILURE:
        raise RefusedError(f"finger set '{mounted.id}' does not hold '{product.id}'; call cell/select_product and swap")
    if not confirm_lift and mark is not TableMark.SUCCESS:
        raise RefusedError(
            f"finger set '{mounted.id}' is not known to hold '{product.id}' (table and counted grasps say: "
            f"{mark.value}); only a lift can tell: grasp with confirm_lift"
        )
    if not confirm_lift and (carried := carried_kg(product, mounted.id)) < product.mass_kg:
        raise RefusedError(
            f"'{product.id}' weighs {product.mass_kg:g} kg; pressed as its recipe asks with finger set '{mounted.id}', "
            f"friction carries {carried:.2f} kg; only a lift can tell: grasp with confirm_lift"
        )
    return mounted
