# SPDX-License-Identifier: Apache-2.0
"""Cables through a mesh: where they run, how they rub, what pulls them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softgrip_model.friction.laws import FrictionLaw, k_index, law_index
from softgrip_model.gdfe import _core

Array = NDArray[np.float64]
Index = NDArray[np.int32]


@dataclass(frozen=True)
class RoutingPoint:
    """A point of the cable: a weighted mean of nodes that moves with them as a rigid tab would, or fixed in space."""

    position: tuple[float, float, float]
    nodes: Index
    weights: Array


@dataclass(frozen=True, eq=False)
class Cable:
    """A cable through points of the mesh.

    Attributes:
        points: from the first to the anchor.
        friction: law at every point but the anchor (radius in mm, tension in N).
        entry: unit vector from the first point towards the actuator; None: no friction at the first point.
    """

    points: tuple[RoutingPoint, ...]
    friction: FrictionLaw
    entry: tuple[float, float, float] | None = (-1.0, 0.0, 0.0)

    def core(self) -> _core.Cable:
        """Return it as the core takes it."""
        points = []
        for point in self.points:
            fixed = np.zeros(3) if len(point.nodes) else np.array(point.position)
            points.append(_core.CablePoint(point.nodes.tolist(), point.weights.tolist(), fixed))
        return _core.Cable(
            points,
            np.zeros(3) if self.entry is None else np.array(self.entry),
            law_index(self.friction.law),
            k_index(self.friction.k_reading),
            list(self.friction.coefficients),
            self.friction.radius_mm,
        )


@dataclass(frozen=True)
class Drive:
    """What pulls a cable: a length that it is shortened by, or a tension at the actuator [N]."""

    target: float
    by_length: bool = True
