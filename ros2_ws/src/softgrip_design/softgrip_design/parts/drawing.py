# SPDX-License-Identifier: Apache-2.0
"""A finger's drawing with its dimensions, to compare a print with: SVG, 2:1, lengths in mm."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from softgrip_design.parts.finger_form import FingerForm, JointGroove
from softgrip_design.parts.forms import polygon

Array = NDArray[np.float64]

SCALE = 2.0
INCH_MM = 25.4
TEXT: dict[str, Any] = {"fontsize": 8.5, "family": "DejaVu Sans"}
_PART_COLOUR = "#f5e6d0"
_OVER_CHANNEL: dict[str, Any] = {"facecolor": _PART_COLOUR, "edgecolor": "none", "pad": 0.5}
_ARROW: dict[str, Any] = {"arrowstyle": "<->", "linewidth": 0.5, "shrinkA": 0.0, "shrinkB": 0.0}


def figure_of(finger: FingerForm) -> Figure:
    """Return the side view of a finger with h, l, r, opening, link lengths, width and height."""
    outlines = [polygon(body.outline) for body in finger.form.bodies]
    everything = np.vstack(outlines)
    left, right = float(everything[:, 0].min()) - 14.0, float(everything[:, 0].max()) + 14.0
    low, high = -finger.depth_mm - 14.0, 17.0
    size = (SCALE * (right - left) / INCH_MM, SCALE * (high - low) / INCH_MM)
    figure = Figure(figsize=size)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_xlim(left, right)
    axes.set_ylim(low, high)
    axes.set_axis_off()
    for outline in outlines:
        axes.add_patch(Polygon(outline, closed=True, facecolor=_PART_COLOUR, edgecolor="black", linewidth=0.7))
    for bore in finger.channels:
        axes.plot((bore.start[0], bore.end[0]), (bore.start[1], bore.end[1]), "--", color="#c03020", linewidth=0.6)
    for j, groove in enumerate(finger.grooves):
        _draw_groove(axes, finger, groove, j)
    _draw_lengths(axes, finger)
    axes.text(left + 2.0, low + 2.0, _title(finger), **TEXT)
    return figure


def _title(finger: FingerForm) -> str:
    return (
        f"finger {finger.form.title.split()[-1]}, serial {finger.serial}; TPU, printed on its side; width "
        f"{finger.width_mm:.3f}, channels of {2.0 * finger.channel_radius_mm:.2f}; lengths in mm, scale {SCALE:g}:1"
    )


def _draw_groove(axes: Axes, finger: FingerForm, groove: JointGroove, joint: int) -> None:
    h, l = groove.strip_mm  # noqa: E741  the thesis' letters
    x = groove.x_mm
    axes.plot(x, 0.0, "+", color="black", markersize=6, markeredgewidth=0.6)
    dimension(axes, (x - 0.5 * l, 12.0), (x + 0.5 * l, 12.0), f"l{joint} = {l:.3f}", extend_to=h)
    axes.annotate(f"h{joint} = {h:.3f}", (x, h), (x, 8.0), ha="center", **TEXT,
                  arrowprops={"arrowstyle": "->", "linewidth": 0.5})  # fmt: skip
    for side, (end_x, end_y) in enumerate(groove.routing):
        r = math.hypot(end_x - x, end_y)
        axes.plot((x, end_x), (0.0, end_y), "-", color="#3060c0", linewidth=0.5)
        axes.plot(end_x, end_y, ".", color="#3060c0", markersize=3)
        axes.text(end_x + (1.0 if side else -1.0), end_y - 0.4, f"r{2 * joint + side} = {r:.3f}",
                  ha="left" if side else "right", color="#203f80", bbox=_OVER_CHANNEL, **TEXT)  # fmt: skip
    opening = math.degrees(2.0 * groove.half_opening_rad)
    free = math.degrees(groove.free_rad)
    stop = f", strip free to {free:.0f}°" if free < opening - 0.5 else ""
    axes.text(x, -finger.depth_mm + 0.8, f"{opening:.2f}°{stop}", ha="center", **TEXT)


def _draw_lengths(axes: Axes, finger: FingerForm) -> None:
    ends = [*(groove.x_mm for groove in finger.grooves), finger.length_mm]
    level = -finger.depth_mm - 6.0
    for j, (start, end) in enumerate(itertools.pairwise(ends)):
        dimension(axes, (start, level), (end, level), f"link {j} = {end - start:.3f}", extend_to=0.0)
    dimension(axes, (finger.seat.end_mm, level), (0.0, level), f"foot = {-finger.seat.end_mm:.3f}", extend_to=0.0)
    right = finger.length_mm + 5.0
    axes.annotate("", (right, -finger.depth_mm), (right, 0.0), arrowprops=_ARROW)
    axes.text(right + 0.8, -0.5 * finger.depth_mm, f"{finger.depth_mm:.3f}", rotation=90, va="center", **TEXT)


def dimension(axes: Axes, start: tuple[float, float], end: tuple[float, float], text: str, *, extend_to: float) -> None:
    """Draw a dimension between two points of equal height, its lines reaching to a height of the part."""
    axes.annotate("", start, end, arrowprops=_ARROW)
    for x, y in (start, end):
        axes.plot((x, x), (extend_to, y + math.copysign(1.0, y)), color="black", linewidth=0.3)
    axes.text(0.5 * (start[0] + end[0]), start[1] + 0.8, text, ha="center", **TEXT)


def write_svg(figure: Figure, path: Path) -> None:
    """Write a drawing; it holds no date and no random names, so that it changes only with the part.

    Raises:
        OSError: the file cannot be written.
    """
    with rc_context({"svg.hashsalt": "softgrip", "svg.fonttype": "none"}):
        FigureCanvasSVG(figure).print_svg(path, metadata={"Date": None})
