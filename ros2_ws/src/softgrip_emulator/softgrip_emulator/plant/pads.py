# SPDX-License-Identifier: Apache-2.0
"""Where on the fingers a product can press: pad points on the inner side of every link, and how joints move them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from softgrip_emulator.plant.fingers import FingerBank
    from softgrip_emulator.plant.products import Hand

    Array = NDArray[np.float64]

_ALONG_LINK: Final = np.array([0.3, 0.55, 0.8, 1.0])
_TIP_DEPTH: Final = 0.55
"""Depth of the point at a link's end, where the groove is, as a share of the body's height."""
_NOWHERE_M: Final = 1.0e3


class Pads:
    """Pad points of the fingers of one bank (finger F, point P = 4 a joint, joint J)."""

    def __init__(self, bank: FingerBank, hand: Hand, slots: tuple[str, ...]) -> None:
        self.bank = bank
        places = [hand.slots.get(slot) for slot in slots]
        side = np.array([1.0 if p is None else float(p.side) for p in places])
        rest = np.array([0.7 if p is None else p.rest_angle_rad for p in places])
        self._base = np.array([[0.0, 0.0] if p is None else [p.along_m, p.out_m] for p in places])[:, None, :]
        self._forward = np.stack([side * np.cos(rest), np.sin(rest)], axis=1)
        self._inward = np.stack([-side * np.sin(rest), np.cos(rest)], axis=1)
        self._reach_m = bank.link_m[:, :, None] * _ALONG_LINK
        self._depth_m = np.where(_ALONG_LINK < 1.0, 1.0, _TIP_DEPTH) * bank.body_height_m[:, None, None]
        links, per_link = bank.link_m.shape[1], len(_ALONG_LINK)
        self._unreal = np.repeat(~bank.real_joint, per_link, axis=1)
        beyond = np.repeat(np.arange(links), per_link)[:, None] >= np.arange(links)[None, :]
        self._moved_by = (beyond[None, :, :] & bank.real_joint[:, None, :]).astype(np.float64)

    def points(self) -> tuple[Array, Array]:
        """Pad points in the world [m], (F, P, 2), and how they move with each joint [m/rad], (F, P, J, 2)."""
        joints, heading = self.bank.chain()
        cos, sin = np.cos(heading)[:, :, None], np.sin(heading)[:, :, None]
        x = (joints[:, :-1, None, 0] + self._reach_m * cos - self._depth_m * sin).reshape(len(heading), -1)
        y = (joints[:, :-1, None, 1] - self._reach_m * sin - self._depth_m * cos).reshape(len(heading), -1)
        world = self._base + self._to_world(x, y)
        world[self._unreal] = _NOWHERE_M
        # A joint moves the points on its own link and beyond; turning closes, i.e. (x, y) goes by (y, -x).
        arm_x = (x[:, :, None] - joints[:, None, :-1, 0]) * self._moved_by
        arm_y = (y[:, :, None] - joints[:, None, :-1, 1]) * self._moved_by
        return world, self._to_world(arm_y, -arm_x)

    def _to_world(self, x: Array, y: Array) -> Array:
        """Turn vectors in the fingers' base frames, (F, ...) each, into the world's, (F, ..., 2)."""
        shape = (len(x), *(1,) * (x.ndim - 1), 2)
        return np.asarray(x[..., None] * self._forward.reshape(shape) - y[..., None] * self._inward.reshape(shape))
