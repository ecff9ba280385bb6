# SPDX-License-Identifier: Apache-2.0
"""The shipped cell under launch_testing: it comes up, answers, and ends at Ctrl-C with nothing left to say.

    launch_test ros2_ws/src/softgrip_bringup/test/launch_testing_cell.py

The suite's own tests of whole cells are in tests/system; this one is for who runs launch_test over an index's packages.
"""

from __future__ import annotations

import subprocess
import tempfile
import unittest
from pathlib import Path
from typing import Any

import launch_testing
import launch_testing.actions
import launch_testing.asserts
from launch import LaunchDescription
from launch.actions import ExecuteProcess

START_S, ANSWER_S = 180.0, 60.0


def generate_test_description() -> tuple[LaunchDescription, dict[str, Any]]:
    """Return the emulated cell's tendons, without rig, camera and page."""
    folder = Path(tempfile.mkdtemp(prefix="softgrip-launch-"))
    devices = [f"{name}:=false" for name in ("rig", "camera", "panel", "gripper", "record")]
    cell = ExecuteProcess(
        cmd=[
            "ros2", "launch", "softgrip_bringup", "cell.launch.yaml", f"out:={folder}/out", f"wire_dir:={folder}/wires",
            *devices,
        ],
        sigterm_timeout="30",
    )  # fmt: skip
    return LaunchDescription([cell, launch_testing.actions.ReadyToTest()]), {"cell": cell}


class TestCellRuns(unittest.TestCase):
    """While the cell is up."""

    def test_the_emulated_hardware_is_there_and_the_driver_speaks(self, proc_output: Any, cell: ExecuteProcess) -> None:
        """Wait for the wires, then for a state of the tendons, as a user asks for one."""
        proc_output.assertWaitFor("wires in", process=cell, timeout=START_S, stream="stdout")
        command = ["ros2", "topic", "echo", "--once", "/safety/state"]
        answer = subprocess.run(command, capture_output=True, text=True, timeout=ANSWER_S, check=False)
        assert "estop: false" in answer.stdout


@launch_testing.post_shutdown_test()
class TestCellEnded(unittest.TestCase):
    """After Ctrl-C."""

    def test_the_launch_ends_without_an_error(self, proc_info: Any, cell: ExecuteProcess) -> None:
        """Exit code 0, or that of an interrupted launch."""
        launch_testing.asserts.assertExitCodes(proc_info, allowable_exit_codes=[0, 130, -2], process=cell)
