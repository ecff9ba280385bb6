# SPDX-License-Identifier: Apache-2.0
"""Whether the watch names what has changed about a finger: 25 changes, and quiet closings under all conditions.

The true finger is not the watch's: its joints are hinges (mode P), it is printed as its tolerances have it, its strips
creep, and its closings scatter. Each change is judged twice: by the closings of its finger alone, and by those of a
hand of three fingers, as a cell has it. Heat, the camera and how closings are made concern all three; the rest one of
them. The peer is the former watch (friction or stiffness) on the same closings.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root

from softgrip_model.finger import Finger, JointModel, Kernel
from softgrip_model.finger.closing_samples import ClosingInstant
from softgrip_model.finger.diagnosis import WATCH, WATCHED, CauseWatch, ClosingConditions
from softgrip_model.finger.hypotheses import Cause
from softgrip_model.finger.parts import bends, groove, strip_moment
from softgrip_model.finger.predictor import assumed_friction
from softgrip_model.finger.uncertainty import SCALED_COEFFICIENTS, Causes
from softgrip_model.finger.wear import WearMonitor, WearSettings, WearVerdict
from softgrip_model.friction.laws import FrictionLaw
from softgrip_model.profile import load_directory, shipped_directory
from softgrip_testing.benchmark_claim import claim, no_options

Array = NDArray[np.float64]

SETS = ("power", "hook", "pinch")
CELLS = range(7301, 7302)
PULLS_MM = np.arange(1.0, 16.5, 1.0)
#: Fingers of a hand.
FINGERS = 3
#: Quiet closings before a change, and closings after which it is asked for.
QUIET, AFTER = 12, 5
#: Closings of each of the quiet cells, under all conditions.
LONG_QUIET, QUIET_CELLS = 150, range(7401, 7407)
#: Share of the stress that creeps, and how fast [s] (docs/emulator.md: 10 % in 6 s).
CREEP, CREEP_S = 0.10, 6.0
#: Of a closing: pull [mm], tips [mm], tension; friction and stiffness beside the closing before.
SCATTER_MM, TIP_MM, TENSION, WANDER = 0.03, 0.3, 0.02, 0.01


@dataclass(frozen=True)
class Truth:
    """How a true finger differs from its profile, and how it is seen."""

    friction: float = 1.0
    stiffness: float = 1.0
    strips: tuple[float, ...] = (1.0, 1.0, 1.0)
    contact: tuple[int, float] = (0, 1.0)
    zero_mm: float = 0.0
    stretch_mm_per_n: float = 0.0
    camera_mm: tuple[float, float] = (0.0, 0.0)
    camera_scale: float = 1.0
    tilt_rad: float = 0.0
    gain: float = 1.0
    creep: float = CREEP
    speed_mm_per_s: float = 16.0
    rest_s: float = 12.0
    further_mm: float = 0.0


@dataclass(frozen=True)
class Change:
    """A change from closing to closing (n = 1 for the first), the causes that name it, whether all fingers share it."""

    name: str
    causes: frozenset[Cause]
    apply: Callable[[Truth, int], Truth]
    shared: bool = False


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


class TrueFinger:
    """A printed finger of a set, closed again and again."""

    def __init__(self, finger_set: str, seed: int) -> None:
        profile = load_directory(shipped_directory())[finger_set]
        self.believed, friction = Finger.from_profile(profile, "index"), assumed_friction(profile)
        self.law = friction.law
        self._rng = np.random.default_rng([seed, SETS.index(finger_set)])
        hinges = self.believed.with_joint_model(JointModel.HINGE)
        self._printed = hinges.with_design(
            np.array(hinges.thickness_mm) + 0.07 * self._rng.standard_normal(3),
            np.array(hinges.routing_mm) + 0.07 * self._rng.standard_normal(6),
        )
        self._own = self._rng.normal(1.0, 0.05, 2)
        self._predicted_n = Kernel([self.believed], self.law).solve(PULLS_MM).tension_n[0, :, 0]

    def close(self, truth: Truth) -> tuple[tuple[ClosingInstant, ...], ClosingConditions]:
        """Close once; return what is seen of it."""
        wander = 1.0 + WANDER * self._rng.standard_normal(2)
        tips, tensions = self.answer(truth, SCATTER_MM * self._rng.standard_normal(), *wander)
        seen = tips + TIP_MM * self._rng.standard_normal(tips.shape)
        measured_n = tensions * (1.0 + TENSION * self._rng.standard_normal(len(tensions)))
        closing = tuple(
            ClosingInstant(0, float(p), tip, float(n), float(expected))
            for p, tip, n, expected in zip(PULLS_MM, seen, measured_n, self._predicted_n, strict=True)
        )
        return closing, ClosingConditions(truth.speed_mm_per_s, truth.rest_s, further_mm=truth.further_mm)

    def answer(
        self, truth: Truth, shift_mm: float = 0.0, friction: float = 1.0, stiffness: float = 1.0
    ) -> tuple[Array, Array]:
        """Return tips [mm] and tensions [N] of a closing as it would be seen without noise."""
        t = PULLS_MM / truth.speed_mm_per_s
        loading = 1.0 - truth.creep * (1.0 - CREEP_S / t * (1.0 - np.exp(-t / CREEP_S)))
        unrecovered = 1.0 - 0.5 * truth.creep * math.exp(-truth.rest_s / CREEP_S)
        own = self._own * np.array([friction * truth.friction, stiffness * unrecovered])
        pulled = PULLS_MM + truth.zero_mm + shift_mm
        found = [self._solve(truth, pull, own[0], own[1] * share) for pull, share in zip(pulled, loading, strict=True)]
        tips = np.array([tip for tip, _ in found]) * truth.camera_scale * np.array([1.0, math.cos(truth.tilt_rad)])
        return tips + truth.camera_mm, truth.gain * np.array([tension for _, tension in found])

    def _solve(self, truth: Truth, pull: float, friction: float, stiffness: float) -> tuple[Array, float]:
        """Return tip [mm] and actuator tension [N]."""
        strip = self._printed.strip
        moduli = tuple(stiffness * truth.stiffness * modulus for modulus in strip.modulus_mpa)
        finger = dataclasses.replace(
            self._printed,
            strip=dataclasses.replace(strip, modulus_mpa=moduli),
            strip_width_mm=tuple(self._printed.width_mm * np.array(truth.strips)),
        )
        scaled = np.array(SCALED_COEFFICIENTS[self.law.law])
        law = self.law.with_coefficients(np.array(self.law.coefficients) * (1.0 + (friction - 1.0) * scaled))
        tension = 0.0
        for _ in range(3 if truth.stretch_mm_per_n else 1):
            found = Kernel([finger], law).solve([pull - truth.stretch_mm_per_n * tension], threads=1)
            tension = float(found.tension_n[0, 0, 0])
        if truth.contact[1] != 1.0:
            return _one_contact(
                finger, law, pull, truth.contact, found.angle_rad[0, 0], float(found.tension_n[0, 0, -1])
            )
        return found.tip_mm[0, 0], tension


def _one_contact(
    finger: Finger, law: FrictionLaw, pull: float, contact: tuple[int, float], start: Array, tip_n: float
) -> tuple[Array, float]:
    """Return tip and tension with ln Rf of one contact multiplied; by SciPy from the parts of mode P."""
    place, factor = contact
    spans = [groove(finger.routing_mm[2 * j], finger.routing_mm[2 * j + 1], 0.0).span_mm for j in range(3)]

    def chain(x: Array) -> list[float]:
        size = np.sqrt(np.asarray(bends(finger, x[:3])) ** 2 + finger.smoothing_rad**2)
        log = [float(x[3])]
        for i in range(5, -1, -1):
            ratio = float(law.evaluate(size[i], math.exp(log[-1])).log_ratio)
            log.append(log[-1] + ratio * (factor if i == place else 1.0))
        return log[::-1]

    def residual(x: Array) -> list[float]:
        log, taken, rows = chain(x), 0.0, []
        for j in range(3):
            at = groove(finger.routing_mm[2 * j], finger.routing_mm[2 * j + 1], float(x[j]))
            taken += spans[j] - at.span_mm
            rows.append(strip_moment(finger, j, float(x[j]))[0] - math.exp(log[2 * j + 1]) * at.arm_mm)
        return [*rows, 10.0 * (taken - pull)]

    x = root(residual, [*start, math.log(tip_n)], tol=1e-10).x
    heading = np.cumsum(x[:3])
    tip = np.array([np.dot(finger.link_mm, np.cos(heading)), -np.dot(finger.link_mm, np.sin(heading))])
    return tip, math.exp(chain(x)[0])


def watch_of(finger: TrueFinger) -> CauseWatch:
    """Return a watch of what is believed of a finger."""
    return CauseWatch(Causes(finger.believed, finger.law, None, WATCHED), WATCH)


@dataclass(frozen=True)
class Verdict:
    """What was named of a change: of its finger alone, and of the hand; and whether the former watch acts rightly."""

    finger_set: str
    number: int
    alone: tuple[Cause, ...]
    in_hand: tuple[Cause, ...]
    former: bool


def changed(finger_set: str, seed: int, number: int) -> Verdict:
    """Return what is named of a change."""
    one = CHANGES[number]
    hand = [TrueFinger(finger_set, seed + 17 * number + 1000 * place) for place in range(FINGERS)]
    watches = [watch_of(finger) for finger in hand]
    former = WearMonitor(hand[0].believed, hand[0].law, WearSettings())
    after = AFTER if "closing" not in one.name else 3 * AFTER
    for n in range(1 - QUIET, after + 1):
        for place, (finger, watch) in enumerate(zip(hand, watches, strict=True)):
            moved = n > 0 and (place == 0 or one.shared)
            closing, conditions = finger.close(one.apply(Truth(), n) if moved else Truth())
            watch.take(closing, conditions)
            if place == 0:
                feed(former, closing)
    alone = watches[0].diagnosis.causes
    watches[0].join(watches[1:])
    before = former.judge()[0]
    friction_right = Cause.FRICTION in one.causes and before is WearVerdict.RECALIBRATE
    stiffness_right = Cause.STIFFNESS in one.causes and before is WearVerdict.WORN
    in_hand = watches[0].diagnosis.causes
    return Verdict(finger_set, number, alone, in_hand, friction_right or stiffness_right)


def feed(former: WearMonitor, closing: tuple[ClosingInstant, ...]) -> None:
    """Have the former watch take a closing."""
    for instant in closing:
        former.add(instant, pulling=True, free=True)
    former.add(closing[-1], pulling=False, free=True)


def quiet(seed: int) -> tuple[int, int]:
    """Return closings, and those called worn, under all conditions."""
    finger = TrueFinger(SETS[seed % len(SETS)], seed)
    watch, rng, worn = watch_of(finger), np.random.default_rng(seed), 0
    for _ in range(LONG_QUIET):
        truth = Truth(
            stiffness=1.0 - 0.01 * rng.uniform(-10.0, 10.0),  # 1 % a kelvin (the table: 5-15 % for 5-15 K)
            speed_mm_per_s=rng.uniform(6.0, 20.0),
            rest_s=float(np.exp(rng.uniform(math.log(0.5), math.log(60.0)))),
        )
        watch.take(*finger.close(truth))
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


def main() -> int:
    """Print the claims."""
    no_options(__doc__)
    cases = [(name, seed, number) for number in range(len(CHANGES)) for name in SETS for seed in CELLS]
    with ProcessPoolExecutor() as pool:
        found = list(pool.map(changed, *zip(*cases, strict=True), chunksize=4))
        calm = list(pool.map(quiet, QUIET_CELLS))
    print(table(found), file=sys.stderr)
    closings, worn = (sum(column) for column in zip(*calm, strict=True))
    former = percent([v.former for v in found])
    for what, causes in (("finger alone", [v.alone for v in found]), ("hand of three", [v.in_hand for v in found])):
        pairs = list(zip(causes, found, strict=True))
        claim(
            f"right cause, {what}", percent([first(*pair) for pair in pairs]), "%", better="higher", goal=90.0,
            runs=len(found), peer="former watch", peer_value=former,
            note=f"{len(CHANGES)} changes, {AFTER} closings after each; among the first two named: "
            f"{percent([among(*pair, 2) for pair in pairs]):.1f} %",
        )  # fmt: skip
    claim(
        "false worn", 1e4 * worn / closings, "of 10,000 closings", better="lower", goal=1.0, runs=closings,
        note="rests 0.5-60 s, 6-20 mm/s, +-10 K",
    )  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
