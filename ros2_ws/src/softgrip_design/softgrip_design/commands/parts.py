# SPDX-License-Identifier: Apache-2.0
"""parts: from a profile to files for CAD and for the printer."""

from __future__ import annotations

import argparse
import difflib
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from softgrip_description.cell_file import load_cell
from softgrip_description.errors import CellFileError, HandError
from softgrip_description.hand import Hand, load_hand, shipped_hand
from softgrip_design.errors import DesignError
from softgrip_design.parts.assembly import assembly_picture
from softgrip_design.parts.bill import PrintedRow, bill_text, bought_rows, instead_rows, printed_rows
from softgrip_design.parts.drawing import figure_of, write_svg
from softgrip_design.parts.drives import FACES, ServoFace, face_of, horn_places_mm
from softgrip_design.parts.files import write_part
from softgrip_design.parts.forms import Form, PartError
from softgrip_design.parts.kit import Kit, fingers_of, whole_kit
from softgrip_design.parts.picture import write
from softgrip_design.parts.solid import Solid, make_solid
from softgrip_design.parts.views import views_of
from softgrip_model.profile import Profile, ProfileError, load, shipped_directory

#: of the driver's parameter spool_radii_m
SPOOL_RADIUS_MM = 10.0
#: folder of what other servos would take
OTHER_SERVOS = "other_servos"

EPILOG = """\
Writes STEP (in the part's own frame), STL and 3MF (as it lies on the printer's bed; the 3MF carries material and print
settings) and a drawing with dimensions (SVG) of every part, and bill.md. Without --finger also palm, servo
plate, spools, guide blocks of the friction rig, camera stand, foot of the calibration target, test cube, and a picture
of hand and servo plate. Plates and spools of other servos go into the folder other_servos. Nothing is written when a
part is not watertight or has walls thinner than the nozzle is wide. docs/parts.md shows all of them.

Needs build123d: make parts-setup.

examples:
  parts power
  parts power --servo XM430-W350
  parts power --cell-file cell.yaml
  parts out/design/hand_power.yaml --finger index --out out/index
"""


def parser() -> argparse.ArgumentParser:
    """Return the command line's parser."""
    made = argparse.ArgumentParser(
        prog="parts", description=__doc__, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    made.add_argument("profile", metavar="PROFILE", help="id of a shipped profile, or a profile file")
    made.add_argument("--finger", action="append", help="only this finger, again for more (default: hand and bench)")
    made.add_argument("--hand", type=Path, help="hand file (default: the shipped hand)")
    made.add_argument("--out", type=Path, metavar="FOLDER", help="(default: out/parts/<profile>)")
    made.add_argument("--cell-file", type=Path, metavar="FILE", help="cell.yaml that says servo and spool radius")
    made.add_argument(
        "--spool-radius-mm",
        type=float,
        help=f"to the middle of the cable (default: that of the cell file, else {SPOOL_RADIUS_MM:g})",
    )
    models = [model for face in FACES for model in face.models]
    made.add_argument(
        "--servo",
        metavar="MODEL",
        help=f"that pulls: {', '.join(models)} (default: that of the cell file, else {models[0]})",
    )
    made.add_argument("--serial", default="", help="engraved, before the slot's name (default: the profile's id)")
    return made


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; 0 when all parts were written, 2 for a request that cannot be met."""
    options = parser().parse_args(args)
    started = time.perf_counter()
    try:
        profile = load(_profile_path(options.profile))
        hand = load_hand(options.hand) if options.hand else shipped_hand()
        drive = _drive(options)
        kit = _kit(profile, hand, drive, options)
        folder = options.out or Path("out/parts") / profile.id
        solids, others = _write_parts(kit, folder)
        printed = printed_rows(list(solids.values()))
        bought = bought_rows(kit, drive.spool_radius_mm, drive.face, drive.model)
        instead = instead_rows(kit.instead, others)
        (folder / "bill.md").write_text(bill_text(profile.title, printed, bought, instead), encoding="utf-8")
        if kit.others:
            horns = horn_places_mm(drive.face, drive.spool_radius_mm, len(hand.slots))
            write(assembly_picture(hand, solids, horns, drive.face), folder / "assembly.png")
    except (CellFileError, DesignError, HandError, ProfileError, OSError) as error:
        print(f"parts: {error}", file=sys.stderr)
        return 2
    _print_parts(printed, folder, time.perf_counter() - started)
    return 0


def _profile_path(name: str) -> Path:
    path = Path(name)
    if path.suffix or path.exists():
        return path
    known = {one.stem: one for one in sorted(shipped_directory().glob("*.yaml"))}
    if name not in known:
        near = difflib.get_close_matches(name, known, 1)
        question = f"; did you mean '{near[0]}'?" if near else ""
        raise DesignError(
            f"profile: expected one of {', '.join(known)}, or a profile file (.yaml), found {name!r}{question}"
        )
    return known[name]


@dataclass(frozen=True)
class _Drive:
    """What pulls the cables: the servo, its front, and the radius of its spools."""

    model: str
    face: ServoFace
    spool_radius_mm: float


def _drive(options: argparse.Namespace) -> _Drive:
    """Return servo and spool: of the options, else of the cell file, else as shipped."""
    cell = load_cell(options.cell_file) if options.cell_file else None
    chain = cell.servos.chain if cell and cell.servos else ()
    models = [options.servo] if options.servo else [one.model for one in chain] or [FACES[0].models[0]]
    faces = list({face_of(model).name: face_of(model) for model in models}.values())
    if len(faces) > 1:
        raise PartError(
            f"{options.cell_file}: expected servos with one front, found {', '.join(models)}; make a plate for each: "
            "--servo MODEL"
        )
    radii = {one.spool_radius_m for one in chain} - {None}
    if len(radii) > 1 and options.spool_radius_mm is None:
        raise PartError(
            f"{options.cell_file}: expected spools of one radius, found {sorted(filter(None, radii))} m; make each: "
            "--spool-radius-mm"
        )
    given = options.spool_radius_mm
    radius_mm = next((1e3 * one for one in radii if one), SPOOL_RADIUS_MM) if given is None else given
    return _Drive(" or ".join(dict.fromkeys(models)), faces[0], radius_mm)


def _kit(profile: Profile, hand: Hand, drive: _Drive, options: argparse.Namespace) -> Kit:
    if options.finger:
        slots = tuple(dict.fromkeys(options.finger))
        return Kit(profile, hand, fingers_of(profile, hand, slots, options.serial), ())
    return whole_kit(profile, hand, drive.spool_radius_mm, options.serial, drive.face)


def _write_parts(kit: Kit, folder: Path) -> tuple[dict[str, Solid], dict[str, Solid]]:
    """Make all parts before one is written: a refused one leaves no half a hand behind.

    Returns:
        the parts, and those of other servos, by name of their form.
    """
    channels = {finger.form.name: finger.channels for finger in kit.fingers.values()}
    others = [form for one in kit.instead for form in one.forms]
    drawings = {finger.form.name: figure_of(finger) for finger in kit.fingers.values()}
    with Progress(
        TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), console=Console(stderr=True), transient=True
    ) as progress:
        task = progress.add_task("", total=2 * (len(kit.forms) + len(others)))

        def made(forms: Sequence[Form]) -> dict[str, Solid]:
            found = {}
            for form in forms:
                progress.update(task, description=f"making and checking {form.name}")
                found[form.name] = make_solid(form, channels.get(form.name, ()))
                progress.advance(task)
            return found

        solids, other_solids = made(kit.forms), made(others)
        for place, made_here in ((folder, solids), (folder / OTHER_SERVOS, other_solids)):
            if made_here:
                place.mkdir(parents=True, exist_ok=True)
            for name, solid in made_here.items():
                progress.update(task, description=f"writing {name}")
                write_part(solid, place)
                write_svg(drawings.get(name) or views_of(solid), place / f"{name}.svg")
                progress.advance(task)
    return solids, other_solids


def _print_parts(printed: Sequence[PrintedRow], folder: Path, seconds: float) -> None:
    count = len(printed)
    title = f"{count} part{'s' * (count > 1)} in {seconds:.1f} s"
    table = Table(title=title, caption=f"written: 3MF, STEP, STL and drawing of each, into {folder}")
    for heading in ("part", "count", "material", "cm3", "g", "filament [m]"):
        table.add_column(escape(heading), justify="left" if heading in {"part", "material"} else "right")
    for row in printed:
        table.add_row(row.title, str(row.count), row.material, f"{1e-3 * row.volume_mm3:.1f}", f"{row.mass_g:.1f}",
                      f"{row.filament_m:.2f}")  # fmt: skip
    Console(width=None if sys.stdout.isatty() else 130).print(table)


if __name__ == "__main__":
    sys.exit(main())
