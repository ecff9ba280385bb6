# SPDX-License-Identifier: Apache-2.0
"""friction_rig's side of the emergency stop: it follows safety/state, or serves a stop of its own on a bench alone."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from std_srvs.srv import Trigger

from softgrip_driver.rig.stop_guard import HeardState, StopGuard
from softgrip_driver.tendon.safety import Safety
from softgrip_driver.tendon.safety_store import SafetyStore, SafetyStoreError
from softgrip_interfaces.msg import SafetyState
from softgrip_nodekit import LATCHED, Pings, UrgentServer, duration_clock, steady_timer
from softgrip_time.units import NANOSECONDS

#: Who publishes safety/state.
SOURCE = "tendon_driver"
#: [s] without a publisher of safety/state, or an answer of it, before the stand stops, and between looks
MAX_ABSENCE_S = 1.0
LOOK_PERIOD_S = 0.2


class RigSafety(Protocol):
    """Where the stand learns whether it may move."""

    @property
    def refusal(self) -> str:
        """Why it may not, empty when it may."""

    def close(self) -> None:
        """Stop listening."""


class FollowedSafety:
    """Follows the cell's safety state; ``on_stop`` gets the reason whenever the stand may not move any more."""

    def __init__(self, node: Node, group: CallbackGroup, on_stop: Callable[[str], None]) -> None:
        self._guard = StopGuard(MAX_ABSENCE_S)
        self._node = node
        self._on_stop = on_stop
        node.create_subscription(SafetyState, "safety/state", self._on_state, LATCHED, callback_group=group)
        # A process that stands still stays in the graph for as long as the middleware's lease: 10 s, or 60 s.
        self._source = Pings(
            node,
            [SOURCE],
            LOOK_PERIOD_S,
            MAX_ABSENCE_S,
            now_s=lambda: duration_clock(node).now().nanoseconds / NANOSECONDS,
            callback_group=group,
        )
        self._timer = steady_timer(node, LOOK_PERIOD_S, self._look)

    @property
    def refusal(self) -> str:
        """Why the stand may not move, empty when it may."""
        return self._guard.refusal(time.monotonic())

    def close(self) -> None:
        """Nothing of its own is open."""

    def _on_state(self, message: SafetyState) -> None:
        self._guard.take_state(
            HeardState(bool(message.estop), message.estop_reason, bool(message.locked), message.lock_owner)
        )
        self._check()

    def _look(self) -> None:
        self._source.find_changes()
        self._guard.take_answering(is_answering=not self._source.silent)
        self._guard.take_publishers(self._node.count_publishers("safety/state"), time.monotonic())
        self._check()

    def _check(self) -> None:
        refusal = self.refusal
        if refusal:
            self._on_stop(refusal)


class OwnSafety:
    """A latched stop of the stand's own, for a bench without tendons: rig/stop and rig/stop_reset.

    The stop has a session and thread of its own, and is on disk before it is answered.
    """

    def __init__(
        self,
        node: Node,
        store: SafetyStore,
        group: CallbackGroup,
        on_stop: Callable[[str], None],
        age_refusal: Callable[[], str],
    ) -> None:
        self._on_stop = on_stop
        self._age_refusal = age_refusal
        self._safety = Safety(store)
        node.create_service(Trigger, "rig/stop_reset", self._on_reset, callback_group=group)
        self._urgent = UrgentServer(node, Trigger, "rig/stop", self._serve_stop, self._on_standstill)

    @property
    def refusal(self) -> str:
        """Why the stand may not move, empty when it may."""
        return self._safety.refusal.replace("estop_reset", "rig/stop_reset")

    def close(self) -> None:
        """Stop serving."""
        self._urgent.close()

    def _serve_stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        del request
        self._safety.latch_stop("asked for through the service rig/stop")
        self._on_stop(self.refusal)
        problem = self._safety.persist()
        response.success = not problem
        response.message = f"stopped; {problem or 'rig/stop_reset returns'}"
        return response

    def _on_standstill(self, stood_s: float) -> None:
        if self._safety.latch_standstill(stood_s):
            self._on_stop(self.refusal)
            self._safety.persist()

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        del request
        # It may have been sent before the stop that it would end.
        if refusal := self._age_refusal():
            response.success, response.message = False, refusal
            return response
        try:
            self._safety.reset_stop()
            response.success, response.message = True, "reset; resume the plan to go on"
        except SafetyStoreError as error:
            response.success, response.message = False, str(error)
        return response
