# SPDX-License-Identifier: Apache-2.0
"""Numpy, imported when the first fixed-size array is made: it costs more start-up time than all the rest together."""

from __future__ import annotations

import functools
import sys
from typing import TYPE_CHECKING, Any, TypeGuard

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt


def is_ndarray(value: object, code: str | None = None) -> TypeGuard[npt.NDArray[Any]]:
    """Whether a value is a numpy array (of this type code, where one is given)."""
    numpy = sys.modules.get("numpy")
    if numpy is None or not isinstance(value, numpy.ndarray):
        return False
    return code is None or value.dtype == numpy.dtype(code)


@functools.cache
def dtype(code: str) -> np.dtype[Any]:
    """Return numpy's type of a type code."""
    import numpy as np  # noqa: PLC0415  see the module

    return np.dtype(code)


def make_array(values: Any, code: str) -> npt.NDArray[Any]:
    """Return a fresh array of a type."""
    import numpy as np  # noqa: PLC0415  see the module

    return np.array(values, dtype=code)


def read_array(data: Any, code: str, count: int, offset: int) -> npt.NDArray[Any]:
    """Return a fresh array of ``count`` elements from bytes."""
    import numpy as np  # noqa: PLC0415  see the module

    return np.frombuffer(data, code, count, offset).copy()


def utf16_to_wide(data: bytes) -> bytes:
    """Return UTF-16 units, two bytes each, as four bytes each."""
    import numpy as np  # noqa: PLC0415  see the module

    return np.frombuffer(data, "<u2").astype("<u4").tobytes()


def wide_to_utf16(data: Any, count: int, offset: int) -> bytes:
    """Return ``count`` four-byte units as two bytes each."""
    import numpy as np  # noqa: PLC0415  see the module

    return np.frombuffer(data, "<u4", count, offset).astype("<u2").tobytes()
