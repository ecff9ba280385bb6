# SPDX-License-Identifier: Apache-2.0
"""Seconds and nanoseconds: stamps and what is compared with them are whole nanoseconds, all other times seconds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, overload

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

NANOSECONDS: Final = 1_000_000_000


def to_ns(time_s: float) -> int:
    """Return seconds as whole nanoseconds."""
    return round(time_s * 1e9)


@overload
def to_s(time_ns: float) -> float: ...
@overload
def to_s(time_ns: NDArray[np.int64]) -> NDArray[np.floating[Any]]: ...
def to_s(time_ns: float | NDArray[np.int64]) -> float | NDArray[np.floating[Any]]:
    """Return nanoseconds as seconds."""
    return time_ns * 1e-9
