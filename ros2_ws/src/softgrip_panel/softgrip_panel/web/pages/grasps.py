# SPDX-License-Identifier: Apache-2.0
"""Page Grasps: every grasp with verdict, reason, curve and pictures; filter and export."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import asdict
from typing import Any
from urllib.parse import urlencode

from nicegui import ui

from softgrip_panel.model.facts import CountedView
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


def _list(page: Page, show: Callable[[CountedView | int], None]) -> None:
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


def _row(page: Page, row: GraspRow, show: Callable[[CountedView | int], None]) -> Any:
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
            found = row.counted if row.number is None else row.number
            name = f"counted-{row.at_s:.0f}" if row.number is None else str(row.number)
            if found is not None:
                page.button("grasps.show", lambda: show(found), "small", name=f"show-{name}")
    return made


def _detail_holder(page: Page) -> Callable[[CountedView | int], None]:
    with card(page, "grasps.detail", "grasp-detail"):
        holder = element("div")
        with holder:
            text_element("p", page.t("grasps.choose"), "note")

        def show(found: CountedView | int) -> None:
            holder.clear()
            with holder:
                if isinstance(found, CountedView):
                    _counted_detail(page, found)
                    return
                record = page.state.grasps.find(found)
                if record is None:
                    text_element("p", page.t("grasps.gone"), "note")
                else:
                    _detail(page, record)

    return show


def _counted_detail(page: Page, counted: CountedView) -> None:
    """Show what the database alone knows of a grasp: by what it was decided and when, without a curve."""
    _verdict(page, counted)
    if math.isfinite(counted.decided_stamp_s):
        before_s = counted.at_s - counted.decided_stamp_s
        at = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(counted.decided_stamp_s))
        text_element("p", page.t("grasps.decided_at", at=at, before=before_s), id="decided-at")
    text_element("p", page.t("grasps.unseen"), "note")


def _verdict(page: Page, found: GraspRecord | CountedView) -> None:
    text_element("p", f"{found.product}: {found.outcome}", "instruction verdict", data_state=found.outcome)
    text_element("p", found.reason)
    if any(found.serials):
        text_element("p", page.t("grasps.by", finger_set=found.finger_set, serials=", ".join(found.serials)))
    for one in found.fingers:
        text = page.t(
            "grasps.decided", finger=one.finger, state=one.state, tension=one.contact_tension_n, level=one.threshold_n
        )
        text_element("p", text, "note")


def _detail(page: Page, record: GraspRecord) -> None:
    _verdict(page, record)
    if record.decided_s is not None:
        text_element("p", page.t("grasps.decided_after", after=record.decided_s), id="decided-after")
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
