# SPDX-License-Identifier: Apache-2.0
"""Values of a case file, checked one by one: every refusal names the key, what was expected and what was found."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np

from softgrip_model.gdfe.errors import GdfeError

Choice = TypeVar("Choice")


def keys(where: str, data: Mapping[str, Any], needed: set[str], possible: set[str]) -> None:
    """Refuse missing and unknown keys."""
    missing, unknown = sorted(needed - set(data)), sorted(set(data) - needed - possible)
    if missing or unknown:
        raise GdfeError(f"{where}: missing keys {missing}, unknown keys {unknown}; it has {sorted(needed | possible)}")


def mapping(where: str, value: Any) -> dict[str, Any]:
    """Return a mapping."""
    if not isinstance(value, dict):
        raise GdfeError(f"{where}: expected a mapping, found {value!r}")
    return value


def entries(where: str, value: Any) -> list[dict[str, Any]]:
    """Return a list of mappings."""
    if not isinstance(value, list):
        raise GdfeError(f"{where}: expected a list, found {value!r}")
    return [mapping(f"{where}[{number}]", entry) for number, entry in enumerate(value)]


def number(where: str, value: Any, least: float | None = None) -> float:
    """Return a finite number, `least` or more."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        hint = " (YAML reads exponents only as in 1.0e-6)" if isinstance(value, str) else ""
        raise GdfeError(f"{where}: expected a number, found {value!r}{hint}")
    if least is not None and value < least:
        raise GdfeError(f"{where}: expected {least:g} or more, found {value!r}")
    return float(value)


def vector(where: str, value: Any) -> tuple[float, float, float]:
    """Return three numbers."""
    if not isinstance(value, list) or len(value) != 3:
        raise GdfeError(f"{where}: expected three numbers [x, y, z], found {value!r}")
    x, y, z = (number(where, v) for v in value)
    return x, y, z


def along_axes(where: str, value: Any) -> tuple[float, float, float]:
    """Return the vector of a mapping axis -> number; axes that are not named are 0."""
    found = [0.0, 0.0, 0.0]
    for name, size in mapping(where, value).items():
        for axis in axes(where, name):
            found["xyz".index(axis)] = number(f"{where}.{name}", size)
    return found[0], found[1], found[2]


def axes(where: str, value: Any) -> str:
    """Return letters out of x, y, z."""
    if not isinstance(value, str) or not value or set(value) - set("xyz"):
        raise GdfeError(f"{where}: expected axes out of x, y, z, found {value!r}")
    return value


def one_of(where: str, value: Any, known: Mapping[str, Choice]) -> Choice:
    """Return what a name stands for."""
    if value not in known:
        raise GdfeError(f"{where}: expected one of {', '.join(known)}, found {value!r}")
    return known[value]


def choice(where: str, kind: Any, value: Any) -> Any:
    """Return a member of an enumeration."""
    try:
        return kind(value)
    except ValueError as error:
        raise GdfeError(f"{where}: expected one of {[str(k) for k in kind]}, found {value!r}") from error
