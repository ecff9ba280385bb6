# SPDX-License-Identifier: Apache-2.0
"""The method as the thesis writes it (chapter 5): shape factors from stiffness ratios, the previous shape V^P.

For reproduction only: forces vanish as increments are refined, because V^P forgets stress (docs/gdfe.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from softgrip_model.gdfe.errors import GdfeError
from softgrip_model.gdfe.solver import ConstitutiveLaw, Equilibrium, Solver

Array = NDArray[np.float64]


class Tangent(Protocol):
    """A material whose tangent modulus is known."""

    def tangent_modulus(self, strain: Array) -> Array:
        """Return dP/de at strains."""
        ...


def stiffness_ratio(omega_left: Array, omega_right: Array) -> Array:
    """Return R_M of two shape factors, exactly: E = 3 k w / (2 + w) at small strain."""
    return np.asarray(omega_left * (2.0 + omega_right) / (omega_right * (2.0 + omega_left)))


def shape_factor(relative_modulus: Array) -> Array:
    """Return w of q = E / k: w = 2 q / (3 - q)."""
    q = np.asarray(relative_modulus, dtype=np.float64)
    return np.asarray(2.0 * q / (3.0 - q))


def material_constants(omega: float, k: float = 1.0) -> tuple[float, float]:
    """Return E and nu of the energy with one shape factor: 3 k w / (2 + w), (1 - w) / (2 + w)."""
    return 3.0 * k * omega / (2.0 + omega), (1.0 - omega) / (2.0 + omega)


def geometric_ratio_published(stiffness: Array) -> Array:
    """Return R_G of R_M >= 1 by Eq 5.7; the fit gives 1.01 at 1."""
    r = np.asarray(stiffness, dtype=np.float64)
    return np.asarray(0.0017 * r * r + 1.42245 * r - 0.4141)


def shape_factors_published(moduli: Array) -> Array:
    """Return w of every element by Eq 5.8: h / R_G(E_max / E), h = r_max / (r_max + 1)."""
    ratio = moduli.max() / moduli
    return np.asarray(ratio.max() / (ratio.max() + 1.0) / geometric_ratio_published(ratio))


def shape_factors_closed_form(moduli: Array) -> Array:
    """Return w of every element from the exact small-strain law, the stiffest with Eq 5.8's h."""
    ratio = moduli.max() / moduli
    h = ratio.max() / (ratio.max() + 1.0)
    return shape_factor(3.0 * h / (2.0 + h) / ratio)


def force_unit(moduli: Array, omega: Array) -> float:
    """Return k, which makes the solver's forces physical: E_max (2 + w_max) / (3 w_max)."""
    stiffest = int(np.argmax(moduli))
    w = float(omega[stiffest])
    return float(moduli[stiffest]) * (2.0 + w) / (3.0 * w)


class ThesisState:
    """Keeps a solver's shape factors and last strains as Algorithm 1 asks: `before` goes into `march`.

    Moduli and shape factors are those of the last converged state, taken before the boundary is moved.
    """

    def __init__(
        self,
        solver: Solver,
        materials: Sequence[Tangent],
        factors: Callable[[Array], Array] = shape_factors_published,
        *,
        previous_shape: bool = True,
        update: bool = True,
    ) -> None:
        """Start at rest.

        Args:
            solver: with the thesis law.
            materials: in the order of the mesh's numbers.
            factors: element moduli -> shape factors.
            previous_shape: use V^P (Eqs 5.9, 5.10); False leaves Eq 5.4.
            update: take moduli at the last strain; False keeps those at rest (linear).
        """
        if solver.settings.law is not ConstitutiveLaw.THESIS:
            raise GdfeError(f"expected a solver with the law 'thesis', found {solver.settings.law}")
        self._solver, self._materials, self._factors = solver, materials, factors
        self._previous_shape, self._update = previous_shape, update
        self.moduli = np.zeros(len(solver.mesh.hexes))
        self.omega = np.zeros(len(solver.mesh.hexes))

    def before(self, last: Equilibrium | None) -> None:
        """Set shape factors and last strains for the next increment."""
        count = len(self.moduli)
        strain = last.strain if last is not None else np.zeros(count)
        for index, material in enumerate(self._materials):
            chosen = self._solver.mesh.materials == index
            self.moduli[chosen] = material.tangent_modulus(strain[chosen] if self._update else np.zeros(chosen.sum()))
        self.omega = self._factors(self.moduli)
        self._solver.set_thesis_state(self.omega, strain if self._previous_shape else np.zeros(count))
