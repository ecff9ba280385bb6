# SPDX-License-Identifier: Apache-2.0
"""Which points to measure: D-optimal designs, that make the coefficients' joint confidence region smallest."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softgrip_model.friction.errors import DataError
from softgrip_model.friction.laws import FrictionLaw

Array = NDArray[np.float64]

_EXCHANGES = 200
_STARTS = 12


def next_best(law: FrictionLaw, slopes: Array, angle: ArrayLike, tension_low: ArrayLike) -> int:
    """Return the candidate whose measurement raises det(J^T J) most.

    Args:
        law: present coefficients.
        slopes: d ln Rf / d coefficient at the points measured so far, shape (points, p).
        angle: of the candidates [rad], shape (candidates,).
        tension_low: T2 of the candidates [N], shape (candidates,).
    """
    rows = _candidate_rows(law, angle, tension_low)
    scale = np.linalg.norm(rows, axis=0)
    information = (slopes / scale).T @ (slopes / scale)
    inverse = np.linalg.pinv(information, hermitian=True)
    gains = np.einsum("ij,jk,ik->i", rows / scale, inverse, rows / scale)
    return int(np.argmax(gains))


def optimal_design(
    law: FrictionLaw, angle: ArrayLike, tension_low: ArrayLike, count: int = 9, seed: int = 0
) -> NDArray[np.intp]:
    """Return ``count`` candidates, repeats allowed, with the largest det(J^T J): Fedorov exchange from several starts.

    Args:
        law: coefficients near the expected ones (the design depends on them only weakly).
        angle: of the candidates [rad], shape (candidates,).
        tension_low: T2 of the candidates [N], shape (candidates,).
        count: points to choose, at least the number of coefficients.
        seed: of the starts.

    Raises:
        DataError: fewer points than coefficients, or candidates that cannot tell the coefficients apart.
    """
    rows = _candidate_rows(law, angle, tension_low)
    if count < rows.shape[1]:
        raise DataError(f"design: expected at least {rows.shape[1]} points for the {law.law} law, found {count}")
    rng = np.random.default_rng(seed)
    best: tuple[float, NDArray[np.intp]] | None = None
    for _ in range(_STARTS):
        chosen = _exchange(rows, rng.integers(0, len(rows), count))
        value = log_determinant(rows[chosen])
        if np.isfinite(value) and (best is None or value > best[0] + 1e-9):
            best = value, chosen
    if best is None:
        raise DataError("design: expected candidates at two angles and two loads at least, found fewer")
    return np.sort(best[1])


def efficiency(law: FrictionLaw, angle: ArrayLike, tension_low: ArrayLike, chosen: ArrayLike) -> float:
    """Return the D-efficiency of chosen candidates against the optimal design of as many points, 0 .. 1."""
    rows = _candidate_rows(law, angle, tension_low)
    indices = np.asarray(chosen, dtype=np.intp)
    best = optimal_design(law, angle, tension_low, len(indices))
    return float(np.exp((log_determinant(rows[indices]) - log_determinant(rows[best])) / rows.shape[1]))


def log_determinant(rows: Array) -> float:
    """Return ln det(J^T J) of a Jacobian's rows; -inf when singular."""
    sign, value = np.linalg.slogdet(rows.T @ rows)
    return float(value) if sign > 0 else -np.inf


def _candidate_rows(law: FrictionLaw, angle: ArrayLike, tension_low: ArrayLike) -> Array:
    return law.evaluate(np.ravel(np.asarray(angle)), np.ravel(np.asarray(tension_low))).d_coefficients


def _exchange(rows: Array, chosen: NDArray[np.intp]) -> NDArray[np.intp]:
    """Swap one point for a candidate as long as the determinant grows."""
    count, size = len(chosen), rows.shape[1]
    scaled = rows / np.linalg.norm(rows, axis=0)
    ridge = 1e-9 * np.eye(size)
    for _ in range(_EXCHANGES):
        inverse = np.linalg.inv(scaled[chosen].T @ scaled[chosen] + ridge)
        spread = scaled @ inverse @ scaled.T
        own = np.diag(spread)
        # Fedorov's delta: relative growth of the determinant when point i is replaced by candidate j.
        growth = own[np.newaxis, :] - (own[chosen][:, np.newaxis] * (1.0 + own) - spread[chosen] ** 2)
        i, j = divmod(int(np.argmax(growth)), len(rows))
        if growth[i, j] <= 1e-9:
            break
        chosen = chosen.copy()
        chosen[i] = j
    return chosen[:count]
