# SPDX-License-Identifier: Apache-2.0
"""The operator's hands on emulated hardware: set the rig, mount fingers, put a product down.

They are a node of their own, spun by a thread of their own, so that they can be used from any callback of the shift.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import TYPE_CHECKING, TypeVar

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from softgrip_demo.errors import ShiftError
from softgrip_interfaces.srv import MountFingers, PlaceObject, SetRig
from softgrip_nodekit.errors import SuccessResponseT

if TYPE_CHECKING:
    from rclpy.client import Client

Request = TypeVar("Request")

TIMEOUT = 10.0  # [s] for one movement of the hands


class Hands:
    """What a person does beside the cell; every call is one service of the emulated cell, done when it returns.

    Args:
        namespace: of the cell; the process's own arguments are for another node.
    """

    def __init__(self, namespace: str = "/") -> None:
        self._node = Node("operator", namespace=namespace, use_global_arguments=False)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._rig = self._node.create_client(SetRig, "emulator/set_rig")
        self._mount = self._node.create_client(MountFingers, "emulator/mount")
        self._place = self._node.create_client(PlaceObject, "emulator/place_object")
        self._thread = threading.Thread(target=self._spin, name="operator", daemon=True)
        self._thread.start()

    def set_rig(self, angle: float, load: float) -> None:
        """Set the wrap angle [rad] and hang a mass [kg]."""
        self._call(self._rig, SetRig.Request(angle=angle, load=load))

    def mount(self, slots: Sequence[str], serials: Sequence[str], profile: str) -> None:
        """Put fingers of one profile into the slots; empty serials leave a slot empty."""
        profiles = [profile if serial else "" for serial in serials]
        self._call(self._mount, MountFingers.Request(fingers=list(slots), serials=list(serials), profiles=profiles))

    def place(self, product: str) -> None:
        """Put a product between the fingers; an empty name takes it away."""
        self._call(self._place, PlaceObject.Request(product=product, offset=0.0))

    def close(self) -> None:
        """End the thread."""
        self._executor.shutdown(timeout_sec=2.0)
        self._thread.join(timeout=2.0)
        self._node.destroy_node()

    def _call(self, client: Client[Request, SuccessResponseT], request: Request) -> None:
        if not client.wait_for_service(timeout_sec=TIMEOUT):
            raise ShiftError(f"expected the emulated cell's {client.srv_name} within {TIMEOUT:g} s, found none")
        done = threading.Event()
        future = client.call_async(request)
        future.add_done_callback(lambda _: done.set())
        if not done.wait(TIMEOUT):
            raise ShiftError(f"expected an answer of {client.srv_name} within {TIMEOUT:g} s, found none")
        response = future.result()
        if not response.success:
            raise ShiftError(f"{client.srv_name} refused: {response.message}")

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            return


def seat(hands: Hands, step: str, slots: Sequence[str], serials: Sequence[str], profile: str) -> Sequence[str]:
    """Do a step of a swap: take fingers out, or put others in and return their serials."""
    if step == "remove":
        hands.mount(slots, [""] * len(slots), "")
    if step != "insert":
        return ()
    hands.mount(slots, serials, profile)
    return serials
