# SPDX-License-Identifier: Apache-2.0
"""Write the film and the calibration that a bag of frames holds, for pages that track a film of yours."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np

from softgrip_bag.reader import attachments
from softgrip_testing.scripts import load_script

ROOT = Path(__file__).resolve().parents[2]
FPS = 30.0

example = load_script(ROOT / "examples/track_frames.py")


def main() -> int:
    """Write both."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("film", type=Path, help="to write, .mp4")
    parser.add_argument("calibration", type=Path, help="to write, .yaml")
    arguments = parser.parse_args()
    carried = {one.name: one.data for one in attachments(example.BAG)}
    arguments.calibration.write_bytes(carried[example.CALIBRATION])
    frames = [
        cv2.imdecode(np.frombuffer(bytes(frame["data"]), np.uint8), cv2.IMREAD_COLOR)
        for _, frame in example.messages(example.BAG, example.FRAMES)
    ]
    height, width = frames[0].shape[:2]
    film = cv2.VideoWriter(str(arguments.film), cv2.VideoWriter.fourcc(*"mp4v"), FPS, (width, height))
    for frame in frames:
        film.write(frame)
    film.release()
    return 0


if __name__ == "__main__":
    sys.exit(main())
