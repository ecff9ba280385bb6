# SPDX-License-Identifier: Apache-2.0
"""What all pages have: stop, mode, control, navigation, warnings, and the last thing that was done."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Coroutine, Mapping
from typing import Any, Final

from nicegui import background_tasks, ui
from starlette.requests import Request

from softgrip_panel.model.acts import Act, ActResult
from softgrip_panel.model.explain import explain_stop
from softgrip_panel.model.roles import Person, Role
from softgrip_panel.model.state import Notice
from softgrip_panel.web.gate import TOKEN, person_of
from softgrip_panel.web.shown import ShownParts
from softgrip_panel.web.site import PERIOD_S, PanelSite

#: Path and text key of every page, in the order of the navigation.
PAGES: Final = {
    "/": "nav.cell",
    "/work": "nav.work",
    "/swap": "nav.swap",
    "/grasps": "nav.grasps",
    "/records": "nav.records",
    "/bags": "nav.bags",
    "/fingers": "nav.fingers",
    "/friction": "nav.friction",
    "/setup": "nav.setup",
}

#: So long a notice lies over the page [s]; page Cell keeps the last ones.
SAID_S: Final = 15.0

_HEAD: Final = '<link rel="stylesheet" href="/assets/panel.css"><script type="module" src="/assets/panel.js"></script>'


def element(tag: str, classes: str = "", **attributes: str) -> Any:
    """Return an HTML element for others to stand in; `data_level` and the like become attributes."""
    return _attributed(ui.element(tag), classes, attributes)


def text_element(tag: str, text: str = "", classes: str = "", **attributes: str) -> Any:
    """Return an HTML element with a text, which is shown as it is, whatever stands in it."""
    made = ui.label(text)
    made.tag = tag
    return _attributed(made, classes, attributes)


def _attributed(made: Any, classes: str, attributes: dict[str, str]) -> Any:
    if classes:
        made.classes(classes)
    for name, value in attributes.items():
        # not by props(), whose one string cannot hold quotes of a text
        made._props[name.replace("_", "-")] = value  # noqa: SLF001
    return made


class ChoiceField:
    """The browser's own list to choose from: it works with keyboard, touch and screen reader everywhere.

    Args:
        label: what is chosen.
        options: value -> text.
    """

    def __init__(self, label: str, options: Mapping[str, str]) -> None:
        self.value = ""
        with element("label", "choice"):
            text_element("span", label)
            self._select = element("select")
        self._select.on("change", self._on_change, js_handler="(event) => emit(event.target.value)")
        self.set_options(options)

    def set_options(self, options: Mapping[str, str]) -> None:
        """Offer other values; what was chosen stays where it is among them."""
        self.value = self.value if self.value in options else next(iter(options), "")
        self._select.clear()
        with self._select:
            for value, text in options.items():
                chosen = {"selected": "selected"} if value == self.value else {}
                text_element("option", text, value=value, **chosen)

    def _on_change(self, event: Any) -> None:
        self.value = str(event.args)


class Page:
    """One page in one browser.

    Args:
        site: what the pages are made of.
        request: of the browser.
        path: of the page.
    """

    def __init__(self, site: PanelSite, request: Request, path: str) -> None:
        self.site = site
        self.t = site.texts
        self.state = site.desk.state
        self.desk = site.desk
        self.person: Person = person_of(request.scope)
        self.shown = ShownParts()
        self._token: str = request.scope[TOKEN]
        self._path = path
        self._said: Any = None
        self._said_s = 0.0
        self._last_notice = self.state.notices[-1].number if self.state.notices else 0

    def build(self, body: Callable[[Page], None]) -> None:
        """Make the page.

        Args:
            body: makes what is its own.
        """
        ui.page_title(f"{self.t(PAGES[self._path])} - {self.t('title')}")
        ui.add_head_html(_HEAD)
        ui.query(".nicegui-content").classes("shell")
        text_element("a", self.t("skip"), "skip", href="#content")
        self._header()
        self._navigation()
        with element("main", classes="content", id="content", tabindex="-1"):
            text_element("h1", self.t(PAGES[self._path]))
            self._warnings()
            body(self)
            text_element("p", self.t("no_safety_device"), "note")
        self._said = text_element("div", "", "said", role="status", aria_live="polite")
        ui.timer(PERIOD_S, self._refresh)

    @property
    def has_control(self) -> bool:
        """Whether this person has control now."""
        return self.state.control.has(self.person)

    @property
    def may_act(self) -> bool:
        """Whether a button that moves something may be pressed here and now."""
        return self.has_control and self.person.role >= Role.OPERATE

    def button(
        self, key: str, press: Callable[[], Any], classes: str = "", hint: str = "", name: str = "", **values: object
    ) -> Any:
        """Return a large button; the text key is what stands on it, `name` is for tests and scripts."""
        made = ui.button(self.t(key, **values), on_click=press, color=None).props("no-caps unelevated")
        made.classes(f"act {classes}")
        made._props["data-name"] = name or key.rpartition(".")[2]  # noqa: SLF001  as in _attributed()
        if hint:
            made.tooltip(hint)
        return made

    def do(self, act: Act) -> Callable[[], None]:
        """Return a handler that does an act."""
        return lambda: self.begin_act(act)

    def begin_act(self, act: Act, then: Callable[[ActResult], None] | None = None) -> None:
        """Do an act beside the page; it goes on when the page is left."""

        async def perform() -> None:
            result = await self.desk.perform(self.person, act)
            if then is not None:
                then(result)

        self.begin_task(perform())

    def begin_task(self, doing: Coroutine[Any, Any, object]) -> None:
        """Do what takes time beside the page, while its session goes on; it goes on when the page is left."""
        if self._is_known():
            background_tasks.create(doing)
        else:
            doing.close()

    def known(self, change: Callable[[Person], ActResult]) -> None:
        """Do what the panel does itself, while this page's session goes on."""
        if self._is_known():
            change(self.person)

    def commands(self, *acts: Act) -> None:
        """Show the commands that do the same."""
        with element("details", classes="same"):
            text_element("summary", self.t("cell.same_by"))
            for act in acts:
                text_element("code", act.call.command_line(self.site.namespace))

    def _header(self) -> None:
        with element("header", classes="bar"):
            text_element(
                "button",
                self.t("estop.button"),
                "estop",
                type="button",
                id="estop",
                aria_label=self.t("estop.aria"),
                accesskey="s",
            )
            with element("div", classes="facts", role="group", aria_label=self.t("mode.label")):
                self.shown.state(
                    self.shown.text(text_element("strong", "", "mode", id="mode"), self._mode_text), self._mode_name
                )
                self.shown.text(text_element("span", "", "stop-note", id="stop-note"), self._stop_text)
            self._calls_for_attention()
            with element("div", classes="facts control", role="group", aria_label=self.t("control.label")):
                self.shown.text(text_element("span", "", id="control"), self._control_text)
                with element("div", classes="row"):
                    self._control_buttons()
            with element("div", classes="facts who"):
                text_element("span", f"{self.person.name} ({self.t(f'role.{self.person.role.word}')})", id="who")
                with element("form", method="post", action="/logout"):
                    text_element("button", self.t("login.logout"), "small", type="submit")
                text_element("button", self.t("theme"), "small", type="button", id="theme")

    def _calls_for_attention(self) -> None:
        """Make what a person has to see on whatever page: alarms, and what waits for hands."""
        state, shown = self.state, self.shown
        with element("div", classes="facts attention", role="status"):
            alarms = text_element("a", "", "bad", href="/#alarms", id="alarm-count")
            shown.text(alarms, lambda: self.t("alarms.count", count=state.alarms.count))
            shown.visible(alarms, lambda: state.alarms.count > 0)
            swap = text_element("a", "", href="/swap", id="swap-waits")
            shown.text(swap, lambda: self.t("swap.foreign_waits" if state.swap.view.is_foreign else "swap.waits"))
            shown.visible(swap, lambda: state.swap.view.is_waiting)
            rig = text_element("a", self.t("friction.waits"), href="/friction", id="rig-waits")
            shown.visible(rig, lambda: state.rig.needs_confirmation)

    def _control_buttons(self) -> None:
        desk, shown, person = self.desk, self.shown, self.person
        if person.role < Role.OPERATE:
            return
        take = self.button("control.take", lambda: self.known(desk.take_control), "small")
        shown.text(take, lambda: self.t("control.take" if self._is_free() else "control.ask"))
        shown.visible(take, lambda: not self.has_control)
        back = self.button("control.give_back", lambda: self.known(desk.give_back), "small")
        shown.visible(back, lambda: self.has_control)
        over = self.button("control.hand_over", lambda: self.known(desk.hand_over), "small loud")
        shown.text(over, lambda: self.t("control.hand_over").format(name=self._asker()))
        shown.visible(over, lambda: self.has_control and bool(self._asker()))
        if person.role >= Role.ENGINEER:
            force = self.button("control.force", self._ask_force, "small")
            shown.visible(force, lambda: not self.has_control and not self._is_free())

    def _ask_force(self) -> None:
        with ui.dialog() as dialog, ui.card(), element("form", classes="stack"):
            reason = ui.input(self.t("control.force_reason"))

            def force() -> None:
                self.known(lambda person: self.desk.force_control(person, str(reason.value or "")))
                dialog.close()

            self.button("control.force", force, "loud")
        dialog.open()

    def _navigation(self) -> None:
        with element("nav", classes="nav", aria_label=self.t("nav.label")):
            for path, key in PAGES.items():
                link = text_element("a", self.t(key), href=path)
                if path == self._path:
                    link._props["aria-current"] = "page"  # noqa: SLF001  as in element()

    def _warnings(self) -> None:
        text_element("p", self.t("disconnected"), "warning lost", role="alert", id="lost")
        stale = text_element("p", self.t("stale"), "warning", role="alert")
        self.shown.visible(stale, lambda: self.state.is_stale)

    def _mode_name(self) -> str:
        if self.state.safety is not None and self.state.safety.estop:
            return "ESTOP"
        return self.state.cell.mode if self.state.cell else "none"

    def _mode_text(self) -> str:
        return self.t(f"mode.{self._mode_name()}")

    def _stop_text(self) -> str:
        key, values = explain_stop(self.state.policy)
        return self.t(key, **values)

    def _control_text(self) -> str:
        view = self.state.control.view
        if view.owner is None:
            return self.t("control.nobody")
        if view.owner.session == self.person.session:
            asked = self._asker()
            return self.t("control.asked", name=asked) if asked else self.t("control.you")
        return self.t("control.lost" if view.is_lost else "control.other", name=view.owner.name)

    def _asker(self) -> str:
        asked_by = self.state.control.view.asked_by
        return asked_by.name if asked_by else ""

    def _is_free(self) -> bool:
        view = self.state.control.view
        return view.owner is None or view.is_lost

    def _is_known(self) -> bool:
        """Whether this page's session goes on; else the page goes to the log-in."""
        if self.site.sessions.find(self._token) is not None:
            return True
        ui.navigate.to("/login")
        return False

    def _refresh(self) -> None:
        self.state.control.observe_page(self.person.session)
        self.shown.refresh()
        notices = [one for one in self.state.notices if one.number > self._last_notice]
        if notices:
            self._last_notice = notices[-1].number
            self._said.set_text(self.notice_text(notices[-1]))
            self._said.classes(replace="said" if notices[-1].success else "said refused")
            self._said_s = time.monotonic()
        elif self._said.text and time.monotonic() - self._said_s > SAID_S:
            self._said.set_text("")

    def notice_text(self, notice: Notice) -> str:
        """Return a notice in words."""
        key = "notices.done" if notice.success else "notices.refused"
        act = f"{self.t(f'act.{notice.act}')} {notice.subject}".strip()
        return self.t(key, who=notice.who, act=act, message=notice.message).removesuffix(": ")


def clock_text(at_s: float) -> str:
    """Return a time of day of this machine."""
    return time.strftime("%H:%M:%S", time.localtime(at_s))


def add_page(site: PanelSite, path: str, body: Callable[[Page], None]) -> None:
    """Add a page to the site."""

    async def build(request: Request) -> None:
        await asyncio.sleep(0)
        Page(site, request, path).build(body)

    ui.page(path)(build)
