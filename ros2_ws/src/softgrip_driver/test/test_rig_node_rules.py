# SPDX-License-Identifier: Apache-2.0
"""What friction_rig refuses, stops, keeps and makes active, without a rig: the measurement is scripted."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import rclpy
from std_srvs.srv import Trigger

from softgrip_driver.errors import DriverError, PortLostError, StoppedError
from softgrip_driver.nodes import friction_rig
from softgrip_driver.nodes.friction_rig import FrictionRig
from softgrip_driver.rig.procedure import ProcedurePhase, ProcedureStep
from softgrip_driver.rig.slide import PointVerdict
from softgrip_interfaces.action import CalibrateFriction
from softgrip_interfaces.msg import FrictionModel
from softgrip_model.friction.errors import FrictionError
from softgrip_model.friction.record import ModelVerdict
from softgrip_testing.free_domains import own_domain
from softgrip_testing.waiting import wait_until

pytestmark = pytest.mark.ros
Result = CalibrateFriction.Result
STEP = ProcedureStep(ProcedurePhase.SET_UP, 0, 1, SimpleNamespace(angle=0.2, load=1.0), "hang the weight")  # type: ignore[arg-type]


class GivenGoal(SimpleNamespace):
    """A goal; remembers how it ended."""

    def __init__(self, **fields: Any) -> None:
        super().__init__(request=CalibrateFriction.Goal(**fields), is_cancel_requested=False, ended="")

    def publish_feedback(self, _feedback: Any) -> None:
        pass

    def succeed(self) -> None:
        self.ended = "succeeded"

    def abort(self) -> None:
        self.ended = "aborted"

    def canceled(self) -> None:
        self.ended = "canceled"


class GivenBench:
    """The devices; writes down what is done with them."""

    def __init__(self, done: list[str]) -> None:
        self.stage = self.gauge = None
        self.fails: Exception | None = None
        self._done = done

    @contextmanager
    def measuring(self) -> Iterator[None]:
        yield

    def read_idle(self, _now: float) -> None:
        if self.fails is not None:
            raise self.fails

    def reopen(self) -> None:
        self._done.append("opened again")

    def close(self) -> None:
        self._done.append("closed")


class Rig:
    """The node with scripted devices; ``script`` measures in place of the procedure."""

    def __init__(self) -> None:
        self.node = FrictionRig()
        self.done: list[str] = []
        self.bench = GivenBench(self.done)
        self.node._bench = self.bench  # type: ignore[assignment]
        self.node._active = True
        self.node._safety.close()
        self.node._safety = SimpleNamespace(refusal="", close=lambda: None)  # type: ignore[assignment]
        self.script: Callable[[Any, Any], Any] = lambda *_: self.outcome(ModelVerdict.USABLE)

    def outcome(self, verdict: ModelVerdict, name: str = "measured") -> Any:
        model = replace(self.node._models.get("braid-tpu"), id=name, verdict=verdict)
        return SimpleNamespace(calibration=SimpleNamespace(model=model))

    def calibrate(self, goal: GivenGoal | None = None) -> Any:
        return self.node._on_calibrate(goal or GivenGoal())

    def begin(self, goal: GivenGoal | None = None) -> Callable[[], Any]:
        """Calibrate on a thread of its own; returns what waits for the result."""
        found: list[Any] = []
        thread = threading.Thread(target=lambda: found.append(self.calibrate(goal)), daemon=True)
        thread.start()

        def result() -> Any:
            thread.join(15.0)
            assert found, "expected a result, found a measurement that goes on"
            return found[0]

        return result


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Rig]:
    monkeypatch.setenv("ROS_DOMAIN_ID", own_domain())
    settings = (f"model_dir:={tmp_path / 'models'}", "safety_source:=none", f"safety_file:={tmp_path / 'stop.yaml'}")
    rclpy.init(args=["--ros-args", *(word for setting in settings for word in ("-p", setting))])
    made = Rig()

    class Scripted:
        def __init__(self, _stage: Any, _gauge: Any, operator: Any, clock: Any, *_: Any) -> None:
            self._given = operator, clock

        def run(self, _request: Any, *, resume: bool) -> Any:
            del resume
            made.done.append("measured")
            return made.script(*self._given)

    monkeypatch.setattr(friction_rig, "Procedure", Scripted)
    yield made
    made.node.close()
    made.node.destroy_node()
    rclpy.try_shutdown()


def wait_for_a_person(operator: Any, _clock: Any) -> None:
    operator.confirmed(STEP)


def asks(rig: Rig) -> bool:
    session = rig.node._session
    return session is not None and session._waiting


def inactive(rig: Rig) -> None:
    rig.node._active = False


def without_devices(rig: Rig) -> None:
    rig.node._bench = None


def stopped(rig: Rig) -> None:
    rig.node._safety = SimpleNamespace(refusal="the emergency stop is on", close=lambda: None)  # type: ignore[assignment]


def too_old(rig: Rig) -> None:
    rig.node._order_guard = SimpleNamespace(refusal="this order may be as old")  # type: ignore[assignment]


def without_rig(rig: Rig) -> None:
    rig.node._has_rig = False


@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        (inactive, "expected friction_rig to be active"),
        (without_devices, "expected friction_rig to be active"),
        (stopped, "the emergency stop is on"),
        (too_old, "this order may be as old"),
        (without_rig, "this bench has no rig"),
    ],
)
def test_nothing_is_pulled_where_it_must_not_be_and_the_result_is_no_model(
    rig: Rig, spoil: Callable[[Rig], None], expected: str
) -> None:
    spoil(rig)
    goal = GivenGoal(activate=True)
    result = rig.calibrate(goal)
    assert (result.outcome, goal.ended) == (Result.FAILED, "aborted")
    assert expected in result.reason
    assert result.model.verdict == FrictionModel.DO_NOT_USE
    assert rig.done == []


def test_a_stop_that_comes_while_a_measurement_begins_is_not_lost(rig: Rig) -> None:
    said = iter(["", "the emergency stop is on", *[""] * 100])

    class Safety:
        @property
        def refusal(self) -> str:
            return next(said)

        def close(self) -> None:
            pass

    def run(_operator: Any, clock: Any) -> Any:
        if clock.stopped:
            raise StoppedError("stopped")
        return rig.outcome(ModelVerdict.USABLE)

    rig.node._safety, rig.script = Safety(), run
    result = rig.calibrate()
    assert result.outcome == Result.CANCELLED
    assert "the emergency stop is on" in result.reason


def test_a_stop_ends_the_wait_for_a_person_and_says_why(rig: Rig) -> None:
    rig.script = wait_for_a_person
    goal = GivenGoal()
    result = rig.begin(goal)
    wait_until(lambda: asks(rig))
    rig.node._stop_now("the emergency stop is on")
    assert result().outcome == Result.CANCELLED
    assert "the emergency stop is on; accepted points are kept" in result().reason
    assert goal.ended == "aborted"


def test_a_client_that_cancels_ends_it(rig: Rig) -> None:
    rig.script = wait_for_a_person
    goal = GivenGoal()
    result = rig.begin(goal)
    wait_until(lambda: asks(rig))
    goal.is_cancel_requested = True
    rig.node._on_cancel(None)
    assert (result().outcome, goal.ended) == (Result.CANCELLED, "canceled")
    assert rig.node._session is None
    assert not rig.node.progress._progress.running, "who comes later sees a rig that measures"


def test_whoever_disconnects_stops_first_waits_for_the_end_and_lets_nothing_begin_again(rig: Rig) -> None:
    go_on = threading.Event()

    def run(operator: Any, clock: Any) -> None:
        try:
            wait_for_a_person(operator, clock)
        finally:
            go_on.wait(0.3)  # the stage comes to a stop
            rig.done.append("stage stands")

    rig.script = run
    result = rig.begin()
    wait_until(lambda: asks(rig))
    session = rig.node._session
    assert session is not None
    rig.node.disconnect()
    assert session.ended.is_set(), "else each end of the process waits for two seconds"
    assert rig.done == ["measured", "stage stands", "closed"]
    assert result().outcome == Result.CANCELLED
    assert rig.calibrate().outcome == Result.FAILED
    rig.node._bench = rig.bench  # type: ignore[assignment]
    assert "to be active" in rig.calibrate().reason
    assert rig.done.count("measured") == 1


def test_a_confirmation_is_taken_once_and_only_while_somebody_waits_for_it(rig: Rig) -> None:
    def confirm() -> Any:
        return rig.node._on_confirm(Trigger.Request(), Trigger.Response())

    def run(operator: Any, clock: Any) -> Any:
        wait_for_a_person(operator, clock)
        rig.done.append("confirmed")
        wait_for_a_person(operator, clock)
        return rig.outcome(ModelVerdict.USABLE)

    assert (confirm().success, confirm().message) == (False, "nothing to confirm: no step is waiting")
    rig.script = run
    result = rig.begin()
    wait_until(lambda: asks(rig))
    guard = rig.node._order_guard
    too_old(rig)
    assert (confirm().success, confirm().message) == (False, "this order may be as old")
    assert asks(rig)
    rig.node._order_guard = guard
    assert confirm().success
    wait_until(lambda: "confirmed" in rig.done)
    wait_until(lambda: asks(rig))
    assert confirm().success
    assert result().outcome == Result.SUCCEEDED
    assert not confirm().success


def judged(index: int, verdict: PointVerdict) -> Any:
    numbers = ("tension_low", "tension_high", "stddev", "stick_slip", "drift", "window_start", "window_end")
    slide = SimpleNamespace(**dict.fromkeys(numbers, 1.0), verdict=verdict, reason="")
    return SimpleNamespace(plan_id="p", index=index, point=STEP.point, slide=slide, speed=0.001)


def test_only_points_that_were_accepted_at_last_are_in_the_result(rig: Rig) -> None:
    rejected = next(verdict for verdict in PointVerdict if verdict is not PointVerdict.ACCEPTED)

    def run(operator: Any, _clock: Any) -> Any:
        for index, verdict in ((0, PointVerdict.ACCEPTED), (1, rejected), (2, PointVerdict.ACCEPTED), (2, rejected)):
            operator.judged(judged(index, verdict))
        return rig.outcome(ModelVerdict.USABLE)

    rig.script = run
    assert [sample.index for sample in rig.calibrate().samples] == [0]


@pytest.mark.parametrize("verdict", list(ModelVerdict))
@pytest.mark.parametrize("activate", [True, False])
def test_a_model_is_active_where_it_is_usable_and_that_was_asked_for(
    rig: Rig, verdict: ModelVerdict, activate: bool
) -> None:
    rig.script = lambda *_: rig.outcome(verdict)
    result = rig.calibrate(GivenGoal(activate=activate))
    assert (result.outcome, result.model.id) == (Result.SUCCEEDED, "measured")
    assert (rig.node._active_id == "measured") is (activate and verdict is ModelVerdict.USABLE)
    assert rig.node._models.get("measured").verdict is verdict


@pytest.mark.parametrize("error", [DriverError("the gauge is gone"), FrictionError("no fit"), OSError("disk is full")])
def test_a_measurement_that_failed_is_no_success(rig: Rig, error: Exception) -> None:
    def run(*_: Any) -> None:
        raise error

    rig.script, goal = run, GivenGoal()
    result = rig.calibrate(goal)
    assert (result.outcome, goal.ended) == (Result.FAILED, "aborted")
    assert str(error) in result.reason
    rig.script = lambda *_: rig.outcome(ModelVerdict.USABLE)
    assert rig.calibrate().outcome == Result.SUCCEEDED, "and the next one begins"


def test_a_lost_device_is_opened_again_and_one_that_refuses_is_not(rig: Rig) -> None:
    rig.bench.fails = DriverError("the gauge is saturated")
    rig.node._look()
    assert rig.done == []
    rig.bench.fails = PortLostError("the gauge is gone")
    rig.node._look()
    assert rig.done == ["opened again"]


def test_a_model_that_is_not_there_is_not_active(rig: Rig) -> None:
    activate = friction_rig.ActivateFrictionModel
    answer = rig.node._on_activate(activate.Request(id="nothing"), activate.Response())
    assert not answer.success
    assert "nothing" in answer.message
    assert rig.node._active_id == "braid-tpu"
    assert rig.node._on_activate(activate.Request(id="twine-pla"), activate.Response()).success
    assert rig.node._active_id == "twine-pla"
