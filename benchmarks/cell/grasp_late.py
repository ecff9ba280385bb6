# SPDX-License-Identifier: Apache-2.0
"""What becomes of grasps when the computer has other things to do: the driver's loop is late, and so are its goals.

A servo whose next goal comes late falls back and catches up; the current for that passes for tension, of all fingers at
once, and is easily taken for a touch before there is one. All products are grasped with the sets that hold them (Table
4.2: success), on emulated cells in virtual time: punctually, as late as in a shift on two slow processors, and worse.
`mistaken touch`: the fingers were told to press, or a verdict other than EMPTY fell, before the plant shows any contact
force. The peer is the same hand with a punctual driver.
"""

from __future__ import annotations

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

from softgrip_cell.catalogue_file import read_catalogue
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.grasp.values import GraspOutcome, GraspPhase, GraspTask
from softgrip_cell.products import TableMark
from softgrip_testing.benchmark_claim import claim
from softgrip_testing.virtual_cell import CHECK, LOADED, OVERLOADED, PUNCTUAL, Lateness, VirtualCell, task

SETS = ("power", "pinch")
SEEDS = (1, 2, 3)
LATENESS = {"punctual": PUNCTUAL, "loaded": LOADED, "overloaded": OVERLOADED}

#: A shift's lift window [s], and how far its checks close [m].
SETTINGS = replace(GraspSettings(), lift_window_s=1.0)
SHIFT_CHECK = replace(CHECK, length_m=0.015)


@dataclass(frozen=True)
class Grasped:
    """One grasp: what was said, and whether something was taken for a touch before there was one."""

    outcome: GraspOutcome
    mistaken: bool


def grasp(cell: VirtualCell, made: GraspTask) -> Grasped:
    """Grasp what is there, and lift it."""
    touched = mistaken = lifted = False
    outcome = None
    for step, _ in cell.grasp(made, SETTINGS):
        touched = touched or max(cell.plant.grasp.state().contact_forces_n, default=0.0) > 0.0
        if step.phase is GraspPhase.LIFT and not lifted:
            lifted = True
            cell.plant.lift()
        outcome = step.verdict.outcome if step.verdict is not None else None
        decided = step.phase is GraspPhase.HOLD or outcome not in {None, GraspOutcome.EMPTY}
        mistaken = mistaken or (decided and not touched)
    assert outcome is not None
    return Grasped(outcome, mistaken)


def grasps(seed: int, finger_set: str, lateness: Lateness) -> dict[str, Grasped]:
    """Grasp every product that a set holds, with one cell; return by product what became of it."""
    cell = VirtualCell(seed, finger_set, lateness=lateness)
    cell.plant.grasp.lifts_itself = False
    cell.home()
    checks = cell.check(SHIFT_CHECK)
    if any(check.reference is None for check in checks.values()):
        print(f"cell {seed} {finger_set}: check refused, no grasps", file=sys.stderr)
        return {}
    found = {}
    for name, product in read_catalogue().products.items():
        if product.marks[finger_set] is TableMark.SUCCESS:
            cell.plant.place("")
            if cell.fault() is not None:
                cell.recover()
            cell.open()
            cell.plant.place(name)
            found[name] = grasp(cell, task(product, finger_set, checks))
    return found


def main() -> None:
    """Run all and print the claims."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=list(SEEDS), help="emulated cells")
    options = parser.parse_args()
    jobs = [(name, seed, finger_set) for name in LATENESS for finger_set in SETS for seed in options.seeds]
    with ProcessPoolExecutor(2) as pool:
        results = list(pool.map(grasps, *zip(*((seed, s, LATENESS[name]) for name, seed, s in jobs), strict=True)))
    mistaken, gripped, notes = {}, {}, {}
    for late in LATENESS:
        found = {
            f"{seed}/{finger_set}/{product}": grasped
            for (name, seed, finger_set), products in zip(jobs, results, strict=True)
            for product, grasped in products.items()
            if name == late
        }
        failed = [
            f"{which}: {grasped.outcome}" for which, grasped in found.items() if grasped.outcome != GraspOutcome.GRIPPED
        ]
        mistaken[late] = 100.0 * sum(grasped.mistaken for grasped in found.values()) / len(found)
        gripped[late] = 100.0 * (1.0 - len(failed) / len(found))
        notes[late] = f"{len(found)} grasps; not gripped: {', '.join(failed) or '-'}"
    runs = len(options.seeds)
    for name in ("loaded", "overloaded"):
        claim(
            f"mistaken touches, driver {name}", mistaken[name], "%", better="lower", goal=None, runs=runs,
            note=notes[name], peer="punctual driver", peer_value=mistaken["punctual"],
        )  # fmt: skip
        claim(
            f"gripped, driver {name}", gripped[name], "%", better="higher", goal=None, runs=runs,
            note=f"{notes[name]}; punctual: {notes['punctual']}", peer="punctual driver",
            peer_value=gripped["punctual"],
        )  # fmt: skip


if __name__ == "__main__":
    main()
