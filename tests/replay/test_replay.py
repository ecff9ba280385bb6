# SPDX-License-Identifier: Apache-2.0
"""Recorded traffic of the cell, fed back through the nodes' own code: to the same bits.

Made anew by make_bags.py after a deliberate change of what a node computes. Where `exp` or the vector units of a
machine round otherwise than on the one that recorded, SOFTGRIP_REPLAY_TOLERANCE says how far numbers may differ.
"""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path

import pytest

from softgrip_bag.comparison import Result
from softgrip_bag.nodes.digest import digest
from softgrip_bag.nodes.through import check
from softgrip_bag.reader import attachments, read, topic_types

PROFILES = Path(__file__).resolve().parents[2] / "ros2_ws/src/softgrip_bringup/profiles"
BAGS = Path(__file__).resolve().parent / "bags"
TOLERANCE = float(os.environ.get("SOFTGRIP_REPLAY_TOLERANCE", "0"))
NODES = {
    "closings": ("kinematics_predictor", 1000),
    "shapes": ("gdfe_simulator", 3),
    "frames": ("marker_tracker", 20),
    "grasps": ("grasp_mix_manager", 100),
}
OUTCOMES = ["GRIPPED", "EMPTY", "SLIPPED", "ABORTED", "TENDON_FAULT"]
#: A gain of each node: parameter, another value.
GAINS = {
    "kinematics_predictor": ("tip_stddev_m", "0.0011"),
    "grasp_mix_manager": ("contact_floor_n", "0.9"),
}


def bag_of(node: str) -> Path:
    return BAGS / next(bag for bag, (name, _) in NODES.items() if name == node)


def changed(node: str, *arguments: str) -> Result:
    return check(bag_of(node), node, list(arguments), tolerance=TOLERANCE)


@pytest.mark.parametrize("bag", NODES)
def test_the_node_says_what_it_said(bag: str) -> None:
    node, least = NODES[bag]
    result = check(BAGS / bag, node, tolerance=TOLERANCE)
    assert result.divergence is None, str(result.divergence)
    assert result.without_input == 0
    assert result.compared >= least


@pytest.mark.parametrize("node", GAINS)
def test_another_gain_is_named_with_topic_field_time_and_both_values(node: str) -> None:
    parameter, value = GAINS[node]
    found = changed(node, "-p", f"{parameter}:={value}").divergence
    assert found is not None
    assert found.topic
    assert found.field
    assert found.recorded != found.replayed
    first = next(read(bag_of(node)))
    assert found.stamp > first.received - 60_000_000_000
    assert re.fullmatch(r".+ at \d+\.\d{9} s, field .+: recorded .+, replayed .+", str(found))


def test_a_change_of_a_profile_by_a_millionth_is_found(tmp_path: Path) -> None:
    folder = tmp_path / "profiles"
    shutil.copytree(PROFILES, folder)
    for path in folder.glob("*.yaml"):
        text, count = re.subn(
            r"(modulus_constant_pa: )([\d.]+)", lambda m: f"{m[1]}{float(m[2]) * (1 + 1e-6)!r}", path.read_text()
        )
        assert count
        path.write_text(text)
    found = changed("kinematics_predictor", "-p", f"profiles_directory:={folder}").divergence
    assert found is not None
    assert isinstance(found.recorded, float | str)


def test_the_calibration_is_there_with_its_samples_and_its_model() -> None:
    bag = BAGS / "calibration"
    assert topic_types(bag)["/rig/sample"] == "softgrip_interfaces/msg/FrictionSample"
    story = digest(bag)
    assert sum(sample.accepted for sample in story.samples) >= 9
    assert story.fits[-1].points == 9


def test_there_is_a_closing_with_every_finger_set() -> None:
    profiles = {(closing.profile, closing.finger) for closing in digest(BAGS / "closings").closings}
    assert {profile for profile, _ in profiles} == {"hook", "pinch", "power"}


def test_there_is_a_grasp_with_every_outcome_and_the_fault_of_the_last() -> None:
    story = digest(BAGS / "grasps")
    assert [grasp.outcome for grasp in story.grasps] == OUTCOMES
    assert any("index" in fault.name for fault in story.faults if fault.source == "tendon/status")


@pytest.mark.parametrize("bag", NODES)
def test_the_bag_carries_what_sets_its_node_up(bag: str) -> None:
    node, _ = NODES[bag]
    assert f"parameters/{node}.yaml" in {attachment.name for attachment in attachments(BAGS / bag)}


def test_the_bags_are_small() -> None:
    assert sum(file.stat().st_size for file in BAGS.rglob("*.mcap")) < 12_000_000
