# SPDX-License-Identifier: Apache-2.0
"""The planner against brute force over every sequence and every choice of finger sets."""

from __future__ import annotations

import random
from itertools import permutations, product

import pytest

from softgrip_cell.catalogue_file import read_catalogue
from softgrip_cell.errors import RefusedError
from softgrip_cell.outcomes import Tally, estimate
from softgrip_cell.planner import Durations, Estimates, Order, plan_mix
from softgrip_cell.products import TableMark

SETS = ("power", "pinch", "hook", "claw")
RANK = {TableMark.FAILURE: 0, TableMark.PARTIAL: 1, TableMark.SUCCESS: 2}


def thesis_estimates() -> Estimates:
    return {
        item.id: {name: estimate(mark) for name, mark in item.marks.items()}
        for item in read_catalogue().products.values()
    }


def random_instance(rng: random.Random) -> tuple[list[Order], Estimates, list[str], str | None]:
    sets = list(SETS[: rng.randint(1, 4)])
    estimates = {
        f"p{i}": {
            name: estimate(rng.choice(list(TableMark)), Tally(rng.randint(0, 5), rng.randint(0, 3))) for name in sets
        }
        for i in range(4)
    }
    orders = [Order(rng.choice(list(estimates)), rng.randint(1, 9)) for _ in range(rng.randint(1, 5))]
    return orders, estimates, sets, rng.choice([None, *SETS])


def brute_force(
    orders: list[Order], estimates: Estimates, sets: list[str], mounted: str | None, *, keep_order: bool
) -> tuple[int, float] | None:
    """Best (swaps, expected successes) over everything that can be done; None when an order cannot be served."""
    options = []
    for order in orders:
        known = estimates[order.product]
        best = max(RANK[known[name].mark] for name in sets)
        if best == 0:
            return None
        options.append([name for name in sets if RANK[known[name].mark] == best])
    sequences = [tuple(range(len(orders)))] if keep_order else list(permutations(range(len(orders))))
    costs = []
    for choice in product(*options):
        successes = sum(estimates[o.product][s].mean * o.quantity for o, s in zip(orders, choice, strict=True))
        for sequence in sequences:
            now, swaps = mounted, 0
            for index in sequence:
                swaps += choice[index] != now
                now = choice[index]
            costs.append((swaps, -round(successes, 6)))
    swaps, successes = min(costs)
    return swaps, -successes


@pytest.mark.parametrize("keep_order", [False, True])
def test_500_random_instances_cost_what_brute_force_costs(keep_order: bool) -> None:
    rng = random.Random(9)
    served = 0
    for _ in range(250):
        orders, estimates, sets, mounted = random_instance(rng)
        best = brute_force(orders, estimates, sets, mounted, keep_order=keep_order)
        if best is None:
            with pytest.raises(RefusedError):
                plan_mix(orders, estimates, sets, mounted, keep_order=keep_order)
            continue
        served += 1
        plan = plan_mix(orders, estimates, sets, mounted, keep_order=keep_order)
        picks = sum(order.quantity for order in orders)
        assert plan.swaps == best[0]
        assert plan.expected_success * picks == pytest.approx(best[1], abs=1e-5)
        assert sorted(step.index for step in plan.steps) == list(range(len(orders)))
        now = mounted
        for step in plan.steps:
            assert step.swap_before == (step.finger_set != now)
            now = step.finger_set
    assert served > 100


def test_the_hook_set_is_redundant_for_the_15_products() -> None:
    estimates = thesis_estimates()
    plan = plan_mix([Order(name, 10) for name in estimates], estimates, ["power", "pinch", "hook"], "power")
    assert plan.redundant_sets == ("hook",)
    assert plan.swaps == 1
    assert {step.order.product: step.finger_set for step in plan.steps}["baloney"] == "power"
    assert {step.order.product: step.finger_set for step in plan.steps}["grape"] == "pinch"


def test_kept_order_changes_sets_only_where_it_has_to() -> None:
    orders = [Order(name, 1) for name in ("egg", "baloney", "egg", "grape", "egg", "baloney")]
    plan = plan_mix(orders, thesis_estimates(), ["power", "pinch", "hook"], "pinch", keep_order=True)
    assert [step.index for step in plan.steps] == list(range(6))
    # From pinch: power for baloney, pinch for grape, power for the last baloney.
    assert plan.swaps == 3


def test_predicted_time_counts_picks_and_swaps() -> None:
    plan = plan_mix(
        [Order("egg", 3), Order("grape", 2)],
        thesis_estimates(),
        ["power", "pinch"],
        None,
        durations=Durations(pick_s=4.0, swap_s=100.0),
    )
    assert plan.swaps == 1
    assert plan.predicted_time_s == pytest.approx(5 * 4.0 + 100.0)


@pytest.mark.parametrize(
    ("orders", "expected"),
    [
        ([], "at least one order"),
        ([Order("egg", 0)], "order 0 .egg.: expected a quantity >= 1, found 0"),
        ([Order("egg", -4)], "found -4"),
        ([Order("brick", 1)], "'brick' is not in the mix; known are apple"),
    ],
)
def test_nonsense_orders_are_refused(orders: list[Order], expected: str) -> None:
    with pytest.raises(RefusedError, match=expected):
        plan_mix(orders, thesis_estimates(), ["power", "pinch", "hook"])


def test_an_order_that_no_usable_set_serves_is_refused_by_name() -> None:
    with pytest.raises(RefusedError, match="no usable finger set holds 'grape': power failure, hook failure"):
        plan_mix([Order("grape", 1)], thesis_estimates(), ["power", "hook"])
    with pytest.raises(RefusedError, match="no set is usable"):
        plan_mix([Order("grape", 1)], thesis_estimates(), [])
