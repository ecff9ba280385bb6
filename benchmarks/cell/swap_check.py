# SPDX-License-Identifier: Apache-2.0
"""Does the check after a swap accept good finger sets and refuse wrong, worn, unknown and broken ones?

200 randomised trials on the emulated cell in virtual time. The index finger's tip is seen as by the camera (0.5 mm of
noise at 30 Hz), tensions as the driver estimates them, predictions as the predictor makes them after a nine-point
calibration. Wrong = a set other than the finger records say; worn = friction or stiffness of a finger changed since its
last check; broken = one cable torn; unknown = serials without a usable finger record. The peer looks at serials alone.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from random import Random

from softgrip_cell.catalogue_file import read_catalogue
from softgrip_cell.errors import RefusedError
from softgrip_cell.finger_records import FingerState, read_finger_records
from softgrip_cell.grasp.reference import FreeReference
from softgrip_cell.storage import MountedSlot
from softgrip_cell.swap.check import EmptyClosing, Finding
from softgrip_cell.swap.sequence import SwapSequence, SwapStep
from softgrip_testing.benchmark_claim import claim, no_options
from softgrip_testing.virtual_cell import CHECK, SEEN_EVERY, SLOTS, VirtualCell

CELLS = range(1, 21)
SETS = ("power", "pinch", "hook")


@dataclass(frozen=True)
class Trial:
    """One trial: what was mounted, and whether it was accepted by the whole check and by the serials alone."""

    kind: str
    detail: str
    accepted: bool
    accepted_by_serial: bool


def trials(seed: int) -> list[Trial]:
    """Ten trials with one emulated cell."""
    rng = Random(seed)
    found = [_unknown(rng), _unknown(rng)]
    for number in range(5):
        finger_set = SETS[(seed + number) % 3]
        cell = VirtualCell(seed, finger_set, copy=number)
        cell.home()
        good, reasons, references = _check(cell, rng)
        found.append(Trial("good", f"{finger_set}: {reasons}", good, accepted_by_serial=True))
        if number == 0:
            wrong = SETS[(seed + number + 1 + seed % 2) % 3]
            cell.mount(wrong, copy=number, said=finger_set)
            cell.home()
            accepted, reasons, _ = _check(cell, rng)
            found.append(Trial("wrong", f"{wrong} as {finger_set}: {reasons}", accepted, accepted_by_serial=True))
        elif number == 1 and good:
            how = _wear(cell, rng)
            accepted, reasons, _ = _check(cell, rng, references)
            found.append(Trial("worn", f"{finger_set} {how}: {reasons}", accepted, accepted_by_serial=True))
        elif number == 2:
            slot = rng.choice(SLOTS)
            cell.plant.disturbances.broken_tendons.add(slot)
            accepted, reasons, _ = _check(cell, rng)
            found.append(Trial("broken", f"{slot}: {reasons}", accepted, accepted_by_serial=True))
    return found


def _check(
    cell: VirtualCell, rng: Random, earlier: Mapping[str, FreeReference] | None = None
) -> tuple[bool, str, dict[str, FreeReference]]:
    """Close on nothing; a fault of the driver refuses as well."""
    closing = EmptyClosing(SLOTS, CHECK, earlier)
    try:
        cell.open()
        ticket = cell.move(CHECK.length_m, CHECK.speed_m_per_s, CHECK.tension_limit_n)
    except RuntimeError as error:
        return False, str(error), {}
    count = 0
    while cell.controller.result(ticket)[0] is None:
        closing.observe(cell.observe())
        count += 1
        if count % SEEN_EVERY == 0:
            closing.observe_tip(cell.see_tip(rng))
    fault = cell.fault()
    if fault is not None:
        return False, f"{fault.tendon}: {fault.name}", {}
    closing.end(cell.pulled_length_m())
    results = closing.judge()
    bad = [f"{name} {check.reason}" for name, check in results.items() if check.finding is not Finding.GOOD]
    references = {name: check.reference for name, check in results.items() if check.reference is not None}
    return not bad, "; ".join(bad) or "good", references


def _wear(cell: VirtualCell, rng: Random) -> str:
    """A worn cable guide (friction up by half or more) or a cracked joint (stiffness down by a third or more)."""
    if rng.random() < 0.5:
        cell.plant.bank.friction_scale = scale = rng.uniform(1.5, 2.0)
        return f"friction x {scale:.2f}"
    share = rng.uniform(0.5, 0.67)
    _soften(cell, share)
    return f"stiffness x {share:.2f}"


def _soften(cell: VirtualCell, share: float) -> None:
    worn = [replace(f, stiffness=f.stiffness * share) for f in cell.plant.mounted if f is not None]
    cell.plant.mounted[:] = worn
    cell.plant._rebuild(keep=())  # noqa: SLF001  a benchmark may reach into the plant: nobody else wears fingers
    cell.home()


def _unknown(rng: Random) -> Trial:
    """Serials that nobody knows, or whose finger record says that they must not be used."""
    finger_set = rng.choice(SETS)
    finger_records = read_finger_records()
    serials = [s for s, p in finger_records.items() if p.profile == finger_set and s.endswith("01")]
    slot = rng.randrange(3)
    state = rng.choice([None, FingerState.WORN, FingerState.RETIRED, FingerState.UNKNOWN])
    given: Sequence[str] = serials
    if state is None:
        given = [*serials[:slot], "ZZ-9", *serials[slot + 1 :]]
    else:
        finger_records[serials[slot]] = replace(finger_records[serials[slot]], state=state)
    sequence = SwapSequence(
        read_catalogue().finger_sets[finger_set], [MountedSlot(name) for name in SLOTS], finger_records
    )
    sequence.released()
    sequence.locked()
    sequence.confirm("open_palm")
    sequence.confirm("remove")
    try:
        sequence.confirm("insert", given)
    except RefusedError as error:
        return Trial("unknown", str(error), accepted=False, accepted_by_serial=False)
    return Trial("unknown", "", sequence.step is SwapStep.CLOSE_PALM, accepted_by_serial=True)


def main() -> None:
    """Run all trials on two processes and print the claims."""
    no_options(__doc__)
    with ProcessPoolExecutor(2) as pool:
        found = [trial for many in pool.map(trials, CELLS) for trial in many]
    for trial in found:
        if trial.accepted != (trial.kind == "good"):
            print(f"{trial.kind}: {'accepted' if trial.accepted else 'refused'}: {trial.detail}", file=sys.stderr)
    good = [trial for trial in found if trial.kind == "good"]
    bad = [trial for trial in found if trial.kind != "good"]
    kinds = {kind: sum(trial.kind == kind for trial in bad) for kind in ("wrong", "worn", "broken", "unknown")}
    refused = 100.0 * sum(not trial.accepted for trial in bad) / len(bad)
    peer = 100.0 * sum(not trial.accepted_by_serial for trial in bad) / len(bad)
    note = f"{len(bad)} bad sets: {kinds}"
    claim(
        "swap check refuses", refused, "%", better="higher", goal=100.0, runs=len(bad), note=note,
        peer="serials alone", peer_value=peer,
    )  # fmt: skip
    accepted = 100.0 * sum(trial.accepted for trial in good) / len(good)
    note = f"{len(good)} good sets of {len(CELLS)} emulated cells"
    claim("swap check accepts", accepted, "%", better="higher", goal=98.0, runs=len(good), note=note)


if __name__ == "__main__":
    main()
