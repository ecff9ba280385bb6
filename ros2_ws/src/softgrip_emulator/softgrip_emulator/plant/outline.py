# SPDX-License-Identifier: Apache-2.0
"""A product's outline in the grasp plane: a rounded rectangle, for each finger as thick as it is where that one is."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from softgrip_emulator.plant.products import Product

    Array = NDArray[np.float64]

_FAR_M: Final = 1.0


class Outline:
    """Rounded rectangle of one product.

    Args:
        product: the item.
        across_m: place of each finger out of the grasp plane [m], (F,).
        finger_width_m: [m]
    """

    def __init__(self, product: Product, across_m: Array, finger_width_m: float) -> None:
        half = np.array([product.width_m, product.height_m]) / 2.0
        edge = np.maximum(np.abs(across_m) - finger_width_m / 2.0, 0.0)
        reach = edge / (product.length_m / 2.0)
        # Away from the middle of a ball a finger meets a smaller cross-section; beyond the end it meets nothing.
        if product.round_in_length:
            shrink = np.sqrt(np.maximum(1.0 - reach**2, 0.0))
        else:
            shrink = np.where(reach < 1.0, 1.0, 0.0)
        self._core_m = (half - product.corner_m) * shrink[:, None, None]
        self._corner_m = product.corner_m * shrink[:, None]
        self._missed = shrink[:, None] <= 0.0

    def distance(self, offset_m: Array) -> tuple[Array, Array]:
        """Signed distance to the outline, (F, P), and outward normal, (F, P, 2).

        Args:
            offset_m: points from the product's centre [m], (F, P, 2).
        """
        from_core = np.abs(offset_m) - self._core_m
        deepest = np.maximum(from_core[..., 0], from_core[..., 1])
        outer = np.maximum(from_core, 0.0)
        length = np.sqrt(outer[..., 0] ** 2 + outer[..., 1] ** 2)
        distance = length + np.minimum(deepest, 0.0) - self._corner_m
        along_axis = (from_core == deepest[..., None]).astype(np.float64)
        inside = (length <= 1e-9)[..., None]
        direction = np.where(inside, along_axis, outer / np.maximum(length, 1e-9)[..., None])
        sign = np.where(offset_m >= 0.0, 1.0, -1.0)
        return np.where(self._missed, _FAR_M, distance), sign * direction
