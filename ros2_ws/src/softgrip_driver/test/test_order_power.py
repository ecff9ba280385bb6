# SPDX-License-Identifier: Apache-2.0
"""An order may take hold of what a lock made slack, but not while a lock or a stop stands, not even for a cycle."""

from __future__ import annotations

import pytest

from softgrip_driver.tendon.gripper import Block, GripperController, Policies
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.loop import BusLoop

LOCK = Block("hands are inside", is_stop=False, lets_go=True)


class Switch:
    """A backend of one switch."""

    tendons = ("a",)

    def __init__(self) -> None:
        self.switched: list[tuple[str, bool]] = []

    def power(self, tendon: str, on: bool) -> None:
        self.switched.append((tendon, on))


@pytest.mark.parametrize(("block", "switched"), [(None, [("a", True)]), (LOCK, [])], ids=["free", "locked"])
def test_an_order_switches_torque_on_only_in_a_free_cell(
    reading, block: Block | None, switched: list[tuple[str, bool]]
) -> None:  # type: ignore[no-untyped-def]
    switch = Switch()
    controller = GripperController({"a": TendonLimits()}, Policies(), block=lambda: block)
    controller.step(0.005, {"a": reading(0.005, 0.0, powered=False)})
    loop = BusLoop(switch, controller, 100.0)  # type: ignore[arg-type]
    loop.call = lambda request, *_, **__: request(controller, 0.01)  # type: ignore[method-assign]  # no thread
    assert loop.order(lambda *_: "asked", power=True) == "asked"
    assert switch.switched == switched
