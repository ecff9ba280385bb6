# SPDX-License-Identifier: Apache-2.0
"""How hard the fingers press: what to command once they touch, and what to keep up."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from softgrip_cell.grasp.reading import Reader, Reading
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.grasp.values import Close, GraspTask, Press
from softgrip_cell.products import Fragility

#: Fingers that touch nothing are held with this, so that their tendons stay taut [N].
MIN_TENSION_N: Final = 1.0

#: Share of the holding excess from which a finger counts as pressing with all that was asked of it.
FULL_SHARE: Final = 0.8

#: A finger that stands is pulled again when it presses with less than this share of it for LOW_S, at most so often [s].
KEEP_SHARE: Final = 0.9
LOW_S: Final = 0.04
KEEP_PERIOD_S: Final = 0.15

#: A finger that was pulled again, went on by more than this [m] and presses no harder for it has found what gives way:
#: it keeps its tension and is not pulled harder.
YIELD_M: Final = 0.001
YIELD_SHARE: Final = 0.1

#: What is fragile is pressed at most so many times faster than it was met: a motor does not stop at once [1].
FRAGILE_PACE: Final = 1.3

#: A drive that is told to pull needs so long until its current tells its tension [s]; believed once in STARTING_ONCE_S.
STARTING_S: Final = 0.1
STARTING_ONCE_S: Final = 0.5


class Pressing:
    """Tensions that the fingers keep. Slots that press are those it was told of with `press`."""

    def __init__(self, task: GraspTask, settings: GraspSettings, reader: Reader) -> None:
        self._task = task
        self._recipe = task.recipe
        self._settings = settings
        self._reader = reader
        fragile = task.product.fragility is Fragility.FRAGILE
        self._speed_m_per_s = min(
            settings.press_speed_m_per_s, (FRAGILE_PACE if fragile else math.inf) * task.recipe.closing_speed_m_per_s
        )
        self._kept_since_ns: dict[int, int] = {}
        self._kept_n: dict[int, float] = {}
        self._starting_until_ns: dict[int, int] = {}
        self._low_since_ns: dict[int, int] = {}
        self._last_commands: dict[int, tuple[float, Reading]] = {}
        self._yielded: set[int] = set()

    @property
    def slots(self) -> frozenset[int]:
        """Slots that keep a tension."""
        return frozenset(self._kept_since_ns)

    def path_m(self, slot: int) -> float:
        """End of a finger's path [m]: what the recipe allows, but never beyond what was checked."""
        return min(self._recipe.pull_limit_m, self._task.references[slot].reach_m)

    def at_end(self, slot: int, reading: Reading) -> bool:
        """A finger that has closed as far as it may."""
        return reading.pulled_m >= self.path_m(slot) - self._settings.reach_m

    def close(self, slots: Sequence[int]) -> Close:
        """Close these fingers along their paths, with a tension that the product bears wherever they meet it."""
        free_n = max(self._task.references[slot].tension(self.path_m(slot)) for slot in slots)
        contact_tension_n = max(
            self._reader.contact_tension_limit_n(slot, self._recipe.force_limit_n) for slot in slots
        )
        limit_n = min(free_n + contact_tension_n, self._settings.tension_limit_n)
        for slot in slots:
            self._kept_since_ns.pop(slot, None)
            self._kept_n.pop(slot, None)
            self._last_commands.pop(slot, None)
            self._yielded.discard(slot)
        return Close(tuple(slots), tuple(map(self.path_m, slots)), self._recipe.closing_speed_m_per_s, limit_n)

    def press(self, slots: Sequence[int], readings: Sequence[Reading], now_ns: int) -> Press:
        """Have these fingers press with what the recipe asks for, but with no more than the product bears."""
        for slot in slots:
            self._kept_since_ns[slot] = now_ns
            if now_ns >= self._starting_until_ns.get(slot, 0) + (STARTING_ONCE_S - STARTING_S) * 1e9:
                self._starting_until_ns[slot] = now_ns + round(STARTING_S * 1e9)
        tensions_n = tuple(self._requested_n(slot, readings[slot]) for slot in slots)
        self._last_commands.update((slot, (n, readings[slot])) for slot, n in zip(slots, tensions_n, strict=True))
        return Press(tuple(slots), tensions_n, self._speed_m_per_s)

    def keep(self, slots: Sequence[int], readings: Sequence[Reading], now_ns: int) -> Press:
        """Have fingers that touch nothing yet keep the tension that they have, so that they follow what comes."""
        self._kept_since_ns.update(dict.fromkeys(slots, now_ns))
        requested_n = [min(readings[slot].tension_n, self._requested_n(slot, readings[slot])) for slot in slots]
        self._kept_n.update(zip(slots, requested_n, strict=True))
        return Press(tuple(slots), tuple(max(MIN_TENSION_N, n) for n in requested_n), self._speed_m_per_s)

    def keep_up(self, readings: Sequence[Reading], standing: Sequence[bool], now_ns: int) -> tuple[Press, ...]:
        """Pull again where a product that settled or gave way has taken a finger's tension away.

        A finger that moves is following already; it would only be stopped by a new command.
        """
        for slot, reading in enumerate(readings):
            if self._yields(slot, reading):
                self._kept_n[slot] = min(self._last_commands[slot][0], self._kept_n.get(slot, math.inf))
                self._yielded.add(slot)
            low = slot in self._kept_since_ns and reading.tension_n < self._requested_n(slot, reading, KEEP_SHARE)
            if low and standing[slot]:
                self._low_since_ns.setdefault(slot, now_ns)
            else:
                self._low_since_ns.pop(slot, None)
        slots = [
            slot
            for slot, since_ns in self._kept_since_ns.items()
            if now_ns - self._low_since_ns.get(slot, now_ns) >= LOW_S * 1e9
            and not self.at_end(slot, readings[slot])
            and now_ns - since_ns >= KEEP_PERIOD_S * 1e9
        ]
        return (self.press(slots, readings, now_ns),) if slots else ()

    def hold_still(self) -> None:
        """From here on no finger is told more than it was told last."""
        self._kept_n.update((slot, min(n, self._kept_n.get(slot, n))) for slot, (n, _) in self._last_commands.items())

    def _yields(self, slot: int, reading: Reading) -> bool:
        """What this finger was told last has moved it on, but it presses no harder for it."""
        last_command = self._last_commands.get(slot)
        if last_command is None:
            return False
        gained_n = reading.contact_tension_n - last_command[1].contact_tension_n
        return reading.pulled_m - last_command[
            1
        ].pulled_m >= YIELD_M and gained_n <= YIELD_SHARE * self._contact_tension_n(slot)

    def was_commanded_within(self, span_s: float, now_ns: int) -> bool:
        """A finger was told what to keep so short a time ago that it may not have begun to move."""
        return any(now_ns - since_ns < span_s * 1e9 for since_ns in self._kept_since_ns.values())

    def is_starting(self, slot: int, now_ns: int) -> bool:
        """A drive that was told to pull a moment ago: its current is no measure of the tension while it speeds up."""
        return now_ns < self._starting_until_ns.get(slot, 0)

    def is_full(self, slot: int, reading: Reading) -> bool:
        """A finger presses with what was asked of it, or as hard as what gives way lets it."""
        if slot not in self._kept_since_ns:
            return False
        given_n = KEEP_SHARE * self._kept_n[slot] if slot in self._yielded else math.inf
        return reading.contact_tension_n >= FULL_SHARE * self._contact_tension_n(slot) or reading.tension_n >= given_n

    def _contact_tension_n(self, slot: int) -> float:
        """Excess tension that a finger shall press with [N]: the recipe's, unless the product bears less."""
        return min(
            self._recipe.hold_contact_tension_n, self._reader.contact_tension_limit_n(slot, self._recipe.force_limit_n)
        )

    def _requested_n(self, slot: int, reading: Reading, share: float = 1.0) -> float:
        """Tension that a finger shall keep where it stands now [N], with a share of the excess asked of it."""
        max_n = min(reading.free_n + share * self._contact_tension_n(slot), self._settings.tension_limit_n)
        return max(MIN_TENSION_N, min(max_n, share * self._kept_n.get(slot, math.inf)))
