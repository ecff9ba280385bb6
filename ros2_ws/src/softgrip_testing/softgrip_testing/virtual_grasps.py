# SPDX-License-Identifier: Apache-2.0
"""Every product grasped by emulated cells in virtual time: what the cell says of each grasp, and what the plant shows.

A block is one emulated cell with one finger set and all products of a product set, in the catalogue's order. It depends
on nothing outside, so its outcomes are the same in whatever process, order and number of workers blocks are run.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache
from itertools import product as combinations
from typing import TYPE_CHECKING, Final

from softgrip_cell.catalogue_file import read_catalogue
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.grasp.values import GraspOutcome, GraspPhase
from softgrip_emulator.plant.products import PlantProduct, products, published_products
from softgrip_testing.virtual_cell import HANGS_S, VirtualCell, task

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from softgrip_cell.products import Product
    from softgrip_cell.swap.check import FingerCheck

FINGER_SETS: Final = ("power", "pinch", "hook")


class ProductSet(StrEnum):
    """Which physical products the emulated world holds; names and recipes are the catalogue's in both."""

    #: the emulator's own products, which were tuned towards Table 4.2
    TUNED = "A"
    #: the same by published masses and dimensions, frozen
    PUBLISHED = "B"


@dataclass(frozen=True)
class GraspBlock:
    """One cell, one finger set, all products of a set.

    Attributes:
        product_set: what lies in the crate.
        seed: of the emulated cell.
        finger_set: profile in every slot.
    """

    product_set: ProductSet
    seed: int
    finger_set: str


@dataclass(frozen=True)
class VirtualGrasp:
    """How one grasp ended.

    Attributes:
        product: its name.
        outcome: the cell's verdict.
        reason: the cell's.
        is_true: the verdict is what the plant shows: GRIPPED where the product hangs still.
        duration_s: virtual time from the command to the verdict [s].
    """

    product: str
    outcome: str
    reason: str
    is_true: bool
    duration_s: float


def blocks(
    seeds: Iterable[int],
    product_sets: Sequence[ProductSet] = tuple(ProductSet),
    finger_sets: Sequence[str] = FINGER_SETS,
) -> list[GraspBlock]:
    """Return every combination, in the order of seeds: a part that was run is a fair sample."""
    return [GraspBlock(of, seed, fingers) for seed, of, fingers in combinations(seeds, product_sets, finger_sets)]


def grasp_products(block: GraspBlock, names: Sequence[str] = ()) -> list[VirtualGrasp]:
    """Grasp every product once.

    Args:
        block: cell, finger set and product set.
        names: only these products; empty: all of the catalogue.

    Returns:
        one result a product, in the catalogue's order; all ABORTED where a finger did not pass its check.
    """
    cell = VirtualCell(block.seed, block.finger_set)
    cell.plant.grasp.lifts_itself = False
    cell.home()
    checks = cell.check()
    refused = [check.reason for check in checks.values() if check.reference is None]
    described = {name: known for name, known in catalogue(block.product_set).items() if not names or name in names}
    if refused:
        return [VirtualGrasp(name, GraspOutcome.ABORTED.value, refused[0], True, 0.0) for name in described]
    return [_grasp(cell, block, known, checks) for known in described.values()]


@cache
def catalogue(product_set: ProductSet) -> Mapping[str, Product]:
    """Return the products as the cell knows them: sizes and masses are those of the set, recipes the catalogue's."""
    shipped = read_catalogue().products
    if product_set is ProductSet.TUNED:
        return shipped
    return {name: _measured(shipped[name], real) for name, real in published_products().items()}


def plant_products(product_set: ProductSet) -> Mapping[str, PlantProduct]:
    """Return the products as the emulated world knows them."""
    return products() if product_set is ProductSet.TUNED else published_products()


def _measured(known: Product, real: PlantProduct) -> Product:
    length_m, width_m, height_m = sorted((real.width_m, real.height_m, real.length_m), reverse=True)
    return replace(known, size_m=(length_m, width_m, height_m), mass_kg=real.mass_kg)


def _grasp(cell: VirtualCell, block: GraspBlock, known: Product, checks: Mapping[str, FingerCheck]) -> VirtualGrasp:
    """Place, grasp, lift and watch one product as a trial does."""
    cell.plant.place("")
    if cell.fault() is not None:
        cell.recover()
    cell.open()
    cell.plant.place(plant_products(block.product_set)[known.id])
    begun_s, lifted_s = cell.plant.now_s, None
    for step, _ in cell.grasp(task(known, block.finger_set, checks), GraspSettings()):
        if step.phase is GraspPhase.LIFT and lifted_s is None:
            lifted_s = cell.plant.now_s
            cell.plant.lift()
    assert step.verdict is not None, "a grasp ends with a verdict"
    duration_s = cell.plant.now_s - begun_s
    hung_s = 0.0 if lifted_s is None else cell.plant.now_s - lifted_s
    outcome = step.verdict.outcome
    is_true = cell.hangs(HANGS_S - hung_s) == (outcome is GraspOutcome.GRIPPED)
    return VirtualGrasp(known.id, outcome.value, step.verdict.reason, is_true, round(duration_s, 3))
