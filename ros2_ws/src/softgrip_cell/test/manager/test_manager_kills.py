# SPDX-License-Identifier: Apache-2.0
"""kill -9 of the manager at every step of a swap and a grasp: the truth or unknown, hardware safe, database whole."""

from __future__ import annotations

import signal
import threading
from typing import Any

import pytest
from rclpy.action import ActionClient

from softgrip_cell.errors import RefusedError
from softgrip_interfaces.action import Grasp, MoveTendon, SwapFingers
from softgrip_interfaces.msg import (
    CellState,
    MountedFinger,
)
from softgrip_interfaces.srv import ConfirmStep, ReleaseLock

pytestmark = pytest.mark.ros

#: Steps in which a person's hands may be inside: the drives are locked, and the manager has the token on disk.
HANDS_IN = {"open_palm", "remove", "insert", "close_palm", "unlock"}

SWAP_KILLS = {
    # step in which the manager dies: (state of the slots after the restart, prefix of the serials that it names)
    "release": (MountedFinger.TO_BE_VERIFIED, "PW"),
    "lock": (MountedFinger.TO_BE_VERIFIED, "PW"),
    "open_palm": (MountedFinger.UNKNOWN, "PW"),
    "remove": (MountedFinger.UNKNOWN, "PW"),
    "insert": (MountedFinger.UNKNOWN, ""),
    "close_palm": (MountedFinger.TO_BE_VERIFIED, "PI"),
    "unlock": (MountedFinger.TO_BE_VERIFIED, "PI"),
    "home": (MountedFinger.TO_BE_VERIFIED, "PI"),
    "verify": (MountedFinger.TO_BE_VERIFIED, "PI"),
}


def cut_off(cell: Any, step: str, *, changed: bool = True) -> str:
    """Begin a swap and have it stand at a step; returns the token that its feedback gave."""
    cell.driver.blocked = {step}
    reached = threading.Event()
    tokens: set[str] = set()
    serials = cell.serials("PI" if changed else "PW")

    def on_feedback(message: Any) -> None:
        feedback = message.feedback
        tokens.add(feedback.token)
        if feedback.step == getattr(SwapFingers.Feedback, step.upper()):
            reached.set()
        elif feedback.confirmation:
            given = serials if feedback.step == SwapFingers.Feedback.INSERT else []
            request = ConfirmStep.Request(step=feedback.step, token=feedback.token, serials=given)
            confirm.call_async(request)

    confirm = cell.node.create_client(ConfirmStep, "cell/confirm_step")
    client = ActionClient(cell.node, SwapFingers, "cell/swap")
    cell.until(client.server_is_ready, 10.0, "cell/swap")
    cell.until(confirm.service_is_ready, 10.0, "cell/confirm_step")
    goal = SwapFingers.Goal(finger_set="pinch" if changed else "power")
    client.send_goal_async(goal, feedback_callback=on_feedback)
    assert reached.wait(10.0), f"the swap did not come to step {step}"
    (token,) = tokens
    return token


def refuses_everybody(cell: Any) -> None:
    """With hands inside nothing moves, whoever orders it."""
    moved = cell.driver.moved
    outcome, reason = cell.order()
    assert outcome == MoveTendon.Result.REFUSED
    assert "locked by 'grasp_mix_manager" in reason
    assert cell.order("a token that nobody has")[0] == MoveTendon.Result.REFUSED
    with pytest.raises(RefusedError, match="locked"):
        cell.controller.release()
    assert cell.driver.moved == moved


@pytest.mark.parametrize("step", SWAP_KILLS)
def test_kill_9_in_a_swap_leaves_the_truth_or_unknown(cell: Any, step: str) -> None:
    cell.start()
    assert cell.swap().outcome == SwapFingers.Result.SUCCEEDED
    ordered = cell.driver.moved
    token = cut_off(cell, step)
    if step == "verify":  # its order may still be on its way when the feedback is here
        cell.until(lambda: cell.driver.moved > ordered, 10.0, "the order of the check")
    if step in HANDS_IN - {"unlock"}:  # there the scripted driver is held up in its answer
        refuses_everybody(cell)
    cell.stop(signal.SIGKILL)

    cell.driver.unblock()
    released, moved = cell.driver.released, cell.driver.moved
    assert cell.driver.guard.locked == (step in HANDS_IN)
    cell.start(mode=CellState.SWAPPING if step in HANDS_IN else CellState.IDLE)
    state = cell.state(lambda s: "restarted" in s.reason, "what was cut off")
    expected, prefix = SWAP_KILLS[step]
    assert {mounted.state for mounted in state.mounted} == {expected}
    assert [m.serial for m in state.mounted] == (cell.serials(prefix) if prefix else [""] * 3)
    assert f"restarted during swap 'pinch' at step '{step}'" in state.reason
    if step in HANDS_IN:
        refuses_everybody(cell)
        assert "hands_out" in cell.swap().reason
        assert "expected the token" in cell.confirm("hands_out", "guessed").message
        assert "found 'open_palm'" in cell.confirm("open_palm", token).message
        assert cell.driver.guard.locked
        assert cell.confirm("hands_out", token).success
        cell.until(lambda: not cell.driver.guard.locked, 10.0, "the lock to be released")
        cell.state(lambda s: s.mode == CellState.IDLE, "mode idle")
    assert "cell/swap" in cell.controller.grasp("egg").reason
    assert (cell.driver.released, cell.driver.moved) == (released, moved), "nothing moves by itself after a restart"
    assert cell.integrity() == "ok"


@pytest.mark.parametrize("step", sorted(HANDS_IN - {"unlock"}))
def test_with_hands_inside_every_foreign_order_and_confirmation_is_refused(cell: Any, step: str) -> None:
    cell.start()
    token = cut_off(cell, step)
    refuses_everybody(cell)
    serials = cell.serials("PI")
    for guess in ("", "0" * 32, cell.driver.guard.lock_token):
        answer = cell.confirm(step, guess, serials)
        assert not answer.success
        assert "expected the token that the feedback of this swap gave" in answer.message
    assert "expected a confirmation of step" in cell.confirm("hands_out", token).message
    assert "swapping" in cell.swap("power").reason
    refuses_everybody(cell)
    assert cell.confirm(step, token, serials).success


def test_the_token_of_an_earlier_swap_confirms_nothing(cell: Any) -> None:
    cell.start()
    first = cut_off(cell, "open_palm")
    cell.stop(signal.SIGKILL)
    cell.start(mode=CellState.SWAPPING)
    assert cell.confirm("hands_out", first).success
    cell.state(lambda s: s.mode == CellState.IDLE, "mode idle")
    second = cut_off(cell, "open_palm")
    assert second != first
    assert len(second) == 32
    assert not cell.confirm("open_palm", first).success


def test_a_lock_that_a_person_overrode_during_a_restart_is_not_waited_for(cell: Any) -> None:
    cell.start()
    cut_off(cell, "remove")
    cell.stop(signal.SIGKILL)
    cell.driver.guard.estop = True
    overridden = ReleaseLock.Request(override_owner=True, reason="Ada: hands are out")
    assert cell.driver.guard.unlock(overridden, ReleaseLock.Response()).success
    cell.driver.guard.estop = False
    cell.start()
    state = cell.state(lambda s: "the lock of the drives is gone" in s.reason, "the lock to be gone")
    assert state.mode == CellState.IDLE


@pytest.mark.parametrize("phase", ["approach", "close", "hold", "lift"])
def test_kill_9_in_a_grasp_lets_nobody_grasp_before_the_fingers_were_opened(cell: Any, phase: str) -> None:
    cell.start("lift_window_s:=30.0")
    assert cell.swap().outcome == SwapFingers.Result.SUCCEEDED
    cell.driver.bench.contact_m = (0.004, 0.004, 0.004)
    if phase == "approach":  # the fingers stand closed, and do not open in time
        cell.driver.bench.pulled_length_m = [0.01, 0.01, 0.01]
        cell.driver.blocked = {"open"}
    reached = threading.Event()
    client = ActionClient(cell.node, Grasp, "cell/grasp")
    cell.until(client.server_is_ready, 10.0, "cell/grasp")
    phases = []

    def on_feedback(message: Any) -> None:
        phases.append(message.feedback.phase)
        if message.feedback.phase == getattr(Grasp.Feedback, phase.upper()):
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
