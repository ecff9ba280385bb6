# SPDX-License-Identifier: Apache-2.0
"""Page Set-up, parameters: of each node, with description and bounds; what may change while it runs can be set."""

from __future__ import annotations

from typing import Any

from nicegui import background_tasks, ui

from softgrip_panel.errors import PanelError
from softgrip_panel.model import acts
from softgrip_panel.model.acts import ActResult
from softgrip_panel.model.parameters import ParameterView
from softgrip_panel.model.roles import Role
from softgrip_panel.web.parts import card, table
from softgrip_panel.web.shell import ChoiceField, Page, element, text_element


class _Parameters:
    """What one browser looks at."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.node = ""
        self.found: tuple[ParameterView, ...] = ()
        self.part = ""

    async def read(self, say: Any) -> None:
        """Ask the node that is chosen."""
        reader = self.page.site.parameters
        if reader is None or not self.node:
            return
        try:
            self.found = await reader.read(self.node)
            say("")
        except PanelError as error:
            self.found = ()
            say(str(error))

    def rows(self) -> tuple[ParameterView, ...]:
        """Return those whose name or description has the part that is looked for."""
        part = self.part.lower()
        return tuple(one for one in self.found if part in one.name.lower() or part in one.description.lower())


def parameters_card(page: Page) -> None:
    """Make the card."""
    work = _Parameters(page)
    with card(page, "setup.parameters", "parameters"):
        text_element("p", page.t("setup.parameters_how"), "note")
        problem = text_element("p", "", "problem", role="alert", id="parameter-problem")
        with element("div", classes="row"):
            node = ChoiceField(page.t("setup.node"), {})
            part = ui.input(page.t("setup.part")).props("outlined dense").classes("grow")

            def read() -> None:
                work.node = node.value
                background_tasks.create(work.read(problem.set_text))

            page.button("setup.read", read, "big", name="read-parameters")
        body = table(page, "setup.parameter", "setup.value", "setup.bounds", "setup.meaning", "setup.change")

        def look() -> tuple[ParameterView, ...]:
            work.part = str(part.value or "")
            return work.rows()

        def write(found: tuple[ParameterView, ...]) -> None:
            for one in found:
                _row(work, one, problem.set_text)

        page.shown.parts(body, look, write)
        page.shown.follow_value(lambda: page.state.nodes, lambda names: node.set_options({one: one for one in names}))


def _row(work: _Parameters, one: ParameterView, say: Any) -> None:
    page = work.page
    with element("tr"):
        text_element("th", one.name, scope="row")
        text_element("td", one.text)
        text_element("td", one.bounds or "-")
        text_element("td", one.description, "why")
        with element("td"):
            if not one.is_changeable:
                text_element("span", page.t("setup.at_start"), "note")
            elif page.person.role >= Role.ENGINEER:
                page.button("setup.set", lambda: _ask(work, one, say), "small", name=f"set-{one.name}")


def _ask(work: _Parameters, one: ParameterView, say: Any) -> None:
    page, node = work.page, work.node
    with ui.dialog() as dialog, ui.card().classes("dialog"):
        text_element("h2", page.t("setup.set_title", node=node, name=one.name))
        text_element("p", one.description)
        text_element("p", one.bounds, "note")
        value = ui.input(page.t("setup.value"), value=one.text).props("outlined autofocus").classes("grow new-value")
        problem = text_element("p", "", "problem", role="alert")

        def then(result: ActResult) -> None:
            say("" if result.success else result.message)
            background_tasks.create(work.read(lambda text: say(text) if text else None))

        def change() -> None:
            try:
                typed = one.read(str(value.value if value.value is not None else ""))
            except PanelError as error:
                problem.set_text(str(error))
                return
            dialog.close()
            page.begin_act(acts.set_parameter(node, one.name, one.kind, typed), then)

        page.button("setup.set", change, "loud big", name="set-confirm")
        page.commands(acts.set_parameter(node, one.name, one.kind, one.value))
    dialog.open()
