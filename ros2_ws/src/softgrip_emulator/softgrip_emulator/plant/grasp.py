# SPDX-License-Identifier: Apache-2.0
"""Fingers against a product in the grasp plane: contact, friction, lifting, slipping, crushing. SI units.

World coordinates are (along the palm, out of the palm). Pads are rows of points that press on the product's outline
(a rounded rectangle) with a stiffness in series of pad and product; tangentially they stick until Coulomb's limit.
The product moves in the plane, overdamped; it does not turn. While it stands on the table it moves along only. When
the arm lifts (told to, or by itself when the grip has settled) its weight pulls.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from softgrip_emulator.plant.outline import Outline
from softgrip_emulator.plant.pads import Pads
from softgrip_emulator.plant.products import Hand, Product, hand

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from softgrip_emulator.plant.fingers import FingerBank

    Array = NDArray[np.float64]

_GRAVITY: Final = 9.81
_SHAKE: Final = 1.15
"""The arm accelerates: the product weighs this much more than at rest."""
_PAD_STIFFNESS_N_PER_M: Final = 6000.0
_DAMPING_NS_PER_M: Final = 1.5
_RELAXATION: Final = 0.4
"""Share of the implicit step taken: the pads of the other side, not yet touched, are not in its stiffness."""
_SETTLED_S: Final = 0.35
_SETTLED_FORCE_N: Final = 0.25
_SETTLED_RATE_N_PER_S: Final = 1.5
_LOST_WAY_M: Final = 0.030
_HELD_SPEED_M_S: Final = 0.002
_SET_DOWN_PAYOUT_M: Final = 0.002
_FAR_M: Final = 0.006
_NAP_STEPS: Final = 4


@dataclass(frozen=True)
class GraspState:
    """What is so with the product between the fingers."""

    product: str = ""
    touching: bool = False
    held: bool = False
    slipped: bool = False
    crushed: bool = False
    contact_forces_n: tuple[float, ...] = ()


class Grasp:
    """One product (or none) and its contacts with the mounted fingers."""

    def __init__(self, slots: Sequence[str]) -> None:
        self._hand: Hand = hand()
        self._slots = tuple(slots)
        places = [self._hand.slots.get(slot) for slot in slots]
        self._across = np.array([0.0 if p is None else p.across_m for p in places])
        self._count = len(places)
        self.lifts_itself = True
        """Whoever has no arm to command has the product lifted as soon as the grip has settled."""
        self._pads: Pads | None = None
        self._outline: Outline | None = None
        self._product: Product | None = None
        self._name = ""
        self._clear()

    def _clear(self) -> None:
        self._centre = np.zeros(2)
        self._start = np.zeros(2)
        self._velocity = np.zeros(2)
        self._stick: Array | None = None
        self._before: Array | None = None
        self.forces_n = np.zeros(self._count)
        self._lifted = False
        self._slipped = False
        self._crushed = False
        self._settled_s = 0.0
        self._force_before = 0.0
        self._most_wound = 0.0
        self._nap = 0

    # -- what a person or the arm does ---------------------------------------------------------------------------------

    def place(self, product: Product | None, profile: str, offset_m: float = 0.0) -> None:
        """Present a product to the open fingers, or take it away (None)."""
        self._clear()
        self._product = product
        self._name = "" if product is None else product.name
        if product is not None:
            self._outline = Outline(product, self._across, self._hand.finger_width_m)
            along, out = self._hand.presented_at(product, profile)
            self._centre = np.array([along + offset_m, out])
            self._start = self._centre.copy()

    def lift(self) -> None:
        """Raise the arm: from here on whatever does not hold the product leaves it behind."""
        self._lifted = self._product is not None

    def state(self) -> GraspState:
        """Snapshot."""
        total = float(self.forces_n.sum())
        held = self._lifted and total > _SETTLED_FORCE_N and float(np.abs(self._velocity).max()) < _HELD_SPEED_M_S
        return GraspState(
            product=self._name,
            touching=total > 0.05,
            held=held,
            slipped=self._slipped,
            crushed=self._crushed,
            contact_forces_n=tuple(float(force) for force in self.forces_n),
        )

    # -- mechanics -------------------------------------------------------------------------------------------------

    def load(self, bank: FingerBank, wound_m: Array, dt_s: float) -> tuple[Array, Array] | None:
        """Move the product by one step and give what it does to the joints.

        Returns:
            Joint torques [N m], (F, J), closing positive, and their stiffness (F, J, J) [N m/rad]; None when nothing
            touches.
        """
        product = self._product
        if product is None or self._outline is None:
            return None
        if self._nap > 0:
            self._nap -= 1
            return None
        if self._pads is None or self._pads.bank is not bank:
            self._pads = Pads(bank, self._hand, self._slots)
        points, levers = self._pads.points()
        distance, normal = self._outline.distance(points - self._centre)
        nearest = float(distance.min()) if distance.size else 1.0
        if nearest > 0.0:
            self._loosen(nearest, dt_s)
            return None
        pressed = np.minimum(distance, 0.0) * -1.0
        stiffness = self._stiffness(product)
        push = stiffness * pressed
        tangent = np.stack([-normal[..., 1], normal[..., 0]], axis=-1)
        drag, sticks = self._drag(product, points, tangent, push, stiffness, dt_s)
        on_finger = push[..., None] * normal + drag[..., None] * tangent
        self.forces_n = np.sqrt((on_finger.sum(axis=1) ** 2).sum(axis=1))
        self._watch(product, push, wound_m, dt_s)
        self._move_product(push, drag, normal, tangent, stiffness, sticks, dt_s)
        return self._on_joints(levers, on_finger, normal, tangent, pressed > 0.0, sticks, stiffness)

    def _loosen(self, nearest_m: float, dt_s: float) -> None:
        self.forces_n = np.zeros(self._count)
        self._stick = None
        self._before = None
        if nearest_m > _FAR_M and not self._lifted:
            self._nap = _NAP_STEPS
        if self._lifted:
            self._velocity = np.array([0.0, 0.3])
            self._centre = self._centre + self._velocity * dt_s
            self._notice_loss()

    def _stiffness(self, product: Product) -> float:
        softness = 0.15 if self._crushed else 1.0
        of_product = product.stiffness_n_per_m * softness
        return _PAD_STIFFNESS_N_PER_M * of_product / (_PAD_STIFFNESS_N_PER_M + of_product)

    def _drag(
        self, product: Product, points: Array, tangent: Array, push: Array, stiffness: float, dt_s: float
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Tangential force on the finger (F, P) and where it sticks."""
        if self._stick is None or self._before is None:
            self._stick = np.zeros(push.shape)
            moved = np.zeros(points.shape)
        else:
            moved = points - self._before - self._velocity * dt_s
        self._before = points
        self._stick = self._stick + (moved * tangent).sum(axis=2)
        most = product.friction * push / stiffness
        sticks = np.abs(self._stick) <= most
        self._stick = np.clip(self._stick, -most, most)
        return -stiffness * self._stick, sticks & (push > 0.0)

    def _on_joints(
        self,
        levers: Array,
        force: Array,
        normal: Array,
        tangent: Array,
        pressed: NDArray[np.bool_],
        sticks: NDArray[np.bool_],
        stiffness: float,
    ) -> tuple[Array, Array]:
        torque = (levers * force[:, :, None, :]).sum(axis=(1, 3))
        by_normal = (levers * normal[:, :, None, :]).sum(axis=3) * pressed[:, :, None]
        by_tangent = (levers * tangent[:, :, None, :]).sum(axis=3) * sticks[:, :, None]
        matrix = stiffness * (by_normal.transpose(0, 2, 1) @ by_normal + by_tangent.transpose(0, 2, 1) @ by_tangent)
        return torque, matrix

    def _move_product(
        self,
        push: Array,
        drag: Array,
        normal: Array,
        tangent: Array,
        stiffness: float,
        sticks: NDArray[np.bool_],
        dt_s: float,
    ) -> None:
        product = self._product
        assert product is not None
        force = -(push[..., None] * normal + drag[..., None] * tangent).sum(axis=(0, 1))
        n = normal[push > 0.0]
        t = tangent[sticks]
        matrix = stiffness * (n.T @ n + t.T @ t) + np.eye(2) * (_DAMPING_NS_PER_M / dt_s)
        if self._lifted:
            force[1] += product.mass_kg * _GRAVITY * _SHAKE
            change = np.linalg.solve(matrix, force)
        else:
            # The table carries it; it slides along.
            change = np.array([force[0] / matrix[0, 0], 0.0])
        change = np.clip(_RELAXATION * change, -1e-3, 1e-3)
        self._centre = self._centre + change
        self._velocity = change / dt_s
        if self._lifted:
            self._notice_loss()

    def _watch(self, product: Product, push: Array, wound_m: Array, dt_s: float) -> None:
        total = float(push.sum())
        if float(push.sum(axis=1).max()) > product.crush_n:
            self._crushed = True
        wound = float(wound_m.sum())
        self._most_wound = max(self._most_wound, wound)
        if self._most_wound - wound > _SET_DOWN_PAYOUT_M:
            # The fingers open: the arm has set the product down before.
            self._lifted = False
            return
        quiet = abs(total - self._force_before) < _SETTLED_RATE_N_PER_S * dt_s
        self._force_before = total
        self._settled_s = self._settled_s + dt_s if quiet and total > _SETTLED_FORCE_N else 0.0
        if self.lifts_itself and self._settled_s > _SETTLED_S:
            self._lifted = True

    def _notice_loss(self) -> None:
        if self._centre[1] - self._start[1] > _LOST_WAY_M:
            self._slipped = True
            self._lifted = False
            self._product = None
            self._name = ""
            self.forces_n = np.zeros(self._count)
            self._velocity = np.zeros(2)
