# SPDX-License-Identifier: Apache-2.0
"""capture: a hand on video becomes grasp motions, each of a kind, ready for `optimise`."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from softgrip_design import plots
from softgrip_design.capture.detector import INSTALL, HandDetector, MediaPipeDetector
from softgrip_design.capture.frames import Images, Source, Video, record_camera
from softgrip_design.capture.grasps import DetectedGrasp, find_grasps
from softgrip_design.capture.overlay import write_overlay
from softgrip_design.capture.recording import LONG_FINGERS, RecordedMotion, Recording, record, steady
from softgrip_design.errors import DesignError

EPILOG = f"""\
SOURCE is a video file, a folder of images (in the order of the numbers in their names), or `camera` or `camera:1`.
Works without a network. MediaPipe is an extra:  {INSTALL}

Writes into --out: motion_<nn>_<kind>.csv (joint angles of every motion, input of `optimise`), motions.json (the numbers
behind each kind), recording.png and overlay.mp4 (both with the motions marked).

Film one whole hand without an object: open, close as for the grasp, hold for half a second, open again.

examples:
  capture grasps.mp4
  capture camera --seconds 15 --out out/my_hand
"""


def parser() -> argparse.ArgumentParser:
    """Return the command line's parser."""
    made = argparse.ArgumentParser(
        prog="capture", description=__doc__, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    made.add_argument("source", metavar="SOURCE", help="video, folder of images, or camera")
    made.add_argument("--out", type=Path, default=Path("out/capture"), metavar="DIR", help="(default: %(default)s)")
    made.add_argument("--rate", type=float, default=30.0, metavar="HZ", help="of images (default: %(default)s)")
    made.add_argument("--seconds", type=float, default=10.0, help="to film with a camera (default: %(default)s)")
    made.add_argument("--no-overlay", action="store_true", help="write no video")
    return made


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; 0 when a motion was found, 1 when a hand but no motion, 2 when the source cannot be used."""
    options = parser().parse_args(args)
    try:
        if not _is_camera(options.source) and not Path(options.source).exists():  # before MediaPipe is loaded
            raise DesignError(f"expected a film, a folder of images or camera, found nothing at {options.source}")
        with MediaPipeDetector() as detector:
            return capture(options, detector)
    except (DesignError, OSError) as error:
        print(f"capture: {error}", file=sys.stderr)
        return 2


def capture(options: argparse.Namespace, detector: HandDetector) -> int:
    """Do what the command does, with the given detector.

    Raises:
        DesignError: the source cannot be used.
    """
    if not all(math.isfinite(value) and value > 0.0 for value in (options.rate, options.seconds)):
        raise DesignError(f"expected a rate and a time above 0, found {options.rate} and {options.seconds}")
    with Progress(
        TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), console=Console(stderr=True), transient=True
    ) as progress:
        source = _source(options, progress)
        looking = progress.add_task("looking for the hand", total=source.count)
        recording = record(source, detector, lambda done: progress.update(looking, completed=done))
        motion = steady(recording)
        grasps = find_grasps(motion, recording.origin)
        options.out.mkdir(parents=True, exist_ok=True)
        files = _write(options.out, recording, motion, grasps)
        if not options.no_overlay:
            drawing = progress.add_task("drawing the overlay", total=len(recording.times))
            path = options.out / "overlay.mp4"
            write_overlay(
                source, recording, motion, grasps, path, lambda done: progress.update(drawing, completed=done)
            )
    _print(recording, grasps, files, options.out)
    return 0 if grasps else 1


def _is_camera(source: str) -> bool:
    return source == "camera" or source.startswith("camera:")


def _source(options: argparse.Namespace, progress: Progress) -> Source:
    text: str = options.source
    if _is_camera(text):
        number = text.partition(":")[2] or "0"
        if not number.isdigit():
            raise DesignError(f"expected camera or camera:<number>, found {text!r}")
        options.out.mkdir(parents=True, exist_ok=True)
        filming = progress.add_task("filming, Ctrl-C ends it", total=options.seconds)
        path = options.out / "camera.avi"
        return record_camera(int(number), options.seconds, path, lambda now: progress.update(filming, completed=now))
    path = Path(text)
    return Images(path, options.rate) if path.is_dir() else Video(path)


def _write(folder: Path, recording: Recording, motion: RecordedMotion, grasps: Sequence[DetectedGrasp]) -> list[Path]:
    for stale in folder.glob("motion_*.csv"):  # of an earlier capture: they would pass for motions of this one
        stale.unlink()
    files = [folder / f"motion_{number:02d}_{grasp.kind}.csv" for number, grasp in enumerate(grasps, start=1)]
    for path, grasp in zip(files, grasps, strict=True):
        grasp.trajectory.save(path)
    data = {
        **recording.origin,
        "frames": len(recording.times),
        "frames_with_hand": int(recording.seen.sum()),
        "motions": [{"file": path.name, **_plain(grasp)} for path, grasp in zip(files, grasps, strict=True)],
    }
    (folder / "motions.json").write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
    spans = [(grasp.start_s, grasp.end_s, f"{i} {grasp.kind}") for i, grasp in enumerate(grasps, start=1)]
    plots.draw_recording(motion.times, motion.angles, spans, recording.origin["source"], folder / "recording.png")
    return files


def _plain(grasp: DetectedGrasp) -> dict[str, object]:
    finger, gap = grasp.touching
    return {
        "kind": str(grasp.kind),
        "why": grasp.why,
        "start_s": grasp.start_s,
        "end_s": grasp.end_s,
        "curled": list(grasp.curled),
        "proximal_share": None if math.isnan(grasp.proximal_share) else grasp.proximal_share,
        "nearest_to_thumb": finger,
        "distance_palm_lengths": gap,
        "flexion_deg": {name: float(np.degrees(value)) for name, value in grasp.flexion_rad.items()},
    }


def _print(recording: Recording, grasps: Sequence[DetectedGrasp], files: Sequence[Path], folder: Path) -> None:
    seen, frames = int(recording.seen.sum()), len(recording.times)
    table = Table(title=f"{len(grasps)} motions; a hand in {seen} of {frames} frames", caption=f"written: {folder}")
    for heading in ("file", "time [s]", *LONG_FINGERS, "kind", "because"):
        table.add_column(escape(heading), justify="right" if heading in LONG_FINGERS else "left")
    for path, grasp in zip(files, grasps, strict=True):
        flexions = (f"{math.degrees(grasp.flexion_rad[finger]):.0f}" for finger in LONG_FINGERS)
        table.add_row(path.name, f"{grasp.start_s:.2f}-{grasp.end_s:.2f}", *flexions, str(grasp.kind), grasp.why)
    console = Console(width=None if sys.stdout.isatty() else 150)
    console.print(table)
    if not grasps:
        console.print("No motion from an open to a closed hand. Open it fully, close it, hold for half a second.")


if __name__ == "__main__":
    sys.exit(main())
