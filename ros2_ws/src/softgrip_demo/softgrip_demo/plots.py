# SPDX-License-Identifier: Apache-2.0
"""Figures of the report, as SVG text."""

from __future__ import annotations

from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.collections import PatchCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from softgrip_bag.plots import COLOURS, DEGREES, MILLIMETRES, STYLE, draw_joints, draw_ratio, svg
from softgrip_demo.summary import tip_errors_percent, tip_half_widths
from softgrip_model.friction.laws import FrictionLaw, KReading, Law

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from softgrip_demo.record import FrictionResult, ShiftClosing


def friction_figure(friction: FrictionResult) -> str:
    """Tension ratio over wrap angle: measured points and the fitted law, one curve a load."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(5.6, 3.5), layout="constrained")
        axes = figure.subplots()
        law = FrictionLaw(
            Law(friction.law),
            tuple(friction.coefficients.values()),
            friction.radius_mm,
            KReading(friction.k_reading),
        )
        draw_ratio(axes, law, [(p.angle, p.tension_high, p.tension_low) for p in friction.points])
        return svg(figure)


def joints_figure(closing: ShiftClosing) -> str:
    """Joint angles over pulled length: markers as dots, prediction as lines."""
    pulled = np.array([s.pulled_length_m for s in closing.samples])
    measured = np.array([s.measured_angles for s in closing.samples])
    predicted = np.array([s.predicted_angles for s in closing.samples])
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(3.7, 3.1), layout="constrained")
        axes = figure.subplots()
        draw_joints(axes, pulled, measured, predicted)
        axes.set(xlabel="pulled length [mm]", ylabel="joint angle [deg]", title=closing.grasp)
        axes.legend(loc="upper left")
        return svg(figure)


def demonstration_figure(closing: ShiftClosing, human: np.ndarray) -> str:
    """Joint angles over their sum, as Fig 4.5: the person (thin) and the printed finger (dots).

    Args:
        closing: of the finger set.
        human: (rows, joints) [rad] flexion of the person's index finger, growing in its sum.
    """
    measured = np.array([s.measured_angles for s in closing.samples]) * DEGREES
    shown = human * DEGREES
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(3.7, 3.1), layout="constrained")
        axes = figure.subplots()
        for joint in range(measured.shape[1]):
            colour = COLOURS[joint % len(COLOURS)]
            axes.plot(shown.sum(axis=1), shown[:, joint], "-", color=colour, lw=1.0, label=f"J{joint} hand")
            axes.plot(measured.sum(axis=1), measured[:, joint], ".", color=colour, ms=3, alpha=0.6)
        axes.set(
            xlabel="sum of joint angles [deg]", ylabel="joint angle [deg]", title=f"{closing.grasp}: as the hand does"
        )
        axes.legend(loc="upper left")
        return svg(figure)


def tip_figure(closing: ShiftClosing) -> str:
    """The fingertip's path, measured and predicted, with the simulated shape at the end behind it."""
    measured = np.array([s.measured_tip for s in closing.samples]) * MILLIMETRES
    predicted = np.array([s.predicted_tip for s in closing.samples]) * MILLIMETRES
    errors = tip_errors_percent(closing)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(3.7, 3.4), layout="constrained")
        axes = figure.subplots()
        _draw_shape(axes, closing)
        _draw_intervals(axes, predicted, tip_half_widths(closing) * MILLIMETRES)
        axes.plot(*measured.T, ".", color="#c8553d", ms=3, label="markers")
        axes.plot(*predicted.T, "-", color="#0b6e4f", lw=1.5, label="prediction")
        axes.set(
            xlabel="x [mm]",
            ylabel="y [mm]",
            title=f"{closing.grasp}: tip error {errors.mean():.2f} % mean, {errors.max():.2f} % max",
        )
        axes.title.set_fontsize(8.5)
        axes.set_aspect("equal")
        # below the axes; "outside lower center" is new in matplotlib 3.7, Ubuntu 24.04 has 3.6
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=3)
        return svg(figure)


def _draw_intervals(axes: Axes, centres: np.ndarray, half_widths: np.ndarray) -> None:
    """Draw each sample's 95 % interval as the ellipse of its two half widths."""
    stated = np.isfinite(half_widths).all(axis=1)
    if not stated.any():
        return
    pairs = zip(centres[stated], 2.0 * half_widths[stated], strict=True)
    ellipses = [Ellipse((x, y), width, height) for (x, y), (width, height) in pairs]
    axes.add_collection(PatchCollection(ellipses, facecolors="#0b6e4f", edgecolors="none", alpha=0.06))
    axes.scatter([], [], color="#0b6e4f", alpha=0.3, label="95 % interval")


def _draw_shape(axes: Axes, closing: ShiftClosing) -> None:
    if closing.shape is None:
        return
    vertices = np.array(closing.shape.vertices)[:, :2] * MILLIMETRES
    quads = [vertices[list(face)] for face in closing.shape.faces]
    axes.add_collection(PolyCollection(quads, facecolors="#dfe9e3", edgecolors="#b9cbc1", linewidths=0.25))
