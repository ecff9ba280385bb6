# SPDX-License-Identifier: Apache-2.0
"""How exact and how honest the marker tracker is, on rendered closings with known truth.

Clean: the three designs of Fig 4.4 closing 0 .. 20 mm, sensor noise of one grey level. Hard: the same with noise, blur,
motion, exposure, colour cast, a moving shadow, green clutter and decoys, JPEG 50 .. 95, things passing in front of one
or two markers for up to 15 frames, and two fingers crossing. A plain tracker (HSV threshold with the ranges of
Emio.API, contours, moments, nearest neighbour, started with the true places) sees the same frames.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from softgrip_testing.benchmark_claim import claim
from softgrip_testing.synthetic_images import Conditions, Occluder, Picture, SyntheticScene, make_calibration
from softgrip_vision.layout import ChainLayout, FingerSetup
from softgrip_vision.tracker import Tracker

Array = NDArray[np.float64]

CHAIN = ChainLayout((0.045, 0.027, 0.023))
#: Joint angles [deg] of the designs of Fig 4.4 at 0, 10 and 20 mm of pulled length (finger.md 3, hyp4).
CLOSINGS = {
    "power": ((0.0, 0.0, 0.0), (47.82, 22.552, 23.986), (83.728, 46.710, 45.102)),
    "hook": ((0.0, 0.0, 0.0), (4.814, 53.582, 21.216), (10.894, 86.704, 49.393)),
    "pinch": ((0.0, 0.0, 0.0), (52.573, 2.343, 1.720), (89.384, 22.484, 16.578)),
}
FRAMES = 60
FPS = 30.0
#: Emio.API's green: OpenCV hue, saturation, value; smallest area [px^2].
HSV_LOW, HSV_HIGH, HSV_AREA = (36, 138, 35), (90, 255, 255), 100.0
#: [px] A plain tracker's marker cannot jump further between frames.
NEAREST_REACH = 40.0
#: A marker with less than this share of its disc in sight is gone; one with more than that was simply missed.
GONE = 0.02
#: [px] A reading this close to another marker, and this far from its own, changed identity.
SWITCH_PX = 12.0


@dataclass
class Tally:
    """Sums over frames of one tracker."""

    centre_errors: list[float] = field(default_factory=list)
    angle_errors: list[float] = field(default_factory=list)
    switches: int = 0
    false_accepts: int = 0
    gone: int = 0
    present: int = 0
    seen: int = 0
    frames: int = 0
    poses: int = 0

    def add(self, readings: Array, truth: Array, visible: Array) -> None:
        """Add (n + 2, 2) [px] readings, NaN where nothing was seen, of one finger in one frame."""
        for index, (reading, centre, share) in enumerate(zip(readings, truth, visible, strict=True)):
            found = bool(np.isfinite(reading).all())
            self.gone += share <= GONE
            self.present += share > 0.98
            self.seen += found and share > 0.98
            if not found:
                continue
            if share <= GONE:
                self.false_accepts += 1
                continue
            error = math.dist(reading, centre)
            others = np.delete(truth, index, axis=0)
            nearest = float(np.hypot(*(others - reading).T).min())
            if error > SWITCH_PX and nearest < SWITCH_PX:
                self.switches += 1
            self.centre_errors.append(error)

    def add_pose(self, angles: Array | None, truth: Array) -> None:
        """Add (n,) [rad] joint angles, None where the tracker stayed silent."""
        self.frames += 1
        if angles is not None:
            self.poses += 1
            self.angle_errors += np.degrees(angles - truth).tolist()


def rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values else math.nan


class PlainTracker:
    """HSV threshold, contours, moments, nearest neighbour; started with the true places."""

    def __init__(self, start: dict[str, Array]) -> None:
        self._last = {finger: places.copy() for finger, places in start.items()}

    def measure(self, image: NDArray[np.uint8]) -> dict[str, Array]:
        """Return, per finger, (n + 2, 2) [px] centres; NaN where nothing was near."""
        mask = cv2.inRange(cv2.cvtColor(image, cv2.COLOR_BGR2HSV), np.array(HSV_LOW), np.array(HSV_HIGH))
        contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        moments = [m for contour in contours if (m := cv2.moments(contour))["m00"] >= HSV_AREA]
        centres = np.array([(m["m10"] / m["m00"], m["m01"] / m["m00"]) for m in moments]).reshape(-1, 2)
        out = {}
        for finger, last in self._last.items():
            readings = np.full_like(last, math.nan)
            for index, place in enumerate(last):
                distances = np.hypot(*(centres - place).T)
                if distances.size and distances.min() < NEAREST_REACH:
                    readings[index] = last[index] = centres[int(distances.argmin())]
            out[finger] = readings
        return out


def plain_angles(readings: Array, scene: SyntheticScene, finger: str) -> Array | None:
    """Return (n,) joint angles [rad] straight from the markers' directions; None when one is missing."""
    if not np.isfinite(readings).all():
        return None
    points = scene.to_plane(finger, readings)
    headings = np.unwrap(np.arctan2(*np.diff(points, axis=0).T[::-1]))
    return np.asarray(-np.diff(headings))


def closing(grasp: str, frame: int) -> Array:
    """Return (3,) joint angles [rad] of a design's closing, smooth in time, out and half back."""
    phase = 0.5 - 0.5 * math.cos(1.5 * math.pi * frame / (FRAMES - 1))
    corners = np.radians(CLOSINGS[grasp])
    return np.array([np.interp(20.0 * phase, (0.0, 10.0, 20.0), corners[:, joint]) for joint in range(3)])


def passers(random: np.random.Generator, scene: SyntheticScene, finger: str, grasp: str) -> dict[int, list[Occluder]]:
    """Return, per frame, things that hide one or two markers for up to 15 frames and move with them."""
    hidden: dict[int, list[Occluder]] = {}
    for begin in (4, 22, 40):
        start, length = begin + int(random.integers(0, 3)), int(random.integers(3, 16))
        first = int(random.integers(0, CHAIN.joints + 2))
        victims = {first, min(first + 1, CHAIN.joints + 1)} if random.random() < 0.5 else {first}
        green = random.random() < 0.3
        colour = (70.0, 160.0, 60.0) if green else (120.0, 140.0, 175.0)
        for frame in range(start, start + length):
            centres = scene.centres(finger, closing(grasp, frame))
            slide = 22.0 * max(0.0, 1.0 - min(frame - start, start + length - 1 - frame) / 1.0)
            for marker in victims:
                u, v = centres[marker]
                hidden.setdefault(frame, []).append(Occluder(u + slide, v - slide, 26.0, colour))
    return hidden


@dataclass
class Run:
    """One closing to be rendered."""

    grasp: str
    scene: SyntheticScene
    fingers: tuple[str, ...]
    conditions: list[Conditions]
    occluders: dict[int, list[Occluder]]

    def pictures(self) -> Iterator[tuple[dict[str, Array], Picture]]:
        """Yield (finger to joint angles, picture) of every frame."""
        for frame, conditions in enumerate(self.conditions):
            angles = {name: closing(self.grasp, max(0, frame - 6 * i)) for i, name in enumerate(self.fingers)}
            yield angles, self.scene.render(angles, conditions, self.occluders.get(frame, []))


def clean_runs() -> Iterator[Run]:
    for seed, grasp in enumerate(CLOSINGS):
        scene = SyntheticScene(make_calibration(), {"index": CHAIN}, seed=seed)
        yield Run(grasp, scene, ("index",), [Conditions(noise=1.0)] * FRAMES, {})


def hard_runs(count: int, seed: int) -> Iterator[Run]:
    random = np.random.default_rng(seed)
    for number in range(count):
        grasp = list(CLOSINGS)[number % 3]
        fingers = ("index", "thumb") if number % 4 == 3 else ("index",)
        scene = SyntheticScene(
            make_calibration(fingers),
            dict.fromkeys(fingers, CHAIN),
            clutter=int(random.integers(10, 40)),
            decoys=int(random.integers(5, 20)),
            seed=seed * 1000 + number,
        )
        blue, green, red = random.uniform(0.85, 1.15, 3).tolist()
        fixed = Conditions(
            noise=float(random.uniform(1.5, 6.0)),
            blur=float(random.uniform(0.6, 1.8)),
            exposure=float(random.uniform(0.55, 1.35)),
            channel_gains=(blue, green, red),
            shadow=float(random.uniform(0.0, 0.6)),
            jpeg=int(random.integers(50, 96)),
        )
        swing = float(random.uniform(0.0, 8.0))
        conditions = [
            replace(fixed, motion_px=swing * abs(math.sin(k / 7)), shadow_edge=0.25 + 0.5 * k / FRAMES)
            for k in range(FRAMES)
        ]
        yield Run(grasp, scene, fingers, conditions, passers(random, scene, "index", grasp))


def measure(run: Run, ours: Tally, plain: Tally) -> None:
    setups = tuple(FingerSetup(name) for name in run.fingers)
    tracker = Tracker(setups, {run.grasp: dict.fromkeys(run.fingers, CHAIN)}, run.scene.calibration, run.grasp)
    peer: PlainTracker | None = None
    for frame, (angles, picture) in enumerate(run.pictures()):
        peer = peer or PlainTracker(picture.centres)
        plain_readings = peer.measure(picture.image)
        for reading in tracker.measure(picture.image, 1000.0 + frame / FPS):
            name = reading.finger
            places = [m.pixel if not m.occluded else np.full(2, math.nan) for m in reading.markers]
            ours.add(np.array(places), picture.centres[name], picture.visible[name])
            ours.add_pose(reading.pose.angles if reading.pose else None, angles[name])
            plain.add(plain_readings[name], picture.centres[name], picture.visible[name])
            plain.add_pose(plain_angles(plain_readings[name], run.scene, name), angles[name])


def report(kind: str, ours: Tally, plain: Tally, goals: tuple[float, float]) -> None:
    coverage = (
        f"markers in sight that were seen: ours {ours.seen / ours.present:.1%}, peer {plain.seen / plain.present:.1%}; "
        f"frames with a pose: ours {ours.poses / ours.frames:.1%}, peer {plain.poses / plain.frames:.1%}"
    )
    peer = "HSV threshold, moments, nearest neighbour"
    within = np.percentile(ours.centre_errors, 95)
    note = f"RMS of {len(ours.centre_errors)} centres, 95 % below {within:.3f} px; {coverage}"
    claim(f"{kind} centre error", rms(ours.centre_errors), "px", better="lower", goal=goals[0], runs=1, note=note,
          peer=peer, peer_value=rms(plain.centre_errors))  # fmt: skip
    within = np.percentile(np.abs(ours.angle_errors), 95)
    note = f"RMS of {len(ours.angle_errors)} angles, 95 % below {within:.3f} deg"
    claim(f"{kind} joint error", rms(ours.angle_errors), "deg", better="lower", goal=goals[1], runs=1, note=note,
          peer=peer, peer_value=rms(plain.angle_errors))  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hard", type=int, default=16, help="hard closings of 60 frames (default 16)")
    parser.add_argument("--seed", type=int, default=1, help="of the hard closings (default 1)")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    clean, clean_plain, hard, hard_plain = Tally(), Tally(), Tally(), Tally()
    for run in clean_runs():
        measure(run, clean, clean_plain)
    for run in hard_runs(args.hard, args.seed):
        measure(run, hard, hard_plain)
    report("clean", clean, clean_plain, (0.15, 0.3))
    report("hard", hard, hard_plain, (0.5, 1.0))
    peer = "HSV threshold, moments, nearest neighbour"
    note = f"in {len(clean.centre_errors) + len(hard.centre_errors)} readings"
    claim("identity switches", clean.switches + hard.switches, "1", better="lower", goal=0, runs=1, note=note,
          peer=peer, peer_value=clean_plain.switches + hard_plain.switches)  # fmt: skip
    note = f"of {hard.gone} markers that were gone"
    claim("false accepts", hard.false_accepts, "1", better="lower", goal=0, runs=1, note=note,
          peer=peer, peer_value=hard_plain.false_accepts)  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
