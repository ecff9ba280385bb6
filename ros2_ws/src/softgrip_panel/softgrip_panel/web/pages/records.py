# SPDX-License-Identifier: Apache-2.0
"""Page Finger records: life, checks, age of the calibration, retiring, labels."""

from __future__ import annotations

from datetime import date
from html import escape
from typing import Any
from urllib.parse import quote

import segno
from nicegui import ui

from softgrip_panel.model import acts
from softgrip_panel.model.facts import FingerRecordView
from softgrip_panel.model.records import check_age_days, life_share
from softgrip_panel.model.roles import Role
from softgrip_panel.texts import Texts
from softgrip_panel.web.charts import check_chart
from softgrip_panel.web.parts import card, table
from softgrip_panel.web.shell import Page, element, text_element


def records_page(page: Page) -> None:
    """Make the page's own part."""
    with card(page, "records.list", "records"):
        body = table(
            page,
            "records.serial",
            "records.fits",
            "records.state",
            "records.life",
            "records.checked",
            "records.material",
            "records.acts",
            is_whole=True,
        )

        page.shown.rows(body, lambda: page.state.fingers, tuple, lambda one: _row(page, one))


def _row(page: Page, record: FingerRecordView) -> Any:
    with element("tr", data_serial=record.serial) as made:
        text_element("th", record.serial, "serial", scope="row")
        text_element("td", f"{record.profile} {record.finger}")
        with element("td"):
            text_element("span", record.state, "bad" if record.objection else "good")
            if record.objection:
                text_element("p", record.objection, "note")
        with element("td"):
            share = life_share(record)
            with element("div", classes="life", aria_hidden="true"):
                element("div", style=f"width: {100.0 * share:.0f}%")
            text_element("span", page.t("records.cycles", cycles=record.cycles, limit=record.cycle_limit))
        age = check_age_days(record, date.today())  # noqa: DTZ011  a person's day
        with element("td"):
            text_element("span", page.t("records.never") if age is None else page.t("records.days", days=age))
            if record.check:
                page.button("records.check", lambda: _show_check(page, record), "small", name=f"check-{record.serial}")
        with element("td"):
            text_element("span", f"{record.material}, {record.cable}, ")
            text_element("span", record.printed, "whole")
        with element("td"), element("div", classes="row"):
            text_element(
                "a", page.t("records.label"), "export", href=f"/label/{quote(record.serial, safe='')}", target="_blank"
            )
            if page.person.role >= Role.ENGINEER and record.state != "retired":
                page.button(
                    "records.retire", lambda: _ask_retire(page, record), "small", name=f"retire-{record.serial}"
                )
    return made


def _show_check(page: Page, record: FingerRecordView) -> None:
    """Show the empty closing of the last check: what the next one is compared with."""
    with ui.dialog() as dialog, ui.card().classes("dialog"):
        text_element("h2", page.t("records.check_title", serial=record.serial))
        with element("div", classes="drawing"):
            label = page.t("records.check_aria", serial=record.serial)
            chart = check_chart(record.check, label, page.t("records.check_x"), page.t("records.check_y"))
            ui.html(chart, sanitize=False)
        text_element("p", page.t("records.check_note"), "note")
        page.button("records.close", dialog.close, "big", name="check-close")
    dialog.open()


def _ask_retire(page: Page, record: FingerRecordView) -> None:
    with ui.dialog() as dialog, ui.card().classes("dialog"):
        text_element("h2", page.t("records.retire_title", serial=record.serial))
        text_element("p", page.t("records.retire_note"))
        reason = ui.input(page.t("records.reason")).props("outlined autofocus").classes("grow retire-reason")

        page.commands(acts.retire_finger(record.serial, page.person.name, page.t("records.reason")))

        def retire() -> None:
            page.begin_act(acts.retire_finger(record.serial, page.person.name, str(reason.value or "")))
            dialog.close()

        page.button("records.retire", retire, "loud big", name="retire-confirm")
    dialog.open()


def label_html(record: FingerRecordView, t: Texts) -> str:
    """Return a label to print: the serial as text and as QR code, and which finger it is."""
    code = segno.make(record.serial, error="m", micro=False).svg_inline(scale=4, dark="#000", light="#fff")
    words = f"{record.profile} / {record.finger}, {record.printed}"
    return (
        f'<!doctype html><html lang="{escape(t.language)}"><head><meta charset="utf-8">'
        f"<title>{escape(record.serial)}</title><style>body{{font:16px system-ui,sans-serif;"
        "margin:4mm;color:#000;background:#fff}strong{font-size:24px}svg{display:block}"
        "@page{size:62mm 40mm;margin:2mm}</style></head><body><main>"
        f'<div role="img" aria-label="{escape(t("records.code", serial=record.serial))}">{code}</div>'
        f"<strong>{escape(record.serial)}</strong><p>{escape(words)}</p></main></body></html>"
    )
