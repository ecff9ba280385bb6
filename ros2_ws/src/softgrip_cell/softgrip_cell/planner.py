# SPDX-License-Identifier: Apache-2.0
"""Ordering work so that fingers are swapped as seldom as can be, exactly.

Among the plans that serve every order with an admissible finger set, the best has (1) the fewest swaps, then (2) the
highest expected number of successful picks. A set is admissible for a product when its mark is as good as the best mark
that any usable set has for it, and not "failure".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

from softgrip_cell.errors import RefusedError
from softgrip_cell.outcomes import MARK_RATE, SuccessEstimate
from softgrip_cell.products import TableMark

#: Free ordering looks at every subset of the finger sets; beyond this many it would take seconds.
MAXIMUM_SETS: Final = 12

#: Rates are compared as whole parts of this, so that sums do not depend on the order of adding.
RATE_PARTS: Final = 1_000_000_000


@dataclass(frozen=True)
class Order:
    """A number of picks of one product."""

    product: str
    quantity: int


@dataclass(frozen=True)
class PlannedOrder:
    """One order in its place.

    Attributes:
        index: of the order in the request.
        expected_success: [0..1] of each pick.
        predicted_time_s: picks and the swap before, if any [s].
    """

    index: int
    order: Order
    finger_set: str
    swap_before: bool
    expected_success: float
    predicted_time_s: float
    reason: str


@dataclass(frozen=True)
class Plan:
    """A sequence of orders.

    Attributes:
        expected_success: mean over all picks [0..1].
        redundant_sets: finger sets that can stay in the store for the whole mix.
    """

    steps: tuple[PlannedOrder, ...]
    swaps: int
    predicted_time_s: float
    expected_success: float
    redundant_sets: tuple[str, ...]


@dataclass(frozen=True)
class Durations:
    """What a pick and a swap take [s]; a swap of the thesis' hand takes about 5 minutes (4.3.4)."""

    pick_s: float = 6.0
    swap_s: float = 300.0


Estimates = Mapping[str, Mapping[str, SuccessEstimate]]  # product -> finger set -> estimate


def admissible_sets(product: str, estimates: Estimates, usable_sets: Sequence[str]) -> tuple[str, ...]:
    """Return the finger sets that may serve a product, in the order of ``usable_sets``.

    Raises:
        RefusedError: the product is not in the mix, or every usable set fails on it.
    """
    if product not in estimates:
        raise RefusedError(f"product '{product}' is not in the mix; known are {', '.join(sorted(estimates))}")
    marks = {name: estimates[product][name].mark for name in usable_sets if name in estimates[product]}
    best = max(marks.values(), key=MARK_RATE.__getitem__, default=TableMark.FAILURE)
    if best is TableMark.FAILURE:
        raise RefusedError(
            f"no usable finger set holds '{product}': "
            + (", ".join(f"{name} {mark.value}" for name, mark in marks.items()) or "no set is usable")
        )
    return tuple(name for name, mark in marks.items() if mark is best)


def plan_mix(
    orders: Sequence[Order],
    estimates: Estimates,
    usable_sets: Sequence[str],
    mounted_set: str | None = None,
    *,
    keep_order: bool = False,
    durations: Durations = Durations(),
) -> Plan:
    """Plan the work for an order list.

    Args:
        orders: products with quantities >= 1.
        estimates: what is known of every product.
        usable_sets: finger sets that could be mounted now.
        mounted_set: the set in the slots, None when mixed or unknown.
        keep_order: only choose finger sets; do not reorder.
        durations: for the predicted time.

    Raises:
        RefusedError: an order cannot be served or is nonsense; names the order.
    """
    if not orders:
        raise RefusedError("expected at least one order, found none")
    if len(usable_sets) > MAXIMUM_SETS:
        raise RefusedError(f"expected at most {MAXIMUM_SETS} finger sets, found {len(usable_sets)}")
    for index, order in enumerate(orders):
        if order.quantity < 1:
            raise RefusedError(f"order {index} ({order.product}): expected a quantity >= 1, found {order.quantity}")
    choices = [admissible_sets(order.product, estimates, usable_sets) for order in orders]
    weights = [
        {name: round(estimates[order.product][name].mean * RATE_PARTS) * order.quantity for name in names}
        for order, names in zip(orders, choices, strict=True)
    ]
    if keep_order:
        sequence = list(enumerate(_best_in_order(weights, mounted_set)))
    else:
        sequence = _best_free(weights, usable_sets, mounted_set)
    return _describe(orders, estimates, sequence, usable_sets, mounted_set, durations)


def _best_in_order(weights: Sequence[Mapping[str, int]], mounted_set: str | None) -> list[str]:
    """Choose a set per order by dynamic programming over the mounted set (Bellman); cost (swaps, -successes)."""
    best: dict[str | None, tuple[int, int]] = {mounted_set: (0, 0)}
    origins: list[dict[str, str | None]] = []
    for options in weights:
        following: dict[str | None, tuple[int, int]] = {}
        origin: dict[str, str | None] = {}
        for name, weight in options.items():
            arrivals = {before: (swaps + (before != name), lost - weight) for before, (swaps, lost) in best.items()}
            origin[name] = min(arrivals, key=arrivals.__getitem__)
            following[name] = arrivals[origin[name]]
        best = following
        origins.append(origin)
    last = min(best, key=best.__getitem__)
    chosen: list[str] = []
    for origin in reversed(origins):
        assert last is not None
        chosen.append(last)
        last = origin[last]
    return chosen[::-1]


def _best_free(
    weights: Sequence[Mapping[str, int]], usable_sets: Sequence[str], mounted_set: str | None
) -> list[tuple[int, str]]:
    """Choose the set of finger sets that covers all orders with the fewest swaps.

    With a free order each set is mounted once at most, so only the subset of sets matters: every subset is tried.
    """
    ranked: list[tuple[tuple[int, int], tuple[str, ...]]] = []
    for size in range(1, len(usable_sets) + 1):
        for subset in combinations(usable_sets, size):
            if all(any(name in options for name in subset) for options in weights):
                total = sum(max(options.get(name, -1) for name in subset) for options in weights)
                ranked.append(((size - (mounted_set in subset), -total), subset))
    _, subset = min(ranked, key=lambda entry: entry[0])
    order_of_sets = sorted(subset, key=lambda name: (name != mounted_set, usable_sets.index(name)))
    chosen = [max(subset, key=lambda name: options.get(name, -1)) for options in weights]
    return [(index, name) for name in order_of_sets for index, choice in enumerate(chosen) if choice == name]


def _describe(
    orders: Sequence[Order],
    estimates: Estimates,
    sequence: Sequence[tuple[int, str]],
    usable_sets: Sequence[str],
    mounted_set: str | None,
    durations: Durations,
) -> Plan:
    steps: list[PlannedOrder] = []
    mounted = mounted_set
    for index, name in sequence:
        order = orders[index]
        known = estimates[order.product][name]
        swap = name != mounted
        steps.append(
            PlannedOrder(
                index=index,
                order=order,
                finger_set=name,
                swap_before=swap,
                expected_success=known.mean,
                predicted_time_s=order.quantity * durations.pick_s + swap * durations.swap_s,
                reason=f"{name}: {known.mark.value}, {known.mean:.2f} [{known.low:.2f}, {known.high:.2f}]"
                + (f"; swap from {mounted or 'unknown fingers'}" if swap else ""),
            )
        )
        mounted = name
    picks = sum(order.quantity for order in orders)
    used = {step.finger_set for step in steps}
    return Plan(
        steps=tuple(steps),
        swaps=sum(step.swap_before for step in steps),
        predicted_time_s=sum(step.predicted_time_s for step in steps),
        expected_success=sum(step.expected_success * step.order.quantity for step in steps) / picks,
        redundant_sets=tuple(name for name in usable_sets if name not in used),
    )
