# SPDX-License-Identifier: Apache-2.0
"""Whether the watch names what has changed about a finger: 25 changes, and quiet closings under all conditions.

The true finger is not the watch's (`_changed_finger`): its joints are hinges (mode P), or it is the emulated cell's
(``--plant beams``). It is printed as its tolerances have it, its strips creep, its closings scatter. Each change is
judged twice: by the closings of its finger alone, and by those of a hand of three fingers, as a cell has it. Heat, the
camera and how closings are made concern all three; the rest one of them. The peer is the former watch (friction or
stiffness) on the same closings.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import math
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np
from _changed_finger import SETS, BeamFinger, ChangedFinger, HingedFinger, Truth

from softgrip_model.finger.closing_samples import ClosingInstant
from softgrip_model.finger.diagnosis import WATCH, WATCHED, CauseWatch
from softgrip_model.finger.hypotheses import Cause
from softgrip_model.finger.uncertainty import Causes
from softgrip_model.finger.wear import WearMonitor, WearSettings, WearVerdict
from softgrip_testing.benchmark_claim import claim

PLANTS: dict[str, Callable[[str, int], ChangedFinger]] = {"hinges": HingedFinger, "beams": BeamFinger}
#: Of development; what is published is from other ones.
CELLS, QUIET_CELLS = 7301, 7401
#: Fingers of a hand.
FINGERS = 3
#: Quiet closings before a change, and closings after which it is asked for; of one that goes on.
QUIET, AFTER, AFTER_ONGOING = 12, (5, 12), (15, 24)
#: Closings of each of the quiet cells, under all conditions.
LONG_QUIET = 150


@dataclass(frozen=True)
class Change:
    """A change from closing to closing (n = 1 for the first), the causes that name it, whether all fingers share it.

    Attributes:
        after: closings after which it is asked for.
    """

    name: str
    causes: frozenset[Cause]
    apply: Callable[[Truth, int], Truth]
    shared: bool = False
    after: tuple[int, ...] = AFTER


def change(name: str, causes: set[Cause], *, shared: bool = False, **to: object) -> Change:
    """Return a change that stays."""
    return Change(name, frozenset(causes), lambda truth, _: dataclasses.replace(truth, **to), shared)  # type: ignore[arg-type]


SOFTER = {Cause.STIFFNESS, Cause.TEMPERATURE}
CHANGES = (
    change("friction x 0.75", {Cause.FRICTION}, friction=0.75),
    change("friction x 1.1", {Cause.FRICTION}, friction=1.1),
    change("friction x 1.25", {Cause.FRICTION}, friction=1.25),
    change("friction x 1.6", {Cause.FRICTION}, friction=1.6),
    Change(
        "friction + 1 % a closing",
        frozenset({Cause.FRICTION}),
        lambda t, n: dataclasses.replace(t, friction=1 + 0.01 * n),
        after=AFTER_ONGOING,
    ),
    change("one contact x 2", {Cause.FRICTION}, contact=(2, 2.0)),
    change("stiffness - 5 %", SOFTER, shared=True, stiffness=0.95),
    change("stiffness - 15 %", SOFTER, shared=True, stiffness=0.85),
    change("stiffness + 10 %", SOFTER, shared=True, stiffness=1.10),
    change("softening - 25 %", {Cause.RUNNING_IN, Cause.STIFFNESS}, stiffness=0.75, further_mm=3.0),
    change("middle strip - 30 %", {Cause.STRIP}, strips=(1.0, 0.7, 1.0)),
    change("zero + 0.3 mm", {Cause.ZERO}, zero_mm=0.3),
    change("zero + 1 mm", {Cause.ZERO}, zero_mm=1.0),
    change("zero - 1 mm", {Cause.ZERO}, zero_mm=-1.0),
    change("cable's stiffness / 3", {Cause.CABLE}, stretch_mm_per_n=0.1),
    change("camera 1 mm", {Cause.CAMERA}, shared=True, camera_mm=(0.7, 0.7)),
    change("camera 2 mm", {Cause.CAMERA}, shared=True, camera_mm=(1.4, -1.4)),
    change("camera's scale + 1 %", {Cause.CAMERA}, shared=True, camera_scale=1.01),
    change("5 deg out of plane", {Cause.OUT_OF_PLANE}, tilt_rad=math.radians(5.0)),
    change("15 deg out of plane", {Cause.OUT_OF_PLANE}, tilt_rad=math.radians(15.0)),
    change("tension gain + 8 %", {Cause.TENSION_GAIN}, gain=1.08),
    change("tension gain - 8 %", {Cause.TENSION_GAIN}, gain=0.92),
    change("6 instead of 16 mm/s", {Cause.CONDITIONS}, shared=True, speed_mm_per_s=6.0),
    change("0.5 s rest", {Cause.CONDITIONS}, shared=True, rest_s=0.5),
    change("creep 10 to 25 %", SOFTER, creep=0.25),
)


def watch_of(finger: ChangedFinger) -> CauseWatch:
    """Return a watch of what is believed of a finger."""
    return CauseWatch(Causes(finger.believed, finger.law, None, WATCHED), WATCH)


@dataclass(frozen=True)
class Verdict:
    """What was named of a change: of its finger alone, and of the hand; and whether the former watch acts rightly.

    Attributes:
        after: place in `AFTER` of how many closings it was asked for after.
    """

    finger_set: str
    number: int
    after: int
    alone: tuple[Cause, ...]
    in_hand: tuple[Cause, ...]
    former: bool


def changed(plant: str, thermometer: bool, finger_set: str, seed: int, number: int) -> list[Verdict]:
    """Return what is named of a change after so many closings, and after more."""
    one, calm, verdicts = CHANGES[number], Truth(thermometer=thermometer), []
    hand = [PLANTS[plant](finger_set, seed + 17 * number + 1000 * place) for place in range(FINGERS)]
    watches = [watch_of(finger) for finger in hand]
    former = WearMonitor(hand[0].believed, hand[0].law, WearSettings())
    for n in range(1 - QUIET, one.after[-1] + 1):
        for place, (finger, watch) in enumerate(zip(hand, watches, strict=True)):
            moved = n > 0 and (place == 0 or one.shared)
            closing, conditions = finger.close(one.apply(calm, n) if moved else calm)
            watch.add_closing(closing, conditions)
            if place == 0:
                feed(former, closing)
        if n in one.after:
            before = former.judge()[0]
            friction_right = Cause.FRICTION in one.causes and before is WearVerdict.RECALIBRATE
            stiffness_right = Cause.STIFFNESS in one.causes and before is WearVerdict.WORN
            alone = watches[0].diagnosis.causes
            watches[0].join(watches[1:])
            in_hand = watches[0].diagnosis.causes
            watches[0].join(())
            after = one.after.index(n)
            verdicts.append(Verdict(finger_set, number, after, alone, in_hand, friction_right or stiffness_right))
    return verdicts


def feed(former: WearMonitor, closing: tuple[ClosingInstant, ...]) -> None:
    """Have the former watch take a closing."""
    for instant in closing:
        former.add(instant, pulling=True, free=True)
    former.add(closing[-1], pulling=False, free=True)


def quiet(plant: str, thermometer: bool, seed: int) -> tuple[int, int]:
    """Return closings, and those called worn, under all conditions."""
    finger = PLANTS[plant](SETS[seed % len(SETS)], seed)
    watch, rng, worn = watch_of(finger), np.random.default_rng(seed), 0
    for _ in range(LONG_QUIET):
        truth = Truth(
            thermometer=thermometer,
            stiffness=1.0 - 0.01 * rng.uniform(-10.0, 10.0),  # 1 % a kelvin (the table: 5-15 % for 5-15 K)
            speed_mm_per_s=rng.uniform(6.0, 20.0),
            rest_s=float(np.exp(rng.uniform(math.log(0.5), math.log(60.0)))),
        )
        watch.add_closing(*finger.close(truth))
        worn += watch.judge()[0] is WearVerdict.WORN
    return LONG_QUIET, worn


def table(found: Sequence[Verdict]) -> str:
    """Return for each change and set how often the right cause comes first, of the finger alone and of the hand."""
    lines = []
    for number, one in enumerate(CHANGES):
        cells, wrong = [], Counter[str]()
        for name in SETS:
            mine = [verdict for verdict in found if (verdict.finger_set, verdict.number) == (name, number)]
            cells.append(f"{sum(first(v.alone, v) for v in mine)}, {sum(first(v.in_hand, v) for v in mine)}")
            wrong.update(" or ".join(v.in_hand) or "nothing" for v in mine if not first(v.in_hand, v))
        listed = "; ".join(f"{name} ({count})" for name, count in wrong.most_common())
        lines.append(f"| {one.name} | {' | '.join(cells)} | {listed} |")
    return "\n".join(lines)


def first(causes: tuple[Cause, ...], verdict: Verdict) -> bool:
    """Whether the first cause is right."""
    return bool(causes) and causes[0] in CHANGES[verdict.number].causes


def among(causes: tuple[Cause, ...], verdict: Verdict, count: int) -> bool:
    """Whether the first so many causes hold a right one."""
    return bool(CHANGES[verdict.number].causes.intersection(causes[:count]))


def percent(found: Sequence[bool]) -> float:
    """Return the share of those that hold."""
    return 100.0 * float(np.mean(found))


def parser() -> argparse.ArgumentParser:
    """Return the command line's parser."""
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--plant", choices=PLANTS, default="hinges", help="the true fingers (default hinges)")
    made.add_argument("--thermometer", action="store_true", help="the room's temperature is measured")
    made.add_argument("--seed", type=int, default=CELLS, help=f"of the first cell with changes (default {CELLS})")
    made.add_argument("--cells", type=int, default=1, help="with changes; 75 cases each (default 1)")
    made.add_argument("--quiet-seed", type=int, default=QUIET_CELLS, help=f"first quiet cell (default {QUIET_CELLS})")
    made.add_argument("--quiet-cells", type=int, default=6, help=f"of {LONG_QUIET} closings each (default 6)")
    return made


def say_right(found: Sequence[Verdict], what_with: str, after: int) -> None:
    """Print how often the right cause comes first."""
    former = percent([v.former for v in found])
    for what, causes in (("finger alone", [v.alone for v in found]), ("hand of three", [v.in_hand for v in found])):
        pairs = list(zip(causes, found, strict=True))
        claim(
            f"right cause, {what}, after {after} closings", percent([first(*pair) for pair in pairs]), "%",
            better="higher", goal=90.0, runs=len(found), peer="former watch", peer_value=former,
            note=f"{what_with}; {len(CHANGES)} changes; among the first two: "
            f"{percent([among(*pair, 2) for pair in pairs]):.1f} %",
        )  # fmt: skip


def main() -> int:
    """Print the claims."""
    options = parser().parse_args()
    plant, with_what = options.plant, "with a thermometer" if options.thermometer else "no thermometer"
    seeds = range(options.seed, options.seed + options.cells)
    quiet_seeds = range(options.quiet_seed, options.quiet_seed + options.quiet_cells)
    cases = [
        (plant, options.thermometer, name, seed, number)
        for number in range(len(CHANGES))
        for name in SETS
        for seed in seeds
    ]
    with ProcessPoolExecutor() as pool:
        every = [one for each in pool.map(changed, *zip(*cases, strict=True), chunksize=4) for one in each]
        calm = list(pool.map(functools.partial(quiet, plant, options.thermometer), quiet_seeds))
    closings, worn = (sum(column) for column in zip(*calm, strict=True))
    for place, after in enumerate(AFTER):
        found = [verdict for verdict in every if verdict.after == place]
        print(f"after {after} closings\n{table(found)}", file=sys.stderr)
        say_right(found, f"{plant}, {with_what}", after)
    claim(
        "false worn", 1e4 * worn / closings, "of 10,000 closings", better="lower", goal=1.0, runs=closings,
        note=f"{plant}, {with_what}; rests 0.5-60 s, 6-20 mm/s, +-10 K",
    )  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
