# SPDX-License-Identifier: Apache-2.0
"""How one mounted finger differs from its prediction when it closes on nothing, learned from the check after a swap.

The predictor knows the profile; this finger is a printed piece of it. Its stiffness and the motor's torque constant are
off by some per cent, which would drown a light contact. The difference is smooth in the pulled length: a table will do.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softgrip_cell.errors import CatalogueError
from softgrip_cell.yaml_fields import with_present_names

#: Distance of the table's rows [m].
BIN_M: Final = 0.001

#: A row needs this many samples, else its neighbours speak for it.
BIN_SAMPLES: Final = 3


@dataclass(frozen=True)
class FreeReference:
    """Table of measured minus predicted tension over pulled length.

    Attributes:
        pulled_length_m: rows, rising [m].
        offset_n: mean difference [N].
        tension_n: mean tension measured [N].
        stddev_n: one standard deviation of a single sample about the table [N].
        friction_model: id of the predictor's friction model when it was taken.
        friction_digest: of its numbers; a model with another one makes the table void.
    """

    pulled_length_m: tuple[float, ...]
    offset_n: tuple[float, ...]
    tension_n: tuple[float, ...]
    stddev_n: float
    friction_model: str
    friction_digest: str = ""

    def __post_init__(self) -> None:
        rows = len(self.pulled_length_m)
        if not rows or len(self.offset_n) != rows or len(self.tension_n) != rows:
            raise CatalogueError(
                f"free reference: expected {rows or 'one or more'} rows in every column, found {len(self.offset_n)} "
                f"offsets and {len(self.tension_n)} tensions"
            )
        if any(b <= a for a, b in pairwise(self.pulled_length_m)) or not all(
            map(math.isfinite, (*self.offset_n, *self.tension_n, self.stddev_n))
        ):
            raise CatalogueError("free reference: expected rising rows and finite offsets; check the finger again")

    @property
    def reach_m(self) -> float:
        """Longest pulled length that was checked [m]."""
        return self.pulled_length_m[-1]

    def offset(self, pulled_length_m: float) -> float:
        """Return the difference to expect at a pulled length [N]; the outermost rows hold beyond the table."""
        return float(np.interp(pulled_length_m, self.pulled_length_m, self.offset_n))

    def tension(self, pulled_length_m: float) -> float:
        """Return the tension of the free motion at a pulled length [N]."""
        return float(np.interp(pulled_length_m, self.pulled_length_m, self.tension_n))

    def slope(self, pulled_length_m: float) -> float:
        """Return how fast the tension of the free motion rises at a pulled length [N/m]."""
        return max(0.0, float(np.interp(pulled_length_m, self.pulled_length_m, self._slopes)))

    @cached_property
    def _slopes(self) -> NDArray[np.float64]:
        """Slope at each row [N/m]."""
        if len(self.pulled_length_m) < 2:
            return np.zeros(1)
        return np.asarray(np.gradient(np.asarray(self.tension_n), np.asarray(self.pulled_length_m)), dtype=np.float64)

    def document(self) -> dict[str, object]:
        """Return plain data for storage."""
        return {
            "pulled_length_m": list(self.pulled_length_m),
            "offset_n": list(self.offset_n),
            "tension_n": list(self.tension_n),
            "stddev_n": self.stddev_n,
            "friction_model": self.friction_model,
            "friction_digest": self.friction_digest,
        }

    @staticmethod
    def from_document(document: Mapping[str, object]) -> FreeReference:
        """Read what document() wrote, also under its former names."""
        present: dict[str, Any] = with_present_names(dict(document))
        return FreeReference(
            pulled_length_m=tuple(present["pulled_length_m"]),
            offset_n=tuple(present["offset_n"]),
            tension_n=tuple(present["tension_n"]),
            stddev_n=float(present["stddev_n"]),
            friction_model=str(present["friction_model"]),
            friction_digest=str(present.get("friction_digest", "")),  # tables of older releases have none
        )


def learn_reference(
    pulled_length_m: ArrayLike,
    measured_n: ArrayLike,
    predicted_n: ArrayLike,
    friction_model: str,
    friction_digest: str = "",
) -> FreeReference:
    """Build the table from an empty closing.

    Args:
        pulled_length_m: pulled length of each sample [m].
        measured_n: tension measured [N].
        predicted_n: tension predicted [N].
        friction_model: id used by the predictor.
        friction_digest: of that model's numbers.

    Raises:
        CatalogueError: too few samples for a single row.
    """
    lengths = np.asarray(pulled_length_m, dtype=float)
    measured = np.asarray(measured_n, dtype=float)
    difference = measured - np.asarray(predicted_n, dtype=float)
    rows = np.round(lengths / BIN_M).astype(int)
    kept = [row for row in np.unique(rows) if np.count_nonzero(rows == row) >= BIN_SAMPLES]
    if not kept:
        raise CatalogueError(
            f"free reference: expected at least {BIN_SAMPLES} samples within {BIN_M * 1e3:g} mm of pulled length, "
            f"found {len(lengths)} samples in all; close more slowly"
        )
    centres = [float(lengths[rows == row].mean()) for row in kept]
    offsets = [float(np.median(difference[rows == row])) for row in kept]
    scatter = difference - np.interp(lengths, centres, offsets)
    spread = 1.4826 * float(np.median(np.abs(scatter - np.median(scatter))))  # MAD of a normal distribution
    tensions = [float(np.median(measured[rows == row])) for row in kept]
    return FreeReference(tuple(centres), tuple(offsets), tuple(tensions), spread, friction_model, friction_digest)
