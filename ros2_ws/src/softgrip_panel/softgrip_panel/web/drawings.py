# SPDX-License-Identifier: Apache-2.0
"""Drawings of what a person has to do, as SVG made of numbers and the package's own texts only.

Every coordinate is an absolute one of its picture, so that what is cut off can be tested.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import Final

#: Size of every picture.
WIDTH: Final = 420
HEIGHT: Final = 290
_HEAD = f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{{label}}" xmlns="http://www.w3.org/2000/svg">'
_LINE = 'fill="none" stroke="currentColor" stroke-width="4" stroke-linecap="round" stroke-linejoin="round"'
_MARK = 'fill="none" stroke="var(--accent)" stroke-width="6" stroke-linecap="round" stroke-linejoin="round"'
#: The palm, from left to right.
_PALM_LEFT, _PALM_RIGHT = 90.0, 330.0
#: Between slots there is this room where parts are drawn at their full width.
_FULL_PITCH = 48.0

_Point = tuple[float, float]


def _path(points: Sequence[_Point], style: str, *, closed: bool = False) -> str:
    return f'<path d="M{" L".join(f"{x:.1f} {y:.1f}" for x, y in points)}{" Z" if closed else ""}" {style}/>'


def _finger(x: float, y: float, size: float, style: str) -> str:
    """Return a finger that hangs down, with three links, the last one its tip."""
    wide, narrow = 13.0 * size, 8.0 * size
    return "".join(
        _path(
            [(x - wide, top), (x + wide, top), (x + narrow, top + 24.0), (x - narrow, top + 24.0)], style, closed=True
        )
        for top in (y + 4.0 + 30.0 * link for link in range(3))
    )


def _arrow(start: _Point, end: _Point, size: float = 1.0) -> str:
    """Return an arrow; its head as wide as its size."""
    away = math.atan2(end[1] - start[1], end[0] - start[0])
    head = [
        (
            end[0] - size * (14.0 * math.cos(away) + side * math.sin(away)),
            end[1] - size * (14.0 * math.sin(away) - side * math.cos(away)),
        )
        for side in (-11.0, 11.0)
    ]
    return _path([start, end], _MARK) + _path([head[0], end, head[1]], _MARK)


def swap_drawing(step: str, label: str, slots: int = 3) -> str:
    """Return what to do at a step of a swap.

    Args:
        step: as in softgrip_panel.model.swap.STEPS.
        label: of the picture, for who does not see it.
        slots: of the hand.
    """
    pitch = (_PALM_RIGHT - _PALM_LEFT) / max(1, slots)
    size = min(1.0, pitch / _FULL_PITCH)
    places = [_PALM_LEFT + pitch * (slot + 0.5) for slot in range(slots)]
    palm = f'<rect x="{_PALM_LEFT:.0f}" y="92" width="{_PALM_RIGHT - _PALM_LEFT:.0f}" height="46" rx="10" {_LINE}/>'
    is_open = step in {"open_palm", "remove", "insert"}
    lid = _path([(_PALM_LEFT, 92.0), (120.0, 40.0), (360.0, 40.0)], _MARK) if is_open else ""
    wide = 34.0 * size
    holes = "".join(
        f'<rect class="slot" x="{x - wide / 2.0:.1f}" y="126" width="{wide:.1f}" height="14" {_LINE}/>' for x in places
    )
    inside = "".join(_finger(x, 140.0, size, _LINE) for x in places)
    outside = "".join(_finger(x, 184.0, size, _MARK) for x in places)
    beside = [x + 23.0 * size for x in places]
    marks = {
        "open_palm": inside + _arrow((360.0, 92.0), (360.0, 44.0)),
        "remove": outside + "".join(_arrow((x, 150.0), (x, 180.0), size) for x in beside),
        "insert": outside + "".join(_arrow((x, 180.0), (x, 150.0), size) for x in beside),
        "close_palm": inside + _arrow((360.0, 44.0), (360.0, 92.0)),
        "hands_out": inside + _arrow((345.0, 190.0), (405.0, 220.0)),
        "verify": inside + f'<path d="M100 240 Q210 270 320 240" {_MARK}/>',
    }
    return _HEAD.format(label=escape(label)) + palm + lid + holes + marks.get(step, inside) + "</svg>"


def rig_drawing(angle_rad: float, load_kg: float, label: str) -> str:
    """Return the rig with a wrap angle and a weight: the cable comes from the stage, and the weight hangs."""
    cx, cy, r = 210.0, 140.0, 55.0
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    ax, ay = cx + r * cos, cy - r * sin  # where the cable leaves the surface; it hangs straight down at the right
    large = 1 if angle_rad > math.pi else 0

    def along(far: float, side: float) -> _Point:
        """Return a place so far along the leaving cable, and so far beside it."""
        return ax - far * sin + side * cos, ay - far * cos - side * sin

    (end_x, end_y), stage = along(72.0, 0.0), [along(72.0, -20.0), along(72.0, 20.0), along(98.0, 20.0)]
    text = f"{math.degrees(angle_rad):.0f} deg, {load_kg:.2f} kg"
    return (
        _HEAD.format(label=escape(f"{label}: {text}"))
        + f'<circle cx="{cx}" cy="{cy}" r="{r}" {_LINE}/>'
        + f'<path d="M{cx + r} {cy} V205" {_MARK}/><rect x="{cx + r - 24}" y="205" width="48" height="32" {_LINE}/>'
        + f'<path d="M{cx + r} {cy} A{r} {r} 0 {large} 0 {ax:.1f} {ay:.1f} L{end_x:.1f} {end_y:.1f}" {_MARK}/>'
        + f'<g class="stage">{_path([*stage, along(98.0, -20.0)], _LINE, closed=True)}'
        + f"{_path([along(85.0, -8.0), along(85.0, 8.0)], _LINE)}"
        + f"{_path([along(106.0, -26.0), along(106.0, 26.0)], _LINE)}</g>"
        + f'<text x="{cx}" y="276" text-anchor="middle" fill="currentColor" font-size="22">{escape(text)}</text></svg>'
    )
