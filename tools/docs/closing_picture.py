# SPDX-License-Identifier: Apache-2.0
"""Draws docs/images/closing.gif: a finger of the emulated cell as the camera saw it, beside its prediction.

The data are a shipped bag: finger/measured (the marker tracker) and the finger/predicted of the same instant.
"""

from __future__ import annotations

import argparse
import io
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from PIL import Image

from softgrip_bag.definition import decode, parse_definitions
from softgrip_bag.reader import read, topic_summaries
from softgrip_model.finger import Finger
from softgrip_model.profile import load_directory, shipped_directory

ROOT = Path(__file__).resolve().parents[2]
BAG = ROOT / "tests/replay/bags/closings"
PICTURE = ROOT / "docs/images/closing.gif"
FINGER = "index"
#: One picture for at least so much pulled length [m].
STEP_M = 0.00045
DURATION_MS, LAST_MS = 70, 1600
MEASURED, PREDICTED = "#1f6f8b", "#d1495b"

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Frame:
    """One instant of a closing, as seen and as predicted; angles [rad], tips [m]."""

    stamp_ns: int
    profile: str
    pulled_length_m: float
    measured: Array
    predicted: Array
    tip_error_mm: float


def states(topic: str) -> Iterator[tuple[int, Any]]:
    """Yield stamp [ns] and state of the finger, of each message of a topic that has it."""
    schema = next(one for one in topic_summaries(BAG) if one.name == topic)
    definitions = parse_definitions(schema.type_name, schema.schema)
    for raw in read(BAG, {topic}):
        message = decode(schema.type_name, definitions, raw.data).values
        stamp = message["header"].values["stamp"].values
        for state in message["fingers"]:
            if state.values["finger"] == FINGER:
                yield int(stamp["sec"]) * 10**9 + int(stamp["nanosec"]), state.values


def frames() -> list[Frame]:
    """Return what was measured, each with the prediction of its instant."""
    predicted = dict(states("/finger/predicted"))
    stamps = np.array(sorted(predicted))
    found = []
    for stamp, seen in states("/finger/measured"):
        nearest = predicted[int(stamps[np.abs(stamps - stamp).argmin()])]
        pair = [np.array(state["joint_angles"]) for state in (seen, nearest)]
        if len(pair[0]) == len(pair[1]) and all(np.isfinite(angles).all() for angles in pair):
            tips = [np.array([state["tip"].values[axis] for axis in "xy"]) for state in (seen, nearest)]
            error = 1e3 * float(np.hypot(*(tips[0] - tips[1])))
            found.append(Frame(stamp, nearest["profile"], nearest["pulled_length"], *pair, error))
    return found


def longest_closing(everything: Sequence[Frame]) -> list[Frame]:
    """Return the frames of the closing that goes furthest, a step apart."""
    runs: list[list[Frame]] = [[]]
    for frame in everything:
        last = runs[-1][-1] if runs[-1] else None
        if last is not None and (frame.profile != last.profile or frame.pulled_length_m < last.pulled_length_m - 1e-4):
            runs.append([])
        if not runs[-1] or frame.pulled_length_m >= runs[-1][-1].pulled_length_m + STEP_M:
            runs[-1].append(frame)
    return max(runs, key=lambda run: run[-1].pulled_length_m - run[0].pulled_length_m if run else 0.0)


def chain(finger: Finger, angles: Array) -> Array:
    """Return the joints and the tip [mm] of a finger with these joint angles, closing towards -y."""
    links = np.array(finger.link_mm, dtype=float)
    turned = -np.cumsum(angles)
    steps = links[:, None] * np.column_stack([np.cos(turned), np.sin(turned)])
    return np.vstack([[0.0, 0.0], np.cumsum(steps, axis=0)])


def draw(frame: Frame, past: Sequence[Frame], finger: Finger, limits: tuple[float, float]) -> Image.Image:
    """Return one picture."""
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(7.2, 3.3), width_ratios=(1.25, 1), layout="constrained", dpi=100
    )
    draw_finger(left, frame, finger)
    pulled = [1e3 * one.pulled_length_m for one in past]
    right.plot(pulled, [one.tip_error_mm for one in past], color="0.25")
    right.set(xlim=(0, limits[0]), ylim=(0, limits[1]), xlabel="pulled length [mm]")
    right.set_title("tip: seen minus predicted [mm]", fontsize=10)
    right.grid(alpha=0.3)
    memory = io.BytesIO()
    figure.savefig(memory, format="png")
    plt.close(figure)
    return Image.open(memory).convert("RGB").quantize(48)


def draw_finger(axes: Axes, frame: Frame, finger: Finger) -> None:
    """Draw both fingers."""
    reach = float(np.sum(finger.link_mm))
    axes.plot([-12, 0], [0, 0], color="0.6", linewidth=14, solid_capstyle="butt")
    for angles, colour, style, width, label in (
        (frame.measured, MEASURED, "-", 9.0, "seen by the camera"),
        (frame.predicted, PREDICTED, "--", 2.5, "predicted"),
    ):
        points = chain(finger, angles)
        axes.plot(*points.T, style, color=colour, linewidth=width, alpha=0.85, label=label, solid_capstyle="round")
        axes.plot(*points.T, "o", color="white", markeredgecolor=colour, markersize=5)
    axes.set(xlim=(-15, 1.05 * reach), ylim=(-1.02 * reach, 0.25 * reach), aspect="equal", xlabel="[mm]")
    axes.set_title(f"{frame.profile}, {FINGER}: {1e3 * frame.pulled_length_m:.1f} mm pulled", fontsize=10)
    axes.legend(loc="lower left", fontsize=8, frameon=False)


def main() -> int:
    """Draw and write the picture."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    run = longest_closing(frames())
    finger = Finger.from_profile(load_directory(shipped_directory())[run[0].profile], FINGER)
    limits = 1.05e3 * run[-1].pulled_length_m, max(2.0, 1.15 * max(frame.tip_error_mm for frame in run))
    pictures = [draw(frame, run[: i + 1], finger, limits) for i, frame in enumerate(run)]
    durations = [DURATION_MS] * (len(pictures) - 1) + [LAST_MS]
    pictures[0].save(
        PICTURE, save_all=True, append_images=pictures[1:], duration=durations, loop=0, optimize=True, disposal=1
    )
    print(f"{PICTURE.relative_to(ROOT)}: {len(pictures)} frames, {PICTURE.stat().st_size / 1e3:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
