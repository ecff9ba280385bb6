# SPDX-License-Identifier: Apache-2.0
"""How soon and how rightly cell/grasp says what became of a closing, beside an ordinary stall time-out.

Some 200 randomised grasps on the emulated cell in virtual time (six cells, three finger sets, a product or none):
the plant says when fingers touched, when the product was lost, when everything stood; the grasp sequence sees only what
tendon/state and finger/predicted carry at the driver's 100 Hz. Middleware is not in these figures; runtime_latency
measures it.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from random import Random

import numpy as np
from _claim import claim
from _virtual_cell import SLOTS, VirtualCell, task

from softgrip_cell.catalogue_file import read_catalogue
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.grasp.values import GraspTask, Outcome

GRASPS_PER_CELL = 34
CELLS = ((1, "power"), (2, "power"), (3, "pinch"), (4, "pinch"), (5, "pinch"), (6, "hook"))

#: What parallel_gripper_controller ships with: slower than this for so long counts as stalled.
STALL_SPEED_M_PER_S = 0.001
STALL_TIME_S = 1.0

#: After a verdict the plant goes on for so long before it is asked what is so [s].
AFTERWARDS_S = 1.4

PEER_EVERY = 4
LIFT_S = 1.5
TOUCH_N = 0.05


@dataclass(frozen=True)
class Trial:
    """One grasp.

    Attributes:
        outcome: what was said. latency_s: from the plant's event to that; NaN where there is no such event.
        held: the product hung from the fingers afterwards.
        peer_outcome, peer_latency_s, peer_held: the same with a stall time-out, where it was run.
    """

    said: str
    outcome: Outcome
    latency_s: float
    held: bool
    peer_outcome: Outcome | None = None
    peer_latency_s: float = float("nan")
    peer_held: bool = False


def trials(cell_seed: int, finger_set: str) -> list[Trial]:
    """Grasp with one cell and one set."""
    rng = Random(1000 * cell_seed)
    products = read_catalogue().products
    cell = VirtualCell(cell_seed, finger_set)
    cell.home()
    checks = cell.check()
    if any(check.reference is None for check in checks.values()):
        print(f"cell {cell_seed} {finger_set}: check refused, no grasps", file=sys.stderr)
        return []
    settings = GraspSettings(lift_window_s=LIFT_S)
    found = []
    for number in range(GRASPS_PER_CELL):
        name = rng.choice(list(products))
        present = rng.random() > 0.25
        confirm_lift = bool(number % 2)
        offset_m = rng.uniform(-0.004, 0.004)
        _present(cell, name if present else "", offset_m)
        made = task(products[name], finger_set, checks, confirm_lift=confirm_lift)
        outcome, latency_s, reason = _ours(cell, made, settings)
        said = f"{finger_set} {name if present else 'nothing'} lift={confirm_lift}: {outcome.value}: {reason}"
        trial = Trial(said, outcome, latency_s, _held(cell))
        if number % PEER_EVERY == 0:
            _present(cell, name if present else "", offset_m)
            peer_outcome, peer_latency_s = _stall(cell, made.recipe.closing_speed_m_per_s)
            trial = replace(trial, peer_outcome=peer_outcome, peer_latency_s=peer_latency_s, peer_held=_held(cell))
        found.append(trial)
    return found


def _present(cell: VirtualCell, name: str, offset_m: float) -> None:
    cell.plant.place("")
    if cell.fault() is not None:
        cell.recover()
    cell.open()
    cell.plant.place(name, offset_m if name else 0.0)


def _held(cell: VirtualCell) -> bool:
    """Let the plant go on, lift what is gripped, and say whether it hung still in the second half of that time."""
    cycles = round(AFTERWARDS_S / cell.period_s)
    hung = False
    for number in range(cycles):
        cell.observe()
        hung = hung or (number > cycles // 2 and cell.plant.grasp.state().held)
    return hung and not cell.plant.grasp.state().slipped


def _events(cell: VirtualCell) -> Iterator[tuple[str, float]]:
    """What the plant does, with its time: "enclosed", "lost", "moved"."""
    both = False
    while True:
        forces = cell.plant.grasp.state().contact_forces_n or (0.0,) * len(SLOTS)
        touching = [force > TOUCH_N for force in forces]
        if sum(touching) > 1 and not both:
            both = True
            yield "enclosed", cell.plant.now_s
        elif both and not any(touching):
            both = False
            yield "lost", cell.plant.now_s
        elif any(abs(motor.shaft.velocity_rad_s) * 0.01 > STALL_SPEED_M_PER_S for motor in cell.plant.motors):
            yield "moved", cell.plant.now_s
        else:
            yield "", cell.plant.now_s


def _ours(cell: VirtualCell, made: GraspTask, settings: GraspSettings) -> tuple[Outcome, float, str]:
    last: dict[str, float] = {}
    verdict = None
    watch = _events(cell)
    lifted_s = float("nan")
    for step, _ in cell.grasp(made, settings):
        event, at_s = next(watch)
        last[event] = at_s
        if step.phase.value == "lift" and np.isnan(lifted_s):
            lifted_s = at_s
        verdict = step.verdict
    assert verdict is not None
    event_s = {
        Outcome.GRIPPED: last.get("enclosed") if np.isnan(lifted_s) else lifted_s + LIFT_S,
        Outcome.EMPTY: last.get("moved"),
        Outcome.SLIPPED: last.get("lost"),
    }.get(verdict.outcome)
    latency_s = float("nan") if event_s is None else max(0.0, cell.plant.now_s - event_s)
    return verdict.outcome, latency_s, verdict.reason


def _stall(cell: VirtualCell, speed: float) -> tuple[Outcome, float]:
    """Close with a tension limit; when all fingers have stood for the stall time, look whether they came to the end."""
    target_m = 0.017
    cell.move(target_m, speed, 18.0)
    still_since = enclosed_s = None
    watch = _events(cell)
    moved_s = cell.plant.now_s
    while True:
        pair = cell.observe()
        event, at_s = next(watch)
        enclosed_s = at_s if event == "enclosed" else enclosed_s
        moved_s = at_s if event == "moved" else moved_s
        slow = all(abs(sample.velocity) < STALL_SPEED_M_PER_S for sample in cell.samples())
        still_since = (still_since or at_s) if slow else None
        if still_since is not None and at_s - still_since >= STALL_TIME_S:
            short = [target_m - pulled_m > 0.01 * target_m for pulled_m in pair.sample.pulled_m]
            outcome = Outcome.GRIPPED if any(short) else Outcome.EMPTY
            since_s = enclosed_s if outcome is Outcome.GRIPPED and enclosed_s is not None else moved_s
            return outcome, at_s - since_s


def _rate(wrong: int, said: int) -> float:
    return 100.0 * wrong / said if said else 0.0


def main() -> None:
    """Run all trials on two processes and print the claims."""
    with ProcessPoolExecutor(2) as pool:
        found = [trial for many in pool.map(trials, *zip(*CELLS, strict=True)) for trial in many]
    latency = np.array([trial.latency_s for trial in found])
    latency = 1e3 * latency[np.isfinite(latency)]
    peer = 1e3 * np.array([trial.peer_latency_s for trial in found if trial.peer_outcome is not None])
    for trial in found:
        wrong = trial.held != (trial.outcome is Outcome.GRIPPED) and trial.outcome in (Outcome.GRIPPED, Outcome.EMPTY)
        if wrong or trial.latency_s > 0.1:
            print(f"held={trial.held} {1e3 * trial.latency_s:.0f} ms {trial.said}", file=sys.stderr)
    counts = {o.value: sum(t.outcome is o for t in found) for o in Outcome}
    note = f"{len(found)} grasps, outcomes {counts}; latency {latency.min():.0f} .. {latency.max():.0f} ms"
    rival = "stall time-out (1 mm/s for 1 s)"
    for name, share in (("result latency p50", 50), ("result latency p99", 99)):
        value, other = float(np.percentile(latency, share)), float(np.percentile(peer, share))
        goal = 100.0 if share == 99 else None
        claim(name, value, "ms", better="lower", goal=goal, runs=len(latency), note=note, peer=rival, peer_value=other)
    for name, said, truth in (("false gripped", Outcome.GRIPPED, True), ("false empty", Outcome.EMPTY, False)):
        ours = [trial for trial in found if trial.outcome is said]
        theirs = [trial for trial in found if trial.peer_outcome is said]
        wrong = sum(trial.held is not truth for trial in ours)
        peer_wrong = sum(trial.peer_held is not truth for trial in theirs)
        note = f"{wrong} of {len(ours)} said {said.value}; the stall time-out {peer_wrong} of {len(theirs)}"
        value, other = _rate(wrong, len(ours)), _rate(peer_wrong, len(theirs))
        claim(name, value, "%", better="lower", goal=1.0, runs=len(ours), note=note, peer=rival, peer_value=other)


if __name__ == "__main__":
    main()
