# SPDX-License-Identifier: Apache-2.0
"""The record of a first run as one page to look at and to print."""

from __future__ import annotations

from jinja2 import Environment, PackageLoader, StrictUndefined

from softgrip_demo.first_run.record import FirstRunRecord


def render(record: FirstRunRecord) -> str:
    """Return the page, self-contained HTML; everything from outside is escaped."""
    environment = Environment(
        loader=PackageLoader("softgrip_demo"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    return environment.get_template("first_run.html.j2").render(record=record, reports=[*record.reports.values()])
