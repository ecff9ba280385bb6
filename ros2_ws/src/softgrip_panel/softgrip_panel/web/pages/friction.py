# SPDX-License-Identifier: Apache-2.0
"""Page Friction: the guided measurement, its points and fit, the list of models."""

from __future__ import annotations

import math
from collections.abc import Callable, Coroutine, Sequence
from typing import Any

from nicegui import ui

from softgrip_panel.model import acts
from softgrip_panel.model.acts import Act, ActResult
from softgrip_panel.model.friction import FrictionModelView, Refusal, RigPoint, RigProgress, fit_picture
from softgrip_panel.model.roles import Person, Role
from softgrip_panel.web.charts import fit_chart
from softgrip_panel.web.drawings import rig_drawing
from softgrip_panel.web.parts import card, table, verdict_cell
from softgrip_panel.web.shell import ChoiceField, Page, element, text_element

PLANS = ("9", "adaptive", "45")


def friction_page(page: Page) -> None:
    """Make the page's own part."""
    shown_model = ShownModel(page)
    with element("div", classes="columns"):
        with element("div", classes="column"):
            _now(page)
            if page.person.role >= Role.OPERATE:
                _start(page)
        with element("div", classes="column"):
            _fit(page, shown_model)
            _points(page)
    _models(page, shown_model)


class ShownModel:
    """Which model the picture shows: the one that somebody chose here, else the last fit, else the active one."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._chosen = ""

    def choose(self, model: str) -> None:
        """Show a model of the list from now on."""
        self._chosen = model

    @property
    def view(self) -> FrictionModelView | None:
        """The model; None where none is known."""
        state = self._page.state
        known = {one.id: one for one in state.friction_models}
        candidates = (self._chosen, "" if state.rig.is_running else state.rig.fitted, state.friction_active)
        return next((known[one] for one in candidates if one in known), None)


def _now(page: Page) -> None:
    shown = page.shown
    with card(page, "friction.now", "rig"):
        text = text_element("p", "", "instruction", id="rig-instruction", role="status", aria_live="assertive")
        shown.text(text, lambda: _instruction(page))
        shown.text(text_element("p", "", "clock"), lambda: _count(page.state.rig))
        holder = element("div", classes="drawing")

        def draw(place: tuple[float, float] | None) -> None:
            if place is not None:
                ui.html(rig_drawing(*place, page.t("friction.drawing")), sanitize=False)

        shown.parts(
            holder,
            lambda: (page.state.rig.angle_rad, page.state.rig.load_kg) if page.state.rig.is_running else None,
            draw,
        )
        if page.person.role < Role.OPERATE:
            return
        with element("div", classes="row"):
            done = page.button("friction.done", lambda: _confirm(page), "big", name="rig-done")
            shown.visible(done, lambda: page.state.rig.needs_confirmation)
            shown.enabled(done, lambda: page.may_act)
            cancel = page.button("friction.cancel", lambda: page.desk.stop_action(page.person, "calibrate"))
            shown.visible(cancel, lambda: page.state.rig.is_running)
            accept = page.button(
                "friction.accept", lambda: _ask_activate(page, page.state.rig.fitted), "big", name="accept"
            )
            refuse = page.button(
                "friction.refuse", lambda: _ask_refuse(page, page.state.rig.fitted), "big", name="refuse"
            )
            for button in (accept, refuse):
                shown.visible(button, lambda: _is_to_be_judged(page))
                shown.enabled(button, lambda: page.may_act)


def _is_to_be_judged(page: Page) -> bool:
    """Whether the last measurement fitted a model that nobody has accepted or refused."""
    fitted = page.state.rig.fitted
    return bool(fitted) and page.state.friction_active != fitted and page.state.refusals.find(fitted) is None


def _confirm(page: Page) -> None:
    """Confirm that angle and weight are set; on the emulated rig the emulated hands set them first."""
    rig = page.state.rig

    def then(result: ActResult) -> None:
        if result.success:
            page.begin_act(acts.confirm_rig())

    if page.state.is_emulated:
        page.begin_act(acts.set_rig(rig.angle_rad, rig.load_kg), then)
    else:
        page.begin_act(acts.confirm_rig())


def _start(page: Page) -> None:
    with card(page, "friction.start", "rig-start"):
        text_element("p", page.t("friction.start_hint"), "note")
        with element("div", classes="row"):
            plan = ChoiceField(page.t("friction.plan"), {one: page.t(f"friction.plan_{one}") for one in PLANS})
            cable = ui.input(page.t("friction.cable"), value="PE braid 0.25 mm").props("outlined dense").classes("grow")
            surface = ui.input(page.t("friction.surface"), value="TPU, printed along the layers")
            surface.props("outlined dense").classes("grow")
        with element("div", classes="row"):
            cable_mm = ui.number(page.t("friction.cable_radius"), value=0.125, min=0.01, max=10.0, step=0.005)
            surface_mm = ui.number(page.t("friction.surface_radius"), value=3.0, min=0.1, max=100.0, step=0.1)
            for field in (cable_mm, surface_mm):
                field.props("outlined dense").classes("grow")
            resume = ui.checkbox(page.t("friction.resume"), value=False)

        def begin() -> None:
            page.begin_act(
                acts.calibrate(
                    plan.value,
                    cable=str(cable.value or ""),
                    surface=str(surface.value or ""),
                    cable_radius_m=1e-3 * float(cable_mm.value or 0.0),
                    surface_radius_m=1e-3 * float(surface_mm.value or 0.0),
                    resume=bool(resume.value),
                )
            )

        button = page.button("friction.begin", begin, "big", name="rig-begin")
        page.shown.enabled(button, lambda: page.may_act and not page.state.rig.is_running)
        page.commands(acts.calibrate("9", "PE braid 0.25 mm", "TPU", 0.000125, 0.003, resume=False), acts.confirm_rig())


def _fit(page: Page, chosen: ShownModel) -> None:
    """Draw T1/T2 of a model with its interval beside the points of the last measurement."""
    with card(page, "friction.fit", "friction-fit"):
        page.shown.text(text_element("h3", "", id="fit-model"), lambda: _fit_title(page, chosen.view))
        holder = element("div", classes="drawing")

        def draw(seen: tuple[FrictionModelView | None, tuple[RigPoint, ...]]) -> None:
            picture = fit_picture(*seen)
            label = page.t("friction.fit_aria", points=len(picture.points))
            ui.html(fit_chart(picture, label, page.t("friction.fit_x"), page.t("friction.ratio")), sanitize=False)

        page.shown.parts(holder, lambda: (chosen.view, page.state.rig.points), draw)
        text_element("p", page.t("friction.fit_hint"), "note")


def _fit_title(page: Page, model: FrictionModelView | None) -> str:
    if model is None:
        return page.t("friction.fit_none")
    return page.t("friction.fit_of", model=model.id, verdict=model.verdict, reason=model.reason)


def _points(page: Page) -> None:
    with card(page, "friction.points", "rig-points"):
        body = table(
            page, "friction.angle", "friction.load", "friction.t2", "friction.t1", "friction.ratio", "friction.verdict"
        )

        def write(points: Sequence[RigPoint]) -> None:
            for one in reversed(points):
                with element("tr"):
                    text_element("td", f"{math.degrees(one.angle_rad):.0f}°")
                    text_element("td", f"{one.load_kg:.2f} kg", "whole")
                    text_element("td", f"{one.tension_low_n:.2f} N", "whole")
                    text_element("td", f"{one.tension_high_n:.2f} ± {one.stddev_n:.2f} N", "whole")
                    text_element("td", f"{one.ratio:.3f}")
                    verdict_cell(one.verdict, one.reason, is_good=one.verdict == "ACCEPTED")

        page.shown.parts(body, lambda: page.state.rig.points, write)


def _models(page: Page, chosen: ShownModel) -> None:
    with card(page, "friction.models", "friction-models"):
        body = table(
            page,
            "friction.model",
            "friction.coefficients",
            "friction.error",
            "friction.age",
            "friction.verdict",
            "friction.acts",
        )

        def write(models: Sequence[tuple[FrictionModelView, Refusal | None]]) -> None:
            for one, refusal in models:
                _model(page, one, refusal, chosen)

        def seen() -> tuple[tuple[FrictionModelView, Refusal | None], ...]:
            return tuple((one, page.state.refusals.find(one.id)) for one in page.state.friction_models)

        page.shown.parts(body, seen, write)


def _model(page: Page, model: FrictionModelView, refusal: Refusal | None, chosen: ShownModel) -> None:
    with element("tr"):
        text_element("th", f"{model.id} ({model.law})", "long", scope="row")
        text_element("td", "; ".join(_coefficient(*one) for one in model.coefficients))
        text_element("td", f"{_percent(model.average_error)} / {_percent(model.maximum_error)}, {model.points}")
        text_element("td", page.t("records.days", days=int(model.age_s // 86400)))
        verdict_cell(model.verdict, model.reason, is_good=model.verdict == "USABLE")
        with element("td"):
            if refusal is not None:
                text_element("p", page.t("friction.refused", who=refusal.who, reason=refusal.reason), "problem")
            if model.is_active:
                text_element("span", page.t("friction.active"), "good")
            page.button("friction.show", lambda: chosen.choose(model.id), "small", name=f"show-{model.id}")
            if page.person.role >= Role.OPERATE and not model.is_active:
                page.button(
                    "friction.activate", lambda: _ask_activate(page, model.id), "small", name=f"activate-{model.id}"
                )
                if refusal is None:
                    page.button(
                        "friction.refuse", lambda: _ask_refuse(page, model.id), "small", name=f"refuse-{model.id}"
                    )


def _percent(share: float) -> str:
    return "?" if math.isnan(share) else f"{100.0 * share:.1f} %"


def _coefficient(name: str, value: float, half_width: float) -> str:
    return f"{name} {value:.4g}" + ("" if math.isnan(half_width) else f" ± {half_width:.2g}")


def _ask_activate(page: Page, model: str) -> None:
    refusal = page.state.refusals.find(model)
    said = page.t("friction.refused", who=refusal.who, reason=refusal.reason) if refusal else ""
    title = page.t("friction.activate_title", model=model)
    _ask_reason(page, "activate", title, model, page.desk.activate_model, acts.activate_friction(model, ""), said)


def _ask_refuse(page: Page, model: str) -> None:
    same = acts.refuse_friction(model, page.person.name, "")
    title = page.t("friction.refuse_title", model=model)
    _ask_reason(page, "refuse", title, model, page.desk.refuse_model, same, page.t("friction.refuse_will"))


def _ask_reason(
    page: Page,
    name: str,
    title: str,
    model: str,
    do: Callable[[Person, str, str], Coroutine[Any, Any, ActResult]],
    same: Act,
    said: str,
) -> None:
    """Ask for the reason of an act on a model, then do it.

    Args:
        page: that asks.
        name: of the act, for its button.
        title: of the question.
        model: id of it.
        do: the act, called with person, model and reason.
        same: the act, for its command.
        said: what is to be known before; "" = nothing.
    """
    with ui.dialog() as dialog, ui.card().classes("dialog"):
        text_element("h2", title)
        if said:
            text_element("p", said)
        reason = ui.input(page.t("records.reason")).props("outlined autofocus").classes(f"grow {name}-reason")
        problem = text_element("p", "", "problem", role="alert")
        page.commands(same)

        def confirmed() -> None:
            if not str(reason.value or "").strip():
                problem.set_text(page.t("friction.reason_missing"))
                return
            page.begin_task(do(page.person, model, str(reason.value)))
            dialog.close()

        page.button(f"friction.{name}", confirmed, "loud big", name=f"{name}-confirm")
    dialog.open()


def _instruction(page: Page) -> str:
    rig = page.state.rig
    if rig.is_running:
        return rig.instruction or page.t("friction.begins")
    return rig.message or page.t("friction.none")


def _count(rig: RigProgress) -> str:
    return f"{rig.index + 1} / {rig.total}" if rig.is_running and rig.total else ""
