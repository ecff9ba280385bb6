# SPDX-License-Identifier: Apache-2.0
"""One gripper goal at a time, whichever of control_msgs' two actions it came by; a newer goal ends an older one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from rclpy.task import Future

from softgrip_cell.errors import RefusedError
from softgrip_cell.gripper.goal_monitor import GoalEnd, GoalMonitor, GoalSettings
from softgrip_cell.gripper.orders import GripperGoal, TendonOrder
from softgrip_cell.nodes.driver_link import DriverLink, Ended, MoveEnd
from softgrip_interfaces.action import Grasp
from softgrip_nodekit import GoalResult, NodeIo, PendingResult, SentGoal

#: The driver's movement is over, and not because of anything that the goal has to know.
_GRASP_ENDS: Final = {Grasp.Result.GRIPPED: GoalEnd.STALLED, Grasp.Result.EMPTY: GoalEnd.REACHED}


@dataclass(frozen=True)
class GripperSample:
    """The gripper at one instant: opening [m], its speed [m/s], largest tendon tension [N]."""

    time_s: float
    position_m: float
    velocity_m_s: float
    effort_n: float


@dataclass(frozen=True)
class GoalOutcome:
    """How a goal ended: by its flags, or for a reason that has none (then `end` is None)."""

    end: GoalEnd | None
    reason: str
    sample: GripperSample | None


@dataclass(eq=False)
class _RunningGoal:
    goal: GripperGoal
    done: Future[GoalOutcome]
    monitor: GoalMonitor | None = None
    grasp: SentGoal[Grasp.Result] | None = None  # the goal sent to cell/grasp

    def finish(self, outcome: GoalOutcome) -> None:
        if not self.done.done():
            self.done.set_result(outcome)


class GripperServer:
    """Runs goals: owns the tendons, orders, and watches until the goal has ended.

    Args:
        io: the node's clocks and clients.
        driver: the tendons.
        settings: when a goal has ended.
        order_of: turns a goal into the order that the mounted fingers need; raises RefusedError.
        product_of: returns the product to grasp for a goal, "" where tendons are just moved.
    """

    def __init__(
        self,
        io: NodeIo,
        driver: DriverLink,
        settings: GoalSettings,
        order_of: Callable[[GripperGoal], TendonOrder],
        product_of: Callable[[GripperGoal], str],
    ) -> None:
        self._driver = driver
        self._settings = settings
        self._order_of = order_of
        self._product_of = product_of
        self._grasp = io.create_action_client(Grasp, "cell/grasp")
        self._running: _RunningGoal | None = None
        self.sample: GripperSample | None = None

    @property
    def is_active(self) -> bool:
        """Whether a goal is going on."""
        return self._running is not None

    async def run(self, goal: GripperGoal) -> GoalOutcome:
        """Run a goal to its end; a goal that is running ends first, as the goal that another one replaced."""
        self.end("replaced by a newer goal")
        running = self._running = _RunningGoal(goal, Future())
        product = self._product_of(goal)
        if product:
            self._start_grasp(running, product)
        else:
            self._own_and_move(running)
        outcome = await running.done
        if self._running is running:
            self._running = None
        return outcome

    def end(self, reason: str) -> None:
        """End the running goal from outside; nothing is ordered by that."""
        if self._running is not None:
            running, self._running = self._running, None
            if running.grasp is not None:
                running.grasp.cancel_goal_async()
            running.finish(GoalOutcome(None, reason, self.sample))

    def hold(self, reason: str) -> None:
        """End the running goal and stop; the fingers stay where they are."""
        self.end(reason)
        self._driver.hold()

    def observe(self, sample: GripperSample) -> None:
        """Take the gripper's state; a goal ends with it."""
        self.sample = sample
        running = self._running
        if running is None or running.monitor is None:
            return
        end = running.monitor.check(sample.time_s, sample.position_m, sample.velocity_m_s)
        if end is not None:
            running.finish(GoalOutcome(end, "", sample))

    def move(self, order: TendonOrder, ended: Ended) -> None:
        """Send an order to the tendons, which have to be owned."""
        slots = self._driver.slots
        targets = [order.pulled_length_m] * len(slots)
        self._driver.move(slots, targets, order.speed_m_s, order.tension_limit_n, ended)

    def _own_and_move(self, running: _RunningGoal) -> None:
        def owned(why_not: str) -> None:
            if self._running is not running:
                return
            if why_not:
                self._fail(running, why_not)
                return
            try:
                order = self._order_of(running.goal)
            except RefusedError as error:
                self._fail(running, str(error))
                return
            start_s = self.sample.time_s if self.sample is not None else 0.0
            running.monitor = GoalMonitor(self._settings, running.goal.position_m, start_s)
            self.move(order, lambda end: self._movement_ended(running, end))

        self._driver.lease.acquire(owned)

    def _movement_ended(self, running: _RunningGoal, end: MoveEnd) -> None:
        if not end.is_good:  # else the monitor sees that it reached or stalled
            self._fail(running, f"the driver did not move: {end.reason}")

    def _start_grasp(self, running: _RunningGoal, product: str) -> None:
        def ended(future: PendingResult[GoalResult[Grasp.Result]]) -> None:
            result = future.result().result
            end = _GRASP_ENDS.get(result.outcome)
            running.finish(GoalOutcome(end, result.reason, self.sample))

        def on_goal(future: PendingResult[SentGoal[Grasp.Result]]) -> None:
            sent = future.result()
            if not sent.accepted:
                self._fail(running, "cell/grasp rejected the goal; see the manager's log")
                return
            running.grasp = sent
            sent.get_result_async().add_done_callback(ended)
            if running.done.done():  # ended meanwhile
                sent.cancel_goal_async()

        if not self._grasp.server_is_ready():
            self._fail(running, "expected action cell/grasp, found none; start grasp_mix_manager or set close_by:=move")
            return
        # The manager must own the tendons to grasp.
        self._driver.lease.release()
        goal = Grasp.Goal(product=product, confirm_lift=False, trial=False)
        self._grasp.send_goal_async(goal).add_done_callback(on_goal)

    def _fail(self, running: _RunningGoal, reason: str) -> None:
        running.finish(GoalOutcome(None, reason, self.sample))
