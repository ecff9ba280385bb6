# SPDX-License-Identifier: Apache-2.0
"""The guided swap, step by step (thesis 4.3.4: open the palm, take the fingers out, insert the new ones, close)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from softgrip_cell.errors import RefusedError
from softgrip_cell.finger_records import FingerRecord
from softgrip_cell.products import FingerSet
from softgrip_cell.storage.journal import MountedSlot, SlotState


class SwapStep(StrEnum):
    """Steps of a swap, in order; the value is what the database and texts call it."""

    RELEASE = "release"
    LOCK = "lock"
    OPEN_PALM = "open_palm"
    REMOVE = "remove"
    INSERT = "insert"
    CLOSE_PALM = "close_palm"
    UNLOCK = "unlock"
    HOME = "home"
    VERIFY = "verify"
    DONE = "done"


class PersistAction(StrEnum):
    """What has to be written down before the step that follows may begin."""

    NOTHING = "nothing"
    FORGET_SLOTS = "forget slots"
    PARK_FINGERS = "park fingers"
    READ_IN = "read in"


#: What a person confirms when a swap ended while the drives were locked (cell/confirm_step).
HANDS_OUT: Final = "hands_out"

#: What unlocks the drives where the token of the swap is lost.
OVERRIDE_TEXT: Final = (
    "without the token: estop, then tendon/unlock with override_owner: true and a reason, then estop_reset"
)

#: What has to happen before anything else after such a swap.
HANDS_OUT_TEXT: Final = (
    "the drives stay locked: take your hands out, then confirm step 'hands_out' with the token of that swap "
    f"(cell/confirm_step); {OVERRIDE_TEXT}"
)

#: Steps that wait for a person or a tool changer.
CONFIRMED_STEPS = frozenset({SwapStep.OPEN_PALM, SwapStep.REMOVE, SwapStep.INSERT, SwapStep.CLOSE_PALM})


@dataclass(frozen=True)
class SwapTransition:
    """Where a swap goes next.

    Attributes:
        step: the step that begins now.
        instruction: for the person, or what the cell does itself.
        persist: write this first, so that a kill at any moment leaves the truth or "unknown".
        serials: fingers read in, slot order; only with READ_IN.
    """

    step: SwapStep
    instruction: str
    persist: PersistAction = PersistAction.NOTHING
    serials: tuple[str, ...] = ()

    @property
    def confirmation(self) -> bool:
        """Whether cell/confirm_step ends this step."""
        return self.step in CONFIRMED_STEPS


class SwapSequence:
    """Walks through one swap.

    Args:
        finger_set: what is to be mounted.
        slots: what the slots are known to hold.
        finger records: every known finger.
        wanted: serials asked for (slot order), empty for any usable finger of the set.

    Raises:
        RefusedError: no such fingers, or they may not be used.
    """

    def __init__(
        self,
        finger_set: FingerSet,
        slots: Sequence[MountedSlot],
        finger_records: Mapping[str, FingerRecord],
        requested: Sequence[str] = (),
    ) -> None:
        self.finger_set = finger_set
        self._slots = tuple(slots)
        self._finger_records = finger_records
        self._requested = tuple(requested)
        if self._requested:
            self._check_serials(self._requested)
        self.only_check = self._already_in()
        self.serials: tuple[str, ...] = tuple(slot.serial for slot in slots) if self.only_check else ()
        if not self.only_check:
            self._proposed = self._requested or self._propose()
        self.step = SwapStep.RELEASE

    def start(self) -> SwapTransition:
        """Return the first step: tendons slack before anybody reaches in."""
        return SwapTransition(SwapStep.RELEASE, "The tendons go slack. Keep your hands away.")

    def released(self) -> SwapTransition:
        """The tendons are slack."""
        self._expect(SwapStep.RELEASE)
        if self.only_check:
            return self._go(SwapStep.HOME, "The tendons are being homed. Keep your hands away.")
        return self._go(SwapStep.LOCK, "The drives are being locked. Keep your hands away.")

    def locked(self) -> SwapTransition:
        """The drives have no torque and refuse everybody."""
        self._expect(SwapStep.LOCK)
        return self._go(SwapStep.OPEN_PALM, "Open the palm.", PersistAction.FORGET_SLOTS)

    def confirm(self, step: str, serials: Sequence[str] = ()) -> SwapTransition:
        """A person says that a step is done.

        Args:
            step: the one that is waiting, a value of SwapStep.
            serials: where the step asks for them, of the fingers now in the slots, slot order.

        Raises:
            RefusedError: another step is waiting, or the serials may not be used; the swap stays where it is.
        """
        if self.step not in CONFIRMED_STEPS:
            raise RefusedError(f"no step waits for a confirmation: the swap is at '{self.step}'")
        if step != self.step:
            raise RefusedError(f"expected a confirmation of step '{self.step}', found '{step}'")
        if self.step is SwapStep.OPEN_PALM:
            return self._go(SwapStep.REMOVE, self._remove_text())
        if self.step is SwapStep.REMOVE:
            places = ", ".join(f"{s} into {slot.name}" for s, slot in zip(self._proposed, self._slots, strict=True))
            text = f"Insert {places}; hook the cables; confirm with the serials you read on the fingers, slot order."
            return self._go(SwapStep.INSERT, text, PersistAction.PARK_FINGERS)
        if self.step is SwapStep.INSERT:
            self._check_serials(serials)
            self.serials = tuple(serials)
            return self._go(SwapStep.CLOSE_PALM, "Close the palm.", PersistAction.READ_IN, self.serials)
        return self._go(SwapStep.UNLOCK, "The drives are being unlocked. Keep your hands away.")

    def unlocked(self) -> SwapTransition:
        """The drives obey again; no hands are inside."""
        self._expect(SwapStep.UNLOCK)
        return self._go(SwapStep.HOME, "The tendons are being homed. Keep your hands away.")

    def homed(self) -> SwapTransition:
        """The tendons' zero is known."""
        self._expect(SwapStep.HOME)
        return self._go(SwapStep.VERIFY, "The fingers close on nothing to be checked. Keep the palm free.")

    def safe_condition(self) -> str:
        """Return in words how the cell is left when the swap ends now."""
        if self.step in (SwapStep.RELEASE, SwapStep.LOCK, SwapStep.OPEN_PALM) and not self.only_check:
            return "tendons slack, fingers as before but to be verified"
        if self.step in (SwapStep.HOME, SwapStep.VERIFY) or self.only_check:
            return "tendons released, fingers to be verified before any grasp"
        if self.step is SwapStep.UNLOCK:
            return "tendons slack, fingers to be verified before any grasp"
        return "tendons slack, palm open, slots unknown: run the swap again before any grasp"

    def _go(
        self,
        step: SwapStep,
        instruction: str,
        persist: PersistAction = PersistAction.NOTHING,
        serials: tuple[str, ...] = (),
    ) -> SwapTransition:
        self.step = step
        return SwapTransition(step, instruction, persist, serials)

    def _expect(self, step: SwapStep) -> None:
        if self.step is not step:
            raise RefusedError(f"expected the swap to be at '{step}', found '{self.step}'")

    def _already_in(self) -> bool:
        """The slots hold this set already, as far as anybody knows: only the check is needed."""
        known = all(slot.state in (SlotState.TO_BE_VERIFIED, SlotState.VERIFIED) for slot in self._slots)
        serials = tuple(slot.serial for slot in self._slots)
        if not known or (self._requested and serials != self._requested):
            return False
        try:
            self._check_serials(serials)
        except RefusedError:
            return False
        return True

    def _remove_text(self) -> str:
        inside = [f"{slot.serial} from {slot.name}" for slot in self._slots if slot.serial]
        if inside:
            return f"Unhook the cables, take out {', '.join(inside)} and put them into the store."
        return "Unhook the cables, take out whatever is in the slots and put it into the store."

    def _propose(self) -> tuple[str, ...]:
        """Choose the least used usable finger of the set for every slot."""
        chosen: list[str] = []
        for slot in self._slots:
            candidates = [
                finger_record
                for finger_record in self._finger_records.values()
                if finger_record.profile == self.finger_set.profile
                and finger_record.finger == slot.name
                and (
                    finger_record.objection() is None
                    or (finger_record.serial == slot.serial and not finger_record.is_spent)
                )
            ]
            if not candidates:
                raise RefusedError(
                    f"no usable {slot.name} finger of profile '{self.finger_set.profile}' is in the store; "
                    "print one and enter its finger record, or choose another finger set"
                )
            chosen.append(
                min(candidates, key=lambda finger_record: (finger_record.cycles, finger_record.serial)).serial
            )
        return tuple(chosen)

    def _check_serials(self, serials: Sequence[str]) -> None:
        if len(serials) != len(self._slots):
            names = ", ".join(slot.name for slot in self._slots)
            raise RefusedError(f"expected one serial per slot ({names}), found {len(serials)}")
        for slot, serial in zip(self._slots, serials, strict=True):
            finger_record = self._finger_records.get(serial)
            if finger_record is None:
                raise RefusedError(
                    f"slot {slot.name}: finger '{serial}' has no finger record; enter one before mounting it"
                )
            if finger_record.profile != self.finger_set.profile or finger_record.finger != slot.name:
                raise RefusedError(
                    f"slot {slot.name}: expected its finger of profile '{self.finger_set.profile}', found "
                    f"{serial}: {finger_record.finger} finger of '{finger_record.profile}'"
                )
            objection = finger_record.objection()
            if objection is not None:
                raise RefusedError(f"slot {slot.name}: {objection}")
