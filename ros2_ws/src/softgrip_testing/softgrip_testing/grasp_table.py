# SPDX-License-Identifier: Apache-2.0
"""Print what becomes of every product in every finger set, beside thesis Table 4.2, at several closing tensions."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

from rich.console import Console
from rich.progress import track
from rich.table import Table

from softgrip_emulator.plant.manual_grasp import HandPulledCell
from softgrip_emulator.plant.products import products
from softgrip_model.profile import ProfileError, load_directory

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from softgrip_emulator.plant.grasp import GraspState
    from softgrip_model.profile import Profile

FINGER_SETS: Final = ("power", "pinch", "hook")
TABLE_42: Final = {
    "egg": "++-", "orange": "++-", "muffin": "++-", "apple": "++-", "sausage": "+++", "banana": "++-", "baloney": "+--",
    "grape": "-+-", "cheese_slice": "o+o", "cheese_cake": "++-", "cracker_sheet": "++-", "frozen_pizza": "-o-",
    "bag_of_chips": "++-", "tomato_vine": "+++", "grape_vine": "+++",
}  # fmt: skip
"""Success +, partial o, failure -, for power, pinch and hook (C.-D. Matte, 2025, Table 4.2)."""


def outcome(state: GraspState) -> str:
    """One word for a grasp."""
    if state.crushed:
        return "crushed"
    if state.held:
        return "held"
    if state.slipped:
        return "slipped"
    return "touched" if state.touching else "empty"


def grasp(profiles: Mapping[str, Profile], finger_set: str, product: str, tension_n: float, seed: int) -> GraspState:
    """Close one finger set on one product."""
    cell = HandPulledCell(profiles, finger_set, seed=seed)
    cell.place(product)
    return cell.close(tension_n)


def main(args: Sequence[str] | None = None) -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("profiles", type=Path, help="folder of finger profiles, e.g. softgrip_bringup/profiles")
    parser.add_argument("--tensions", type=float, nargs="+", default=[8.0, 14.0, 20.0], metavar="N", help="[N]")
    parser.add_argument("--products", nargs="+", choices=sorted(products()), default=list(TABLE_42), metavar="NAME")
    parser.add_argument("--seed", type=int, default=1, help="of fingers and products")
    options = parser.parse_args(args)
    console = Console()
    try:
        profiles = load_directory(options.profiles)
    except ProfileError as error:
        console.print(f"[red]{error}")
        return 2
    table = Table("product", *(f"{name} ({n:g} N)" for name in FINGER_SETS for n in options.tensions), "Table 4.2")
    for product in track(options.products, "grasping", console=Console(stderr=True), transient=True):
        row = [
            outcome(grasp(profiles, name, product, n, options.seed)) for name in FINGER_SETS for n in options.tensions
        ]
        table.add_row(product, *row, " ".join(TABLE_42.get(product, ())))
    console.print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
