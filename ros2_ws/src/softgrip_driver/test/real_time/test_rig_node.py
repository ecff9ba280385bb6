# SPDX-License-Identifier: Apache-2.0
"""friction_rig as a process of its own, on an emulated rig, guided by an action client that plays the person."""

from __future__ import annotations

import gc
import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from softgrip_driver.tendon.safety_store import SafetyStoreError, check_port_is_free_to_move
from softgrip_emulator.rig import EmulatedRig
from softgrip_interfaces.action import CalibrateFriction
from softgrip_interfaces.msg import FrictionModel, FrictionSample, RigProgress, SafetyState
from softgrip_interfaces.srv import ActivateFrictionModel, ListFrictionModels
from softgrip_model.friction.published import published_ids
from softgrip_nodekit import LATCHED, RELIABLE, SENSOR, nanoseconds
from softgrip_testing.free_domains import own_domain

pytestmark = pytest.mark.ros
#: Rig seconds a second: quick, and 3 mm of sliding still last long enough to be sampled by a busy machine.
SCALE = 20.0
GOAL: dict[str, Any] = {
    "plan": "custom",
    "angles": [0.17, 0.17, 0.87, 1.57, 1.57],
    "loads": [0.2, 1.0, 0.6, 0.2, 1.0],
    "cable": "PE braid",
    "surface": "TPU",
    "cable_radius": 0.000125,
    "surface_radius": 0.003,
    "activate": True,
}


class Person(Node):
    """Sets what the rig asks for, confirms, and listens."""

    def __init__(self, rig: EmulatedRig) -> None:
        super().__init__("person")
        self.rig = rig
        self.obeys = True
        self.waits_at = ""
        self.steps: list[Any] = []
        self.samples: list[FrictionSample] = []
        self.active: list[FrictionModel] = []
        self.wrenches = 0
        self.create_subscription(FrictionSample, "rig/sample", self.samples.append, RELIABLE)
        self.create_subscription(FrictionModel, "friction/active", self.active.append, LATCHED)
        self.create_subscription(WrenchStamped, "load_cell/wrench", self._on_wrench, SENSOR)
        self.safety = self.create_publisher(SafetyState, "safety/state", LATCHED)
        self.safety.publish(SafetyState())
        self._confirm = self.create_client(Trigger, "rig/confirm")
        self._calibrate = ActionClient(self, CalibrateFriction, "rig/calibrate")
        self.executor_ = SingleThreadedExecutor()
        self.executor_.add_node(self)
        self.process: subprocess.Popen[str] | None = None

    def start(self, folder: Path, *parameters: str) -> subprocess.Popen[str]:
        given = [
            "autostart:=true",
            f"stage_port:={folder / 'stand'}",
            f"gauge_port:={folder / 'gauge'}",
            f"model_dir:={folder / 'models'}",
            f"time_scale:={SCALE}",
            *parameters,
        ]
        settings = [argument for parameter in given for argument in ("-p", parameter)]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "softgrip_driver.nodes.friction_rig", "--ros-args", *settings],
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "ROS_HOME": str(folder)},  # where a stop of its own is kept
        )
        return self.process

    def stop(self) -> int:
        assert self.process is not None
        self.process.send_signal(signal.SIGINT)
        self.process.communicate(timeout=60)
        return self.process.returncode

    def kill(self) -> None:
        """Kill the node, and wait until what it served is seen to be gone: a goal sent before is lost with it."""
        assert self.process is not None
        process, self.process = self.process, None
        process.kill()
        process.communicate(timeout=60)
        self.until(lambda: not self._calibrate.server_is_ready(), "rig/calibrate to be gone")

    def until(self, condition: Callable[[], bool], expected: str, seconds: float = 60.0) -> None:
        deadline = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < deadline, f"expected {expected}"
            assert self.process is None or self.process.poll() is None, "friction_rig ended"
            self.executor_.spin_once(timeout_sec=0.01)

    def call(self, kind: Any, name: str, request: Any) -> Any:
        client = self.create_client(kind, name)
        self.until(client.service_is_ready, name)
        future = client.call_async(request)
        self.until(future.done, f"an answer of {name}")
        return future.result()

    def goal(self, **changes: Any) -> Any:
        """Send a goal; return its handle."""
        self.until(self._calibrate.server_is_ready, "rig/calibrate")
        self.until(self._confirm.service_is_ready, "rig/confirm")
        goal = CalibrateFriction.Goal(**(GOAL | changes))
        future = self._calibrate.send_goal_async(goal, feedback_callback=self._on_feedback)
        self.until(future.done, "the goal's acceptance")
        return future.result()

    def result(self, handle: Any) -> Any:
        future = handle.get_result_async()
        self.until(future.done, "a result", 60.0)
        return future.result().result

    def _on_feedback(self, message: Any) -> None:
        step = message.feedback
        self.steps.append(step)
        waits = bool(self.waits_at) and self.waits_at in step.instruction
        if step.phase == CalibrateFriction.Feedback.SET_UP and self.obeys and not waits:
            self.do(step)

    def do(self, step: Any) -> None:
        """Set what a step asks for, and confirm."""
        self.rig.set(step.angle, step.load)
        self._confirm.call_async(Trigger.Request())

    def _on_wrench(self, _: WrenchStamped) -> None:
        self.wrenches += 1


@pytest.fixture
def person(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Person]:
    monkeypatch.setenv("ROS_DOMAIN_ID", own_domain())
    rclpy.init()
    with EmulatedRig(seed=4, time_scale=SCALE).open_ports(tmp_path) as rig:
        person = Person(rig)
        yield person
        if person.process is not None and person.process.poll() is None:
            person.process.kill()
            person.process.communicate(timeout=60)
        person.executor_.shutdown(timeout_sec=1.0)
        person.destroy_node()
    rclpy.try_shutdown()
    del person
    # What DDS still has to say goodbye to would hold this process up later, and the next rig in it with it.
    gc.collect()


@pytest.mark.slow
def test_a_guided_calibration_gives_an_active_model(person: Person, tmp_path: Path) -> None:
    person.start(tmp_path)
    person.until(lambda: bool(person.active), "the first active model")
    assert person.active[0].id == "braid-tpu"
    result = person.result(person.goal())
    assert result.outcome == CalibrateFriction.Result.SUCCEEDED, result.reason
    assert result.model.verdict in {FrictionModel.USABLE, FrictionModel.DO_NOT_USE, FrictionModel.REPEAT_POINTS}
    assert len(result.samples) == 5
    assert len(result.model.covariance) == 16
    assert result.model.points == 5
    assert all(sample.verdict == FrictionSample.ACCEPTED for sample in result.samples)
    assert person.wrenches > 50
    if result.model.verdict == FrictionModel.USABLE:
        person.until(lambda: person.active[-1].id == result.model.id, "the new model to become active")

    listed = person.call(ListFrictionModels, "friction/list", ListFrictionModels.Request())
    assert [model.id for model in listed.models] == [result.model.id, *published_ids()]
    assert 0.0 <= listed.ages[0] < 300.0
    answer = person.call(ActivateFrictionModel, "friction/activate", ActivateFrictionModel.Request(id="twine-pla"))
    assert answer.success
    person.until(lambda: person.active[-1].id == "twine-pla", "the chosen model to become active")
    since_ns = [nanoseconds(model.activated) for model in person.active]
    assert since_ns[0] > 0
    assert since_ns == sorted(set(since_ns))
    answer = person.call(ActivateFrictionModel, "friction/activate", ActivateFrictionModel.Request(id="nothing"))
    assert not answer.success
    assert "available" in answer.message
    idle = person.call(Trigger, "rig/confirm", Trigger.Request())
    assert not idle.success
    assert person.stop() == 0
    assert person.rig.plant.velocity == 0.0


@pytest.mark.slow
def test_cancelling_keeps_what_was_measured_and_resuming_goes_on(person: Person, tmp_path: Path) -> None:
    person.start(tmp_path)
    handle = person.goal()
    person.until(lambda: len(person.samples) >= 2, "two points")
    person.obeys = False
    cancelled = handle.cancel_goal_async()
    person.until(cancelled.done, "the cancellation")
    result = person.result(handle)
    assert result.outcome == CalibrateFriction.Result.CANCELLED
    assert "resume" in result.reason
    person.obeys = True
    person.steps.clear()
    result = person.result(person.goal(resume=True))
    assert result.outcome == CalibrateFriction.Result.SUCCEEDED, result.reason
    asked = {step.index for step in person.steps if step.phase == 0 and step.load > 0.0}
    assert 0 not in asked
    assert result.model.points == 5


def late_progress(person: Person) -> list[RigProgress]:
    """What rig/progress says to somebody who comes now; filled as messages come."""
    found: list[RigProgress] = []
    person.create_subscription(RigProgress, "rig/progress", found.append, LATCHED)
    person.until(lambda: bool(found), "rig/progress")
    return found


@pytest.mark.slow
def test_who_comes_late_knows_where_the_measurement_stands_and_goes_on_with_it(person: Person, tmp_path: Path) -> None:
    person.start(tmp_path)
    person.waits_at = "the wrap angle to 49.8473"  # 0.87 rad: the third point
    handle = person.goal()
    person.until(lambda: len(person.samples) == 2 and person.steps[-1].index == 2, "the third point to be asked for")
    seen = late_progress(person)
    waiting = seen[-1]
    assert (waiting.running, waiting.confirmation, waiting.index, waiting.total) == (True, True, 2, 5)
    assert (waiting.angle, waiting.load) == (0.87, 0.6)
    assert waiting.instruction == person.steps[-1].instruction
    assert [sample.tension_high for sample in waiting.samples] == [sample.tension_high for sample in person.samples]
    refused = person.result(person.goal())
    assert refused.outcome == CalibrateFriction.Result.FAILED
    assert seen[-1].confirmation  # a goal that was refused beside it changes nothing
    person.waits_at = ""
    person.do(waiting)
    person.until(lambda: not seen[-1].confirmation, "the confirmation to be taken")
    result = person.result(handle)
    person.until(lambda: not seen[-1].running, "the end")
    assert (seen[-1].outcome, seen[-1].model) == (CalibrateFriction.Result.SUCCEEDED, result.model.id)
    assert len(seen[-1].samples) >= 5


@pytest.mark.slow
def test_a_rig_that_was_killed_says_which_plan_can_be_resumed(person: Person, tmp_path: Path) -> None:
    person.start(tmp_path)
    assert late_progress(person)[-1] == RigProgress(header=late_progress(person)[-1].header)  # nothing was measured
    person.goal()
    person.until(lambda: len(person.samples) >= 2, "two points")
    person.kill()
    person.start(tmp_path)
    progress = late_progress(person)
    person.until(lambda: bool(progress[-1].reason), "the broken plan")
    assert not progress[-1].running
    assert re.search(r"plan \S+-custom was broken off after \d points: resume it", progress[-1].reason)


def test_a_model_that_the_disk_cannot_hold_is_in_the_result_with_the_reason(person: Person, tmp_path: Path) -> None:
    process = person.start(tmp_path)
    person.waits_at = "zero is checked"
    handle = person.goal()
    person.until(lambda: bool(person.steps) and person.waits_at in person.steps[-1].instruction, "the last step", 60.0)
    (plan,) = (tmp_path / "models" / "plans").iterdir()
    # No file of the process may grow beyond what the plan's last line needs: the model's is larger.
    maximum = plan.stat().st_size + 100
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (maximum, maximum))
    person.do(person.steps[-1])
    result = person.result(handle)
    assert result.outcome == CalibrateFriction.Result.FAILED
    assert "make room" in result.reason
    assert result.model.points == 5
    assert not list((tmp_path / "models").glob("*.yaml"))
    assert person.stop() == 0


def test_what_cannot_be_measured_is_refused_with_the_reason(person: Person, tmp_path: Path) -> None:
    person.start(tmp_path)
    result = person.result(person.goal(plan="seven"))
    assert result.outcome == CalibrateFriction.Result.FAILED
    assert "expected one of" in result.reason
    result = person.result(person.goal(resume=True))
    assert "found none" in result.reason
    result = person.result(person.goal(cable_radius=0.0, surface_radius=0.0))
    assert "radii" in result.reason
    assert result.model.verdict == FrictionModel.DO_NOT_USE
    result = person.result(person.goal(law="amontons"))
    assert "amontons" in result.reason


def test_ctrl_c_in_the_middle_of_a_pull_stops_the_stage(person: Person, tmp_path: Path) -> None:
    person.start(tmp_path)
    person.goal()
    person.until(lambda: person.rig.plant.velocity > 0.0, "motion")
    assert person.stop() == 0
    deadline = time.monotonic() + 20.0
    while person.rig.plant.velocity:
        person.rig.plant.advance(person.rig.clock.now_s())
        assert time.monotonic() < deadline, "the stage still moves"


def test_a_missing_device_ends_the_process_with_a_reason(person: Person, tmp_path: Path) -> None:
    process = person.start(tmp_path, "gauge_port:=/nonexistent", "connect_timeout:=0.3")
    _, heard = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "/nonexistent" in heard
    assert "check cable" in heard


# --- the emergency stop -----------------------------------------------------------------------------------------------

STOPS = {
    "stopped": SafetyState(estop=True, estop_reason="a person"),
    "locked": SafetyState(locked=True, lock_owner="manager", lock_reason="hands in the palm"),
}


def pulling(person: Person) -> Any:
    """Start a plan and return its handle once the stand pulls."""
    handle = person.goal()
    person.until(lambda: any(step.phase == CalibrateFriction.Feedback.PULLING for step in person.steps), "a pull")
    return handle


def stands_still(person: Person) -> None:
    """By the truth of the emulated stand: its carriage does not move any more."""
    plant = person.rig.plant

    def still() -> bool:
        before = plant.travel
        for _ in range(20):
            person.executor_.spin_once(timeout_sec=0.01)
        return bool(plant.travel == before)

    person.until(still, "a stand that stands still")


@pytest.mark.parametrize("kind", STOPS)
def test_a_stop_of_the_cell_stops_a_pull_and_nothing_is_pulled_until_it_has_ended(person, tmp_path, kind):
    person.start(tmp_path)
    handle = pulling(person)
    person.safety.publish(STOPS[kind])
    result = person.result(handle)
    assert result.outcome == CalibrateFriction.Result.CANCELLED
    assert {"stopped": "emergency stop is on (a person)", "locked": "locked by manager"}[kind] in result.reason
    stands_still(person)
    refused = person.result(person.goal(resume=True))
    assert refused.outcome == CalibrateFriction.Result.FAILED
    person.safety.publish(SafetyState())
    person.until(lambda: True, "a moment")
    handle = person.goal(resume=True)
    assert person.result(handle).outcome == CalibrateFriction.Result.SUCCEEDED


def test_nothing_is_pulled_before_the_safety_state_was_seen_or_after_its_publisher_has_gone(person, tmp_path):
    person.destroy_publisher(person.safety)
    person.start(tmp_path)
    result = person.result(person.goal())
    assert result.outcome == CalibrateFriction.Result.FAILED
    assert "found none yet; start tendon_driver" in result.reason
    person.safety = person.create_publisher(SafetyState, "safety/state", LATCHED)
    person.safety.publish(SafetyState())

    def begun() -> Any:
        handle = person.goal()
        seen = len(person.steps)
        person.until(lambda: handle.status != 2 or len(person.steps) > seen, "an answer")
        return handle

    handle = begun()
    person.until(lambda: any(step.phase == CalibrateFriction.Feedback.PULLING for step in person.steps), "a pull")
    person.destroy_publisher(person.safety)
    result = person.result(handle)
    assert result.outcome == CalibrateFriction.Result.CANCELLED
    assert "nobody publishes safety/state" in result.reason
    stands_still(person)


def test_a_bench_without_tendons_has_a_stop_of_its_own_that_stays(person, tmp_path, monkeypatch):
    person.start(tmp_path, "safety_source:=none")
    handle = pulling(person)
    assert person.call(Trigger, "rig/stop", Trigger.Request()).success
    assert "rig/stop" in person.result(handle).reason
    stands_still(person)
    person.kill()
    # Whoever moves this stand asks the same file, and so does the node when it keeps its models elsewhere.
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    with pytest.raises(SafetyStoreError, match="an emergency stop"):
        check_port_is_free_to_move(str(tmp_path / "stand"))
    person.start(tmp_path, "safety_source:=none", f"model_dir:={tmp_path / 'others'}")
    assert "rig/stop_reset" in person.result(person.goal()).reason
    person.kill()
    person.start(tmp_path, "safety_source:=none")
    assert "rig/stop_reset" in person.result(person.goal()).reason
    assert person.call(Trigger, "rig/stop_reset", Trigger.Request()).success
    assert person.result(person.goal(resume=True)).outcome == CalibrateFriction.Result.SUCCEEDED
