# SPDX-License-Identifier: Apache-2.0
"""Values of a case file, checked one by one: every refusal names the key, what was expected and what was found."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import TypeVar

from softgrip_model.gdfe.errors import GdfeError

Choice = TypeVar("Choice")
Kind = TypeVar("Kind", bound=Enum)

#: Beyond it no number of a case means anything, and products of a few of them are not finite.
LARGEST = 1e30


def keys(where: str, data: Mapping[str, object], needed: set[str], possible: set[str]) -> None:
    """Refuse missing and unknown keys."""
    missing, unknown = sorted(needed - set(data)), sorted(str(key) for key in set(data) - needed - possible)
    if missing or unknown:
        raise GdfeError(f"{where}: missing keys {missing}, unknown keys {unknown}; it has {sorted(needed | possible)}")


def mapping(where: str, value: object) -> dict[str, object]:
    """Return a mapping."""
    if not isinstance(value, dict):
        raise GdfeError(f"{where}: expected a mapping, found {value!r}")
    return value


def entries(where: str, value: object) -> list[dict[str, object]]:
    """Return a list of mappings."""
    if not isinstance(value, list):
        raise GdfeError(f"{where}: expected a list, found {value!r}")
    return [mapping(f"{where}[{number}]", entry) for number, entry in enumerate(value)]


def number(where: str, value: object, minimum: float | None = None) -> float:
    """Return a number, `least` or more."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= LARGEST:
        hint = " (YAML reads exponents only as in 1.0e-6)" if isinstance(value, str) else ""
        raise GdfeError(f"{where}: expected a number, found {value!r}{hint}")
    if minimum is not None and value < minimum:
        raise GdfeError(f"{where}: expected {minimum:g} or more, found {value!r}")
    return float(value)


def numbers(where: str, value: object, minimum: float | None = None, count: int | None = None) -> tuple[float, ...]:
    """Return a list of numbers, `least` or more each; not empty, or exactly `count`."""
    if not isinstance(value, list) or not value or (count is not None and len(value) != count):
        raise GdfeError(f"{where}: expected a list of {count or 'one or more'} numbers, found {value!r}")
    return tuple(number(f"{where}[{k}]", one, minimum) for k, one in enumerate(value))


def vector(where: str, value: object) -> tuple[float, float, float]:
    """Return three numbers."""
    if not isinstance(value, list) or len(value) != 3:
        raise GdfeError(f"{where}: expected three numbers [x, y, z], found {value!r}")
    x, y, z = (number(where, v) for v in value)
    return x, y, z


def along_axes(where: str, value: object) -> tuple[float, float, float]:
    """Return the vector of a mapping axis -> number; axes that are not named are 0."""
    found = [0.0, 0.0, 0.0]
    for name, size in mapping(where, value).items():
        for axis in axes(where, name):
            found["xyz".index(axis)] = number(f"{where}.{name}", size)
    return found[0], found[1], found[2]


def axes(where: str, value: object) -> str:
    """Return letters out of x, y, z."""
    if not isinstance(value, str) or not value or set(value) - set("xyz"):
        raise GdfeError(f"{where}: expected axes out of x, y, z, found {value!r}")
    return value


def one_of(where: str, value: object, known: Mapping[str, Choice]) -> Choice:
    """Return what a name stands for."""
    if not isinstance(value, str) or value not in known:
        raise GdfeError(f"{where}: expected one of {', '.join(known)}, found {value!r}")
    return known[value]


def axis(where: str, value: object) -> int:
    """Return the number of one axis."""
    letters = axes(where, value)
    if len(letters) != 1:
        raise GdfeError(f"{where}: expected one of x, y, z, found {value!r}")
    return "xyz".index(letters)


def choice(where: str, kind: type[Kind], value: object) -> Kind:
    """Return a member of an enumeration."""
    try:
        return kind(value)
    except ValueError as error:
        raise GdfeError(f"{where}: expected one of {[str(k) for k in kind]}, found {value!r}") from error
