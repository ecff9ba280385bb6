# SPDX-License-Identifier: Apache-2.0
"""Figures of a fit, as Figs 3.4 and 3.5 of the thesis, with residuals."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from softgrip_model.friction.fit import Fit, capstan_per_load, errors
from softgrip_model.friction.laws import GRAVITY, Law

_TITLES = {Law.CAPSTAN: "Capstan, one mu a load", Law.HEAP: "Heap et al.", Law.MATTE: "Matte"}
STYLE = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "svg.hashsalt": "softgrip",
}


def draw_fits(fits: Mapping[Law, Fit], path: Path, title: str = "") -> None:
    """Draw T1/T2 over the angle, one panel a law, one curve a load (Fig 3.4).

    Args:
        fits: of the same points.
        path: image to write; its suffix chooses the format.
        title: above all panels.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(3.4 * len(fits), 3.4), layout="constrained")
        panels = figure.subplots(1, len(fits), sharey=True, squeeze=False)[0]
        for axes, (law, fit) in zip(panels, fits.items(), strict=True):
            _draw_law(axes, fit, law)
        panels[0].set_ylabel("T1 / T2")
        panels[-1].legend(title="T2", fontsize=8)
        if title:
            figure.suptitle(title)
        figure.savefig(path, dpi=130)


def draw_residuals(fits: Mapping[Law, Fit], path: Path) -> None:
    """Draw relative residuals over angle and load, one colour a law."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.0, 3.0), layout="constrained")
        over_angle, over_load = figure.subplots(1, 2, sharey=True)
        for number, (law, fit) in enumerate(fits.items()):
            percent = 100.0 * np.expm1(fit.residuals)
            shift = 0.6 * (number - 0.5 * (len(fits) - 1))
            over_angle.plot(np.degrees(fit.points.angle) + shift, percent, "o", ms=3, color=f"C{number}")
            load = 1e3 * fit.points.tension_low / GRAVITY
            over_load.plot(
                load + 8.0 * shift, percent, "o", ms=3, color=f"C{number}", label=_TITLES[law].partition(",")[0]
            )
        for axes, label in ((over_angle, "wrap angle [deg]"), (over_load, "load [g]")):
            axes.axhline(0.0, color="0.6", lw=0.8)
            axes.set_xlabel(label)
        over_angle.set_ylabel("measured - fitted [%]")
        over_load.legend(fontsize=8)
        figure.savefig(path, dpi=130)


def _draw_law(axes: Axes, fit: Fit, law: Law) -> None:
    points = fit.points
    angles = np.linspace(0.0, 1.05 * float(points.angle.max()), 100)
    loads = np.unique(points.tension_low.round(6))
    # As the thesis does: the capstan law knows no load, so it gets one mu for each.
    predicted = fit.law.ratio(points.angle, points.tension_low)
    for number, load in enumerate(loads):
        here = np.isclose(points.tension_low, load, rtol=1e-4)
        curve = fit.law
        if law is Law.CAPSTAN:
            curve = curve.with_coefficients(capstan_per_load(points.subset(np.flatnonzero(here)))[1].mean())
            predicted[here] = curve.ratio(points.angle[here], load)
        axes.plot(np.degrees(angles), curve.ratio(angles, load), color=f"C{number}", lw=1.2)
        axes.plot(
            np.degrees(points.angle[here]), points.ratio[here], "o", ms=3.5, color=f"C{number}", label=f"{load:.2f} N"
        )
    axes.set_title(f"{_TITLES[law]}: {100 * errors(predicted, points.ratio)[0]:.1f} % average error", fontsize=9)
    axes.set_xlabel("wrap angle [deg]")
