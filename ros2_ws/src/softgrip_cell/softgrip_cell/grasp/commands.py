# SPDX-License-Identifier: Apache-2.0
"""What a grasp commands: open, close, press, stop, and with how much tension."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from softgrip_cell.grasp.contact import ContactEstimator, FingerContact
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.grasp.values import GraspTask
from softgrip_cell.products import Fragility
from softgrip_time.units import to_ns


@dataclass(frozen=True)
class Open:
    """Let the fingers go back to straight."""


@dataclass(frozen=True)
class Close:
    """Pull these slots to these lengths; the others stay where they are."""

    slots: tuple[int, ...]
    targets_m: tuple[float, ...]
    speed_m_per_s: float
    tension_limit_n: float


@dataclass(frozen=True)
class Press:
    """Keep a tension [N] in these slots and follow an object that gives way, at most so fast [m/s]."""

    slots: tuple[int, ...]
    tensions_n: tuple[float, ...]
    speed_m_per_s: float


@dataclass(frozen=True)
class Stop:
    """Stop all slots and keep them where they are."""


Command = Open | Close | Press | Stop


@dataclass
class _TensionOrder:
    """What one finger keeps.

    Attributes:
        since_ns: stamp of the command. max_n: it is never told more than this [N].
        requested_n, contact: the last `press` and what was felt then; None for a finger that only keeps its tension.
        low_since_ns: since when it stands with too little tension; None while it does not.
        has_yielded: the product gave way to it.
    """

    since_ns: int
    max_n: float = math.inf
    requested_n: float = 0.0
    contact: FingerContact | None = None
    low_since_ns: int | None = None
    has_yielded: bool = False


class TensionControl:
    """Chooses tensions for the fingers; `slots` are those that were commanded to keep one."""

    def __init__(self, task: GraspTask, settings: GraspSettings, estimator: ContactEstimator) -> None:
        self._task = task
        self._recipe = task.recipe
        self._settings = settings
        self._estimator = estimator
        is_fragile = task.product.fragility is Fragility.FRAGILE
        pace = settings.fragile_pace if is_fragile else math.inf
        self._speed_m_per_s = min(settings.press_speed_m_per_s, pace * task.recipe.closing_speed_m_per_s)
        self._orders: dict[int, _TensionOrder] = {}
        self._starting_until_ns: dict[int, int] = {}

    @property
    def slots(self) -> frozenset[int]:
        """Slots that keep a tension."""
        return frozenset(self._orders)

    def is_near_end(self, slot: int, contact: FingerContact) -> bool:
        """Return whether a finger has closed as far as it may, but for what a drive leaves."""
        return contact.pulled_length_m >= self._task.paths_m[slot] - self._settings.reach_m

    def close(self, slots: Sequence[int]) -> Close:
        """Close these fingers along their paths, with a tension that the product bears wherever they meet it."""
        paths_m, references = self._task.paths_m, self._task.references
        free_n = max(references[slot].tension(paths_m[slot]) for slot in slots)
        contact_n = max(self._estimator.contact_tension_limit_n(slot, self._recipe.force_limit_n) for slot in slots)
        limit_n = min(free_n + contact_n, self._settings.tension_limit_n)
        for slot in slots:
            self._orders.pop(slot, None)
        return Close(tuple(slots), tuple(paths_m[s] for s in slots), self._recipe.closing_speed_m_per_s, limit_n)

    def press(self, slots: Sequence[int], contacts: Sequence[FingerContact], now_ns: int) -> Press:
        """Command these fingers to press with what the recipe asks for, but with no more than the product bears."""
        settings = self._settings
        pause_ns = to_ns(settings.starting_period_s - settings.starting_s)
        for slot in slots:
            if now_ns >= self._starting_until_ns.get(slot, 0) + pause_ns:
                self._starting_until_ns[slot] = now_ns + to_ns(settings.starting_s)
            order = self._orders.setdefault(slot, _TensionOrder(now_ns))
            order.since_ns = now_ns
            order.requested_n, order.contact = self._requested_n(slot, contacts[slot]), contacts[slot]
        return Press(tuple(slots), tuple(self._orders[slot].requested_n for slot in slots), self._speed_m_per_s)

    def keep_tension(self, slots: Sequence[int], contacts: Sequence[FingerContact], now_ns: int) -> Press:
        """Command fingers that touch nothing yet to keep the tension that they have, so that they follow what comes."""
        for slot in slots:
            max_n = min(contacts[slot].tension_n, self._requested_n(slot, contacts[slot]))
            self._orders[slot] = _TensionOrder(now_ns, max_n)
        tensions_n = [max(self._settings.min_tension_n, self._orders[slot].max_n) for slot in slots]
        return Press(tuple(slots), tuple(tensions_n), self._speed_m_per_s)

    def keep_up(self, contacts: Sequence[FingerContact], standing: Sequence[bool], now_ns: int) -> tuple[Press, ...]:
        """Pull again where a product that settled or gave way has taken a finger's tension away.

        A finger that moves is following already; it would only be stopped by a new command.
        """
        settings = self._settings
        slots = []
        for slot, order in self._orders.items():
            contact = contacts[slot]
            if self._gives_way(slot, order, contact):
                order.max_n, order.has_yielded = min(order.requested_n, order.max_n), True
            is_low = contact.tension_n < self._requested_n(slot, contact, settings.keep_share)
            if not (is_low and standing[slot]):
                order.low_since_ns = None
            elif order.low_since_ns is None:
                order.low_since_ns = now_ns
            low_ns = 0 if order.low_since_ns is None else now_ns - order.low_since_ns
            is_due = now_ns - order.since_ns >= to_ns(settings.keep_period_s)
            if low_ns >= to_ns(settings.low_s) and is_due and not self.is_near_end(slot, contact):
                slots.append(slot)
        return (self.press(slots, contacts, now_ns),) if slots else ()

    def hold_still(self) -> None:
        """From here on command no finger more than its last command."""
        for order in self._orders.values():
            if order.contact is not None:
                order.max_n = min(order.requested_n, order.max_n)

    def _gives_way(self, slot: int, order: _TensionOrder, contact: FingerContact) -> bool:
        """Whether the last command has moved this finger on, but it presses no harder for it."""
        if order.contact is None:
            return False
        gained_n = contact.contact_tension_n - order.contact.contact_tension_n
        moved_m = contact.pulled_length_m - order.contact.pulled_length_m
        return moved_m >= self._settings.yield_m and gained_n <= self._settings.yield_share * self._holding_n(slot)

    def was_commanded_within(self, span_s: float, now_ns: int) -> bool:
        """Return whether a finger was commanded so short a time ago that it may not have begun to move."""
        return any(now_ns - order.since_ns < to_ns(span_s) for order in self._orders.values())

    def is_starting(self, slot: int, now_ns: int) -> bool:
        """Return whether a drive was commanded to pull a moment ago: its current does not measure tension yet."""
        return now_ns < self._starting_until_ns.get(slot, 0)

    def is_full(self, slot: int, contact: FingerContact) -> bool:
        """Return whether a finger presses with what was asked of it, or as hard as what gives way lets it."""
        order = self._orders.get(slot)
        if order is None:
            return False
        given_n = self._settings.keep_share * order.max_n if order.has_yielded else math.inf
        return (
            contact.contact_tension_n >= self._settings.full_share * self._holding_n(slot)
            or contact.tension_n >= given_n
        )

    def _holding_n(self, slot: int) -> float:
        """Contact tension that a finger shall press with [N]: the recipe's, unless the product bears less."""
        limit_n = self._estimator.contact_tension_limit_n(slot, self._recipe.force_limit_n)
        return min(self._recipe.hold_contact_tension_n, limit_n)

    def _requested_n(self, slot: int, contact: FingerContact, share: float = 1.0) -> float:
        """Tension that a finger shall keep where it stands now [N], with a share of the holding tension."""
        limit_n = min(contact.free_n + share * self._holding_n(slot), self._settings.tension_limit_n)
        max_n = self._orders[slot].max_n if slot in self._orders else math.inf
        return max(self._settings.min_tension_n, min(limit_n, share * max_n))
