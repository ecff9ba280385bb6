# SPDX-License-Identifier: Apache-2.0
"""Leases as services and topics of tendon_driver: who may command which tendon."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node

from softgrip_driver.errors import DriverError
from softgrip_driver.nodes import convert
from softgrip_driver.nodes.tendon_safety import NOT_CONNECTED
from softgrip_driver.tendon.gripper import GripperController
from softgrip_driver.tendon.loop import BusLoop
from softgrip_driver.tendon.ownership import Lease, LeaseRefusal, OwnerRow
from softgrip_interfaces.msg import LeaseHeartbeat, TendonOwners
from softgrip_interfaces.srv import AcquireLease, ReleaseLease
from softgrip_nodekit import LATCHED, RELIABLE


class LeaseServer:
    """Translates between services and the ownership of the tendons; decides nothing.

    Args:
        node: the driver's.
        loop: gives the bus loop, None while the drives are not connected.
        group: of callbacks that wait for the bus.
    """

    def __init__(self, node: Node, loop: Callable[[], BusLoop | None], group: CallbackGroup) -> None:
        self._node = node
        self._loop = loop
        self._shown: tuple[OwnerRow, ...] | None = None
        self._owners = node.create_publisher(TendonOwners, "tendon/owners", LATCHED)
        node.create_service(AcquireLease, "tendon/lease", self._on_acquire, callback_group=group)
        node.create_service(ReleaseLease, "tendon/lease_release", self._on_release, callback_group=group)
        node.create_subscription(LeaseHeartbeat, "tendon/heartbeat", self._on_heartbeat, RELIABLE, callback_group=group)

    def publish_owners(self, rows: tuple[OwnerRow, ...]) -> None:
        """Publish who owns what, where it has changed."""
        if rows != self._shown:
            self._shown = rows
            self._owners.publish(convert.to_owners(rows, self._node.get_clock().now().to_msg()))

    def _on_acquire(self, request: AcquireLease.Request, response: AcquireLease.Response) -> AcquireLease.Response:
        def acquire(controller: GripperController, now: float) -> Lease:
            lease, taken = controller.ownership.acquire(
                request.owner,
                list(request.tendons),
                request.duration,
                now,
                hand_over=request.hand_over,
                force=request.force,
                reason=request.reason,
            )
            controller.stop_taken(taken, lease, request.reason)
            return lease

        loop = self._loop()
        if loop is None:
            response.message = NOT_CONNECTED
            return response
        try:
            lease = loop.call(acquire)
        except (LeaseRefusal, DriverError, TimeoutError) as error:
            response.message = str(error)
            return response
        response.success, response.token, response.duration = True, lease.token, lease.duration_s
        response.message = (
            f"granted to {lease.owner}; send tendon/heartbeat at least every {lease.duration_s / 3:.2f} s"
        )
        return response

    def _on_release(self, request: ReleaseLease.Request, response: ReleaseLease.Response) -> ReleaseLease.Response:
        loop = self._loop()
        if loop is None:
            response.message = NOT_CONNECTED
            return response
        try:
            ended = loop.call(lambda controller, now: controller.release_lease(request.token, now))
        except (DriverError, TimeoutError) as error:
            response.message = str(error)
            return response
        response.success = bool(ended)
        response.message = (
            f"released: {', '.join(ended)}" if ended else "expected the token of a lease, found none such"
        )
        return response

    def _on_heartbeat(self, message: LeaseHeartbeat) -> None:
        loop = self._loop()
        # A stranger's heartbeats do not keep the bus thread busy.
        if loop is not None and loop.running and loop.is_owner(message.token):
            loop.post(lambda controller, now: controller.ownership.renew(message.token, now))
