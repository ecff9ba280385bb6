# SPDX-License-Identifier: Apache-2.0
"""Track a finger's markers in recorded frames, with the calibration that the bag carries."""

import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np

from softgrip_bag.definition import decode, parse_definitions
from softgrip_bag.reader import attachments, read, topic_summaries
from softgrip_time.units import to_s
from softgrip_vision import calibration
from softgrip_vision.layout import FingerSetup, read_chains
from softgrip_vision.options import TrackerOptions
from softgrip_vision.readings import FingerReading
from softgrip_vision.tracker import Tracker

BAG = Path(__file__).parents[1] / "tests/replay/bags/frames"
FRAMES, PROFILE = "/camera/image_raw/compressed", "power"
OPTIONS = TrackerOptions(placement_stddev_m=3e-4)  # how exactly the markers were stuck on
CALIBRATION = "parameter_files/marker_tracker/calibration_file/camera_calibration.yaml"


def messages(bag: Path, topic: str) -> Iterator[tuple[int, Mapping[str, Any]]]:
    """Yield stamp [ns] and fields of each message of a topic."""
    kind = next(one for one in topic_summaries(bag) if one.name == topic)
    definitions = parse_definitions(kind.type_name, kind.schema)
    for raw in read(bag, {topic}):
        yield raw.published, decode(kind.type_name, definitions, raw.data).values


def main(bag: Path = BAG) -> list[FingerReading]:
    """Return the reading of the index finger in every frame."""
    carried = {one.name: one.data for one in attachments(bag)}
    with TemporaryDirectory() as folder:
        file = Path(folder) / "calibration.yaml"
        file.write_bytes(carried[CALIBRATION])
        known = calibration.load(file)
    tracker = Tracker((FingerSetup("index"),), read_chains(None), known, PROFILE, OPTIONS)
    found = []
    for stamp_ns, frame in messages(bag, FRAMES):
        pixels = cv2.imdecode(np.frombuffer(bytes(frame["data"]), np.uint8), cv2.IMREAD_COLOR)
        (reading,) = tracker.measure(pixels, to_s(stamp_ns))
        found.append(reading)
        if reading.pose is not None:
            angles, stddev = np.degrees(reading.pose.angles), np.degrees(reading.pose.angles_stddev)
            print("  ".join(f"{a:6.2f} +- {s:.2f}" for a, s in zip(angles, stddev, strict=True)), "deg")
    return found


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
