# SPDX-License-Identifier: Apache-2.0
"""Cables through a mesh: where they run, how they rub, what pulls them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softgrip_model.friction.laws import FrictionLaw, k_index, law_index
from softgrip_model.gdfe import _core
from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.gdfe.mesh import CORNER_SIGNS, Mesh, shape_slopes

Array = NDArray[np.float64]
Index = NDArray[np.int32]


@dataclass(frozen=True)
class RoutingPoint:
    """A point of the cable: a weighted mean of nodes that moves with them as a rigid tab would, or fixed in space."""

    position: tuple[float, float, float]
    nodes: Index
    weights: Array


@dataclass(frozen=True, eq=False)
class RoutedCable:
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
            *friction_numbers(self.friction),
        )


def friction_numbers(friction: FrictionLaw) -> tuple[int, int, list[float], float]:
    """Return a friction law as the core takes it: law, reading of K, coefficients, radius [mm]."""
    return law_index(friction.law), k_index(friction.k_reading), list(friction.coefficients), friction.radius_mm


@dataclass(frozen=True)
class CableDrive:
    """What pulls a cable: a length that it is shortened by, or a tension at the actuator [N]."""

    target: float
    by_length: bool = True

    def core(self) -> _core.CableDrive:
        """Return it as the core takes it."""
        return _core.CableDrive(by_length=self.by_length, target=self.target)


def guide(position: tuple[float, float, float]) -> RoutingPoint:
    """Return a point that is fixed in space."""
    return RoutingPoint(position, np.zeros(0, dtype=np.int32), np.zeros(0))


def attach(mesh: Mesh, position: tuple[float, float, float]) -> RoutingPoint:
    """Return a point that moves with the hexahedron it lies in.

    Raises:
        GdfeError: the point lies in no hexahedron.
    """
    point = np.array(position)
    slack = 1e-6 * float(np.ptp(mesh.nodes, axis=0).max())
    corners = mesh.nodes[mesh.hexes]
    near = (corners.min(axis=1) <= point + slack).all(axis=1) & (corners.max(axis=1) >= point - slack).all(axis=1)
    for element in np.flatnonzero(near):
        weights = _shares_within(corners[element], point)
        if weights is not None:
            return RoutingPoint(position, mesh.hexes[element].copy(), weights)
    raise GdfeError(f"the point {position} lies in no element of the mesh")


def _shares_within(corners: Array, point: Array) -> Array | None:
    """Return the trilinear shares (8,) of the corners (8, 3) at a point of the hexahedron, None when it is outside."""
    at = np.zeros(3)
    for _ in range(20):
        factors = 1.0 + CORNER_SIGNS * at
        shape = factors.prod(axis=1) / 8.0
        step = np.linalg.solve(corners.T @ shape_slopes(at), point - shape @ corners)
        at = at + step
        if np.abs(step).max() < 1e-12:
            break
    return shape if np.abs(at).max() <= 1.0 + 1e-5 else None
