# SPDX-License-Identifier: Apache-2.0
"""The manager as a client of tendon_driver: close, open, hold, release, home; as the owner of the tendons."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from std_srvs.srv import Trigger

from softgrip_cell.grasp.commands import Close, Command, Open, Press
from softgrip_cell.nodes.tendon_lease import TendonLease
from softgrip_interfaces.action import MoveTendon
from softgrip_nodekit import GoalResult, NodeIo, PendingResult, SentGoal, ServiceClient, to_time_message
from softgrip_time.units import to_ns

Answered = Callable[[bool, str], None]


@dataclass(frozen=True)
class MoveEnd:
    """How a movement ended: MoveTendon's outcome and reason, and by tendon how far it was pulled then [m]."""

    outcome: int
    reason: str
    pulled_length_m: Mapping[str, float] = field(default_factory=dict)

    @property
    def is_good(self) -> bool:
        """Whether the tendons went where they were sent, or to the tension limit."""
        return self.outcome in (MoveTendon.Result.REACHED, MoveTendon.Result.TENSION_LIMIT)


Ended = Callable[[MoveEnd], None]


@dataclass
class _Movement:
    """One goal of tendon/move on its way."""

    tendons: frozenset[str]
    ended: Ended
    handle: SentGoal[MoveTendon.Result] | None = None
    stopped: bool = False
    replaced: bool = False


@dataclass(frozen=True)
class MotionLimits:
    """What goes with every order to the driver.

    Attributes:
        open_speed_m_per_s: for opening [m/s].
        tension_limit_n: largest tension asked of the driver, also while fingers open [N].
        order_s: an order that the driver would begin later than this is refused by it [s].
    """

    open_speed_m_per_s: float
    tension_limit_n: float
    order_s: float


class DriverLink:
    """Commands to the driver; a new one takes the place of those that move the same tendons.

    Every call returns at once; results come back through callbacks in the node's executor. The callback of a movement
    that was stopped or replaced by this link is not called any more.

    Args:
        node_io: the node's way to others.
        slots: tendon names, in slot order.
        lease: of these tendons; its token goes with every movement.
        limits: what no movement may exceed.
    """

    def __init__(self, node_io: NodeIo, slots: Sequence[str], lease: TendonLease, limits: MotionLimits) -> None:
        self._node_io = node_io
        #: Names of the tendons, in order.
        self.slots = tuple(slots)
        self.lease = lease
        self._limits = limits
        self._move = node_io.create_action_client(MoveTendon, "tendon/move")
        self._release = node_io.create_client(Trigger, "tendon/release")
        self._home = node_io.create_client(Trigger, "tendon/home")
        self._movements: list[_Movement] = []

    def missing(self) -> list[str]:
        """Return the driver's interfaces that nobody serves."""
        servers = {
            "action tendon/move": self._move.server_is_ready(),
            "service tendon/release": self._release.service_is_ready(),
            "service tendon/home": self._home.service_is_ready(),
        }
        return [name for name, ready in servers.items() if not ready] + self.lease.missing()

    def run(self, command: Command, ended: Ended) -> None:
        """Do what a grasp commands.

        Args:
            command: open, close, press or stop.
            ended: called when a movement ends by itself.
        """
        if isinstance(command, Close):
            tendons = [self.slots[slot] for slot in command.slots]
            self.move(tendons, command.targets_m, command.speed_m_per_s, command.tension_limit_n, ended)
        elif isinstance(command, Open):
            self.open(self._limits.open_speed_m_per_s, ended)
        elif isinstance(command, Press):
            tendons = [self.slots[slot] for slot in command.slots]
            limit_n = self._limits.tension_limit_n  # of LENGTH only, but never 0
            self._send(tendons, MoveTendon.Goal.TENSION, command.tensions_n, command.speed_m_per_s, limit_n, ended)
        else:
            self.hold()

    def move(
        self,
        tendons: Sequence[str],
        targets_m: Sequence[float],
        speed_m_per_s: float,
        tension_limit_n: float,
        ended: Ended,
    ) -> None:
        """Move tendons to pulled lengths [m]; they stop at the tension limit [N]."""
        self._send(tendons, MoveTendon.Goal.LENGTH, targets_m, speed_m_per_s, tension_limit_n, ended)

    def open(self, speed_m_per_s: float, ended: Ended) -> None:
        """Let every finger go back to straight."""
        targets_m = [0.0] * len(self.slots)
        self.move(self.slots, targets_m, speed_m_per_s, self._limits.tension_limit_n, ended)

    def _send(
        self,
        tendons: Sequence[str],
        mode: int,
        targets: Sequence[float],
        speed_m_per_s: float,
        tension_limit_n: float,
        ended: Ended,
    ) -> None:
        # The driver lets a new movement take the place of a running one by itself: cancelling that one first would let
        # go of the tension in between.
        for running in self._movements:
            running.replaced = running.replaced or bool(running.tendons & set(tendons))
        movement = _Movement(frozenset(tendons), ended)
        self._movements.append(movement)
        goal = MoveTendon.Goal(
            tendons=list(tendons),
            mode=mode,
            targets=[float(target) for target in targets],
            speed=float(speed_m_per_s),
            tension_limit=float(tension_limit_n),
            lease=self.lease.token,
            deadline=to_time_message(self._node_io.now_ns() + to_ns(self._limits.order_s)),
        )

        def on_result(future: PendingResult[GoalResult[MoveTendon.Result]]) -> None:
            result = future.result().result
            pulled_length_m = dict(zip(result.tendons, result.pulled_lengths, strict=False))
            self._finish(movement, MoveEnd(result.outcome, result.reason, pulled_length_m))

        def on_goal(future: PendingResult[SentGoal[MoveTendon.Result]]) -> None:
            handle = future.result()
            if not handle.accepted:
                why = "tendon/move rejected the goal; see the driver's log"
                self._finish(movement, MoveEnd(MoveTendon.Result.REFUSED, why))
            elif movement.stopped:
                handle.cancel_goal_async()
            else:
                movement.handle = handle
                handle.get_result_async().add_done_callback(on_result)

        self._move.send_goal_async(goal).add_done_callback(on_goal)

    def _finish(self, movement: _Movement, end: MoveEnd) -> None:
        if movement in self._movements:
            self._movements.remove(movement)
        if not movement.stopped and not movement.replaced:
            movement.ended(end)

    def hold(self) -> None:
        """Stop every running movement; the driver keeps holding where the tendons are."""
        for movement in self._movements:
            movement.stopped = True
            if movement.handle is not None:
                movement.handle.cancel_goal_async()
        self._movements.clear()

    def release(self, answered: Answered) -> None:
        """Let the tendons go slack, slowly."""
        self.hold()
        self._trigger(self._release, answered)

    def home(self, answered: Answered) -> None:
        """Find the zero of the pulled lengths."""
        self.hold()
        self._trigger(self._home, answered)

    @staticmethod
    def _trigger(client: ServiceClient[Trigger.Request, Trigger.Response], answered: Answered) -> None:
        def on_response(future: PendingResult[Trigger.Response | None]) -> None:
            response = future.result()
            if response is None:
                answered(False, "the driver went away before it answered")
            else:
                answered(bool(response.success), str(response.message))

        client.call_async(Trigger.Request()).add_done_callback(on_response)
