# SPDX-License-Identifier: Apache-2.0
"""Light products on the emulated cell in virtual time, with a driver that is as late as on a busy computer."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

from softgrip_cell.catalogue_file import read_catalogue
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.grasp.values import GraspOutcome, GraspPhase

VIRTUAL_CELL = Path(__file__).resolve().parents[4] / "benchmarks" / "_virtual_cell.py"
SETTINGS = GraspSettings(lift_window_s=1.0)

#: Cells whose driver is late where it matters: while the fingers close and touch nothing yet.
CASES = [
    *((seed, "power", "egg") for seed in (1, 6, 8)),
    *((seed, "power", "banana") for seed in (1, 4, 16)),
    *((seed, "pinch", name) for seed in (1, 5, 13) for name in ("grape", "cheese_slice")),
]


@pytest.fixture(scope="module")
def virtual() -> Iterator[ModuleType]:
    """The module of the cell in virtual time."""
    spec = importlib.util.spec_from_file_location("_virtual_cell_of_the_tests", VIRTUAL_CELL)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


@pytest.mark.parametrize(("seed", "finger_set", "name"), CASES)
def test_a_light_product_is_not_pushed_away_before_it_is_touched(
    virtual: ModuleType, seed: int, finger_set: str, name: str
) -> None:
    cell = virtual.VirtualCell(seed, finger_set, lateness=virtual.LOADED)
    cell.plant.grasp.lifts_itself = False
    cell.home()
    checks = cell.check(replace(virtual.CHECK, length_m=0.015))
    cell.plant.place(name)
    touched = False
    for step, _ in cell.grasp(virtual.task(read_catalogue().products[name], finger_set, checks), SETTINGS):
        touched = touched or max(cell.plant.grasp.state().contact_forces_n, default=0.0) > 0.0
        assert touched or step.phase in {GraspPhase.APPROACH, GraspPhase.CLOSE}, "pressed before anything was touched"
        if step.phase is GraspPhase.LIFT:
            cell.plant.lift()
    assert step.verdict is not None
    assert step.verdict.outcome is GraspOutcome.GRIPPED
