# SPDX-License-Identifier: Apache-2.0
"""Writes docs/parts.md and its pictures: the parts of the power grasp, and what was chosen for them.

`render()` is the text; a test compares it with the committed file. The pictures need build123d (`make parts-setup`).
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from string import Template

from softgrip_description.hand import shipped_hand
from softgrip_design.commands.parts import SPOOL_RADIUS_MM
from softgrip_design.parts import bench, bill, drives, finger_form, foot, palm, printing, screws
from softgrip_design.parts.assembly import assembly_picture
from softgrip_design.parts.drawing import figure_of, write_svg
from softgrip_design.parts.kit import fingers_of
from softgrip_design.parts.palm import palm_forms
from softgrip_design.parts.picture import write
from softgrip_design.parts.solid import make_solid
from softgrip_design.parts.views import views_of
from softgrip_model.profile import load, shipped_directory

ROOT = Path(__file__).resolve().parents[2]
FIGURES = ROOT / "docs/figures"


def assumed_rows() -> list[tuple[str, str, str]]:
    """Return what was chosen: what, value, why."""
    f = finger_form
    channel = f"cable + {f.CABLE_PLAY_MM} mm each side, at least {2.0 * f.MIN_CHANNEL_RADIUS_MM:g} mm wide"
    marker = f"{f.MARKER_DIAMETER_MM:g} mm, one layer deep; base marker {f.BASE_MARKER_MM:g} mm behind joint 0"
    section = f"{2.0 * foot.HALF_WIDTH_MM:g} x {foot.Y_MM[1] - foot.Y_MM[0]:g} x {foot.LENGTH_MM:g} mm"
    shoulder = f"{foot.MIN_SHOULDER_MM:g} mm behind joint 0 or {foot.DEPTH_MM:g} mm below the palm's face"
    sheath = f"PTFE 2 x 3 mm, {foot.SHEATH_DEPTH_MM:g} mm deep in the foot; {bill.SHEATH_M} m long"
    pin = (
        "M3, its length slot by slot in bill.md; "
        f"hole {2.0 * foot.PIN_RADIUS_MM:g} mm, thread {palm.PIN_THREAD_MM:g} mm "
        f"in {2.0 * foot.PIN_TAP_RADIUS_MM:g} mm; its head is sunk by what a length of the standard is too short, "
        f"{palm.MAX_PIN_SINK_MM:g} mm at most"
    )
    board = f"M4 through a board of {screws.BOARD_MM:g} mm, with nuts"
    hole = (
        f"cable + {drives.KNOT_PLAY_MM} mm each side, at least {2.0 * printing.NOZZLE_MM:g} mm; recess of "
        f"{2.0 * drives.BEAD_SEAT_MM:g} mm"
    )
    bead = f"a crimp bead of {drives.BEAD_MM:g} mm before the knot"
    strands = 1.0 + 2.0 / math.sqrt(3.0)  # the least circle round three circles
    knot = (
        "no source gives a knot's width; any cut through one has three strands, which lie in a circle of "
        f"{strands:.2f} widths, narrower than the hole"
    )
    turns = f"{bill.TURNS:g} turns on it while the finger is straight"
    reel = f"groove {drives.GROOVE_MM:g} mm, rims {drives.RIM_HEIGHT_MM} mm; {turns}"
    block = f"contact radius {bench.SURFACE_RADIUS_MM:g} mm (section 3.2.1), {bench.BLOCK_WIDTH_MM:g} mm wide"
    return [
        ("channel", channel, "smaller ones print shut"),
        ("mouth of a channel", f"rounded by {f.MOUTH_MM} mm", "the cable bends around it"),
        ("slit below a strip", f"{f.SLIT_MM} mm", "prints open"),
        ("edge of a lip", f"at least {f.MIN_LIP_DEPTH_MM} mm deep", "prints open"),
        ("play between bent strip and lip", f"{f.STRIP_PLAY_MM} mm", "no contact before the flanks meet"),
        ("tip anchor", f"pocket {2.0 * f.ANCHOR_RADIUS_MM:g} x {f.ANCHOR_DEPTH_MM} mm", "a crimp bead of 2 mm"),
        ("marker seat", marker, "[vision](vision.md); a base that sits in the palm has none"),
        ("foot", section, "mortise and tenon (section 4.2.2), drawn nowhere"),
        ("shoulder of the foot", shoulder, "in front of it the first groove, behind it the palm"),
        ("key", f"V of {foot.KEY_DEPTH_MM} mm on the back of the foot", "one place a slot"),
        ("cross pin", pin, "one screw a swap; ISO 4762; thread formed in plastic: two to three diameters [1]"),
        ("screws to the bench", board, "parts stand on a board"),
        ("knot hole of a spool", hole, "threads 0.25 mm braid, prints open"),
        ("end of a cable on its spool", bead, knot),
        ("sheath", sheath, "servos stand beside the arm"),
        ("play of a foot", f"{printing.CLEARANCE_MM} mm each side", "usual for filament printers"),
        ("spool", reel, "radius as the driver's spool_radii_m; turns: [winding](build/winding.md)"),
        ("guide block", block, "the block's faces are the cable's tangents"),
    ]


def render() -> str:
    """Return the text of docs/parts.md."""
    strip = load(shipped_directory() / "power.yaml").finger("index")
    return Template(Path(__file__).with_name("parts.md.in").read_text(encoding="utf-8")).substitute(
        faces=", ".join(model for face in drives.FACES for model in face.models),
        cube=f"{bench.CUBE_MM:g}",
        cube_g=f"{bench.CUBE_G:g}",
        angles=f"{bench.WRAP_ANGLES_DEG[0]} to {bench.WRAP_ANGLES_DEG[-1]}",
        assumed="\n".join(f"| {' | '.join(row)} |" for row in assumed_rows()),
        weakened=f"{100.0 * printing.LAYER_MM / (1e3 * strip.width_m):.1f}",
        layer=printing.LAYER_MM,
        nozzle=printing.NOZZLE_MM,
        sources="\n".join(f"* {', '.join(face.models)}: {face.source}." for face in drives.FACES)
        + "\n* C.-D. Matte, *Toward Predictable Tendon Driven Soft Robots*, 2025: sections named above."
        + "\n* [1] B. Lincoln, K. Gomes, J. Braden, *Mechanical Fastening of Plastics*, chapter on fastening sites of "
        "self-threading screws, doi 10.1201/9780203747889-6 (its abstract was read).",
    )


def draw() -> None:
    """Write the pictures."""
    hand, profile = shipped_hand(), load(shipped_directory() / "power.yaml")
    cable_mm = 1e3 * profile.cable.radius_m
    fingers = fingers_of(profile, hand, profile.slots)
    write_svg(figure_of(fingers["index"]), FIGURES / "parts_index.svg")
    write_svg(views_of(make_solid(palm_forms(hand)[0])), FIGURES / "parts_palm.svg")
    solids = {finger.form.name: make_solid(finger.form, finger.channels) for finger in fingers.values()}
    face, count = drives.FACES[0], len(hand.slots)
    drive = [drives.servo_plate(face, SPOOL_RADIUS_MM, count), drives.spool(face, SPOOL_RADIUS_MM, cable_mm, count)]
    solids |= {form.name: make_solid(form) for form in (*palm_forms(hand), *drive)}
    horns = drives.horn_places_mm(face, SPOOL_RADIUS_MM, count)
    write(assembly_picture(hand, solids, horns), FIGURES / "parts_hand.png")


def main() -> int:
    """Write text and pictures."""
    (ROOT / "docs/parts.md").write_text(render(), encoding="utf-8")
    draw()
    return 0


if __name__ == "__main__":
    sys.exit(main())
