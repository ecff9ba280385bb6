# SPDX-License-Identifier: Apache-2.0
"""Numbers as MJCF writes them."""

from __future__ import annotations

from collections.abc import Iterable


def text(values: Iterable[float]) -> str:
    """Return numbers with spaces between them."""
    return " ".join(number(value) for value in values)


def number(value: float) -> str:
    """Return a number with 12 digits; never -0."""
    return f"{float(value) + 0.0:.12g}"
