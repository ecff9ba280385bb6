# SPDX-License-Identifier: Apache-2.0
"""Compare what a node said when it was recorded with what it says when the bag is fed back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from softgrip_time.units import to_s

#: Fields left out of the comparison: topic type -> field names.
NOT_COMPARED = {
    # measures of the machine, not of the cell
    "softgrip_interfaces/msg/PredictedShape": frozenset({"solve_time", "rate"}),
}

#: Numbers smaller than this count as this large when a tolerance is given: what ought to be zero is noise of others.
FLOOR = 1e-3


@dataclass(frozen=True)
class Divergence:
    """The first difference: where, when, and both values."""

    topic: str
    stamp: int  # [ns]
    field: str
    recorded: object
    replayed: object

    def __str__(self) -> str:
        """Return it in one line."""
        return (
            f"{self.topic} at {to_s(self.stamp):.9f} s, field {self.field}: "
            f"recorded {self.recorded!r}, replayed {self.replayed!r}"
        )


@dataclass(frozen=True)
class ReplayResult:
    """How many outputs were compared, and the first that differs."""

    compared: int
    divergence: Divergence | None
    without_input: int = 0  # recorded outputs whose input the recorder did not get; not compared

    @property
    def identical(self) -> bool:
        """True when something was compared and nothing differs."""
        return self.compared > 0 and self.divergence is None


def first_difference(
    recorded: Any, replayed: Any, skip: frozenset[str], path: str = "", tolerance: float = 0.0
) -> tuple[str, Any, Any] | None:
    """Return (field, recorded, replayed) of the first leaf that differs; NaN equals NaN.

    Args:
        recorded: tree of dicts, lists and plain values.
        replayed: tree of the same type.
        skip: names of fields that are not compared.
        path: of the trees in a larger one.
        tolerance: of numbers with a fraction, relative to the larger one or to `FLOOR`; 0 = bit for bit.
    """
    if isinstance(recorded, Mapping):
        pairs = [
            (f"{path}.{key}" if path else key, value, replayed[key])
            for key, value in recorded.items()
            if key not in skip
        ]
    elif isinstance(recorded, Sequence) and not isinstance(recorded, (str, bytes)):
        if len(recorded) != len(replayed):
            return f"{path}.length", len(recorded), len(replayed)
        both = enumerate(zip(recorded, replayed, strict=True))
        pairs = [(f"{path}[{index}]", a, b) for index, (a, b) in both]
    else:
        return None if _same(recorded, replayed, tolerance) else (path, recorded, replayed)
    differences = (first_difference(a, b, skip, name, tolerance) for name, a, b in pairs)
    return next((found for found in differences if found), None)


def _same(recorded: object, replayed: object, tolerance: float) -> bool:
    both_nan = recorded != recorded and replayed != replayed  # noqa: PLR0124  NaN is the value unequal to itself
    if recorded == replayed or both_nan:
        return True
    if not (tolerance and isinstance(recorded, float) and isinstance(replayed, float)):
        return False
    return abs(recorded - replayed) <= tolerance * max(abs(recorded), abs(replayed), FLOOR)
