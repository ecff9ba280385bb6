# SPDX-License-Identifier: Apache-2.0
"""Page Grasps: every grasp with verdict, reason, curve and pictures; filter and export."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from typing import Any
from urllib.parse import urlencode

from nicegui import ui

from softgrip_panel.model.grasps import GraspRecord
from softgrip_panel.model.records import GraspFilter, GraspRow, grasp_rows
from softgrip_panel.web.parts import card, table
from softgrip_panel.web.shell import ChoiceField, Page, clock_text, element, text_element

OUTCOMES = ("", "GRIPPED", "EMPTY", "SLIPPED", "TENDON_FAULT", "ABORTED")
#: So many rows are drawn; the export has them all.
MAX_ROWS = 100
MOMENTS = {"before": "grasps.before", "at": "grasps.at_verdict", "after": "grasps.after"}


def grasps_page(page: Page) -> None:
    """Make the page's own part."""
    with element("div", classes="columns"):
        with element("div", classes="column"):
            shown_grasp = _detail_holder(page)
        with element("div", classes="column"):
            _list(page, shown_grasp)


def _list(page: Page, show: object) -> None:
    with card(page, "grasps.list", "grasps"):
        with element("div", classes="row"):
            product = ui.input(page.t("grasps.product")).props("outlined dense").classes("grow")
            serial = ui.input(page.t("grasps.finger")).props("outlined dense").classes("grow")
            outcome = ChoiceField(page.t("grasps.verdict"), {one: one or page.t("grasps.every") for one in OUTCOMES})
        export = text_element("a", page.t("grasps.export"), "export", id="export", download="grasps.csv")
        body = table(page, "grasps.at", "grasps.product", "grasps.set", "grasps.verdict", "grasps.show")

        none = text_element("p", page.t("grasps.none"), "note")

        def chosen() -> GraspFilter:
            return GraspFilter(str(product.value or ""), str(serial.value or ""), outcome.value)

        page.shown.state(export, lambda: f"/grasps.csv?{urlencode(asdict(chosen()))}", "href")

        def look() -> tuple[object, ...]:
            """Return what the list depends on; the list itself is made only when that has changed."""
            return page.state.grasps.version, page.state.counted, chosen()

        def list_rows(seen: tuple[Any, ...]) -> list[GraspRow]:
            rows = grasp_rows(page.state.grasps.records, page.state.counted)
            found = [row for row in rows if seen[2].admits(row)][:MAX_ROWS]
            none.set_visibility(not found)
            return found

        page.shown.rows(body, look, list_rows, lambda row: _row(page, row, show))


def _row(page: Page, row: GraspRow, show: object) -> Any:
    with element("tr") as made:
        text_element("td", clock_text(row.at_s), "whole")
        text_element("td", row.product)
        with element("td"):
            for part in (row.finger_set, *row.serials):
                text_element("span", part, "whole")
        with element("td"):
            text_element("span", row.outcome or "...", "verdict", data_state=row.outcome)
            text_element("p", row.reason)
        with element("td"):
            if row.number is not None and callable(show):
                number = row.number
                page.button("grasps.show", lambda: show(number), "small", name=f"show-{number}")
    return made


def _detail_holder(page: Page) -> object:
    with card(page, "grasps.detail", "grasp-detail"):
        holder = element("div")
        with holder:
            text_element("p", page.t("grasps.choose"), "note")

        def show(number: int) -> None:
            record = page.state.grasps.find(number)
            holder.clear()
            with holder:
                if record is None:
                    text_element("p", page.t("grasps.gone"), "note")
                else:
                    _detail(page, record)

    return show


def _detail(page: Page, record: GraspRecord) -> None:
    text_element("p", f"{record.product}: {record.outcome}", "instruction verdict", data_state=record.outcome)
    text_element("p", record.reason)
    for one in record.fingers:
        text = page.t(
            "grasps.decided", finger=one.finger, state=one.state, tension=one.contact_tension_n, level=one.threshold_n
        )
        text_element("p", text, "note")
    element(
        "canvas",
        id="curve",
        width="640",
        height="300",
        role="img",
        aria_label=page.t("grasps.curve_aria"),
        data_curve=curve_json(record),
    )
    text_element("p", page.t("grasps.curve_hint"), "note")
    with element("div", classes="pictures"):
        for moment, key in MOMENTS.items():
            if moment in record.pictures:
                with element("figure"):
                    source = f"/grasps/{record.number}/{moment}.jpg"
                    element("img", src=source, alt=page.t(key), width="320", height="240")
                    text_element("figcaption", page.t(key))


def curve_json(record: GraspRecord) -> str:
    """Return tendons, samples [s, N ..., N ...] and the deciding moment [s] for the drawing."""
    samples = [
        [round(one.at_s, 2), *(_plain(value) for value in (*one.tension_n, *one.free_tension_n))]
        for one in record.samples
    ]
    return json.dumps({"tendons": record.tendons, "samples": samples, "decided": record.decided_s})


def _plain(value: float) -> float | None:
    return round(value, 2) if math.isfinite(value) else None
