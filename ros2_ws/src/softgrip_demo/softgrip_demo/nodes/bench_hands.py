# SPDX-License-Identifier: Apache-2.0
"""The hands at a cell's first run: a person's, or those of the emulated cell."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

from softgrip_demo.nodes.hands import Hands, seat
from softgrip_demo.products import serials_of
from softgrip_driver.commands.person import Terminal


class BenchHands(Protocol):
    """Does what the cell asks for."""

    def set_rig(self, angle_rad: float, load_kg: float, instruction: str) -> None:
        """Set the wrap angle and hang a mass; done when it returns."""

    def seat(self, step: str, instruction: str) -> Sequence[str]:
        """Do a step of a swap; return the serials of the fingers where it asks for them."""

    def place(self, product: str) -> None:
        """Put a product between the fingers; an empty name takes it away."""

    def close(self) -> None:
        """Nothing more is asked for."""


class PersonHands:
    """Somebody who is asked.

    Args:
        person: who.
        finger_set: that is to be mounted; slots: of the gripper.
    """

    def __init__(self, person: Terminal, finger_set: str, slots: Sequence[str]) -> None:
        self._person = person
        self._serials = serials_of(finger_set, slots)

    def set_rig(self, angle_rad: float, load_kg: float, instruction: str) -> None:
        """Ask for angle and mass."""
        text = instruction or f"Set the rig to {math.degrees(angle_rad):.0f} degrees and hang {load_kg * 1e3:.0f} g"
        self._person.confirm("rig", text)

    def seat(self, step: str, instruction: str) -> Sequence[str]:
        """Ask for a step of a swap."""
        if step != "insert":
            self._person.confirm(f"swap.{step}", instruction)
            return ()
        answer = self._person.ask("swap.serials", f"{instruction}; serials", " ".join(self._serials))
        return answer.replace(",", " ").split()

    def place(self, product: str) -> None:
        """Ask for the product."""
        self._person.confirm(
            "product", f"Put the {product} between the fingers" if product else "Take the product away"
        )

    def close(self) -> None:
        """Nothing to do."""


class EmulatorHands:
    """The services of the emulated cell.

    Args:
        finger_set: that is to be mounted; slots: of the gripper.
        namespace: of the cell.
    """

    def __init__(self, finger_set: str, slots: Sequence[str], namespace: str) -> None:
        self._hands = Hands(namespace)
        self._set, self._slots = finger_set, list(slots)
        self._serials = serials_of(finger_set, slots)

    def set_rig(self, angle_rad: float, load_kg: float, instruction: str) -> None:
        """Set it."""
        del instruction
        self._hands.set_rig(angle_rad, load_kg)

    def seat(self, step: str, instruction: str) -> Sequence[str]:
        """Take fingers out and put others in."""
        del instruction
        return seat(self._hands, step, self._slots, self._serials, self._set)

    def place(self, product: str) -> None:
        """Put it down or take it away."""
        self._hands.place(product)

    def close(self) -> None:
        """End the thread of the hands."""
        self._hands.close()
