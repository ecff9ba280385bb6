# SPDX-License-Identifier: Apache-2.0
"""What a friction model from outside has to be before anything is computed with it, and the digest that names it."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from softgrip_model.digest import text_sha256
from softgrip_model.friction.errors import LawError
from softgrip_model.friction.laws import COEFFICIENT_NAMES, FrictionLaw, KReading, Law

Array = NDArray[np.float64]

#: Coefficients that a cable on a finger can have, as (lowest, highest). Why so far and no farther:
#: mu: cord on plastic has 0.05 to 0.5, rubber on rubber at most 2; without friction there is no law, so 0 is not in it.
#: alpha: the local mu where T/r is 1 N/mm (Eq 3.8), 0.12 to 0.43 in Table 3.2; the fit looks no farther than 3.
#: n: the thesis' laws have 0 < n < 1; towards 1 the law is Capstan's, towards 0 tension has no influence.
#: epsilon, lambda: the surface term of Eq 3.9, 0.06 to 0.18 and 0.01 to 0.05 in Table 3.2; the fit's own search range.
COEFFICIENT_BOUNDS: Final[dict[str, tuple[float, float]]] = {
    "mu": (1e-6, 2.0),
    "alpha": (1e-6, 3.0),
    "n": (1e-3, 0.999),
    "epsilon": (-1.0, 2.0),
    "lambda": (-0.5, 0.5),
}
#: [mm] of r = r_cable + r_surface: thinner than the finest thread, wider than a finger.
RADIUS_MM: Final = (0.01, 100.0)
#: Rounding may make an eigenvalue of a correlation matrix so negative [1].
NEGATIVE_EIGENVALUE: Final = -1e-6


class PublishedFriction(Protocol):
    """A friction model as it comes from outside; names, units and order of softgrip_interfaces/FrictionModel."""

    id: str
    law: str
    k_reading: str
    coefficient_names: Sequence[str]
    coefficients: Sequence[float]
    covariance: Sequence[float]
    cable_radius: float
    surface_radius: float
    angle_range: NDArray[np.float64]
    tension_range: NDArray[np.float64]
    digest: str


@dataclass(frozen=True, eq=False)
class AcceptedFriction:
    """A friction model that may be computed with.

    Attributes:
        law: coefficients, radius and calibrated ranges.
        covariance: of the coefficients in the law's order, (p, p); None when unknown.
        digest: SHA-256 of all numbers, 64 hex digits.
    """

    law: FrictionLaw
    covariance: Array | None
    digest: str


def accept(model: PublishedFriction) -> AcceptedFriction:
    """Check every number of a friction model that came from outside.

    Raises:
        LawError: an unknown law, numbers that it cannot have, or a digest of other numbers; names the model.
    """
    try:
        law, order = _law(model)
        covariance = _covariance(model.covariance, law.names, order)
    except LawError as error:
        raise LawError(f"friction model {model.id!r}: {error}; calibrate again (rig/calibrate)") from error
    digest = model_digest(law, covariance, float(model.cable_radius), float(model.surface_radius))
    if model.digest not in {"", digest}:
        raise LawError(
            f"friction model {model.id!r}: expected the digest of its numbers, {digest[:12]}..., found "
            f"{model.digest[:12]!r}; it was changed on its way: activate it again (friction/activate)"
        )
    return AcceptedFriction(law, covariance, digest)


def model_digest(law: FrictionLaw, covariance: Array | None, cable_radius_m: float, surface_radius_m: float) -> str:
    """Return the SHA-256 of all numbers of a model, 64 hex digits: two models with the same one predict the same.

    Args:
        law: coefficients, reading and calibrated ranges.
        covariance: (p, p) in the law's order; None when unknown.
        cable_radius_m: [m].
        surface_radius_m: [m].
    """
    numbers = {
        "law": str(law.law),
        "k_reading": str(law.k_reading),
        "coefficients": _exact(law.coefficients),
        "covariance": [] if covariance is None else _exact(covariance.ravel()),
        "radii": _exact((cable_radius_m, surface_radius_m)),
        "angle_range": _exact(law.angle_range),
        "tension_range": _exact(law.tension_range),
    }
    return text_sha256(json.dumps(numbers, sort_keys=True))


def _exact(values: Sequence[float] | Array) -> list[str]:
    """Return numbers without rounding, the same on every machine."""
    return [float(value).hex() for value in values]


def _law(model: PublishedFriction) -> tuple[FrictionLaw, list[int]]:
    """Return the law, and where each of its coefficients stands in the message."""
    try:
        kind, reading = Law(model.law), KReading(model.k_reading or KReading.PRINTED)
    except ValueError as error:
        raise LawError(
            f"expected a law of {', '.join(Law)} and a reading of {', '.join(KReading)}, "
            f"found {model.law!r} and {model.k_reading!r}"
        ) from error
    given, names = list(model.coefficient_names), COEFFICIENT_NAMES[kind]
    if sorted(given) != sorted(names) or len(model.coefficients) != len(names):
        raise LawError(
            f"expected coefficients {', '.join(names)} of {kind}, found {len(model.coefficients)} numbers for {given}"
        )
    order = [given.index(name) for name in names]
    coefficients = tuple(float(model.coefficients[index]) for index in order)
    for name, value in zip(names, coefficients, strict=True):
        low, high = COEFFICIENT_BOUNDS[name]
        if not low <= value <= high:  # also NaN
            raise LawError(f"{kind}: expected {low:g} <= {name} <= {high:g}, found {value:g}")
    radius_mm = 1e3 * (float(model.cable_radius) + float(model.surface_radius))
    if not (RADIUS_MM[0] <= radius_mm <= RADIUS_MM[1] and min(model.cable_radius, model.surface_radius) >= 0.0):
        raise LawError(
            f"expected radii >= 0 with a sum of {RADIUS_MM[0]:g} to {RADIUS_MM[1]:g} mm, "
            f"found {1e3 * model.cable_radius:g} and {1e3 * model.surface_radius:g} mm"
        )
    ranges = _range("angle_range", model.angle_range, "rad"), _range("tension_range", model.tension_range, "N")
    return FrictionLaw(kind, coefficients, radius_mm, reading, *ranges), order


def _range(name: str, ends: Iterable[float], unit: str) -> tuple[float, float]:
    low, high = (float(end) for end in ends)
    if not 0.0 <= low < high < math.inf:
        raise LawError(f"{name}: expected 0 <= low < high, both finite, found {low:g} and {high:g} {unit}")
    return low, high


def _covariance(flat: Sequence[float], names: Sequence[str], order: Sequence[int]) -> Array | None:
    """Return the covariance in the law's order; it has to be one: symmetric, no negative eigenvalue."""
    values, count = np.array(flat, dtype=np.float64), len(names)
    if not values.size:
        return None
    if values.size != count**2 or not np.isfinite(values).all():
        raise LawError(f"covariance: expected {count**2} finite numbers or none, found {values.size} or not finite")
    matrix = values.reshape(count, count)[np.ix_(order, order)]
    stddev = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    scale = np.where(stddev > 0.0, stddev, 1.0)
    correlation = matrix / np.outer(scale, scale)
    if not np.allclose(correlation, correlation.T, atol=1e-6):
        raise LawError("covariance: expected a symmetric matrix, found another one")
    smallest = float(np.linalg.eigvalsh(correlation)[0])
    if (np.diag(matrix) < 0.0).any() or smallest < NEGATIVE_EIGENVALUE:
        raise LawError(
            f"covariance: expected no negative variance, found an eigenvalue of {smallest:.3g} in its correlations"
        )
    return matrix
