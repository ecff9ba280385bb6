# SPDX-License-Identifier: Apache-2.0
"""Page Cell: what the cell does now, what is wrong with it, and the acts that everybody needs."""

from __future__ import annotations

import functools
import math

from nicegui import ui

from softgrip_panel.model import acts
from softgrip_panel.model.alarms import Alarm
from softgrip_panel.model.explain import explain_reset
from softgrip_panel.model.roles import Role
from softgrip_panel.model.state import Notice
from softgrip_panel.web.parts import card, row
from softgrip_panel.web.shell import ChoiceField, Page, clock_text, element, text_element

#: So many tendons are told in words.
MAX_TENDONS = 8


def cell_page(page: Page) -> None:
    """Make the page's own part."""
    with element("div", classes="columns"):
        with element("div", classes="column"):
            _camera(page)
            _tensions(page)
            _counters(page)
        with element("div", classes="column"):
            _facts(page)
            _alarms(page)
            _actions(page)
            _notices(page)


def _camera(page: Page) -> None:
    with card(page, "cell.camera"):
        element("canvas", id="camera", width="640", height="480", role="img", aria_label=page.t("cell.camera_aria"))
        with element("p", classes="legend"):
            text_element("span", page.t("cell.predicted"), "predicted")
            text_element("span", page.t("cell.measured"), "measured")
            text_element("span", page.t("cell.no_picture"), id="no-picture")


def _tensions(page: Page) -> None:
    with card(page, "cell.tensions"):
        element("canvas", id="tensions", width="640", height="190", role="img", aria_label=page.t("cell.tensions_aria"))
        text_element("p", page.t("cell.tensions_hint"), "note")
        with element("ul", classes="hidden-list", id="tension-list"):
            for number in range(MAX_TENDONS):
                line = text_element("li")
                page.shown.text(line, functools.partial(_tension_text, page, number))
                page.shown.visible(line, functools.partial(_has_tendon, page, number))


def _has_tendon(page: Page, number: int) -> bool:
    return number < len(page.state.tensions)


def _tension_text(page: Page, number: int) -> str:
    """Return one tendon in words, rounded so that a resting hand changes nothing here."""
    if not _has_tendon(page, number):
        return ""
    one = page.state.tensions[number]
    free = "?" if math.isnan(one.free_tension_n) else f"{one.free_tension_n:.0f}"
    return page.t(
        "cell.tension",
        name=one.name,
        tension=f"{one.tension_n:.0f}",
        free=free,
        pulled=f"{one.pulled_length_m * 1e3:.0f}",
    )


def _facts(page: Page) -> None:
    state = page.state
    with card(page, "cell.title", "facts"), element("dl", classes="pairs"):
        row(page, "cell.set", lambda: _set_text(page), "finger-set")
        row(
            page,
            "cell.product",
            lambda: (state.cell.product if state.cell else "") or page.t("cell.no_product"),
            "product",
        )
        row(page, "cell.owner", lambda: _owner_text(page), "tendon-owner")
        page.shown.text(text_element("dd", "", "wide", id="reason"), lambda: _reason_text(page))


def _set_text(page: Page) -> str:
    cell = page.state.cell
    if cell is None or not any(one.serial for one in cell.mounted):
        return page.t("cell.no_set")
    serials = ", ".join(f"{one.slot} {one.serial or '-'} ({one.state})" for one in cell.mounted)
    return f"{cell.finger_set or page.t('cell.no_set')}: {serials}"


def _owner_text(page: Page) -> str:
    owners = sorted({one.owner for one in page.state.owners if one.owner})
    return ", ".join(owners) or page.t("cell.no_owner")


def _reason_text(page: Page) -> str:
    cell, safety = page.state.cell, page.state.safety
    parts = [cell.fault, cell.reason] if cell else []
    if safety is not None and safety.estop:
        parts.insert(0, safety.estop_reason)
    return "; ".join(filter(None, parts))


def _actions(page: Page) -> None:
    state, shown = page.state, page.shown
    with card(page, "cell.actions", "acts"):
        reset = page.button("reset.button", lambda: _ask_reset(page), "loud", name="reset")
        shown.visible(reset, lambda: state.safety is not None and state.safety.estop)
        shown.enabled(reset, lambda: page.may_act)
        if page.person.role < Role.OPERATE:
            return
        with element("div", classes="row"):
            product = product_choice(page)
            lift = ui.checkbox(page.t("cell.lift"), value=False)
            trial = ui.checkbox(page.t("cell.trial"), value=False)

        def hold() -> None:
            if product.value:
                page.begin_act(acts.grasp(product.value, confirm_lift=bool(lift.value), trial=bool(trial.value)))

        with element("div", classes="row"):
            button = page.button("cell.hold", hold, "big", page.t("cell.hold_hint"))
            shown.enabled(button, lambda: page.may_act and _is_idle(page))
            page.button("cell.release", page.do(acts.release()), "big")
            cancel = page.button("cell.cancel", lambda: page.desk.stop_action(page.person, "grasp"))
            shown.visible(cancel, lambda: state.cell is not None and state.cell.mode == "GRASPING")
            home = page.button("cell.home", page.do(acts.home()))
            shown.enabled(home, lambda: page.may_act and _is_idle(page))
        text_element("p", page.t("cell.release_hint"), "note", id="release-hint")
        _emulated(page, product)
        page.commands(acts.estop(), acts.release(), acts.grasp("egg", confirm_lift=False), acts.home())


def product_choice(page: Page) -> ChoiceField:
    """Return a choice among the products of the cell, which may be heard of later."""
    choice = ChoiceField(page.t("cell.hold_what"), {})
    page.shown.follow_value(
        lambda: page.state.products, lambda products: choice.set_options({one: one for one in products})
    )
    return choice


def _emulated(page: Page, product: ChoiceField) -> None:
    """Make the emulated hands; shown where there are such."""
    with element("div", classes="emulated", id="emulated") as part:
        text_element("h3", page.t("emulated.title"))
        text_element("p", page.t("emulated.note"), "note")
        with element("div", classes="row"):
            place = page.button("emulated.place", lambda: page.begin_act(acts.place_object(product.value or "")))
            away = page.button("emulated.take_away", page.do(acts.place_object("")))
            for button in (place, away):
                page.shown.enabled(button, lambda: page.may_act)
    page.shown.visible(part, lambda: page.state.is_emulated)


def _is_idle(page: Page) -> bool:
    cell, safety = page.state.cell, page.state.safety
    return cell is not None and cell.mode in {"IDLE", "HOLDING"} and not (safety and (safety.estop or safety.locked))


def _ask_reset(page: Page) -> None:
    with ui.dialog() as dialog, ui.card().classes("dialog"):
        text_element("h2", page.t("reset.title"))
        for key, values in explain_reset(page.state.safety, page.state.tendons):
            text_element("p", page.t(key, **values))
        page.commands(acts.estop_reset())

        def reset() -> None:
            dialog.close()
            page.begin_act(acts.estop_reset())

        page.button("reset.button", reset, "loud big", name="reset-confirm")
    dialog.open()


def _alarms(page: Page) -> None:
    with card(page, "alarms.title", "alarms"):
        none = text_element("p", page.t("alarms.none"), "note")
        page.shown.visible(none, lambda: not page.state.alarms.active)
        holder = element("ul", classes="alarms", aria_live="polite")

        def write(alarms: tuple[Alarm, ...]) -> None:
            for alarm in alarms:
                _alarm(page, alarm)

        page.shown.parts(holder, lambda: page.state.alarms.active[:20], write)
        remarks = element("div", id="remarks")

        def write_remarks(titles: tuple[str, ...]) -> None:
            if titles:
                text_element("p", page.t("alarms.remarks"), "note")
            for title in titles:
                text_element("p", title, "note")

        page.shown.parts(remarks, lambda: _remarks(page), write_remarks)
        with element("details"):
            text_element("summary", page.t("alarms.history"))
            over = element("ul")

            def write_over(alarms: tuple[Alarm, ...]) -> None:
                for alarm in alarms:
                    text = f"{clock_text(alarm.raised_s)} {alarm.fact.title}; "
                    text_element("li", text + page.t("alarms.acknowledged", name=alarm.acknowledged_by))

            page.shown.parts(over, lambda: page.state.alarms.history[:20], write_over)


def _remarks(page: Page) -> tuple[str, ...]:
    return tuple(f"{one.source}: {one.title}" for one in page.state.alarms.remarks)[:10]


def _alarm(page: Page, alarm: Alarm) -> None:
    t = page.t
    with element("li", classes="alarm", data_level=alarm.fact.level.value, data_stage=alarm.stage.value):
        text_element("strong", alarm.fact.title)
        when = f"{t(f'alarms.{alarm.stage.value}')}, {t('alarms.since', time=clock_text(alarm.raised_s))}"
        if alarm.times > 1:
            when += f", {t('alarms.times', times=alarm.times)}"
        text_element("p", f"{alarm.fact.source}: {when}", "note")
        if alarm.fact.cause:
            text_element("p", f"{t('alarms.cause')}: {alarm.fact.cause}")
        if alarm.fact.remedy:
            text_element("p", f"{t('alarms.remedy')}: {alarm.fact.remedy}")
        if alarm.acknowledged_by:
            text_element("p", t("alarms.acknowledged", name=alarm.acknowledged_by), "note")
        elif page.person.role >= Role.OPERATE:
            page.button("alarms.acknowledge", lambda: page.desk.acknowledge(page.person, alarm.key), "small")


def _counters(page: Page) -> None:
    names = ("picks", "gripped", "empty", "slipped", "tendon_faults", "aborted", "swaps")
    with card(page, "counters.title"), element("dl", classes="pairs tight"):
        for name in names:
            row(page, f"counters.{name}", lambda name=name: str(getattr(page.state.cell, name, 0)), f"count-{name}")
        row(page, "counters.quality", lambda: _share(page.state.cell.quality if page.state.cell else math.nan))
        row(
            page, "counters.availability", lambda: _share(page.state.cell.availability if page.state.cell else math.nan)
        )


def _share(value: float) -> str:
    return "-" if math.isnan(value) else f"{100.0 * value:.0f} %"


def _notices(page: Page) -> None:
    with card(page, "notices.title"):
        holder = element("ol", classes="notices", reversed="")

        def write(notices: tuple[Notice, ...]) -> None:
            for notice in reversed(notices):
                text_element("li", f"{clock_text(notice.at_s)} {page.notice_text(notice)}")

        page.shown.parts(holder, lambda: tuple(page.state.notices)[-8:], write)
