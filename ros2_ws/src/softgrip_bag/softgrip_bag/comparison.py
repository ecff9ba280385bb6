# SPDX-License-Identifier: Apache-2.0
"""Compare what a node said when it was recorded with what it says when the bag is fed back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

#: Fields left out of the comparison: topic type -> field names.
NOT_COMPARED = {
    # measures of the machine, not of the cell
    "softgrip_interfaces/msg/PredictedShape": frozenset({"solve_time", "rate"}),
    # names which of the two inputs of the same stamp came last; between two topics a bag does not know that
    "softgrip_interfaces/msg/PredictionResidual": frozenset({"frame_id"}),
}


@dataclass(frozen=True)
class Divergence:
    """The first difference: where, when, and both values."""

    topic: str
    stamp: int  # [ns]
    field: str
    recorded: Any
    replayed: Any

    def __str__(self) -> str:
        """Say it in one line."""
        return (
            f"{self.topic} at {self.stamp * 1e-9:.9f} s, field {self.field}: "
            f"recorded {self.recorded!r}, replayed {self.replayed!r}"
        )


@dataclass(frozen=True)
class Result:
    """How many outputs were compared, and the first that differs."""

    compared: int
    divergence: Divergence | None
    without_input: int = 0  # recorded outputs whose input the recorder did not get; not compared

    @property
    def identical(self) -> bool:
        """True when something was compared and nothing differs."""
        return self.compared > 0 and self.divergence is None


Tree = Mapping[str, Any]


def first_difference(recorded: Any, replayed: Any, skip: frozenset[str], path: str = "") -> tuple[str, Any, Any] | None:
    """Return (field, recorded, replayed) of the first leaf that differs, bit for bit; NaN equals NaN."""
    if isinstance(recorded, Mapping):
        for key, value in recorded.items():
            if key in skip:
                continue
            found = first_difference(value, replayed[key], skip, f"{path}.{key}" if path else key)
            if found:
                return found
        return None
    if isinstance(recorded, Sequence) and not isinstance(recorded, (str, bytes)):
        if len(recorded) != len(replayed):
            return f"{path}.length", len(recorded), len(replayed)
        for index, (a, b) in enumerate(zip(recorded, replayed, strict=True)):
            found = first_difference(a, b, skip, f"{path}[{index}]")
            if found:
                return found
        return None
    both_nan = recorded != recorded and replayed != replayed  # noqa: PLR0124  NaN is the value unequal to itself
    return None if recorded == replayed or both_nan else (path, recorded, replayed)
