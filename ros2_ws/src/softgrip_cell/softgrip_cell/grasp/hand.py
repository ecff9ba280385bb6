# SPDX-License-Identifier: Apache-2.0
"""What the hand as a whole does: whether both sides touch, whether something is held between them, or is getting lost.

A hand has two sides: the thumb, and the fingers against it; a hook has any two fingers. What the fingers' contacts say
one by one is combined here into the few statements that the sequence decides by (GraspSequence.TABLE).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from softgrip_cell.grasp.commands import TensionControl
from softgrip_cell.grasp.contact import FingerContact
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.grasp.values import GraspTask
from softgrip_time.units import to_ns


@dataclass(frozen=True)
class HandState:
    """What the hand does at one instant.

    Attributes:
        contacts: of its fingers.
        pressing: which fingers press: by tension, by camera, or as they keep a commanded tension short of their end.
        standing: which fingers do not move.
        has_opposing_contact: both sides touch something, by tension.
        is_enclosing: both sides press, and something blocks at least one of these fingers: not their own stops.
        is_hooked_on: a hook's thumb presses on something while its fingers, closed as far as they go, feel nothing.
        is_holding: what was enclosed still is: the tension of both sides is not lost.
        has_collapsed: both sides lost their tension at once, and a finger went on into the room that was left.
        has_no_contact: nothing touches any more.
        was_pressed: both sides have pressed on something, not only brushed it.
        is_gripping: both sides stand and press with what the recipe asks for.
        is_tip_deflected: a finger is seen bent by something.
        motion_m: how far the finger that went farthest has moved within rest_s [m].
    """

    contacts: tuple[FingerContact, ...]
    pressing: tuple[bool, ...]
    standing: tuple[bool, ...]
    has_opposing_contact: bool
    is_enclosing: bool
    is_hooked_on: bool
    is_holding: bool
    has_collapsed: bool
    has_no_contact: bool
    was_pressed: bool
    is_gripping: bool
    is_tip_deflected: bool
    motion_m: float


class MotionHistory:
    """Contacts of all fingers over a time span [s]."""

    def __init__(self, span_s: float) -> None:
        self._span_ns = to_ns(span_s)
        self._rows: deque[tuple[int, tuple[FingerContact, ...]]] = deque()

    def add(self, now_ns: int, contacts: tuple[FingerContact, ...]) -> None:
        """Take the contacts of a sample."""
        self._rows.append((now_ns, contacts))
        while len(self._rows) > 1 and self._rows[1][0] <= now_ns - self._span_ns:
            self._rows.popleft()

    def motions_m(self, within_s: float) -> tuple[float, ...]:
        """Return how far every finger has moved lately [m]; infinite before it was watched for so long."""
        now_ns, last = self._rows[-1]
        then_ns = now_ns - to_ns(within_s)
        before = next((contacts for at_ns, contacts in reversed(self._rows) if at_ns <= then_ns), None)
        if before is None:
            return (math.inf,) * len(last)
        return tuple(abs(now.pulled_length_m - then.pulled_length_m) for now, then in zip(last, before, strict=True))

    def motion_m(self, within_s: float) -> float:
        """Return how far the finger that went farthest has moved lately [m]."""
        return max(self.motions_m(within_s))

    def peak_tension_n(self, within_s: float) -> tuple[float, ...]:
        """Return every finger's highest tension of late [N]."""
        then_ns = self._rows[-1][0] - to_ns(within_s)
        late = [contacts for at_ns, contacts in self._rows if at_ns >= then_ns]
        return tuple(max(contact.tension_n for contact in column) for column in zip(*late, strict=True))


class HandEstimator:
    """Combines the contacts of a hand's fingers, sample by sample."""

    def __init__(self, task: GraspTask, settings: GraspSettings, control: TensionControl) -> None:
        self._task = task
        self._settings = settings
        self._control = control
        self._history = MotionHistory(settings.rest_s)
        self._peak_n = [0.0] * len(task.slots)
        self._peak_strength_n = [0.0] * len(task.slots)
        self._met_near_end: set[int] = set()

    @property
    def peak_n(self) -> tuple[float, ...]:
        """Greatest contact tension of every finger short of its end [N]."""
        return tuple(self._peak_n)

    def start_hold(self, contacts: Sequence[FingerContact]) -> None:
        """Both sides press: what fingers meet near their ends from now on counts as long as they press."""
        self._met_near_end.clear()
        self.add_met_near_end(range(len(contacts)), contacts)

    def add_met_near_end(self, slots: Sequence[int], contacts: Sequence[FingerContact]) -> None:
        """Remember which of these fingers are near their ends now."""
        self._met_near_end |= {slot for slot in slots if not contacts[slot].is_short}

    def estimate(self, now_ns: int, contacts: tuple[FingerContact, ...]) -> HandState:
        """Return the state of the hand with these contacts."""
        self._history.add(now_ns, contacts)
        for slot, contact in enumerate(contacts):
            if contact.is_short:
                self._peak_n[slot] = max(self._peak_n[slot], contact.contact_tension_n)
                if contact.strength_n >= contact.threshold_n:  # a surge of a late drive is within its wider threshold
                    self._peak_strength_n[slot] = max(self._peak_strength_n[slot], contact.strength_n)
        settings, standing = self._settings, self._history.motions_m(self._settings.standing_s)
        pressing = [
            contact.is_touching or contact.is_deflected or (slot in self._control.slots and not contact.is_at_end)
            for slot, contact in enumerate(contacts)
        ]
        min_peak_n = settings.min_peak_share * self._task.recipe.hold_contact_tension_n
        return HandState(
            contacts=contacts,
            pressing=tuple(pressing),
            standing=tuple(motion_m <= settings.standing_m for motion_m in standing),
            has_opposing_contact=self._has_both_sides([contact.is_touching for contact in contacts]),
            is_enclosing=self._has_both_sides(pressing) and _has_blocked(pressing, contacts),
            is_hooked_on=self._is_hooked_on(contacts),
            is_holding=self._is_holding(now_ns, contacts),
            has_collapsed=self._has_collapsed(contacts),
            has_no_contact=not any(each.contact_tension_n >= 0.5 * each.punctual_threshold_n for each in contacts),
            was_pressed=self._has_both_sides([peak_n >= min_peak_n for peak_n in self._peak_strength_n]),
            is_gripping=self._is_gripping(now_ns, contacts, max(standing)),
            is_tip_deflected=any(contact.is_deflected for contact in contacts),
            motion_m=self._history.motion_m(settings.rest_s),
        )

    def _has_both_sides(self, fingers: Sequence[bool]) -> bool:
        """Whether these are the thumb and at least one finger against it; with a hook any two fingers."""
        return sum(fingers) > 1 and (fingers[self._task.thumb] or not self._task.opposed)

    def _is_hooked_on(self, contacts: Sequence[FingerContact]) -> bool:
        thumb = contacts[self._task.thumb]
        others = [contact for slot, contact in enumerate(contacts) if slot != self._task.thumb]
        is_closed = all(not contact.is_short for contact in others)
        return not self._task.opposed and thumb.is_touching and thumb.is_short and is_closed

    def _is_holding(self, now_ns: int, contacts: Sequence[FingerContact]) -> bool:
        """Thumb and a finger still press, on what is between them or against a finger that stands at its stop.

        A drive that was just commanded shows no tension yet; a finger that is seen bent holds whatever its tension.
        """
        share = self._settings.slip_share
        is_pressing = [
            contact.contact_tension_n >= share * contact.punctual_threshold_n
            or contact.is_deflected
            or self._control.is_starting(slot, now_ns)
            for slot, contact in enumerate(contacts)
        ]
        is_loaded = [
            pressing and (not contact.is_at_end or slot in self._met_near_end)
            for slot, (pressing, contact) in enumerate(zip(is_pressing, contacts, strict=True))
        ]
        against_stop = [loaded or contact.is_at_end for loaded, contact in zip(is_loaded, contacts, strict=True)]
        is_supported = self._has_both_sides(is_loaded) or (any(is_loaded) and self._has_both_sides(against_stop))
        return is_supported and _has_blocked(is_loaded, contacts)

    def _has_collapsed(self, contacts: Sequence[FingerContact]) -> bool:
        """One side alone may slide on a product that is held, and bend round it again."""
        settings = self._settings
        min_loss_n = settings.collapse_share * self._task.recipe.hold_contact_tension_n
        has_lost = [
            peak_n - contact.tension_n >= min_loss_n and not contact.is_at_threshold
            for contact, peak_n in zip(contacts, self._history.peak_tension_n(settings.collapse_s), strict=True)
        ]
        is_touched = any(contact.is_at_threshold and not contact.is_at_end for contact in contacts)
        motion_m = self._history.motion_m(settings.collapse_s)
        return self._has_both_sides(has_lost) and not is_touched and settings.collapse_m <= motion_m < math.inf

    def _is_gripping(self, now_ns: int, contacts: Sequence[FingerContact], motion_m: float) -> bool:
        is_full = [
            contact.is_touching and self._control.is_full(slot, contact) for slot, contact in enumerate(contacts)
        ]
        is_commanded = self._control.was_commanded_within(self._settings.standing_s, now_ns)
        return self._has_both_sides(is_full) and not is_commanded and motion_m <= self._settings.gripping_m


def _has_blocked(fingers: Sequence[bool], contacts: Sequence[FingerContact]) -> bool:
    """Whether one of these fingers was stopped short of its end: not by its own stops."""
    return any(finger and contact.is_short for finger, contact in zip(fingers, contacts, strict=True))
