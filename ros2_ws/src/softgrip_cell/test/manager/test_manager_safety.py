# SPDX-License-Identifier: Apache-2.0
"""The manager beside others: emergency stop, locks and leases of other people, silence, wrong numbers, a full disk."""

from __future__ import annotations

import io
import math
import re
import resource
import signal
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action import ActionClient
from sensor_msgs.msg import JointState

from softgrip_cell.errors import RefusedError
from softgrip_cell.nodes.controller_client import GRASP_OUTCOMES, CellController, ask
from softgrip_cell.nodes.grasp_mix_manager import START_S
from softgrip_cell.nodes.tendon_lease import HAND_OVER_S
from softgrip_interfaces.action import Grasp, MoveTendon, SwapFingers
from softgrip_interfaces.msg import CellState, SwapProgress, TendonStatus
from softgrip_interfaces.srv import AcquireLock, ConfirmStep
from softgrip_nodekit import LATCHED, RELIABLE, seconds

pytestmark = pytest.mark.ros

TOUCHED = (0.008, 0.009, 0.0085)
OK, ERROR, STALE = 0, 2, 3  # diagnostic_msgs/DiagnosticStatus


def ready(cell: Any, *parameters: str) -> None:
    """A cell with power fingers that were checked."""
    cell.start(*parameters)
    # a busy computer loses samples of the check, or lets the driver be silent for a second: both are refused
    tries = (cell.swap() for _ in range(5))
    swapped = next(
        each for each in tries if not any(late in each.reason for late in ("samples up to", "found none for"))
    )
    assert swapped.outcome == SwapFingers.Result.SUCCEEDED, swapped.reason


def held(cell: Any) -> None:
    """An orange in the hand."""
    cell.driver.bench.contact_m = TOUCHED
    result = cell.controller.grasp("orange")
    assert GRASP_OUTCOMES[result.outcome] == "GRIPPED", result.reason
    cell.state(lambda s: s.mode == CellState.HOLDING, "mode holding, which is on disk then")


def grasped(cell: Any, during: Callable[[], None], phase: str = "lift") -> Any:
    """Result of a grasp in which something happens at a phase."""
    cell.driver.bench.contact_m = TOUCHED
    return cell.controller.grasp("orange", on_phase=lambda name: during() if name == phase else None)


# --- emergency stop and other people's locks -----------------------------------------------------------------------


@pytest.mark.parametrize("by_status", [True, False])
def test_an_emergency_stop_ends_a_grasp_and_refuses_the_next(cell: Any, by_status: bool) -> None:
    """Also where safety/state alone tells of it."""
    ready(cell, "lift_window_s:=20.0")
    cell.driver.status_tells_estop = by_status
    result = grasped(cell, lambda: setattr(cell.driver.guard, "estop", True))
    assert GRASP_OUTCOMES[result.outcome] == "ABORTED"
    assert "the emergency stop is latched" in result.reason
    cell.state(lambda s: s.mode == CellState.ESTOP, "mode estop")
    assert "the emergency stop is latched" in cell.controller.grasp("egg").reason
    assert "the emergency stop is latched" in cell.swap("pinch", "PI").reason


def test_somebody_elses_lock_ends_a_grasp_and_names_its_owner(cell: Any) -> None:
    ready(cell, "lift_window_s:=20.0")

    def lock() -> None:
        request = AcquireLock.Request(owner="Ada at the panel", reason="cleaning")
        cell.driver.guard.lock(request, AcquireLock.Response())

    result = grasped(cell, lock)
    assert GRASP_OUTCOMES[result.outcome] == "ABORTED"
    for refused in (result.reason, cell.controller.grasp("egg").reason, cell.swap("pinch", "PI").reason):
        assert "locked by 'Ada at the panel': cleaning" in refused
    state = cell.state(lambda s: "Ada" in s.reason, "the owner of the lock")
    assert cell.driver.guard.lock_owner == "Ada at the panel", "the manager leaves it alone"
    assert state.mode != CellState.SWAPPING


# --- a swap ----------------------------------------------------------------------------------------------------------


def test_a_swap_locks_the_drives_between_slack_tendons_and_the_closed_palm(cell: Any) -> None:
    cell.start()
    seen: dict[str, bool] = {}
    serials = cell.serials("PW")

    def confirm(step: str, _instruction: str) -> list[str]:
        seen[step] = cell.driver.guard.locked
        return serials if step == "insert" else []

    result = cell.controller.swap("power", confirm)
    assert result.outcome == SwapFingers.Result.SUCCEEDED, result.reason
    assert seen == dict.fromkeys(("open_palm", "remove", "insert", "close_palm"), True)
    assert not cell.driver.guard.locked
    assert not cell.driver.refused


def test_a_swap_does_not_go_on_with_taut_tendons(cell: Any) -> None:
    cell.start()
    cell.driver.release_fails = "busy"
    cell.driver.bench.pulled_length_m = [0.010, 0.0, 0.010]  # 6.7 N by the bench
    result = cell.swap()
    assert result.outcome == SwapFingers.Result.FAILED
    assert "tendon/release: busy; tendons index, thumb are taut" in result.reason
    assert not cell.driver.guard.locked


def test_a_swap_does_not_go_on_with_tendons_that_stay_taut_though_the_release_was_answered(cell: Any) -> None:
    cell.start()
    cell.driver.bench.drive_n = lambda _: 3.0
    result = cell.swap()
    assert result.outcome == SwapFingers.Result.FAILED
    assert "tendon/release: done; tendons index, middle, thumb are taut" in result.reason


def test_where_nothing_is_released_slack_tendons_will_do(cell: Any) -> None:
    cell.start()
    cell.driver.release_fails = "torque is off"
    assert cell.swap().outcome == SwapFingers.Result.SUCCEEDED


def test_a_cancelled_swap_stays_locked_until_its_client_says_that_hands_are_out(cell: Any) -> None:
    cell.start()
    client = ActionClient(cell.node, SwapFingers, "cell/swap")
    cell.until(client.server_is_ready, 10.0, "cell/swap")
    tokens: list[str] = []
    asked = threading.Event()

    def on_feedback(message: Any) -> None:
        tokens.append(message.feedback.token)
        if message.feedback.confirmation:
            asked.set()

    goal = client.send_goal_async(SwapFingers.Goal(finger_set="power"), feedback_callback=on_feedback)
    handle = cell.wait(goal, 5.0, "a goal handle")
    assert asked.wait(10.0)
    cell.wait(handle.cancel_goal_async(), 5.0, "the cancel to be taken")
    result = cell.wait(handle.get_result_async(), 5.0, "a result").result
    assert result.outcome == SwapFingers.Result.CANCELLED
    assert "take your hands out" in result.reason
    assert cell.driver.guard.locked
    assert "take your hands out" in cell.controller.grasp("egg").reason
    assert "expected the token" in cell.confirm("hands_out", "").message
    assert cell.confirm("hands_out", tokens[0]).success
    cell.state(lambda s: s.mode == CellState.IDLE, "mode idle")
    assert not cell.driver.guard.locked
    assert cell.swap().outcome == SwapFingers.Result.SUCCEEDED


def test_a_swap_whose_person_goes_away_is_cancelled_and_says_how_to_unlock(cell: Any) -> None:
    cell.start()

    def gone(step: str, _instruction: str) -> list[str]:
        if step == "insert":
            raise RefusedError("nobody there")
        return []

    with pytest.raises(RefusedError, match=r"nobody there; .*take your hands out.*; the token: \S+$"):
        cell.controller.swap("power", gone, timeout_s=20.0)
    assert cell.driver.guard.locked
    assert cell.controller.may_unlock
    other = CellController(cell.node, cell.wait)
    assert not other.may_unlock
    with pytest.raises(RefusedError, match=r"found none; without the token: estop, .* a reason, then estop_reset"):
        other.hands_out()
    cell.controller.hands_out()
    cell.state(lambda s: s.mode == CellState.IDLE, "mode idle")
    assert not cell.driver.guard.locked


def test_a_closed_terminal_refuses_a_step(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO())
    with pytest.raises(RefusedError, match="expected Enter or serials at step 'remove', found the end of the input"):
        ask("remove", "Take the fingers out.")


def test_a_swap_fails_where_somebody_holds_the_lock_already_or_takes_it_away(cell: Any) -> None:
    cell.start()

    def override(step: str, _instruction: str) -> list[str]:
        if step == "remove":
            cell.driver.guard.lock_token = ""
            cell.driver.guard.publish()
        return []

    result = cell.controller.swap("power", override)
    assert result.outcome == SwapFingers.Result.FAILED
    assert "the lock of the drives is gone" in result.reason


def test_the_controllers_client_ends_what_its_swap_left_locked(cell: Any) -> None:
    cell.start("swap_limit_s:=5.0")
    result = cell.controller.swap("power", lambda step, _: ["wrong"] * 3 if step == "insert" else [], timeout_s=20.0)
    assert "not done within 5 s" in result.reason
    assert cell.driver.guard.locked
    cell.controller.hands_out()
    cell.state(lambda s: s.mode == CellState.IDLE, "mode idle")
    assert not cell.driver.guard.locked


def progress_of(cell: Any) -> list[SwapProgress]:
    """What cell/swap_progress says to somebody who comes now; filled as messages come."""
    found: list[SwapProgress] = []
    cell.node.create_subscription(SwapProgress, "cell/swap_progress", found.append, LATCHED)
    cell.until(lambda: bool(found), 5.0, "cell/swap_progress")
    return found


def test_everybody_can_follow_a_swap_and_nobody_gets_its_token(cell: Any) -> None:
    cell.start()
    heard = progress_of(cell)
    (before,) = heard
    assert before == SwapProgress(header=before.header)  # no swap in this run
    client = ActionClient(cell.node, SwapFingers, "cell/swap")
    cell.until(client.server_is_ready, 10.0, "cell/swap")
    feedback: list[SwapFingers.Feedback] = []
    goal = SwapFingers.Goal(finger_set="power")
    sent = client.send_goal_async(goal, feedback_callback=lambda message: feedback.append(message.feedback))
    handle = cell.wait(sent, 5.0, "a goal handle")
    for name, serials in (("open_palm", []), ("remove", []), ("insert", cell.serials("PW")), ("close_palm", [])):
        number = getattr(SwapFingers.Feedback, name.upper())
        cell.until(lambda number=number: heard[-1].step == number, 5.0, f"cell/swap_progress at {name}")
        cell.until(lambda number=number: feedback[-1].step == number, 5.0, f"feedback at {name}")
        assert (heard[-1].running, heard[-1].confirmation) == (True, True)
        assert heard[-1].instruction == feedback[-1].instruction
        if name == "remove":
            late = progress_of(cell)[0]  # somebody else comes in the midst of it
        assert cell.confirm(name, feedback[-1].token, serials).success
    assert (late.running, late.step, late.finger_set) == (True, SwapFingers.Feedback.REMOVE, "power")
    assert bytes(bytearray(late.goal_id)) == bytes(bytearray(handle.goal_id.uuid))
    assert 0.0 < seconds(late.since) < seconds(late.header.stamp)
    result = cell.wait(handle.get_result_async(), 10.0, "a result").result
    cell.until(lambda: not heard[-1].running, 5.0, "the end on cell/swap_progress")
    end = heard[-1]
    assert (end.outcome, end.reason, end.confirmation, end.step) == (result.outcome, result.reason, False, 0)
    assert len(feedback[0].token) == 32
    assert not any(feedback[0].token in str(message) for message in (*heard, late))


def test_a_refused_swap_leaves_the_progress_of_the_last_one(cell: Any) -> None:
    cell.start()
    heard = progress_of(cell)
    assert cell.swap("claw").outcome == SwapFingers.Result.REFUSED
    assert cell.swap().outcome == SwapFingers.Result.SUCCEEDED
    cell.until(lambda: heard[-1].outcome == SwapFingers.Result.SUCCEEDED, 5.0, "the end")
    assert {message.finger_set for message in heard} <= {"", "power"}


def test_hands_inside_are_said_also_by_a_manager_that_was_killed_and_gone_when_they_are_out(cell: Any) -> None:
    cell.start("swap_limit_s:=5.0")

    def wrong(step: str, _instruction: str) -> list[str]:
        return ["wrong"] * 3 if step == "insert" else []

    assert "not done within 5 s" in cell.controller.swap("power", wrong, timeout_s=20.0).reason
    heard = progress_of(cell)
    cell.until(lambda: not heard[-1].running, 5.0, "the end")
    assert (heard[-1].step, heard[-1].confirmation) == (ConfirmStep.Request.HANDS_OUT, True)
    assert (heard[-1].outcome, heard[-1].finger_set) == (SwapFingers.Result.FAILED, "power")
    cell.stop(signal.SIGKILL)
    heard.clear()
    cell.start(mode=CellState.SWAPPING)
    cell.until(lambda: bool(heard), 5.0, "cell/swap_progress of the next manager")
    assert (heard[-1].step, heard[-1].confirmation, heard[-1].finger_set) == (10, True, "power")
    cell.controller.hands_out()
    cell.until(lambda: not heard[-1].confirmation, 5.0, "hands that are out")
    assert heard[-1].step == 0


# --- leases ----------------------------------------------------------------------------------------------------------


def test_the_tendons_are_owned_while_the_cell_works_or_holds_and_free_otherwise(cell: Any) -> None:
    ready(cell)
    assert cell.driver.guard.lease_owner == "", "free when the swap's result comes"
    for goal in cell.driver.goals:  # of the manager's own check
        assert goal.lease
        assert goal.speed > 0.0
        assert 0.0 < goal.tension_limit <= 35.0
        assert abs(cell.node.get_clock().now().nanoseconds * 1e-9 - goal.deadline.sec) < 60.0
    assert cell.order()[0] == MoveTendon.Result.REACHED
    cell.controller.release()
    held(cell)
    assert cell.driver.guard.lease_owner == "grasp_mix_manager"
    assert "owned by 'grasp_mix_manager'" in cell.order()[1]
    beats = cell.driver.guard.heartbeats
    cell.until(lambda: cell.driver.guard.heartbeats > beats + 3, 5.0, "heartbeats while something is held")
    cell.controller.release()
    cell.until(lambda: cell.driver.guard.lease_owner == "", 5.0, "the tendons to be free")
    assert not cell.driver.refused[1:], "nothing of the manager's was refused"


def test_a_grasp_of_tendons_that_somebody_owns_is_refused_with_the_owner_and_works_when_they_are_free(
    cell: Any,
) -> None:
    ready(cell)
    cell.driver.guard.take_lease("Ada at the panel")
    refused = cell.controller.grasp("orange")
    assert GRASP_OUTCOMES[refused.outcome] == "ABORTED"
    assert "owned by 'Ada at the panel'" in refused.reason
    assert "owned by 'Ada at the panel'" in cell.swap("pinch", "PI").reason
    state = cell.state(lambda s: s.mode == CellState.IDLE, "mode idle")
    assert state.aborted == 0, "a grasp that never began is not counted"
    cell.driver.guard.end_lease()
    held(cell)


def test_what_is_only_held_is_handed_over_to_whoever_asks(cell: Any) -> None:
    ready(cell)
    held(cell)
    cell.driver.guard.ask_for_hand_over("Ada at the panel")
    cell.until(lambda: cell.driver.guard.lease_owner == "", 5.0, "the hand-over")
    cell.driver.guard.take_lease("Ada at the panel")
    assert cell.driver.cell.mode == CellState.HOLDING
    cell.driver.guard.end_lease()
    cell.until(lambda: cell.driver.guard.lease_owner == "grasp_mix_manager", 15.0, "the tendons to be taken back")


def test_the_lease_outlasts_a_slow_release_which_its_end_would_stop(cell: Any) -> None:
    ready(cell)
    held(cell)
    cell.driver.tendon_state = TendonStatus.RELEASING
    cell.controller.release()
    cell.state(lambda s: s.mode == CellState.IDLE, "mode idle")
    beats = cell.driver.guard.heartbeats
    cell.until(lambda: cell.driver.guard.heartbeats > beats + 3, 5.0, "heartbeats while the tendons move")
    assert cell.driver.guard.lease_owner == "grasp_mix_manager"
    cell.driver.tendon_state = TendonStatus.HOLDING
    cell.until(lambda: cell.driver.guard.lease_owner == "", 5.0, "the tendons to be free")


def test_a_running_grasp_is_not_handed_over_but_its_end_is(cell: Any) -> None:
    ready(cell, "lift_window_s:=1.0")
    result = grasped(cell, lambda: cell.driver.guard.ask_for_hand_over("Ada at the panel"))
    assert GRASP_OUTCOMES[result.outcome] == "GRIPPED", result.reason
    cell.until(lambda: cell.driver.guard.lease_owner == "", 5.0, "the hand-over")


def test_a_running_grasp_keeps_its_tendons_while_somebody_asks_for_them(cell: Any) -> None:
    ready(cell, "lift_window_s:=30.0")
    cell.driver.bench.contact_m = TOUCHED
    client = ActionClient(cell.node, Grasp, "cell/grasp")
    cell.until(client.server_is_ready, 10.0, "cell/grasp")
    moved = cell.driver.moved
    handle = cell.wait(client.send_goal_async(Grasp.Goal(product="orange", confirm_lift=True)), 5.0, "a goal handle")
    cell.until(lambda: cell.driver.moved > moved, 10.0, "an order of the grasp")
    cell.driver.guard.ask_for_hand_over("Ada at the panel")
    beats = cell.driver.guard.heartbeats
    cell.until(lambda: cell.driver.guard.heartbeats > beats + 8, 10.0, "heartbeats: each is a look of the manager")
    assert cell.driver.guard.lease_owner == "grasp_mix_manager"
    cell.wait(handle.cancel_goal_async(), 5.0, "the cancel to be taken")
    cell.until(lambda: cell.driver.guard.lease_owner == "", 10.0, "the hand-over after its end")


def test_a_grasp_that_loses_the_tendons_ends_and_names_who_has_them(cell: Any) -> None:
    ready(cell, "lift_window_s:=20.0")
    result = grasped(cell, lambda: cell.driver.guard.take_lease("Ada at the panel"))
    assert GRASP_OUTCOMES[result.outcome] == "ABORTED"
    assert "found 'Ada at the panel'" in result.reason


def test_tendons_that_were_handed_over_are_left_alone_for_a_while(cell: Any) -> None:
    """A person may take longer for them than the manager's next look."""
    ready(cell)
    held(cell)
    cell.driver.guard.ask_for_hand_over("Ada at the panel")
    cell.until(lambda: cell.driver.guard.lease_owner == "", 5.0, "the hand-over")
    handed_over_s = time.monotonic()
    while time.monotonic() - handed_over_s < HAND_OVER_S - 1.5:
        assert cell.driver.guard.lease_owner == ""
        time.sleep(0.05)
    cell.until(lambda: cell.driver.guard.lease_owner == "grasp_mix_manager", 15.0, "the tendons to be taken back")


def in_the_check(cell: Any, happens: Callable[[], None]) -> Any:
    """Result of a swap in whose check something happens once: the first time that its own order moves the tendons."""
    cell.start()

    def look(_message: JointState) -> None:
        if cell.driver.moved and cell.driver.guard.lease_owner == "grasp_mix_manager":
            cell.driver.spoil = lambda _: None
            happens()

    cell.driver.spoil = look
    return cell.swap(timeout_s=60.0)


def test_a_check_that_loses_the_tendons_ends_and_names_who_has_them(cell: Any) -> None:
    result = in_the_check(cell, lambda: cell.driver.guard.take_lease("Ada at the panel"))
    assert result.outcome == SwapFingers.Result.FAILED
    assert "lost the tendons" in result.reason
    assert "found 'Ada at the panel'" in result.reason


def test_a_check_whose_driver_falls_silent_fails(cell: Any) -> None:
    result = in_the_check(cell, lambda: setattr(cell.driver, "quiet", True))
    assert result.outcome == SwapFingers.Result.FAILED
    # One of the last two messages may come a period of the watch after the other; the first gap seen ends it.
    assert re.search(r"expected tendon/(state|status)( and tendon/status)?, found none for 1 s", result.reason)


def test_a_manager_that_ends_gives_the_tendons_back(cell: Any) -> None:
    ready(cell, "lease_s:=10.0")
    held(cell)
    assert cell.driver.guard.lease_owner == "grasp_mix_manager"
    ended_s = time.monotonic()
    cell.stop()
    assert cell.code == 0
    # Ten seconds after its last heartbeat the lease would end by itself.
    cell.until(lambda: cell.driver.guard.lease_owner == "", 8.0 - (time.monotonic() - ended_s), "the tendons")


def test_a_manager_that_comes_back_keeps_alive_what_is_held(cell: Any) -> None:
    ready(cell)
    held(cell)
    # killed while the outcome is not yet on disk: the next run does not know whether something is held
    client = ActionClient(cell.node, Grasp, "cell/grasp")
    assert "is held" in cell.controller.grasp("egg").reason
    cell.controller.release()
    cell.state(lambda s: s.mode == CellState.IDLE, "mode idle after release")
    goal = client.send_goal_async(Grasp.Goal(product="orange", confirm_lift=True))
    cell.wait(goal, 5.0, "a goal handle")
    cell.state(lambda s: s.mode == CellState.GRASPING, "mode grasping")
    moved = cell.driver.moved
    cell.until(lambda: cell.driver.moved > moved, 5.0, "an order: what follows a grasp's begin on disk")
    assert cell.driver.guard.lease_owner == "grasp_mix_manager"
    cell.stop(signal.SIGKILL)
    cell.until(lambda: cell.driver.guard.lease_owner == "", 10.0, "the lease to end with its owner")
    cell.start(mode=CellState.UNKNOWN)
    cell.until(lambda: cell.driver.guard.lease_owner == "grasp_mix_manager", 10.0, "the lease of the new run")
    beats = cell.driver.guard.heartbeats
    cell.until(lambda: cell.driver.guard.heartbeats > beats + 3, 5.0, "heartbeats")


# --- silence and wrong numbers ---------------------------------------------------------------------------------------


def heard_of_tendons(cell: Any) -> list[tuple[int, str]]:
    """Level and words of the manager's component tendons on /diagnostics; the list grows."""
    said: list[tuple[int, str]] = []

    def on_diagnostics(message: DiagnosticArray) -> None:
        said.extend(
            (one.level[0] if isinstance(one.level, bytes) else int(one.level), one.message)
            for one in message.status
            if one.name == "grasp_mix_manager: tendons"
        )

    cell.node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, RELIABLE)
    return said


def test_a_driver_that_is_still_starting_is_waited_for_and_one_that_ends_is_missed_at_once(cell: Any) -> None:
    said = heard_of_tendons(cell)
    cell.driver.quiet = cell.driver.status_quiet = True
    cell.start(mode=CellState.UNKNOWN)
    cell.until(lambda: bool(said), 10.0, "the first word on the tendons")
    cell.driver.quiet = False
    cell.until(lambda: said[-1][1] == "waiting for the first tendon/status", 8.0, "tendon/status to be waited for")
    cell.driver.status_quiet = False
    cell.until(lambda: said[-1][0] == OK, 10.0, "the driver to be heard")
    assert {level for level, _ in said} == {OK, STALE}, said
    assert said[0] == (STALE, "waiting for the first tendon/state and tendon/status")
    cell.driver.status_quiet = True
    cell.until(lambda: said[-1][0] == ERROR, 10.0, "an error")
    assert said[-1][1] == "expected tendon/status, found none for 1 s; start or check tendon_driver"


def test_a_driver_that_never_comes_is_an_error(cell: Any) -> None:
    said = heard_of_tendons(cell)
    cell.driver.quiet = cell.driver.status_quiet = True
    cell.start(mode=CellState.UNKNOWN)
    cell.until(lambda: bool(said) and said[-1][0] == ERROR, START_S + 10.0, "an error")
    assert said[-1][1] == "expected tendon/state and tendon/status, found none for 1 s; start or check tendon_driver"


@pytest.mark.parametrize(("what", "topic"), [("quiet", "tendon/state"), ("status_quiet", "tendon/status")])
def test_nothing_is_grasped_while_the_driver_is_silent(cell: Any, what: str, topic: str) -> None:
    ready(cell, "lift_window_s:=20.0")
    setattr(cell.driver, what, True)
    cell.state(lambda s: s.mode == CellState.UNKNOWN, "mode unknown")
    for refused in (cell.controller.grasp("orange").reason, cell.swap("pinch", "PI").reason):
        assert "expected tendon/state and tendon/status, found silence" in refused
    setattr(cell.driver, what, False)
    cell.state(lambda s: s.mode == CellState.IDLE, "mode idle")
    lost = grasped(cell, lambda: setattr(cell.driver, what, True))
    assert GRASP_OUTCOMES[lost.outcome] == "ABORTED"
    assert topic in lost.reason
    assert "the fingers hold where they are" in lost.reason


def test_a_grasp_whose_predictor_dies_ends_though_the_driver_goes_on(cell: Any) -> None:
    """Contact is felt as the difference to a prediction: without one nobody knows how hard a product is pressed."""
    ready(cell, "lift_window_s:=20.0")
    lost = grasped(cell, lambda: setattr(cell.driver, "predicts", False))
    assert GRASP_OUTCOMES[lost.outcome] == "ABORTED"
    assert "finger/predicted" in lost.reason


def no_number(message: JointState) -> None:
    message.effort[1] = math.nan


def too_short(message: JointState) -> None:
    message.effort.pop()


def too_long(message: JointState) -> None:
    message.position.append(0.0)


@pytest.mark.parametrize("spoil", [no_number, too_short, too_long])
def test_samples_without_a_number_decide_nothing_and_an_interrupted_grasp_says_so(
    cell: Any, spoil: Callable[[JointState], None]
) -> None:
    ready(cell, "lift_window_s:=1.0")
    every_other = iter(range(10**9))

    def now_and_then(message: JointState) -> None:
        if next(every_other) % 2:
            spoil(message)

    cell.driver.spoil = now_and_then
    held(cell)  # what comes between them is enough
    cell.controller.release()
    cell.state(lambda s: s.mode == CellState.IDLE, "mode idle after release")
    lost = grasped(cell, lambda: setattr(cell.driver, "spoil", spoil))
    assert GRASP_OUTCOMES[lost.outcome] == "ABORTED"
    assert "without a number for every slot were dropped" in lost.reason


def test_one_sample_of_open_fingers_does_not_let_go_of_what_is_held(cell: Any) -> None:
    ready(cell)
    held(cell)
    for _ in range(3):
        cell.driver.publish_state((0.0, 0.0, 0.0))
    refused = cell.controller.grasp("egg")  # answered after these samples were taken
    assert "'orange' is held" in refused.reason
    assert cell.driver.cell.mode == CellState.HOLDING


# --- a full disk -----------------------------------------------------------------------------------------------------


def fill_disk(cell: Any, *, full: bool) -> None:
    """Have the system refuse every byte that the manager would write to a file, or let it write again."""
    _, hard = resource.prlimit(cell.process.pid, resource.RLIMIT_FSIZE)
    resource.prlimit(cell.process.pid, resource.RLIMIT_FSIZE, (0 if full else hard, hard))


def test_a_full_disk_is_a_fault_and_lets_go_of_nothing(cell: Any) -> None:
    ready(cell, "lift_window_s:=1.0")
    result = grasped(cell, lambda: fill_disk(cell, full=True))
    assert GRASP_OUTCOMES[result.outcome] == "GRIPPED", result.reason
    state = cell.state(lambda s: s.mode == CellState.FAULT, "mode fault")
    assert "expected to be able to use it" in state.fault
    assert cell.driver.guard.lease_owner == "grasp_mix_manager", "the hold is kept alive"
    refused = cell.controller.grasp("egg").reason
    assert "could not be written down" in refused
    released = cell.driver.released
    cell.controller.release()
    assert cell.driver.released == released + 1
    fill_disk(cell, full=False)
    state = cell.state(lambda s: s.mode == CellState.IDLE, "mode idle")
    assert (state.gripped, state.fault) == (1, ""), "the grasp was counted when it could be"
    assert cell.process.poll() is None
    assert cell.integrity() == "ok"


def test_hands_get_out_of_a_swap_whose_disk_is_full(cell: Any) -> None:
    cell.start()

    def confirm(step: str, _instruction: str) -> list[str]:
        if step == "remove":
            fill_disk(cell, full=True)
        return []

    result = cell.controller.swap("power", confirm)
    assert result.outcome == SwapFingers.Result.FAILED
    assert "take your hands out" in result.reason
    assert cell.driver.guard.locked
    cell.controller.hands_out()
    cell.until(lambda: not cell.driver.guard.locked, 10.0, "the lock to be released")
    fill_disk(cell, full=False)
    cell.state(lambda s: s.mode == CellState.IDLE and s.fault == "", "mode idle")


def test_a_manager_starts_at_fault_where_it_cannot_write_and_takes_up_its_work_when_it_can(cell: Any) -> None:
    ready(cell)
    held(cell)
    cell.stop(signal.SIGKILL)
    cell.start_with_full_disk()
    state = cell.state(lambda s: s.mode == CellState.FAULT, "mode fault")
    assert state.fault
    assert "could not be written down" in cell.controller.grasp("egg").reason
    fill_disk(cell, full=False)
    state = cell.state(lambda s: s.mode == CellState.IDLE, "mode idle")
    assert [mounted.serial for mounted in state.mounted] == cell.serials("PW")
    cell.stop()
    assert cell.code == 0


def test_a_goal_that_is_cancelled_before_the_tendons_are_owned_moves_nothing(cell: Any) -> None:
    ready(cell)
    client = ActionClient(cell.node, Grasp, "cell/grasp")
    cell.until(client.server_is_ready, 10.0, "cell/grasp")
    cell.driver.guard.take_lease("grasp_mix_manager", duration_s=60.0)  # as an earlier run left it
    moved = cell.driver.moved
    handle = cell.wait(client.send_goal_async(Grasp.Goal(product="orange", confirm_lift=True)), 5.0, "a goal handle")
    cell.wait(handle.cancel_goal_async(), 5.0, "the cancel to be taken")
    cell.driver.guard.end_lease()
    result = cell.wait(handle.get_result_async(), 10.0, "a result").result
    assert GRASP_OUTCOMES[result.outcome] == "ABORTED"
    assert "cancelled by the client before anything moved" in result.reason
    assert cell.driver.moved == moved
