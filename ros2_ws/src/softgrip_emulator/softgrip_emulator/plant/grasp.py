# SPDX-License-Identifier: Apache-2.0
"""Fingers against a product in the grasp plane: contact, friction, lifting, slipping, crushing. SI units.

World coordinates are (along the palm, out of the palm). The mechanics are in src/plant/grasp.hpp.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from softgrip_emulator.plant import _core
from softgrip_emulator.plant.products import GraspWorld, PlantProduct, SlotPlace, hand

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from softgrip_emulator.plant.fingers import FingerBank

    Array = NDArray[np.float64]

_TOUCH_N = 0.05
_OUTLINE_POINTS = 32
_SOMEWHERE = SlotPlace(side=1, along_m=0.0, out_m=0.0, rest_angle_rad=0.7, across_m=0.0)
"""A finger in a slot that the hand does not describe."""


@dataclass(frozen=True)
class GraspState:
    """What is so with the product between the fingers."""

    product: str = ""
    touching: bool = False
    held: bool = False
    slipped: bool = False
    crushed: bool = False
    contact_forces_n: tuple[float, ...] = ()


class PlantGrasp:
    """One product (or none) and its contacts with the mounted fingers."""

    def __init__(self, slots: Sequence[str], seed: int) -> None:
        self._hand: GraspWorld = hand().assembled(seed)
        self._places = places = [self._hand.slots.get(slot, _SOMEWHERE) for slot in slots]
        self._product: PlantProduct | None = None
        self._core = _core.Grasp(
            [(p.along_m, p.out_m, p.side, p.rest_angle_rad, p.across_m) for p in places],
            self._hand.finger_width_m,
            self._hand.palm_m,
        )
        self._name = ""
        self.on_fingers_n: Array = self._core.on_fingers_n()
        """Force of the product on each finger in the world [N], (F, 2); a view that changes with every step."""
        self.forces_n: Array = self._core.forces_n()
        """Its size [N], (F,)."""

    @property
    def lifts_itself(self) -> bool:
        """Whoever has no arm to command has the product lifted as soon as the grip has settled."""
        return self._core.lifts_itself

    @lifts_itself.setter
    def lifts_itself(self, lifts: bool) -> None:
        self._core.lifts_itself = lifts

    # -- what a person or the arm does ---------------------------------------------------------------------------------

    def place(self, product: PlantProduct | None, profile: str, offset_m: float = 0.0) -> None:
        """Present a product to the open fingers, or take it away (None)."""
        self._product = product
        if product is None:
            self._core.take_away()
            self._name = ""
            return
        along, out = self._hand.presented_at(product, profile)
        self._core.place(product, along + offset_m, out)
        self._name = product.name

    def lift(self) -> None:
        """Raise the arm: from here on whatever does not hold the product leaves it behind."""
        self._core.lift()

    def state(self) -> GraspState:
        """Snapshot."""
        forces = tuple(self.forces_n.tolist())
        return GraspState(
            product=self._name if self._core.present else "",
            touching=sum(forces) > _TOUCH_N,
            held=self._core.held,
            slipped=self._core.slipped,
            crushed=self._core.crushed,
            contact_forces_n=forces,
        )

    @property
    def centre_m(self) -> tuple[float, float]:
        """Where the product's centre is, along and out of the palm [m]."""
        return self._core.centre_m

    @property
    def palm_push_n(self) -> float:
        """Force of the palm on the product, out of the palm [N]."""
        return self._core.palm_push_n

    def outline_m(self, slot: int) -> Array:
        """The product's outline in the base frame of a slot's finger [m], (n, 2); n = 0 without a product."""
        if self._product is None or not self._core.present:
            return np.zeros((0, 2))
        # A rounded rectangle: a quarter of a circle about each corner of its core.
        radius = min(self._product.corner_m, 0.5 * self._product.width_m, 0.5 * self._product.height_m)
        core = 0.5 * np.array([self._product.width_m, self._product.height_m]) - radius
        turns = np.linspace(0.0, 2.0 * np.pi, _OUTLINE_POINTS, endpoint=False) + np.pi / _OUTLINE_POINTS
        round_m = np.stack([np.cos(turns), np.sin(turns)], axis=1)
        place = self._places[slot]
        away = np.array(self.centre_m) + np.sign(round_m) * core + radius * round_m - (place.along_m, place.out_m)
        cos, sin = math.cos(place.rest_angle_rad), math.sin(place.rest_angle_rad)
        to_finger = np.array([[place.side * cos, sin], [place.side * sin, -cos]])
        return np.asarray(away @ to_finger.T)

    # -- mechanics -------------------------------------------------------------------------------------------------

    def load(self, bank: FingerBank, wound_m: Array, dt_s: float) -> _core.JointLoad | None:
        """Move the product by one step and give what it does to the joints; None when nothing touches.

        Args:
            bank: the mounted fingers.
            wound_m: cable wound on each spool since mounting [m], (F,).
            dt_s: step [s].
        """
        return self._core.load(bank.core, wound_m, dt_s)
