# SPDX-License-Identifier: Apache-2.0
"""Page Fingers: shape coloured by strain, joints predicted and measured, residual and its CUSUM, contact."""

from __future__ import annotations

import functools
import math

from nicegui import ui

from softgrip_panel.model.explain import explain_residual
from softgrip_panel.model.facts import FingerView, ResidualView
from softgrip_panel.model.residuals import ResidualSample, WatchLimits
from softgrip_panel.web.charts import statistic_chart, tip_chart
from softgrip_panel.web.parts import card, fill, table, verdict_cell
from softgrip_panel.web.shell import Page, element, text_element

#: Of a chart: its vertical axis, its curves, its limits.
STATISTIC_WORDS = (
    "fingers.statistic", "fingers.friction", "fingers.stiffness", "fingers.limit_low", "fingers.limit_high",
)  # fmt: skip


def fingers_page(page: Page) -> None:
    """Make the page's own part."""
    ui.add_head_html('<script type="module" src="/assets/shape.js"></script>')
    with element("div", classes="columns"):
        with element("div", classes="column"), card(page, "fingers.shape", "shape-card"):
            element(
                "canvas", id="shape", width="720", height="560", tabindex="0", role="img",
                aria_label=page.t("fingers.shape_aria"),
            )  # fmt: skip
            text_element("p", page.t("fingers.no_shape"), "note", id="shape-said")
            text_element("p", page.t("fingers.shape_hint"), "note")
        with element("div", classes="column"):
            _joints(page)
            _residuals(page)
            _contacts(page)


def _joints(page: Page) -> None:
    with card(page, "fingers.joints", "joints"):
        body = table(page, "fingers.finger", "fingers.predicted", "fingers.measured")

        def rows() -> tuple[tuple[str, str, str], ...]:
            measured = {one.name: one for one in page.state.measured}
            return tuple(
                (one.name, _angles(one), _angles(measured[one.name]) if one.name in measured else "-")
                for one in page.state.predicted
            )

        page.shown.parts(body, rows, fill)


def _angles(finger: FingerView) -> str:
    return "  ".join(f"{math.degrees(angle):.0f}°" for angle in finger.joint_angles_rad)


def _residuals(page: Page) -> None:
    with card(page, "fingers.residual", "residuals"):
        body = table(
            page,
            "fingers.finger",
            "fingers.tip",
            "fingers.cusum_friction",
            "fingers.cusum_stiffness",
            "fingers.verdict",
        )

        def rows() -> tuple[tuple[ResidualView, str, bool], ...]:
            found = [page.state.residuals[name] for name in sorted(page.state.residuals)]
            return tuple((one, *explain_residual(one, page.state.cell)) for one in found)

        def write(found: tuple[tuple[ResidualView, str, bool], ...]) -> None:
            for one, said, is_good in found:
                with element("tr"):
                    text_element("th", one.finger, scope="row")
                    text_element("td", f"{1e3 * one.tip_error_m:.1f} mm ({one.tip_error_percent:.1f} %)")
                    text_element("td", f"{one.cusum_friction:.1f}")
                    text_element("td", f"{one.cusum_stiffness:.1f}")
                    verdict_cell(page.t(said) if said else one.verdict, one.reason, is_good=is_good)

        page.shown.parts(body, rows, write)
        page.shown.text(text_element("p", "", "note", id="watch-limits"), lambda: _limits_text(page))
        holder = element("div", classes="drawing", id="residual-charts")
        page.shown.parts(holder, lambda: _history(page), lambda seen: _draw_history(page, *seen))


_Fingers = tuple[tuple[str, tuple[ResidualSample, ...]], ...]


def _history(page: Page) -> tuple[_Fingers, WatchLimits]:
    """Return what the charts depend on: the kept samples of each finger, and the limits."""
    history = page.state.residual_history
    with page.state.locked():
        fingers = tuple((name, history.samples(name)) for name in history.fingers)
    return fingers, page.state.watch_limits


def _draw_history(page: Page, fingers: _Fingers, limits: WatchLimits) -> None:
    if not fingers:
        return
    x_name = page.t("fingers.minutes")
    for name, samples in fingers:
        text_element("h3", name)
        label = page.t("fingers.statistic_aria", finger=name)
        words = [page.t(one) for one in STATISTIC_WORDS]
        ui.html(statistic_chart(samples, limits, label, x_name, words), sanitize=False)
    ui.html(tip_chart(fingers, page.t("fingers.tip_aria"), x_name, page.t("fingers.tip_axis")), sanitize=False)


def _limits_text(page: Page) -> str:
    limits = page.state.watch_limits
    if not limits.kind:
        return page.t("fingers.limits_unknown")
    return page.t(f"fingers.limits_{limits.kind}", low=f"{limits.low:g}", high=f"{limits.high:g}")


def _contacts(page: Page) -> None:
    with card(page, "fingers.contact", "contacts"):
        for number in range(8):
            line = text_element("p")
            page.shown.text(line, functools.partial(_contact_text, page, number))
        text_element("p", page.t("fingers.contact_hint"), "note")


def _contact_text(page: Page, number: int) -> str:
    if number >= len(page.state.tensions):
        return ""
    one = page.state.tensions[number]
    if math.isnan(one.contact_tension_n):
        text = page.t("fingers.contact_unknown", name=one.name)
    else:
        text = page.t("fingers.contact_line", name=one.name, tension=f"{one.contact_tension_n:.0f}")
    judged = page.state.grasps.judged(one.name)
    return f"{text}; {page.t('fingers.contact_judged', state=judged.state)}" if judged else text
