# SPDX-License-Identifier: Apache-2.0
"""How a finger's shape in the mesh follows from its design: values with gradients to h, r, moduli and pulled length.

Lengths in mm, angles in rad, forces in N. A goal is a function of the closed shape with slopes of its own; `tip_goal`
and `joint_angle_goal` are two. Where nodes and routing lie follows from h and r by `mesh_finger`, as many of both for
every design, so what a variable does at a fixed displacement is a difference of meshes; what the finger answers to it
is the adjoint's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softgrip_model.finger import Finger
from softgrip_model.friction.laws import FrictionLaw
from softgrip_model.gdfe import _core
from softgrip_model.gdfe.adjoint import Adjoint, CableLine, EquilibriumTangent, place_of, refined
from softgrip_model.gdfe.cable import CableDrive, RoutedCable
from softgrip_model.gdfe.closing import (
    LENGTH_TOLERANCE_MM,
    SECTIONS_AFTER,
    WINDOW,
    ClosingSettings,
    Keyframes,
    solve_mesh,
)
from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.gdfe.finger_mesh import FingerMesh, mesh_finger
from softgrip_model.gdfe.materials import SolidMaterial
from softgrip_model.gdfe.solver import ConstitutiveLaw, Equilibrium, Solver, SolverSettings, Supports

Array = NDArray[np.float64]

#: Differences of h and r [mm]: meshes are smooth in both, and forces known to 1e-13.
DESIGN_STEP_MM = 1e-5


@dataclass(frozen=True, eq=False)
class GoalSlopes:
    """A goal at one shape.

    Attributes:
        value: of it.
        by_vertices: (n, 3) slopes to where the nodes are [per mm].
        by_actuator_tension: [per N]
    """

    value: float
    by_vertices: Array
    by_actuator_tension: float = 0.0


#: (mesh, vertices (n, 3) [mm], actuator tension [N]) -> value with slopes.
Goal = Callable[[FingerMesh, Array, float], GoalSlopes]


def tip_goal(direction: ArrayLike) -> Goal:
    """Return the tip's coordinate along a direction (3,) [mm]."""
    along = np.asarray(direction, dtype=np.float64)

    def goal(mesh: FingerMesh, vertices: Array, _tension: float) -> GoalSlopes:
        slopes = np.zeros_like(vertices)
        slopes[mesh.tip.nodes] += mesh.tip.weights[:, None] * along
        return GoalSlopes(float(along @ place_of(mesh.tip, vertices)), slopes)

    return goal


def tension_goal() -> Goal:
    """Return the tension at the actuator [N]."""
    return lambda _mesh, vertices, tension: GoalSlopes(tension, np.zeros_like(vertices), 1.0)


def link_angles(mesh: FingerMesh, vertices: Array) -> tuple[Array, Array]:
    """Return how far each link has turned in the closing plane, (n,) [rad], and the slopes to the nodes, (n, N, 3)."""
    angles, slopes = [], np.zeros((len(mesh.link_nodes), *vertices.shape))
    for link, nodes in enumerate(mesh.link_nodes):
        rest, now = (at[nodes, :2] - at[nodes, :2].mean(axis=0) for at in (mesh.mesh.nodes, vertices))
        sine = float(np.sum(rest[:, 1] * now[:, 0] - rest[:, 0] * now[:, 1]))  # closing, towards -y, is positive
        cosine = float(np.sum(rest * now))
        angles.append(np.arctan2(sine, cosine))
        square = sine**2 + cosine**2
        turned = np.stack([rest[:, 1], -rest[:, 0]], axis=1)
        slopes[link, nodes, :2] = (cosine * turned - sine * rest) / square
    return np.unwrap(angles), slopes


def joint_angle_goal(joint: int) -> Goal:
    """Return the angle of one joint [rad]: how far its link has turned against the one before, or the base."""

    def goal(mesh: FingerMesh, vertices: Array, _tension: float) -> GoalSlopes:
        angles, slopes = link_angles(mesh, vertices)
        before, slope_before = (angles[joint - 1], slopes[joint - 1]) if joint else (0.0, 0.0)
        return GoalSlopes(float(angles[joint] - before), slopes[joint] - slope_before)

    return goal


@dataclass(frozen=True, eq=False)
class DesignGradient:
    """A goal's value and slopes.

    Attributes:
        value: of the goal.
        by_thickness: (n,) to every h [per mm].
        by_routing: (2 n,) to every r [per mm].
        by_stiffness: to a factor on all moduli, at 1.
        by_pulled: to the pulled length [per mm].
    """

    value: float
    by_thickness: Array
    by_routing: Array
    by_stiffness: float
    by_pulled: float

    def numbers(self) -> Array:
        """Return all slopes, (3 n + 2,): h, r, stiffness, pulled length."""
        return np.concatenate([self.by_thickness, self.by_routing, [self.by_stiffness, self.by_pulled]])


class MeshedFinger:
    """A design in the mesh: closed to any pulled length, with gradients.

    Args:
        finger: the design.
        friction: of its cable.
        material: of its body.
        settings: how closings are computed.
        law: of the elements.

    Raises:
        GdfeError: a finger that cannot be meshed.
    """

    def __init__(
        self,
        finger: Finger,
        friction: FrictionLaw,
        material: SolidMaterial,
        settings: ClosingSettings | None = None,
        law: ConstitutiveLaw = ConstitutiveLaw.CALIBRATED,
    ) -> None:
        self.finger, self.friction, self.settings = finger, friction, settings or ClosingSettings()
        self.mesh = self._meshed(finger)
        supports = Supports.none(len(self.mesh.mesh.nodes)).with_prescribed(self.mesh.clamped)
        method = SolverSettings(
            law=law, step_limit=0.5 * min(finger.thickness_mm), window=WINDOW, sections_after=SECTIONS_AFTER
        )
        self.solver = Solver(self.mesh.mesh, [material], supports, [self._cable(self.mesh)], method)
        self._keyframes = Keyframes(
            self.settings.keyframe_mm,
            self.settings.travel_mm,
            LENGTH_TOLERANCE_MM,
            partial(solve_mesh, self.settings, self.solver, is_keyframe=True),
            self.solver.rest(),
        )

    def close(self, pulled_mm: float) -> Equilibrium:
        """Return the equilibrium at a pulled length, converged as far as gradients want it.

        Raises:
            GdfeError: there is none.
        """
        self._keyframes.cover(pulled_mm)
        if not self._keyframes.within_reach(pulled_mm):
            raise GdfeError(
                f"pulled {pulled_mm:.2f} mm: expected a shape, found none beyond {self._keyframes.reach_mm:.2f} mm"
            )
        return refined(self.solver, self._keyframes.start(pulled_mm), [CableDrive(pulled_mm)])

    def gradients(self, closed: Equilibrium, pulled_mm: float, goals: list[Goal]) -> list[DesignGradient]:
        """Return goals with their gradients at an equilibrium of `close`.

        Raises:
            GdfeError: a slack cable, or an equilibrium at a limit point.
        """
        tangent = EquilibriumTangent(self.solver, closed, [CableDrive(pulled_mm)])
        changes = [self._changed(tangent, k) for k in range(3 * self.finger.joints)]
        return [self._gradient(tangent, goal, closed, changes) for goal in goals]

    def _gradient(
        self, tangent: EquilibriumTangent, goal: Goal, closed: Equilibrium, changes: list[_DesignChange]
    ) -> DesignGradient:
        found = goal(self.mesh, tangent.vertices, closed.tension[0][0])
        by_vertices, by_anchor = found.by_vertices, 0.0
        if found.by_actuator_tension:
            nodes, anchor = tangent.actuator_slopes(0)
            by_vertices = by_vertices + found.by_actuator_tension * nodes
            by_anchor = found.by_actuator_tension * anchor
        adjoint = tangent.adjoint(by_vertices, [by_anchor])
        at_rest = [self._value(goal, change) for change in changes]
        slopes = [direct - change.multiply_adjoint(adjoint) for direct, change in zip(at_rest, changes, strict=True)]
        n = self.finger.joints
        return DesignGradient(
            found.value,
            np.array(slopes[:n]),
            np.array(slopes[n:]),
            tangent.by_stiffness(adjoint),
            tangent.by_target(adjoint),
        )

    @staticmethod
    def _value(goal: Goal, change: _DesignChange) -> float:
        """Return a goal's change with the design at a fixed displacement."""
        more, less = (goal(one.mesh, one.vertices, one.actuator_tension).value for one in (change.more, change.less))
        return (more - less) / (2.0 * DESIGN_STEP_MM)

    def _changed(self, tangent: EquilibriumTangent, number: int) -> _DesignChange:
        """Return what a larger and a smaller h or r do at the displacement and the tension of a state."""
        more, less = (self._imbalance(tangent, number, side * DESIGN_STEP_MM) for side in (1.0, -1.0))
        return _DesignChange(more, less)

    def _imbalance(self, tangent: EquilibriumTangent, number: int, step_mm: float) -> _Imbalance:
        n = self.finger.joints
        design = np.concatenate([self.finger.thickness_mm, self.finger.routing_mm])
        design[number] += step_mm
        mesh = self._meshed(self.finger.with_design(design[:n], design[n:]))
        displacement = tangent.state.displacement
        force = (
            _core.ElementForces(self.solver.problem(mesh.mesh.nodes), self.solver.settings.core()).at(displacement)
            if number < n
            else tangent.element_force  # the routing moves no node
        )
        line = CableLine(self._cable(mesh))
        vertices = mesh.mesh.nodes + displacement
        pull = line.pull(line.places(vertices), tangent.state.anchor_tension[0])
        rest = line.pull(line.places(mesh.mesh.nodes), 0.0).length
        cable_force = line.selection(len(vertices)).T @ pull.force.ravel()
        return _Imbalance(mesh, vertices, force - cable_force.reshape(-1, 3), pull.length - rest, pull.actuator_tension)

    def _meshed(self, finger: Finger) -> FingerMesh:
        return mesh_finger(finger, self.settings.resolution, finger.body_mm)

    def _cable(self, mesh: FingerMesh) -> RoutedCable:
        return RoutedCable(mesh.routing, self.friction)


@dataclass(frozen=True, eq=False)
class _Imbalance:
    """What a changed design does at a fixed displacement and anchor tension.

    Attributes:
        mesh: of the design; vertices: (n, 3) [mm].
        force: (n, 3) out-of-balance [N]; length: of the cable less that at rest [mm].
        actuator_tension: [N]
    """

    mesh: FingerMesh
    vertices: Array
    force: Array
    length: float
    actuator_tension: float


@dataclass(frozen=True, eq=False)
class _DesignChange:
    """The imbalances of a larger and of a smaller variable."""

    more: _Imbalance
    less: _Imbalance

    def multiply_adjoint(self, adjoint: Adjoint) -> float:
        """Return adjoint . dR/dp."""
        force = np.sum(adjoint.node * (self.more.force - self.less.force))
        length = adjoint.cable[0] * (self.more.length - self.less.length)
        return float((force + length) / (2.0 * DESIGN_STEP_MM))
