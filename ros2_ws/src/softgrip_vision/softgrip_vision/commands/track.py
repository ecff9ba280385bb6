# SPDX-License-Identifier: Apache-2.0
"""Measure the joint angles of fingers in a video: what one did by hand, frame by frame.

Writes into the output folder:
  track.csv     one line per frame and finger: time, joint angles and tip with standard deviations, markers
  track.png     joint angles and tip over time, with their uncertainty
  overlay.mp4   the video with what was found drawn in
Ends with 1 when no frame showed a finger. A film that breaks off, and Ctrl-C, leave the results
up to there and end with 1, too.

Example:
  ros2 run softgrip_vision track closing.mp4 --calibration camera.yaml --out out/closing --profile power
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
from rich.console import Console
from rich.progress import Progress

from softgrip_time.units import to_s
from softgrip_vision import calibration
from softgrip_vision.errors import VisionError
from softgrip_vision.frame import FrameSource
from softgrip_vision.layout import ChainLayout, Chains, FingerSetup, read_chains
from softgrip_vision.options import TrackerOptions
from softgrip_vision.overlay import draw
from softgrip_vision.readings import FingerReading
from softgrip_vision.report import Rows, plot, write_csv
from softgrip_vision.sources import open_source
from softgrip_vision.tracker import Tracker

console = Console()
#: Files have no other time line than their own.
START_NS = 0
#: Share of the frames that a film announces: some containers give an estimate.
MIN_SHARE = 0.95


def main(argv: Sequence[str] | None = None) -> None:
    """Run the command."""
    arguments = _parser().parse_args(argv)
    try:
        _track(arguments)
    except (VisionError, OSError) as error:
        console.print(f"track: {error}", style="red", highlight=False)
        sys.exit(1)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="track", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("video", metavar="VIDEO", help="video file or folder of pictures")
    parser.add_argument("--calibration", type=Path, required=True, help="of the camera (calibrate_camera)")
    parser.add_argument("--out", type=Path, required=True, help="folder for the results")
    chain = parser.add_mutually_exclusive_group()
    chain.add_argument("--profile", default="power", help="finger profile that gives the link lengths (default power)")
    chain.add_argument("--links-mm", type=float, nargs="+", metavar="MM",
                       help="link lengths instead, joint to joint, the last one to the tip")  # fmt: skip
    parser.add_argument("--profiles", type=Path, help="folder of profiles (default: the shipped ones)")
    parser.add_argument("--fingers", nargs="+", help="which planes of the calibration to look at (default: all)")
    parser.add_argument("--hue", type=float, default=120.0, help="colour of the markers [deg] (default 120: green)")
    parser.add_argument("--placement-mm", type=float, default=0.3, metavar="MM",
                        help="how exactly the markers were stuck on (default 0.3: by hand)")  # fmt: skip
    parser.add_argument("--no-overlay", action="store_true", help="write no overlay video")
    return parser


def _track(arguments: argparse.Namespace) -> None:
    known = calibration.load(arguments.calibration)
    names = arguments.fingers or [plane.finger for plane in known.planes]
    if not names:
        raise VisionError(f"{arguments.calibration}: expected a finger's plane, found none; run calibrate_camera plane")
    chains, profile = _chains(arguments, names)
    setups = tuple(FingerSetup(name, arguments.hue) for name in names)
    tracker = Tracker(setups, chains, known, profile, TrackerOptions(placement_stddev_m=arguments.placement_mm / 1e3))
    source = open_source(arguments.video, start_ns=START_NS)
    try:
        _make_folder(arguments.out)
        rows, cut_short = _measure_all(source, tracker, arguments)
    finally:
        source.close()
    write_csv(rows, arguments.out / "track.csv")
    plot(rows, arguments.out / "track.png")
    _summary(rows, arguments.out)
    if cut_short:
        raise VisionError(f"{cut_short}; the results end there")
    if all(reading.pose is None for _, reading in rows):
        raise VisionError(f"expected markers in {arguments.video}, found none in any of its frames")


def _measure_all(source: FrameSource, tracker: Tracker, arguments: argparse.Namespace) -> tuple[Rows, str]:
    """Return all that was measured, and why that is not all of the film; raise when it is nothing."""
    rows: list[tuple[float, FingerReading]] = []
    frames, announced = 0, getattr(source, "frame_count", 0)
    try:
        with Progress(console=console) as progress:
            for time, readings in _readings(source, tracker, arguments, progress):
                rows += [(time, reading) for reading in readings]
                frames += 1
    except KeyboardInterrupt:
        return rows, "interrupted"
    except VisionError as error:
        if not rows:
            raise
        return rows, str(error)
    if frames < MIN_SHARE * announced:
        return rows, f"{arguments.video}: expected {announced} frames, found {frames}; is the file cut off?"
    return rows, ""


def _make_folder(path: Path) -> None:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        raise VisionError(f"{path}: expected a folder for the results, found a file of that name") from error


def _readings(
    source: FrameSource, tracker: Tracker, arguments: argparse.Namespace, progress: Progress
) -> Iterator[tuple[float, tuple[FingerReading, ...]]]:
    """Yield (time [s], readings) of every frame, writing the overlay on the way."""
    overlay: cv2.VideoWriter | None = None
    task = progress.add_task("tracking", total=getattr(source, "frame_count", 0) or None)
    try:
        while (frame := source.read()) is not None:
            image, time = frame.pixels(), to_s(frame.stamp_ns)
            readings = tracker.measure(image, time)
            yield time, readings
            if not arguments.no_overlay:
                overlay = overlay or _writer(arguments.out / "overlay.mp4", source, (frame.width, frame.height))
                overlay.write(draw(image, readings))
            progress.advance(task)
    finally:
        if overlay is not None:
            overlay.release()


def _chains(arguments: argparse.Namespace, fingers: Sequence[str]) -> tuple[Chains, str]:
    """Return the chains to look for and the profile to take from them."""
    if arguments.links_mm is None:
        return read_chains(arguments.profiles), arguments.profile
    layout = ChainLayout(tuple(length * 1e-3 for length in arguments.links_mm))
    return {"video": dict.fromkeys(fingers, layout)}, "video"


def _writer(path: Path, source: object, size: tuple[int, int]) -> cv2.VideoWriter:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), getattr(source, "fps", 30.0), size)
    if not writer.isOpened():
        raise VisionError(f"{path}: expected to write an MP4 video there, found that OpenCV cannot")
    return writer


def _summary(rows: Sequence[tuple[float, FingerReading]], out: Path) -> None:
    for finger in sorted({reading.finger for _, reading in rows}):
        mine = [reading for _, reading in rows if reading.finger == finger]
        silent = [reading.problem for reading in mine if reading.pose is None]
        text = f"{finger}: pose in {len(mine) - len(silent)} of {len(mine)} frames"
        if silent:
            maximum = max(set(silent), key=silent.count)
            text += f"; most often missing because: {maximum}"
        console.print(text, highlight=False)
    console.print(f"results in {out}", highlight=False)


if __name__ == "__main__":
    main()
