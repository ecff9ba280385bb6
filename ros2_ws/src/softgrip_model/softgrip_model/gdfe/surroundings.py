# SPDX-License-Identifier: Apache-2.0
"""What acts on a mesh from outside: weight, pressure, follower forces, rigid obstacles with friction."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from softgrip_model.gdfe import _core
from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.gdfe.mesh import CORNER_SIGNS, Mesh, shape_slopes

Array = NDArray[np.float64]
Index = NDArray[np.int32]
Vector = tuple[float, float, float]


class ObstacleShape(StrEnum):
    """Rigid bodies that a mesh can touch."""

    PLANE = "plane"
    SPHERE = "sphere"
    CYLINDER = "cylinder"


_SHAPE = {shape: index for index, shape in enumerate(ObstacleShape)}


@dataclass(frozen=True, eq=False)
class Obstacle:
    """A rigid body that nodes of the mesh may touch but not enter.

    Attributes:
        shape: plane, sphere or cylinder (endless).
        point: on the plane, or centre, or on the cylinder's axis.
        nodes: that may touch it; those of `Mesh.surface()` when nothing smaller is known.
        axis: normal of the plane, towards the body; direction of the cylinder; any length but 0.
        radius: of sphere and cylinder.
        friction: Coulomb's coefficient.
    """

    shape: ObstacleShape
    point: Vector
    nodes: Index
    axis: Vector = (0.0, 1.0, 0.0)
    radius: float = 0.0
    friction: float = 0.0

    def __post_init__(self) -> None:
        if not np.isfinite([*self.point, *self.axis]).all() or not np.linalg.norm(self.axis) > 0.0:
            raise GdfeError(f"{self.shape}: expected a finite point and an axis other than 0, found {self}")
        if self.shape is not ObstacleShape.PLANE and not 0.0 < self.radius < np.inf:
            raise GdfeError(f"{self.shape}: expected a radius above 0, found {self.radius!r}")
        if not 0.0 <= self.friction < np.inf:
            raise GdfeError(f"{self.shape}: expected a friction coefficient of 0 or more, found {self.friction!r}")
        if not len(self.nodes):
            raise GdfeError(f"{self.shape}: expected nodes that may touch it, found none")

    def core(self) -> _core.Obstacle:
        """Return it as the core takes it."""
        axis = np.array(self.axis) / np.linalg.norm(self.axis)
        nodes = np.unique(self.nodes).tolist()
        return _core.Obstacle(_SHAPE[self.shape], np.array(self.point), axis, self.radius, self.friction, nodes)


@dataclass(frozen=True, eq=False)
class FollowerPatch:
    """Nodes that carry a force in shares and whose mean rotation turns it.

    Attributes:
        nodes: (k,)
        shares: (k,) of the force, sum 1.
    """

    nodes: Index
    shares: Array

    def __post_init__(self) -> None:
        if len(self.nodes) < 3 or abs(float(self.shares.sum()) - 1.0) > 1e-9:
            raise GdfeError(
                f"follower force: expected three nodes or more and shares of sum 1, found {len(self.nodes)} nodes "
                f"and {float(self.shares.sum()):g}"
            )

    @classmethod
    def of_faces(cls, mesh: Mesh, quads: Index) -> FollowerPatch:
        """Return the patch that spreads a force evenly over faces (f, 4)."""
        nodes = np.unique(quads)
        return cls(nodes, face_shares(mesh.nodes, quads)[nodes])

    def core(self) -> _core.FollowerPatch:
        """Return it as the core takes it."""
        return _core.FollowerPatch(self.nodes.tolist(), self.shares.tolist())


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Everything around a mesh; how strongly it acts is said with every solve (`Acts`).

    Attributes:
        pressed: faces (f, 4) of every surface under pressure, outward by the right-hand rule.
        followers: patches under a force that turns with them.
        obstacles: rigid bodies.
    """

    pressed: tuple[Index, ...] = ()
    followers: tuple[FollowerPatch, ...] = ()
    obstacles: tuple[Obstacle, ...] = ()

    def core(self) -> _core.Surroundings:
        """Return them as the core takes them."""
        return _core.Surroundings(
            [quads.tolist() for quads in self.pressed],
            [patch.core() for patch in self.followers],
            [obstacle.core() for obstacle in self.obstacles],
        )


@dataclass(frozen=True, eq=False)
class Acts:
    """How the surroundings act in one solve, in their order.

    Attributes:
        pressures: of every pressed surface, against its faces; force / length^2.
        follower_forces: of every patch, as it points at rest.
        motions: of every obstacle since rest.
    """

    pressures: tuple[float, ...] = ()
    follower_forces: tuple[Vector, ...] = ()
    motions: tuple[Vector, ...] = ()

    @classmethod
    def nothing(cls, around: Surroundings) -> Acts:
        """Return what leaves the mesh alone: no pressure, no force, obstacles where they are."""
        zero = (0.0, 0.0, 0.0)
        return cls((0.0,) * len(around.pressed), (zero,) * len(around.followers), (zero,) * len(around.obstacles))

    def check(self, around: Surroundings) -> None:
        """Refuse numbers that do not fit the surroundings.

        Raises:
            GdfeError: which list has the wrong length, or is not finite.
        """
        for name, given, requested in (
            ("pressures", self.pressures, around.pressed),
            ("follower forces", self.follower_forces, around.followers),
            ("motions of obstacles", self.motions, around.obstacles),
        ):
            if len(given) != len(requested) or not np.isfinite(np.array(given, dtype=np.float64)).all():
                raise GdfeError(f"expected {len(requested)} finite {name}, found {given}")


@dataclass(frozen=True, eq=False)
class Contact:
    """Where an obstacle holds the mesh.

    Attributes:
        nodes: (k,) that touch it.
        force: (k, 3) on these nodes.
        gap: (k,) distance that is left, negative inside.
        sliding: (k,) friction is exhausted.
    """

    nodes: Index = field(default_factory=lambda: np.zeros(0, dtype=np.int32))
    force: Array = field(default_factory=lambda: np.zeros((0, 3)))
    gap: Array = field(default_factory=lambda: np.zeros(0))
    sliding: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))

    @property
    def total(self) -> Array:
        """Force of the obstacle on the mesh, (3,)."""
        return np.asarray(self.force.sum(axis=0))


def contacts_of(touches: list[_core.Touch], obstacles: int) -> tuple[Contact, ...]:
    """Return the contact of every obstacle."""
    found = []
    for number in range(obstacles):
        own = [touch for touch in touches if touch.obstacle == number]
        if not own:
            found.append(Contact())
            continue
        found.append(
            Contact(
                np.array([touch.node for touch in own], dtype=np.int32),
                np.array([touch.force for touch in own]),
                np.array([touch.gap for touch in own]),
                np.array([touch.sliding for touch in own]),
            )
        )
    return tuple(found)


def face_shares(nodes: Array, quads: Index) -> Array:
    """Return each node's share of an even load on faces (f, 4), (n,): integral of its shape function over area."""
    point = 1.0 / np.sqrt(3.0)
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], dtype=np.float64)
    shares = np.zeros(len(nodes))
    for xi, eta in signs * point:
        shape = 0.25 * (1 + signs[:, 0] * xi) * (1 + signs[:, 1] * eta)
        along_xi = 0.25 * signs[:, 0] * (1 + signs[:, 1] * eta)
        along_eta = 0.25 * signs[:, 1] * (1 + signs[:, 0] * xi)
        corners = nodes[quads]
        area = np.linalg.norm(
            np.cross(np.einsum("a,fak->fk", along_xi, corners), np.einsum("a,fak->fk", along_eta, corners)), axis=1
        )
        np.add.at(shares, quads, area[:, None] * shape)
    return np.asarray(shares / shares.sum())


def gravity(mesh: Mesh, density: tuple[float, ...], acceleration: Vector) -> Array:
    """Return the weight of a mesh as forces on its nodes, (n, 3).

    Args:
        mesh: at rest.
        density: mass / length^3 of every material number.
        acceleration: (3,) length / time^2, in units whose product with density is force / length^3.
    """
    if len(density) <= int(mesh.materials.max()) or not all(0.0 <= d < np.inf for d in density):
        raise GdfeError(f"gravity: expected a density of 0 or more for {mesh.materials.max() + 1} materials: {density}")
    mass = np.zeros(len(mesh.nodes))
    of_element = np.array(density)[mesh.materials]
    for gauss in CORNER_SIGNS / np.sqrt(3.0):
        shape = (1.0 + CORNER_SIGNS * gauss).prod(axis=1) / 8.0
        jacobian = np.linalg.det(np.einsum("ak,eaj->ejk", shape_slopes(gauss), mesh.nodes[mesh.hexes]))
        np.add.at(mass, mesh.hexes, (of_element * jacobian)[:, None] * shape)
    return np.asarray(mass[:, None] * np.array(acceleration))
