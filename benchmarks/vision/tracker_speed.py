# SPDX-License-Identifier: Apache-2.0
"""Frames per second of the marker tracker at 1280x720 on one core, everything after the image is decoded.

One finger of five markers closing and opening over clutter, then three fingers of five, two of whose tips are hidden by
the finger below in every third frame: what is hidden is looked for. A plain tracker (HSV threshold of the whole frame,
contours, moments, nearest neighbour) sees the same frames.
"""

from __future__ import annotations

import argparse
import math
import os
import statistics
import sys
import time
from collections.abc import Callable

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # one core; read when numpy is imported

import cv2
import numpy as np
from numpy.typing import NDArray
from tracker_accuracy import CHAIN, FPS, PlainTracker, closing

from softgrip_testing.benchmark_claim import claim, spread
from softgrip_testing.synthetic_images import Conditions, SyntheticScene, make_calibration
from softgrip_vision.colour import Image
from softgrip_vision.layout import FingerSetup
from softgrip_vision.tracker import Tracker

FRAMES = 60
GOAL_FPS = 250.0
PEER = "HSV threshold of the whole frame, moments, nearest neighbour"


def render(fingers: tuple[str, ...]) -> tuple[SyntheticScene, list[Image], dict[str, NDArray[np.float64]]]:
    """Return the scene, the frames of a closing there and back (so that they can be repeated), and the first places."""
    calibration = make_calibration(fingers, scale=4500.0 if len(fingers) == 1 else 2800.0)
    scene = SyntheticScene(calibration, dict.fromkeys(fingers, CHAIN), clutter=30, decoys=10, seed=3)
    there = [
        scene.render(dict.fromkeys(fingers, closing("power", k)), Conditions(noise=2.0)) for k in range(FRAMES // 2)
    ]
    images = [picture.image for picture in (*there, *there[::-1])]
    return scene, images, there[0].centres


def pass_times(measure: Callable[[Image, float], object], images: list[Image], runs: int) -> list[list[float]]:
    """Return the seconds of every frame of every run; one run goes first, untimed, and holds the search."""
    passes: list[list[float]] = []
    stamp = 1000.0
    for run in range(runs + 1):
        times = []
        for image in images:
            stamp += 1 / FPS
            start = time.perf_counter()
            measure(image, stamp)
            times.append(time.perf_counter() - start)
        if run:
            passes.append(times)
    return passes


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=7, help="passes over the frames (default 7)")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    results = {}
    for fingers in (("index",), ("index", "middle", "thumb")):
        scene, images, start = render(fingers)
        chains = {"power": dict.fromkeys(fingers, CHAIN)}
        tracker = Tracker(tuple(FingerSetup(f) for f in fingers), chains, scene.calibration, "power")
        ours = pass_times(tracker.measure, images, args.runs)
        plain = PlainTracker(start)
        peer = pass_times(lambda image, _stamp, plain=plain: plain.measure(image), images, args.runs)
        results[len(fingers)] = ours, peer
    for count, (ours, peer) in results.items():
        rates = [len(times) / math.fsum(times) for times in ours]
        late = [float(np.percentile(times, 95)) * 1e3 for times in ours]
        peer_rate = statistics.median(len(times) / math.fsum(times) for times in peer)
        peer_late = statistics.median(float(np.percentile(times, 95)) * 1e3 for times in peer)
        what = "1280x720, one core, after decoding, " + ("1 finger" if count == 1 else f"{count} fingers")
        suffix = "" if count == 1 else f" {count} fingers"
        claim(f"fps{suffix}", statistics.median(rates), "1/s", better="higher", goal=GOAL_FPS, runs=args.runs,
              note=f"{what}; {spread(rates, '1/s')}", peer=PEER, peer_value=peer_rate)  # fmt: skip
        claim(f"p95 latency{suffix}", statistics.median(late), "ms", better="lower", goal=1e3 / GOAL_FPS,
              runs=args.runs, note=f"{what}; {spread(late, 'ms')}", peer=PEER, peer_value=peer_late)  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
