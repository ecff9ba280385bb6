# SPDX-License-Identifier: Apache-2.0
"""friction_rig's side of the emergency stop: what it hears of the cell's, and the stop that a bench alone has."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from softgrip_driver.nodes.rig_safety import MAX_ABSENCE_S, FollowedSafety, OwnSafety
from softgrip_driver.tendon.safety_store import SafetyStore, SafetyStoreError
from softgrip_interfaces.msg import SafetyState
from softgrip_nodekit import LATCHED, standstill
from softgrip_testing.free_domains import own_domain
from softgrip_testing.waiting import TEST_TIMEOUT_S, wait_until

pytestmark = pytest.mark.ros


class Bench:
    """A rig's node and a person's, spun by a thread, and what the rig was told."""

    def __init__(self) -> None:
        self.context = Context()
        rclpy.init(args=[], context=self.context)
        self.rig = Node("friction_rig", context=self.context)
        self.person = Node("person", context=self.context)
        self.stops: list[str] = []
        self.age_refusal = ""
        self._closing: list[Callable[[], None]] = []
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.rig)
        self._executor.add_node(self.person)
        self._thread = threading.Thread(target=self._executor.spin)

    def follow(self) -> FollowedSafety:
        safety = FollowedSafety(self.rig, None, self.stops.append)
        self._thread.start()
        return safety

    def own(self, path: Path) -> OwnSafety:
        safety = OwnSafety(self.rig, SafetyStore(path), None, self.stops.append, lambda: self.age_refusal)
        self._closing.append(safety.close)
        if not self._thread.is_alive():
            self._thread.start()
        return safety

    def call(self, name: str) -> Any:
        client = self.person.create_client(Trigger, name)
        assert client.wait_for_service(timeout_sec=TEST_TIMEOUT_S), name
        future = client.call_async(Trigger.Request())
        wait_until(future.done, f"an answer of {name}")
        return future.result()

    def close(self) -> None:
        for close in self._closing:
            close()
        self._executor.shutdown()
        self._thread.join()
        self.rig.destroy_node()
        self.person.destroy_node()
        self.context.try_shutdown()


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setenv("ROS_DOMAIN_ID", own_domain())
    bench = Bench()
    yield bench
    bench.close()


# --- the cell's -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("state", "expected"),
    [
        (SafetyState(estop=True, estop_reason="a person"), "the emergency stop is on (a person)"),
        (SafetyState(locked=True, lock_owner="Ada"), "the cell is locked by Ada"),
    ],
)
def test_a_stop_and_a_lock_of_the_cell_end_a_pull_and_their_end_starts_none(
    bench: Bench, state: SafetyState, expected: str
) -> None:
    publisher = bench.person.create_publisher(SafetyState, "safety/state", LATCHED)
    publisher.publish(SafetyState())
    safety = bench.follow()
    wait_until(lambda: safety.refusal == "")
    publisher.publish(state)
    wait_until(lambda: any(expected in reason for reason in bench.stops))
    assert expected in safety.refusal
    publisher.publish(SafetyState())
    wait_until(lambda: safety.refusal == "")


def test_a_cell_that_is_gone_or_there_twice_stops_the_stand(bench: Bench) -> None:
    publisher = bench.person.create_publisher(SafetyState, "safety/state", LATCHED)
    publisher.publish(SafetyState())
    safety = bench.follow()
    wait_until(lambda: safety.refusal == "")
    second = bench.person.create_publisher(SafetyState, "safety/state", LATCHED)
    wait_until(lambda: any("2 nodes publish safety/state" in reason for reason in bench.stops))
    bench.person.destroy_publisher(second)
    wait_until(lambda: safety.refusal == "")
    bench.person.destroy_publisher(publisher)
    # Well beyond the second that it may be gone, and within what a person would still call at once.
    wait_until(lambda: any("nobody publishes safety/state" in reason for reason in bench.stops), timeout_s=30.0)


def test_a_driver_that_stands_still_stops_the_stand_long_before_the_middleware_misses_it(bench: Bench) -> None:
    goes_on = threading.Event()
    goes_on.set()
    driver = Node("tendon_driver", context=bench.context)

    def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        goes_on.wait(TEST_TIMEOUT_S)
        return response

    driver.create_service(Trigger, "~/ping", answer)
    driver.create_publisher(SafetyState, "safety/state", LATCHED).publish(SafetyState())
    executor = SingleThreadedExecutor(context=bench.context)
    executor.add_node(driver)
    thread = threading.Thread(target=executor.spin)
    thread.start()
    try:
        safety = bench.follow()
        wait_until(lambda: safety.refusal == "")
        time.sleep(3 * MAX_ABSENCE_S)  # it answers: nothing stops
        assert bench.stops == []
        goes_on.clear()
        stood_since = time.monotonic()
        wait_until(lambda: any("does not answer its ping" in reason for reason in bench.stops))
        assert time.monotonic() - stood_since > 0.7 * MAX_ABSENCE_S
        goes_on.set()
        wait_until(lambda: safety.refusal == "")
    finally:
        goes_on.set()
        executor.shutdown()
        thread.join()
        driver.destroy_node()


# --- a bench's own ----------------------------------------------------------------------------------------------------


def test_a_stop_of_its_own_is_told_kept_and_ended_by_its_reset_alone(bench: Bench, tmp_path: Path) -> None:
    file = tmp_path / "stop.yaml"
    safety = bench.own(file)
    assert safety.refusal == ""
    answer = bench.call("rig/stop")
    assert (answer.success, answer.message) == (True, "stopped; rig/stop_reset returns")
    assert bench.stops == [safety.refusal]
    assert "asked for through the service rig/stop" in safety.refusal
    assert "rig/stop_reset" in safety.refusal
    assert "estop_reset" not in safety.refusal, "a service that this bench does not have"
    assert SafetyStore(file).load().is_stopped, "on the disk before it is answered"
    reset = bench.call("rig/stop_reset")
    assert (reset.success, reset.message) == (True, "reset; resume the plan to go on")
    assert safety.refusal == ""
    assert not SafetyStore(file).load().is_stopped


def test_a_reset_that_may_be_older_than_the_stop_ends_nothing(bench: Bench, tmp_path: Path) -> None:
    safety = bench.own(tmp_path / "stop.yaml")
    bench.call("rig/stop")
    bench.age_refusal = "this order may be as old"
    reset = bench.call("rig/stop_reset")
    assert (reset.success, reset.message) == (False, "this order may be as old")
    assert safety.refusal


def test_a_stop_that_cannot_be_written_holds_and_says_so(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise SafetyStoreError("the disk is full")

    safety = bench.own(tmp_path / "stop.yaml")
    with monkeypatch.context() as patch:
        patch.setattr(SafetyStore, "save", refuse)
        answer = bench.call("rig/stop")
        assert not answer.success
        assert answer.message == "stopped; the disk is full"
        assert bench.stops == [safety.refusal]
        assert safety.refusal
        reset = bench.call("rig/stop_reset")
        assert not reset.success
        assert "the disk is full" in reset.message
    assert not SafetyStore(tmp_path / "stop.yaml").load().is_stopped
    assert bench.call("rig/stop").success
    assert SafetyStore(tmp_path / "stop.yaml").load().is_stopped


def test_a_process_that_stood_still_stops_the_stand_for_a_stop_may_be_lost(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    suspended_s = 0.0
    asked: list[float] = []

    def now_s() -> float:
        asked.append(suspended_s)
        return time.monotonic() + suspended_s

    monkeypatch.setattr(standstill, "boot_time_s", now_s)
    file = tmp_path / "stop.yaml"
    safety = bench.own(file)
    wait_until(lambda: len(asked) >= 2)
    assert safety.refusal == ""
    suspended_s = 3600.0
    wait_until(lambda: bool(bench.stops))
    assert safety.refusal
    wait_until(lambda: SafetyStore(file).load().is_stopped, "a stop on the disk", timeout_s=20.0)


def test_its_stop_is_not_served_any_more_once_it_is_closed(bench: Bench, tmp_path: Path) -> None:
    safety = bench.own(tmp_path / "stop.yaml")
    assert "friction_rig_urgent" in [thread.name for thread in threading.enumerate()]
    safety.close()
    assert "friction_rig_urgent" not in [thread.name for thread in threading.enumerate()]
