# SPDX-License-Identifier: Apache-2.0
"""Eq 4.5 with the finger closed in the mesh (GDFE) instead of by the kernel: slower by far, and with whole links.

The kernel finds the design, this moves it on to where the mesh closes as it should. The closings are compared at a few
equal steps of the whole deflection. The pulled length of each is found by secants: what a variable does is taken at
equal deflection, as Eq 4.4 asks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, OptimizeResult, minimize

from softgrip_design.objective import ROUNDING_DEG2, Weights
from softgrip_design.target import DesignTarget
from softgrip_model.finger import Finger
from softgrip_model.friction.laws import FrictionLaw
from softgrip_model.gdfe.closing import ClosingSettings
from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.gdfe.finger_gradient import MeshedFinger, joint_angle_goal, link_angles, tension_goal
from softgrip_model.gdfe.materials import SolidMaterial, StressPolynomial
from softgrip_model.gdfe.solver import Equilibrium

Array = NDArray[np.float64]

#: n of Eq 4.4 in the mesh.
STEPS = 6
#: How closings are computed: as far as fingers go.
SETTINGS = ClosingSettings(travel_mm=40.0, max_iterations=1000)
#: [rad] at which a deflection is met, secants to it at most, and [mm] a radian takes before anything is known.
DEFLECTION_TOLERANCE_RAD, SECANTS, FIRST_MM_PER_RAD = 1e-9, 15, 7.0


@dataclass(frozen=True, eq=False)
class MeshClosing:
    """Pulled lengths (steps,), joint angles (steps, n), tensions (steps,), slopes of these two at equal deflection."""

    pulled_mm: Array
    angle_rad: Array
    tension_n: Array
    angle_slopes: Array
    tension_slopes: Array


class FollowOnMesh:
    """Eq 4.5 of a finger that is closed in the mesh.

    Args:
        finger: lengths and material; its thickness and routing do not matter.
        law: friction of cable on finger.
        target: joint angles to follow; `STEPS` of its steps are taken.
        weights: of error and force.
        lower, upper: bounds of the design vector h (n), r (2 n) [mm].
        settings: how it is closed.
        material: of the finger; None = its strips'.
    """

    def __init__(
        self,
        finger: Finger,
        law: FrictionLaw,
        target: DesignTarget,
        weights: Weights,
        lower: Array,
        upper: Array,
        settings: ClosingSettings = SETTINGS,
        material: SolidMaterial | None = None,
    ) -> None:
        count = len(target.deflection_rad)
        steps = np.unique(np.ceil(count * np.arange(1, STEPS + 1) / STEPS).astype(int)) - 1
        self.target = DesignTarget(target.deflection_rad[steps], target.angle_rad[steps])
        self.lower, self.upper = lower, upper
        self._finger, self._law, self._weights = finger, law, weights
        self._material = material or strip_material(finger)
        self._settings = settings

    def meshed(self, x: Array) -> MeshedFinger:
        """Return the design x in the mesh."""
        n = self._finger.joints
        return MeshedFinger(self._finger.with_design(x[:n], x[n:]), self._law, self._material, self._settings)

    def closing(self, x: Array) -> MeshClosing:
        """Return what the design x does.

        Raises:
            GdfeError: it does not close so far, or cannot be meshed.
        """
        n = self._finger.joints
        meshed = self.meshed(x)
        goals = [*(joint_angle_goal(joint) for joint in range(n)), tension_goal()]
        pulls, angles, tensions, angle_slopes, tension_slopes = [], [], [], [], []
        pulled_mm, rad_per_mm = 0.0, 1.0 / FIRST_MM_PER_RAD
        reached_rad = 0.0
        for deflection in self.target.deflection_rad:
            guess_mm = pulled_mm + (float(deflection) - reached_rad) / rad_per_mm
            pulled_mm, closed = _at_deflection(meshed, float(deflection), guess_mm, rad_per_mm)
            found = meshed.gradients(closed, pulled_mm, goals)
            slopes = np.array([one.numbers() for one in found])
            whole = slopes[:n].sum(axis=0)
            reached_rad, rad_per_mm = float(deflection), float(whole[-1])
            # the pulled length that keeps the deflection changes with the design, too
            kept = slopes[:, : 3 * n] - np.outer(slopes[:, -1] / whole[-1], whole[: 3 * n])
            pulls.append(pulled_mm)
            angles.append([one.value for one in found[:n]])
            tensions.append(found[n].value)
            angle_slopes.append(kept[:n])
            tension_slopes.append(kept[n])
        return MeshClosing(*(np.array(each) for each in (pulls, angles, tensions, angle_slopes, tension_slopes)))

    def error_deg(self, x: Array) -> float:
        """Return E_T, Eq 4.4 [deg]."""
        return float(np.sqrt(np.mean(np.degrees(self.closing(x).angle_rad - self.target.angle_rad) ** 2)))

    def value(self, x: Array) -> float:
        """Return E of Eq 4.5; infinity where the finger has no equilibrium."""
        return self.value_and_gradient(x)[0]

    def value_and_gradient(self, x: Array) -> tuple[float, Array]:
        """Return E and its derivatives to x [per mm]."""
        try:
            closing = self.closing(x)
        except GdfeError:
            return math.inf, np.zeros_like(x)
        deviation = np.degrees(closing.angle_rad - self.target.angle_rad)
        error = math.sqrt(np.mean(deviation**2) + ROUNDING_DEG2)
        to_error = np.einsum("sj,sjk->k", deviation, np.degrees(closing.angle_slopes)) / (deviation.size * error)
        weights = self._weights
        value = weights.error * error + weights.force * float(closing.tension_n[-1])
        return value, np.asarray(weights.error * to_error + weights.force * closing.tension_slopes[-1])

    def improve(self, x: Array, iterations: int = 30) -> Array:
        """Return a design near x that is at least as good (SLSQP)."""
        began = self.value(x)
        result: OptimizeResult = minimize(
            self.value_and_gradient,
            x,
            jac=True,
            method="SLSQP",
            bounds=Bounds(self.lower, self.upper),
            options={"ftol": 1e-4, "maxiter": iterations},
        )
        return np.clip(result.x, self.lower, self.upper) if result.fun <= began else x


def strip_material(finger: Finger) -> StressPolynomial:
    """Return the stress curve [MPa] whose slope is the strips' tangent modulus a e^2 + b e + c."""
    a, b, c = finger.strip.modulus_mpa
    limit = finger.strip.max_strain
    return StressPolynomial("strips", (c, b / 2.0, a / 3.0), finger.strip.poisson, (-limit, limit))


def _at_deflection(
    meshed: MeshedFinger, deflection_rad: float, pulled_mm: float, rad_per_mm: float
) -> tuple[float, Equilibrium]:
    """Return the pulled length that gives a deflection, by secants, and the equilibrium there.

    Raises:
        GdfeError: none is found.
    """
    before: tuple[float, float] | None = None
    for _ in range(SECANTS):
        closed = meshed.close(pulled_mm)
        angles, _ = link_angles(meshed.mesh, meshed.mesh.mesh.nodes + closed.displacement)
        missing = deflection_rad - float(angles[-1])
        if abs(missing) <= DEFLECTION_TOLERANCE_RAD:
            return pulled_mm, closed
        if before is not None:
            rad_per_mm = (before[1] - missing) / (pulled_mm - before[0])
        before = pulled_mm, missing
        pulled_mm = max(0.2 * pulled_mm, pulled_mm + missing / rad_per_mm)
    raise GdfeError(
        f"expected a deflection of {math.degrees(deflection_rad):.1f} deg, found no pulled length that gives it"
    )
