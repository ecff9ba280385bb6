# SPDX-License-Identifier: Apache-2.0
"""Virtual grasps beside thesis Table 4.2: cells x products x finger sets, with binomial intervals."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

from softgrip_demo.table42 import CrossCheck, Tried
from softgrip_sweep.intervals import wilson
from softgrip_sweep.task import SweepTask
from softgrip_testing.virtual_grasps import FINGER_SETS, GraspBlock, ProductSet, blocks, catalogue, grasp_products

#: So many cells make a thousand grasps: 12 x 15 products x 3 finger sets x 2 product sets = 1080.
CELLS: Final = 12
_FUNCTION: Final = f"{__name__}:grasp_block"


@dataclass(frozen=True)
class SweptGrasp:
    """One grasp and the block that it belongs to."""

    block: GraspBlock
    product: str
    outcome: str
    reason: str
    is_true: bool


def tasks(
    seeds: Iterable[int], product_sets: Sequence[ProductSet] = tuple(ProductSet), names: Sequence[str] = ()
) -> list[SweepTask]:
    """Return a task for each cell, product set and finger set; it grasps every product (or those named) once."""
    return [
        SweepTask(_FUNCTION, {"product_set": b.product_set.value, "seed": b.seed, "finger_set": b.finger_set}
                  | ({"names": list(names)} if names else {}))
        for b in blocks(seeds, product_sets)
    ]  # fmt: skip


def grasp_block(product_set: str, seed: int, finger_set: str, names: Sequence[str] = ()) -> list[dict[str, Any]]:
    """Grasp the products of one block; called by a worker."""
    block = GraspBlock(ProductSet(product_set), seed, finger_set)
    return [asdict(one) for one in grasp_products(block, names)]


def grasps(task: SweepTask, result: Sequence[dict[str, Any]]) -> list[SweptGrasp]:
    """Return the grasps of a task's result."""
    given = task.arguments
    block = GraspBlock(ProductSet(given["product_set"]), given["seed"], given["finger_set"])
    return [SweptGrasp(block, r["product"], r["outcome"], r["reason"], r["is_true"]) for r in result]


def cross_check(found: Sequence[SweptGrasp], product_set: ProductSet, how: str) -> CrossCheck:
    """Return the grasps of a product set beside the table, products in the catalogue's order."""
    of_it = [one for one in found if one.block.product_set is product_set]
    tried = []
    for name, known in catalogue(product_set).items():
        for fingers in FINGER_SETS:
            outcomes = tuple(g.outcome for g in of_it if g.product == name and g.block.finger_set == fingers)
            if outcomes:
                tried.append(Tried(name, fingers, str(known.marks[fingers]), outcomes))
    return CrossCheck(how, tuple(tried))


def agreement(check: CrossCheck) -> tuple[int, int]:
    """Return how many products with a finger set earn the table's mark, and of how many."""
    return sum(item.agrees for item in check.tried), len(check.tried)


def rows(check: CrossCheck) -> list[tuple[str, ...]]:
    """Return a row for each product: its name, and for each finger set held/tried, the interval [%] and the mark."""
    found = {(item.product, item.finger_set): item for item in check.tried}
    names = dict.fromkeys(item.product for item in check.tried)
    return [(name, *(_cell(found.get((name, fingers))) for fingers in FINGER_SETS)) for name in names]


def _cell(item: Tried | None) -> str:
    if item is None:
        return "-"
    held, tried = item.outcomes.count("GRIPPED"), len(item.outcomes)
    low, high = wilson(held, tried)
    sign = "=" if item.agrees else "!"
    return f"{held}/{tried} [{100 * low:.0f}, {100 * high:.0f}] {sign} {item.mark}"
