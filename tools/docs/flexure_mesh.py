# SPDX-License-Identifier: Apache-2.0
"""A finger of hexahedra closed by tensions: the elements of CalculiX' C3D8I, some twenty times as fast.

Eight nodes, three incompatible modes (Taylor, Beresford, Wilson 1976: slopes of 1 - x^2 with the Jacobian of the
element's middle), neo-Hookean. The finger is symmetric, so z >= 0 is meshed. `python tools/docs/flexure_study.py fit`
compares it with CalculiX on the same mesh.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.linalg import splu

from softgrip_model.finger import Finger
from softgrip_model.gdfe.finger_mesh import FingerMesh

Array = NDArray[np.float64]

NODES, MODES = 8, 3
CORNERS = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], dtype=float
)
STEPS, SMALL_MM = 15, 1e-7
#: A step [mm] that leads nowhere, and the smallest share of the load that is tried.
LOST_MM, MIN_SHARE = 200.0, 3e-3


def _slopes(at: Array) -> Array:
    """Slopes (8, 3) of the trilinear shapes in the unit cube."""
    slopes = np.empty((NODES, 3))
    for axis in range(3):
        one, other = (a for a in range(3) if a != axis)
        slopes[:, axis] = CORNERS[:, axis] * (1 + CORNERS[:, one] * at[one]) * (1 + CORNERS[:, other] * at[other]) / 8
    return slopes


class HalfFinger:
    """The half z >= 0 of a finger's mesh under its cable's tensions; lengths in mm, forces in N.

    Args:
        finger: as the kernel computes it.
        mesh: of the whole finger.
        modulus_mpa: neo-Hookean, at rest.
    """

    def __init__(self, finger: Finger, mesh: FingerMesh, modulus_mpa: float) -> None:
        nodes = mesh.mesh.nodes
        kept = nodes[:, 2] > -1e-9
        number = np.where(kept, np.cumsum(kept) - 1, -1)
        self.mesh, self.nodes, self.number = mesh, nodes[kept], number
        self.hexes = number[mesh.mesh.hexes[kept[mesh.mesh.hexes].all(axis=1)]]
        poisson = finger.strip.poisson
        self.shear = modulus_mpa / (2.0 * (1.0 + poisson))
        self.bulk = modulus_mpa / (3.0 * (1.0 - 2.0 * poisson))
        self._points()
        held = np.zeros_like(self.nodes, dtype=bool)
        held[number[mesh.clamped[kept[mesh.clamped]]]] = True
        held[np.abs(self.nodes[:, 2]) < 1e-9, 2] = True
        self.free = np.flatnonzero(~held.ravel())
        unknown = np.full(held.size, -1)
        unknown[self.free] = np.arange(len(self.free))
        self.freedoms = (3 * self.hexes[:, :, None] + np.arange(3)).reshape(len(self.hexes), -1)
        self.unknown = unknown[self.freedoms]
        rows, columns = np.repeat(self.unknown, 24, axis=1).ravel(), np.tile(self.unknown, (1, 24)).ravel()
        self.chosen = (rows >= 0) & (columns >= 0)
        self.places = rows[self.chosen], columns[self.chosen]
        self.rest_points = np.array([point.position[:2] for point in mesh.routing])
        self.weights = self._folded(kept, number)
        self.free_weights = self.weights[:, self.free]

    def _points(self) -> None:
        """Slopes (E, 8, 11, 3) of nodes and modes at the Gauss points, and these points' volumes (E, 8)."""
        corners = self.nodes[self.hexes]
        middle = np.einsum("eai,ak->eik", corners, _slopes(np.zeros(3)))
        inverse, size = np.linalg.inv(middle), np.linalg.det(middle)
        self.slopes = np.empty((len(corners), 8, NODES + MODES, 3))
        self.volume = np.empty((len(corners), 8))
        for point, at in enumerate(CORNERS / np.sqrt(3.0)):
            jacobian = np.einsum("eai,ak->eik", corners, _slopes(at))
            self.volume[:, point] = np.linalg.det(jacobian)
            self.slopes[:, point, :NODES] = np.einsum("ak,eki->eai", _slopes(at), np.linalg.inv(jacobian))
            for mode in range(MODES):
                scale = (size / self.volume[:, point])[:, None]
                self.slopes[:, point, NODES + mode] = -2.0 * at[mode] * inverse[:, mode, :] * scale

    def _folded(self, kept: NDArray[np.bool_], number: NDArray[np.int_]) -> sp.csr_matrix:
        """What makes the cable's points (x, y) of displacements; nodes of the other half move as their images do."""
        rows, columns, values = [], [], []
        for i, point in enumerate(self.mesh.routing):
            for node, weight in zip(point.nodes, point.weights, strict=True):
                if not kept[node]:
                    continue
                both = 1.0 if abs(self.mesh.mesh.nodes[node, 2]) < 1e-9 else 2.0
                rows += [2 * i, 2 * i + 1]
                columns += [3 * number[node], 3 * number[node] + 1]
                values += [both * weight] * 2
        return sp.csr_matrix((values, (rows, columns)), shape=(2 * len(self.mesh.routing), self.nodes.size))

    def points(self, moved: Array) -> Array:
        """Where the cable runs (points, 2)."""
        return self.rest_points + np.asarray(self.weights @ moved.ravel()).reshape(-1, 2)

    def shortening(self, moved: Array) -> float:
        """By how much the cable has become shorter."""
        before, now = (np.linalg.norm(np.diff(p, axis=0), axis=1).sum() for p in (self.rest_points, self.points(moved)))
        return float(before - now)

    def tip(self, moved: Array) -> Array:
        """The tip (2,)."""
        tip, by_node = self.mesh.tip, np.zeros(len(self.number))
        by_node[tip.nodes] = tip.weights
        at = self.number >= 0
        both = np.where(np.abs(self.mesh.mesh.nodes[at, 2]) < 1e-9, 1.0, 2.0)
        return np.asarray(tip.position[:2]) + (by_node[at] * both) @ moved[self.number[at], :2]

    def turned(self, where: NDArray[np.int_], moved: Array) -> float:
        """By which angle [rad] some nodes have turned towards closing, as a rigid body that fits them best."""
        rest, now = (at[where, :2] - at[where, :2].mean(axis=0) for at in (self.nodes, self.nodes + moved))
        sine = np.sum(rest[:, 1] * now[:, 0] - rest[:, 0] * now[:, 1])
        return float(np.arctan2(sine, np.sum(rest * now)))

    def elements(self, moved: Array, modes: Array) -> tuple[Array, Array, float]:
        """Forces (E, 33), stiffness (E, 33, 33) of every element, and the smallest volume ratio."""
        both = np.concatenate([moved[self.hexes], modes], axis=1)
        gradient = np.einsum("eai,egaj->egij", both, self.slopes, optimize=True) + np.eye(3)
        ratio = np.linalg.det(gradient)
        if not ratio.min() > 0.0:
            return np.empty(0), np.empty(0), float(ratio.min())
        turned = np.swapaxes(np.linalg.inv(gradient), -1, -2)
        trace = (gradient**2).sum(axis=(-1, -2))
        shear = self.shear * ratio ** (-2.0 / 3.0)
        pressure = self.bulk * (ratio - 1.0) * ratio

        def each(x: Array) -> Array:
            return x[..., None, None]

        stress = each(shear) * (gradient - each(trace) / 3.0 * turned) + each(pressure) * turned
        nine = (*ratio.shape, 9)
        f, t = gradient.reshape(nine), turned.reshape(nine)
        mixed = f[..., :, None] * t[..., None, :]
        tangent = each(shear * 2.0 / 9.0 * trace + self.bulk * ratio * (2.0 * ratio - 1.0)) * (
            t[..., :, None] * t[..., None, :]
        )
        tangent -= each(shear * 2.0 / 3.0) * (mixed + np.swapaxes(mixed, -1, -2))
        cross = np.einsum("egil,egkj->egijkl", turned, turned).reshape(*ratio.shape, 9, 9)
        tangent += each(shear * trace / 3.0 - pressure) * cross + each(shear) * np.eye(9)
        stress *= each(self.volume)
        tangent *= each(self.volume)
        count, parts = len(ratio), NODES + MODES
        forces = np.einsum("egij,egaj->eai", stress, self.slopes, optimize=True).reshape(count, -1)
        half = np.matmul(tangent.reshape(count, 8, 27, 3), np.swapaxes(self.slopes, -1, -2))
        half = np.swapaxes(half.reshape(count, 8, 3, 3, 3 * parts), 2, 3).reshape(count, 8, 3, 9 * parts)
        stiffness = np.einsum("egaj,egjx->eax", self.slopes, half, optimize=True).reshape(count, parts, 3, 3, parts)
        return forces, stiffness.transpose(0, 1, 2, 4, 3).reshape(count, 3 * parts, 3 * parts), float(ratio.min())

    def _cable(self, moved: Array, tensions: Array) -> tuple[Array, Array]:
        """Forces on the points and their stiffness, of half the tensions."""
        points = self.points(moved)
        apart = np.diff(points, axis=0)
        length = np.linalg.norm(apart, axis=1)
        force, stiffness = np.zeros_like(points), np.zeros((points.size, points.size))
        for i, (along, half) in enumerate(zip(apart / length[:, None], 0.5 * tensions, strict=True)):
            force[i] -= half * along
            force[i + 1] += half * along
            block = half / length[i] * (np.eye(2) - np.outer(along, along))
            near, far = slice(2 * i, 2 * i + 2), slice(2 * i + 2, 2 * i + 4)
            stiffness[near, near] += block
            stiffness[far, far] += block
            stiffness[near, far] -= block
            stiffness[far, near] -= block
        return force.ravel(), stiffness

    def at_rest(self) -> tuple[Array, Array]:
        """Displacements (N, 3) and modes (E, 3, 3) of nothing."""
        return np.zeros_like(self.nodes), np.zeros((len(self.hexes), MODES, 3))

    def equilibrium(self, tensions: ArrayLike, start: tuple[Array, Array]) -> tuple[Array, Array] | None:
        """Return displacements and modes under tensions (stretches,); None where Newton does not get there."""
        moved, modes = (x.copy() for x in start)
        for step in range(STEPS):
            forces, stiffness, min_ratio = self.elements(moved, modes)
            if not min_ratio > 0.0:
                return None
            inner = np.concatenate([forces[:, 24:, None], stiffness[:, 24:, :24]], axis=2)
            solved = np.linalg.solve(stiffness[:, 24:, 24:], inner)
            coupling = stiffness[:, :24, 24:]
            condensed = stiffness[:, :24, :24] - coupling @ solved[:, :, 1:]
            left = forces[:, :24] - (coupling @ solved[:, :, :1])[:, :, 0]
            cable_force, cable_stiffness = self._cable(moved, np.asarray(tensions, dtype=float))
            residual = np.asarray(self.free_weights.T @ cable_force)
            np.add.at(residual, self.unknown[self.unknown >= 0], left[self.unknown >= 0])
            system = sp.csc_matrix((condensed.ravel()[self.chosen], self.places), shape=(len(self.free),) * 2)
            system = system + self.free_weights.T @ sp.csc_matrix(cable_stiffness) @ self.free_weights
            change = np.zeros(moved.size)
            change[self.free] = -splu(
                system.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}
            ).solve(residual)
            local = solved[:, :, 0] + (solved[:, :, 1:] @ change[self.freedoms][:, :, None])[:, :, 0]
            modes -= local.reshape(modes.shape)
            moved += change.reshape(moved.shape)
            largest = np.abs(change).max()
            if step > 0 and largest < SMALL_MM * max(1.0, np.abs(moved).max()):
                return moved, modes
            if not largest < LOST_MM:
                return None
        return None

    def closing(self, tensions: ArrayLike, shares: list[float]) -> list[tuple[float, Array]]:
        """Return displacements at growing shares of the tensions (stretches,), as far as they are found."""
        full, found = np.asarray(tensions, dtype=float), []
        last, before = (0.0, *self.at_rest()), None
        left = list(shares)
        while left:
            share = left[0]
            state = None
            if before is not None:
                ahead = (share - last[0]) / (last[0] - before[0])
                guess = tuple(now + ahead * (now - then) for now, then in zip(last[1:], before[1:], strict=True))
                state = self.equilibrium(share * full, (guess[0], guess[1]))
            state = state or self.equilibrium(share * full, (last[1], last[2]))
            if state is None:
                if share - last[0] < MIN_SHARE:
                    break
                left.insert(0, 0.5 * (share + last[0]))
                continue
            left.pop(0)
            before, last = last, (share, *state)
            if share in shares:
                found.append((share, state[0]))
        return found
