# SPDX-License-Identifier: Apache-2.0
"""tendon_driver: the tendon drives as a lifecycle node. Configured = connected and identified, active = may move."""

from __future__ import annotations

import gc
import sys
import threading
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from builtin_interfaces.msg import Time
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from softgrip_driver.autogroup import AUTOGROUP_REMEDY, has_autogroups
from softgrip_driver.configuration import DriverConfiguration, checked_configuration
from softgrip_driver.errors import ConfigurationError, DriverError
from softgrip_driver.nodes import convert
from softgrip_driver.nodes.tendon_health import HealthReport
from softgrip_driver.nodes.tendon_leases import LeaseServer
from softgrip_driver.nodes.tendon_parameters import PARAMETERS
from softgrip_driver.nodes.tendon_safety import Drives, SafetyServer
from softgrip_driver.tendon.backend import TendonBackend
from softgrip_driver.tendon.blocking import block_of, keeps_torque
from softgrip_driver.tendon.gripper import Ticket
from softgrip_driver.tendon.loop import BusLoop, LoopSnapshot
from softgrip_driver.tendon.motions import MoveOutcome
from softgrip_driver.tendon.safety_store import SafetyStore, SafetyStoreError
from softgrip_driver.tendon.session import ZeroKeeper
from softgrip_driver.tendon.zero_store import ZeroStore
from softgrip_interfaces.action import MoveTendon
from softgrip_interfaces.msg import TendonStatusArray
from softgrip_nodekit import (
    RELIABLE,
    SENSOR,
    Diagnostics,
    FatalError,
    HardwareNode,
    HealthMonitor,
    OrderGuard,
    StartupError,
    callback_errors,
    cell_clock,
    claim_name,
    nanoseconds,
    run,
    startup_errors,
    steady_timer,
    to_time_message,
    with_message_info,
)
from softgrip_time import Clock as CellClock
from softgrip_time import WallClock
from softgrip_time.units import NANOSECONDS

if TYPE_CHECKING:
    from rclpy.action.server import ServerGoalHandle
    from rclpy.publisher import Publisher
    from rclpy.subscription import MessageInfo

    _Handle = ServerGoalHandle[MoveTendon.Goal, MoveTendon.Result, MoveTendon.Feedback]

#: [s] for every drive to answer for the first time
FIRST_READING = 2.0
#: [s] between feedback messages of a move
FEEDBACK_PERIOD = 0.1
#: [s] between looks at the health
HEALTH_PERIOD = 0.5
#: [s] between messages of tendon/status at rest
REST_STATUS_PERIOD = 0.2
#: [s] a move may take beyond the time its way needs
MOVE_GRACE = 10.0
#: [s] after which an order that came without a deadline is not obeyed any more
ORDER_LIFETIME_S = 1.0
#: [s] between looks whether the bus loop still runs, and whether the stop is on disk
SUPERVISION_PERIOD_S = 0.5
#: [s] after which a thread that computes gives way to the bus thread; Python's default of 5 ms is a control period
SWITCH_INTERVAL = 0.0005


class TendonDriver(HardwareNode):
    """Translates between messages and the bus loop; decides nothing."""

    def __init__(self) -> None:
        super().__init__("tendon_driver")
        values = PARAMETERS.declare(self)
        with startup_errors(ConfigurationError):
            self._configuration: DriverConfiguration = checked_configuration(values)
        self._status_period = 1.0 / values["status_rate"]
        self._home_on_activate: bool = values["home_on_activate"]
        self._backend: TendonBackend | None = None
        self._loop: BusLoop | None = None
        self._keeper: ZeroKeeper | None = None
        self._publishing: threading.Thread | None = None
        self._active = False
        self._clock_of_cell: CellClock = WallClock()
        #: moves that have begun, until somebody waits for their end
        self._begun: dict[bytes, Ticket | str] = {}
        self._health_nodes: list[str] = [name for name in values["health_nodes"] if name]
        self._monitor: HealthMonitor | None = None
        self._order_guard = OrderGuard(self)
        diagnostics = Diagnostics(self, hardware_id=self._configuration.port)
        self._health = HealthReport(diagnostics)
        self._state_publisher = self.create_publisher(JointState, "tendon/state", SENSOR)
        self._status_publisher = self.create_publisher(TendonStatusArray, "tendon/status", SENSOR)
        self._make_servers()

    def _make_servers(self) -> None:
        # Homing, release and moves wait for the hardware, and may overlap each other.
        waiting = ReentrantCallbackGroup()
        # Moves begin in the order in which they were sent: of two in a row the second is the one that holds.
        orders = MutuallyExclusiveCallbackGroup()
        self.create_service(Trigger, "tendon/home", self._on_home, callback_group=waiting)
        self.create_service(Trigger, "tendon/release", self._on_release, callback_group=waiting)
        configuration = self._configuration
        drives = Drives(lambda: self._loop, lambda: self._active, lambda: self._order_guard.refusal)
        store = SafetyStore(configuration.safety_file)
        self._safety_server = SafetyServer(self, store, configuration.policies, drives, waiting)
        self._safety = self._safety_server.safety
        self._leases = LeaseServer(self, lambda: self._loop, waiting)
        self.create_subscription(
            JointTrajectory,
            "tendon/trajectory",
            with_message_info(self._on_trajectory),
            RELIABLE,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )
        steady_timer(self, SUPERVISION_PERIOD_S, self._supervise)
        self._action = ActionServer(
            self,
            MoveTendon,
            "tendon/move",
            execute_callback=self._execute_move,
            goal_callback=self._on_goal,
            handle_accepted_callback=self._begin_move,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=orders,
        )

    # --- lifecycle -------------------------------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Open the port, identify the devices, check and set them up; torque stays off.

        What the process before left holding when it was killed goes on holding, where the policy says so.
        """
        del state
        configuration = self._configuration
        record = self._safety.record
        if record.is_stopped:
            self.get_logger().warning(f"starts with the emergency stop on: {record.stop_reason}; estop_reset ends it")
        if record.is_locked:
            self.get_logger().warning(f"starts locked by {record.lock_owner} ({record.lock_reason})")
        try:
            clock = self._clock_of_cell = cell_clock(self)
            backend = configuration.drives.backend(self.get_logger().warning, clock)
            with clock.stepping():
                identities = backend.connect(keep_torque=keeps_torque(record, configuration.policies))
        except (DriverError, StartupError) as error:
            return self.fail(str(error))
        for identity in identities:
            self.get_logger().info(f"tendon '{identity.tendon}': {identity.device}")
            for warning in identity.warnings:
                self.get_logger().warning(f"tendon '{identity.tendon}': {warning}")
        controller = configuration.controller(lambda: block_of(self._safety, configuration.policies))
        for tendon in backend.tendons:
            controller.drives[tendon].is_left_holding = backend.is_powered(tendon)
        loop = BusLoop(backend, controller, configuration.loop_rate, clock=clock, rest_stride=configuration.rest_stride)
        loop.start()
        self._backend, self._loop = backend, loop
        self._keeper = ZeroKeeper(ZeroStore(configuration.zero_file), identities, configuration.spools)
        if loop.wait_for(lambda seen: all(drive.time > 0.0 for drive in seen.drives), FIRST_READING) is None:
            counters = backend.counters
            self.disconnect()
            return self.fail(
                f"expected readings of every device that had answered, found {counters.lost} replies lost in "
                f"{counters.transactions} transactions; check cable and supply, and the adapter's latency with selftest"
            )
        self._publishing = threading.Thread(target=self._publish_cycles, args=(loop,), name="publish", daemon=True)
        self._publishing.start()
        self.get_logger().info(f"bus loop: {configuration.loop_rate:g} Hz")
        if has_autogroups() and isinstance(clock, WallClock):
            self.get_logger().info(f"on a busy computer {AUTOGROUP_REMEDY}")
        # What there is by now stays: a full collection of it would stop the bus thread for milliseconds.
        gc.collect()
        gc.freeze()
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Recall zeros that still hold, take hold of the tendons, home where asked to.

        While the emergency stop or a lock stands nothing is powered; estop_reset, or the next order, takes hold.
        """
        loop, keeper = self._loop, self._keeper
        if loop is None or keeper is None:
            return self.fail("not configured")
        try:
            recalled = keeper.recall(loop)
            # An unclean end must be seen by the next process, so this is on disk before torque goes on.
            self._safety.set_armed(armed=True)
            held = loop.take_over()
            if not self._safety.refusal:
                loop.power(on=True)
        except (DriverError, TimeoutError) as error:
            return self.fail(str(error))
        if held:
            self.get_logger().warning(f"goes on holding {', '.join(held)}, as the driver before left them")
        self._active = True
        if self._health_nodes and self._monitor is None:
            self._monitor = HealthMonitor(
                self,
                self._health_nodes,
                on_silent=self._on_silent,
                on_back=self._say_back,
                now_s=self._clock_of_cell.now_s,
            )
        for one in recalled:
            text = f"tendon '{one.tendon}': {one.reason}"
            self.get_logger().info(text if one.valid else f"{text}; call tendon/home")
        unhomed = [one.tendon for one in recalled if not one.valid]
        if unhomed and self._home_on_activate and not self._safety.refusal:
            success, message = self._home(unhomed)
            if not success:
                return self.fail(message)
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let go of the tendons; the readings go on."""
        self._active = False
        if self._loop is not None and self._loop.running:
            self._loop.power(on=False)
            self._disarm()
        self._stop_monitor()
        return super().on_deactivate(state)

    def close(self) -> None:
        """Leave the hardware safe, and end what guards it."""
        self.disconnect()
        self._safety_server.close()

    def _disarm(self) -> None:
        """Note on disk that no drive is left with torque on; where that fails the next process starts stopped."""
        try:
            self._safety.set_armed(armed=False)
        except SafetyStoreError as error:
            self.get_logger().warning(f"{error}; the next start will be stopped until estop_reset")

    def _stop_monitor(self) -> None:
        monitor, self._monitor = self._monitor, None
        if monitor is not None:
            monitor.close()

    def _on_silent(self, name: str) -> None:
        """Stop what moves because a node that the cell needs does not answer; what holds goes on holding."""
        self.get_logger().error(f"node '{name}' has not answered for a second; moving drives stop and hold")
        loop = self._loop
        if loop is not None and loop.running:
            loop.post(lambda controller, _: controller.hold_all(f"node '{name}' does not answer"))

    def _say_back(self, name: str) -> None:
        self.get_logger().info(f"node '{name}' answers again")

    def _supervise(self) -> None:
        """End the process when the bus loop has ended, and put a stop on disk that could not be written at first."""
        loop = self._loop
        if loop is not None and loop.failure is not None:
            raise FatalError(f"the bus loop has ended: {loop.failure!r}")
        self._safety.persist()

    def disconnect(self) -> None:
        """Let go of the drives, or leave them holding where the policy says so, and close the port."""
        self._active = False
        loop, backend = self._loop, self._backend
        if loop is not None and backend is not None:
            loop.stop()
            with loop.clock.stepping():
                backend.disconnect(keep_torque=loop.keeps_hold)
            if loop.has_let_go:
                self._disarm()
        self._loop = self._backend = None
        self._stop_monitor()  # the middleware may take its time: only when the drives are safe
        if self._publishing is not None:
            self._publishing.join(2.0)
            self._publishing = None

    # --- out -------------------------------------------------------------------------------------------------------

    def _publish_cycles(self, loop: BusLoop) -> None:
        """Publish every cycle from a thread of its own, so that middleware never delays the bus."""
        sequence, status_due, health_due, was_resting = 0, 0.0, 0.0, False
        while loop.running:
            for snapshot in loop.since(sequence, 0.5):
                sequence = snapshot.sequence
                stamp = self._stamp(snapshot)
                if not self.context.ok():
                    return
                if not snapshot.port_lost:
                    self._publish(self._state_publisher, convert.to_joint_state(snapshot.drives, stamp))
                if snapshot.time >= status_due or (was_resting and not snapshot.is_resting):
                    rest_s = REST_STATUS_PERIOD if snapshot.is_resting else 0.0
                    status_due = snapshot.time + max(self._status_period, rest_s)
                    self._publish(self._status_publisher, convert.to_status(snapshot, stamp))
                    self._guarded(self._leases.publish_owners, loop.owners)
                was_resting = snapshot.is_resting
                if snapshot.time >= health_due:
                    health_due = snapshot.time + HEALTH_PERIOD
                    self._guarded(self._report, snapshot)
        if loop.failure is not None:
            self.get_logger().fatal(f"the bus loop has ended: {loop.failure!r}")

    def _publish(self, publisher: Publisher, message: object) -> None:
        self._guarded(publisher.publish, message)

    def _guarded(self, call: Callable[..., object], *arguments: object) -> None:
        """Call; what it raises is counted and logged, and readings go on."""
        try:
            call(*arguments)
        except Exception as error:  # noqa: BLE001  a report must not end the readings
            # Ctrl-C shuts the context down under this thread; rclpy has no public name for what publish raises then.
            if self.context.ok():
                callback_errors(self).report(error)

    def _report(self, snapshot: LoopSnapshot) -> None:
        backend = self._backend
        if backend is not None:
            self._health.report_health(snapshot, backend.counters)

    def _stamp(self, snapshot: LoopSnapshot) -> Time:
        """Return when the readings came, since the epoch."""
        return to_time_message(self._clock_of_cell.epoch_ns(snapshot.time))

    # --- in --------------------------------------------------------------------------------------------------------

    def _on_home(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        del request
        response.success, response.message = self._home([])
        return response

    def _home(self, tendons: Sequence[str]) -> tuple[bool, str]:
        def home(loop: BusLoop) -> tuple[bool, str]:
            ticket = loop.order(lambda controller, now: controller.home(now, tendons), power=self._active)
            outcome, reason = self._wait(loop, ticket, self._homing_timeout())
            if outcome is MoveOutcome.REACHED and self._keeper is not None:
                self._keeper.save_zeros(loop, datetime.now(UTC).isoformat(timespec="seconds"))
            return outcome is MoveOutcome.REACHED, reason

        return self._with_loop(home)

    def _on_release(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        del request

        def release(loop: BusLoop) -> tuple[bool, str]:
            ticket = loop.call(lambda controller, now: controller.release(now))
            limits = next(iter(self._configuration.limits.values()))
            outcome, reason = self._wait(loop, ticket, limits.travel / limits.release_speed + MOVE_GRACE)
            return outcome is MoveOutcome.REACHED, reason

        response.success, response.message = self._with_loop(release)
        return response

    def _on_trajectory(self, message: JointTrajectory, info: MessageInfo) -> None:
        def follow(loop: BusLoop) -> tuple[bool, str]:
            if refusal := self._safety.refusal_of_sent(info["source_timestamp"]):
                return False, refusal
            trajectories = convert.from_trajectory(message, self._configuration.limits)
            lease = message.header.frame_id
            ticket = loop.order(lambda controller, now: controller.follow(trajectories, now, lease), power=self._active)
            return not ticket.refusal, ticket.refusal

        accepted, reason = self._with_loop(follow)
        if not accepted:
            self.get_logger().warning(f"trajectory refused: {reason}", throttle_duration_sec=1.0)

    def _on_goal(self, goal: MoveTendon.Goal) -> GoalResponse:
        # Refusals are told in the result, with their reason; a rejected goal could not say why.
        del goal
        return GoalResponse.ACCEPT

    def _begin_move(self, handle: _Handle) -> None:
        self._begun[bytes(handle.goal_id.uuid)] = self._ticket_or_refusal(handle.request)
        handle.execute()

    def _ticket_or_refusal(self, goal: MoveTendon.Goal) -> Ticket | str:
        if self._loop is None or not self._active:
            return "the driver is not active"
        if refusal := self._order_guard.refusal:
            return refusal
        try:
            request = convert.from_move_goal(goal, self._deadline_s(goal.deadline))
            return self._loop.order(lambda controller, now: controller.move(request, now), power=self._active)
        except (DriverError, TimeoutError) as error:
            return str(error) or repr(error)

    def _deadline_s(self, deadline: Time) -> float:
        """Return a deadline since the epoch as the loop's time [s]; one that is not set is a second from now."""
        deadline_ns = nanoseconds(deadline)
        now_s = self._clock_of_cell.now_s()
        if deadline_ns == 0:
            return now_s + ORDER_LIFETIME_S
        return now_s + (deadline_ns - self._clock_of_cell.epoch_ns(now_s)) / NANOSECONDS

    def _execute_move(self, handle: _Handle) -> MoveTendon.Result:
        """Wait for the end of a move that has begun."""
        begun, loop = self._begun.pop(bytes(handle.goal_id.uuid)), self._loop
        if isinstance(begun, str) or loop is None:
            refusal = begun if isinstance(begun, str) else "the driver is not active"
            return self._end(handle, MoveOutcome.REFUSED, refusal, ())
        try:
            outcome, reason = self._wait(loop, begun, self._move_timeout(handle.request.speed), handle)
        except (DriverError, TimeoutError) as error:
            # Whatever it still does must not go on behind the back of a client that was told that it ended.
            loop.post(lambda controller, now: controller.cancel(begun, now))
            return self._end(handle, MoveOutcome.FAULT, f"{error}; it holds where it is", tuple(begun.jobs))
        return self._end(handle, outcome, reason, tuple(begun.jobs))

    def _end(self, handle: _Handle, outcome: MoveOutcome, reason: str, tendons: Sequence[str]) -> MoveTendon.Result:
        if outcome is MoveOutcome.CANCELLED and handle.is_cancel_requested:
            handle.canceled()
        elif outcome in {MoveOutcome.REACHED, MoveOutcome.TENSION_LIMIT}:
            handle.succeed()
        else:
            handle.abort()
        snapshot = self._loop.snapshot if self._loop is not None else None
        drives = [] if snapshot is None else [drive for drive in snapshot.drives if drive.tendon in tendons]
        return convert.to_move_result(outcome, reason, drives)

    # --- waiting ---------------------------------------------------------------------------------------------------

    def _wait(
        self, loop: BusLoop, ticket: Ticket, timeout: float, handle: _Handle | None = None
    ) -> tuple[MoveOutcome, str]:
        """Wait for the end of a request, cycle by cycle; with an action's handle also give feedback and heed cancel."""
        deadline = loop.clock.now_s() + timeout
        sequence, feedback_due, cancelled = 0, 0.0, False
        outcome, reason = loop.call(lambda controller, _: controller.result(ticket))
        while True:
            if outcome is not None:
                return (MoveOutcome.CANCELLED, "cancelled; it holds where it is") if cancelled else (outcome, reason)
            now = loop.clock.now_s()
            if now > deadline:
                loop.call(lambda controller, at: controller.cancel(ticket, at))
                return MoveOutcome.TIMEOUT, f"not done within {timeout:.1f} s; it holds where it is"
            if handle is not None and handle.is_cancel_requested and not cancelled:
                cancelled = True
                loop.call(lambda controller, at: controller.cancel(ticket, at))
            snapshots = loop.since(sequence, 0.5)
            if not snapshots:  # raises where the loop has ended
                outcome, reason = loop.call(lambda controller, _: controller.result(ticket))
                continue
            sequence = snapshots[-1].sequence
            outcome, reason = ticket.result(snapshots[-1].drives)
            if handle is not None and outcome is None and snapshots[-1].time >= feedback_due:
                feedback_due = snapshots[-1].time + FEEDBACK_PERIOD
                drives = [drive for drive in snapshots[-1].drives if drive.tendon in ticket.jobs]
                handle.publish_feedback(convert.to_move_feedback(drives))

    def _with_loop(self, action: Callable[[BusLoop], tuple[bool, str]]) -> tuple[bool, str]:
        loop = self._loop
        if loop is None:
            return False, "not connected; configure and activate the driver"
        if refusal := self._order_guard.refusal:
            return False, refusal
        try:
            success, message = action(loop)
        except (DriverError, TimeoutError) as error:
            return False, str(error) or repr(error)
        return success, message

    def _homing_timeout(self) -> float:
        return max(limits.homing_timeout for limits in self._configuration.limits.values()) + MOVE_GRACE

    def _move_timeout(self, speed: float) -> float:
        limits = next(iter(self._configuration.limits.values()))
        return limits.travel / speed + MOVE_GRACE


class _NamedDriver(TendonDriver):
    """The driver as a process: the only one of its name."""

    def __init__(self) -> None:
        super().__init__()
        self._name_lock = claim_name(self)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    sys.setswitchinterval(SWITCH_INTERVAL)
    return run(_NamedDriver, args, threads=6)


if __name__ == "__main__":
    sys.exit(main())
