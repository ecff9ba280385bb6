# SPDX-License-Identifier: Apache-2.0
"""A node in simulated time: its durations and timers follow /clock, and the time waits for its executor."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
import rclpy
from builtin_interfaces.msg import Time
from rclpy.clock_type import ClockType
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rosgraph_msgs.msg import Clock

from softgrip_emulator.clock import SetClock
from softgrip_emulator.participants import REST_LAG_FACTOR
from softgrip_emulator.time_server import TimeServer
from softgrip_nodekit import (
    SENSOR,
    CellFollower,
    HealthMonitor,
    StartupError,
    cell_clock,
    duration_clock,
    duration_timer,
    join_cell_time,
)
from softgrip_nodekit.cell_time import LAG_S
from softgrip_testing.waiting import TEST_TIMEOUT_S, wait_until
from softgrip_time import SimulatedClock, WallClock

pytestmark = pytest.mark.ros


@pytest.fixture
def context(monkeypatch: pytest.MonkeyPatch) -> Iterator[Context]:
    context = Context()
    rclpy.init(args=[], context=context)
    yield context
    context.try_shutdown()


class Cell:
    """A time server whose time is published."""

    def __init__(self, folder: Path, context: Context, expected: tuple[str, ...] = ()) -> None:
        self.path = folder / "time"
        self.node = Node("cell", context=context)
        publisher = self.node.create_publisher(Clock, "/clock", SENSOR)

        def publish(now_s: float) -> None:
            whole = int(self.server.epoch_s + now_s)
            publisher.publish(Clock(clock=Time(sec=whole, nanosec=int((self.server.epoch_s + now_s - whole) * 1e9))))

        self.server = TimeServer(self.path, SetClock(), list, publish, speed=0.0, expected=expected)
        self.server.open()
        self.server.start()


@pytest.fixture
def cell(tmp_path: Path, context: Context) -> Iterator[Cell]:
    one = Cell(tmp_path, context, expected=("follows",))
    yield one
    one.server.close()
    one.node.destroy_node()


def simulated(context: Context, name: str, path: Path) -> Node:
    return joined(context, name, path)[0]


def joined(context: Context, name: str, path: Path) -> tuple[Node, CellFollower]:
    overrides = [RosParameter("use_sim_time", value=True), RosParameter("lockstep", value=str(path))]
    node = Node(name, context=context, parameter_overrides=overrides)
    return node, join_cell_time(node)


def test_a_node_without_a_cell_lives_in_the_computers_time(context: Context) -> None:
    node = Node("plain", context=context)
    join_cell_time(node)
    assert node.get_parameter("lockstep").value == ""
    assert isinstance(cell_clock(node), WallClock)
    assert duration_clock(node).clock_type == ClockType.STEADY_TIME
    CellFollower(node, "frames").report(0)
    node.destroy_node()


def test_lockstep_needs_simulated_time(context: Context) -> None:
    node = Node("half", context=context, parameter_overrides=[RosParameter("lockstep", value="/run/time")])
    with pytest.raises(StartupError, match="use_sim_time"):
        join_cell_time(node)
    node.destroy_node()


def test_a_cell_that_is_not_there_is_named(context: Context, tmp_path: Path) -> None:
    node = simulated(context, "alone", tmp_path / "time")
    with pytest.raises(StartupError, match="start emulated_cell first"):
        cell_clock(node)
    with pytest.raises(OSError, match="start emulated_cell first"):
        CellFollower(node).report(0)
    node.destroy_node()


def test_the_time_waits_for_an_executor_and_durations_are_its(context: Context, cell: Cell) -> None:
    node = simulated(context, "follows", cell.path)
    go_on, stands, ticks = threading.Event(), threading.Event(), []
    go_on.set()
    durations = duration_clock(node)
    assert durations.clock_type == ClockType.ROS_TIME

    def tick() -> None:
        if not go_on.is_set():
            stands.set()
        go_on.wait(TEST_TIMEOUT_S)
        ticks.append(durations.now().nanoseconds * 1e-9)

    duration_timer(node, 0.05, tick)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    spinning = threading.Thread(target=executor.spin, daemon=True)
    spinning.start()
    wait_until(lambda: cell.server.participants.names() == {"follows"})
    wait_until(lambda: len(ticks) > 100)  # five seconds of the cell
    assert [one.join.lag_s for one in cell.server.participants.all] == [LAG_S]
    # Nobody steps this cell, so it rests, and lags are long. A tick is late by some of them, since in a round of the
    # executor the report may come before it; how busy the computer is does not count.
    assert max(b - a for a, b in pairwise(ticks[20:])) < 0.05 + 4.0 * REST_LAG_FACTOR * LAG_S
    go_on.clear()  # an executor that stands still
    assert stands.wait(TEST_TIMEOUT_S)
    held_s = cell.server.held_s.get("follows (clock)", 0.0)  # a busy computer's executor has held it before, too
    wait_until(lambda: cell.server.held_s.get("follows (clock)", 0.0) > held_s + 0.3)
    stands_s = cell.server.clock.now_s()
    time.sleep(0.2)
    assert cell.server.clock.now_s() == stands_s
    go_on.set()
    wait_until(lambda: cell.server.clock.now_s() > stands_s + 0.5)
    executor.shutdown()
    spinning.join(TEST_TIMEOUT_S)
    node.destroy_node()


def test_the_time_waits_no_more_for_one_that_has_left(context: Context, cell: Cell) -> None:
    """Its executor has ended, and its drives must be let go of in the cell's time."""
    node, follower = joined(context, "follows", cell.path)
    now_s = cell.server.clock.now_s
    follower.report(int((cell.server.epoch_s + now_s()) * 1e9))
    wait_until(lambda: cell.server.held_s.get("follows (clock)", 0.0) > 0.1)
    follower.leave()
    wait_until(lambda: not cell.server.participants.all)
    left_s = now_s()
    wait_until(lambda: now_s() > left_s + 0.5)
    follower.report(int((cell.server.epoch_s + now_s()) * 1e9))  # of a timer that was running
    time.sleep(0.1)
    assert not cell.server.participants.all
    node.destroy_node()


def test_a_driver_steps_with_the_cell(context: Context, cell: Cell) -> None:
    node = simulated(context, "driver", cell.path)
    clock = cell_clock(node)
    assert isinstance(clock, SimulatedClock)
    with clock.stepping():
        clock.wait(clock.now_s() + 0.25)
        assert cell.server.clock.now_s() == clock.now_s()
        assert clock.epoch_ns(clock.now_s()) * 1e-9 == pytest.approx(cell.server.epoch_s + clock.now_s(), abs=1e-5)
    node.destroy_node()


def test_a_node_that_is_only_late_is_not_reported_while_the_cells_time_stands(context: Context) -> None:
    """The peer never answers; by the cell's clock no time passes, by the computer's more than the limit."""
    node = Node("watches", context=context)
    silent: list[str] = []
    now_s = [100.0]
    monitor = HealthMonitor(
        node, ["peer"], 0.01, 0.05, on_silent=silent.append, on_back=lambda _: None, now_s=lambda: now_s[0]
    )
    monitor._asked._watch.take_answer("peer", 100.0)
    time.sleep(0.3)
    assert silent == []
    for _ in range(20):  # in steps that no watcher calls a pause of its own
        now_s[0] += 0.01
        time.sleep(0.03)
    wait_until(lambda: silent == ["peer"])
    monitor.close()
    node.destroy_node()
