# SPDX-License-Identifier: Apache-2.0
"""Emergency stop, reset and lock as services of tendon_driver, and the latched topic safety/state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from std_srvs.srv import Trigger

from softgrip_driver.errors import DriverError
from softgrip_driver.nodes import convert
from softgrip_driver.tendon.gripper import Policies
from softgrip_driver.tendon.loop import BusLoop
from softgrip_driver.tendon.safety import Safety, SafetyRefusal
from softgrip_driver.tendon.safety_store import SafetyRecord, SafetyStore, SafetyStoreError
from softgrip_interfaces.msg import SafetyState
from softgrip_interfaces.srv import AcquireLock, ReleaseLock
from softgrip_nodekit import LATCHED, UrgentServer, callback_errors

NOT_CONNECTED = "the drives are not connected, so nothing holds or moves"


@dataclass(frozen=True)
class Drives:
    """What the services need of the driver.

    Attributes:
        loop: gives the bus loop, None while the drives are not connected.
        may_power: says whether the driver is active, so that a reset may switch torque on.
        age_refusal: says why a request may be older than it looks; empty when it is not.
    """

    loop: Callable[[], BusLoop | None]
    may_power: Callable[[], bool]
    age_refusal: Callable[[], str]


class SafetyServer:
    """Translates between services and a `Safety`; decides nothing.

    The stop has a session, queue and thread of its own: nothing else that the node does delays it.
    """

    def __init__(
        self, node: Node, store: SafetyStore, policies: Policies, drives: Drives, group: CallbackGroup
    ) -> None:
        self._node = node
        self._policies = policies
        self._drives = drives
        self._publisher = node.create_publisher(SafetyState, "safety/state", LATCHED)
        self.safety = Safety(store, self._publish)
        self._publish(self.safety.record)
        node.create_service(Trigger, "estop_reset", self._on_reset, callback_group=group)
        node.create_service(AcquireLock, "tendon/lock", self._on_lock, callback_group=group)
        node.create_service(ReleaseLock, "tendon/unlock", self._on_unlock, callback_group=group)
        self._urgent = UrgentServer(node, Trigger, "estop", self._on_stop, self._on_standstill)

    def close(self) -> None:
        """Stop serving."""
        self._urgent.close()

    def _publish(self, record: SafetyRecord) -> None:
        try:
            stamp = self._node.get_clock().now().to_msg()
            self._publisher.publish(convert.to_safety_state(record, stamp))
        except Exception as error:  # noqa: BLE001  a stop counts whether it can be told or not
            callback_errors(self._node).report(error)

    def _on_stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Stop first, then tell the other nodes, put it on disk, answer: middleware and disk may take their time."""
        del request
        self.safety.latch_stop("asked for through the service estop")
        problems = self._stop()
        policy = self._policies.estop.name.lower()
        response.success = not problems
        response.message = f"stopped ({policy}); {'; '.join(problems) or 'estop_reset returns'}"
        self._node.get_logger().warning(f"emergency stop: {response.message}")
        return response

    def _on_standstill(self, stood_s: float) -> None:
        """Stop where a stop may have been asked for in vain: its request ends with the link to a silent process."""
        reason = self.safety.latch_standstill(stood_s)
        if not reason:
            return
        problems = "".join(f"; {problem}" for problem in self._stop())
        self._node.get_logger().error(f"emergency stop: {reason}; estop_reset returns{problems}")

    def _stop(self) -> list[str]:
        """Do what a latched stop asks for, tell the others, put it on disk; return what could not be done."""
        undone = self._enforce()
        self.safety.announce()
        unwritten = self.safety.persist()
        return [problem for problem in (undone, unwritten and f"{unwritten}; it holds in memory") if problem]

    def _enforce(self) -> str:
        """Do what the state asks for; return what could not be done, empty when all was."""
        loop = self._drives.loop()
        if loop is None or not loop.running:
            return ""
        try:
            return loop.enforce_block()
        except TimeoutError as error:
            return str(error)
        except DriverError:
            return ""  # the loop has just ended, and lets go by itself

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        del request
        # It may have been sent before the stop that it would end.
        if refusal := self._drives.age_refusal():
            response.success, response.message = False, refusal
            return response
        try:
            self.safety.reset_stop()
            loop = self._drives.loop()
            done = NOT_CONNECTED if loop is None else loop.reset(power=self._drives.may_power() and not self._is_locked)
        except (DriverError, TimeoutError) as error:
            response.success, response.message = False, str(error)
            return response
        response.success = True
        response.message = f"{done}; {self.safety.refusal}" if self._is_locked else done
        return response

    @property
    def _is_locked(self) -> bool:
        return self.safety.record.is_locked

    def _on_lock(self, request: AcquireLock.Request, response: AcquireLock.Response) -> AcquireLock.Response:
        try:
            response.token = self.safety.acquire_lock(request.owner, request.reason, request.token)
        except (SafetyRefusal, SafetyStoreError) as error:
            response.success, response.message = False, str(error)
            return response
        undone = self._enforce()
        response.success = not undone
        response.message = f"locked, but keep your hands out: {undone}" if undone else "locked; torque is off"
        return response

    def _on_unlock(self, request: ReleaseLock.Request, response: ReleaseLock.Response) -> ReleaseLock.Response:
        if refusal := self._drives.age_refusal():
            response.success, response.message = False, refusal
            return response
        try:
            response.message = self.safety.release_lock(
                request.token, override_owner=request.override_owner, reason=request.reason
            )
            response.success = True
        except (SafetyRefusal, SafetyStoreError) as error:
            response.success, response.message = False, str(error)
        return response
