# SPDX-License-Identifier: Apache-2.0
"""Page Set-up: driver, bus, what needs it for itself, tensioning, weights; camera and parameters have own parts."""

from __future__ import annotations

import asyncio
import functools
from collections.abc import Callable, Sequence

from nicegui import background_tasks, ui

from softgrip_panel.errors import PanelError
from softgrip_panel.model import acts
from softgrip_panel.model.acts import ActResult
from softgrip_panel.model.bench import (
    ACTIVE,
    BAUDS,
    MAX_ID,
    TO_FREE,
    TO_TAKE,
    BenchView,
    TerminalStep,
    bus_causes,
    id_step,
    terminal_steps,
)
from softgrip_panel.model.roles import Role
from softgrip_panel.model.tensioning import PLAN, SETTLED_MM, TensioningRound
from softgrip_panel.model.weights import MAX_KG, MIN_KG, WeightPoint
from softgrip_panel.web.pages.setup_camera import camera_card
from softgrip_panel.web.pages.setup_parameters import parameters_card
from softgrip_panel.web.parts import card, command, fill, row, table
from softgrip_panel.web.shell import ChoiceField, Page, element, text_element
from softgrip_panel.web.site import PERIOD_S

#: A weight is read so often, a tenth of a second apart.
READINGS = 15


def setup_page(page: Page) -> None:
    """Make the page's own part."""
    if page.person.role < Role.ENGINEER:
        text_element("p", page.t("setup.engineers"), "warning")
    with element("div", classes="stack"):
        _driver(page)
        with element("div", classes="columns"):
            with element("div", classes="column"):
                _terminal(page)
                _weights(page)
            with element("div", classes="column"):
                _tensioning(page)
                camera_card(page)
        parameters_card(page)


def is_engineer(page: Page) -> bool:
    """Whether this person may set up at all."""
    return page.person.role >= Role.ENGINEER


# --- driver and bus


def _driver(page: Page) -> None:
    def bench() -> BenchView:
        return page.state.bench

    def figure(key: str) -> str:
        return bench().bus.get(key, "-")

    with card(page, "setup.driver", "driver"):
        with element("dl", classes="pairs tight"):
            row(page, "setup.phase", lambda: _phase_text(page), "driver-phase")
            row(page, "setup.port", lambda: f"{bench().port or '?'}, {bench().baud or '?'} baud")
            for key in ("rate [Hz]", "jitter p99 [ms]", "missed cycles", "lost replies", "damaged replies"):
                name = f"setup.bus_{key.partition(' [')[0].replace(' ', '_')}"
                row(page, name, functools.partial(figure, key))
        _servos(page)
        holder = element("ul", classes="alarms")

        def write(keys: Sequence[str]) -> None:
            for key in keys:
                text_element("li", page.t(key), "alarm", data_level="warning")

        page.shown.parts(holder, lambda: bus_causes(bench()), write)
        if not is_engineer(page):
            return
        with element("div", classes="row"):
            free = page.button("setup.free", lambda: _ask_transitions(page, "free", TO_FREE), name="free-bus")
            page.shown.enabled(free, lambda: page.may_act and bench().phase in TO_FREE)
            take = page.button("setup.take", lambda: _ask_transitions(page, "take", TO_TAKE), name="take-bus")
            page.shown.enabled(
                take,
                lambda: page.may_act and bench().phase in TO_TAKE and not page.site.bench_commands.output.is_running,
            )
        page.commands(*(acts.set_driver(one) for one in ("deactivate", "cleanup", "configure", "activate")))


def _phase_text(page: Page) -> str:
    bench = page.state.bench
    key = f"setup.phase_{bench.phase}"
    return page.t(key) if page.t.has(key) else bench.phase or page.t("setup.phase_unknown")


def _servos(page: Page) -> None:
    body = table(
        page,
        "setup.tendon",
        "setup.servo",
        "setup.state",
        "setup.current",
        "setup.temperature",
        "setup.voltage",
        "setup.lost_replies",
        "setup.errors",
        is_whole=True,
    )

    def rows() -> tuple[tuple[str, ...], ...]:
        bench, tendons = page.state.bench, {one.name: one for one in page.state.tendons}
        return tuple(
            (
                name,
                f"{bench.of(name, bench.servo_ids)}, {bench.of(name, bench.servo_models)}",
                _state_text(page, tendons[name]) if name in tendons else "-",
                figures.get("current [A]", "-"),
                figures.get("temperature [degC]", "-"),
                figures.get("voltage [V]", "-"),
                figures.get("lost replies", "-"),
                figures.get("hardware error", "-"),
            )
            for name, figures in sorted(bench.servos.items())
        )

    page.shown.parts(body, rows, fill)


def _state_text(page: Page, tendon: object) -> str:
    homed = page.t("setup.homed" if getattr(tendon, "homed", False) else "setup.unhomed")
    return f"{getattr(tendon, 'state', '?')}, {homed}"


def _ask_transitions(page: Page, name: str, ways: dict[str, tuple[str, ...]]) -> None:
    """Show what will happen, then make the driver's transitions one after the other; a refused one ends the way."""
    left = list(ways.get(page.state.bench.phase, ()))
    with ui.dialog() as dialog, ui.card().classes("dialog"):
        text_element("h2", page.t(f"setup.{name}_title"))
        text_element("p", page.t(f"setup.{name}_will"))
        page.commands(*(acts.set_driver(one) for one in left))

        def go_on(result: ActResult | None = None) -> None:
            if left and (result is None or result.success):
                page.begin_act(acts.set_driver(left.pop(0)), go_on)

        def confirmed() -> None:
            dialog.close()
            go_on()

        page.button(f"setup.{name}", confirmed, "loud big", name=f"{name}-confirm")
    dialog.open()


# --- what needs a terminal


def _terminal(page: Page) -> None:
    with card(page, "setup.terminal", "terminal"):
        text_element("p", page.t("setup.terminal_why"))
        state = text_element("p", "", "instruction", id="bus-owner")
        page.shown.text(state, lambda: page.t("setup.bus_busy" if page.state.bench.has_bus else "setup.bus_free"))
        holder = element("div")

        def write(_: object) -> None:
            for one in terminal_steps(page.state.bench):
                text_element("h3", page.t(f"setup.do_{one.key}"))
                text_element("p", page.t(f"setup.why_{one.key}"), "note")
                command(page, one.command)
                if one.key == "ids":
                    _id_fields(page)
                elif one.is_run_here and is_engineer(page):
                    _run_button(page, one.key, _giving(one))

        page.shown.parts(holder, lambda: _named_bus(page.state.bench), write)
        _bench_output(page)


def _giving(step: TerminalStep) -> Callable[[], TerminalStep]:
    return lambda: step


def _run_button(page: Page, key: str, read: Callable[[], TerminalStep]) -> None:
    """Make the button that runs a step here; it can be pressed while nobody else has the bus."""
    work = page.site.bench_commands

    def run() -> None:
        try:
            step = read()
        except PanelError as error:
            problem = str(error)
            page.known(lambda person: page.desk.refuse(person, "bench", problem))
            return
        page.known(lambda person: work.begin_step(person, step))

    button = page.button("setup.run", run, "small", name=f"run-{key}")
    page.shown.enabled(button, lambda: page.may_act and not page.state.bench.has_bus and not work.output.is_running)


def _id_fields(page: Page) -> None:
    if not is_engineer(page):
        return
    with element("div", classes="row"):
        now = ui.number(page.t("setup.id_now"), value=1, min=0, max=MAX_ID, step=1, precision=0)
        new = ui.number(page.t("setup.id_new"), value=1, min=0, max=MAX_ID, step=1, precision=0)
        for one, name in ((now, "id-now"), (new, "id-new")):
            one.props("outlined dense").classes(f"grow {name}")
        baud = ChoiceField(page.t("setup.baud_now"), {str(one): str(one) for one in (57_600, *BAUDS)})

        def read() -> TerminalStep:
            return id_step(page.state.bench, _whole(now.value), int(baud.value), _whole(new.value))

        _run_button(page, "ids", read)


def _whole(value: object) -> int:
    """Return what a field of numbers holds; -1, which no servo has, where that is none."""
    return int(value) if isinstance(value, (int, float)) else -1


def _bench_output(page: Page) -> None:
    """Show what the last command said, and how it ended."""
    work, shown = page.site.bench_commands, page.shown
    said = text_element("p", "", "instruction", id="bench-said", role="status")
    shown.text(said, lambda: _bench_text(page))
    lines = text_element("pre", "", "output", id="bench-output", tabindex="0", aria_label=page.t("setup.output"))
    shown.text(lines, lambda: "\n".join(work.output.lines))
    shown.visible(lines, lambda: bool(work.output.lines))
    if is_engineer(page):
        stop = page.button("setup.run_end", lambda: page.known(work.stop), name="run-end")
        shown.visible(stop, lambda: work.output.is_running)


def _bench_text(page: Page) -> str:
    output = page.site.bench_commands.output
    if not output.key:
        return ""
    name = page.t(f"setup.do_{output.key}")
    if output.is_running:
        return page.t("setup.run_goes_on", name=name)
    return page.t("setup.run_done" if output.code == 0 else "setup.run_failed", name=name, code=output.code)


def _named_bus(bench: BenchView) -> tuple[object, ...]:
    """Return what the commands depend on."""
    return bench.port, bench.baud, bench.tendons, bench.servo_ids


# --- homing and tensioning


def _tensioning(page: Page) -> None:
    work, shown = page.site.tensioning, page.shown
    with card(page, "setup.tensioning", "tensioning"):
        text_element("p", page.t("setup.tensioning_how", tension=PLAN.tension_n, hold=PLAN.hold_s, settled=SETTLED_MM))
        shown.text(text_element("p", "", "instruction", id="tensioning-said", role="status"), lambda: _round_text(page))
        shown.text(text_element("p", "", "problem", role="alert"), lambda: work.problem)
        body = table(page, "setup.round", "setup.shifts", "setup.result")

        shown.parts(body, lambda: [_round_row(page, one) for one in reversed(work.rounds)], fill)
        if not is_engineer(page):
            return
        with element("div", classes="row"):
            home = page.button("cell.home", page.do(acts.home()), name="setup-home")
            begin = page.button(
                "setup.tension", lambda: background_tasks.create(work.run_round(page.person)), "big", name="tension"
            )
            for one in (home, begin):
                shown.enabled(one, lambda: page.may_act and page.state.bench.phase == ACTIVE and not work.is_running)
            stop = page.button("setup.tension_stop", lambda: _stop_tensioning(page), name="tension-stop")
            shown.visible(stop, lambda: work.is_running)
        page.commands(
            acts.home(), acts.pull(PLAN.tension_n, PLAN.speed_m_s), acts.slacken(PLAN.speed_m_s, PLAN.tension_n)
        )


def _stop_tensioning(page: Page) -> None:
    for name in ("pull", "slacken"):
        page.desk.stop_action(page.person, name)


def _round_text(page: Page) -> str:
    work = page.site.tensioning
    if work.is_running:
        return page.t("setup.tensioning_now", step=page.t(f"act.{work.step}") if work.step else "...")
    if not work.rounds:
        return page.t("setup.tensioning_none")
    return page.t("setup.settled" if work.rounds[-1].has_settled else "setup.not_settled")


def _round_row(page: Page, one: TensioningRound) -> list[str]:
    shifts = ", ".join(f"{name} {shift:+.2f} mm" for name, shift in one.shifts_mm.items())
    return [str(one.number), shifts or "-", page.t("setup.settled_short" if one.has_settled else "setup.moves")]


# --- tension by weights


def _weights(page: Page) -> None:
    check, shown = page.state.weights, page.shown
    with card(page, "setup.weights", "weights"):
        text_element("p", page.t("setup.weights_how"))
        body = table(page, "setup.tendon", "setup.mass", "setup.weight", "setup.reading", "setup.error")

        shown.parts(body, lambda: [_weight_row(one) for one in reversed(check.points)], fill)
        holder = element("ul", id="weight-factors")

        def write_factors(factors: dict[str, float]) -> None:
            for name, factor in factors.items():
                key = "setup.factor_good" if check.is_good(name) else "setup.factor_bad"
                text_element("li", page.t(key, name=name, factor=factor), "good" if check.is_good(name) else "bad")

        shown.parts(holder, check.factors, write_factors)
        if not is_engineer(page):
            return
        problem = text_element("p", "", "problem", role="alert", id="weight-problem")
        with element("div", classes="row"):
            tendon = ChoiceField(page.t("setup.tendon"), {})
            shown.follow_value(
                lambda: tuple(one.name for one in page.state.tensions),
                lambda names: tendon.set_options({one: one for one in names}),
            )
            mass = ui.number(page.t("setup.mass"), value=0.5, min=MIN_KG, max=MAX_KG, step=0.1)
            mass.props("outlined dense").classes("grow")

            async def read() -> None:
                problem.set_text(page.t("setup.reading_now"))
                readings = []
                for _ in range(READINGS):
                    readings += [one.tension_n for one in page.state.tensions if one.name == tendon.value]
                    await asyncio.sleep(PERIOD_S)
                try:
                    point = check.add_weight(tendon.value, float(mass.value or 0.0), readings)
                except PanelError as error:
                    problem.set_text(str(error))
                    return
                problem.set_text("")
                said = f"{point.mass_kg:g} kg: {point.tension_n:.2f} N"
                page.desk.record_event(page.person.name, "weigh", point.tendon, success=True, message=said)

            page.button("setup.weigh", lambda: background_tasks.create(read()), "big", name="weigh")
            page.button("setup.clear", check.clear, name="weights-clear")
        command(page, f"ros2 topic echo --field effort {page.site.namespace.rstrip('/')}/tendon/state")


def _weight_row(one: WeightPoint) -> list[str]:
    return [
        one.tendon,
        f"{one.mass_kg:g} kg",
        f"{one.weight_n:.2f} N",
        f"{one.tension_n:.2f} ± {one.spread_n:.2f} N",
        f"{100.0 * one.error:+.0f} %",
    ]
