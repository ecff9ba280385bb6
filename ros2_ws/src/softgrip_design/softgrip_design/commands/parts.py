# SPDX-License-Identifier: Apache-2.0
"""parts: from a profile to files for CAD and for the printer."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from softgrip_description.errors import HandError
from softgrip_description.hand import Hand, load_hand, shipped_hand
from softgrip_design.errors import DesignError
from softgrip_design.parts.assembly import assembly_picture
from softgrip_design.parts.bill import PrintedRow, bill_text, bought_rows, printed_rows
from softgrip_design.parts.drawing import figure_of, write_svg
from softgrip_design.parts.drives import FACES, face_of
from softgrip_design.parts.files import write_part
from softgrip_design.parts.kit import Kit, fingers_of, whole_kit
from softgrip_design.parts.picture import write
from softgrip_design.parts.solid import Solid, make_solid
from softgrip_model.profile import Profile, ProfileError, load, shipped_directory

EPILOG = """\
Writes STEP (in the part's own frame), STL and 3MF (as it lies on the printer's bed; the 3MF carries material and print
settings) of every part, a drawing with dimensions (SVG) of every finger, and bill.md. Without --finger also palm, servo
plates, spools, guide blocks of the friction rig, camera stand, foot of the calibration target, and a picture of the
hand. Nothing is written when a part is not watertight or has walls thinner than the nozzle is wide. docs/parts.md shows
all of them.

Needs build123d: make parts-setup.

examples:
  parts power
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
    made.add_argument(
        "--spool-radius-mm", type=float, default=10.0, help="to the middle of the cable (default: %(default)s)"
    )
    models = [model for face in FACES for model in face.models]
    made.add_argument(
        "--servo", default=models[0], metavar="MODEL", help=f"in the bill: {', '.join(models)} (default: %(default)s)"
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
        kit = _kit(profile, hand, options)
        folder = options.out or Path("out/parts") / profile.id
        folder.mkdir(parents=True, exist_ok=True)
        solids = _write_parts(kit, folder)
        for name, finger in kit.fingers.items():
            write_svg(figure_of(finger), folder / f"finger_{name}.svg")
        printed = printed_rows(list(solids.values()))
        bought = bought_rows(kit, options.spool_radius_mm, face_of(options.servo))
        (folder / "bill.md").write_text(bill_text(profile.title, printed, bought), encoding="utf-8")
        if kit.others:
            write(assembly_picture(hand, solids), folder / "assembly.png")
    except (DesignError, HandError, ProfileError, OSError) as error:
        print(f"parts: {error}", file=sys.stderr)
        return 2
    _print_parts(printed, folder, time.perf_counter() - started)
    return 0


def _profile_path(name: str) -> Path:
    path = Path(name)
    return path if path.suffix or path.exists() else shipped_directory() / f"{name}.yaml"


def _kit(profile: Profile, hand: Hand, options: argparse.Namespace) -> Kit:
    if options.finger:
        slots = tuple(dict.fromkeys(options.finger))
        return Kit(profile, hand, fingers_of(profile, hand, slots, options.serial), ())
    return whole_kit(profile, hand, options.spool_radius_mm, options.serial)


def _write_parts(kit: Kit, folder: Path) -> dict[str, Solid]:
    """Make all parts before one is written: a refused one leaves no half a hand behind."""
    channels = {finger.form.name: finger.channels for finger in kit.fingers.values()}
    solids = {form.name: make_solid(form, channels.get(form.name, ())) for form in kit.forms}
    for solid in solids.values():
        write_part(solid, folder)
    return solids


def _print_parts(printed: Sequence[PrintedRow], folder: Path, seconds: float) -> None:
    count = len(printed)
    title = f"{count} part{'s' * (count > 1)} in {seconds:.1f} s"
    table = Table(title=title, caption=f"written: 3MF, STEP and STL of each, into {folder}")
    for heading in ("part", "count", "material", "cm3", "g", "filament [m]"):
        table.add_column(escape(heading), justify="left" if heading in {"part", "material"} else "right")
    for row in printed:
        table.add_row(row.title, str(row.count), row.material, f"{1e-3 * row.volume_mm3:.1f}", f"{row.mass_g:.1f}",
                      f"{row.filament_m:.2f}")  # fmt: skip
    Console(width=None if sys.stdout.isatty() else 130).print(table)


if __name__ == "__main__":
    sys.exit(main())
