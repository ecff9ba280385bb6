# SPDX-License-Identifier: Apache-2.0
"""The zero that homing finds does not depend on where the driver's periods fall on the way to it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from softgrip_testing.virtual_cell import SLOTS, VirtualCell

SETTINGS = Path(__file__).parents[2] / "ros2_ws/src/softgrip_bringup/settings/cell.yaml"
SPOOL_RADIUS_M = 0.010
#: How far the spools are turned beforehand [rad], up to ten periods of homing's way, and how much later it begins [s]
STARTS = [(0.0, 0.0), (0.005, 0.002), (0.012, 0.007), (0.021, 0.003), (0.033, 0.018), (0.041, 0.001), (0.046, 0.012)]


def homing_speed_m_s() -> float:
    """Return the shipped cell's."""
    settings = yaml.safe_load(SETTINGS.read_text())["/**/tendon_driver"]["ros__parameters"]
    return float(settings["homing_speed_m_s"])


def zeros_m(seed: int, finger_set: str, turned_rad: float, later_s: float) -> list[float]:
    """Return the zeros of a cell (device frame), less the way by which its spools were turned [m]."""
    cell = VirtualCell(seed, finger_set)
    for servo in cell.plant.servos:
        servo.shaft.angle_rad += turned_rad
    cell.mount(finger_set)
    cell.plant.advance_to(cell.plant.now_s + later_s)
    for drive in cell.controller.drives.values():
        drive.limits = replace(drive.limits, homing_speed=homing_speed_m_s())
    cell.home()
    zeros = [cell.controller.drives[slot].zero for slot in SLOTS]
    return [zero - SPOOL_RADIUS_M * turned_rad for zero in zeros if zero is not None]


@pytest.mark.parametrize(("seed", "finger_set"), [(1, "power"), (2, "pinch")])
def test_homings_that_begin_elsewhere_and_later_find_the_same_zero(seed: int, finger_set: str) -> None:
    """As the shipped cell homes: a period winds 0.046 mm, and the zero is found to about that (14 mm/s: 0.1 mm)."""
    zeros = np.array([zeros_m(seed, finger_set, *start) for start in STARTS])
    assert zeros.shape == (len(STARTS), len(SLOTS))
    assert zeros.std(axis=0, ddof=1).max() < 0.07e-3
