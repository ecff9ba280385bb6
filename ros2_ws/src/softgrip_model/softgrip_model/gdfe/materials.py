# SPDX-License-Identifier: Apache-2.0
"""Materials as the calibrated law takes them: shear secant modulus over equivalent strain, from a uniaxial test.

Stresses in MPa with lengths in mm and forces in N, or any other consistent set.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from softgrip_model.gdfe.errors import GdfeError

Array = NDArray[np.float64]

#: Equivalent strains (nu = 0.5) up to this are tabulated; beyond, the modulus stays what it is there.
TABLE_END = 4.0
#: Pieces of a table.
TABLE_CELLS = 512


class VolumeShape(StrEnum):
    """How the volume-conserving shape V^v is found (gdfe: scale or projection)."""

    PROJ = "proj"
    SCALE = "scale"


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

    def uniaxial_stress(self, stretch: Array) -> Array:
        """Return the nominal stress of a uniaxial test, with the material's own nu, at stretches > 0 (any shape)."""
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

    def uniaxial_stress(self, stretch: Array) -> Array:
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

    def uniaxial_stress(self, stretch: Array) -> Array:
        """Return the stress at stretches (any shape): the test was done on the material as it is."""
        return self.nominal_stress(stretch)

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
        if 0.0 in self.exponents or self.shear_modulus <= 0.0:
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

    def uniaxial_stress(self, stretch: Array) -> Array:
        """Return the nominal stress at stretches (any shape) where the sides, free of stress, give way as nu has it.

        With l_i' = l_i J^(-1/3): tau_i = sum 2 mu / alpha (l_i'^alpha - mean_k l_k'^alpha) + K J (J - 1), tau_2 = 0.
        """
        along = np.asarray(stretch, dtype=np.float64)

        def stresses(across: Array) -> tuple[Array, Array]:
            volume = along * across**2
            unit = np.cbrt(volume)
            pressure = self.bulk_modulus * volume * (volume - 1.0)
            shape = sum(
                2.0 * mu / alpha * ((along / unit) ** alpha - (across / unit) ** alpha) / 3.0
                for mu, alpha in zip(self.moduli, self.exponents, strict=True)
            )
            return 2.0 * shape + pressure, pressure - shape

        # between sides that stay where they are and sides that keep the volume
        ends = np.minimum(along**-0.5, 1.0), np.maximum(along**-0.5, 1.0)
        return np.asarray(stresses(_root(lambda across: stresses(across)[1], *ends))[0] / along)

    def initial_modulus(self) -> float:
        """Return 2 mu (1 + nu): Young's modulus at rest."""
        return 2.0 * self.shear_modulus * (1.0 + self.poisson)

    def shape_stress(self, stretches: Array) -> Array:
        """Return the deviators of the principal Kirchhoff stresses at principal stretches, both (..., 3)."""
        l = np.asarray(stretches, dtype=np.float64)  # noqa: E741  lambda of the equation
        l = l / np.cbrt(l.prod(axis=-1))[..., None]  # noqa: E741
        s = sum(2.0 * mu / alpha * l**alpha for mu, alpha in zip(self.moduli, self.exponents, strict=True))
        return np.asarray(s - np.mean(s, axis=-1, keepdims=True))

    def stable(self, stretches: Array) -> NDArray[np.bool_]:
        """Return whether Drucker's condition holds at principal stretches (..., 3), taken at constant volume, (...).

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


def _root(function: Callable[[Array], Array], low: Array, high: Array) -> Array:
    """Return where increasing functions of arrays change their sign between two ends, element by element."""
    for _ in range(60):
        middle = 0.5 * (low + high)
        above = function(middle) > 0.0
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return 0.5 * (low + high)


def _drawn_by_projection(strain: Array, lame_per_mu: float) -> tuple[Array, Array]:
    """Return stretch and stress per mu of a bar with free sides at equivalent strains, V^v by projection.

    With the principal stretches L and L^(-1/2) of F*: F* - F is k / L along and k L^(1/2) across. No stress across,
    2 (q - 1) = 3 lame/mu k L^(1/2), gives k = 2 (1/L - L^(-1/2)) / (2 + 3 lame/mu).
    """

    def stretches(kept: Array) -> tuple[Array, Array, Array]:
        k = 2.0 * (1.0 / kept - kept**-0.5) / (2.0 + 3.0 * lame_per_mu)
        return kept - k / kept, kept**-0.5 - k * kept**0.5, k

    def beyond(kept: Array) -> Array:
        along, across, _ = stretches(kept)
        return np.asarray((along - across) / 1.5 - strain)

    kept = _root(beyond, np.ones_like(strain), 1.0 + 1.5 * strain)
    along, _, k = stretches(kept)
    return along, 2.0 * (along - 1.0) - 3.0 * lame_per_mu * k / kept


def _drawn_by_scale(strain: Array, lame_per_mu: float) -> tuple[Array, Array]:
    """Return the same for V^v by scale: F* = J^(-1/3) F, no stress across: 2 (q - 1) + s q = 0, s as below."""

    def swelling(across: Array) -> Array:
        return np.asarray(3.0 * lame_per_mu * (1.0 - np.cbrt(1.0 / ((across + 1.5 * strain) * across**2))))

    def across_stress(across: Array) -> Array:
        return 2.0 * (across - 1.0) + swelling(across) * across

    across = _root(across_stress, np.full_like(strain, 1e-3), np.ones_like(strain))
    along = across + 1.5 * strain
    return along, 2.0 * (along - 1.0) + swelling(across) * along


def shear_secant(material: SolidMaterial, strain: Array, shape: VolumeShape = VolumeShape.PROJ) -> Array:
    """Return mu(eps_eq) with which a uniaxial test of the law, sides free, gives the material's stress back.

    Args:
        material: what is tested.
        strain: equivalent strains (nu = 0.5), (n,).
        shape: how the law finds V^v, by which its sides give way.
    """
    strain = np.asarray(strain, dtype=np.float64)
    at_rest = material.initial_modulus() / (2.0 * (1.0 + material.poisson))
    if isinstance(material, Linear):
        return np.full_like(strain, at_rest)
    lame_per_mu = 2.0 * material.poisson / (1.0 - 2.0 * material.poisson)
    drawn = _drawn_by_scale if shape is VolumeShape.SCALE else _drawn_by_projection
    # stress and stress per mu vanish alike at rest
    stretch, stress_per_mu = drawn(np.maximum(strain, 1e-6), lame_per_mu)
    return np.asarray(np.where(strain < 1e-6, at_rest, material.uniaxial_stress(stretch) / stress_per_mu))


def calibrated_shape_stress(material: SolidMaterial, stretches: Array, shape: VolumeShape = VolumeShape.PROJ) -> Array:
    """Return the deviators of the calibrated law's principal Kirchhoff stresses at principal stretches, both (n, 3).

    Its nominal stresses are 2 mu (l_i - 1) + 3 lame (l_i - l_i*), mu = mu(eps_eq), l* of product 1 (`VolumeShape`).
    """
    l = np.asarray(stretches, dtype=np.float64)  # noqa: E741  lambda of the equation
    apart = l - l.mean(axis=-1, keepdims=True)
    mu = shear_secant(material, np.sqrt((apart**2).sum(axis=-1) / 1.5), shape)
    lame_per_mu = 2.0 * material.poisson / (1.0 - 2.0 * material.poisson)
    kept = l / np.cbrt(l.prod(axis=-1))[..., None] if shape is VolumeShape.SCALE else _nearest_of_volume_one(l)
    stress = mu[..., None] * l * (2.0 * (l - 1.0) + 3.0 * lame_per_mu * (l - kept))
    return np.asarray(stress - stress.mean(axis=-1, keepdims=True))


def _nearest_of_volume_one(l: Array) -> Array:  # noqa: E741  lambda of the equation
    """Return the stretches of product 1 nearest to l, (n, 3): l_i* = l_i + k / l_i*."""

    def moved(k: Array) -> Array:
        return np.asarray(0.5 * (l + np.sqrt(np.maximum(l**2 + 4.0 * k[..., None], 0.0))))

    low = -0.25 * l.min(axis=-1) ** 2
    return moved(_root(lambda k: moved(k).prod(axis=-1) - 1.0, low, np.full_like(low, 4.0)))


def secant_table(modulus: Callable[[Array], Array]) -> Array:
    """Return mu(eps) as cubic pieces, (4, TABLE_CELLS): orders of t = 0..1 within the cell."""
    edges = np.linspace(0.0, TABLE_END, TABLE_CELLS + 1)
    inner = edges[:-1, None] + (edges[1] - edges[0]) * np.array([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0])
    values = modulus(inner.ravel()).reshape(inner.shape)
    vandermonde = np.vander(np.array([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0]), increasing=True)
    return np.ascontiguousarray(np.linalg.solve(vandermonde, values.T))
