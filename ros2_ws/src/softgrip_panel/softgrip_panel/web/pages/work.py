# SPDX-License-Identifier: Apache-2.0
"""Page Work: an order list, its plan, its run, and how well it goes."""

from __future__ import annotations

import math
from typing import Any

from nicegui import background_tasks, ui

from softgrip_panel.errors import PanelError
from softgrip_panel.model import acts
from softgrip_panel.model.facts import ProductView
from softgrip_panel.model.orders import MAX_BYTES, read_orders
from softgrip_panel.model.roles import Role
from softgrip_panel.model.work import WorkOptions, WorkRun
from softgrip_panel.model.work_file import WorkItem, WorkPhase
from softgrip_panel.web.parts import card, row, table
from softgrip_panel.web.shell import Page, element, text_element

#: A file never leaves the browser but as the text of the orders.
_READ_FILE = f"""async (event) => {{
  const file = event.target.files[0];
  emit(file && file.size <= {MAX_BYTES} ? await file.text() : null);
}}"""


def work_page(page: Page) -> None:
    """Make the page's own part."""
    run = page.site.worker.run
    with element("div", classes="columns"):
        with element("div", classes="column"):
            if page.person.role >= Role.OPERATE:
                _orders(page)
            _products(page)
        with element("div", classes="column"):
            _run(page, run)
            _figures(page, run)
            _items(page, run)


def _orders(page: Page) -> None:
    with card(page, "work.orders", "orders"):
        text_element("p", page.t("work.orders_hint"), "note")
        text = ui.textarea(label=page.t("work.list")).props("outlined").classes("grow")
        text.props["input-style"] = "min-height: 8rem; font-family: monospace"
        keep = ui.checkbox(page.t("work.keep_order"), value=False)

        with element("label", "choice"):
            text_element("span", page.t("work.file"))
            file = element("input", type="file", accept=".csv,.txt")
        problem = text_element("p", "", "problem", role="alert", id="order-problem")

        def read_file(event: Any) -> None:
            if isinstance(event.args, str):
                text.value = event.args[:MAX_BYTES]
            else:
                problem.set_text(page.t("work.too_large"))

        file.on("change", read_file, js_handler=_READ_FILE)

        def plan() -> None:
            try:
                orders = read_orders(str(text.value or ""))
            except PanelError as error:
                problem.set_text(str(error))
                return
            problem.set_text("")

            async def ask() -> None:
                result = await page.site.worker.plan(page.person, orders, keep_order=bool(keep.value))
                problem.set_text("" if result.success else result.message)

            background_tasks.create(ask())

        page.button("work.plan", plan, "big")
        page.commands(acts.plan(["egg", "grape"], [2, 1], keep_order=False))


def _run(page: Page, run: WorkRun) -> None:
    shown, worker = page.shown, page.site.worker
    with card(page, "work.run", "run"):
        shown.text(
            text_element("p", "", "instruction", id="work-phase"), lambda: page.t(f"work.phase_{run.phase.value}")
        )
        message = text_element("p", "", "problem", role="status", id="work-message")
        shown.text(message, lambda: "; ".join(filter(None, (run.message, run.problem))))
        with element("dl", classes="pairs"):
            row(page, "work.swaps", lambda: str(run.swaps), "plan-swaps")
            row(page, "work.minutes", lambda: f"{run.predicted_time_s / 60.0:.1f}", "plan-minutes")
            row(page, "work.success", lambda: _percent(run.expected_success))
            row(page, "work.redundant", lambda: ", ".join(run.redundant_sets) or "-")
        if page.person.role < Role.OPERATE:
            return
        with element("div", classes="row"):
            lift = ui.checkbox(page.t("cell.lift"), value=True)
            trial = ui.checkbox(page.t("cell.trial"), value=False)
            pause = ui.checkbox(page.t("work.pause_on_failure"), value=True)
            hands = ui.checkbox(page.t("work.emulated_hands"), value=True)
            shown.visible(hands, lambda: page.state.is_emulated)

        def start() -> None:
            options = WorkOptions(
                confirm_lift=bool(lift.value),
                trial=bool(trial.value),
                pause_on_failure=bool(pause.value),
                emulated_hands=page.state.is_emulated and bool(hands.value),
            )
            page.known(lambda person: worker.start(person, options))

        with element("div", classes="row"):
            begin = page.button("work.start", start, "big", name="work-start")
            shown.text(begin, lambda: page.t("work.resume" if run.phase is WorkPhase.PAUSED else "work.start"))
            shown.enabled(
                begin, lambda: page.may_act and run.phase in (WorkPhase.PLANNED, WorkPhase.PAUSED) and bool(run.items)
            )
            stop = page.button("work.pause", lambda: page.known(worker.pause), "big", name="work-pause")
            shown.enabled(stop, lambda: run.phase is WorkPhase.RUNNING)
            leave = page.button(
                "work.leave_out", lambda: page.known(worker.leave_out), name="work-leave-out", product=""
            )
            shown.text(leave, lambda: page.t("work.leave_out", product=_next_product(run)).rstrip())
            shown.visible(leave, lambda: run.phase is WorkPhase.PAUSED)
            shown.enabled(leave, lambda: page.may_act and bool(_next_product(run)))
        page.commands(acts.swap("power"), acts.grasp("egg"), acts.release())
        link = text_element("a", page.t("work.to_swap"), "instruction", href="/swap")
        shown.visible(link, lambda: page.state.swap.view.is_open)


def _next_product(run: WorkRun) -> str:
    number = run.next_number
    return "" if number is None else run.items[number].product


def _figures(page: Page, run: WorkRun) -> None:
    with card(page, "work.figures", "figures"), element("dl", classes="pairs"):
        row(page, "work.done", lambda: f"{run.figures().done} / {run.figures().total}", "work-done")
        row(page, "counters.gripped", lambda: str(run.figures().gripped), "work-gripped")
        row(page, "work.rate", lambda: _number(run.figures().rate_per_h))
        row(page, "work.availability", lambda: _percent(run.figures().availability))
        row(page, "work.performance", lambda: _percent(run.figures().performance))
        row(page, "work.quality", lambda: _percent(run.figures().quality))
        row(page, "work.oee", lambda: _percent(run.figures().oee), "work-oee")


def _items(page: Page, run: WorkRun) -> None:
    with card(page, "work.items", "items"):
        body = table(page, "work.product", "work.set", "work.outcome", "work.table42", "work.reason")

        def write(items: tuple[WorkItem, ...]) -> None:
            catalogue = {one.id: one for one in page.state.catalogue}
            for item in items[:500]:
                product = catalogue.get(item.product)
                with element("tr"):
                    text_element("td", item.product)
                    text_element("td", item.finger_set)
                    text_element("td", item.outcome or "...", "verdict", data_state=item.outcome)
                    text_element("td", product.table_marks.get(item.finger_set, "-") if product else "-")
                    text_element("td", item.reason, "why")

        page.shown.parts(body, lambda: run.items, write)


def _products(page: Page) -> None:
    with card(page, "work.products", "products"):
        body = table(page, "work.product", "work.grasp", "work.marks", "work.measured")

        def write(products: tuple[ProductView, ...]) -> None:
            for one in products:
                with element("tr"):
                    text_element("td", one.id)
                    text_element("td", one.grasp, "whole")
                    text_element("td", ", ".join(f"{name}: {mark or '-'}" for name, mark in one.table_marks.items()))
                    text_element("td", _measured(one))

        page.shown.parts(body, lambda: page.state.catalogue, write)


def _measured(product: ProductView) -> str:
    counted = [
        f"{name}: {product.expected_success[name]:.0%} ({grasps})" for name, grasps in product.grasps.items() if grasps
    ]
    return ", ".join(counted) or "-"


def _percent(value: float) -> str:
    return "-" if math.isnan(value) else f"{100.0 * value:.0f} %"


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.0f}"
