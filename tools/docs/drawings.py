# SPDX-License-Identifier: Apache-2.0
"""Draws pictures of lines, boxes and words as SVG: those of docs/build, the driver's cycle, the emulated cell's wires.

Dimensions and rates come from the code.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from html import escape
from itertools import pairwise
from pathlib import Path

import numpy as np

from softgrip_description.hand import shipped_hand
from softgrip_design.parts import bench, bill, drives, finger_form, foot, palm, screws
from softgrip_design.parts.assembly import smooth
from softgrip_design.parts.forms import Form, Prism
from softgrip_driver.dynamixel.registers import MODELS
from softgrip_driver.nodes.tendon_parameters import PARAMETERS
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.wizard.wizard import WizardSettings
from softgrip_model.profile import load, shipped_directory

FIGURES = Path(__file__).resolve().parents[2] / "docs/figures"
INK, GREEN, RUST, SOFT, PAPER = "#22312b", "#0b6e4f", "#b2432c", "#5d6d66", "#ffffff"
#: a servo whose stall sizes the supply
SERVO, SERVOS = MODELS["XL330-M288"], 3


class Drawing:
    """A picture in lines, boxes and words.

    Args:
        width, height: [px].
        title: for who does not see it.
    """

    def __init__(self, width: int, height: int, title: str) -> None:
        self._size, self._title, self._parts = (width, height), title, list[str]()

    def box(self, x: float, y: float, width: float, height: float, text: str, colour: str = INK) -> None:
        """Draw a box with lines of text in it; the first one is bold."""
        self._parts.append(
            f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="6" fill="{PAPER}" stroke="{colour}"/>'
        )
        lines = text.split("\n")
        top = y + height / 2 - 8.5 * (len(lines) - 1) + 5
        for number, line in enumerate(lines):
            self.text(x + width / 2, top + 17 * number, line, colour, "middle", bold=number == 0)

    def text(
        self, x: float, y: float, text: str, colour: str = INK, anchor: str = "start", *, bold: bool = False
    ) -> None:
        """Write a line."""
        weight = ' font-weight="bold"' if bold else ""
        self._parts.append(
            f'<text x="{x:g}" y="{y:g}" fill="{colour}" text-anchor="{anchor}"{weight}>{escape(text)}</text>'
        )

    def line(self, *points: tuple[float, float], colour: str = INK, width: float = 1.5, arrow: bool = False) -> None:
        """Draw a line through points, with an arrow at its end where asked for."""
        path = " ".join(f"{x:g},{y:g}" for x, y in points)
        head = (
            f' marker-end="url(#{"rust" if colour == RUST else "green" if colour == GREEN else "ink"})"'
            if arrow
            else ""
        )
        self._parts.append(f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="{width:g}"{head}/>')

    def circle(self, x: float, y: float, radius: float, colour: str = INK, fill: str = "none") -> None:
        """Draw a circle."""
        self._parts.append(
            f'<circle cx="{x:g}" cy="{y:g}" r="{radius:g}" fill="{fill}" stroke="{colour}" stroke-width="1.5"/>'
        )

    def rectangle(self, x: float, y: float, width: float, height: float, fill: str, colour: str = INK) -> None:
        """Draw a rectangle with sharp corners."""
        self._parts.append(
            f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" fill="{fill}" stroke="{colour}"/>'
        )

    def polygon(self, points: Sequence[tuple[float, float]], fill: str) -> None:
        """Draw a polygon."""
        path = " ".join(f"{x:g},{y:g}" for x, y in points)
        self._parts.append(f'<polygon points="{path}" fill="{fill}" stroke="{INK}"/>')

    def svg(self) -> str:
        """Return the picture."""
        width, height = self._size
        heads = "".join(
            f'<marker id="{name}" markerWidth="9" markerHeight="8" refX="8" refY="4" orient="auto">'
            f'<path d="M0,0 L9,4 L0,8 z" fill="{colour}"/></marker>'
            for name, colour in (("ink", INK), ("green", GREEN), ("rust", RUST))
        )
        body = "\n".join(self._parts)
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
            f'role="img" font-family="DejaVu Sans, sans-serif" font-size="13">\n<title>{escape(self._title)}</title>\n'
            f'<defs>{heads}</defs>\n<rect width="{width}" height="{height}" fill="{PAPER}"/>\n{body}\n</svg>\n'
        )


def wiring() -> str:
    """Return how the servos are fed, fused and stopped."""
    volts, amperes = SERVO.rated_voltage, SERVOS * SERVO.stall_current
    slots = tuple(shipped_hand().slots)
    drawing = Drawing(
        960, 300, "Wiring: supply, fuse, emergency stop, power hub, servos; the adapter carries data only"
    )
    drawing.box(20, 40, 150, 70, f"supply\n{volts:g} V, above {amperes:.1f} A")
    drawing.box(210, 40, 110, 70, f"fuse\n{math.ceil(amperes):g} A", RUST)
    drawing.box(360, 40, 150, 70, "emergency stop\nlatching, opens +", RUST)
    drawing.box(560, 40, 130, 70, "power hub\nfeeds the bus")
    for left, right in ((170, 210), (320, 360), (510, 560)):
        drawing.line((left, 62), (right, 62), colour=RUST, width=2.5)
    drawing.line((95, 110), (95, 150), (625, 150), (625, 110), width=2.5)
    drawing.text(330, 143, "- straight through")
    for number in range(SERVOS):
        x = 560 + 132 * number
        drawing.box(x, 210, 120, 60, f"servo of {slots[number]}\ngets ID {number + 1}")
        if number:
            drawing.line((x - 12, 240), (x, 240), colour=GREEN, width=2.5)
    drawing.line((600, 110), (600, 210), colour=GREEN, width=2.5)
    drawing.text(610, 185, "one cable from servo to servo", GREEN)
    drawing.box(360, 205, 150, 70, "adapter (U2D2)\nfeeds no servo")
    drawing.line((510, 240), (535, 240), (535, 95), (560, 95), colour=GREEN)
    drawing.text(415, 190, "data and ground", GREEN)
    drawing.box(160, 205, 130, 70, "computer\nUSB")
    drawing.line((290, 240), (360, 240), colour=GREEN)
    return drawing.svg()


def spool() -> str:
    """Return how a tendon is wound on a spool: seen from outside, and cut along its axis."""
    limits, face = TendonLimits(), drives.FACES[0]
    cable_mm = 1e3 * load(shipped_directory() / "power.yaml").cable.radius_m
    radius_mm = 1e3 * WizardSettings(Path()).spool_radius_m
    form = drives.spool(face, radius_mm, cable_mm, SERVOS)
    boss, *screws, hole, seat = form.bores
    rim_mm, floor_mm, scale = radius_mm + drives.RIM_HEIGHT_MM, radius_mm - cable_mm, 8.0
    title = "Spool, from outside and cut: the tendon comes off on one side; knot hole in the outer rim"
    drawing = Drawing(880, 430, title)
    x, y = 190.0, 190.0
    drawing.circle(x, y, scale * rim_mm, INK, "#eef2f0")
    drawing.circle(x, y, scale * floor_mm, SOFT)
    drawing.circle(x, y, scale * boss.radius_mm, INK, PAPER)
    for bore in screws:
        drawing.circle(x + scale * bore.start[0], y - scale * bore.start[1], scale * bore.radius_mm, INK, PAPER)
    at = (x + scale * hole.start[0], y - scale * hole.start[1])
    drawing.circle(*at, scale * seat.radius_mm, RUST, PAPER)
    drawing.circle(*at, scale * hole.radius_mm, RUST, RUST)
    drawing.line((at[0] + 8, at[1] - 10), (300, 66), colour=RUST)
    drawing.text(304, 62, f"knot hole {2.0 * hole.radius_mm:g} mm in the outer rim,", RUST)
    drawing.text(304, 79, f"round it a recess of {2.0 * seat.radius_mm:g} mm", RUST)
    angle = math.radians(-68.0)
    end = (x + scale * radius_mm * math.cos(angle), y - scale * radius_mm * math.sin(angle))
    drawing.line((x, y), end, colour=SOFT, arrow=True)
    drawing.text(x + 44, y + 112, f"spool_radius_m: {1e-3 * radius_mm:.3f},", SOFT)
    drawing.text(x + 44, y + 129, "to the middle of the tendon", SOFT)
    left = x - scale * radius_mm
    drawing.line((left, y), (left, 22), colour=GREEN, width=2.5, arrow=True)
    drawing.text(left - 8, 18, "to the ridge of the plate", GREEN)
    arc = [(x + 66 * math.cos(a / 20), y - 66 * math.sin(a / 20)) for a in range(52, 80)]
    drawing.line(*arc, colour=RUST, width=2, arrow=True)
    drawing.text(x - 16, y + 50, "pulls", RUST, "end")
    drawing.text(x, 350, "seen from outside, ridge of the plate above", SOFT, "middle")
    drawing.text(620, 350, "cut along its axis", SOFT, "middle")
    _spool_cut(drawing, form, (620.0, 250.0))
    turns = f"{bill.TURNS:g} turns while the finger is straight, side by side in the groove of {drives.GROOVE_MM:g} mm"
    drawing.text(20, 378, turns)
    travel = f"homing lets out {1e3 * limits.slack_travel:g} mm and winds in {1e3 * limits.homing_travel:g} mm at most"
    drawing.text(20, 398, travel)
    drawing.text(20, 418, "direction is 1 where the servo counts up as it pulls, else -1: the wizard finds it")
    return drawing.svg()


def _spool_cut(drawing: Drawing, form: Form, at: tuple[float, float]) -> None:
    """Draw a spool cut along its axis and through the knot hole, the servo below it."""
    scale = 10.0
    x, y = at
    neck, inner, floor, outer = form.bodies
    hole, seat = form.bores[-2:]
    top = outer.end_mm

    def half(prism: Prism) -> float:
        return max(corner.x_mm for corner in prism.outline)

    def band(prism: Prism, low: float, high: float) -> None:
        wide = half(prism)
        drawing.rectangle(x - scale * wide, y - scale * high, 2.0 * scale * wide, scale * (high - low), "#eef2f0")

    band(neck, 0.0, inner.start_mm)
    band(inner, inner.start_mm, inner.end_mm)
    band(floor, inner.end_mm, outer.start_mm)
    band(outer, outer.start_mm, top)
    place = math.hypot(*hole.start[:2])
    for bore, low in ((hole, outer.start_mm), (seat, seat.start[2])):
        drawing.rectangle(
            x + scale * (place - bore.radius_mm), y - scale * top, 2.0 * scale * bore.radius_mm, scale * (top - low),
            PAPER, RUST,
        )  # fmt: skip
    beads = x + scale * place
    bead = y - scale * (seat.start[2] + 0.5 * drives.BEAD_MM)
    groove = y - scale * (inner.end_mm + 2.0)
    drawing.line((beads - 3, groove), (beads, y - scale * outer.start_mm), (beads, bead - 34), colour=GREEN, width=2.5)
    drawing.circle(beads, bead, 0.5 * scale * drives.BEAD_MM, INK, "#cfd8d3")
    drawing.circle(beads, bead - 17, 6, GREEN, GREEN)
    drawing.text(beads + 16, bead - 18, "knot", GREEN)
    drawing.text(beads + 16, bead + 3, f"bead {drives.BEAD_MM:g} mm", INK)
    for turn in range(int(bill.TURNS)):
        for side in (-1.0, 1.0):
            drawing.circle(
                x + side * (scale * half(floor) + 2.5), y - scale * inner.end_mm - 8 - 6 * turn, 2.5, GREEN, GREEN
            )
    drawing.text(x, y - scale * 0.5 * (inner.end_mm + outer.start_mm) + 5, f"groove {drives.GROOVE_MM:g} mm", INK,
                 "middle")  # fmt: skip
    drawing.rectangle(x - scale * half(neck), y, 2.0 * scale * half(neck), 22, PAPER)
    drawing.text(x, y + 15, "horn of the servo", SOFT, "middle")
    drawing.line((x - scale * half(neck) - 22, y - 6), (x - scale * half(neck), y - 6), colour=SOFT, arrow=True)
    drawing.text(x - scale * half(neck) - 26, y - 2, f"collar {2.0 * half(neck):g} mm", SOFT, "end")
    drawing.text(x - scale * half(inner) - 8, y - scale * top + 12, "outer rim", SOFT, "end")


#: From the middle of a figure-eight knot to its end: x, y on the page, z towards the eye; the other half is this one
#: turned about the middle with z reversed. Four crossings, over and under by turns: only this knot has them (4_1 of
#: Rolfsen's table).
HALF_KNOT = (
    (0.0, 0.0, 0.0), (-1.5, 0.9, -1.0), (-2.9, 1.3, 0.0), (-3.4, 0.2, 0.0), (-2.6, -0.9, 1.0), (-1.3, -2.1, 0.0),
    (0.2, -2.2, 0.0), (1.5, -0.9, -1.0), (2.6, 0.9, 1.0), (4.0, 2.8, 0.0),
)  # fmt: skip


def figure_eight(between: int) -> list[tuple[float, float, float]]:
    """Return a figure-eight knot in an open strand, from end to end; its ends leave on opposite sides.

    Args:
        between: points from one of its knots to the next (Catmull-Rom).
    """
    half = np.array(HALF_KNOT)
    knots = np.concatenate([-half[:0:-1], half])
    return [(x, y, z) for x, y, z in smooth([knots[0], *knots, knots[-1]], between).tolist()]


def strand(
    drawing: Drawing, at: tuple[float, float], share: float, scale: float, width: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Draw a share of the knot, from its beginning; return where it begins and ends.

    Args:
        drawing: to draw on.
        at: its middle.
        share: of its points.
        scale: [px] of a unit.
        width: of the strand [px].
    """
    whole = [(at[0] + scale * x, at[1] - scale * y, z) for x, y, z in figure_eight(40)]
    line = whole[: max(2, round(share * len(whole)))]
    # the farther pieces first: what is drawn later lies above, with a margin of paper
    pieces = [line[k : k + 12] for k in range(0, len(line) - 1, 10)]
    for piece in sorted(pieces, key=lambda one: one[len(one) // 2][2]):
        points = [(x, y) for x, y, _ in piece]
        if piece[len(piece) // 2][2] > 0.3 and len(points) > 4:
            drawing.line(*points[1:-2], colour=PAPER, width=width + 6.0)
        drawing.line(*points, colour=GREEN, width=width)
    return line[0][:2], line[-1][:2]


def knot() -> str:
    """Return the stopper knot as it is tied, in four pictures."""
    drawing = Drawing(940, 290, "Figure-eight stopper knot, tied in four steps; its crossings are numbered")
    #: how much of the strand is drawn, number of the new crossings with their places, what is done
    steps = (
        (12.5, ((1, -1.5, 0.9),), "1. make a loop: the end", "goes behind the tendon (1)"),
        (15.0, ((2, -2.6, -0.9),), "2. lead it round, before", "the tendon (2)"),
        (18.0, ((3, 1.5, -0.9), (4, 2.6, 0.9)), "3. through the loop: behind", "one side (3), before the other (4)"),
    )
    for number, (last, crossings, *texts) in enumerate(steps):
        at, scale = (120.0 + 236.0 * number, 110.0), 24.0
        _, end = strand(drawing, at, last / 18.0, scale, 5.0)
        drawing.circle(*end, 5, RUST, RUST)
        for name, x, y in crossings:
            dx, dy = (-4, -14) if y > 0 else (4, 24)
            drawing.text(at[0] + scale * x + dx, at[1] - scale * y + dy, f"{name}", RUST, "middle", bold=True)
        for row, text in enumerate(texts):
            drawing.text(at[0], 216 + 18 * row, text, INK, "middle")
    at = (830.0, 110.0)
    begin, end = strand(drawing, at, 1.0, 8.5, 9.0)
    drawing.line((at[0] - 95, begin[1] + 6), begin, colour=GREEN, width=9)
    drawing.line(end, (at[0] + 70, end[1] - 6), colour=GREEN, width=9)
    drawing.circle(at[0] + 70, end[1] - 6, 6, RUST, RUST)
    drawing.text(at[0], 216, "4. pull at both ends: it sits", INK, "middle")
    drawing.text(at[0], 234, "close behind the bead", INK, "middle")
    drawing.text(20, 274, "green: from the spool's groove, through knot hole and bead", GREEN)
    drawing.text(920, 274, "red: the end; leave 5 mm of it", RUST, "end")
    return drawing.svg()


def assembly() -> str:
    """Return what is screwed to what, in five steps."""
    face, hand = drives.FACES[0], shipped_hand()
    pins = ", ".join(f"{name}: {palm.pin_screw(hand, name).name.split(',')[0]}" for name in hand.slots)
    (plate_screw, plates), (spool_screw, spools) = face.screws
    plate_screw, spool_screw = plate_screw.removesuffix(", plate"), spool_screw.removesuffix(", spool")
    to_board = screws.board_screw(drives.PLATE_MM, "").name
    to_palm, to_arm = (f"{number} {screw}" for screw, number in _taken(palm.palm_forms(hand)[1]))
    drawing = Drawing(900, 470, "Put together: servo, spool, servo plate on the board, palm on the arm, finger, sheath")
    # servo plate from the side, the ridge on the left
    drawing.rectangle(470, 250, 330, 14, "#cfd8d3")
    drawing.rectangle(470, 205, 34, 45, "#cfd8d3")
    drawing.text(806, 258, "servo plate", INK)
    drawing.rectangle(560, 264, 130, 74, "#e7ece9")
    drawing.text(625, 306, "servo", INK, "middle")
    drawing.rectangle(600, 252, 50, 10, PAPER)
    drawing.rectangle(600, 246, 50, 6, "#eef2f0")
    drawing.rectangle(586, 238, 78, 8, "#eef2f0")
    drawing.rectangle(594, 212, 62, 26, "#eef2f0")
    drawing.rectangle(586, 204, 78, 8, "#eef2f0")
    drawing.text(674, 226, "spool", INK)
    drawing.rectangle(440, 264, 112, 22, "#efe6d8")
    drawing.rectangle(698, 264, 122, 22, "#efe6d8")
    drawing.text(826, 281, "board", INK)
    drawing.line((450, 225), (594, 225), colour=GREEN, width=2.5)
    # palm from the side, the arm below
    drawing.rectangle(60, 180, 220, 80, "#cfd8d3")
    drawing.text(82, 226, "palm", INK)
    drawing.rectangle(60, 300, 220, 14, "#cfd8d3")
    drawing.rectangle(60, 260, 12, 40, "#cfd8d3")
    drawing.rectangle(268, 260, 12, 40, "#cfd8d3")
    drawing.rectangle(110, 314, 120, 34, "#e7ece9")
    drawing.text(170, 366, "arm's flange", INK, "middle")
    drawing.polygon(
        ((190, 262), (222, 262), (222, 176), (236, 176), (236, 60), (182, 60), (182, 176), (190, 176)), "#f3d3a5"
    )
    drawing.text(246, 76, "finger", INK)
    drawing.circle(206, 226, 6, RUST, PAPER)
    drawing.line((206, 250), (206, 282), (300, 282), (380, 225), (487, 225), colour=GREEN, width=6)
    drawing.text(330, 215, "sheath", GREEN)
    # screws
    drawing.line((572, 238), (572, 290), colour=RUST, width=3)
    drawing.line((612, 190), (612, 256), colour=RUST, width=3)
    drawing.line((520, 236), (520, 306), colour=RUST, width=3)
    drawing.line((730, 236), (730, 306), colour=RUST, width=3)
    drawing.line((76, 322), (76, 250), colour=RUST, width=3)
    drawing.line((264, 322), (264, 250), colour=RUST, width=3)
    drawing.line((130, 294), (130, 338), colour=RUST, width=3)
    drawing.line((210, 294), (210, 338), colour=RUST, width=3)
    for x, y, name in (
        (572, 310, "1"), (600, 180, "2"), (520, 326, "3"), (76, 340, "3"), (244, 340, "3"), (206, 246, "4"),
        (420, 208, "5"),
    ):  # fmt: skip
        drawing.circle(x, y - 5, 10, RUST, PAPER)
        drawing.text(x, y, name, RUST, "middle", bold=True)
    lines = (
        f"1: {plates} {plate_screw} a servo;  2: {spools} {spool_screw} a spool",
        f"3: servo plate to the board 4 {to_board}; palm's plate to the arm {to_arm}, to the palm {to_palm}",
        f"4: cross pins, {pins};  5: sheath {foot.SHEATH_DEPTH_MM:g} mm into foot and ridge",
    )
    for number, text in enumerate(lines):
        drawing.text(20, 416 + 19 * number, text.replace(", ISO 4762", ""))
    return drawing.svg()


def _taken(form: Form) -> list[tuple[str, int]]:
    """Return a part's screws and how many of each, in the order of its holes."""
    names = [bore.screw.name for bore in form.bores if bore.screw]
    return [(name, names.count(name)) for name in dict.fromkeys(names)]


def camera() -> str:
    """Return where the camera and the markers are."""
    design = load(shipped_directory() / "power.yaml").finger("index")
    drawing = Drawing(
        820, 330, "Camera beside the finger, looking along its joints' axes; green markers on base, joints and tip"
    )
    scale, x0, y0 = 3600.0, 190.0, 110.0
    base_mm = finger_form.BASE_MARKER_MM
    places = [-base_mm * 1e-3, 0.0]
    for length in design.link_lengths_m:
        places.append(places[-1] + length)
    drawing.box(30, y0 - 60, 110, 120, "palm")
    drawing.line((140, y0), (x0 + scale * places[-1] + 25, y0), colour="#cfd8d3", width=34)
    names = ("base", *(f"joint_{j}" for j in range(design.joints)), "tip")
    for name, place in zip(names, places, strict=True):
        drawing.circle(x0 + scale * place, y0, 9, GREEN, GREEN)
        drawing.text(x0 + scale * place, y0 - 26, name, GREEN, "middle")
    for a, b in pairwise(places[1:]):
        drawing.text(x0 + scale * (a + b) / 2, y0 + 36, f"{1e3 * (b - a):.1f} mm", SOFT, "middle")
    drawing.text(x0 + scale * places[0] - 5, y0 + 54, f"{base_mm:g} mm behind joint_0", SOFT, "middle")
    drawing.text(
        30, 205, f"markers: green discs of {finger_form.MARKER_DIAMETER_MM:g} mm, on the side that the camera sees"
    )
    drawing.text(
        30,
        228,
        "camera: square to this plane, the whole closing in sight, light from its side, focus and exposure fixed",
    )
    drawing.text(30, 251, "calibrate_camera lens, then plane: the board lies in this plane, its cross on joint_0")
    slots = ", ".join(shipped_hand().slots)
    drawing.text(30, 274, f"one plane for each finger that is watched (slots: {slots})")
    return drawing.svg()


def rig() -> str:
    """Return the friction rig from the side."""
    drawing = Drawing(820, 330, "Friction rig: stage, gauge, cable over the guide block, hung weight")
    drawing.box(20, 110, 120, 60, "stage\npulls")
    drawing.box(180, 110, 130, 60, "gauge (T1)\nin the cable")
    drawing.line((140, 140), (180, 140), width=2.5)
    x, y, radius = 520.0, 190.0, 50.0
    drawing.circle(x, y, radius, INK, "#e7ece9")
    drawing.text(x, y + 4, "guide block", INK, "middle")
    drawing.line((310, 140), (x, 140), colour=GREEN, width=2.5)
    angle = math.radians(60.0)
    arc = [(x + radius * math.sin(a), y - radius * math.cos(a)) for a in (angle * i / 12 for i in range(13))]
    drawing.line(*arc, colour=GREEN, width=2.5)
    end = (arc[-1][0] + 75 * math.cos(angle), arc[-1][1] + 75 * math.sin(angle))
    drawing.line(arc[-1], end, colour=GREEN, width=2.5)
    drawing.circle(end[0] - 10, end[1] + 8, 12, SOFT)
    drawing.text(end[0] + 12, end[1] + 6, "guide pulley", SOFT)
    drawing.line((end[0] + 2, end[1] + 8), (end[0] + 2, 285), colour=GREEN, width=2.5)
    drawing.box(end[0] - 48, 280, 100, 36, "weight (T2)")
    radius_mm = bench.SURFACE_RADIUS_MM
    drawing.text(590, 130, "wrap angle", RUST)
    drawing.line((x, 140), (x + 70, 140), colour=RUST)
    drawing.line((x + 46, 140), (x + 40, 158), (x + 30, 170), colour=RUST, arrow=True)
    drawing.text(20, 215, f"block: radius {radius_mm:g} mm, printed as the finger is,")
    drawing.text(20, 233, "one for each angle (`parts` makes them)")
    drawing.text(20, 263, "weights 0.2, 0.6 and 1.0 kg at three angles: nine points")
    drawing.text(20, 281, "stage positive = pulls; gauge positive = pulled")
    return drawing.svg()


def driver_cycle() -> str:
    """Return what tendon_driver does in one cycle of its bus, and who talks to it from which thread."""
    drawing = Drawing(860, 380, "One cycle of the tendon driver: read, believe, guard, move, write; orders and stops")
    steps = (
        "read\none group read\nof all servos",
        "believe\nlate, jumped,\nrebooted?",
        "guards\nbroken, slack,\njammed, too hot",
        "motion\nsetpoint, trim,\ntension limit",
        "write\none group write\nof all goals",
    )
    width, left, top = 132, 20, 150
    for number, text in enumerate(steps):
        x = left + 172 * number
        drawing.box(x, top, width, 78, text, GREEN)
        if number:
            drawing.line((x - 40, top + 39), (x, top + 39), colour=GREEN, arrow=True)
    end = left + 172 * (len(steps) - 1) + width / 2
    drawing.line(
        (end, top + 78), (end, 262), (left + width / 2, 262), (left + width / 2, top + 78), colour=GREEN, arrow=True
    )
    rates = {parameter.name: parameter.default for parameter in PARAMETERS.rows}
    at_rest = max(rates["rest_rate"], 2.0 / rates["bus_watchdog_s"])
    text = f"bus thread: {rates['loop_rate']:g} cycles a second, {at_rest:g} at rest"
    drawing.text(430, 282, text, GREEN, "middle")
    drawing.box(left + 172 * 1, 20, 304, 60, "executor\nservices, actions, streams")
    drawing.line((left + 172 * 2 + 66, 80), (left + 172 * 3 + 40, top), arrow=True)
    drawing.text(left + 172 * 3 - 30, 104, "orders, each with a deadline")
    drawing.box(left + 172 * 3 + 30, 20, 262, 60, "emergency stop\nsession, queue, thread of its own", RUST)
    drawing.line((end, 80), (end, top), colour=RUST, arrow=True)
    drawing.text(end + 8, 128, "torque off", RUST)
    drawing.box(left, 312, 304, 50, "safety file\nread before the port is opened", RUST)
    drawing.line((left + 30, 312), (left + 30, top + 78), colour=RUST, arrow=True)
    drawing.text(344, 342, "tendon/state every cycle, tendon/status ten times a second, faults by name")
    return drawing.svg()


def emulator_wires() -> str:
    """Return what is inside the emulated cell, and by which wires the suite's nodes meet it."""
    drawing = Drawing(860, 360, "The emulated cell: one plant behind pseudo-terminals, a camera stream and a clock")
    drawing.box(20, 30, 250, 70, "plant\nbeams, cables, friction, products")
    drawing.box(20, 130, 250, 60, "servos\nmotor, gears, firmware, registers")
    drawing.box(20, 220, 250, 50, "friction rig\nstand, gauge, weights")
    drawing.box(20, 290, 250, 50, "camera\npictures of fingers and markers")
    drawing.line((145, 100), (145, 130))
    rows = (
        (160, "servos: bytes of the maker's protocol", "tendon_driver"),
        (245, "stand, gauge: lines of text", "friction_rig"),
        (315, "camera.url: motion JPEG", "camera, marker_tracker"),
        (65, "time: who lives in the cell's time", "nodes that it waits for"),
    )
    for y, wire, node in rows:
        colour = RUST if y == 65 else GREEN
        drawing.line((270, y), (600, y), colour=colour, arrow=True)
        drawing.text(435, y - 9, wire, colour, "middle")
        drawing.box(600, y - 22, 240, 44, node)
    drawing.text(435, 354, "no node of the suite sees more than a bench would show it", SOFT, "middle")
    return drawing.svg()


PICTURES = {
    "build_wiring": wiring,
    "build_spool": spool,
    "build_knot": knot,
    "build_assembly": assembly,
    "build_camera": camera,
    "build_rig": rig,
    "driver_cycle": driver_cycle,
    "emulator_wires": emulator_wires,
}


def main() -> int:
    """Write all pictures."""
    for name, draw in PICTURES.items():
        (FIGURES / f"{name}.svg").write_text(draw(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
