# SPDX-License-Identifier: Apache-2.0
"""Whether predicted intervals hold the true fingertip in emulated cells unknown to all fits, and how wide they are.

Each cell (its own seed: prints, spools, zero, friction, camera) has one finger set, is calibrated on its rig, homes,
and closes the index finger on nothing. The tip is seen by a marker that was glued beside it, through the cell's own
wrong calibration of its camera. The peer is the interval of the friction's covariance alone, of the same closings.
"""

from __future__ import annotations

import statistics
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from softgrip_emulator.camera.optics import Optics, draw_optics
from softgrip_emulator.camera.optics import calibrated as calibrated_optics
from softgrip_model.finger.session import MeasuredFinger, Session
from softgrip_model.finger.wear import WearSettings
from softgrip_testing.benchmark_claim import claim, no_options
from softgrip_testing.virtual_cell import SLOTS, TIP_NOISE_M, VirtualCell, calibrated

SEEDS = range(9601, 9651)
SETS = ("power", "hook", "pinch")
CLOSINGS = 5
#: Pulled length [m] and speed [m/s] of a closing; it is looked at from here on [m].
PULL_M, SPEED_M_PER_S, FROM_M = 0.016, 0.016, 0.002
#: Between closings [s]; what was learnt counts 2 s after a closing's end. Driver periods a frame of the camera.
REST_S, FRAME_PERIODS = 2.5, 5
#: Two-sided 95 %.
NORMAL_95 = 1.96

Array = NDArray[np.float64]


#: [m] that the tip's marker is glued beside it (softgrip_emulator.camera.scene).
GLUED_M = 0.15e-3


class Camera:
    """Where a cell's camera, as it was calibrated, sees the marker at a finger's tip."""

    def __init__(self, seed: int) -> None:
        self._true = draw_optics(640, 480, seed)
        self._believed = calibrated_optics(self._true, seed)
        self._rng = np.random.default_rng(seed)
        self._glue_m = np.random.default_rng([seed, 0x474C]).normal(0.0, GLUED_M, 2)

    def see(self, tip_m: Array, heading_rad: float) -> Array:
        """Return the measured tip [m] of a finger whose last link points so."""
        cos, sin = np.cos(heading_rad), np.sin(heading_rad)
        marker_m = tip_m + np.array([[cos, sin], [-sin, cos]]) @ self._glue_m
        pixel = self._true.to_pixels(marker_m[None])[0]
        return _plane(self._believed, pixel) + self._rng.normal(0.0, TIP_NOISE_M, 2)


def _plane(optics: Optics, pixel: Array) -> Array:
    """Return the point of the plane that is seen at a pixel, by Newton."""
    point = np.zeros(2)
    step_m = 1e-6
    for _ in range(6):
        found = optics.to_pixels(point + step_m * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
        slopes = (found[1:] - found[0]).T / step_m
        point = point + np.linalg.solve(slopes, pixel - found[0])
    return point


@dataclass
class Score:
    """How often coordinates of the tip lie within their interval, and how wide these are [mm]."""

    inside: list[bool] = field(default_factory=list)
    half_width_mm: list[float] = field(default_factory=list)

    def add(self, true_m: Array, predicted_m: Array, stddev_m: Array) -> None:
        """Take one prediction."""
        half = NORMAL_95 * stddev_m
        self.inside += (np.abs(true_m - predicted_m) <= half).tolist()
        self.half_width_mm += (1e3 * half).tolist()

    @property
    def coverage(self) -> float:
        """Share of coordinates within their interval [%]."""
        return 100.0 * float(np.mean(self.inside))

    @property
    def width_mm(self) -> float:
        """Median half width [mm]."""
        return statistics.median(self.half_width_mm)


@dataclass
class Scores:
    """Of the first closing, of the one after all that were learnt from, and of the first by friction's covariance."""

    before: Score = field(default_factory=Score)
    after: Score = field(default_factory=Score)
    friction_alone: Score = field(default_factory=Score)

    def add(self, other: Scores) -> None:
        """Take those of another cell."""
        for name in ("before", "after", "friction_alone"):
            mine, theirs = getattr(self, name), getattr(other, name)
            mine.inside += theirs.inside
            mine.half_width_mm += theirs.half_width_mm


class Closings:
    """Closings of a cell's index finger, seen by its camera."""

    def __init__(self, seed: int, finger_set: str) -> None:
        self.cell, self._camera = VirtualCell(seed, finger_set), Camera(seed)
        self._alone = Session(self.cell.profiles, {SLOTS[0]: finger_set}, WearSettings(), uncertainty=None)
        self._alone.set_friction(calibrated(seed))
        self._periods = 0
        self.cell.home()

    def close(self, score: Score | None, friction_alone: Score | None) -> None:
        """Close once and open again; score what is predicted on the way."""
        cell = self.cell
        ticket = cell.move(PULL_M, SPEED_M_PER_S, slots=SLOTS[:1])
        while cell.controller.result(ticket)[0] is None:
            cell.cycle()
            sample = cell.samples()[0]
            if sample.pulled_length_m > FROM_M:
                for session, where in ((cell.session, score), (self._alone, friction_alone)):
                    if where is not None:
                        (found,) = session.predict([sample], SLOTS[:1])
                        where.add(cell.tip_m(), np.array(found.tip), np.nan_to_num(np.array(found.tip_stddev)))
            self._see()
        cell.open()
        for _ in range(round(REST_S / cell.period_s)):
            cell.cycle()
            self._see()

    def _see(self) -> None:
        """Have the predictor take the tendon, and every few periods a frame."""
        sample = self.cell.samples()[0]
        self.cell.session.on_tendons([sample], SLOTS[:1])
        if self.has_frame():
            x, y = self.seen_tip().tolist()
            self.cell.session.on_measured(sample.stamp, [MeasuredFinger(SLOTS[0], (), (x, y))])

    def has_frame(self) -> bool:
        """Count a driver's period; return whether the camera takes a frame at it."""
        self._periods += 1
        return self._periods % FRAME_PERIODS == 0

    def seen_tip(self) -> Array:
        """Return the tip [m] as the camera sees it now."""
        return self._camera.see(self.cell.tip_m(), self.cell.tip_heading_rad())


def run(seed: int, finger_set: str) -> Scores:
    """Score one cell."""
    closings, scores = Closings(seed, finger_set), Scores()
    closings.close(scores.before, scores.friction_alone)
    for _ in range(CLOSINGS - 1):
        closings.close(None, None)
    closings.close(scores.after, None)
    return scores


def main() -> int:
    """Print the claims."""
    no_options(__doc__)
    names = [SETS[i % len(SETS)] for i in range(len(SEEDS))]
    with ProcessPoolExecutor() as pool:
        found = list(pool.map(run, SEEDS, names))
    total, scores = Scores(), {name: Scores() for name in SETS}
    for name, one in zip(names, found, strict=True):
        scores[name].add(one)
        total.add(one)
    before, after, alone = total.before, total.after, total.friction_alone
    by_set = "; ".join(f"{name} {one.before.coverage:.0f} / {one.after.coverage:.0f} %" for name, one in scores.items())
    widths = "; ".join(
        f"{name} {one.before.width_mm:.1f} / {one.after.width_mm:.1f} mm" for name, one in scores.items()
    )
    where = f"{len(SEEDS)} cells, closings of {1e3 * PULL_M:g} mm, 95 % intervals of x and y; before / after five:"
    claim(
        "coverage", before.coverage, "%", better="higher", goal=95.0, runs=len(SEEDS), note=f"{where} {by_set}",
        peer="friction's covariance alone", peer_value=alone.coverage,
    )  # fmt: skip
    claim(
        "half width", before.width_mm, "mm", better="lower", goal=3.0, runs=len(SEEDS),
        note=f"median; {widths}", peer="friction's covariance alone", peer_value=alone.width_mm,
    )  # fmt: skip
    claim(
        "half width after five closings", after.width_mm, "mm", better="lower", goal=1.0,
        runs=len(SEEDS), note=f"median; they hold {after.coverage:.0f} %", peer="before",
        peer_value=before.width_mm,
    )  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
