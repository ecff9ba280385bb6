# SPDX-License-Identifier: Apache-2.0
"""Three views of a part with outer dimensions and a table of its holes, to compare a print with. Lengths in mm.

A finger has a drawing of its own (`drawing.py`): its joints are what matters there.
"""

from __future__ import annotations

import math
import string
from collections import defaultdict
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from softgrip_design.parts.drawing import INCH_MM, TEXT, dimension
from softgrip_design.parts.forms import Bore, Form, PartPose, circle
from softgrip_design.parts.printing import LAYER_MM, MATERIALS, NOZZLE_MM
from softgrip_design.parts.solid import Solid, cad

Array = NDArray[np.float64]

#: Drawn to the largest of these that keeps the sheet within its width.
SCALES, SHEET_WIDTH_MM = (2.0, 1.0, 0.5), 290.0
#: Wide enough for the text.
MIN_SHEET_MM = 190.0
#: Around and between views, on the sheet; and the height of a line of text.
GAP_MM, LINE_MM = 16.0, 4.5
#: Of the eye; farther than any part is long.
FAR_MM = 1e4
#: A curved edge is drawn by points that are so far apart, and by so many at least and at most.
CURVE_STEP_MM = 0.5
CURVE_POINTS = (9, 65)
#: Places that a line of the table names.
PLACES_A_LINE = 4


@dataclass(frozen=True)
class View:
    """Where one looks from.

    Attributes:
        title: for people.
        right, up: axes of the part (0, 1, 2 for x, y, z) and signs that they have on the sheet.
    """

    title: str
    right: tuple[int, float]
    up: tuple[int, float]

    @property
    def matrix(self) -> Array:
        """From the part to the sheet, (3, 3): right, up, towards the eye."""
        rows = np.zeros((3, 3))
        rows[0, self.right[0]], rows[1, self.up[0]] = self.right[1], self.up[1]
        rows[2] = np.cross(rows[0], rows[1])
        return rows


#: ISO 128, first angle: from above it is drawn below the front, from the left beside it.
FRONT = View("from the front", (0, 1.0), (2, 1.0))
ABOVE = View("from above", (0, 1.0), (1, 1.0))
LEFT = View("from the left", (1, -1.0), (2, 1.0))


def views_of(solid: Solid) -> Figure:
    """Return a part from the front, from above and from the left, with a table of its holes."""
    box = solid.shape.bounding_box()
    size = np.array(tuple(box.size))
    scale = next((s for s in SCALES if s * (size[0] + size[1]) + 4.0 * GAP_MM <= SHEET_WIDTH_MM), SCALES[-1])
    rows = [*_heading(solid.form, scale), *round_rows(solid.form), *hole_rows(solid.form)]
    gap, line = GAP_MM / scale, LINE_MM / scale
    # each view's lower left corner on the sheet, in millimetres of the part
    table_height = (len(rows) + 1) * line
    places = {
        ABOVE: (gap, table_height + gap),
        FRONT: (gap, table_height + size[1] + 3.0 * gap),
        LEFT: (size[0] + 3.0 * gap, table_height + size[1] + 3.0 * gap),
    }
    sheet = (max(size[0] + size[1] + 4.5 * gap, MIN_SHEET_MM / scale), table_height + size[1] + size[2] + 5.0 * gap)
    figure = Figure(figsize=tuple(scale * side / INCH_MM for side in sheet))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_xlim(0.0, sheet[0])
    axes.set_ylim(0.0, sheet[1])
    axes.set_axis_off()
    for view, place in places.items():
        _draw_view(axes, solid, view, np.array(place), line)
    for k, text in enumerate(rows):
        axes.text(0.5 * gap, table_height - (k + 0.5) * line, text, **TEXT)
    return figure


def _heading(form: Form, scale: float) -> list[str]:
    return [
        f"{form.title} ({form.name}), {MATERIALS[form.material].title}, {form.count} of it",
        f"lengths in mm, scale {scale:g}:1, layers of {LAYER_MM:g}, nozzle of {NOZZLE_MM:g}",
    ]


def _draw_view(axes: Axes, solid: Solid, view: View, place: Array, line: float) -> None:
    turn = view.matrix
    seen, hidden = edges_of(solid, view)
    box = solid.shape.bounding_box()
    ends = np.array([tuple(box.min), tuple(box.max)]) @ turn.T
    low, high = ends[:, :2].min(axis=0), ends[:, :2].max(axis=0)
    move = place - low
    for edges, style in ((hidden, {"linewidths": 0.25, "linestyles": "--"}), (seen, {"linewidths": 0.6})):
        axes.add_collection(LineCollection([edge + move for edge in edges], colors="black", **style))
    width, height = high - low
    x, y = place
    dimension(axes, (x, y - line), (x + width, y - line), f"{width:.2f}", extend_to=y)
    axes.annotate("", (x - line, y), (x - line, y + height), arrowprops={"arrowstyle": "<->", "linewidth": 0.5,
                                                                         "shrinkA": 0.0, "shrinkB": 0.0})  # fmt: skip
    axes.text(x - 1.2 * line, y + 0.5 * height, f"{height:.2f}", rotation=90, ha="right", va="center", **TEXT)
    axes.text(x, y + height + 0.5 * line, view.title, **TEXT)
    for (u, v), text in _labels(solid.form, turn, line).items():
        axes.text(u + move[0], v + move[1], text, color="#a02010", **TEXT)


def _labels(form: Form, turn: Array, line: float) -> dict[tuple[float, float], str]:
    """Return where on the sheet the letters of holes stand that are looked at along their axes."""
    found: dict[tuple[float, float], list[tuple[float, str]]] = defaultdict(list)
    for letter, bores in _lettered(form).items():
        for bore in bores:
            start, end = (turn @ np.array(point) for point in (bore.start, bore.end))
            if np.linalg.norm((end - start)[:2]) < 1e-6:
                u, v = (round(float(value), 3) for value in start[:2])
                found[u, v].append((bore.radius_mm, letter))
    labels = {}
    for (u, v), holes in found.items():
        # in the middle of a hole that has room for it, else beside it
        widest = max(radius for radius, _ in holes)
        aside = -0.3 * line if widest > line else 0.75 * widest
        labels[u + aside, v + aside] = ", ".join(sorted({letter for _, letter in holes}))
    return labels


def edges_of(solid: Solid, view: View) -> tuple[list[Array], list[Array]]:
    """Return seen and hidden edges of a view on the sheet, each (n, 2) [mm]; two points where it is straight."""
    b, turn = cad(), view.matrix
    middle = solid.shape.bounding_box().center()
    eye = middle + b.Vector(*(FAR_MM * turn[2]))
    seen, hidden = solid.shape.project_to_viewport(tuple(eye), tuple(turn[1]), tuple(middle))
    # the sheet's origin is the point that is looked at
    origin = (turn @ np.array(tuple(middle)))[:2]
    return [_points(edge) + origin for edge in seen], [_points(edge) + origin for edge in hidden]


def _points(edge: Any) -> Array:
    curved = int(np.clip(np.ceil(edge.length / CURVE_STEP_MM) + 1, *CURVE_POINTS))
    count = 2 if edge.geom_type.name == "LINE" else curved
    return np.array([tuple(edge @ t)[:2] for t in np.linspace(0.0, 1.0, count)])


def _lettered(form: Form) -> dict[str, list[Bore]]:
    """Return letter -> bores of one radius, axis and length, the widest first."""
    groups: dict[tuple[float, str, float], list[Bore]] = defaultdict(list)
    for bore in form.bores:
        groups[round(bore.radius_mm, 3), _along(bore), round(math.dist(bore.start, bore.end), 2)].append(bore)
    widest_first = sorted(groups, key=lambda kind: -kind[0])
    return dict(zip(string.ascii_uppercase, (groups[kind] for kind in widest_first), strict=False))


def _along(bore: Bore) -> str:
    part = np.abs(np.array(bore.end) - np.array(bore.start)) / math.dist(bore.start, bore.end)
    return f"along {'xyz'[int(part.argmax())]}" if part.max() > 1.0 - 1e-9 else "oblique"


def round_rows(form: Form) -> list[str]:
    """Return what is turned round: diameter and from where to where along z, of bodies in the part's frame."""
    return [
        f"Ø{2.0 * body.outline[0].radius_mm:.2f} from z {body.start_mm:.2f} to {body.end_mm:.2f}"
        for body in form.bodies
        if body.pose == PartPose() and body.outline == circle(body.outline[0].radius_mm)
    ]


def hole_rows(form: Form) -> list[str]:
    """Return the table of a part's holes: letter, count, diameter, axis, length, where each begins in its frame."""
    rows = []
    for letter, bores in _lettered(form).items():
        first = bores[0]
        length = math.dist(first.start, first.end)
        places = [f"({', '.join(f'{value + 0.0:.2f}' for value in np.round(bore.start, 2))})" for bore in bores]
        lines = [" ".join(places[k : k + PLACES_A_LINE]) for k in range(0, len(places), PLACES_A_LINE)]
        hole = f"Ø{2.0 * first.radius_mm:.2f}, {_along(first)}, {length:.2f} long"
        rows.append(f"{letter}: {len(bores)} x {hole}, from {lines[0]}")
        rows += [f"      {line}" for line in lines[1:]]
    return rows
