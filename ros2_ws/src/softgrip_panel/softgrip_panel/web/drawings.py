# SPDX-License-Identifier: Apache-2.0
"""Drawings of what a person has to do, as SVG made of numbers and the package's own texts only."""

from __future__ import annotations

import math
from html import escape

_HEAD = '<svg viewBox="0 0 420 240" role="img" aria-label="{label}" xmlns="http://www.w3.org/2000/svg">'
_LINE = 'fill="none" stroke="currentColor" stroke-width="4" stroke-linecap="round" stroke-linejoin="round"'
_MARK = 'fill="none" stroke="var(--accent)" stroke-width="6" stroke-linecap="round" stroke-linejoin="round"'


def _finger(x: float, y: float, down: bool, style: str) -> str:
    """Return a finger with three links and its tip."""
    way = 1.0 if down else -1.0
    return "".join(
        f'<path d="M{x - 13} {y + way * (4 + 30 * k)} h26 l-5 {way * 24} h-16 z" {style}/>' for k in range(3)
    )


def _arrow(x: float, y: float, dx: float, dy: float) -> str:
    angle = math.degrees(math.atan2(dy, dx))
    length = math.hypot(dx, dy)
    path = f'<path d="M0 0 H{length:.0f} m-14 -11 l14 11 l-14 11" {_MARK}/>'
    return f'<g transform="translate({x} {y}) rotate({angle:.0f})">{path}</g>'


def swap_drawing(step: str, label: str) -> str:
    """Return what to do at a step of a swap."""
    palm = f'<rect x="90" y="92" width="240" height="46" rx="10" {_LINE}/>'
    lid = f'<path d="M90 92 L120 40 H360" {_MARK}/>' if step in {"open_palm", "remove", "insert"} else ""
    slots = "".join(f'<rect x="{x}" y="126" width="34" height="14" {_LINE}/>' for x in (120, 193, 266))
    inside = "".join(_finger(x, 140, True, _LINE) for x in (137, 210, 283))
    outside = "".join(_finger(x, 176, True, _MARK) for x in (137, 210, 283))
    marks = {
        "open_palm": inside + _arrow(360, 92, 0, -48),
        "remove": outside + "".join(_arrow(x, 146, 0, 28) for x in (160, 233, 306)),
        "insert": outside + "".join(_arrow(x, 174, 0, -28) for x in (160, 233, 306)),
        "close_palm": inside + _arrow(360, 44, 0, 48),
        "hands_out": inside + _arrow(345, 190, 60, 30),
        "verify": inside + f'<path d="M100 215 q110 30 220 0" {_MARK}/>',
    }
    return _HEAD.format(label=escape(label)) + palm + lid + slots + marks.get(step, inside) + "</svg>"


def rig_drawing(angle_rad: float, load_kg: float, label: str) -> str:
    """Return the rig with a wrap angle and a weight: the cable comes from the stage, and the weight hangs."""
    cx, cy, r = 210.0, 110.0, 55.0
    start = math.pi / 2.0 - angle_rad  # the weight hangs at the right of the surface, straight down
    ax, ay = cx + r * math.cos(start - math.pi / 2.0), cy + r * math.sin(start - math.pi / 2.0)
    large = 1 if angle_rad > math.pi else 0
    pull_x, pull_y = ax - 150.0 * math.sin(math.pi / 2.0 - start), ay - 150.0 * math.cos(math.pi / 2.0 - start)
    text = f"{math.degrees(angle_rad):.0f} deg, {load_kg:.2f} kg"
    return (
        _HEAD.format(label=escape(f"{label}: {text}"))
        + f'<circle cx="{cx}" cy="{cy}" r="{r}" {_LINE}/>'
        + f'<path d="M{cx + r} {cy} V200" {_MARK}/><rect x="{cx + r - 24}" y="200" width="48" height="32" {_LINE}/>'
        + f'<path d="M{cx + r} {cy} A{r} {r} 0 {large} 0 {ax:.1f} {ay:.1f} L{pull_x:.1f} {pull_y:.1f}" {_MARK}/>'
        + f'<text x="410" y="30" text-anchor="end" fill="currentColor" font-size="22">{escape(text)}</text></svg>'
    )
