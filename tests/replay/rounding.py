# SPDX-License-Identifier: Apache-2.0
"""On which kind of processor each recorded bag was answered, and how far answers may be off it here."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from softgrip_bag.context import arithmetic, rounding_tolerance

#: A part and its arithmetic a line.
FILE = Path(__file__).resolve().parent / "bags" / "arithmetic.txt"


def answered_with() -> dict[str, str]:
    """Return part -> arithmetic."""
    return dict(line.split(maxsplit=1) for line in FILE.read_text().splitlines())


def note(parts: Iterable[str]) -> None:
    """Note that these parts were answered here."""
    found = answered_with() | dict.fromkeys(parts, arithmetic())
    FILE.write_text("".join(f"{part} {with_}\n" for part, with_ in sorted(found.items())))


def tolerance(part: str) -> float:
    """Return how far a part's results may be off: 0 on the kind of processor that gave them."""
    return rounding_tolerance(answered_with()[part])
