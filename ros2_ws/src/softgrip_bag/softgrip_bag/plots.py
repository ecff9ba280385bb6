# SPDX-License-Identifier: Apache-2.0
"""Figures of reports, as SVG text; the style that all reports of the suite share."""

from __future__ import annotations

import io
from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from softgrip_bag.statistics import BagStatistics
from softgrip_bag.story import RecordedClosing, RecordedFit, RecordedSample, Story
from softgrip_model.friction.laws import FrictionLaw, KReading, Law
from softgrip_time.units import to_s

#: One colour a joint, a load, a topic; the same everywhere.
COLOURS = ("#0b6e4f", "#c8553d", "#3d5a98", "#8e6c8a", "#b08900", "#555555")
INK = "#22312b"
DEGREES = 180.0 / np.pi
MILLIMETRES = 1000.0
STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e3e8e5",
    "grid.linewidth": 0.6,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.frameon": False,
    "svg.fonttype": "path",
    "svg.hashsalt": "softgrip",
}
_MODE_COLOURS = {
    "IDLE": "#dfe9e3",
    "SWAPPING": "#e9d8a6",
    "GRASPING": "#9cc5b0",
    "HOLDING": "#5fa883",
    "FAULT": "#e6a596",
    "ESTOP": "#c8553d",
    "UNKNOWN": "#eeeeee",
}
_BINS = 400


def svg(figure: Figure) -> str:
    """Return a figure as an <svg> element, the same bytes for the same content."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]


def draw_ratio(axes: Axes, law: FrictionLaw, points: Sequence[tuple[float, float, float]]) -> None:
    """Tension ratio over wrap angle, one curve a load.

    Args:
        axes: to draw into.
        law: fitted.
        points: wrap angle [rad], T1, T2 [N] of each measured point.
    """
    loads = sorted({round(low, 1) for _, _, low in points})
    for colour, load in zip(COLOURS, loads, strict=False):
        own = [point for point in points if round(point[2], 1) == load]
        low = float(np.mean([point[2] for point in own]))
        angles = np.linspace(0.0, max(point[0] for point in points) * 1.05, 100)
        axes.plot(angles * DEGREES, law.ratio(angles, low), color=colour, lw=1.6, label=f"T₂ = {low:.2f} N")
        axes.plot([p[0] * DEGREES for p in own], [p[1] / p[2] for p in own], "o", color=colour, ms=5, mec="white")
    axes.set(xlabel="wrap angle θ [deg]", ylabel="tension ratio T₁ / T₂ [1]")
    axes.legend(loc="upper left")


def fit_figure(fit: RecordedFit, samples: Sequence[RecordedSample]) -> str:
    """A fitted model with the points that were measured before it."""
    points = [(s.angle, s.tension_high, s.tension_low) for s in samples if s.accepted and s.time <= fit.time]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(5.0, 3.2), layout="constrained")
        axes = figure.subplots()
        law = FrictionLaw(Law(fit.law), tuple(fit.coefficients.values()), fit.radius_mm, KReading(fit.k_reading))
        draw_ratio(axes, law, points)
        axes.set_title(fit.id)
        return svg(figure)


def closing_figure(closing: RecordedClosing) -> str:
    """Joint angles over pulled length and the fingertip's path: seen as dots, predicted as lines, one a closing."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 3.3), layout="constrained")
        angles, path = figure.subplots(1, 2)
        for run in np.unique(closing.run):
            own = closing.run == run
            draw_joints(
                angles, closing.pulled[own], closing.measured_angles[own], closing.predicted_angles[own], named=run == 0
            )
            path.plot(*(closing.measured[own].T * MILLIMETRES), ".", color=COLOURS[1], ms=3)
            path.plot(*(closing.predicted[own].T * MILLIMETRES), "-", color=COLOURS[0], lw=1.4)
        angles.set(xlabel="pulled length [mm]", ylabel="joint angle [deg]", title="joint angles")
        angles.legend(loc="upper left")
        path.set(xlabel="x [mm]", ylabel="y [mm]", title="path of the fingertip")
        path.set_aspect("equal", adjustable="datalim")
        figure.suptitle(f"{closing.profile}, {closing.finger}", fontsize=10)
        return svg(figure)


def draw_joints(
    axes: Axes,
    pulled_m: NDArray[np.float64],
    measured: NDArray[np.float64],
    predicted: NDArray[np.float64],
    *,
    named: bool = True,
) -> None:
    """Joint angles over pulled length, a colour a joint: measured as dots, predicted as lines.

    Args:
        axes: to draw into.
        pulled_m: (n,) [m].
        measured: (n, joints) [rad].
        predicted: (n, joints) [rad].
        named: put the joints into the legend.
    """
    for joint in range(predicted.shape[1]):
        colour = COLOURS[joint % len(COLOURS)]
        label = f"J{joint}" if named else None
        axes.plot(pulled_m * MILLIMETRES, measured[:, joint] * DEGREES, ".", color=colour, ms=3, alpha=0.6)
        axes.plot(pulled_m * MILLIMETRES, predicted[:, joint] * DEGREES, "-", color=colour, lw=1.4, label=label)


def timeline_figure(found: BagStatistics, story: Story) -> str:
    """Every topic's rate over time as darkness, the cell's modes above, grasps and faults as marks."""
    topics = [topic for topic in found.topics if topic.messages]
    duration = max(found.duration, 1e-3)
    edges = np.linspace(0.0, duration, _BINS + 1)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11.5, 1.6 + 0.17 * len(topics)), layout="constrained")
        modes, rates = figure.subplots(2, 1, sharex=True, height_ratios=(1.0, max(1.0, 0.3 * len(topics))))
        _draw_modes(modes, story, found.start, duration)
        counts = [np.histogram(to_s(topic.received - found.start), edges)[0] for topic in topics]
        shown = [row / max(1, row.max()) for row in counts] or [np.zeros(_BINS)]
        rates.imshow(shown, aspect="auto", extent=(0.0, duration, len(topics) - 0.5, -0.5), cmap="Greens", vmin=0.0)
        rates.set_yticks(range(len(topics)), [topic.name for topic in topics], fontsize=6.5)
        rates.set(xlabel="time [s]")
        rates.grid(visible=False)
        return svg(figure)


def _draw_modes(axes: Axes, story: Story, start: int, duration: float) -> None:
    times = [to_s(mode.time - start) for mode in story.modes]
    for mode, since, until in zip(story.modes, times, [*times[1:], duration], strict=True):
        axes.axvspan(since, until, ymin=0.0, ymax=0.45, color=_MODE_COLOURS.get(mode.mode, "#eeeeee"), lw=0)
    for grasp in story.grasps:
        good = grasp.outcome == "GRIPPED"
        axes.plot(to_s(grasp.time - start), 0.65, "o" if good else "X", color=COLOURS[0 if good else 1], ms=5)
    for fault in story.faults:
        axes.plot(to_s(fault.time - start), 0.9, "v", color=COLOURS[1], ms=5)
    axes.set(ylim=(0, 1), yticks=[0.22, 0.65, 0.9], xlim=(0.0, duration))
    axes.set_yticklabels(["mode", "grasps", "faults"], fontsize=7)
    axes.grid(visible=False)
