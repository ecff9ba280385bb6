# SPDX-License-Identifier: Apache-2.0
"""Recorded traffic of the cell, fed back through the nodes' own code.

To the same bits on the machine that recorded; on another one the last bits of `exp` and of vector units differ, hence
`TOLERANCE`. Made anew by make_bags.py.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from softgrip_bag.nodes.through import check
from softgrip_bag.reader import read, topic_types

PROFILES = Path(__file__).resolve().parents[2] / "ros2_ws/src/softgrip_bringup/profiles"
MODULUS = "modulus_constant_pa: 21890000.0"
BAGS = Path(__file__).resolve().parent / "bags"
#: relative; a hundredth of a percent of a change in a gain is a hundred times more
TOLERANCE = 1e-6
NODES = {
    "closings": ("kinematics_predictor", 100),
    "shapes": ("gdfe_simulator", 3),
}


@pytest.mark.parametrize("name", NODES)
def test_the_node_says_what_it_said(name: str) -> None:
    node, least = NODES[name]
    result = check(BAGS / name, node, tolerance=TOLERANCE)
    assert result.divergence is None, str(result.divergence)
    assert result.compared >= least


def test_a_deliberate_change_of_one_gain_fails_and_is_named(tmp_path: Path) -> None:
    folder = tmp_path / "profiles"
    shutil.copytree(PROFILES, folder)
    power = folder / "power.yaml"
    text = power.read_text()
    assert MODULUS in text
    power.write_text(text.replace(MODULUS, "modulus_constant_pa: 22890000.0"))
    arguments = ["-p", f"profiles_directory:={folder}"]
    result = check(BAGS / "closings", "kinematics_predictor", arguments, tolerance=TOLERANCE)
    assert result.divergence is not None
    assert result.divergence.field != ""


def test_the_calibration_is_there_with_its_samples_and_its_model() -> None:
    bag = BAGS / "calibration"
    assert topic_types(bag)["/rig/sample"] == "softgrip_interfaces/msg/FrictionSample"
    assert sum(1 for _ in read(bag, {"/rig/sample"})) >= 9
    assert any(read(bag, {"/friction/active"}))
