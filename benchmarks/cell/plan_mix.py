# SPDX-License-Identifier: Apache-2.0
"""How long the planner takes for 1,000 orders, free and in the order given; beside a MILP of the same problem (HiGHS).

Both have to find the same number of swaps and the same expected successes, else the benchmark fails. The MILP is that
of a free order: a binary for every finger set that is used, one for every order and set; swaps before successes.
"""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from random import Random

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import lil_matrix

from softgrip_cell.catalogue_file import read_catalogue
from softgrip_cell.outcomes import estimate
from softgrip_cell.planner import Estimates, Order, Plan, admissible_sets, plan_mix
from softgrip_testing.benchmark_claim import claim, no_options, spread, timed

ORDERS = 1000
SETS = ("power", "pinch", "hook")
MOUNTED = "hook"
RUNS = 5


def solve_milp(orders: Sequence[Order], estimates: Estimates) -> tuple[int, float]:
    """Return the fewest swaps and the successes expected with them."""
    picks = sum(order.quantity for order in orders)
    count = len(SETS)
    cost = np.zeros(count + count * len(orders))
    # A swap outweighs every success that could be won by it.
    cost[:count] = [(picks + 1.0) * (name != MOUNTED) for name in SETS]
    upper = np.ones_like(cost)
    chosen = lil_matrix((len(orders), len(cost)))
    used = lil_matrix((count * len(orders), len(cost)))
    for row, order in enumerate(orders):
        allowed = admissible_sets(order.product, estimates, SETS)
        for number, name in enumerate(SETS):
            column = count + count * row + number
            upper[column] = float(name in allowed)
            cost[column] = -estimates[order.product][name].mean * order.quantity
            chosen[row, column] = 1.0
            used[count * row + number, column] = 1.0
            used[count * row + number, number] = -1.0
    found = milp(
        cost,
        integrality=np.ones_like(cost),
        bounds=Bounds(0.0, upper),
        constraints=[LinearConstraint(chosen.tocsr(), 1.0, 1.0), LinearConstraint(used.tocsr(), -np.inf, 0.0)],
    )
    sets = {name for number, name in enumerate(SETS) if found.x[number] > 0.5}
    return len(sets - {MOUNTED}), -float(cost[count:] @ found.x[count:])


def main() -> None:
    """Plan and print the claims."""
    no_options(__doc__)
    rng = Random(9)
    products = read_catalogue().products
    estimates = {p.id: {name: estimate(mark) for name, mark in p.marks.items()} for p in products.values()}
    orders = [Order(rng.choice(list(products)), rng.randint(1, 20)) for _ in range(ORDERS)]
    plans: list[Plan] = []
    free = timed(lambda: plans.append(plan_mix(orders, estimates, SETS, MOUNTED)), RUNS)
    solved: list[tuple[int, float]] = []
    theirs = timed(lambda: solved.append(solve_milp(orders, estimates)), RUNS)
    kept = timed(lambda: plan_mix(orders, estimates, SETS, MOUNTED, keep_order=True), RUNS)
    picks = sum(order.quantity for order in orders)
    swaps, successes = solved[-1]
    if plans[-1].swaps != swaps or abs(plans[-1].expected_success * picks - successes) > 1e-6 * picks:
        raise SystemExit(
            f"expected {swaps} swaps and {successes:.6f} successes as the MILP, found {plans[-1].swaps} and "
            f"{plans[-1].expected_success * picks:.6f}"
        )
    note = f"{spread(free, 'ms', 1e3)}; both find {swaps} swaps and {successes:.1f} of {picks} picks"
    claim(
        "plan 1,000 orders", 1e3 * statistics.median(free), "ms", better="lower", goal=None, runs=RUNS, note=note,
        peer="MILP (scipy, HiGHS)", peer_value=1e3 * statistics.median(theirs),
    )  # fmt: skip
    claim(
        "plan 1,000 orders in their order", 1e3 * statistics.median(kept), "ms", better="lower", goal=None, runs=RUNS,
        note=spread(kept, "ms", 1e3),
    )  # fmt: skip


if __name__ == "__main__":
    main()
