# SPDX-License-Identifier: Apache-2.0
"""What the launch files for RViz and ros2_control come to for a named cell, and for one without a name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from embedded_ros import workspace
from embedded_ros.arguments import parse
from embedded_ros.launch_description import Process
from embedded_ros.launch_file import LaunchReader

LAUNCH = Path(workspace.package("softgrip_bringup").folder) / "launch"


@pytest.fixture(autouse=True)
def programs_of_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stand for programs that are on a machine with ROS 2 alone."""
    monkeypatch.setattr(workspace, "executable", lambda package, name: [f"/opt/{package}/{name}"])


def processes(name: str, **arguments: str) -> list[Process]:
    return LaunchReader(arguments).read(LAUNCH / name).processes


def after(word: str, command: list[str]) -> str:
    return command[command.index(word) + 1]


@pytest.mark.parametrize(
    ("given", "frame"),
    [({}, "flange"), ({"cell": "left"}, "left/flange"), ({"cell": "left", "fixed_frame": "world"}, "world")],
)
def test_rviz_stands_in_a_frame_of_its_cell(given: dict[str, str], frame: str) -> None:
    (rviz,) = processes("view.launch.yaml", **given)
    assert after("-f", rviz.command) == frame
    assert Path(after("-d", rviz.command)).name == "hand.rviz"


@pytest.mark.parametrize(("given", "expected"), [({}, False), ({"use_sim_time": "true"}, True)])
def test_ros2_control_counts_the_time_of_its_cell(given: dict[str, str], expected: bool) -> None:
    """By another clock a controller takes the hand of a slow emulated cell for a stalled one."""
    manager, _ = processes("ros2_control.launch.yaml", cell="left", **given)
    assert "/clock:=clock" in manager.command
    arguments: Any = parse(manager.command[manager.command.index("--ros-args") :])
    value, _ = arguments.parameters_of("/left/controller_manager")["use_sim_time"]
    assert value is expected


@pytest.mark.parametrize(("given", "namespace"), [({}, ""), ({"cell": "left"}, "/left")])
def test_ros2_control_runs_in_the_namespace_of_its_cell(given: dict[str, str], namespace: str) -> None:
    manager, spawner = processes("ros2_control.launch.yaml", **given)
    for process in (manager, spawner):
        remaps = [word for word in process.command if word.startswith("__ns:=")]
        assert remaps == ([f"__ns:={namespace}"] if namespace else [])
    # a relative name: the manager beside it
    assert after("--controller-manager", spawner.command) == "controller_manager"
    # the controllers are nodes in the manager's namespace, with the same file of parameters
    file = after("--params-file", manager.command)
    assert after("--param-file", spawner.command) == file
    given_to: Any = parse(["--ros-args", "--params-file", file])
    for node, parameter in [
        ("controller_manager", "update_rate"),
        ("joint_state_broadcaster", "joints"),
        ("gripper_controller", "joint"),
    ]:
        assert parameter in given_to.parameters_of(f"{namespace}/{node}")
