# SPDX-License-Identifier: Apache-2.0
"""How soon and how rightly cell/grasp says what became of a closing, beside an ordinary stall time-out.

Some 200 randomised grasps on the emulated cell in virtual time (six cells, three finger sets, a product or none). The
grasp sequence sees what tendon/state and finger/predicted carry at the driver's 100 Hz, and nothing else; the plant
says what is so. That gives the time from the event to the sample that decides. The time from that sample's stamp to
the outcome at its client is measured on a live cell, with all processes and the middleware; a result latency is the sum
of one of the first and one of the second, all pairs of them.

The deciding events, taken from the plant:
* GRIPPED without a lift: not the first contact, which decides nothing yet, but when thumb and fingers touch the
  product, the fingers have come to rest on it (3 mm/s), and their tendons pull steadily (10 N/s): pressing is over.
* SLIPPED: the last instant at which both sides touched it.
* EMPTY: the last finger has come to the end of its path, or stands (1 mm/s) without anything to stop it.
Counted from the first contact instead (the other reading of "latency from contact"), GRIPPED has to wait for the
fingers to close and press, whoever decides; that is `gripped after first contact`.
GRIPPED after a lift is decided by the clock (the lift window) and is not among the latencies. As in the cell, a
finger set that is not known to hold a product, or whose friction does not carry it, only tries it with a lift. `held`
is what the plant shows: the product has hung from the fingers for the thesis' 5 s (4.3.3) since the arm began to lift,
and then hangs still.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from random import Random

import numpy as np
from _live_cell import outcomes_at_client_s

from softgrip_cell.catalogue_file import read_catalogue
from softgrip_cell.gates import carried_kg
from softgrip_cell.grasp.settings import GraspSettings
from softgrip_cell.grasp.values import GraspOutcome, GraspTask
from softgrip_cell.products import TableMark
from softgrip_testing.benchmark_claim import claim
from softgrip_testing.virtual_cell import HANGS_S, SLOTS, VirtualCell, task

GRASPS_PER_CELL = 34
CELLS = ((1, "power"), (3, "pinch"), (2, "power"), (4, "pinch"), (6, "hook"), (5, "pinch"))

#: What parallel_gripper_controller ships with: slower than this for so long counts as stalled.
STALL_SPEED_M_PER_S = 0.001
STALL_TIME_S = 1.0

#: Slower than this a finger rests on what it grips [m/s].
REST_SPEED_M_PER_S = 0.003

#: A tendon whose pull changes slower than this pulls steadily [N/s].
STEADY_N_PER_S = 10.0

#: Nearer than this a finger is at the end of its path: here its own grooves close and stop it [m].
AT_END_M = 0.0008

PEER_EVERY = 6

#: Grasps of the live cell, and its ROS domain.
LIVE_GRASPS = 30
DOMAIN = "79"
TOUCH_N = 0.05


@dataclass(frozen=True)
class Trial:
    """One grasp.

    Attributes:
        outcome: what was said. latency_s: from the plant's event to that; NaN where there is no such event.
        contact_s: from the contact of both sides that went on to GRIPPED without a lift; else NaN.
        held: the product hung from the fingers afterwards.
        peer_outcome, peer_latency_s, peer_held: the same with a stall time-out, where it was run.
    """

    said: str
    outcome: GraspOutcome
    latency_s: float
    held: bool
    contact_s: float = float("nan")
    peer_outcome: GraspOutcome | None = None
    peer_latency_s: float = float("nan")
    peer_held: bool = False


class Watch:
    """The plant's side of a grasp: when did what happen?"""

    def __init__(self, cell: VirtualCell, paths_m: Sequence[float]) -> None:
        self._cell = cell
        self._paths_m = tuple(paths_m)
        self.touched_s = float("nan")
        self.last_touched_s = float("nan")
        self.moved_s = self.unsteady_s = cell.plant.now_s
        self.ended_s = float("nan")
        self._pulls_n = cell.plant.bank.tension_n.copy()
        self._opposed = cell.plant.mounted[0] is None or cell.plant.mounted[0].profile != "hook"

    @property
    def touching(self) -> bool:
        """Thumb and a finger touch the product; with a hook any two."""
        forces = self._cell.plant.grasp.state().contact_forces_n or (0.0,) * len(SLOTS)
        touch = [force > TOUCH_N for force in forces]
        return sum(touch) > 1 and (touch[SLOTS.index("thumb")] or not self._opposed)

    def look(self) -> None:
        """Look once a driver period."""
        now_s = self._cell.plant.now_s
        if self.touching:
            if not self.last_touched_s >= now_s - 2.0 * self._cell.period_s:
                self.touched_s = now_s
            self.last_touched_s = now_s
        speeds = [abs(motor.shaft.velocity_rad_s) * motor.spool_radius_m for motor in self._cell.plant.motors]
        self.moved_s = now_s if max(speeds) > STALL_SPEED_M_PER_S else self.moved_s
        pulls_n = self._cell.plant.bank.tension_n.copy()
        steady = float(np.abs(pulls_n - self._pulls_n).max()) < STEADY_N_PER_S * self._cell.period_s
        self._pulls_n = pulls_n
        self.unsteady_s = now_s if max(speeds) > REST_SPEED_M_PER_S or not steady else self.unsteady_s
        pulled = [sample.pulled_length_m for sample in self._cell.samples()]
        done = all(
            length_m > path_m - AT_END_M or (speed < STALL_SPEED_M_PER_S and length_m > 0.5 * path_m)
            for length_m, path_m, speed in zip(pulled, self._paths_m, speeds, strict=True)
        )
        self.ended_s = (self.ended_s if np.isfinite(self.ended_s) else now_s) if done else float("nan")

    def event_s(self, outcome: GraspOutcome, *, lifted: bool) -> float:
        """When that was so which this outcome says; NaN where the plant shows no such instant."""
        if outcome is GraspOutcome.GRIPPED and not lifted:
            return float(np.fmax(self.touched_s, self.unsteady_s))
        if outcome is GraspOutcome.SLIPPED and not self.touching:
            return self.last_touched_s
        # Said before the plant shows it: there is no event to measure from, and no 0 ms among the latencies.
        return self.ended_s if outcome is GraspOutcome.EMPTY else float("nan")


def trials(cell_seed: int, finger_set: str) -> list[Trial]:
    """Grasp with one cell and one set."""
    rng = Random(1000 * cell_seed)
    products = read_catalogue().products
    cell = VirtualCell(cell_seed, finger_set)
    cell.plant.grasp.lifts_itself = False
    cell.home()
    checks = cell.check()
    if any(check.reference is None for check in checks.values()):
        print(f"cell {cell_seed} {finger_set}: check refused, no grasps", file=sys.stderr)
        return []
    settings = GraspSettings()
    found = []
    for number in range(GRASPS_PER_CELL):
        name = rng.choice(list(products))
        present = rng.random() > 0.25
        product = products[name]
        known = (
            product.marks.get(finger_set) is TableMark.SUCCESS and carried_kg(product, finger_set) >= product.mass_kg
        )
        confirm_lift = bool(number % 2) or not known
        offset_m = rng.uniform(-0.004, 0.004)
        _present(cell, name if present else "", offset_m)
        made = task(product, finger_set, checks, confirm_lift=confirm_lift)
        outcome, latency_s, contact_s, hung_s, reason = _ours(cell, made, settings)
        said = f"{finger_set} {name if present else 'nothing'} lift={confirm_lift}: {outcome.value}: {reason}"
        held = cell.hangs(HANGS_S - hung_s)
        # What was not lost has no instant of its loss; it is counted as a false SLIPPED.
        latency_s = math.nan if held and outcome is GraspOutcome.SLIPPED else latency_s
        trial = Trial(said, outcome, latency_s, held, contact_s)
        if number % PEER_EVERY == 0:
            _present(cell, name if present else "", offset_m)
            peer_outcome, peer_latency_s = _stall(cell, made.recipe.closing_speed_m_per_s)
            trial = replace(
                trial, peer_outcome=peer_outcome, peer_latency_s=peer_latency_s, peer_held=cell.hangs(HANGS_S)
            )
        found.append(trial)
    return found


def _present(cell: VirtualCell, name: str, offset_m: float) -> None:
    cell.plant.place("")
    if cell.fault() is not None:
        cell.recover()
    cell.open()
    cell.plant.place(name, offset_m if name else 0.0)


def _ours(cell: VirtualCell, made: GraspTask, settings: GraspSettings) -> tuple[GraspOutcome, float, float, float, str]:
    """Grasp; return the outcome, its latency, that from contact, how long the arm has been up [s], and the reason."""
    watch = Watch(cell, [min(made.recipe.pull_limit_m, reference.reach_m) for reference in made.references])
    verdict = None
    lifted_s = None
    for step, _ in cell.grasp(made, settings):
        watch.look()
        if step.phase.value == "lift" and lifted_s is None:
            lifted_s = cell.plant.now_s
            cell.plant.lift()
        verdict = step.verdict
    assert verdict is not None
    now_s = cell.plant.now_s
    latency_s = now_s - watch.event_s(verdict.outcome, lifted=lifted_s is not None)
    at_once = verdict.outcome is GraspOutcome.GRIPPED and lifted_s is None
    contact_s = now_s - watch.touched_s if at_once else math.nan
    return verdict.outcome, latency_s, contact_s, 0.0 if lifted_s is None else now_s - lifted_s, verdict.reason


def _stall(cell: VirtualCell, speed: float) -> tuple[GraspOutcome, float]:
    """Close with a tension limit; when all fingers have stood for the stall time, look whether they came to the end."""
    target_m = 0.017
    cell.move(target_m, speed, 18.0)
    still_since = None
    watch = Watch(cell, [target_m] * len(SLOTS))
    while True:
        pair = cell.observe()
        watch.look()
        now_s = cell.plant.now_s
        slow = all(abs(sample.velocity) < STALL_SPEED_M_PER_S for sample in cell.samples())
        still_since = (still_since or now_s) if slow else None
        if still_since is not None and now_s - still_since >= STALL_TIME_S:
            short = [target_m - pulled_length_m > 0.01 * target_m for pulled_length_m in pair.sample.pulled_length_m]
            outcome = GraspOutcome.GRIPPED if any(short) else GraspOutcome.EMPTY
            return outcome, now_s - float(np.fmin(watch.event_s(outcome, lifted=False), now_s - STALL_TIME_S))


def _rate(wrong: int, said: int) -> float:
    return 100.0 * wrong / said if said else 0.0


def _published(decided_ms: np.ndarray, way_ms: np.ndarray, share: int) -> float:
    """Percentile of the sums of what a decision took and what its way to the client took [ms]."""
    return float(np.percentile(np.add.outer(decided_ms, way_ms), share))


def _share(values: np.ndarray, share: int) -> str:
    return f"{np.percentile(values, share):.0f}" if len(values) else "-"


def main() -> None:
    """Run all trials on two processes and print the claims."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0, help="added to the seeds of the emulated cells")
    options = parser.parse_args()
    jobs = [(seed + options.seed, finger_set) for seed, finger_set in CELLS]
    with ProcessPoolExecutor(2) as pool:
        found = [trial for many in pool.map(trials, *zip(*jobs, strict=True)) for trial in many]
    ways_ms = 1e3 * np.array(outcomes_at_client_s(DOMAIN, LIVE_GRASPS))
    report(found, ways_ms[np.isfinite(ways_ms)])  # a grasp that was broken off has no deciding sample


def report(found: list[Trial], way_ms: np.ndarray) -> None:
    """Print the claims; ``way_ms``: from deciding samples to the client of a live cell."""
    latency = np.array([trial.latency_s for trial in found])
    for trial in found:
        wrong = trial.held != (trial.outcome is GraspOutcome.GRIPPED)
        if wrong or trial.latency_s > 0.1:
            print(f"held={trial.held} {1e3 * trial.latency_s:.0f} ms {trial.said}", file=sys.stderr)
    counts = {o.value: sum(t.outcome is o for t in found) for o in GraspOutcome}
    parts = []
    for outcome in (GraspOutcome.GRIPPED, GraspOutcome.SLIPPED, GraspOutcome.EMPTY):
        of_it = 1e3 * np.array([t.latency_s for t in found if t.outcome is outcome and np.isfinite(t.latency_s)])
        parts.append(f"{outcome.value} {len(of_it)}: {_share(of_it, 50)} / {_share(of_it, 100)} ms")
    note = f"{len(found)} grasps, outcomes {counts}; event to decision (median / longest): {'; '.join(parts)}; "
    note += f"decision to client, {len(way_ms)} live: {_share(way_ms, 50)} / {_share(way_ms, 100)} ms"
    latency = 1e3 * latency[np.isfinite(latency)]
    peer = 1e3 * np.array([trial.peer_latency_s for trial in found if trial.peer_outcome is not None])
    rival = "stall time-out (1 mm/s for 1 s)"
    for name, share in (("result latency p50", 50), ("result latency p99", 99)):
        value, other = _published(latency, way_ms, share), _published(peer, way_ms, share)
        goal = 100.0 if share == 99 else None
        claim(name, value, "ms", better="lower", goal=goal, runs=len(latency), note=note, peer=rival, peer_value=other)
    contact = 1e3 * np.array([trial.contact_s for trial in found if np.isfinite(trial.contact_s)])
    for share in (50, 99):
        value = _published(contact, way_ms, share)
        claim(
            f"gripped after first contact p{share}", value, "ms", better="lower", goal=None, runs=len(contact),
            note="closing on and pressing included",
        )  # fmt: skip
    for name, said, truth, goal in (
        ("false gripped", GraspOutcome.GRIPPED, True, 1.0),
        ("false empty", GraspOutcome.EMPTY, False, 1.0),
        ("false slipped", GraspOutcome.SLIPPED, False, None),
    ):
        ours = [trial for trial in found if trial.outcome is said]
        theirs = [trial for trial in found if trial.peer_outcome is said]
        wrong = sum(trial.held is not truth for trial in ours)
        peer_wrong = sum(trial.peer_held is not truth for trial in theirs)
        note = f"{wrong} of {len(ours)} said {said.value}; the stall time-out {peer_wrong} of {len(theirs)}"
        value, other = _rate(wrong, len(ours)), _rate(peer_wrong, len(theirs))
        claim(name, value, "%", better="lower", goal=goal, runs=len(ours), note=note, peer=rival, peer_value=other)


if __name__ == "__main__":
    main()
