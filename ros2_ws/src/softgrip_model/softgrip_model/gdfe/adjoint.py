# SPDX-License-Identifier: Apache-2.0
"""Gradients of an equilibrium: its tangent, transposed and factored once, answers every goal and every parameter.

At an equilibrium the out-of-balance forces R of the free unknowns u and the cables' anchor tensions T vanish:

    R_u = elements - cables,    R_T = length - (length at rest - shortening), or actuator tension - target.

A goal J(u, T) changes with a parameter p by dJ/dp = dJ/dp|explicit - adjoint . dR/dp, where A' adjoint = (dJ/du, dJ/dT)
and A = dR/d(u, T). A is not symmetric: friction takes from the tension along the cable, and the calibrated law has no
energy. Blocks of A come from central differences of the forces that the solver itself computes, element by element, so
law and friction are written down once. A is solved directly: the elements' part by levels (`level_factor`), the cables'
as a correction of low rank.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.sparse import coo_array, csr_array, hstack, kron

from softgrip_model.gdfe import _core
from softgrip_model.gdfe.cable import CableDrive, RoutedCable, RoutingPoint
from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.gdfe.level_factor import LevelFactor, levels_of
from softgrip_model.gdfe.solver import ConstitutiveLaw, Equilibrium, Solver, State

Array = NDArray[np.float64]

#: Differences, as shares of an element's edge: strains of that size, where both rounding (1e-14 of a stress) and the
#: law's curvature stay below 1e-8 of a slope.
NODE_STEP = 1e-5
#: Differences of tensions [N]; the friction laws are smooth down to their floor.
TENSION_STEP_N = 1e-5
#: Of a solution: without its cables a bent finger is near a column that buckles, which costs digits.
REFINEMENTS = 1
#: of an equilibrium that gradients are taken at
TOLERANCE = 1e-10


@dataclass(frozen=True, eq=False)
class CablePull:
    """What a cable does at one state: forces on its points (m, 3) [N], its length, tension at the actuator [N]."""

    force: Array
    length: float
    actuator_tension: float

    def numbers(self) -> Array:
        """Return all of it, (3 m + 2,)."""
        return np.concatenate([self.force.ravel(), [self.length, self.actuator_tension]])


class CableLine:
    """A routed cable as a function of where the nodes are."""

    def __init__(self, cable: RoutedCable) -> None:
        self.points = cable.points
        self._core = cable.core()

    def places(self, vertices: Array) -> Array:
        """Return where its points are, (m, 3), for nodes at `vertices` (n, 3)."""
        return np.array([place_of(point, vertices) for point in self.points])

    def pull(self, places: Array, anchor_tension: float) -> CablePull:
        """Return what it does with its points at `places` (m, 3).

        Raises:
            GdfeError: it is wrapped further than the friction law has a value for.
        """
        state = _core.pull_from_anchor(self._core, list(places), anchor_tension)
        if not state.sound:
            raise GdfeError("cable: expected a wrap that the friction law has a value for, found more")
        return CablePull(np.array(state.force), state.length, state.tension[0])

    def slopes(self, places: Array, anchor_tension: float) -> Array:
        """Return the slopes of `CablePull.numbers` to the points' coordinates and the tension, (3 m + 2, 3 m + 1)."""
        step = NODE_STEP * float(np.linalg.norm(np.diff(places, axis=0), axis=1).min())
        columns = []
        for k in range(places.size):
            moved = np.zeros(places.size)
            moved[k] = step
            shift = moved.reshape(places.shape)
            more, less = (self.pull(places + side * shift, anchor_tension).numbers() for side in (1.0, -1.0))
            columns.append((more - less) / (2.0 * step))
        more, less = (self.pull(places, anchor_tension + side * TENSION_STEP_N).numbers() for side in (1.0, -1.0))
        columns.append((more - less) / (2.0 * TENSION_STEP_N))
        return np.array(columns).T

    def selection(self, nodes: int) -> csr_array:
        """Return the points' coordinates as weights of the nodes' coordinates, (3 m, 3 n)."""
        rows = np.repeat(np.arange(len(self.points)), [len(point.nodes) for point in self.points])
        columns = np.concatenate([point.nodes for point in self.points])
        weights = np.concatenate([point.weights for point in self.points])
        selected = coo_array((weights, (rows, columns)), shape=(len(self.points), nodes))
        return csr_array(kron(selected, csr_array(np.eye(3))))


def place_of(point: RoutingPoint, vertices: Array) -> Array:
    """Return where a point of a cable is, (3,), for nodes at `vertices` (n, 3)."""
    if len(point.nodes) == 0:
        return np.array(point.position)
    return np.asarray(point.weights @ vertices[point.nodes])


@dataclass(frozen=True, eq=False)
class Adjoint:
    """How a goal falls with out-of-balance forces.

    Attributes:
        node: (n, 3) with forces on nodes [goal per N]; zero where they are held.
        cable: per cable, with its length, or with its actuator tension where that is prescribed.
    """

    node: Array
    cable: Array


class EquilibriumTangent:
    """The tangent of a converged equilibrium without obstacles, pressures or follower forces."""

    def __init__(self, solver: Solver, equilibrium: Equilibrium, drives: Sequence[CableDrive]) -> None:
        """Prepare; nothing is factored before the first adjoint.

        Raises:
            GdfeError: not converged, a slack cable, obstacles or loads that follow the body, or the thesis law.
        """
        _check(solver, equilibrium)
        self.solver, self.state = solver, equilibrium.state
        self.drives = tuple(drives)
        self.lines = tuple(CableLine(cable) for cable in solver.cables)
        self.vertices = solver.mesh.nodes + equilibrium.displacement

    @cached_property
    def element_force(self) -> Array:
        """Of all elements on the nodes, (n, 3) [N]."""
        return self.solver.internal_force(self.state.displacement)

    @cached_property
    def unknown_of(self) -> NDArray[np.int32]:
        """The free unknown of every node along every axis, (n, 3), -1 where it is held."""
        found, first = [], 0
        for numbers in self.solver.supports.maps():
            found.append(np.where(numbers >= 0, numbers + first, -1))
            first += int(numbers.max(initial=-1)) + 1
        return np.stack(found, axis=1).astype(np.int32)

    @property
    def unknowns(self) -> int:
        """How many free unknowns there are."""
        return int(self.unknown_of.max()) + 1

    @cached_property
    def free(self) -> csr_array:
        """The nodes' coordinates as the free unknowns', (3 n, unknowns)."""
        unknown = self.unknown_of.ravel()
        rows = np.flatnonzero(unknown >= 0)
        return csr_array(coo_array((np.ones(len(rows)), (rows, unknown[rows])), shape=(len(unknown), self.unknowns)))

    @cached_property
    def stiffness(self) -> csr_array:
        """The elements' tangent on the free unknowns, squared [N per length]."""
        mesh, displacement = self.solver.mesh, self.state.displacement
        elements = _core.ElementForces(self.solver.problem(is_disassembled=True), self.solver.settings.core())
        corners = displacement[mesh.hexes]  # (m, 8, 3): every element has its own
        diagonal = mesh.nodes[mesh.hexes[:, 6]] - mesh.nodes[mesh.hexes[:, 0]]
        step = NODE_STEP * float(np.linalg.norm(diagonal, axis=1).min()) / np.sqrt(3.0)
        blocks = np.zeros((len(mesh.hexes), 24, 24))
        for column in range(24):
            forces = []
            for side in (1.0, -1.0):
                moved = corners.copy()
                moved[:, column // 3, column % 3] += side * step
                forces.append(elements.at(moved.reshape(-1, 3)).reshape(-1, 24))
            blocks[:, :, column] = (forces[0] - forces[1]) / (2.0 * step)
        unknown = self.unknown_of[mesh.hexes].reshape(-1, 24)
        rows, columns = (np.broadcast_to(unknown[at], blocks.shape) for at in (np.s_[:, :, None], np.s_[:, None, :]))
        kept = (rows >= 0) & (columns >= 0)
        return csr_array(coo_array((blocks[kept], (rows[kept], columns[kept])), shape=(self.unknowns, self.unknowns)))

    @cached_property
    def _cables(self) -> tuple[csr_array, Array, Array, Array, Array]:
        """What the cables add to A: U, F, t, m, c of [[K - U F U', -U t], [m U', c]]."""
        free = self.free
        selections = [free.T @ line.selection(len(self.vertices)).T for line in self.lines]
        forces, by_tension, measured, corner = [], [], [], []
        for line, drive, tension in zip(self.lines, self.drives, self.state.anchor_tension, strict=True):
            slopes = line.slopes(line.places(self.vertices), tension)
            points = 3 * len(line.points)
            row = points if drive.by_length else points + 1
            forces.append(slopes[:points, :points])
            by_tension.append(slopes[:points, points:])
            measured.append(slopes[row : row + 1, :points])
            corner.append(slopes[row, points])
        joined = csr_array(hstack(selections))
        return joined, block_diag(*forces), block_diag(*by_tension), block_diag(*measured), np.diag(corner)

    @cached_property
    def _factor(self) -> LevelFactor:
        levels = levels_of(self.solver.mesh.hexes, self.unknown_of, self.unknowns)
        return LevelFactor(csr_array(self.stiffness.T), levels)

    def _transposed(self, node: Array, cable: Array) -> tuple[Array, Array]:
        """Return A' (node, cable)."""
        found = self.stiffness.T @ node
        if not self.lines:
            return found, cable
        selected, force, by_tension, measured, corner = self._cables
        pulled = selected.T @ node
        return found - selected @ (force.T @ pulled - measured.T @ cable), corner.T @ cable - by_tension.T @ pulled

    def _solved(self, node: Array, cable: Array) -> tuple[Array, Array]:
        """Return the solution of A' (found) = (node, cable): the elements' part by levels, the cables' by Woodbury."""
        alone = self._factor.solve(node)
        if not self.lines:
            return alone, cable
        selected, force, by_tension, measured, corner = self._cables
        answers, points = self._point_answers, selected.shape[1]
        compliance = selected.T @ answers
        small = np.block([[np.eye(points) - compliance @ force.T, compliance @ measured.T], [-by_tension.T, corner.T]])
        try:
            at = np.linalg.solve(small, np.concatenate([selected.T @ alone, cable]))
        except np.linalg.LinAlgError as error:
            raise GdfeError("tangent: expected one that can be inverted; the shape is at a limit point") from error
        return alone + answers @ (force.T @ at[:points] - measured.T @ at[points:]), at[points:]

    @cached_property
    def _point_answers(self) -> Array:
        return self._factor.solve(self._cables[0].toarray())

    def adjoint(self, by_vertices: Array, by_anchor_tension: Sequence[float] = ()) -> Adjoint:
        """Return the adjoint of a goal.

        Args:
            by_vertices: (n, 3) its slopes to where the nodes are.
            by_anchor_tension: per cable [goal per N]; empty = none.
        """
        node = self.free.T @ by_vertices.ravel()
        cable = np.asarray(by_anchor_tension or np.zeros(len(self.lines)), dtype=np.float64)
        found = self._solved(node, cable)
        for _ in range(REFINEMENTS):
            had = self._transposed(*found)
            more = self._solved(node - had[0], cable - had[1])
            found = found[0] + more[0], found[1] + more[1]
        return Adjoint((self.free @ found[0]).reshape(-1, 3), found[1])

    def actuator_slopes(self, cable: int) -> tuple[Array, float]:
        """Return the slopes of a cable's actuator tension to where the nodes are, (n, 3), and to its anchor tension."""
        line = self.lines[cable]
        slopes = line.slopes(line.places(self.vertices), self.state.anchor_tension[cable])[-1]
        nodes = line.selection(len(self.vertices)).T @ slopes[:-1]
        return nodes.reshape(-1, 3), float(slopes[-1])

    def by_target(self, adjoint: Adjoint) -> float:
        """Return a goal's slope to what the first cable is driven to: its shortening, or its tension [goal per N]."""
        return float(-adjoint.cable[0] if self.drives[0].by_length else adjoint.cable[0])

    def by_stiffness(self, adjoint: Adjoint) -> float:
        """Return a goal's slope to a factor on all moduli, at 1."""
        return float(-np.sum(adjoint.node * self.element_force))


def _check(solver: Solver, equilibrium: Equilibrium) -> None:
    surroundings = solver.surroundings
    if not equilibrium.converged:
        raise GdfeError("gradient: expected a converged equilibrium, found one that is not")
    if surroundings.obstacles or surroundings.pressed or surroundings.followers:
        raise GdfeError("gradient: expected no obstacles, pressures or follower forces, found some")
    if solver.settings.law is ConstitutiveLaw.THESIS:
        raise GdfeError("gradient: expected the law 'calibrated' or 'rigorous', found 'thesis', which forgets stress")
    if any(tension <= TENSION_STEP_N for tension in equilibrium.anchor_tension):
        raise GdfeError("gradient: expected taut cables, found a slack one")


def refined(
    solver: Solver,
    start: State,
    drives: Sequence[CableDrive],
    *,
    max_iterations: int = 4000,
) -> Equilibrium:
    """Return an equilibrium that is converged as far as gradients want it.

    Raises:
        GdfeError: it does not converge.
    """
    found = solver.solve(
        start=start, drives=drives, tolerance=TOLERANCE, length_tolerance=TOLERANCE, max_iterations=max_iterations
    )
    if not found.converged:
        raise GdfeError(
            f"expected a residual below {TOLERANCE:g}, found {found.residual:.1e} after {found.iterations} iterations"
        )
    return found
