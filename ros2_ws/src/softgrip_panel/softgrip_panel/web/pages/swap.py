# SPDX-License-Identifier: Apache-2.0
"""Page Swap: one step at a time, serials by scanner, the empty closing live, a clock."""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable, Sequence
from typing import Any

from nicegui import ui

from softgrip_panel.model import acts
from softgrip_panel.model.acts import Act, ActResult
from softgrip_panel.model.roles import Role
from softgrip_panel.model.swap import ASKS_SERIALS, HANDS_OUT, LIMIT_S, STEPS, SwapPhase, SwapView, read_serials
from softgrip_panel.web.drawings import swap_drawing
from softgrip_panel.web.parts import card
from softgrip_panel.web.shell import Page, element, text_element

#: Drawn while the cell has not said how many it has.
USUAL_SLOTS = 3
#: Where the emulated hands do what the step asks for.
EMULATED_STEPS = frozenset({"remove", "insert"})


def swap_page(page: Page) -> None:
    """Make the page's own part."""
    with element("div", classes="columns"):
        with element("div", classes="column"):
            _now(page)
            if page.person.role >= Role.OPERATE:
                _start(page)
        with element("div", classes="column"):
            _check(page)


def _view(page: Page) -> SwapView:
    return page.state.swap.view


def _step(page: Page) -> str:
    view = _view(page)
    return HANDS_OUT if view.phase is SwapPhase.HANDS_INSIDE else view.step if view.is_open else ""


def _asks_serials(page: Page) -> bool:
    return _step(page) == ASKS_SERIALS and _view(page).can_be_confirmed


def _now(page: Page) -> None:
    shown = page.shown
    with card(page, "swap.now", "swap-now"):
        with element("ol", classes="steps"):
            for step in STEPS[:-1]:
                item = text_element("li", page.t(f"step.{step}"))
                shown.state(item, functools.partial(_step_state, page, step))
        instruction = text_element("p", "", "instruction", id="instruction", role="status", aria_live="assertive")
        shown.text(instruction, lambda: _instruction(page))
        foreign = text_element("p", page.t("swap.foreign"), "note", id="swap-foreign", role="status")
        shown.visible(foreign, lambda: _view(page).is_foreign and _view(page).is_open)
        holder = element("div", classes="drawing")

        def draw(now: tuple[str, int]) -> None:
            step, slots = now
            if step:
                ui.html(swap_drawing(step, page.t(f"step.{step}"), slots), sanitize=False)

        shown.parts(holder, lambda: (_step(page), len(_slots(page)) or USUAL_SLOTS), draw)
        clock = shown.text(text_element("p", "", "clock", id="swap-clock", role="timer"), lambda: _clock(page))
        shown.state(clock, lambda: "late" if _view(page).elapsed_s(time.time()) > LIMIT_S else "")
        if page.person.role >= Role.OPERATE:
            _confirmation(page)


def _confirmation(page: Page) -> None:
    shown = page.shown
    with element("div", classes="stack"):
        serials = ui.input(page.t("swap.serials")).props("outlined autofocus").classes("serials")
        serials.props["input-aria-label"] = page.t("swap.serials")
        shown.visible(serials, lambda: _asks_serials(page))
        hint = text_element("p", page.t("swap.serials_hint"), "note")
        shown.visible(hint, lambda: _asks_serials(page))
        problem = text_element("p", "", "problem", role="alert", id="swap-problem")

        def answered(result: ActResult) -> None:
            problem.set_text("" if result.success else result.message)
            if result.success:
                serials.value = ""

        def confirm() -> None:
            step, slots = _step(page), _slots(page)
            given = read_serials(str(serials.value or ""), slots) if step == ASKS_SERIALS else []
            if step == ASKS_SERIALS and len(given) < len(slots):
                problem.set_text(page.t("swap.serials_missing", slots=", ".join(slots[len(given) :])))
                return
            act = acts.confirm_step(step, _view(page).token, given)
            if not page.state.is_emulated or step not in EMULATED_STEPS:
                page.begin_act(act, answered)
                return

            def then(result: ActResult) -> None:
                if result.success:
                    page.begin_act(act, answered)
                else:
                    problem.set_text(result.message)

            page.begin_act(_emulated_hands(page, given), then)

        def scanned() -> None:
            """Take Enter, with which a scanner ends each code: go on once every slot has its serial."""
            given = read_serials(str(serials.value or ""), _slots(page))
            if len(given) >= len(_slots(page)):
                confirm()
            elif given:
                serials.value = " ".join(given) + " "

        serials.on("keydown.enter", scanned)
        propose = page.button("swap.propose", lambda: serials.set_value(" ".join(_usable(page))), name="propose")
        shown.visible(propose, lambda: _asks_serials(page))
        with element("div", classes="row"):
            done = page.button("swap.done", confirm, "big", name="step-done")
            shown.text(done, lambda: page.t("swap.hands_out" if _step(page) == HANDS_OUT else "swap.done"))
            shown.visible(done, lambda: _view(page).can_be_confirmed)
            shown.enabled(done, lambda: page.may_act)
            cancel = page.button("swap.cancel", lambda: page.desk.stop_action(page.person, "swap"), name="swap-cancel")
            shown.visible(cancel, lambda: _view(page).phase is SwapPhase.RUNNING)


def _usable(page: Page) -> list[str]:
    """Return a usable finger of the set for every slot, the least used one."""
    finger_set = _view(page).finger_set
    chosen = []
    for slot in _slots(page):
        fitting = [
            one for one in page.state.fingers if (one.profile, one.finger) == (finger_set, slot) and not one.objection
        ]
        chosen += [min(fitting, key=lambda one: (one.cycles, one.serial)).serial] if fitting else []
    return chosen


def _emulated_hands(page: Page, serials: Sequence[str]) -> Act:
    """Return what the emulated hands do to the fingers; no serials = they take them out."""
    slots, profiles = _slots(page), {one.serial: one.profile for one in page.state.fingers}
    inside = list(serials) or [""] * len(slots)
    return acts.mount_fingers(slots, inside, [profiles.get(serial, "") for serial in inside])


def _start(page: Page) -> None:
    with card(page, "swap.start", "swap-start"):
        text_element("p", page.t("swap.start_hint"), "note")
        requested = ui.input(page.t("swap.requested")).props("outlined dense").classes("grow")
        _buttons_of_sets(page, lambda: str(requested.value or "").replace(",", " ").split())
        page.commands(acts.swap("power"), acts.confirm_step("insert", "TOKEN", ["PW-I-01", "PW-M-01", "PW-T-01"]))


def _buttons_of_sets(page: Page, serials: Callable[[], list[str]]) -> None:
    """Make a button for every finger set that the catalogue has, whenever it gets another."""
    shown, made = page.shown, dict[str, Any]()
    none = text_element("p", page.t("swap.no_sets"), "note")
    shown.visible(none, lambda: not page.state.finger_sets)
    holder = element("div", classes="row", id="swap-sets")

    def make(finger_set: str) -> Any:
        def begin() -> None:
            page.begin_act(acts.swap(finger_set, serials()))

        made[finger_set] = page.button("swap.to", begin, "big", name=f"swap-{finger_set}", finger_set=finger_set)
        made[finger_set].set_enabled(may_begin())
        return made[finger_set]

    def may_begin() -> bool:
        return page.may_act and not _view(page).is_open

    def enable(may: bool) -> None:
        for button in made.values():
            button.set_enabled(may)

    shown.rows(holder, lambda: page.state.finger_sets, tuple, make)
    shown.follow_value(may_begin, enable)


def _check(page: Page) -> None:
    with card(page, "swap.check", "swap-check"):
        text_element("p", page.t("swap.check_hint"), "note")
        element("canvas", id="check", width="640", height="420", role="img", aria_label=page.t("swap.check_aria"))
        unchecked = text_element("p", "", "note", id="unchecked")
        page.shown.text(unchecked, lambda: _unchecked_text(page))
        with element("ul", id="check-curves", classes="hidden-list") as holder:

            def write(curves: tuple[tuple[str, str, str], ...]) -> None:
                for slot, serial, curve in curves:
                    text_element("li", f"{slot} {serial}", data_slot=slot, data_curve=curve)

            page.shown.parts(holder, lambda: _curves(page), write)


def _curves(page: Page) -> tuple[tuple[str, str, str], ...]:
    """Return slot, serial and the last check of each mounted finger, as "mm,N mm,N ..."."""
    records = {one.serial: one for one in page.state.fingers}
    mounted = page.state.cell.mounted if page.state.cell else ()
    return tuple(
        (
            one.slot,
            one.serial,
            " ".join(f"{1e3 * x:.2f},{n:.2f}" for x, n in records[one.serial].check) if one.serial in records else "",
        )
        for one in mounted
    )


def _unchecked_text(page: Page) -> str:
    """Return which mounted fingers have no record to be drawn."""
    missing = [f"{slot} {serial}".strip() for slot, serial, curve in _curves(page) if not curve]
    return page.t("swap.unchecked", fingers=", ".join(missing)) if missing else ""


def _slots(page: Page) -> tuple[str, ...]:
    return tuple(one.slot for one in page.state.cell.mounted) if page.state.cell else ()


def _step_state(page: Page, step: str) -> str:
    view = _view(page)
    if view.step not in STEPS or view.phase is SwapPhase.NONE:
        return ""
    here, there = STEPS.index(step), STEPS.index(view.step)
    if view.phase is SwapPhase.ENDED and view.success:
        return "done"
    return "now" if here == there and view.is_open else "done" if here < there else ""


def _instruction(page: Page) -> str:
    view = _view(page)
    if view.phase is SwapPhase.NONE:
        return page.t("swap.none")
    if view.phase is SwapPhase.HANDS_INSIDE and view.is_foreign:
        return page.t("swap.foreign_hands_inside")
    if view.phase is SwapPhase.HANDS_INSIDE:
        return page.t("swap.hands_inside")
    if view.phase is SwapPhase.ENDED:
        return page.t("swap.succeeded" if view.success else "swap.failed", message=view.message)
    return view.instruction


def _clock(page: Page) -> str:
    elapsed_s = _view(page).elapsed_s(time.time())
    if math.isnan(elapsed_s) or not _view(page).is_open:
        return ""
    limit = f"{LIMIT_S // 60:.0f}:{LIMIT_S % 60:02.0f}"
    return f"{int(elapsed_s) // 60}:{int(elapsed_s) % 60:02d} / {limit}"
