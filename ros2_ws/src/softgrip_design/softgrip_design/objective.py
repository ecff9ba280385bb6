# SPDX-License-Identifier: Apache-2.0
"""What a good finger is, as a number with its exact gradient to the design variables.

A design vector x has an objective's variables in mm: thicknesses h (n), then routing distances r (2 n), or r alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from softgrip_design.errors import DesignError
from softgrip_design.target import DesignTarget
from softgrip_model.finger import Control, Finger, Kernel, Solution
from softgrip_model.friction.laws import FrictionLaw

Array = NDArray[np.float64]

#: [deg^2] keeps the root of Eq 4.4 and Eq 3.10 differentiable at a perfect fit.
ROUNDING_DEG2 = 1e-12


class Objective(Protocol):
    """A function to be made small within bounds."""

    @property
    def lower(self) -> Array:
        """Smallest design vector [mm]."""

    @property
    def upper(self) -> Array:
        """Largest design vector [mm]."""

    def value(self, x: Array) -> float:
        """Return the objective; infinity where the finger has no equilibrium."""

    def value_and_gradient(self, x: Array) -> tuple[float, Array]:
        """Return the objective and its derivatives to x [per mm]."""


@dataclass(frozen=True)
class Weights:
    """Of Eq 4.5: trajectory error [deg] and actuation force [N]."""

    error: float = 2.0
    force: float = 1.0


class FollowTrajectory:
    """Eq 4.5: the weighted sum of trajectory error E_T (Eq 4.4) and of the force E_F that the full closing takes."""

    def __init__(
        self,
        finger: Finger,
        law: FrictionLaw,
        target: DesignTarget,
        weights: Weights,
        thickness_mm: tuple[float, float],
        routing_mm: tuple[float, float],
    ) -> None:
        """Prepare the kernel.

        Args:
            finger: lengths and material; its thickness and routing do not matter.
            law: friction of cable on finger.
            target: joint angles to follow.
            weights: of error and force.
            thickness_mm: bounds of every h.
            routing_mm: bounds of every r.

        Raises:
            DesignError: target and finger differ in their joints, or the grooves close before the target ends.
        """
        n = finger.joints
        if target.joints != n:
            raise DesignError(f"expected a target with {n} joints, found {target.joints}")
        reach = sum(finger.opening_rad) - n * finger.stop_margin_rad
        if target.deflection_rad[-1] > reach:
            raise DesignError(
                f"expected a deflection of {math.degrees(reach):.0f} deg at most, where the grooves are closed, found "
                f"{math.degrees(target.deflection_rad[-1]):.0f} deg; cut the motion shorter"
            )
        self.lower = np.repeat([thickness_mm[0], routing_mm[0]], [n, 2 * n])
        self.upper = np.repeat([thickness_mm[1], routing_mm[1]], [n, 2 * n])
        self.target = target
        self._base, self._weights, self._joints = finger, weights, n
        self._kernel = Kernel([finger], law)

    def finger(self, x: Array) -> Finger:
        """Return the finger that x describes."""
        return self._base.with_design(x[: self._joints], x[self._joints :])

    def solve(self, x: Array, *, gradient: bool = False) -> Solution:
        """Return the finger's equilibria at the target's deflections, (1, steps)."""
        n = self._joints
        kernel = self._kernel.varied(x[None, :n], x[None, n:])
        return kernel.solve(self.target.deflection_rad, Control.DEFLECTION, gradient=gradient, threads=1)

    def scores(self, designs: Array) -> tuple[Array, Array]:
        """Return E_T [deg] and E_F [N] of many designs at once, in one thread.

        Args:
            designs: design vectors [mm], (N, variables).

        Returns:
            errors and forces, (N,) each; NaN where a finger has no equilibrium.
        """
        n = self._joints
        kernel = self._kernel.varied(designs[:, :n], designs[:, n:])
        solution = kernel.solve(self.target.deflection_rad, Control.DEFLECTION, threads=1)
        deviation = np.degrees(solution.angle_rad - self.target.angle_rad)
        error = np.sqrt(np.mean(deviation**2, axis=(1, 2)))
        failed = solution.failed.reshape(len(designs), -1).any(axis=1)
        return np.where(failed, np.nan, error), np.where(failed, np.nan, solution.tension_n[:, -1, 0])

    def error_deg(self, x: Array) -> float:
        """Return E_T, Eq 4.4 [deg]."""
        return float(np.sqrt(np.mean(self._deviation_deg(self.solve(x)) ** 2)))

    def force_n(self, x: Array) -> float:
        """Return E_F: tension at the actuator when fully closed [N]."""
        return float(self.solve(x).tension_n[0, -1, 0])

    def value(self, x: Array) -> float:
        """Return E of Eq 4.5; infinity where the finger has no equilibrium."""
        solution = self.solve(x)
        if solution.failed.any():
            return math.inf
        error = math.sqrt(np.mean(self._deviation_deg(solution) ** 2) + ROUNDING_DEG2)
        return float(self._weights.error * error + self._weights.force * solution.tension_n[0, -1, 0])

    def value_and_gradient(self, x: Array) -> tuple[float, Array]:
        """Return E and its derivatives to x [per mm]."""
        solution = self.solve(x, gradient=True)
        if solution.failed.any() or solution.gradient is None:
            return math.inf, np.zeros_like(x)
        n = self._joints
        deviation = self._deviation_deg(solution)
        error = math.sqrt(np.mean(deviation**2) + ROUNDING_DEG2)
        to_design = solution.gradient.values[0, :, :, 1 : 1 + 3 * n]
        angles = np.degrees(to_design[:, :n]).reshape(-1, 3 * n)
        slope_error = deviation.ravel() @ angles / (deviation.size * error)
        slope_force = to_design[-1, n + 2]
        weights = self._weights
        value = weights.error * error + weights.force * float(solution.tension_n[0, -1, 0])
        return value, np.asarray(weights.error * slope_error + weights.force * slope_force)

    def _deviation_deg(self, solution: Solution) -> Array:
        return np.asarray(np.degrees(solution.angle_rad[0] - self.target.angle_rad))


class CloseUniformly:
    """Eq 3.10 (section 3.4): all joints equal while the cable is pulled; the routing alone varies.

    The root of the mean over the closing of the summed *squares* is taken, which is what the published value fits;
    with |.| as printed it would be about half of it (docs/finger.md).
    """

    def __init__(
        self, finger: Finger, law: FrictionLaw, routing_mm: tuple[float, float], pull_mm: float, steps: int
    ) -> None:
        """Prepare the kernel.

        Args:
            finger: everything but the routing.
            law: friction of cable on finger.
            routing_mm: bounds of every r.
            pull_mm: pulled length at the end.
            steps: n of Eq 3.10.
        """
        self.lower = np.full(2 * finger.joints, routing_mm[0])
        self.upper = np.full(2 * finger.joints, routing_mm[1])
        self.pulls_mm = pull_mm * np.arange(1, steps + 1) / steps
        self._base, self._kernel = finger, Kernel([finger], law)
        self._thickness = np.array([finger.thickness_mm])

    def finger(self, x: Array) -> Finger:
        """Return the finger that x describes."""
        return self._base.with_design(self._base.thickness_mm, x)

    def solve(self, x: Array, *, gradient: bool = False) -> Solution:
        """Return the finger's equilibria at the pulled lengths, (1, steps)."""
        return self._kernel.varied(self._thickness, x[None]).solve(self.pulls_mm, gradient=gradient, threads=1)

    def value(self, x: Array) -> float:
        """Return Eq 3.10 with squares [deg]; infinity where the finger has no equilibrium."""
        solution = self.solve(x)
        if solution.failed.any():
            return math.inf
        return math.sqrt((self._spread_deg(solution) ** 2).sum() / len(self.pulls_mm) + ROUNDING_DEG2)

    def value_and_gradient(self, x: Array) -> tuple[float, Array]:
        """Return Eq 3.10 and its derivatives to x [per mm]."""
        solution = self.solve(x, gradient=True)
        if solution.failed.any() or solution.gradient is None:
            return math.inf, np.zeros_like(x)
        spread = self._spread_deg(solution)
        value = math.sqrt((spread**2).sum() / len(self.pulls_mm) + ROUNDING_DEG2)
        # the mean's own derivative drops out: deviations from it sum to zero
        angles = np.degrees(solution.gradient.routing[0, :, : self._base.joints]).reshape(-1, len(x))
        return value, np.asarray(spread.ravel() @ angles / (len(self.pulls_mm) * value))

    @staticmethod
    def _spread_deg(solution: Solution) -> Array:
        angles = np.degrees(solution.angle_rad[0])
        return np.asarray(angles - angles.mean(axis=1, keepdims=True))
