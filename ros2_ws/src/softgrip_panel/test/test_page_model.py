# SPDX-License-Identifier: Apache-2.0
"""The page model alone: control, alarms, acts, orders, explanations."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import importlib
import json
import math
import struct
import tracemalloc
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from softgrip_driver.faults import FAULTS
from softgrip_panel.access.record import ActRecord
from softgrip_panel.errors import ActRefusedError, PanelError
from softgrip_panel.model import acts
from softgrip_panel.model.acts import Act, ActResult
from softgrip_panel.model.alarms import AlarmBook, AlarmFact, AlarmStage
from softgrip_panel.model.bags import BagFolder
from softgrip_panel.model.control import LOST_S, ControlDesk
from softgrip_panel.model.desk import MAX_STRANGERS, STRANGERS_S, ActDesk
from softgrip_panel.model.explain import explain_reset, explain_residual, explain_stop
from softgrip_panel.model.facts import (
    CellView,
    ComponentHealth,
    CountedView,
    FingerDecision,
    MountedView,
    ProductView,
    ResidualView,
    SafetyView,
    StopPolicyView,
    TendonView,
    TensionView,
)
from softgrip_panel.model.frames import PanelPicture, pack_picture, pack_tensions
from softgrip_panel.model.grasps import MAX_GRASPS, MAX_PICTURED, GraspRecord
from softgrip_panel.model.orders import OrderLine, read_orders
from softgrip_panel.model.records import GraspFilter, export_csv, grasp_rows
from softgrip_panel.model.roles import Person, Role
from softgrip_panel.model.state import SILENCE_S, PanelState
from softgrip_panel.model.swap import HANDS_OUT, SwapFollower, SwapPhase, SwapView
from softgrip_panel.model.work import PlannedStep, Worker, WorkOptions, WorkRun
from softgrip_panel.model.work_file import LEFT_OUT, WorkPhase
from softgrip_testing.manual_clock import ManualClock

ADA = Person("a", "Ada", Role.OPERATE)
BOB = Person("b", "Bob", Role.OPERATE)
EVE = Person("e", "Eve", Role.LOOK)
IDA = Person("i", "Ida", Role.ENGINEER)
EVERYBODY = (ADA, BOB, EVE, IDA)


class Calls:
    def __init__(self) -> None:
        self.acts: list[tuple[str, str]] = []

    async def call(self, act: Act, who: str) -> ActResult:
        self.acts.append((act.name, who))
        return ActResult(success=True, message="done")

    def cancel(self, act_name: str) -> None:
        self.acts.append((f"cancel {act_name}", ""))


# --- control


def test_control_is_one_persons_until_it_is_handed_over(clock: ManualClock) -> None:
    desk = ControlDesk(clock)
    desk.take_control(ADA)
    with pytest.raises(ActRefusedError, match="Ada has it"):
        desk.take_control(BOB)
    desk.observe_page(BOB.session)
    desk.ask(BOB)
    assert desk.view.asked_by == BOB
    assert desk.has(ADA)
    assert desk.hand_over(ADA) == BOB
    assert desk.has(BOB)
    assert desk.view.asked_by is None


def test_control_of_somebody_without_an_open_page_is_shown_as_lost_and_can_be_taken(clock: ManualClock) -> None:
    desk = ControlDesk(clock)
    desk.take_control(ADA)
    clock.s += LOST_S
    assert not desk.view.is_lost
    clock.s += 0.1
    assert desk.view.is_lost
    assert desk.has(ADA)  # it stays Ada's while nobody takes it
    desk.take_control(BOB)
    assert desk.has(BOB)


def test_who_only_looks_never_has_control_and_force_needs_an_engineer_with_a_reason(clock: ManualClock) -> None:
    desk = ControlDesk(clock)
    for wrong in (lambda: desk.take_control(EVE), lambda: desk.ask(EVE), lambda: desk.force(BOB, "because")):
        with pytest.raises(ActRefusedError):
            wrong()
    desk.take_control(ADA)
    with pytest.raises(ActRefusedError, match="reason"):
        desk.force(IDA, "  ")
    desk.force(IDA, "Ada went home")
    assert desk.has(IDA)


def test_a_session_that_ends_frees_control(clock: ManualClock) -> None:
    desk = ControlDesk(clock)
    desk.take_control(ADA)
    desk.forget(ADA.session)
    assert desk.view.owner is None


class ControlMachine(RuleBasedStateMachine):
    """Whatever people do in whatever order: one owner at most, never one who only looks."""

    def __init__(self) -> None:
        super().__init__()
        self.clock = ManualClock(1000.0)
        self.desk = ControlDesk(self.clock)

    @rule(person=st.sampled_from(EVERYBODY), act=st.sampled_from(["take_control", "ask", "hand_over", "give_back"]))
    def act(self, person: Person, act: str) -> None:
        before = self.desk.view
        try:
            getattr(self.desk, act)(person)
        except ActRefusedError:
            assert self.desk.view == before
        if self.desk.view.owner != before.owner and before.owner is not None and not before.is_lost:
            assert person == before.owner  # only its owner gives control away

    @rule(person=st.sampled_from(EVERYBODY), reason=st.sampled_from(["", "fire"]))
    def force(self, person: Person, reason: str) -> None:
        try:
            self.desk.force(person, reason)
        except ActRefusedError:
            return
        assert person.role is Role.ENGINEER
        assert reason

    @rule(person=st.sampled_from(EVERYBODY))
    def see(self, person: Person) -> None:
        self.desk.observe_page(person.session)

    @rule(seconds=st.sampled_from([0.1, 5.0, 20.0]))
    def wait(self, seconds: float) -> None:
        self.clock.s += seconds

    @rule(person=st.sampled_from(EVERYBODY))
    def leave(self, person: Person) -> None:
        self.desk.forget(person.session)

    @invariant()
    def one_owner_who_may(self) -> None:
        owners = [person for person in EVERYBODY if self.desk.has(person)]
        assert len(owners) <= 1
        assert EVE not in owners


ControlMachine.TestCase.settings = settings(max_examples=30, stateful_step_count=40, deadline=None)
TestControlMachine = ControlMachine.TestCase


# --- the desk


def run(desk: ActDesk, person: Person, act: Act) -> ActResult:
    return asyncio.run(desk.perform(person, act))


@pytest.mark.parametrize("act", acts.EXAMPLES, ids=lambda act: act.name)
def test_no_act_without_role_and_control(act: Act, state: PanelState) -> None:
    calls = Calls()
    desk = ActDesk(state, calls, ActRecord(None, lambda: 0.0))
    for person in EVERYBODY:
        result = run(desk, person, act)
        may = person.role >= act.role and not act.needs_control
        assert result.success is may, (person.name, result.message)
    state.control.take_control(ADA)
    assert run(desk, ADA, act).success is (ADA.role >= act.role)
    assert run(desk, BOB, act).success is (BOB.role >= act.role and not act.needs_control)
    assert {who for name, who in calls.acts if act.needs_control} <= {"Ada"}


def test_whoever_sees_the_page_may_stop_and_who_operates_may_let_go() -> None:
    assert acts.estop().role is Role.LOOK
    assert not acts.estop().needs_control
    assert not acts.release().needs_control


def test_every_act_is_recorded_with_name_and_end_and_without_tokens(state: PanelState, tmp_path: Path) -> None:
    desk = ActDesk(state, Calls(), ActRecord(tmp_path / "acts.jsonl", lambda: 12.5))
    run(desk, EVE, acts.grasp("egg"))
    state.control.take_control(ADA)
    run(desk, ADA, acts.confirm_step("insert", "s3cret-token", ["A", "B", "C"]))
    lines = [json.loads(line) for line in (tmp_path / "acts.jsonl").read_text().splitlines()]
    assert [(one["who"], one["act"], one["success"]) for one in lines] == [
        ("Eve", "grasp", False),
        ("Ada", "confirm_step", True),
        ("Ada", "confirm_step", True),
    ]
    assert [one["message"] for one in lines[1:]] == ["begun", "done"]
    assert "s3cret-token" not in (tmp_path / "acts.jsonl").read_text()
    assert (tmp_path / "acts.jsonl").stat().st_mode & 0o077 == 0
    assert [notice.who for notice in state.notices] == ["Eve", "Ada"]


class EndlessCalls(Calls):
    async def call(self, act: Act, who: str) -> ActResult:
        await super().call(act, who)
        await asyncio.Event().wait()
        raise AssertionError


@pytest.mark.parametrize("act", acts.EXAMPLES, ids=lambda act: act.name)
def test_an_act_that_the_panel_did_not_outlive_names_who_began_it(act: Act, state: PanelState, tmp_path: Path) -> None:
    desk = ActDesk(state, EndlessCalls(), ActRecord(tmp_path / "acts.jsonl", lambda: 12.5))
    audited: list[tuple[str, str, str, str]] = []
    desk.on_done = lambda *line: audited.append(line)
    state.control.take_control(IDA)

    async def end_in_the_midst() -> None:
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(desk.perform(IDA, act), 0.01)

    asyncio.run(end_in_the_midst())
    if act.name == "estop":  # it waits for no disk; the driver's own reason names it
        assert audited == []
        return
    (line,) = [json.loads(one) for one in (tmp_path / "acts.jsonl").read_text().splitlines()]
    assert (line["who"], line["act"], line["message"]) == ("Ida", act.name, "begun")
    assert audited == [("Ida", act.name, act.subject, "begun")]


def test_log_ins_reach_the_audit_table_and_strangers_do_not_fill_it(state: PanelState, clock: ManualClock) -> None:
    desk = ActDesk(state, Calls(), ActRecord(None, lambda: 0.0))
    audited: list[tuple[str, str, str, str]] = []
    desk.on_done = lambda *line: audited.append(line)
    for _ in range(1000):
        desk.record_event("10.0.0.9", "request", "/grasps.csv", success=False, message="no session")
    desk.record_event("Ada", "login", "10.0.0.8", success=True, message="operates")
    assert audited[0] == ("10.0.0.9", "request", "/grasps.csv", "refused: no session")
    assert len(audited) == MAX_STRANGERS + 1
    assert audited[-1] == ("Ada", "login", "10.0.0.8", "operates")
    clock.s += STRANGERS_S
    desk.record_event("10.0.0.9", "request", "/", success=False, message="no session")
    assert len(audited) == MAX_STRANGERS + 2


def test_a_run_is_begun_by_who_has_control_and_ended_by_who_operates(state: PanelState, clock: ManualClock) -> None:
    desk = ActDesk(state, Calls(), ActRecord(None, lambda: 0.0))
    audited: list[tuple[str, str]] = []
    desk.on_done = lambda who, act, _subject, detail: audited.append((f"{who} {act}", detail))
    worker = Worker(desk, WorkRun(clock))
    answer = SimpleNamespace(swaps=0, predicted_time=4.0, expected_success=0.9, redundant_sets=[])
    worker.run.plan([PlannedStep("egg", 1, "power", False, 0.9, 4.0)], answer)

    async def play() -> list[bool]:
        state.control.take_control(ADA)
        begun = [worker.start(one, WorkOptions()).success for one in (EVE, BOB, ADA, ADA)]
        ended = [worker.pause(one).success for one in (EVE, BOB, BOB)]
        return [*begun, *ended]

    assert asyncio.run(play()) == [False, False, True, False, False, True, False]
    assert [who for who, detail in audited if detail.startswith("done")] == ["Ada start_run", "Bob pause_run"]
    assert ("Eve pause_run", "refused: expected the role operate, found look; log in as one who may") in audited


class SwapOfMinutes(Calls):
    """A swap that lasts until it is let go on."""

    def __init__(self) -> None:
        super().__init__()
        self.swapped = asyncio.Event()

    async def call(self, act: Act, who: str) -> ActResult:
        self.acts.append((act.name, who))
        if act.name == "swap":
            await self.swapped.wait()
        return ActResult(success=True, message="GRIPPED: held", answer=ANSWER)


def test_a_run_that_is_paused_during_a_swap_grasps_nothing_after_it(state: PanelState, clock: ManualClock) -> None:
    calls = SwapOfMinutes()
    desk = ActDesk(state, calls, ActRecord(None, clock))
    run = WorkRun(clock)
    worker = Worker(desk, run)
    state.control.take_control(ADA)
    run.plan([PlannedStep("egg", 1, "power", True, 0.9, 4.0)], ANSWER)

    async def work() -> list[str]:
        assert worker.start(ADA, WorkOptions()).success
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        assert worker.pause(BOB).success
        calls.swapped.set()
        for _ in range(10):
            await asyncio.sleep(0)
        before = [name for name, _ in calls.acts]
        assert worker.start(ADA, WorkOptions()).success
        for _ in range(20):
            await asyncio.sleep(0)
        return before

    assert asyncio.run(work()) == ["swap"]
    assert run.phase is WorkPhase.ENDED  # going on, it grasps what was still to come
    assert [name for name, _ in calls.acts][1:] == ["swap", "grasp", "release"]


class RefusingCalls(Calls):
    """A cell that grasps everything but grapes."""

    async def call(self, act: Act, who: str) -> ActResult:
        await super().call(act, who)
        if act.name != "grasp":
            return ActResult(success=True, message="done")
        if act.subject == "grape":
            return ActResult(success=False, message="TENDON_FAULT: index: no reply", answer=act)
        return ActResult(success=True, message="GRIPPED: both sides press", answer=act)


def test_a_product_that_is_always_refused_is_left_out_by_who_has_control(state: PanelState, clock: ManualClock) -> None:
    desk = ActDesk(state, RefusingCalls(), ActRecord(None, lambda: 0.0))
    audited: list[tuple[str, str, str, str]] = []
    desk.on_done = lambda *line: audited.append(line)
    worker = Worker(desk, WorkRun(clock))
    answer = SimpleNamespace(swaps=0, predicted_time=8.0, expected_success=0.9, redundant_sets=[])
    steps = [PlannedStep("grape", 1, "power", False, 0.9, 4.0), PlannedStep("egg", 1, "power", False, 0.9, 4.0)]
    worker.run.plan(steps, answer)
    mounted = (MountedView("index", "A", "power", "verified"),)
    state.observe_cell(CellView("IDLE", "power", mounted))

    async def until_it_rests() -> None:
        for _ in range(100):
            await asyncio.sleep(0)

    async def play() -> list[bool]:
        state.control.take_control(ADA)
        before = worker.leave_out(ADA).success  # nothing is paused yet
        worker.start(ADA, WorkOptions())
        in_run = worker.leave_out(ADA).success
        await until_it_rests()
        assert worker.run.phase is WorkPhase.PAUSED
        worker.start(ADA, WorkOptions())  # it is refused as often as it is tried
        await until_it_rests()
        assert worker.run.next_number == 0
        left = [worker.leave_out(one).success for one in (EVE, BOB, ADA)]
        worker.start(ADA, WorkOptions())
        await until_it_rests()
        return [before, in_run, *left]

    assert asyncio.run(play()) == [False, False, False, False, True]
    assert worker.run.phase is WorkPhase.ENDED
    assert [(item.product, item.outcome) for item in worker.run.items] == [("grape", LEFT_OUT), ("egg", "GRIPPED")]
    assert worker.run.items[0].reason == "left out by Ada: TENDON_FAULT: index: no reply"
    figures = worker.run.figures()
    assert (figures.done, figures.total, figures.gripped, figures.quality) == (1, 1, 1, 1.0)
    assert ("Ada", "leave_out", "grape", "done: item 1 of 2 is left out") in audited
    assert [line[0] for line in audited if line[1] == "leave_out"] == ["Ada", "Ada", "Eve", "Bob", "Ada"]


def test_leaving_the_last_product_out_ends_the_run(state: PanelState, clock: ManualClock) -> None:
    worker = Worker(ActDesk(state, Calls(), ActRecord(None, lambda: 0.0)), WorkRun(clock))
    answer = SimpleNamespace(swaps=0, predicted_time=4.0, expected_success=0.9, redundant_sets=[])
    worker.run.plan([PlannedStep("grape", 1, "power", False, 0.9, 4.0)], answer)
    worker.run.go_to(WorkPhase.PAUSED, "refused")
    state.control.take_control(ADA)
    assert worker.leave_out(ADA).success
    assert worker.run.phase is WorkPhase.ENDED
    assert math.isnan(worker.run.figures().quality)
    assert not worker.leave_out(ADA).success


def test_a_record_that_cannot_be_written_is_said_and_ends_nothing(state: PanelState) -> None:
    record = ActRecord(Path("/dev/null/acts.jsonl"), lambda: 0.0)
    assert run(ActDesk(state, Calls(), record), EVE, acts.estop()).success
    assert "expected to write it" in record.problem


@pytest.mark.parametrize("act", acts.EXAMPLES, ids=lambda act: act.name)
def test_every_act_is_a_command_line_of_ros2(act: Act) -> None:
    command = act.call.command_line("/cell_1")
    assert command.startswith(("ros2 service call /cell_1/", "ros2 action send_goal --feedback /cell_1/"))


def test_a_hostile_name_stays_one_word_of_the_command_line() -> None:
    import shlex  # noqa: PLC0415

    command = acts.grasp("x'; rm -rf / #\"").call.command_line()
    assert len(shlex.split(command)) == 7


# --- alarms


def test_the_life_of_an_alarm(clock: ManualClock) -> None:
    book = AlarmBook(clock)
    fact = AlarmFact("here", "broken")
    book.observe("source", {"k": fact})
    book.advance()
    assert book.active[0].stage is AlarmStage.RAISED
    clock.s += 1.0
    book.advance()
    assert book.active[0].stage is AlarmStage.CONFIRMED
    book.observe("source", {})
    clock.s += 2.0
    book.advance()
    assert book.active[0].stage is AlarmStage.HEALED  # it stays until somebody has seen it
    book.observe("source", {"k": fact})
    assert book.active[0].stage is AlarmStage.RAISED
    assert book.active[0].times == 2
    book.acknowledge("k", "Ada")
    with pytest.raises(ActRefusedError, match="Ada has acknowledged"):
        book.acknowledge("k", "Bob")
    book.observe("source", {})
    clock.s += 2.0
    book.advance()
    assert book.active == ()
    assert book.history[0].acknowledged_by == "Ada"


def test_a_short_gap_does_not_heal_an_alarm(clock: ManualClock) -> None:
    book = AlarmBook(clock)
    for _ in range(5):
        book.observe("source", {"k": AlarmFact("here", "flickers")})
        clock.s += 0.4
        book.advance()
        book.observe("source", {})
        clock.s += 0.4
        book.advance()
    assert len(book.active) == 1
    assert book.active[0].times == 1


@pytest.mark.parametrize("name", sorted(set(FAULTS) - {"estop"}))
def test_a_fault_of_the_table_becomes_an_alarm_with_its_remedy(name: str, state: PanelState) -> None:
    state.observe_tendons([TendonView("index", "STOPPED", homed=True, fault=name, reason="found so")])
    (alarm,) = state.alarms.active
    assert FAULTS[name].meaning in alarm.fact.title
    assert alarm.fact.cause == "found so"
    assert alarm.fact.remedy == FAULTS[name].remedy


def test_a_silent_driver_is_an_alarm(state: PanelState, clock: ManualClock) -> None:
    state.observe_tendons([])
    clock.s += SILENCE_S + 0.1
    state.advance()
    assert state.is_stale
    assert "silent" in state.alarms.active[0].fact.title


SWAP_LOCK = SafetyView(locked=True, lock_owner="grasp_mix_manager: swap to 'power'", lock_reason="swap to 'power'")


def said(name: str, message: str, level: int = 1) -> ComponentHealth:
    return ComponentHealth(name, level, message)


def play(state: PanelState, clock: ManualClock, seconds: float, *statuses: ComponentHealth) -> None:
    """Let time pass with /diagnostics once a second and the panel's ticks between."""
    for _ in range(round(10 * seconds)):
        if round(10 * clock.s) % 10 == 0:
            state.observe_health(statuses)
        state.observe_tendons([TendonView("index", "HOLDING", homed=True)])
        clock.s = round(clock.s + 0.1, 1)
        state.advance()


def test_a_healthy_shift_has_no_alarm_to_acknowledge(state: PanelState, clock: ManualClock) -> None:
    """What an emulated cell says from its start through a swap to a grasp."""
    frames, late = "c/marker_tracker: frames", "c/tendon_driver: executor"
    state.observe_cell(CellView("IDLE", "power"))
    state.observe_safety(SafetyView())
    play(state, clock, 4.0, said(frames, "no frame yet; is the camera running?"))
    play(state, clock, 2.0, said(frames, "measured", 0), said(late, "callbacks were run 1.4 s late"))
    play(state, clock, 2.0, said(late, "", 0))
    state.observe_safety(SWAP_LOCK)  # before the cell says that it swaps
    play(state, clock, 0.5)
    state.observe_cell(CellView("SWAPPING", "power"))
    play(state, clock, 250.0, said("c/gdfe_simulator: finger index", "cable slack: shown at rest", 0))
    assert [one.title for one in state.alarms.remarks] == ["drives locked by grasp_mix_manager: swap to 'power'"]
    state.observe_safety(SafetyView())
    state.observe_cell(CellView("IDLE", "power"))
    play(state, clock, 5.0, said("c/gdfe_simulator: finger index", "4.0 Hz instead of 10 Hz: states come more slowly"))
    play(state, clock, 5.0, said("c/gdfe_simulator: finger index", "1200 hexahedra at 10 Hz", 0))
    assert state.alarms.active == ()
    assert state.alarms.remarks == ()


LASTING = {
    "a node that is always late": said("c/camera: executor", "callbacks were run 2.0 s late; see what takes so long"),
    "a callback that failed": said("c/camera: executor", "a callback failed, see the log: ValueError"),
    "markers that the tracker has lost": said("c/marker_tracker: finger index", "index: tip not seen"),
    "no frame at all": said("c/marker_tracker: frames", "no frame yet; is the camera running?"),
    "shapes that stay coarse": said("c/gdfe_simulator: finger index", "coarser mesh"),
    "a node that is gone": said("c/grasp_mix_manager: node /c/camera", "gone: ended"),
    "an input that is gone": said("c/kinematics_predictor: input tendon/state", "gone: ended"),
    "a finger that is worn": said("c/kinematics_predictor: finger index", "friction +20 %: swap it"),
}


@pytest.mark.parametrize("status", LASTING.values(), ids=list(LASTING))
def test_what_lasts_is_an_alarm_with_cause_and_remedy(
    status: ComponentHealth, state: PanelState, clock: ManualClock
) -> None:
    play(state, clock, 12.0, status)
    (alarm,) = state.alarms.active
    assert alarm.fact.title == status.message
    assert alarm.fact.cause
    assert alarm.fact.remedy
    assert state.alarms.remarks == ()


def test_an_error_waits_for_nothing(state: PanelState) -> None:
    for name in ("c/tendon_driver: bus", "c/marker_tracker: frames", "c/gdfe_simulator: finger index"):
        state.observe_health([said(name, "no frame: lost", 2)])
    assert len(state.alarms.active) == 3


BOBS_LOCK = SafetyView(locked=True, lock_owner="Bob", lock_reason="hands inside")


@pytest.mark.parametrize(
    ("lock", "cell", "after_s"),
    [
        (BOBS_LOCK, CellView("SWAPPING"), 0.0),
        (BOBS_LOCK, CellView("IDLE"), 0.0),
        (SWAP_LOCK, CellView("IDLE"), 1.0),
        (SWAP_LOCK, CellView("SWAPPING", reason="FAILED at remove; confirm hands_out"), 1.0),  # hands may be inside
        (SWAP_LOCK, CellView("SWAPPING", reason="restarted during swap"), 1.0),
        (SWAP_LOCK, CellView("FAULT"), 1.0),
        (SWAP_LOCK, None, 1.0),
    ],
    ids=["another's in a swap", "another's", "no swap's", "an ended swap's", "a lost swap's", "fault", "no manager"],
)
def test_a_lock_that_is_no_running_swaps_own_is_an_alarm(
    lock: SafetyView, cell: CellView | None, after_s: float, state: PanelState, clock: ManualClock
) -> None:
    if cell is not None:
        state.observe_cell(cell)
    state.observe_safety(lock)
    clock.s += after_s
    state.observe_tendons([])
    state.advance()
    (alarm,) = state.alarms.active
    assert lock.lock_owner in alarm.fact.title
    assert alarm.fact.cause == lock.lock_reason
    assert alarm.fact.remedy


def test_what_comes_and_goes_before_it_has_lasted_begins_at_nothing(clock: ManualClock) -> None:
    book = AlarmBook(clock)
    fact = AlarmFact("here", "late", must_last_s=3.0)
    for _ in range(5):
        book.observe("source", {"k": fact})
        clock.s += 2.0
        book.advance()
        book.observe("source", {})
    assert book.active == ()
    book.observe("source", {"k": fact})
    clock.s += 3.0
    book.advance()  # the source need not say it twice
    assert [alarm.key for alarm in book.active] == ["k"]


# --- verdicts of fingers


@pytest.mark.parametrize(
    ("verdict", "reason", "mode", "said_of_it"),
    [
        ("OK", "learning the baseline: closing 1 of 5", "HOLDING", ("fingers.not_judged", False)),
        ("OK", "", "HOLDING", ("fingers.not_judged", False)),
        ("OK", "", "GRASPING", ("fingers.not_judged", False)),
        ("OK", "learning the baseline: closing 1 of 5", "IDLE", ("fingers.learning", False)),
        ("UNSET", "", "IDLE", ("fingers.learning", False)),
        ("OK", "", "IDLE", ("", True)),
        ("WORN", "friction +60 %", "HOLDING", ("", False)),  # what wants an act is said at all times
        ("RECALIBRATE", "friction +20 %", "IDLE", ("", False)),
    ],
)
def test_a_finger_is_good_only_when_it_was_judged(
    verdict: str, reason: str, mode: str, said_of_it: tuple[str, bool]
) -> None:
    residual = ResidualView("index", 0.030, 31.0, 0.0, 0.0, verdict, reason)
    assert explain_residual(residual, CellView(mode)) == said_of_it


# --- finger sets


def test_the_sets_to_swap_to_are_the_catalogues_a_users_own_too(state: PanelState) -> None:
    assert state.finger_sets == ()
    marks = {"power": "success", "pinch": "", "hook": "failure"}
    egg = ProductView("egg", "egg", "power", 0.06, marks, {}, {})
    state.catalogue = (egg, replace(egg, id="nut", table_marks={**marks, "my_pinch": "success"}))
    assert state.finger_sets == ("power", "pinch", "hook", "my_pinch")


# --- explanations


def test_what_a_stop_will_do_follows_the_policy() -> None:
    assert explain_stop(StopPolicyView("let_go", 5.0))[0] == "estop.will_let_go"
    assert explain_stop(StopPolicyView("hold", 5.0)) == ("estop.will_hold", {"tension": 5.0})
    assert explain_stop(StopPolicyView())[0] == "estop.will_unknown"


def test_what_a_reset_will_do_names_what_is_to_be_homed() -> None:
    tendons = [TendonView("index", "STOPPED", homed=True), TendonView("thumb", "STOPPED", homed=False)]
    keys = [key for key, _ in explain_reset(SafetyView(estop=True, locked=True, lock_owner="me"), tendons)]
    assert keys == ["reset.will", "reset.will_home", "reset.will_locked"]
    assert explain_reset(SafetyView(), tendons) == [("reset.none", {})]


# --- orders


def test_orders_are_read_as_people_write_them() -> None:
    text = 'product,quantity\negg,2\n"grape";10\norange=3\n\nmuffin\nbanana 4'
    assert read_orders(text) == [
        OrderLine("egg", 2),
        OrderLine("grape", 10),
        OrderLine("orange", 3),
        OrderLine("muffin", 1),
        OrderLine("banana", 4),
    ]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "expected lines"),
        ("egg,0", "line 1"),
        ("egg,2\n<script>,1", "line 2"),
        ("egg,99999", "1 .. 10000"),
        ("egg,2,3", "a product and a number"),
        ("egg,²", "a number"),
        ("a\n" * 1001, "at most 1000 lines"),
        ("é" * 40_000, "KiB"),
    ],
)
def test_a_wrong_order_list_is_refused_with_its_place(text: str, said: str) -> None:
    with pytest.raises(PanelError, match=said):
        read_orders(text)


@given(st.text(max_size=200))
@settings(deadline=None)
def test_no_text_breaks_the_order_list(text: str) -> None:
    try:
        orders = read_orders(text)
    except PanelError:
        return
    assert all(order.quantity >= 1 and order.product.isascii() for order in orders)


# --- swap, grasps, frames


def test_a_swap_is_taken_up_after_the_panels_end(tmp_path: Path) -> None:
    file = tmp_path / "panel" / "swap.json"
    first = SwapFollower()
    first.keep_in(file)
    first.begin_swap("pinch", "Ada", 100.0)
    first.observe("insert", "Insert them.", "t0ken", needs_confirmation=True)
    assert file.stat().st_mode & 0o077 == 0  # it holds the token
    second = SwapFollower()
    second.keep_in(file)
    assert second.view == first.view
    second.end(success=False, message="cancelled; confirm step 'hands_out' with the token")
    assert second.view.phase is SwapPhase.HANDS_INSIDE
    third = SwapFollower()
    third.keep_in(file)
    assert third.view.token == "t0ken"
    third.observe_mode("IDLE", "hands are out")
    assert third.view.phase is SwapPhase.ENDED


FOREIGN = SwapView(
    SwapPhase.RUNNING, "hook", "remove", "Take them out.", needs_confirmation=True, started_s=50.0, goal_id="0f"
)  # fmt: skip


def test_a_swap_of_another_client_is_shown_and_cannot_be_confirmed_here(tmp_path: Path) -> None:
    swap = SwapFollower()
    swap.keep_in(tmp_path / "swap.json")
    swap.observe_progress(FOREIGN)
    assert (swap.view.step, swap.view.instruction, swap.view.started_s) == ("remove", "Take them out.", 50.0)
    assert swap.view.is_waiting
    assert not swap.view.can_be_confirmed
    swap.observe_mode("SWAPPING", "swapping to 'hook'")
    assert swap.view.is_open
    swap.observe_progress(replace(FOREIGN, phase=SwapPhase.HANDS_INSIDE, step="", message="cancelled"))
    swap.observe_mode("SWAPPING", f"cancelled; confirm step '{HANDS_OUT}'")
    assert (swap.view.phase, swap.view.can_be_confirmed) == (SwapPhase.HANDS_INSIDE, False)
    swap.observe_progress(replace(FOREIGN, phase=SwapPhase.ENDED, needs_confirmation=False, message="cancelled"))
    assert (swap.view.phase, swap.view.is_waiting) == (SwapPhase.ENDED, False)
    assert not (tmp_path / "swap.json").exists()  # of a later panel it would be no swap of its own


def test_an_own_swap_keeps_its_token_whatever_is_said_to_everybody(tmp_path: Path) -> None:
    swap = SwapFollower()
    swap.keep_in(tmp_path / "swap.json")
    mine = replace(FOREIGN, finger_set="pinch", goal_id="aa")
    swap.observe_progress(mine)  # before the goal's acceptance has come
    assert swap.view.is_foreign
    swap.begin_swap("pinch", "Ada", 100.0, "aa")
    assert (swap.view.is_foreign, swap.view.step, swap.view.who) == (False, "remove", "Ada")
    swap.observe("insert", "Insert them.", "t0ken", needs_confirmation=True)
    own = swap.view
    for other in (mine, replace(FOREIGN, phase=SwapPhase.ENDED), replace(FOREIGN, goal_id="")):
        swap.observe_progress(other)
        assert swap.view == own
    later = SwapFollower()  # of a panel that was started again
    later.keep_in(tmp_path / "swap.json")
    later.observe_progress(replace(mine, step="close_palm", instruction="Close the palm."))
    assert (later.view.step, later.view.token, later.view.who) == ("close_palm", "t0ken", "Ada")
    assert later.view.can_be_confirmed
    # a manager that was started again knows no goal; its cell/state says what became of the swap
    later.observe_progress(SwapView(SwapPhase.HANDS_INSIDE, "pinch", needs_confirmation=True))
    assert later.view.token == "t0ken"
    later.observe_mode("SWAPPING", f"restarted during swap 'pinch'; confirm step '{HANDS_OUT}'")
    assert (later.view.phase, later.view.can_be_confirmed) == (SwapPhase.HANDS_INSIDE, True)


def test_a_swap_that_ended_while_the_panel_was_away_gives_way_to_the_next(tmp_path: Path) -> None:
    first = SwapFollower()
    first.keep_in(tmp_path / "swap.json")
    first.begin_swap("pinch", "Ada", 100.0, "aa")
    first.observe("insert", "Insert them.", "t0ken", needs_confirmation=True)
    later = SwapFollower()
    later.keep_in(tmp_path / "swap.json")
    later.observe_progress(FOREIGN)
    assert (later.view.finger_set, later.view.token, later.view.can_be_confirmed) == ("hook", "", False)


def test_a_spoiled_file_of_a_swap_is_no_swap(tmp_path: Path) -> None:
    (tmp_path / "swap.json").write_text('{"phase": "dancing"}')
    swap = SwapFollower()
    swap.keep_in(tmp_path / "swap.json")
    assert swap.view.phase is SwapPhase.NONE


def test_a_grasp_is_kept_with_curve_pictures_and_verdict(state: PanelState, clock: ManualClock) -> None:
    state.grasps.observe_picture(b"before")
    state.observe_cell(CellView("IDLE", "power"))
    state.observe_cell(CellView("GRASPING", "power", product="=egg"))
    for k in range(5):
        clock.s += 0.1
        state.observe_tensions([TensionView("index", 0.001 * k, 2.0 * k, math.nan)])
        state.grasps.observe_picture(f"at {k}".encode())
    state.observe_cell(CellView("IDLE", "power", slipped=1, picks=1))
    clock.s += 1.5
    state.grasps.observe_picture(b"after")
    (record,) = state.grasps.records
    assert record.outcome == "SLIPPED"  # by the counter: somebody else ordered it
    assert record.pictures == {"before": b"before", "at": b"at 4", "after": b"after"}
    assert [sample.tension_n for sample in record.samples] == [(0.0,), (2.0,), (4.0,), (6.0,), (8.0,)]
    assert ",'=egg," in export_csv(grasp_rows(state.grasps.records, ()))  # no formula for a spreadsheet


def test_a_grasp_that_follows_at_once_leaves_the_one_before_its_picture(state: PanelState, clock: ManualClock) -> None:
    for k in range(2):
        state.observe_cell(CellView("GRASPING", "power", product="egg"))
        state.grasps.observe_picture(f"at {k}".encode())
        state.observe_cell(CellView("IDLE", "power", gripped=k + 1, picks=k + 1))
        for tenth in range(1, 4):
            clock.s += 0.1
            state.grasps.observe_picture(f"after {k}, {tenth}".encode())
    clock.s += 2.0
    state.grasps.observe_picture(b"long after")
    second, first = state.grasps.records
    assert first.pictures == {"at": b"at 0", "after": b"after 0, 3"}
    assert second.pictures == {"before": b"after 0, 3", "at": b"at 1", "after": b"after 1, 3"}


@pytest.mark.parametrize(
    ("stamp_s", "at_s"),
    [(502.0, 0.2), (503.0, 0.3), (502.5, 0.25), (507.0, 0.7), (math.nan, None)],
    ids=["a sample", "the next", "between two", "after the last", "none decided"],
)
def test_the_deciding_moment_is_the_deciding_samples_not_the_results(
    stamp_s: float, at_s: float | None, state: PanelState, clock: ManualClock
) -> None:
    state.observe_cell(CellView("GRASPING", "power", product="egg"))
    for k in range(1, 5):  # the cell lives ten times as fast as the panel
        clock.s += 0.1
        state.observe_tensions([TensionView("index", 0.001, 2.0)], 500.0 + k)
    state.observe_cell(CellView("HOLDING", "power"))
    clock.s += 2.0  # the result comes late
    state.grasps.observe_result(
        "GRIPPED", "both press", duration_s=0.4, latency_s=0.0, fingers=(), decided_stamp_s=stamp_s
    )
    (record,) = state.grasps.records
    assert record.decided_s == (None if at_s is None else pytest.approx(at_s))


def test_frames_are_what_the_page_reads() -> None:
    message = pack_picture(PanelPicture(7, b"\xff\xd8jpeg", (640, 480), {"measured": [(1.0, 2.0), (math.nan, 3.0)]}))
    kind, length = struct.unpack_from(">BI", message)
    head = json.loads(message[5 : 5 + length])
    assert (kind, head["number"], head["lines"]) == (1, 7, {"measured": [[1.0, 2.0]]})
    assert message[5 + length :] == b"\xff\xd8jpeg"
    tensions = pack_tensions([TensionView("index", 0.0012, 3.456, math.nan)], stale=True)
    assert json.loads(tensions[1:]) == {"stale": True, "rows": [["index", 3.46, None, 1.2]]}


# --- bags and records


def test_only_files_of_listed_bags_are_reached(tmp_path: Path) -> None:
    bag = tmp_path / "bags" / "one"
    bag.mkdir(parents=True)
    (bag / "a.mcap").write_bytes(b"12345")
    (bag / "link.mcap").symlink_to("/etc/passwd")
    (tmp_path / "bags" / "empty").mkdir()
    (tmp_path / "secret").write_text("no")
    folder = BagFolder(tmp_path / "bags")
    (found,) = folder.bags()
    assert (found.name, found.files, found.size) == ("one", (("a.mcap", 5),), 5)
    assert folder.file("one", "a.mcap") == bag / "a.mcap"
    for wrong in (("one", "../../secret"), ("..", "secret"), ("one", "link.mcap"), ("two", "a.mcap"), ("one", "")):
        with pytest.raises(PanelError):
            folder.file(*wrong)
    with pytest.raises(PanelError):
        folder.report("../secret")
    assert BagFolder(None).bags() == ()


def test_a_grasp_of_another_client_gets_its_deciding_sample_from_the_database(
    state: PanelState, clock: ManualClock
) -> None:
    """The panel sees it begin and end by cell/state and has its curve; the cell's own time runs twice as fast."""
    before = CellView("IDLE", "power", tuple(MountedView(name, "", "", "verified") for name in ("index", "thumb")))
    state.observe_cell(before)
    state.observe_cell(replace(before, mode="GRASPING", product="egg"))
    for step in range(21):
        state.observe_tensions([TensionView("index", 0.001 * step, 0.5 * step)], 5000.0 + 0.2 * step)
        clock.s += 0.1
    state.observe_cell(replace(before, mode="HOLDING", product="egg", picks=1, gripped=1))
    judged = (FingerDecision("index", "BLOCKED", 3.1, 0.9),)
    serials = ("PW-I-01", "PW-T-01")
    other = CountedView(5004.3, "grape", "power", "GRIPPED", "another product", 1.0, serials, 5003.0, judged)
    early = CountedView(4000.0, "egg", "power", "GRIPPED", "long before", 1.0, serials, 3999.0, judged)
    its = CountedView(5004.3, "egg", "power", "GRIPPED", "both sides press", 4.2, serials, 5003.0, judged)
    state.observe_counted([other, its, early])
    (record,) = state.grasps.records
    assert (record.reason, record.serials, record.fingers) == ("both sides press", serials, judged)
    assert record.decided_s == pytest.approx(1.5)  # 3 s of the cell after the first sample
    version = state.grasps.version
    state.observe_counted([replace(one) for one in (other, its, early)])  # the next look
    assert state.grasps.version == version
    assert [row.reason for row in grasp_rows(state.grasps.records, state.counted)] == [
        "both sides press", "another product", "long before",
    ]  # fmt: skip


def test_the_panels_own_verdict_is_not_changed_by_the_database(state: PanelState, clock: ManualClock) -> None:
    idle = CellView("IDLE", "power")
    state.observe_cell(idle)
    state.observe_cell(replace(idle, mode="GRASPING", product="egg"))
    state.observe_tensions([TensionView("index", 0.0, 1.0)], 100.0)
    clock.s += 0.5
    state.observe_tensions([TensionView("index", 0.001, 2.0)], 100.5)
    own = (FingerDecision("index", "CONTACT", 1.0, 0.9),)
    state.grasps.observe_result("GRIPPED", "own", duration_s=1.0, latency_s=0.0, fingers=own, decided_stamp_s=100.25)
    state.observe_cell(replace(idle, mode="HOLDING", product="egg", gripped=1))
    state.observe_counted([CountedView(101.0, "egg", "power", "GRIPPED", "told", 1.0, (), 100.5, ())])
    (record,) = state.grasps.records
    assert (record.reason, record.fingers, record.decided_s) == ("own", own, pytest.approx(0.25))


def test_grasps_of_panel_and_database_are_one_list() -> None:
    seen = [GraspRecord(2, 50.0, "egg", "power", ("A", "B"), outcome="GRIPPED")]
    counted = [
        CountedView(9050.0, "egg", "power", "GRIPPED", "held", 1.0),
        CountedView(9000.0, "egg", "power", "GRIPPED", "held", 1.0),
        CountedView(8000.0, "grape", "pinch", "EMPTY", "nothing", 1.0),
    ]
    rows = grasp_rows(seen, counted)
    assert [(row.number, row.product) for row in rows] == [(2, "egg"), (None, "egg"), (None, "grape")]
    assert export_csv(rows).splitlines()[2].startswith(",9000.000,egg,power,,GRIPPED,")  # the database's, too
    assert [row.product for row in rows if GraspFilter(outcome="EMPTY").admits(row)] == ["grape"]
    assert [row.number for row in rows if GraspFilter(serial="a").admits(row)] == [2]


def test_figures_of_a_run_by_their_formulas(clock: ManualClock) -> None:
    run = WorkRun(clock)
    answer = SimpleNamespace(swaps=1, predicted_time=40.0, expected_success=0.9, redundant_sets=[])
    run.plan([PlannedStep("egg", 4, "power", False, 0.9, 40.0)], answer)
    run.go_to(WorkPhase.RUNNING)
    for k, outcome in enumerate(("GRIPPED", "GRIPPED", "SLIPPED")):
        clock.s += 20.0
        run.finish(k, outcome, "", 20.0)
    run.go_to(WorkPhase.PAUSED)
    clock.s += 20.0
    figures = run.figures()
    assert (figures.done, figures.total, figures.gripped) == (3, 4, 2)
    assert figures.rate_per_h == pytest.approx(3 / 60.0 * 3600.0)
    assert figures.availability == pytest.approx(60.0 / 80.0)
    assert figures.performance == pytest.approx(3 * 10.0 / 60.0)
    assert figures.quality == pytest.approx(2.0 / 3.0)
    assert figures.oee == pytest.approx(0.75 * 0.5 * 2.0 / 3.0)


ANSWER = SimpleNamespace(swaps=1, predicted_time=40.0, expected_success=0.9, redundant_sets=["hook"])


def test_an_order_list_comes_back_paused_with_what_is_done_counted(tmp_path: Path, clock: ManualClock) -> None:
    file, day = tmp_path / "panel" / "work.json", ManualClock(5000.0)
    first = WorkRun(clock)
    first.keep_in(file, day)
    first.plan([PlannedStep("egg", 4, "power", False, 0.9, 40.0)], ANSWER)
    first.go_to(WorkPhase.RUNNING)
    for number, outcome in enumerate(("GRIPPED", "SLIPPED")):
        clock.s, day.s = clock.s + 20.0, day.s + 20.0
        first.finish(number, outcome, "as it was", 20.0)
    assert file.stat().st_mode & 0o077 == 0
    day.s += 40.0  # killed in the midst of the third egg; the next panel's clock is another one
    later = WorkRun(ManualClock(7.0))
    later.keep_in(file, day)
    assert (later.phase, later.next_number, later.items[:2]) == (WorkPhase.PAUSED, 2, first.items[:2])
    assert [one.outcome for one in later.items] == ["GRIPPED", "SLIPPED", "", ""]
    assert "started again" in later.message
    assert (later.swaps, later.redundant_sets, later.expected_success) == (1, ("hook",), 0.9)
    figures = later.figures()
    assert (figures.done, figures.total, figures.gripped) == (2, 4, 1)
    assert figures.availability == pytest.approx(40.0 / 80.0)  # the time without a panel is no time of work
    later.go_to(WorkPhase.RUNNING)
    later.finish(2, "GRIPPED", "", 5.0)
    third = WorkRun(clock)
    third.keep_in(file, day)
    assert (third.phase, third.next_number, third.problem) == (WorkPhase.PAUSED, 3, "")


@pytest.mark.parametrize("phase", [WorkPhase.PLANNED, WorkPhase.ENDED])
def test_a_list_that_did_not_run_comes_back_as_it_was(tmp_path: Path, clock: ManualClock, phase: WorkPhase) -> None:
    first = WorkRun(clock)
    first.keep_in(tmp_path / "work.json", clock)
    first.plan([PlannedStep("egg", 1, "power", False, math.nan, 4.0)], replaced(ANSWER, expected_success=math.nan))
    first.go_to(phase)
    later = WorkRun(clock)
    later.keep_in(tmp_path / "work.json", clock)
    assert (later.phase, later.items, later.paused_s) == (phase, first.items, 0.0)
    assert math.isnan(later.expected_success)


def replaced(answer: SimpleNamespace, **changes: Any) -> SimpleNamespace:
    return SimpleNamespace(**{**vars(answer), **changes})


def kept_document(folder: Path, clock: ManualClock) -> dict[str, Any]:
    run = WorkRun(clock)
    run.keep_in(folder / "work.json", clock)
    run.plan([PlannedStep("egg", 2, "power", False, 0.9, 8.0)], ANSWER)
    document: dict[str, Any] = json.loads((folder / "work.json").read_text())
    return document


@pytest.mark.parametrize(
    "spoil",
    [
        lambda document: json.dumps(document)[:-20],
        lambda _: "\x00" * 100,
        lambda _: "[]",
        lambda document: json.dumps({**document, "phase": "dancing"}),
        lambda document: json.dumps({**document, "running_s": math.nan}),
        lambda document: json.dumps({**document, "items": [["egg", "power", 4.0, "EATEN", "", 0.0]]}),
        lambda document: json.dumps({**document, "items": [["egg", 7, 4.0, "", "", 0.0]]}),
        lambda document: json.dumps({**document, "items": document["items"] * 2501}),
        lambda document: json.dumps({name: value for name, value in document.items() if name != "at_s"}),
    ],
)
def test_a_spoiled_order_list_is_none_and_is_said(tmp_path: Path, clock: ManualClock, spoil: Any) -> None:
    (tmp_path / "work.json").write_text(spoil(kept_document(tmp_path, clock)))
    run = WorkRun(clock)
    run.keep_in(tmp_path / "work.json", clock)
    assert (run.phase, run.items) == (WorkPhase.EMPTY, ())
    assert "work.json: expected the order list of an earlier panel" in run.problem
    run.plan([PlannedStep("egg", 1, "power", False, 0.9, 4.0)], ANSWER)
    assert run.problem == ""


def test_a_disk_that_takes_no_order_list_is_said_and_ends_no_run(tmp_path: Path, clock: ManualClock) -> None:
    (tmp_path / "panel").write_text("no folder")
    run = WorkRun(clock)
    run.keep_in(tmp_path / "panel" / "work.json", clock)
    run.plan([PlannedStep("egg", 2, "power", False, 0.9, 8.0)], ANSWER)
    run.go_to(WorkPhase.RUNNING)
    run.finish(0, "GRIPPED", "", 4.0)
    assert (run.phase, run.figures().done) == (WorkPhase.RUNNING, 1)
    assert "order list: expected to write" in run.problem


@pytest.mark.long
def test_eight_hours_leave_the_model_as_large_as_the_first_three_did(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(Path(__file__).parent)  # benchmarks/driver/panel_memory.py plays the same cell
    busy_cell = importlib.import_module("busy_cell")
    clock = busy_cell.SimulatedTime()
    state = PanelState(clock, clock)
    state.observe_cell(CellView("IDLE", "power"))
    cell = busy_cell.BusyCell(ActDesk(state, Calls(), ActRecord(None, clock)), clock)
    # every tenth tick: each grasp, each alarm, a second between tensions
    tracemalloc.start()
    sizes = []
    for hour in range(8):
        for number in range(hour * 36_000, (hour + 1) * 36_000, 10):
            cell.tick(number)
        gc.collect()
        sizes.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert cell.grasps == 8 * 180
    assert len(state.grasps.records) == MAX_GRASPS
    assert sizes[-1] < 1.1 * sizes[2], sizes  # by then every list of a fixed length is full
    pictured = [record for record in state.grasps.records if record.pictures]
    assert len(pictured) == MAX_PICTURED  # the rest of what is kept is small
