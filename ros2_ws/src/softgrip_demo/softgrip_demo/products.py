# SPDX-License-Identifier: Apache-2.0
"""What the operator of the demo knows: products, Table 4.2, and which printed finger goes into which slot."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

from softgrip_cell.catalogue_file import read_catalogue
from softgrip_cell.finger_records import read_finger_records
from softgrip_demo.errors import ShiftError
from softgrip_model import profile
from softgrip_model.profile import FingerDesign

_catalogue = cache(read_catalogue)


def product_names() -> list[str]:
    """Return the products of Tables 4.1 and 4.2."""
    return list(_catalogue().products)


def expected_outcome(product: str, finger_set: str) -> str:
    """Return what Table 4.2 says: "success", "partial" or "failure"."""
    return str(_catalogue().products[product].marks[finger_set])


def serials_of(finger_set: str, slots: Sequence[str], copy: int = 0) -> list[str]:
    """Return a printed finger of a set for every slot; ``copy`` chooses among several of a kind.

    Raises:
        ShiftError: no such finger was printed.
    """
    finger_records = read_finger_records()
    serials = []
    for slot in slots:
        fitting = sorted(s for s, p in finger_records.items() if p.profile == finger_set and p.finger == slot)
        if copy >= len(fitting):
            raise ShiftError(
                f"expected {copy + 1} printed {finger_set} fingers for slot {slot}, found {len(fitting)} finger records"
            )
        serials.append(fitting[copy])
    return serials


def finger_design(folder: Path, finger_set: str, finger: str) -> FingerDesign:
    """Return the design of one finger from a folder of profiles."""
    return profile.load(folder / f"{finger_set}.yaml").finger(finger)
