# SPDX-License-Identifier: Apache-2.0
"""A policy that was trained in virtual time grasps in the live emulated cell, by one command."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("gymnasium", reason="make study-setup")
pytest.importorskip("rosbags")
from rosbags.highlevel import AnyReader

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.long]
Launch = Callable[..., Any]


@pytest.mark.timeout(600)
def test_the_shipped_policy_holds_an_apple_in_the_live_cell(launch: Launch, tmp_path: Path) -> None:
    cell = launch("ros2", "launch", "softgrip_bringup", "cell.launch.yaml", f"out:={tmp_path}/out")
    cell.wait_for("never homed; call tendon/home", 250.0)
    command = launch("ros2", "run", "softgrip_gym", "run_policy", "--product", "apple", domain=cell.domain)
    code = command.wait_for_end(300.0)
    run = json.loads(command.output.strip().splitlines()[-1])
    assert (code, run["is_held"], run["slipped"], run["crushed"]) == (0, True, False, False), command.output
    cell.interrupt()
    cell.wait_for_end(30.0)
    assert cell.survivors() == []
    (bag,) = (tmp_path / "out" / "bags").iterdir()
    with AnyReader([bag]) as reader:
        topics = {one.topic: one for one in reader.connections}
        orders, states = (
            [(at, reader.deserialize(data, one.msgtype)) for one, at, data in reader.messages([topics[topic]])]
            for topic in ("/tendon/trajectory", "/tendon/state")
        )
    # every action is an order to the tendons by who leased them, and the tendons went there
    assert len([one for _, one in orders if one.header.frame_id]) == run["actions"] > 100
    furthest_m = max(max(one.points[0].positions) for _, one in orders)
    assert furthest_m > 5e-3
    ordered = [state for at, state in states if orders[0][0] <= at <= orders[-1][0]]
    assert max(max(state.position) for state in ordered) == pytest.approx(furthest_m, abs=1e-3)
