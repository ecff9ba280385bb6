# SPDX-License-Identifier: Apache-2.0
"""The zero that homing finds does not depend on where the driver's periods fall on the way to it."""

import numpy as np
import pytest

from softgrip_testing.virtual_cell import SLOTS, VirtualCell

SPOOL_RADIUS_M = 0.010
#: How far the spools are turned beforehand [rad], up to three periods of homing's way, and how much later it begins [s].
STARTS = [(0.0, 0.0), (0.005, 0.002), (0.012, 0.007), (0.021, 0.003), (0.033, 0.018), (0.041, 0.001), (0.046, 0.012)]


def zeros_m(seed: int, finger_set: str, turned_rad: float, later_s: float) -> list[float]:
    """Return the zeros of a cell (device frame), less the way by which its spools were turned [m]."""
    cell = VirtualCell(seed, finger_set)
    for servo in cell.plant.servos:
        servo.shaft.angle_rad += turned_rad
    cell.mount(finger_set)
    cell.plant.advance_to(cell.plant.now_s + later_s)
    cell.home()
    zeros = [cell.controller.drives[slot].zero for slot in SLOTS]
    return [zero - SPOOL_RADIUS_M * turned_rad for zero in zeros if zero is not None]


@pytest.mark.parametrize(("seed", "finger_set"), [(1, "power"), (2, "pinch")])
def test_homings_that_begin_elsewhere_and_later_find_the_same_zero(seed: int, finger_set: str) -> None:
    """A period of homing winds 0.10 mm (10 mm/s, 100 Hz): a zero is found finer than half of that."""
    zeros = np.array([zeros_m(seed, finger_set, *start) for start in STARTS])
    assert zeros.shape == (len(STARTS), len(SLOTS))
    assert zeros.std(axis=0, ddof=1).max() < 0.05e-3
