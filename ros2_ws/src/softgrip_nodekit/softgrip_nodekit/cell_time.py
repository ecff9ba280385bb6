# SPDX-License-Identifier: Apache-2.0
"""How a node lives in the cell's time: the computer's, or with an emulated cell a simulated one that waits for it.

A node of an emulated cell is started with ``use_sim_time`` and with ``lockstep``, the socket of the cell's time server
(softgrip_time). Its executor then follows /clock, and the time runs ahead of the executor by at most `LAG_S`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.timer import Timer

from softgrip_nodekit.errors import StartupError, startup_errors
from softgrip_time import Clock as CellClock
from softgrip_time import Follower, SimulatedClock, WallClock

LOCKSTEP = "lockstep"
USE_SIM_TIME = "use_sim_time"
#: [s] by which the cell's time may run ahead of an executor: less than five periods of tendon/state, which is what a
#: subscription of a sensor stream keeps
LAG_S = 0.04
#: [s] in which an emulated cell that starts at the same time has to be up, and between looks
CELL_WAIT_S, CELL_POLL_S = 60.0, 0.02
#: [s] of the cell's time between two reports of an executor
REPORT_PERIOD_S = 0.02


class CellFollower:
    """Reports a node's progress, for which the cell's time waits; without an emulated cell it does nothing.

    Args:
        node: whose progress it is.
        follows: see `softgrip_time.Follower`.
        lag_s: how far the cell's time may run ahead [s].
    """

    def __init__(self, node: Node, follows: str = "clock", lag_s: float = LAG_S) -> None:
        self._node, self._follows, self._lag_s = node, follows, lag_s
        self._follower: Follower | None = None
        self._has_left = False

    def report(self, epoch_ns: int) -> None:
        """Report that all is done up to a time since the epoch [ns]; the cell's time waits from the first report on.

        Raises:
            OSError: there is no such cell; says what to do.
        """
        path = _lockstep(self._node)
        if not path or self._has_left:
            return
        if self._follower is None:
            self._follower = Follower(Path(path), self._node.get_name(), self._follows, self._lag_s)
        self._follower.report(epoch_ns)

    def leave(self) -> None:
        """Let the cell's time go on without this node."""
        self._has_left = True
        if self._follower is not None:
            self._follower.close()


def join_cell_time(node: Node) -> CellFollower:
    """Declare ``lockstep``; where it is set, the cell's time waits for the node's executor once that has received it.

    Whoever ends the executor calls `CellFollower.leave` then: a driver that lets go of its drives needs the time.

    Raises:
        StartupError: it is set, but the node does not use simulated time.
    """
    text = "socket of the emulated cell's time, which waits for this node; needs use_sim_time; empty = the computer's"
    path = node.declare_parameter(LOCKSTEP, "", ParameterDescriptor(description=text, read_only=True)).value
    if path and not is_simulated(node):
        raise StartupError(f"parameter '{LOCKSTEP}': expected {USE_SIM_TIME} to be true with it, found {path!r} alone")
    follower = CellFollower(node)
    if path:
        node.create_timer(REPORT_PERIOD_S, lambda: follower.report(node.get_clock().now().nanoseconds))
    return follower


def is_simulated(node: Node) -> bool:
    """Whether a node lives in simulated time."""
    return node.has_parameter(USE_SIM_TIME) and bool(node.get_parameter(USE_SIM_TIME).value)


def time_waits_for(node: Node) -> bool:
    """Whether a node lives in the time of an emulated cell, which waits for it."""
    return bool(_lockstep(node))


def cell_clock(node: Node) -> CellClock:
    """Return the clock for what a node's own threads wait for.

    Raises:
        StartupError: there is no such cell; says what to do.
    """
    path = _lockstep(node)
    if not path:
        return WallClock()
    with startup_errors(OSError):
        return SimulatedClock(Path(path), node.get_name())


def await_cell(node: Node) -> None:
    """Wait until the emulated cell is there whose time a node lives in; what is still missing others will name."""
    path = _lockstep(node)
    deadline = time.monotonic() + CELL_WAIT_S
    while path and not Path(path).exists() and time.monotonic() < deadline:
        time.sleep(CELL_POLL_S)


def duration_clock(node: Node) -> Clock:
    """Return the clock for durations of the cell's work: the node's where that is simulated, else the steady one."""
    return node.get_clock() if is_simulated(node) else Clock(clock_type=ClockType.STEADY_TIME)


def duration_timer(node: Node, period: float, callback: Callable[[], None]) -> Timer:
    """Return a timer [s] on the `duration_clock`; what watches for silence takes a `steady_timer` instead."""
    return node.create_timer(period, callback, clock=duration_clock(node))


def _lockstep(node: Node) -> str:
    return str(node.get_parameter(LOCKSTEP).value) if node.has_parameter(LOCKSTEP) else ""


def steady_timer(
    node: Node, period: float, callback: Callable[[], None], callback_group: CallbackGroup | None = None
) -> Timer:
    """Return a timer on the steady clock.

    A timer of `Node.create_timer` follows the node's clock: with ``use_sim_time`` it stands while nobody publishes
    /clock, and a watch that stands finds nothing.

    Args:
        node: that runs it.
        period: [s].
        callback: what is called.
        callback_group: None = the node's default one.
    """
    return node.create_timer(
        period, callback, callback_group=callback_group, clock=Clock(clock_type=ClockType.STEADY_TIME)
    )
