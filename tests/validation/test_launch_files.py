# SPDX-License-Identifier: Apache-2.0
"""What is given to a launch file arrives where it is meant for."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

LAUNCH = Path(__file__).resolve().parents[2] / "ros2_ws/src/softgrip_bringup/launch"


def entities(name: str, kind: str) -> list[dict[str, Any]]:
    """All entities of a kind of a launch file."""
    return [entity[kind] for entity in yaml.safe_load((LAUNCH / name).read_text())["launch"] if kind in entity]


def parameters(executable: str) -> dict[str, str]:
    """Named parameters that the cell's launch file gives to a node."""
    node = next(node for node in entities("cell.launch.yaml", "node") if node["exec"] == executable)
    return {row["name"]: row["value"] for row in node["param"] if "name" in row}


@pytest.mark.parametrize("name", [path.name for path in sorted(LAUNCH.glob("*.launch.yaml"))])
def test_every_argument_is_used(name: str) -> None:
    text = (LAUNCH / name).read_text()
    for argument in entities(name, "arg"):
        assert re.search(rf"\$\(var {argument['name']}\)", text), argument["name"]


def test_the_demo_hands_on_what_the_cell_takes_with_the_cells_default() -> None:
    of_cell = {argument["name"]: argument["default"] for argument in entities("cell.launch.yaml", "arg")}
    include = entities("demo.launch.yaml", "include")[0]
    handed_on = {argument["name"]: argument["value"] for argument in include["arg"]}
    assert handed_on.keys() <= of_cell.keys()
    for argument in entities("demo.launch.yaml", "arg"):
        name = argument["name"]
        if name in of_cell:
            assert handed_on[name] == f"$(var {name})"
        if argument["description"] == "as in cell.launch.yaml":
            assert argument["default"] == of_cell[name]


@pytest.mark.parametrize(
    ("executable", "parameter"),
    [
        ("emulated_cell", "camera_realtime_priority"),
        ("camera", "realtime_priority"),
        ("marker_tracker", "realtime_priority"),
    ],
)
def test_frames_priority_reaches_all_that_a_frame_passes(executable: str, parameter: str) -> None:
    assert parameters(executable)[parameter] == "$(var frames_priority)"


def test_only_nodes_that_hold_hardware_end_the_cell_when_they_are_gone() -> None:
    nodes = entities("cell.launch.yaml", "node")
    ends = {node["exec"] for node in nodes if node.get("on_exit") == "shutdown"}
    assert ends == {"emulated_cell", "tendon_driver", "friction_rig"}
    for node in nodes:
        # the others end it only where they refuse to start
        assert node["launch-prefix"].endswith(" --end-launch-on-refusal") == (node["exec"] not in ends)
