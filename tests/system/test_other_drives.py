# SPDX-License-Identifier: Apache-2.0
"""The emulated cell on Feetech and on Damiao drives: launched, homed, and a finger closed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.long]
DEVICES = ("rig:=false", "camera:=false", "gripper:=false", "panel:=false", "record:=false")
MOVE = "{tendons: [index], mode: 1, targets: [0.015], speed: 0.02, tension_limit: 20.0}"


@pytest.mark.timeout(360)
@pytest.mark.parametrize("drives", ["feetech", "damiao"])
def test_a_cell_on_other_drives_homes_and_closes_a_finger(
    launch: Callable[..., Any], tmp_path: Path, drives: str
) -> None:
    cell = launch(
        "ros2", "launch", "softgrip_bringup", "cell.launch.yaml", f"drives:={drives}", f"wire_dir:={tmp_path}/wires",
        f"out:={tmp_path}/out", *DEVICES,
    )  # fmt: skip
    cell.wait_for("bus loop", 150.0)
    cell.ask_until(("service", "call", "tendon/home", "std_srvs/srv/Trigger"), "success=True")
    cell.ask_until(
        ("action", "send_goal", "tendon/move", "softgrip_interfaces/action/MoveTendon", MOVE), "outcome: 1\n"
    )
    cell.interrupt()
    cell.wait_for_end(30.0)
    assert cell.survivors() == []
