# SPDX-License-Identifier: Apache-2.0
"""The three friction laws, vectorised: Rf = T1/T2 over wrap angle and low tension, with exact derivatives.

Sources: C.-D. Matte, "Toward Predictable Tendon Driven Soft Robots" (2025), Eqs 3.7-3.9; docs/friction.md. The closed
forms live once, in ``include/softgrip/friction.hpp``, and serve every kernel.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from enum import IntFlag, StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softgrip_model.friction import _core
from softgrip_model.friction.errors import LawError

Array = NDArray[np.float64]

#: [m/s^2] as the thesis turns hung grams into newtons (200 g = 1.962 N).
GRAVITY = 9.81
#: [N] below it a tension is evaluated at the floor, and flagged.
TENSION_FLOOR = _core.TENSION_FLOOR_N


class Law(StrEnum):
    """Which law: Eq 3.7, Eq 3.8 (Heap et al.), Eq 3.9 (Matte)."""

    CAPSTAN = "capstan"
    HEAP = "heap"
    MATTE = "matte"


class KReading(StrEnum):
    """Reading of K in Eq 3.8, with x = alpha (1-n) (r/T2)^(1-n) theta.

    PRINTED: K = -x as the thesis prints it. LIMIT: K -> 0. EXACT: K = +x, the integral of dT/dtheta = alpha r^(1-n) T^n
    started from the low tension.
    """

    PRINTED = "printed"
    LIMIT = "limit"
    EXACT = "exact"


class LambdaSign(StrEnum):
    """How a lambda of Table 3.2 goes into Eq 3.9's ``- lambda ln T2``.

    FALLING: its absolute value, so that friction falls with tension as the text says and the data need. PRINTED: the
    table's negative number as it stands, for replicating the thesis' finger results.
    """

    FALLING = "falling"
    PRINTED = "printed"


class LawStatus(IntFlag):
    """What to know about one value; BLOW_UP and INVALID come with NaN."""

    OK = 0
    ANGLE_OUTSIDE_RANGE = 1
    TENSION_OUTSIDE_RANGE = 2
    TENSION_FLOORED = 4
    SURFACE_CLAMPED = 8
    BLOW_UP = 16
    INVALID = 32


COEFFICIENT_NAMES: dict[Law, tuple[str, ...]] = {
    Law.CAPSTAN: ("mu",),
    Law.HEAP: ("alpha", "n"),
    Law.MATTE: ("alpha", "n", "epsilon", "lambda"),
}
_LAW_INDEX = {Law.CAPSTAN: 0, Law.HEAP: 1, Law.MATTE: 2}
_K_INDEX = {KReading.PRINTED: 0, KReading.LIMIT: 1, KReading.EXACT: 2}
_UNBOUNDED = (-math.inf, math.inf)


@dataclass(frozen=True)
class Evaluation:
    """A law's values at many points; all arrays have the broadcast shape S of the inputs.

    Attributes:
        log_ratio: ln Rf, shape S.
        d_angle: d ln Rf / d angle [1/rad], shape S.
        d_log_tension: d ln Rf / d ln T2, shape S.
        d_coefficients: d ln Rf / d coefficient, shape S + (number of coefficients,).
        status: bits of `LawStatus`, shape S.
    """

    log_ratio: Array
    d_angle: Array
    d_log_tension: Array
    d_coefficients: Array
    status: NDArray[np.uint8]

    @property
    def ratio(self) -> Array:
        """Rf = T1/T2, shape S."""
        return np.asarray(np.exp(self.log_ratio))


@dataclass(frozen=True)
class FrictionLaw:
    """One law with its coefficients.

    Attributes:
        law: which.
        coefficients: in the order of `COEFFICIENT_NAMES`; alpha [(N/mm)^(1-n)], the others [1]; lambda as it stands in
            Eq 3.9 (minus sign), so lambda > 0 lets friction fall with tension.
        radius_mm: r = r_cable + r_surface [mm].
        k_reading: reading of K in Eq 3.8.
        angle_range: [rad] calibrated.
        tension_range: [N] calibrated, of T2.
    """

    law: Law
    coefficients: tuple[float, ...]
    radius_mm: float
    k_reading: KReading = KReading.PRINTED
    angle_range: tuple[float, float] = _UNBOUNDED
    tension_range: tuple[float, float] = _UNBOUNDED

    def __post_init__(self) -> None:
        names = COEFFICIENT_NAMES[self.law]
        if len(self.coefficients) != len(names):
            raise LawError(
                f"{self.law}: expected {len(names)} coefficients ({', '.join(names)}), found {len(self.coefficients)}"
            )
        bad = [name for name, value in zip(names, self.coefficients, strict=True) if not math.isfinite(value)]
        if bad:
            raise LawError(f"{self.law}: expected finite coefficients, found {', '.join(bad)} not finite")
        if self.law is not Law.CAPSTAN and not 0.0 < self.coefficients[1] < 1.0:
            raise LawError(f"{self.law}: expected 0 < n < 1, found n = {self.coefficients[1]:g}")
        if not (self.radius_mm > 0.0 and math.isfinite(self.radius_mm)):
            raise LawError(f"expected a radius r = r_cable + r_surface > 0 mm, found {self.radius_mm:g} mm")

    @property
    def names(self) -> tuple[str, ...]:
        """Coefficient names, in order."""
        return COEFFICIENT_NAMES[self.law]

    @property
    def by_name(self) -> dict[str, float]:
        """Coefficients by name."""
        return dict(zip(self.names, self.coefficients, strict=True))

    def with_coefficients(self, coefficients: ArrayLike) -> FrictionLaw:
        """Return the same law with other coefficients."""
        return dataclasses.replace(self, coefficients=tuple(float(c) for c in np.ravel(np.asarray(coefficients))))

    def evaluate(self, angle: ArrayLike, tension_low: ArrayLike) -> Evaluation:
        """Evaluate at wrap angles [rad] and low tensions T2 [N], broadcast against each other."""
        angles, tensions = np.broadcast_arrays(
            np.asarray(angle, dtype=np.float64), np.asarray(tension_low, dtype=np.float64)
        )
        log_ratio, d_angle, d_log_tension, d_coefficients, status = _core.evaluate(
            *self._core_arguments(), self.angle_range, self.tension_range, angles.ravel(), tensions.ravel()
        )
        shape = angles.shape
        return Evaluation(
            log_ratio.reshape(shape),
            d_angle.reshape(shape),
            d_log_tension.reshape(shape),
            d_coefficients.reshape((*shape, len(self.names))),
            status.reshape(shape),
        )

    def ratio(self, angle: ArrayLike, tension_low: ArrayLike) -> Array:
        """Return Rf = T1/T2 at wrap angles [rad] and low tensions [N]; NaN where the law has no value."""
        return self.evaluate(angle, tension_low).ratio

    def blow_up_angle(self, tension_low: float) -> float:
        """Return the wrap angle [rad] from which the printed form has no value; infinite for the others."""
        return float(_core.blow_up_angle(*self._core_arguments(), tension_low))

    @property
    def vanishing_tension(self) -> float:
        """T2 [N] at which the surface term epsilon - lambda ln T2 reaches zero; infinite when it never does."""
        if self.law is not Law.MATTE:
            return math.inf
        epsilon, lam = self.coefficients[2:]
        return math.exp(min(epsilon / lam, 700.0)) if lam > 0.0 else math.inf

    def _core_arguments(self) -> tuple[int, int, list[float], float]:
        return _LAW_INDEX[self.law], _K_INDEX[self.k_reading], list(self.coefficients), self.radius_mm


def law_index(law: Law) -> int:
    """Return the number by which the core knows a law."""
    return _LAW_INDEX[law]


def k_index(reading: KReading) -> int:
    """Return the number by which the core knows a reading of K."""
    return _K_INDEX[reading]
