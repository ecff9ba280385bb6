# SPDX-License-Identifier: Apache-2.0
"""Draws pictures of lines, boxes and words as SVG: those of docs/build, the driver's cycle, the emulated cell's wires.

Dimensions and rates come from the code.
"""

from __future__ import annotations

import math
import sys
from html import escape
from itertools import pairwise
from pathlib import Path

from softgrip_description.hand import shipped_hand
from softgrip_design.parts import bench, bill, drives, finger_form
from softgrip_driver.dynamixel.registers import MODELS
from softgrip_driver.nodes.tendon_parameters import PARAMETERS
from softgrip_driver.tendon.limits import TendonLimits
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
    drawing = Drawing(
        860, 300, "Wiring: supply, fuse, emergency stop, power hub, servos; the adapter carries data only"
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
        x = 560 + 100 * number - 100 * (number // SERVOS)
        drawing.box(x, 210, 80, 60, f"servo {number + 1}\nID {number + 1}")
        if number:
            drawing.line((x - 20, 240), (x, 240), colour=GREEN, width=2.5)
    drawing.line((600, 110), (600, 210), colour=GREEN, width=2.5)
    drawing.text(610, 185, "one cable from servo to servo", GREEN)
    drawing.box(360, 205, 150, 70, "adapter (U2D2)\nfeeds no servo")
    drawing.line((510, 240), (535, 240), (535, 95), (560, 95), colour=GREEN)
    drawing.text(415, 190, "data and ground", GREEN)
    drawing.box(160, 205, 130, 70, "computer\nUSB")
    drawing.line((290, 240), (360, 240), colour=GREEN)
    return drawing.svg()


def spool() -> str:
    """Return how a tendon is wound on a spool."""
    limits = TendonLimits()
    drawing = Drawing(760, 330, "Spool: the tendon comes off on one side; knot hole, turns side by side, loose tendon")
    x, y, radius = 170.0, 165.0, 80.0
    drawing.circle(x, y, radius + 18)
    drawing.circle(x, y, radius)
    drawing.circle(x, y, 14)
    drawing.circle(x - 46, y + 46, 5, RUST, RUST)
    drawing.text(x - 40, y + 70, "knot hole", RUST)
    drawing.line((x, y), (x + radius * math.cos(-0.9), y + radius * math.sin(-0.9)), colour=SOFT)
    drawing.text(x - 66, y - 24, "spool_radius_m", SOFT)
    drawing.line((x, y - radius), (470, y - radius), colour=GREEN, width=2.5, arrow=True)
    drawing.text(300, y - radius - 10, "to the finger", GREEN)
    arc = [(x + 112 * math.cos(a / 20), y + 112 * math.sin(a / 20)) for a in range(-24, 12)]
    drawing.line(*reversed(arc), colour=RUST, width=2, arrow=True)
    drawing.text(292, 178, "this way round pulls:", RUST)
    drawing.text(292, 196, "direction 1 where the servo counts up, else -1;", RUST)
    drawing.text(292, 214, "the wizard finds it", RUST)
    turns = f"{bill.TURNS:g} turns while the finger is straight, side by side in the groove of {drives.GROOVE_MM:g} mm"
    drawing.text(20, 288, turns)
    travel = f"homing lets out {1e3 * limits.slack_travel:g} mm and winds in {1e3 * limits.homing_travel:g} mm at most"
    drawing.text(20, 310, travel)
    return drawing.svg()


def figure_eight(points: int) -> list[tuple[float, float, float]]:
    """Return a figure-eight knot, opened where it is farthest out: x, y on the page, z towards the eye.

    The closed knot is x = (2 + cos 2t) cos 3t, y = (2 + cos 2t) sin 3t, z = sin 4t (E. W. Weisstein, Figure Eight Knot,
    MathWorld); its four crossings go over and under by turns.
    """
    opening = 0.12
    turns = (opening + (2.0 * math.pi - 2.0 * opening) * k / (points - 1) for k in range(points))
    return [
        (
            (2.0 + math.cos(2.0 * t)) * math.cos(3.0 * t),
            (2.0 + math.cos(2.0 * t)) * math.sin(3.0 * t),
            math.sin(4.0 * t),
        )
        for t in turns
    ]


def knot() -> str:
    """Return the stopper knot, open, as it is tied before it is pulled tight."""
    drawing = Drawing(760, 330, "Figure-eight stopper knot at the end of the tendon, open: four crossings, by turns")
    x, y, scale = 170.0, 165.0, 44.0
    strand = [(x + scale * u, y - scale * v, z) for u, v, z in figure_eight(720)]
    # the farther half first: what is drawn later lies above, with a margin of paper
    pieces = [strand[k : k + 14] for k in range(0, len(strand) - 1, 12)]
    for piece in sorted(pieces, key=lambda one: one[len(one) // 2][2]):
        line = [(u, v) for u, v, _ in piece]
        drawing.line(*line[1:-2], colour=PAPER, width=15)
        drawing.line(*line, colour=GREEN, width=6)
    for side, text in ((0, "to the groove of the spool, through the knot hole"), (-1, "end of the tendon: leave 5 mm")):
        u, v, _ = strand[side]
        away = -1.0 if v < y else 1.0
        # half a turn of a lobe's end leads away from the knot
        bend = [(u + 60 * (1.0 - math.cos(a / 20)) + 22 * a / 20, v - away * 38 * math.sin(a / 20)) for a in range(28)]
        drawing.line(*bend, colour=GREEN, width=6)
        drawing.text(bend[-1][0] + 14, bend[-1][1] + 5, text)
    for number, text in enumerate(("make a loop", "lead the end round behind the tendon", "and back through the loop")):
        drawing.text(430, 20 + 18 * number, f"{number + 1}. {text}", SOFT)
    drawing.text(430, 20 + 18 * 3, "4. pull it tight before the tendon is wound", SOFT)
    return drawing.svg()


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
