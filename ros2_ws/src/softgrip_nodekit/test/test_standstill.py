# SPDX-License-Identifier: Apache-2.0
"""After a standstill nothing that may have been asked before it is obeyed, for as long as that may still arrive."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from rclpy.action import ActionClient, CancelResponse
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from softgrip_interfaces.action import Grasp
from softgrip_nodekit import NodeIo
from softgrip_nodekit import standstill as standstill_module
from softgrip_nodekit.standstill import Standstill, boot_time_s
from softgrip_testing.waiting import TEST_TIMEOUT_S


class Time:
    """A steady time that a test sets."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.asked = 0

    def __call__(self) -> float:
        self.asked += 1
        return self.now_s


@pytest.fixture
def now() -> Time:
    return Time()


@pytest.fixture
def standstill(now: Time) -> Standstill:
    started = Standstill(now)
    started.measure_gap()
    return started


def test_a_node_that_goes_on_all_the_time_refuses_nothing(now: Time, standstill: Standstill) -> None:
    for _ in range(100):
        now.now_s += 1.0
        assert standstill.refusal() == ""
        assert standstill.measure_gap() == 0.0


def test_the_first_one_that_looks_notices_and_orders_are_refused_for_a_second(
    now: Time, standstill: Standstill
) -> None:
    now.now_s += 5.0
    assert "stood still for 5.0 s" in standstill.refusal()
    now.now_s += 0.99
    assert "ask again" in standstill.refusal()
    now.now_s += 0.02
    assert standstill.refusal() == ""


def test_a_timer_that_notices_first_does_not_let_the_orders_behind_it_through(
    now: Time, standstill: Standstill
) -> None:
    now.now_s += 5.0
    assert standstill.measure_gap() == 5.0
    assert standstill.measure_gap() == 0.0
    assert "stood still for 5.0 s" in standstill.refusal()


@pytest.mark.parametrize(("gap_s", "is_refused"), [(1.99, False), (2.01, True)])
def test_an_order_may_wait_for_two_seconds(now: Time, standstill: Standstill, gap_s: float, is_refused: bool) -> None:
    now.now_s += gap_s
    assert bool(standstill.refusal()) is is_refused


def test_what_waited_for_a_node_to_start_is_not_refused(now: Time) -> None:
    starting = Standstill(now)
    now.now_s += 60.0
    assert starting.refusal() == ""
    assert starting.measure_gap() == 0.0
    assert starting.refusal() == ""


def test_the_time_is_steady() -> None:
    first = boot_time_s()
    assert first <= boot_time_s()


# --- a node that is asked ---------------------------------------------------------------------------------------------


class Cell:
    """A node that serves an order and an action, a client of both, and the time that the node's guard sees."""

    def __init__(self, now: Time, lockstep: str) -> None:
        self._now = now
        self._context = Context()
        rclpy.init(args=[], context=self._context)
        self._node = Node("server", context=self._context)
        self._node.declare_parameter("lockstep", lockstep)
        self._peer = Node("client", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._executor.add_node(self._peer)
        self.obeyed: list[str] = []
        io = NodeIo(self._node)
        io.create_order_service(Trigger, "confirm", self._on_confirm)
        io.create_action_server(Grasp, "grasp", self._on_grasp, lambda _: CancelResponse.ACCEPT)
        self._confirm = self._peer.create_client(Trigger, "confirm")
        self._grasp = ActionClient(self._peer, Grasp, "grasp")
        assert self._confirm.wait_for_service(timeout_sec=TEST_TIMEOUT_S)
        assert self._grasp.wait_for_server(timeout_sec=TEST_TIMEOUT_S)
        self.go_on(0.5)

    def _on_confirm(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.obeyed.append("confirm")
        response.success = True
        return response

    async def _on_grasp(self, handle: Any) -> Grasp.Result:
        self.obeyed.append("grasp")
        handle.succeed()
        return Grasp.Result()

    def go_on(self, seconds: float) -> None:
        """Let time pass, and the node look."""
        self._now.now_s += seconds
        looked = self._now.asked
        while self._now.asked == looked:
            self._executor.spin_once(timeout_sec=0.05)

    def confirm(self) -> Trigger.Response:
        return self._wait(self._confirm.call_async(Trigger.Request()))

    def is_grasp_accepted(self) -> bool:
        handle = self._wait(self._grasp.send_goal_async(Grasp.Goal()))
        if handle.accepted:
            self._wait(handle.get_result_async())
        return bool(handle.accepted)

    def _wait(self, future: Any) -> Any:
        self._executor.spin_until_future_complete(future, timeout_sec=TEST_TIMEOUT_S)
        assert future.done()
        return future.result()

    def close(self) -> None:
        self._executor.shutdown()
        self._grasp.destroy()
        self._peer.destroy_node()
        self._node.destroy_node()
        self._context.try_shutdown()


@pytest.fixture
def serve(now: Time, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Cell]]:
    monkeypatch.setattr(standstill_module, "boot_time_s", now)
    made: list[Cell] = []

    def make(lockstep: str = "") -> Cell:
        made.append(Cell(now, lockstep))
        return made[-1]

    yield make
    for cell in made:
        cell.close()


def test_a_node_that_stood_still_obeys_no_order_and_no_goal_until_it_has_gone_on_for_a_second(
    now: Time, serve: Callable[..., Cell]
) -> None:
    cell = serve()
    assert cell.confirm().success
    now.now_s += 5.0
    refused = cell.confirm()
    assert not refused.success
    assert "stood still for 5.0 s" in refused.message
    assert not cell.is_grasp_accepted()
    assert cell.obeyed == ["confirm"]
    cell.go_on(0.6)
    cell.go_on(0.6)
    assert cell.confirm().success
    assert cell.is_grasp_accepted()
    assert cell.obeyed == ["confirm", "confirm", "grasp"]


def test_in_an_emulated_cell_time_waits_so_nothing_is_too_old(now: Time, serve: Callable[..., Cell]) -> None:
    cell = serve(lockstep="/tmp/no/such/socket")
    now.now_s += 5.0
    assert cell.confirm().success
    assert cell.is_grasp_accepted()
