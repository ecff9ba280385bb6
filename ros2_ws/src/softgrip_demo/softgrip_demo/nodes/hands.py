# SPDX-License-Identifier: Apache-2.0
"""The operator's hands on emulated hardware: set the rig, mount fingers, put a product down."""

from __future__ import annotations

from collections.abc import Sequence

from rclpy.client import Client
from rclpy.task import Future

from softgrip_demo.nodes.link import CellLink
from softgrip_interfaces.srv import MountFingers, PlaceObject, SetRig


class Hands:
    """What a person does beside the cell; every call is one service of the emulated cell."""

    def __init__(self, link: CellLink) -> None:
        self._link = link
        self._rig: Client | None = None

    def set_rig_async(self, angle: float, load: float) -> Future:
        """Set the wrap angle [rad] and hang a mass [kg]; returns at once, so that a callback may ask for it."""
        if self._rig is None:
            self._rig = self._link.node.create_client(SetRig, "emulator/set_rig")
        return self._rig.call_async(SetRig.Request(angle=angle, load=load))

    def mount(self, slots: Sequence[str], serials: Sequence[str], profile: str) -> None:
        """Put fingers of one profile into the slots."""
        request = MountFingers.Request(fingers=list(slots), serials=list(serials), profiles=[profile] * len(slots))
        self._link.call(MountFingers, "emulator/mount", request)

    def place(self, product: str) -> None:
        """Put a product between the fingers; an empty name takes it away."""
        self._link.call(PlaceObject, "emulator/place_object", PlaceObject.Request(product=product, offset=0.0))
