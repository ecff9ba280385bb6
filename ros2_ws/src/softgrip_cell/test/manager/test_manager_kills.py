# SPDX-License-Identifier: Apache-2.0
"""kill -9 of the manager at every step of a swap and a grasp: the truth or unknown, hardware safe, database whole."""

from __future__ import annotations

import signal
import threading
from typing import Any

import pytest
from rclpy.action import ActionClient

from softgrip_interfaces.action import Grasp, SwapFingers
from softgrip_interfaces.msg import (
    CellState,
    MountedFinger,
)
from softgrip_interfaces.srv import ConfirmStep

pytestmark = pytest.mark.ros

SWAP_KILLS = {
    # step in which the manager dies: (state of the slots after the restart, prefix of the serials that it names)
    "release": (MountedFinger.TO_BE_VERIFIED, "PW"),
    "open_palm": (MountedFinger.UNKNOWN, "PW"),
    "remove": (MountedFinger.UNKNOWN, "PW"),
    "insert": (MountedFinger.UNKNOWN, ""),
    "close_palm": (MountedFinger.TO_BE_VERIFIED, "PI"),
    "home": (MountedFinger.TO_BE_VERIFIED, "PI"),
    "verify": (MountedFinger.TO_BE_VERIFIED, "PI"),
}


@pytest.mark.parametrize("step", SWAP_KILLS)
def test_kill_9_in_a_swap_leaves_the_truth_or_unknown(cell: Any, step: str) -> None:
    cell.start()
    assert cell.swap().outcome == SwapFingers.Result.SUCCEEDED
    cell.driver.blocked = {step}
    reached = threading.Event()
    serials = cell.serials("PI")
    confirm = cell.node.create_client(ConfirmStep, "cell/confirm_step")

    def on_feedback(message: Any) -> None:
        feedback = message.feedback
        if feedback.step == step:
            reached.set()
        elif feedback.confirmation:
            told = serials if feedback.step == "insert" else []
            confirm.call_async(ConfirmStep.Request(step=feedback.step, serials=told))

    client = ActionClient(cell.node, SwapFingers, "cell/swap")
    cell.until(client.server_is_ready, 10.0, "cell/swap")
    client.send_goal_async(SwapFingers.Goal(finger_set="pinch"), feedback_callback=on_feedback)
    assert reached.wait(10.0), f"the swap did not come to step {step}"
    cell.stop(signal.SIGKILL)

    cell.driver.unblock()
    released = cell.driver.released
    cell.start()
    state = cell.state(lambda s: s.mode == CellState.IDLE, "mode idle")
    expected, prefix = SWAP_KILLS[step]
    assert {mounted.state for mounted in state.mounted} == {expected}
    assert [m.serial for m in state.mounted] == (cell.serials(prefix) if prefix else [""] * 3)
    assert f"restarted during swap 'pinch' at step '{step}'" in state.reason
    cell.until(lambda: cell.driver.released > released, 10.0, "the tendons to be released")
    assert "cell/swap" in cell.controller.grasp("egg").reason
    assert cell.integrity() == "ok"


@pytest.mark.parametrize("phase", ["approach", "close", "hold", "lift"])
def test_kill_9_in_a_grasp_lets_nobody_grasp_before_the_fingers_were_opened(cell: Any, phase: str) -> None:
    cell.start("lift_window_s:=30.0")
    assert cell.swap().outcome == SwapFingers.Result.SUCCEEDED
    cell.driver.bench.contact_m = (0.004, 0.004, 0.004)
    if phase == "approach":  # the fingers stand closed, and do not open in time
        cell.driver.bench.pulled_m = [0.01, 0.01, 0.01]
        cell.driver.blocked = {"open"}
    reached = threading.Event()
    client = ActionClient(cell.node, Grasp, "cell/grasp")
    cell.until(client.server_is_ready, 10.0, "cell/grasp")
    phases = []

    def on_feedback(message: Any) -> None:
        phases.append(message.feedback.phase)
        if message.feedback.phase == phase:
            reached.set()

    goal = client.send_goal_async(Grasp.Goal(product="orange", confirm_lift=True), feedback_callback=on_feedback)
    if not reached.wait(10.0):
        result = goal.result() and goal.result().get_result_async()
        cell.until(lambda: result is None or result.done(), 10.0, f"a result of the grasp, which told {phases}")
        pytest.fail(f"the grasp told {phases} and ended with {result and result.result()}")
    released = cell.driver.released
    cell.stop(signal.SIGKILL)

    cell.start(mode=CellState.UNKNOWN)
    state = cell.state(lambda s: s.product == "orange", "the product that may be held")
    assert {mounted.state for mounted in state.mounted} == {MountedFinger.TO_BE_VERIFIED}
    assert "a product may be held: call tendon/release" in cell.controller.grasp("egg").reason
    assert cell.driver.released == released, "nobody but a person may let go of what may be held"
    cell.controller.release()
    cell.state(lambda s: s.mode == CellState.IDLE and s.product == "", "mode idle after release")
    assert cell.integrity() == "ok"
