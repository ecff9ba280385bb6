# SPDX-License-Identifier: Apache-2.0
"""Light products on the emulated cell in virtual time, with a driver that is as late as on a busy computer."""

from __future__ import annotations

from dataclasses import replace

import pytest

from softgrip_cell.catalogue_file import read_catalogue
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.grasp.values import GraspOutcome, GraspPhase
from softgrip_testing.virtual_cell import CHECK, LOADED, VirtualCell, task

SETTINGS = GraspSettings(lift_window_s=1.0)

#: Cells whose driver is late where it matters: while the fingers close and touch nothing yet.
CASES = [
    *((seed, "power", "egg") for seed in (1, 6, 8)),
    *((seed, "power", "banana") for seed in (1, 4, 16)),
    *((seed, "pinch", name) for seed in (1, 5, 13) for name in ("grape", "cheese_slice")),
]


@pytest.mark.parametrize(("seed", "finger_set", "name"), CASES)
def test_a_light_product_is_not_pushed_away_before_it_is_touched(seed: int, finger_set: str, name: str) -> None:
    cell = VirtualCell(seed, finger_set, lateness=LOADED)
    cell.plant.grasp.lifts_itself = False
    cell.home()
    checks = cell.check(replace(CHECK, length_m=0.015))
    cell.plant.place(name)
    touched = False
    for step, _ in cell.grasp(task(read_catalogue().products[name], finger_set, checks), SETTINGS):
        touched = touched or max(cell.plant.grasp.state().contact_forces_n, default=0.0) > 0.0
        assert touched or step.phase in {GraspPhase.APPROACH, GraspPhase.CLOSE}, "pressed before anything was touched"
        if step.phase is GraspPhase.LIFT:
            cell.plant.lift()
    assert step.verdict is not None
    assert step.verdict.outcome is GraspOutcome.GRIPPED
