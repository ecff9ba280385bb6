# SPDX-License-Identifier: Apache-2.0
"""Materials as the calibrated law takes them: shear secant modulus over equivalent strain, from a stress curve.

Stresses in MPa with lengths in mm and forces in N, or any other consistent set.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from softgrip_model.gdfe.errors import GdfeError

Array = NDArray[np.float64]

#: Equivalent strains (nu = 0.5) up to this are tabulated; beyond, the modulus stays what it is there.
TABLE_END = 4.0
#: Pieces of a table.
TABLE_CELLS = 512


class SolidMaterial(Protocol):
    """What the calibrated law asks of a material."""

    @property
    def name(self) -> str:
        """For messages."""
        ...

    @property
    def poisson(self) -> float:
        """Poisson's ratio of the volume term, 0 <= nu < 0.5."""
        ...

    @property
    def strain_range(self) -> tuple[float, float]:
        """Nominal uniaxial strains that the material was measured at, or is stable at."""
        ...

    def nominal_stress(self, stretch: Array) -> Array:
        """Return the uniaxial nominal stress of the incompressible material at stretches > 0 (any shape)."""
        ...

    def initial_modulus(self) -> float:
        """Return Young's modulus at rest."""
        ...


def _check_poisson(name: str, poisson: float) -> None:
    if not 0.0 <= poisson < 0.5:
        raise GdfeError(f"material {name!r}: expected a Poisson ratio of 0 or more and below 0.5, found {poisson!r}")


@dataclass(frozen=True)
class Linear:
    """Hooke's law in the element's own rotated frame: shear modulus and volume term do not change."""

    name: str
    modulus: float
    """Young's modulus E."""
    poisson: float
    strain_range: tuple[float, float] = (-math.inf, math.inf)

    def __post_init__(self) -> None:
        _check_poisson(self.name, self.poisson)
        if not 0.0 < self.modulus < math.inf:
            raise GdfeError(f"material {self.name!r}: expected a Young's modulus above 0, found {self.modulus!r}")

    def nominal_stress(self, stretch: Array) -> Array:
        """Return E (stretch - 1)."""
        return np.asarray(self.modulus * (stretch - 1.0))

    def tangent_modulus(self, strain: Array) -> Array:
        """Return E at strains (any shape)."""
        return np.full_like(np.asarray(strain, dtype=np.float64), self.modulus)

    def initial_modulus(self) -> float:
        """Return E."""
        return self.modulus


@dataclass(frozen=True)
class StressPolynomial:
    """A polynomial of nominal stress over nominal strain fitted to a tensile test; odd in compression.

    Beyond the end of its range the stress goes on with the slope it has there.
    """

    name: str
    coefficients: tuple[float, ...]
    """c1, c2, ...: stress = c1 e + c2 e^2 + ..."""
    poisson: float
    strain_range: tuple[float, float]

    def __post_init__(self) -> None:
        _check_poisson(self.name, self.poisson)
        if not self.coefficients or not all(math.isfinite(c) for c in self.coefficients) or self.coefficients[0] <= 0.0:
            raise GdfeError(f"material {self.name!r}: expected finite coefficients, c1 > 0, found {self.coefficients}")
        if not self.strain_range[0] < 0.0 < self.strain_range[1]:
            raise GdfeError(f"material {self.name!r}: expected a strain range around 0, found {self.strain_range}")

    def nominal_stress(self, stretch: Array) -> Array:
        """Return the stress at stretches (any shape)."""
        strain = np.asarray(stretch) - 1.0
        size = np.abs(strain)
        inside = np.minimum(size, self.strain_range[1])
        polynomial = np.polynomial.Polynomial((0.0, *self.coefficients))
        slope = polynomial.deriv()(self.strain_range[1])
        return np.asarray(np.sign(strain) * (polynomial(inside) + slope * (size - inside)))

    def tangent_modulus(self, strain: Array) -> Array:
        """Return the slope of the stress at strains (any shape), at the end of the range beyond it."""
        slope = np.polynomial.Polynomial((0.0, *self.coefficients)).deriv()
        return np.asarray(slope(np.minimum(np.abs(strain), self.strain_range[1])))

    def initial_modulus(self) -> float:
        """Return c1."""
        return self.coefficients[0]


@dataclass(frozen=True)
class Ogden:
    """W = sum 2 mu_i / alpha_i^2 (l1^alpha_i + l2^alpha_i + l3^alpha_i - 3) (Eq 5.11) and a volume term."""

    name: str
    moduli: tuple[float, ...]
    """mu_i"""
    exponents: tuple[float, ...]
    """alpha_i"""
    poisson: float
    strain_range: tuple[float, float] = (-0.9, 5.0)

    def __post_init__(self) -> None:
        _check_poisson(self.name, self.poisson)
        if len(self.moduli) != len(self.exponents) or not self.moduli:
            raise GdfeError(
                f"material {self.name!r}: expected as many mu as alpha, found {len(self.moduli)}, {len(self.exponents)}"
            )
        if 0.0 in self.exponents or self.initial_modulus() <= 0.0:
            raise GdfeError(f"material {self.name!r}: expected alpha other than 0 and a positive sum of mu")

    @property
    def shear_modulus(self) -> float:
        """Shear modulus at rest, sum mu."""
        return sum(self.moduli)

    @property
    def bulk_modulus(self) -> float:
        """K = 2 mu (1 + nu) / (3 (1 - 2 nu)) of the volume term; CalculiX' D1 is 2 / K."""
        return 2.0 * self.shear_modulus * (1.0 + self.poisson) / (3.0 * (1.0 - 2.0 * self.poisson))

    def nominal_stress(self, stretch: Array) -> Array:
        """Return sum 2 mu / alpha (l^(alpha-1) - l^(-alpha/2-1)) at stretches (any shape)."""
        l = np.asarray(stretch, dtype=np.float64)  # noqa: E741  lambda of the equation
        return np.asarray(
            sum(
                2.0 * mu / alpha * (l ** (alpha - 1.0) - l ** (-alpha / 2.0 - 1.0))
                for mu, alpha in zip(self.moduli, self.exponents, strict=True)
            )
        )

    def initial_modulus(self) -> float:
        """Return 3 sum mu: Young's modulus of the incompressible material at rest."""
        return 3.0 * sum(self.moduli)

    def stable(self, stretches: Array) -> NDArray[np.bool_]:
        """Say whether Drucker's condition holds at principal stretches (..., 3), taken at constant volume, (...).

        d tau : d ln l > 0 for every change of shape: with s_i = sum 2 mu/alpha l_i^alpha and c_i = d s_i / d ln l_i =
        sum 2 mu l_i^alpha the changes e1 = a, e2 = b, e3 = -a - b ask of the matrix
        [[c1 + c3, c3], [c3, c2 + c3]] to be positive definite.
        """
        l = np.asarray(stretches, dtype=np.float64)  # noqa: E741  lambda of the equation
        l = l / np.cbrt(l.prod(axis=-1))[..., None]  # noqa: E741
        c = np.asarray(sum(2.0 * mu * l**alpha for mu, alpha in zip(self.moduli, self.exponents, strict=True)))
        c1, c2, c3 = c[..., 0], c[..., 1], c[..., 2]
        return np.asarray((c1 + c3 > 0.0) & (c1 * c2 + c3 * (c1 + c2) > 0.0))


def neo_hookean(name: str, shear_modulus: float, poisson: float) -> Ogden:
    """Return W = mu/2 (l1^2 + l2^2 + l3^2 - 3) as the Ogden material that it is."""
    return Ogden(name, (shear_modulus,), (2.0,), poisson)


def ninjaflex(poisson: float = 0.45) -> StressPolynomial:
    """Return the polynomial of section 5.4 for printed NinjaFlex [MPa], fitted up to 200 % strain."""
    return StressPolynomial("NinjaFlex", (8.67, -15.7, 15.02, -6.91, 1.53, -0.13), poisson, (-0.3, 2.0))


def cheetah(poisson: float = 0.45) -> StressPolynomial:
    """Return the polynomial of section 5.4 for printed Cheetah [MPa], fitted up to 200 % strain."""
    return StressPolynomial("Cheetah", (19.13, -26.6, 19.9, -7.69, 1.49, -0.11), poisson, (-0.3, 2.0))


def ninjaflex_ogden(poisson: float = 0.45) -> Ogden:
    """Return Table 5.1's Ogden constants for NinjaFlex [MPa]."""
    return Ogden("NinjaFlex", (0.187297, 0.091893, 3.397167), (1.940480, 4.009788, -1.512803), poisson, (-0.8, 4.0))


def cheetah_ogden(poisson: float = 0.45) -> Ogden:
    """Return Table 5.1's Ogden constants for Cheetah [MPa]; unstable compressed below a stretch of 0.69."""
    return Ogden("Cheetah", (-5.497378, 2.499418, 12.259373), (3.303409, 3.722506, -4.762911), poisson, (-0.31, 4.0))


def stretch_of_equivalent_strain(strain: Array) -> Array:
    """Return l >= 1 with l - l^(-1/2) = 1.5 strain: the uniaxial stretch of an equivalent strain (nu = 0.5)."""
    goal = 1.5 * np.asarray(strain, dtype=np.float64)
    stretch = 1.0 + goal
    for _ in range(50):
        step = (stretch - stretch**-0.5 - goal) / (1.0 + 0.5 * stretch**-1.5)
        stretch = stretch - step
        if np.max(np.abs(step), initial=0.0) < 1e-14:
            break
    return stretch


def shear_secant(material: SolidMaterial, strain: Array) -> Array:
    """Return mu(eps_eq) that gives the material's uniaxial stress back.

    mu = P(l) / (2 [(l - 1) + (1 - q) q / l]), q = l^(-1/2): the bracket is the exact incompressible uniaxial response
    of the energy mu |F - R|^2 with the volume constraint.
    """
    strain = np.asarray(strain, dtype=np.float64)
    if isinstance(material, Linear):
        return np.full_like(strain, material.modulus / (2.0 * (1.0 + material.poisson)))
    # at rest numerator and bracket vanish alike: P = E (l - 1), bracket = 1.5 (l - 1)
    safe = np.maximum(strain, 1e-6)
    stretch = stretch_of_equivalent_strain(safe)
    q = stretch**-0.5
    bracket = (stretch - 1.0) + (1.0 - q) * q / stretch
    secant = material.nominal_stress(stretch) / (2.0 * bracket)
    return np.asarray(np.where(strain < 1e-6, material.initial_modulus() / 3.0, secant))


def secant_table(modulus: Callable[[Array], Array]) -> Array:
    """Return mu(eps) as cubic pieces, (4, TABLE_CELLS): orders of t = 0..1 within the cell."""
    edges = np.linspace(0.0, TABLE_END, TABLE_CELLS + 1)
    inner = edges[:-1, None] + (edges[1] - edges[0]) * np.array([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0])
    values = modulus(inner.ravel()).reshape(inner.shape)
    vandermonde = np.vander(np.array([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0]), increasing=True)
    return np.ascontiguousarray(np.linalg.solve(vandermonde, values.T))
