# SPDX-License-Identifier: Apache-2.0
"""Calibrate the cell's camera in three steps.

  1. target: write the board as a PDF; print it at 100 % and glue it to something flat.
       calibrate_camera target --out board.pdf
  2. lens: show the board to the camera from many sides (or take pictures or a video of it).
       calibrate_camera lens 0 --out camera.yaml --serial CAM-0042
  3. plane: lay the printed target into a finger's plane, its cross on the first joint, its x along the straight
     finger; once for each finger.
       calibrate_camera target --plane --columns 9 --rows 6 --square-mm 16 --out plane.pdf
       calibrate_camera plane 0 --calibration camera.yaml --finger index --columns 9 --rows 6 --square-mm 16

SOURCE is a device number or path, a video, a folder of pictures, or a URL. A set of views that is not good enough is
refused, and the message says which views to add.
"""

from __future__ import annotations

import argparse
import datetime as dt
import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from softgrip_vision import calibration
from softgrip_vision.calibrating import Board, BoardView, calibrate_lens, calibrate_plane, collect_views
from softgrip_vision.calibrating.target_pdf import PAGES, cross_origin, draw_target, write_target
from softgrip_vision.calibration import CameraCalibration, FingerPlane
from softgrip_vision.errors import VisionError
from softgrip_vision.sources import SourceOptions, open_source

console = Console()


def main(argv: Sequence[str] | None = None) -> None:
    """Run the command."""
    arguments = _parser().parse_args(argv)
    try:
        arguments.run(arguments)
    except (VisionError, OSError) as error:
        console.print(f"calibrate_camera: {error}", style="red", highlight=False)
        sys.exit(1)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="calibrate_camera", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    steps = parser.add_subparsers(required=True, metavar="STEP")

    target = steps.add_parser("target", help="write the printable board (PDF, true scale)")
    _add_board(target)
    target.add_argument("--out", type=Path, required=True, help="PDF to write")
    target.add_argument("--page", choices=sorted(PAGES), default="A4", help="paper, landscape (default A4)")
    target.add_argument("--plane", action="store_true", help="with the cross that goes on a finger's first joint")
    target.add_argument("--base-marker-mm", type=_length_mm, default=20.0, help="base marker behind first joint [mm]")
    target.set_defaults(run=_target)

    lens = steps.add_parser("lens", help="find the lens from views of the board")
    _add_source(lens, 600)
    _add_board(lens)
    lens.add_argument("--out", type=Path, required=True, help="calibration to write (YAML)")
    lens.add_argument("--serial", default="unknown", help="serial number of the camera, kept with the calibration")
    lens.add_argument("--name", default="camera", help="name of the camera")
    lens.set_defaults(run=_lens)

    plane = steps.add_parser("plane", help="find a finger's plane from the target laid into it")
    _add_source(plane, 30)
    _add_board(plane)
    plane.add_argument("--calibration", type=Path, required=True, help="with the lens; the plane is added to it")
    plane.add_argument("--finger", required=True, type=_name, help="finger that moves in this plane, e.g. index")
    plane.add_argument("--base-marker-mm", type=_length_mm, default=20.0, help="base marker behind first joint [mm]")
    plane.add_argument("--marker-diameter-mm", type=_diameter_mm, default=5.0, help="diameter of the markers [mm]")
    plane.add_argument(
        "--origin-mm",
        type=float,
        nargs=2,
        metavar=("X", "Y"),
        help="first joint from the board's top left corner, y down [mm] (default: the printed cross)",
    )
    plane.set_defaults(run=_plane)
    return parser


def _length_mm(text: str) -> float:
    return _between(text, 1000.0, "mm")


def _diameter_mm(text: str) -> float:
    return _between(text, 100.0, "mm")


def _between(text: str, largest: float, unit: str) -> float:
    """Return a number that a calibration may hold (calibration.load refuses others)."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < largest:
        raise argparse.ArgumentTypeError(f"expected more than 0 and less than {largest:g} {unit}, found '{text}'")
    return value


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number of 1 or more, found '{text}'")
    return int(text)


def _name(text: str) -> str:
    if not text.strip():
        raise argparse.ArgumentTypeError("expected the name of a finger, found ''")
    return text


def _add_source(parser: argparse.ArgumentParser, frames: int) -> None:
    parser.add_argument("source", metavar="SOURCE", help="device, video, folder or URL")
    parser.add_argument(
        "--frames", type=_count, default=frames, help=f"look at no more frames than this (default {frames})"
    )
    parser.add_argument("--size", type=int, nargs=2, metavar=("W", "H"), default=(0, 0), help="asked of a device [px]")


def _add_board(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--columns", type=int, default=11, help="squares across (default 11)")
    parser.add_argument("--rows", type=int, default=7, help="squares down (default 7)")
    parser.add_argument("--square-mm", type=float, default=24.0, help="side of a square as measured on paper [mm] (24)")
    parser.add_argument("--chessboard", action="store_true", help="a chessboard without markers instead of ChArUco")


def _board(arguments: argparse.Namespace) -> Board:
    return Board(arguments.columns, arguments.rows, arguments.square_mm * 1e-3, charuco=not arguments.chessboard)


def _views(arguments: argparse.Namespace, board: Board, what: str) -> list[BoardView]:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[kept]}"))
    source = open_source(arguments.source, SourceOptions(*arguments.size))
    total = min(arguments.frames, getattr(source, "frame_count", 0) or arguments.frames)
    try:
        with Progress(*columns, console=console) as progress:
            task = progress.add_task(what, total=total, kept="")
            return collect_views(
                source,
                board,
                max_frames=arguments.frames,
                progress=lambda read, kept: progress.update(task, completed=read, kept=f"{kept} views kept"),
            )
    finally:
        source.close()


def _make_room(path: Path) -> None:
    """Make the folder of a file before the work begins whose result goes there."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        raise VisionError(f"{path}: expected a file in a folder, found that {path.parent} is a file") from error
    if path.is_dir():
        raise VisionError(f"{path}: expected the name of a file to write, found a folder")


def _target(arguments: argparse.Namespace) -> None:
    _make_room(arguments.out)
    board = _board(arguments)
    figure = draw_target(
        board, arguments.page, base_marker_m=arguments.base_marker_mm * 1e-3 if arguments.plane else None
    )
    write_target(figure, arguments.out)
    console.print(f"{arguments.out}: print at 100 % (no 'fit to page') and check the line under the board with a ruler")


def _lens(arguments: argparse.Namespace) -> None:
    _make_room(arguments.out)
    views = _views(arguments, _board(arguments), "looking for the board")
    fit = calibrate_lens(views, arguments.name)
    result = CameraCalibration(fit.lens, (), _now(), arguments.serial, fit.rms_px, len(views))
    calibration.save(result, arguments.out)
    focal = fit.lens.matrix[(0, 1), (0, 1)]
    console.print(
        f"{arguments.out}: {len(views)} views, reprojection error {fit.rms_px:.3f} px, focal length "
        f"{focal[0]:.1f} x {focal[1]:.1f} px (+- {np.max(fit.focal_stddev / focal):.2%}). Next: calibrate_camera plane"
    )


def _plane(arguments: argparse.Namespace) -> None:
    known = calibration.load(arguments.calibration)
    board = _board(arguments)
    origin = tuple(value * 1e-3 for value in arguments.origin_mm) if arguments.origin_mm else cross_origin(board)
    views = _views(arguments, board, "looking for the target")
    fit = calibrate_plane(views, known.lens, (origin[0], origin[1]))
    plane = FingerPlane(
        arguments.finger,
        fit.homography,
        arguments.base_marker_mm * 1e-3,
        arguments.marker_diameter_mm * 1e-3,
        fit.rms_px,
    )
    others = tuple(other for other in known.planes if other.finger != arguments.finger)
    calibration.save(replace(known, planes=(*others, plane), date=_now()), arguments.calibration)
    console.print(
        f"{arguments.calibration}: plane of '{arguments.finger}' from {fit.corners} corners, reprojection error "
        f"{fit.rms_px:.3f} px"
    )


def _now() -> str:
    return dt.datetime.now(dt.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


if __name__ == "__main__":
    main()
