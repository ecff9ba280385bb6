# SPDX-License-Identifier: Apache-2.0
"""The shift as one self-contained HTML page."""

from __future__ import annotations

import base64
from typing import TYPE_CHECKING

from jinja2 import Environment, PackageLoader, StrictUndefined

from softgrip_demo import plots, table42
from softgrip_design import trajectory

if TYPE_CHECKING:
    from pathlib import Path

    from softgrip_demo.record import ShiftClosing, ShiftRecord


def figures(record: ShiftRecord, folder: Path) -> dict[str, object]:
    """Return what the page shows beside numbers: drawings as SVG, and the frames of the film, read from ``folder``."""
    return {
        "friction_svg": plots.friction_figure(record.friction),
        "closings": [
            {
                "grasp": c.grasp,
                "joints_svg": plots.joints_figure(c),
                "tip_svg": plots.tip_figure(c),
                "demonstration_svg": _demonstration(c),
            }
            for c in record.closings
            if c.samples
        ],
        "film": [
            {
                "image": _data_url(folder / frame.image),
                "joints": frame.predicted_joints,
                "time": frame.time,
                "tension": frame.tension,
                "predicted_tension": frame.predicted_tension,
            }
            for frame in record.film
        ],
    }


def render(record: ShiftRecord, summary: dict[str, object], drawn: dict[str, object]) -> str:
    """Return the page with its ``figures``."""
    environment = Environment(
        loader=PackageLoader("softgrip_demo"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    return environment.get_template("report.html.j2").render(
        record=record, summary=summary, cross_check=table42.page_view(table42.load()), **drawn
    )


def _demonstration(closing: ShiftClosing) -> str:
    """Return the comparison with a person's hand, empty where none was recorded for the grasp."""
    path = trajectory.SHIPPED / f"hand_{closing.grasp}.csv"
    if not path.exists():
        return ""
    return plots.demonstration_figure(closing, trajectory.load(path).closing("index"))


def _data_url(path: Path) -> str:
    return "data:image/jpeg;base64," + base64.b64encode(path.read_bytes()).decode()
