# SPDX-License-Identifier: Apache-2.0
"""Charts of a page, as SVG made of numbers and of texts that are escaped.

A friction model beside its points, the statistics of a finger over time, the empty closing of a record.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Final

from softgrip_panel.model.friction import FitPicture
from softgrip_panel.model.residuals import ResidualSample, WatchLimits

#: Size of a chart.
WIDTH: Final = 640
HEIGHT: Final = 320
_LEFT, _RIGHT, _TOP, _BOTTOM = 58.0, 12.0, 34.0, 44.0
#: Of curves, in their order; each has a dash of its own, too, for who does not tell the colours apart.
STYLES: Final = (("--accent", ""), ("--measured", "10 5"), ("--good", "3 4"), ("--bad", "12 4 3 4"))
#: What the friction law's points that were not accepted are marked by.
ACCEPTED: Final = "ACCEPTED"


@dataclass(frozen=True)
class Axes:
    """Places of values in the chart, from the lowest to the highest of each axis."""

    x: tuple[float, float]
    y: tuple[float, float]

    def place(self, x: float, y: float) -> tuple[float, float]:
        """Return where a point stands [px]."""
        (x0, x1), (y0, y1) = self.x, self.y
        return (
            _LEFT + (WIDTH - _LEFT - _RIGHT) * (x - x0) / ((x1 - x0) or 1.0),
            HEIGHT - _BOTTOM - (HEIGHT - _TOP - _BOTTOM) * (y - y0) / ((y1 - y0) or 1.0),
        )

    def path(self, points: Sequence[tuple[float, float]]) -> str:
        """Return the points as what a path's `d` holds."""
        return "M" + " L".join("{:.1f} {:.1f}".format(*self.place(x, y)) for x, y in points)


def _round_step(span: float) -> float:
    """Return 1, 2 or 5 times a power of ten, so that four to eight of it fill the span."""
    rough = max(span, 1e-9) / 5.0
    power = 10.0 ** math.floor(math.log10(rough))
    return power * next(one for one in (1.0, 2.0, 5.0, 10.0) if one * power >= rough)


def _text(x: float, y: float, text: str, anchor: str = "middle", colour: str = "--dim") -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" font-size="15" style="fill:var({colour})">'
        f"{escape(text)}</text>"
    )


def _frame(axes: Axes, x_name: str, y_name: str) -> str:
    """Return frame, ticks and names of the axes."""
    size = f'width="{WIDTH - _LEFT - _RIGHT}" height="{HEIGHT - _TOP - _BOTTOM}"'
    parts = [f'<rect x="{_LEFT}" y="{_TOP}" {size} fill="none" style="stroke:var(--line)"/>']
    for value in _ticks(axes.x):
        x, y = axes.place(value, axes.y[0])
        parts += [_text(x, y + 18.0, f"{value:g}"), _rule(f"M{x:.1f} {y:.1f} V{_TOP}")]
    for value in _ticks(axes.y):
        x, y = axes.place(axes.x[0], value)
        parts += [_text(x - 6.0, y + 5.0, f"{value:g}", "end"), _rule(f"M{x:.1f} {y:.1f} H{WIDTH - _RIGHT}")]
    parts += [_text((WIDTH + _LEFT) / 2.0, HEIGHT - 6.0, x_name), _text(4.0, 16.0, y_name, "start")]
    return "".join(parts)


def _ticks(ends: tuple[float, float]) -> list[float]:
    step = _round_step(ends[1] - ends[0])
    return [k * step for k in range(math.ceil(ends[0] / step - 1e-9), math.floor(ends[1] / step + 1e-9) + 1)]


def _rule(path: str) -> str:
    return f'<path d="{path}" style="stroke:var(--line)" opacity=".5"/>'


def _line(axes: Axes, points: Sequence[tuple[float, float]], number: int, classes: str) -> str:
    colour, dash = STYLES[number % len(STYLES)]
    dashed = f' stroke-dasharray="{dash}"' if dash else ""
    return (
        f'<path class="{classes}" d="{axes.path(points)}" fill="none" stroke-width="2.5"{dashed} '
        f'style="stroke:var({colour})"/>'
    )


def _legend(names: Sequence[str], y_name: str) -> str:
    """Return the names of the curves above the frame, right of the vertical axis' own."""
    parts, x = [], 24.0 + 8.0 * len(y_name)
    for number, name in enumerate(names):
        colour, dash = STYLES[number % len(STYLES)]
        style = f'stroke-width="3" stroke-dasharray="{dash or "none"}" style="stroke:var({colour})"'
        parts.append(f'<path d="M{x:.0f} 12 h30" {style}/>')
        parts.append(_text(x + 36.0, 17.0, name, "start", "--text"))
        x += 52.0 + 8.0 * len(name)
    return "".join(parts)


def _chart(label: str, *parts: str) -> str:
    return (
        f'<svg class="chart" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(label)}" '
        f'xmlns="http://www.w3.org/2000/svg">{"".join(parts)}</svg>'
    )


def fit_chart(picture: FitPicture, label: str, x_name: str, y_name: str) -> str:
    """Return T1/T2 over the wrap angle: a curve with its interval for each load, and the measured points.

    Args:
        picture: of the model.
        label: of the chart, for who does not see it.
        x_name: of the horizontal axis.
        y_name: of the vertical one.
    """
    edges = [1.0]
    for curve in picture.curves:
        edges += [value for _, *values in curve.points for value in values if math.isfinite(value)]
    edges += [one.ratio for one, _ in picture.points if math.isfinite(one.ratio)]
    ends = [curve.points[-1][0] for curve in picture.curves if curve.points]
    ends += [one.angle_rad for one, _ in picture.points]
    axes = Axes((0.0, 1.05 * math.degrees(max(ends, default=math.pi))), (min(edges), 1.03 * max(edges)))
    parts = [_frame(axes, x_name, y_name), _legend([f"{one.tension_low_n:.2f} N" for one in picture.curves], y_name)]
    for number, curve in enumerate(picture.curves):
        known = [(math.degrees(a), low, high) for a, _, low, high in curve.points if math.isfinite(low + high)]
        if known:
            band = [(a, low) for a, low, _ in known] + [(a, high) for a, _, high in reversed(known)]
            colour = STYLES[number % len(STYLES)][0]
            parts.append(f'<path class="band" d="{axes.path(band)} Z" style="fill:var({colour})" opacity=".16"/>')
        parts.append(_line(axes, [(math.degrees(a), ratio) for a, ratio, _, _ in curve.points], number, "fitted"))
    for one, number in picture.points:
        if not math.isfinite(one.ratio):
            continue
        colour = STYLES[number % len(STYLES)][0] if number >= 0 else "--text"
        angle, spread = math.degrees(one.angle_rad), one.stddev_n / one.tension_low_n
        x, y = axes.place(angle, one.ratio)
        bar = axes.path([(angle, one.ratio - 2.0 * spread), (angle, one.ratio + 2.0 * spread)])
        parts.append(f'<path d="{bar}" stroke-width="2" style="stroke:var({colour})"/>')
        if one.verdict == ACCEPTED:
            parts.append(f'<circle class="measured" cx="{x:.1f}" cy="{y:.1f}" r="5" style="fill:var({colour})"/>')
        else:
            cross = f"M{x - 6:.1f} {y - 6:.1f} l12 12 m0 -12 l-12 12"
            parts.append(f'<path class="refused" d="{cross}" stroke-width="2.5" style="stroke:var({colour})"/>')
    return _chart(label, *parts)


def _minutes(samples: Sequence[ResidualSample], values: Sequence[float]) -> list[tuple[float, float]]:
    """Return (minutes before the last sample, value), values that are none left out."""
    end_s = samples[-1].at_s
    return [
        ((one.at_s - end_s) / 60.0, value) for one, value in zip(samples, values, strict=True) if math.isfinite(value)
    ]


def statistic_chart(
    samples: Sequence[ResidualSample], limits: WatchLimits, label: str, x_name: str, names: Sequence[str]
) -> str:
    """Return the statistics of friction and stiffness of one finger over time, with their limits.

    Args:
        samples: at least one, oldest first.
        limits: drawn as lines across where they are known.
        label: of the chart, for who does not see it.
        x_name: of the axis.
        names: of vertical axis, friction, stiffness, lower limit, upper limit.
    """
    y_name, friction, stiffness, low, high = names
    curves = [
        _minutes(samples, [one.friction for one in samples]),
        _minutes(samples, [one.stiffness for one in samples]),
    ]
    top = max([1.0, *(y for curve in curves for _, y in curve), *filter(math.isfinite, (limits.low, limits.high))])
    axes = Axes((min(-1.0, (samples[0].at_s - samples[-1].at_s) / 60.0), 0.0), (0.0, 1.1 * top))
    parts = [_frame(axes, x_name, y_name), _legend([friction, stiffness], y_name)]
    for value, name, colour in ((limits.low, low, "--warn"), (limits.high, high, "--bad")):
        if math.isfinite(value):
            line = axes.path([(axes.x[0], value), (0.0, value)])
            x, y = axes.place(axes.x[0], value)
            parts.append(f'<path class="limit" d="{line}" stroke-width="2" style="stroke:var({colour})"/>')
            parts.append(_text(x + 6.0, y - 5.0, f"{name} {value:g}", "start", colour))
    parts += [_line(axes, curve, number, "statistic") for number, curve in enumerate(curves) if curve]
    return _chart(label, *parts)


def tip_chart(fingers: Sequence[tuple[str, Sequence[ResidualSample]]], label: str, x_name: str, y_name: str) -> str:
    """Return how far each measured fingertip was from the predicted one over time [mm].

    Args:
        fingers: name and samples, oldest first.
        label: of the chart, for who does not see it.
        x_name: of the horizontal axis.
        y_name: of the vertical one.
    """
    curves = [_minutes(samples, [1e3 * one.tip_error_m for one in samples]) for _, samples in fingers if samples]
    top = max([1.0, *(y for curve in curves for _, y in curve)])
    first = min([-1.0, *(x for curve in curves for x, _ in curve)])
    axes = Axes((first, 0.0), (0.0, 1.1 * top))
    parts = [_frame(axes, x_name, y_name), _legend([name for name, samples in fingers if samples], y_name)]
    return _chart(label, *parts, *(_line(axes, curve, number, "tip") for number, curve in enumerate(curves) if curve))


def check_chart(curve: Sequence[tuple[float, float]], label: str, x_name: str, y_name: str) -> str:
    """Return an empty closing as it was checked: tension [N] over pulled length [mm].

    Args:
        curve: (pulled length [m], tension [N]), at least one.
        label: of the chart, for who does not see it.
        x_name: of the horizontal axis.
        y_name: of the vertical one.
    """
    points = [(1e3 * x, n) for x, n in curve]
    axes = Axes((0.0, max(1.0, *(x for x, _ in points))), (0.0, 1.1 * max(1.0, *(n for _, n in points))))
    return _chart(label, _frame(axes, x_name, y_name), _line(axes, points, 0, "check"))
