# SPDX-License-Identifier: Apache-2.0
"""The manager as a client of tendon_driver: close, open, hold, release, home."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rclpy.action import ActionClient
from rclpy.node import Node
from std_srvs.srv import Trigger

from softgrip_cell.grasp.values import Close, Command, Open
from softgrip_interfaces.action import MoveTendon

Ended = Callable[[int, str], None]
Answered = Callable[[bool, str], None]


class DriverLink:
    """One movement at a time; a new command takes the place of the one that is running.

    Every call returns at once; results come back through callbacks in the node's executor. A callback of a movement
    that was replaced or stopped is not called any more.

    Args:
        node: owner of the clients.
        slots: tendon names, in slot order.
        open_speed_m_per_s: for opening [m/s].
    """

    def __init__(self, node: Node, slots: Sequence[str], open_speed_m_per_s: float) -> None:
        self._node = node
        self._slots = tuple(slots)
        self._open_speed = open_speed_m_per_s
        self._move = ActionClient(node, MoveTendon, "tendon/move")
        self._release = node.create_client(Trigger, "tendon/release")
        self._home = node.create_client(Trigger, "tendon/home")
        self._turn = 0
        self._handle: Any = None

    def missing(self) -> list[str]:
        """Return the driver's interfaces that nobody serves."""
        servers = {
            "action tendon/move": self._move.server_is_ready(),
            "service tendon/release": self._release.service_is_ready(),
            "service tendon/home": self._home.service_is_ready(),
        }
        return [name for name, ready in servers.items() if not ready]

    def run(self, command: Command, ended: Ended) -> None:
        """Do what a grasp commands.

        Args:
            command: open, close or hold.
            ended: called with MoveTendon's outcome and reason when a movement ends by itself.
        """
        if isinstance(command, Close):
            tendons = [self._slots[slot] for slot in command.slots]
            self.move(tendons, command.target_m, command.speed_m_per_s, command.tension_limit_n, ended)
        elif isinstance(command, Open):
            self.move(self._slots, 0.0, self._open_speed, 0.0, ended)
        else:
            self.hold()

    def move(
        self, tendons: Sequence[str], target_m: float, speed_m_per_s: float, tension_limit_n: float, ended: Ended
    ) -> None:
        """Move tendons to a pulled length [m]; a tension limit of 0 leaves it to the driver."""
        self.hold()
        turn = self._turn
        goal = MoveTendon.Goal(
            tendons=list(tendons),
            mode=MoveTendon.Goal.LENGTH,
            targets=[float(target_m)] * len(tendons),
            speed=float(speed_m_per_s),
            tension_limit=float(tension_limit_n),
        )

        def on_goal(future: Any) -> None:
            handle = future.result()
            if not handle.accepted:
                if turn == self._turn:
                    ended(MoveTendon.Result.REFUSED, "tendon/move rejected the goal; see the driver's log")
                return
            if turn != self._turn:
                handle.cancel_goal_async()
                return
            self._handle = handle
            handle.get_result_async().add_done_callback(on_result)

        def on_result(future: Any) -> None:
            if turn != self._turn:
                return
            self._handle = None
            result = future.result().result
            ended(result.outcome, result.reason)

        self._move.send_goal_async(goal).add_done_callback(on_goal)

    def hold(self) -> None:
        """Stop the running movement; the driver keeps holding where the tendons are."""
        self._turn += 1
        if self._handle is not None:
            self._handle.cancel_goal_async()
            self._handle = None

    def release(self, answered: Answered) -> None:
        """Let the tendons go slack, slowly."""
        self.hold()
        self._trigger(self._release, answered)

    def home(self, answered: Answered) -> None:
        """Find the zero of the pulled lengths."""
        self.hold()
        self._trigger(self._home, answered)

    @staticmethod
    def _trigger(client: Any, answered: Answered) -> None:
        def on_response(future: Any) -> None:
            response = future.result()
            if response is None:
                answered(False, "the driver went away before it answered")
            else:
                answered(bool(response.success), str(response.message))

        client.call_async(Trigger.Request()).add_done_callback(on_response)
