# SPDX-License-Identifier: Apache-2.0
"""What the manager does, refuses and says over its services and actions."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import threading
import time
from typing import Any

import pytest
from rclpy.action import ActionClient

from softgrip_cell.errors import RefusedError
from softgrip_cell.nodes.controller_client import GRASP_OUTCOMES
from softgrip_interfaces.action import Grasp, SwapFingers
from softgrip_interfaces.msg import (
    CellState,
    FrictionModel,
    MountedFinger,
    PredictionResidual,
)

pytestmark = pytest.mark.ros


def test_a_shift_from_an_unknown_hand_to_a_gripped_orange(cell: Any) -> None:
    cell.start()
    state = cell.state(lambda s: s.mode == CellState.IDLE, "mode idle")
    assert {mounted.state for mounted in state.mounted} == {MountedFinger.UNKNOWN}
    choice = cell.controller.select("orange")
    assert (choice.grasp, choice.swap_needed) == ("power", True)
    refused = cell.controller.grasp("orange")
    assert GRASP_OUTCOMES[refused.outcome] == "ABORTED"
    assert "slot index is unknown; run cell/swap" in refused.reason

    swapped = cell.swap()
    assert swapped.outcome == SwapFingers.Result.SUCCEEDED, swapped.reason
    assert [(m.serial, m.state) for m in swapped.mounted] == [
        (serial, MountedFinger.VERIFIED) for serial in cell.serials("PW")
    ]
    assert not cell.controller.select("orange").swap_needed

    empty = cell.controller.grasp("orange")
    assert GRASP_OUTCOMES[empty.outcome] == "EMPTY", empty.reason
    cell.controller.release()

    cell.driver.bench.contact_m = (0.008, 0.009, 0.0085)
    phases: list[str] = []
    gripped = cell.controller.grasp("orange", on_phase=phases.append)
    assert GRASP_OUTCOMES[gripped.outcome] == "GRIPPED", gripped.reason
    assert gripped.latency < 0.1
    assert phases[-2:] == ["hold", "lift"]
    state = cell.state(lambda s: s.picks == 2, "two picks")
    assert (state.mode, state.product, state.gripped, state.empty, state.swaps) == (
        CellState.HOLDING,
        "orange",
        1,
        1,
        1,
    )
    again = cell.controller.grasp("egg")
    assert "'orange' is held; call tendon/release" in again.reason
    cell.controller.release()
    cell.state(lambda s: s.mode == CellState.IDLE, "mode idle after release")
    cell.stop()
    assert cell.code == 0


def test_the_plan_comes_over_the_service(cell: Any) -> None:
    cell.start()
    products = ["egg", "grape", "baloney"]
    plan = cell.controller.plan(products, [3, 2, 1])
    assert plan.swaps == 2
    assert list(plan.redundant_sets) == ["hook"]
    assert sorted(step.order for step in plan.steps) == [0, 1, 2]
    with pytest.raises(RefusedError, match="'brick' is not in the mix"):
        cell.controller.plan(["brick"], [1])
    with pytest.raises(RefusedError, match="as many quantities as products"):
        cell.controller.plan(["egg"], [])
    with pytest.raises(RefusedError, match="quantity >= 1, found 0"):
        cell.controller.plan(["egg"], [0])
    with pytest.raises(RefusedError, match="'brick' is not in the mix"):
        cell.controller.select("brick")


def run_manager(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a manager that is expected to end by itself."""
    command = [sys.executable, "-m", "softgrip_cell.nodes.grasp_mix_manager", "--ros-args", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)


def test_a_second_manager_on_the_same_cell_is_refused(cell: Any) -> None:
    cell.start()
    first, cell.process = cell.process, None
    other = subprocess.run(
        [
            sys.executable,
            "-m",
            "softgrip_cell.nodes.grasp_mix_manager",
            "--ros-args",
            "-p",
            f"database_url:={cell.url}",
        ],
        capture_output=True,
        text=True,
        timeout=20,
        check=False,
    )
    cell.process = first
    assert other.returncode == 2
    assert "another grasp_mix_manager runs this cell" in other.stderr


@pytest.mark.parametrize(
    ("parameter", "expected"),
    [
        ("catalogue:=/nowhere.yaml", "cannot be read"),
        ("database_url:=oracle://x", "expected sqlite or postgresql"),
        ("lift_window_s:=-1.0", "lift_window_s"),
        ("thumb:=toe", "expected different names with 'toe'"),
        ("slots:=[index,index,thumb]", "expected different names with 'thumb'"),
    ],
)
def test_a_manager_that_cannot_start_says_why(cell: Any, parameter: str, expected: str) -> None:
    done = run_manager("-p", f"database_url:={cell.url}", "-p", parameter)
    assert done.returncode == 2
    assert expected in done.stderr


def test_refusals_name_what_is_wrong(cell: Any) -> None:
    cell.start()
    assert cell.swap().outcome == SwapFingers.Result.SUCCEEDED

    def reason(product: str = "egg", **options: Any) -> str:
        result = cell.controller.grasp(product, **options)
        assert GRASP_OUTCOMES[result.outcome] == "ABORTED"
        return str(result.reason)

    assert "product 'brick' is not in the mix; known are apple" in reason("brick")
    assert "finger set 'power' does not hold 'grape'" in reason("grape")
    assert "expected one of the finger sets power, pinch, hook, found 'claw'" in cell.swap("claw").reason
    cell.driver.publish_friction(age_s=90 * 86400.0)
    cell.until(lambda: "days old, the limit is 30.0 days" in reason(), 5.0, "a refusal for age")
    cell.driver.publish_friction(model="other", coefficients=[0.3])
    cell.until(lambda: "active is friction model 'other'" in reason(), 5.0, "a refusal for another model")
    cell.driver.publish_friction(coefficients=[0.3])
    cell.until(lambda: "active is friction model 'synthetic'" in reason(), 5.0, "a refusal for other numbers")
    cell.driver.publish_friction(coefficients=[0.3], verdict=FrictionModel.UNSET)
    cell.until(lambda: "expected a verdict, found none" in reason(), 5.0, "a refusal without a verdict")
    cell.driver.publish_friction()
    cell.until(lambda: "does not hold" in reason("grape"), 5.0, "the model of the check")
    cell.driver.fault = "overload"
    cell.state(lambda s: s.mode == CellState.FAULT and "overload" in s.fault, "mode fault")
    assert "the driver has a fault: index: overload: scripted" in reason()
    assert "the driver has a fault" in cell.swap().reason
    cell.driver.fault = ""
    cell.driver.guard.estop = True
    cell.state(lambda s: s.mode == CellState.ESTOP, "mode estop")
    assert "the emergency stop is latched (scripted)" in reason()
    cell.driver.guard.estop = False
    cell.state(lambda s: s.mode == CellState.IDLE, "mode idle")
    # A trial may do what is known to fail.
    tried = cell.controller.grasp("grape", trial=True)
    assert GRASP_OUTCOMES[tried.outcome] == "EMPTY", tried.reason


def test_a_finger_that_its_residual_calls_worn_is_not_used_any_more(cell: Any) -> None:
    cell.start()
    assert cell.swap().outcome == SwapFingers.Result.SUCCEEDED
    heard = cell.driver.count_subscribers
    cell.until(lambda: heard("finger/residual") > 0, 10.0, "somebody who listens to finger/residual")
    for _ in range(8):
        cell.driver.publish_residual("index", PredictionResidual.WATCH, "to be watched, and good")
        time.sleep(0.02)  # else some find no room in the queue
    assert "worn" not in cell.controller.grasp("egg").reason, "asked after these were taken"
    for _ in range(4):
        cell.driver.publish_residual("middle", PredictionResidual.WORN, "a single outburst")
    cell.driver.publish_residual("middle", PredictionResidual.WATCH, "a little off")
    for _ in range(5):
        cell.driver.publish_residual("middle", PredictionResidual.WORN, "12 % of its length beside the prediction")
    state = cell.state(lambda s: "worn" in s.reason, "a worn finger")
    assert "PW-M-01" in state.reason
    assert "outburst" not in state.reason
    refused = cell.controller.grasp("egg").reason
    assert "12 % of its length" in refused
    assert "to be watched" not in refused
    assert "cell/swap" in refused


def test_a_fault_in_a_grasp_ends_it_as_a_tendon_fault_and_a_cancel_as_aborted(cell: Any) -> None:
    cell.start("lift_window_s:=30.0")
    assert cell.swap().outcome == SwapFingers.Result.SUCCEEDED
    cell.driver.bench.contact_m = (0.004, 0.004, 0.004)

    def on_phase(phase: str) -> None:
        if phase == "lift":
            cell.driver.fault = "overheated"

    result = cell.controller.grasp("orange", on_phase=on_phase)
    assert GRASP_OUTCOMES[result.outcome] == "TENDON_FAULT"
    assert "tendon index: overheated" in result.reason
    cell.driver.fault = ""
    cell.state(lambda s: s.mode == CellState.IDLE and s.tendon_faults == 1, "one tendon fault counted")

    client = ActionClient(cell.node, Grasp, "cell/grasp")
    feedback: list[object] = []
    goal = client.send_goal_async(Grasp.Goal(product="orange", confirm_lift=True), feedback_callback=feedback.append)
    handle = cell.wait(goal, 5.0, "a goal handle")
    cell.until(lambda: feedback, 10.0, "a phase of the grasp")  # before it, a cancel comes before anything moves
    cell.wait(handle.cancel_goal_async(), 5.0, "the cancel to be taken")
    answer = cell.wait(handle.get_result_async(), 5.0, "a result")
    assert GRASP_OUTCOMES[answer.result.outcome] == "ABORTED"
    assert "cancelled by the client; the fingers stay where they are" in answer.result.reason


def test_a_driver_that_falls_silent_ends_the_grasp_and_a_manager_that_was_held_up_goes_on(cell: Any) -> None:
    """Its own pause is no silence of others: what was sent meanwhile still waits for it."""
    cell.start("lift_window_s:=2.0")
    assert cell.swap().outcome == SwapFingers.Result.SUCCEEDED
    cell.driver.bench.contact_m = (0.008, 0.009, 0.0085)

    def hold_up(phase: str) -> None:
        if phase == "lift":
            cell.process.send_signal(signal.SIGSTOP)
            threading.Timer(1.4, cell.process.send_signal, [signal.SIGCONT]).start()

    held = cell.controller.grasp("orange", on_phase=hold_up)
    assert GRASP_OUTCOMES[held.outcome] == "GRIPPED", held.reason
    assert held.duration > 1.4
    cell.controller.release()
    cell.state(lambda s: s.mode == CellState.IDLE, "mode idle after release")

    def fall_silent(phase: str) -> None:
        cell.driver.quiet = phase == "lift"

    lost = cell.controller.grasp("orange", on_phase=fall_silent)
    assert GRASP_OUTCOMES[lost.outcome] == "ABORTED"
    # One of the last two messages may come a period of the watch after the other; the first gap seen ends it.
    assert re.search(r"expected tendon/(state|status)( and tendon/status)?, found none for 1 s", lost.reason)
    assert "the fingers hold where they are" in lost.reason
    cell.state(lambda s: s.mode == CellState.UNKNOWN, "mode unknown")


def test_a_cancelled_swap_states_its_safe_condition(cell: Any) -> None:
    cell.start()
    client = ActionClient(cell.node, SwapFingers, "cell/swap")
    cell.until(client.server_is_ready, 10.0, "cell/swap")
    asked = threading.Event()
    goal = client.send_goal_async(
        SwapFingers.Goal(finger_set="power"),
        feedback_callback=lambda message: (
            asked.set() if message.feedback.step == SwapFingers.Feedback.OPEN_PALM else None
        ),
    )
    handle = cell.wait(goal, 5.0, "a goal handle")
    assert asked.wait(5.0)
    cell.wait(handle.cancel_goal_async(), 5.0, "the cancel to be taken")
    answer = cell.wait(handle.get_result_async(), 5.0, "a result")
    assert answer.result.outcome == SwapFingers.Result.CANCELLED
    assert "tendons slack, fingers as before but to be verified" in answer.result.reason
    assert "take your hands out" in answer.result.reason
    cell.state(lambda s: s.mode == CellState.SWAPPING and "hands_out" in s.reason, "the instruction")


def test_a_swap_that_takes_too_long_fails(cell: Any) -> None:
    cell.start("swap_limit_s:=5.0")
    result = cell.controller.swap("power", lambda step, _: ["wrong"] * 3 if step == "insert" else [], timeout_s=20.0)
    assert result.outcome == SwapFingers.Result.FAILED
    assert "not done within 5 s, at step 'insert'; tendons slack, palm open, slots unknown" in result.reason
