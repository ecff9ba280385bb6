# SPDX-License-Identifier: Apache-2.0
"""What the fingers' readings say about something between them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from softgrip_cell.grasp.pressing import Pressing
from softgrip_cell.grasp.reading import Reading
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.grasp.touches import Touches
from softgrip_cell.grasp.trail import Trail
from softgrip_cell.grasp.values import GraspTask

#: Share of the holding excess that a product has to have taken before losing it is a slip, not a mistaken touch.
PEAK_CONTACT_SHARE: Final = 0.15

#: Fingers that move less than this within STANDING_S stand [m], [s]: 3 mm/s.
STANDING_S: Final = 0.06
STANDING_M: Final = 0.0002

#: The same for a grip that is called one: 3 mm/s, seen by an encoder of 15 um [m].
GRIPPING_M: Final = 0.00018

#: Fingers rest when they moved less than this within REST_S [m], [s]; no longer than this the trail is kept.
REST_S: Final = 0.3
RESTING_M: Final = 0.0003

#: Fingers that held something and let go leap forward by this within COLLAPSE_S [m], [s].
COLLAPSE_S: Final = 0.1
COLLAPSE_M: Final = 0.0003

#: And their tension has fallen by at least this share of the holding excess.
COLLAPSE_SHARE: Final = 0.5


class Grip:
    """Judge the fingers sample by sample.

    A finger is *at its end stop* when it has closed as far as it goes: its tension says nothing, but what the other
    side presses against it is held. A finger is *blocked* when something stopped it short of its end.
    """

    def __init__(self, task: GraspTask, settings: GraspSettings, pressing: Pressing) -> None:
        self._task = task
        self._settings = settings
        self._pressing = pressing
        self._trail = Trail(REST_S)
        self._touches = Touches(len(task.slots), settings)
        self._readings: tuple[Reading, ...] = ()
        self._now_ns = 0
        self._peak_n = [0.0] * len(task.slots)
        self._peak_contact_n = [0.0] * len(task.slots)
        self._met_at_end: set[int] = set()
        self._tip_deflected: frozenset[int] = frozenset()

    @property
    def readings(self) -> tuple[Reading, ...]:
        """The present readings; empty before the first."""
        return self._readings

    @property
    def peak_n(self) -> tuple[float, ...]:
        """Greatest contact tension of every finger before its end [N]."""
        return tuple(self._peak_n)

    def look(self, now_ns: int, readings: tuple[Reading, ...], tip_deflected: frozenset[int] = frozenset()) -> None:
        """Take the readings of a sample, and which fingertips the camera sees deflected."""
        self._now_ns = now_ns
        self._tip_deflected = tip_deflected
        self._readings = readings
        self._trail.add(now_ns, readings)
        self._touches.look(now_ns, readings)
        for slot, (reading, kept_n) in enumerate(zip(readings, self._touches.kept_n, strict=True)):
            if not self.at_end(slot):
                self._peak_n[slot] = max(self._peak_n[slot], reading.contact_tension_n)
                self._peak_contact_n[slot] = max(self._peak_contact_n[slot], kept_n)

    def meet(self, slots: Sequence[int]) -> None:
        """Remember which of these fingers are at their ends now: what they meet there counts as long as they press."""
        self._met_at_end |= {slot for slot in slots if self.at_end(slot)}

    def begin(self) -> None:
        """Both sides touch: begin to remember what is met at the ends."""
        self._met_at_end.clear()
        self.meet(range(len(self._readings)))

    # --- fingers ---------------------------------------------------------------------------------------------------

    def at_end(self, slot: int) -> bool:
        """A finger has closed as far as it may, or creeps the last bit of it, where it does not count as blocked."""
        return not self._is_blocked(slot)

    def touches(self, slot: int) -> bool:
        """A finger's tension tells a touch, and no mere disturbance of its drive."""
        return self._touches.sure[slot]

    def presses(self, slot: int) -> bool:
        """A finger touches, or is seen to; one that keeps a tension and was not let go on does so whatever its tension.

        Pushed back by the others, a standing finger has its friction against it and less tension than in free motion.
        """
        seen = slot in self._tip_deflected and self._readings[slot].judged
        return self.touches(slot) or seen or (slot in self._pressing.slots and not self._is_at_end_stop(slot))

    def standing(self) -> tuple[bool, ...]:
        """Which fingers stand."""
        return tuple(advance_m <= STANDING_M for advance_m in self._trail.advances_m(self._now_ns, STANDING_S))

    def advance_m(self, within_s: float = REST_S) -> float:
        """How far the finger that went farthest has moved lately [m]."""
        return self._trail.advance_m(self._now_ns, within_s)

    def _is_at_end_stop(self, slot: int) -> bool:
        return self._readings[slot].pulled_m >= self._pressing.path_m(slot)

    def _is_blocked(self, slot: int) -> bool:
        return self._readings[slot].pulled_m <= self._pressing.path_m(slot) - self._settings.min_blockage_m

    # --- the hand --------------------------------------------------------------------------------------------------

    def encloses(self, fingers: Sequence[bool]) -> bool:
        """The thumb and at least one finger against it; with a hook any two fingers."""
        return sum(fingers) > 1 and (fingers[self._task.thumb] or not self._task.opposed)

    def touched(self) -> bool:
        """Touched from both sides."""
        return self.encloses(self._touches.sure)

    def enclosed(self) -> bool:
        """Something is between the fingers: both sides press, and at least one finger was stopped by it."""
        presses = [self.presses(slot) for slot in range(len(self._readings))]
        return self.encloses(presses) and self._has_blocked(presses)

    def lost_contact(self) -> bool:
        """Nothing touches any more."""
        return not any(reading.contact_tension_n >= 0.5 * reading.threshold_n for reading in self._readings)

    def had_contact(self) -> bool:
        """Both sides have pressed on something, not only brushed it, for longer than a drive is disturbed."""
        min_n = PEAK_CONTACT_SHARE * self._task.recipe.hold_contact_tension_n
        return self.encloses([kept_n >= min_n for kept_n in self._peak_contact_n])

    def is_hooked_on(self) -> bool:
        """The thumb of a hook presses on something while the fingers, closed as far as they go, feel none of it."""
        thumb = self._task.thumb
        fingers = [slot for slot in range(len(self._readings)) if slot != thumb]
        return (
            not self._task.opposed
            and self._readings[thumb].touching
            and self._is_blocked(thumb)
            and all(self.at_end(slot) for slot in fingers)
        )

    def holding(self) -> bool:
        """Thumb and a finger still press; a product that gets away takes all excess with it."""
        share = self._settings.slip_share
        return self._supports(
            [
                reading.contact_tension_n >= share * reading.threshold_n
                or slot in self._tip_deflected
                or self._pressing.is_starting(slot, self._now_ns)
                for slot, reading in enumerate(self._readings)
            ]
        )

    def is_tip_deflected(self) -> bool:
        """A finger is seen bent by something: while lifted, that can only be what hangs in the hand."""
        return bool(self._tip_deflected)

    def collapsed(self) -> bool:
        """Both sides have lost at once what they pressed with, and a finger leaps into the room that was left.

        One side alone may slide on a product that is held, and bend round it anew.
        """
        before = self._trail.hardest(self._now_ns, COLLAPSE_S)
        fell = [
            then.tension_n - now.tension_n >= COLLAPSE_SHARE * self._task.recipe.hold_contact_tension_n
            and not now.touching
            for now, then in zip(self._readings, before, strict=True)
        ]
        had_contact = any(
            reading.touching and not self._is_at_end_stop(slot) for slot, reading in enumerate(self._readings)
        )
        return self.encloses(fell) and not had_contact and COLLAPSE_M <= self.advance_m(COLLAPSE_S) < math.inf

    def grips(self) -> bool:
        """Both sides stand and press with what the recipe asks for."""
        full = [reading.touching and self._pressing.is_full(s, reading) for s, reading in enumerate(self._readings)]
        pulled = self._pressing.was_commanded_within(STANDING_S, self._now_ns)
        return self.encloses(full) and not pulled and self.advance_m(STANDING_S) <= GRIPPING_M

    def rests(self) -> bool:
        """Nothing gives way any more."""
        return self.advance_m() <= RESTING_M

    def _supports(self, presses: Sequence[bool]) -> bool:
        """These fingers hold something between them, or press it against those that stand at their stops."""
        slots = range(len(self._readings))
        at_end_stop = [self._is_at_end_stop(slot) for slot in slots]
        free = [not at_end_stop[slot] or slot in self._met_at_end for slot in slots]
        feels = [free[slot] and presses[slot] for slot in slots]
        between = self.encloses(feels)
        on_end_stop = any(feels) and self.encloses([feels[slot] or at_end_stop[slot] for slot in slots])
        return (between or on_end_stop) and self._has_blocked(feels)

    def _has_blocked(self, presses: Sequence[bool]) -> bool:
        return any(press and self._is_blocked(slot) for slot, press in enumerate(presses))
