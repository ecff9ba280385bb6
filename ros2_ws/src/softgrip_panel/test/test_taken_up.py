# SPDX-License-Identifier: Apache-2.0
"""What a panel that was started again knows of what goes on, and can end it."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest
from builtin_interfaces.msg import Time

from softgrip_interfaces.action import CalibrateFriction, SwapFingers
from softgrip_interfaces.msg import FrictionSample, RigProgress, SwapProgress
from softgrip_interfaces.srv import ConfirmStep
from softgrip_panel.model import acts
from softgrip_panel.model.swap import CONFIRMED, HANDS_OUT, STEPS, SwapPhase
from softgrip_panel.nodes.cell_calls import RosCalls
from softgrip_panel.nodes.convert import SWAP_STEPS, rig_progress, swap_progress

pytestmark = pytest.mark.ros


def test_a_measurement_that_waits_for_a_person_can_be_answered_from_its_last_message() -> None:
    samples = [
        FrictionSample(tension_low=2.0, tension_high=high_n, verdict=verdict)
        for high_n, verdict in ((0.0, FrictionSample.REPEAT), (2.5, FrictionSample.ACCEPTED))
    ]
    message = RigProgress(
        running=True, confirmation=True, index=1, total=9, angle=0.87, load=0.6, instruction="Set it.", samples=samples
    )
    view = rig_progress(message)
    assert (view.is_running, view.needs_confirmation, view.instruction) == (True, True, "Set it.")
    assert (view.index, view.total, view.angle_rad, view.load_kg) == (1, 9, 0.87, 0.6)
    assert [(one.verdict, one.ratio) for one in view.points] == [("REPEAT", 0.0), ("ACCEPTED", 1.25)]
    assert (view.message, view.fitted) == ("", "")


def test_the_end_of_a_measurement_and_what_can_be_resumed_are_said() -> None:
    ended = RigProgress(outcome=CalibrateFriction.Result.SUCCEEDED, reason="usable", model="braid")
    assert (rig_progress(ended).message, rig_progress(ended).fitted) == ("SUCCEEDED: usable", "braid")
    assert rig_progress(RigProgress(reason="resume it")).message == "resume it"


def test_the_steps_of_a_swap_have_the_numbers_of_the_interfaces() -> None:
    assert tuple(SWAP_STEPS.values()) == STEPS[:-1]
    for step in (*CONFIRMED, HANDS_OUT):
        assert acts.confirm_step(step, "").call.request["step"] == getattr(ConfirmStep.Request, step.upper())
    assert acts.confirm_step("verify", "").call.request["step"] == ConfirmStep.Request.UNSET


def test_the_progress_of_a_swap_is_said_as_it_is_and_has_no_token() -> None:
    goal = bytes(range(16))
    message = SwapProgress(
        running=True, goal_id=list(goal), finger_set="hook", since=Time(sec=100), step=SwapFingers.Feedback.INSERT,
        instruction="Insert them.", confirmation=True,
    )  # fmt: skip
    view = swap_progress(message, 1000.0)
    assert (view.phase, view.finger_set, view.step) == (SwapPhase.RUNNING, "hook", "insert")
    assert (view.instruction, view.needs_confirmation, view.started_s) == ("Insert them.", True, 1100.0)
    assert (view.goal_id, view.token) == ("000102030405060708090a0b0c0d0e0f", "")
    assert not [name for name in SwapProgress.get_fields_and_field_types() if "token" in name]


def test_the_end_of_a_swap_and_hands_inside_are_told_apart() -> None:
    ended = SwapProgress(outcome=SwapFingers.Result.SUCCEEDED, reason="as recorded")
    view = swap_progress(ended, 0.0)
    assert (view.phase, view.success, view.message, view.goal_id) == (SwapPhase.ENDED, True, "as recorded", "")
    assert math.isnan(view.started_s)
    inside = SwapProgress(outcome=SwapFingers.Result.CANCELLED, step=ConfirmStep.Request.HANDS_OUT, confirmation=True)
    view = swap_progress(inside, 0.0)
    assert (view.phase, view.success, view.is_waiting) == (SwapPhase.HANDS_INSIDE, False, True)
    assert swap_progress(SwapProgress(), 0.0).phase is SwapPhase.NONE


class CancelClient(SimpleNamespace):
    """A client of action_msgs/CancelGoal."""

    def __init__(self, name: str) -> None:
        super().__init__(name=name, asked=[], is_ready=True)

    def service_is_ready(self) -> bool:
        return bool(self.is_ready)

    def call_async(self, request: Any) -> None:
        self.asked.append(request)


def test_a_goal_of_an_earlier_panel_is_cancelled_by_its_action_and_nobody_elses_is() -> None:
    made: list[CancelClient] = []

    def create_client(_kind: Any, name: str) -> CancelClient:
        made.append(CancelClient(name))
        return made[-1]

    calls = RosCalls(SimpleNamespace(create_client=create_client), print, print, lambda *_: (True, ""))  # type: ignore[arg-type]
    for act in acts.EXAMPLES:
        calls.prepare_cancel(act)
    actions = ("cell/grasp", "cell/swap", "rig/calibrate")
    assert [one.name for one in made] == [f"{name}/_action/cancel_goal" for name in actions]
    calls.cancel("calibrate")
    calls.cancel("pull")  # tendon/move is the manager's, too
    assert [len(one.asked) for one in made] == [0, 0, 1]
    (request,) = made[2].asked
    # action_msgs/CancelGoal: "If the goal ID is zero and timestamp is zero, cancel all goals"
    assert not any(request.goal_info.goal_id.uuid)
    assert (request.goal_info.stamp.sec, request.goal_info.stamp.nanosec) == (0, 0)


def test_without_the_actions_server_the_own_goal_is_asked_to_end() -> None:
    client, asked = CancelClient(""), []
    client.is_ready = False
    calls = RosCalls(SimpleNamespace(create_client=lambda *_: client), print, print, lambda *_: (True, ""))  # type: ignore[arg-type]
    calls.prepare_cancel(acts.swap("power"))
    calls._goals["swap"] = SimpleNamespace(cancel_goal_async=lambda: asked.append("swap"))
    calls.cancel("swap")
    assert (asked, client.asked) == (["swap"], [])
