# SPDX-License-Identifier: Apache-2.0
"""Two hundred operators press what they like, a thousand acts each, while the cell has faults and the panel restarts.

What may reach the cell is decided by a second account of the rules (docs/panel.md), which shares no code with the
panel: who has control, what was pressed, what a run may do. Every rule is broken once to see that it is watched.
"""

from __future__ import annotations

import asyncio
import random
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from softgrip_driver.faults import FAULTS
from softgrip_panel.access.record import ActRecord
from softgrip_panel.model import acts
from softgrip_panel.model.acts import Act, ActResult
from softgrip_panel.model.control import ControlDesk
from softgrip_panel.model.desk import ActDesk
from softgrip_panel.model.facts import CellView, CountedView, SafetyView, TendonView, TensionView
from softgrip_panel.model.orders import OrderLine
from softgrip_panel.model.roles import Person, Role
from softgrip_panel.model.state import PanelState
from softgrip_panel.model.work import Worker, WorkOptions, WorkRun
from softgrip_panel.model.work_file import WorkPhase
from softgrip_testing.manual_clock import ManualClock

OPERATORS, ACTS_EACH = 200, 1000
#: Without a page for so long somebody's control may be taken [s] (docs/panel.md).
LOST_S = 10.0
#: What may switch torque on or make a tendon pull.
POWERING = {"estop_reset", "home", "grasp", "swap", "calibrate", "confirm_rig", "confirm_step", "pull", "set_driver"}
#: What everybody who operates may do, or who only looks.
FREE = {"estop", "release", "select", "plan", "snapshot", "retire_finger"}
#: A run's products; nobody orders them by hand.
RUN_PRODUCTS = ("run egg", "run grape")


#: What the panel has written and no panel has read yet.
WRITTEN: dict[Path, bytes] = {}


class Rules:
    """The rules of control, told a second time."""

    def __init__(self, clock: ManualClock) -> None:
        self.clock = clock
        self.owner: Person | None = None
        self.asked_by: Person | None = None
        self.seen_s: dict[str, float] = {}

    def sees(self, person: Person) -> bool:
        return self.clock.s - self.seen_s.get(person.session, -1e9) <= LOST_S

    def is_owner(self, person: Person) -> bool:
        return self.owner == person

    def give(self, person: Person) -> None:
        self.owner, self.asked_by = person, None
        self.seen_s[person.session] = self.clock.s

    def take(self, person: Person) -> None:
        if person.role < Role.OPERATE or self.is_owner(person):
            return
        if self.owner is None or not self.sees(self.owner):
            self.give(person)
        else:
            self.asked_by = person

    def hand_over(self, person: Person) -> None:
        if self.is_owner(person) and self.asked_by is not None and self.sees(self.asked_by):
            self.give(self.asked_by)

    def give_back(self, person: Person) -> None:
        if self.is_owner(person):
            heir, self.owner = self.asked_by, None
            if heir is not None and self.sees(heir):
                self.give(heir)

    def force(self, person: Person, reason: str) -> None:
        if person.role >= Role.ENGINEER and reason:
            self.give(person)

    def leave(self, person: Person) -> None:
        self.seen_s.pop(person.session, None)
        if self.asked_by == person:
            self.asked_by = None
        self.give_back(person)


class WatchedRecord(ActRecord):
    """Counts what was begun, in whose name."""

    def __init__(self, clock: ManualClock) -> None:
        super().__init__(None, clock)
        self.begun: Counter[tuple[str, str]] = Counter()
        self.refused = 0

    def write(self, who: str, act: str, subject: str, *, success: bool, message: str) -> None:
        self.begun[who, act] += success and message == "begun"
        self.refused += not success


class WatchedCell:
    """A cell that takes its time, refuses now and then, and looks at everything that reaches it."""

    def __init__(self, rules: Rules, chance: random.Random) -> None:
        self.rules, self.chance = rules, chance
        self.people: dict[str, Person] = {}
        self.record: WatchedRecord | None = None
        #: Presses that have not reached the cell yet.
        self.pressed: Counter[tuple[str, str]] = Counter()
        #: In whose name a run goes on; None while none does.
        self.runs: str | None = None
        self.calls: Counter[str] = Counter()
        self.in_runs: Counter[str] = Counter()
        self.is_starting = False

    async def call(self, act: Act, who: str) -> ActResult:
        assert not self.is_starting, f"{act.name} reached the cell while the panel was starting"
        person = self.people[who]
        assert person.role >= act.role, f"{who} is {person.role.word}, {act.name} wants {act.role.word}"
        if act.name not in FREE:
            assert self.rules.is_owner(person), f"{act.name} by {who}, who has no control"
        if not act.is_urgent:
            assert self.record is not None
            assert self.record.begun[who, act.name] > 0, f"{act.name} by {who} is in no record"
            self.record.begun[who, act.name] -= 1
        self._was_asked_for(act, who)
        self.calls[act.name] += 1
        for _ in range(self.chance.randrange(4)):
            await asyncio.sleep(0)
        return self._answer(act)

    def cancel(self, act_name: str) -> None:
        self.calls[f"cancel {act_name}"] += 1

    def _was_asked_for(self, act: Act, who: str) -> None:
        """No act, and so no torque, without a request: a press each, or a run that goes on in this name."""
        if act.name == "grasp" and act.subject in RUN_PRODUCTS:
            assert self.runs == who, f"a run grasps for {who}, found a run of {self.runs}"
            self.in_runs["grasp"] += 1
            return
        if act.name == "swap" and act.subject == "run set":
            assert self.runs == who, f"a run swaps for {who}, found a run of {self.runs}"
            self.in_runs["swap"] += 1
            return
        if self.pressed[who, act.name] > 0:
            self.pressed[who, act.name] -= 1
            return
        assert act.name == "release", f"{act.name} by {who}, which nobody pressed"  # what a run lets go of at its end
        self.in_runs["release"] += 1

    def _answer(self, act: Act) -> ActResult:
        if self.chance.random() < 0.2:
            return ActResult(success=False, message=self.chance.choice(["", "no", "x" * 5000, "<script>"]))
        answer: Any = None
        if act.name == "plan":
            names = act.call.request["products"]
            steps = [
                SimpleNamespace(
                    order=k, product=name, finger_set="run set", swap_before=False, expected_success=0.9,
                    predicted_time=4.0, reason="",
                )
                for k, name in enumerate(names)
            ]  # fmt: skip
            answer = SimpleNamespace(
                steps=steps, swaps=0, predicted_time=8.0, expected_success=0.9, redundant_sets=[]
            )  # fmt: skip
        outcome = self.chance.choice(["GRIPPED", "EMPTY", "ABORTED", "nonsense"]) if act.name == "grasp" else "done"
        return ActResult(success=True, message=f"{outcome}: so", answer=answer or act)


class Shift:
    """Operators, a panel and its cell.

    Args:
        folder: of the panel's state.
        seed: of chance.
        make_desk, make_worker: of the panel.
    """

    def __init__(
        self,
        folder: Path,
        seed: int,
        make_desk: Callable[..., ActDesk] = ActDesk,
        make_worker: Callable[..., Worker] = Worker,
    ) -> None:
        self.folder, self.chance, self.clock = folder, random.Random(seed), ManualClock(1000.0)
        self.make_desk, self.make_worker = make_desk, make_worker
        self.rules = Rules(self.clock)
        self.cell = WatchedCell(self.rules, self.chance)
        self.people = [
            Person(f"s{k}", f"p{k}", role)
            for k, role in enumerate(self.chance.choices(list(Role), [1, 4, 2], k=OPERATORS))
        ]
        self.cell.people = {one.name: one for one in self.people}
        self.here = list(self.people[:12])
        self.tasks: set[asyncio.Task[Any]] = set()
        self.presses = 0
        self.restarts, self.refused = -1, 0
        self.problems: list[str] = []

    def start(self) -> None:
        """Start the panel, for the first time or again: nobody has control, and nothing reaches the cell."""
        self.restarts += 1
        self.cell.is_starting, self.cell.runs = True, None
        self.cell.pressed.clear()
        self.rules.owner = self.rules.asked_by = None
        self.rules.seen_s.clear()
        self.state = PanelState(self.clock, self.clock)
        self.state.swap.keep_in(self.folder / "swap.json")
        self.state.refusals.keep_in(self.folder / "friction.json")
        self.record = self.cell.record = WatchedRecord(self.clock)
        self.desk = self.make_desk(self.state, self.cell, self.record)
        self.run = WorkRun(self.clock)
        self.run.keep_in(self.folder / "work.json", self.clock)
        self.worker = self.make_worker(self.desk, self.run)
        assert self.run.phase is not WorkPhase.RUNNING

    async def settle(self) -> None:
        """Let everything that was begun come to its end."""
        for _ in range(20):
            await asyncio.sleep(0)

    async def work(self, count: int) -> None:
        """Play so many acts; whatever breaks a rule, or is raised and caught by nobody, ends it."""
        asyncio.get_running_loop().set_exception_handler(lambda _, said: self.problems.append(str(said)))
        self.start()
        await self.settle()
        for number in range(count):
            self.cell.is_starting = False
            await self.one()
            if number % 7 == 0:
                await self.settle()
            if number % 5000 == 4999:
                await self.again()
            self.look()
        await self.settle()
        self.look()

    async def again(self) -> None:
        """End the panel in the midst of everything, and start it."""
        self.refused += self.record.refused
        await asyncio.sleep(0)  # a task that has not begun cannot be in the midst
        for task in [*self.tasks, self.worker._task]:  # as the process takes them with it
            if task is not None:
                task.cancel()
        await self.settle()
        self.tasks.clear()
        for path, data in WRITTEN.items():
            path.write_bytes(data)
        self.start()
        await self.settle()

    def look(self) -> None:
        """Compare the panel with the rules, and look at what was raised."""
        view = self.state.control.view
        assert view.owner == self.rules.owner
        for task in [one for one in self.tasks if one.done()]:
            self.tasks.discard(task)
            if not task.cancelled() and task.exception() is not None:
                raise task.exception()  # type: ignore[misc]
        ran = self.worker._task
        if ran is not None and ran.done() and not ran.cancelled() and ran.exception() is not None:
            raise ran.exception()  # type: ignore[misc]
        assert not self.problems, self.problems[0]
        if self.run.phase is not WorkPhase.RUNNING:
            self.cell.runs = None

    def begin(self, person: Person, name: str, doing: Any) -> None:
        """Press a button whose act reaches the cell."""
        self.cell.pressed[person.name, name] += 1
        task = asyncio.get_running_loop().create_task(self.pressed(person, name, doing))
        self.tasks.add(task)

    async def pressed(self, person: Person, name: str, doing: Any) -> None:
        called = self.cell.calls[name]
        await doing
        if self.cell.calls[name] == called and self.cell.pressed[person.name, name] > 0:
            self.cell.pressed[person.name, name] -= 1  # it was refused before it reached the cell

    async def one(self) -> None:
        """Let one operator do one thing."""
        chance = self.chance
        if chance.random() < 0.002:
            self.here = chance.sample(self.people, 12)
        # mostly it is the owner who presses; at times somebody who may not
        owner = self.rules.owner
        person = owner if owner in self.here and chance.random() < 0.5 else chance.choice(self.here)
        assert person is not None
        self.clock.s += chance.choice([0.01, 0.1, 0.5])
        for one in self.here:
            if chance.random() < 0.3:
                self.state.control.observe_page(one.session)
                self.rules.seen_s[one.session] = self.clock.s
        self.presses += 1
        what = chance.random()
        if what < 0.5:
            act = chance.choice(acts.EXAMPLES)
            self.begin(person, act.name, self.desk.perform(person, act))
        elif what < 0.66:
            self.control(person, chance.choice(["take", "take", "hand_over", "give_back", "force", "leave"]))
        elif what < 0.84:
            self.list_of_orders(person, chance.choice(["plan", "start", "start", "pause", "leave_out"]))
        elif what < 0.90:
            self.model(person)
        else:
            self.fault()

    def control(self, person: Person, name: str) -> None:
        desk, rules = self.desk, self.rules
        if name == "take":
            desk.take_control(person)
            rules.take(person)
        elif name == "hand_over":
            desk.hand_over(person)
            rules.hand_over(person)
        elif name == "give_back":
            desk.give_back(person)
            rules.give_back(person)
        elif name == "force":
            reason = self.chance.choice(["", "fire"])
            desk.force_control(person, reason)
            rules.force(person, reason)
        else:
            self.state.control.forget(person.session)
            rules.leave(person)

    def list_of_orders(self, person: Person, name: str) -> None:
        if name == "plan":
            orders = [OrderLine(product, self.chance.randrange(1, 4)) for product in RUN_PRODUCTS]
            self.begin(person, "plan", self.worker.plan(person, orders, keep_order=False))
        elif name == "start":
            options = WorkOptions(emulated_hands=False, confirm_lift=True, trial=False, pause_on_failure=False)
            if self.worker.start(person, options).success:
                assert self.rules.is_owner(person)
                self.cell.runs = person.name
        elif name == "pause":
            if self.worker.pause(person).success:
                self.cell.runs = None
        else:
            self.worker.leave_out(person)

    def model(self, person: Person) -> None:
        reason = self.chance.choice(["", "old cable"])
        name = self.chance.choice(["refuse", "activate"])
        doing = getattr(self.desk, f"{name}_model")(person, self.chance.choice(["a", "b"]), reason)
        self.begin(person, f"{name}_friction", doing)

    def fault(self) -> None:
        """Let something go wrong, or say it is over."""
        state, chance = self.state, self.chance
        name = chance.choice([*FAULTS, "unheard_of", ""])
        state.observe_tendons([TendonView("index", "STOPPED", homed=chance.random() > 0.5, fault=name, reason="r")])
        state.observe_safety(SafetyView(estop=chance.random() > 0.5, locked=chance.random() > 0.8))
        state.observe_tensions([TensionView("index", 0.001, chance.choice([float("nan"), 3.0]))], self.clock.s)
        mode = chance.choice(["IDLE", "GRASPING", "HOLDING", "SWAPPING", "FAULT", "UNKNOWN"])
        state.observe_cell(CellView(mode, chance.choice(["run set", "power"]), picks=3, product="egg"))
        state.swap.observe_mode(mode, chance.choice(["", "hands_out", "restarted during swap"]))
        state.observe_counted([CountedView(self.clock.s, "egg", "power", "GRIPPED", "", 1.0)])
        state.advance()
        keys = [alarm.key for alarm in state.alarms.active] or ["none"]
        self.desk.acknowledge(chance.choice(self.here), chance.choice(keys))


@pytest.fixture(autouse=True)
def _disk_without_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let what is written reach the disk when the panel ends: 200,000 acts write an order list ten thousand times."""
    WRITTEN.clear()

    def write(path: Path, data: bytes, _mode: int = 0o600) -> None:
        WRITTEN[path] = data

    for module in ("work_file", "swap", "friction"):
        monkeypatch.setattr(f"softgrip_panel.model.{module}.write_durably", write)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_two_hundred_operators_with_a_thousand_acts_each_break_no_rule(tmp_path: Path) -> None:
    shift = Shift(tmp_path, 29)
    asyncio.run(shift.work(OPERATORS * ACTS_EACH))
    # all of it was there: every act reached the cell, runs grasped and swapped, refusals came, the panel restarted
    never = {act.name for act in acts.EXAMPLES} - set(shift.cell.calls)
    assert never == set()
    assert min(shift.cell.in_runs[name] for name in ("grasp", "swap")) > 300
    assert shift.refused > 10_000
    assert shift.restarts == OPERATORS * ACTS_EACH // 5000
    # what was kept does not grow with what happened
    assert len(shift.state.notices) <= 50
    assert len(shift.state.alarms.active) <= 200
    assert len(shift.state.grasps.records) <= 200


# --- every rule, broken


class NoCheck(ActDesk):
    def _check(self, person: Person, role: Role, *, needs_control: bool) -> None:
        pass


class NoControl(ActDesk):
    def _check(self, person: Person, role: Role, *, needs_control: bool) -> None:
        super()._check(person, role, needs_control=False)


class NoRecord(ActDesk):
    def record_event(self, who: str, act: str, subject: str, *, success: bool, message: str) -> None:
        pass


class Twice(ActDesk):
    async def perform(self, person: Person, act: Act) -> ActResult:
        await super().perform(person, act)
        return await super().perform(person, act)


class Raises(ActDesk):
    def acknowledge(self, person: Person, key: str) -> ActResult:
        if key != "none":
            raise KeyError(key)
        return super().acknowledge(person, key)


class HomesAtItsStart(ActDesk):
    def __init__(self, state: PanelState, calls: Any, record: ActRecord) -> None:
        super().__init__(state, calls, record)
        asyncio.get_running_loop().create_task(calls.call(acts.home(), "p0"))


class GoesOnAfterAPause(Worker):
    def pause(self, person: Person) -> ActResult:
        result = super().pause(person)
        if result.success:
            self.run.go_to(WorkPhase.RUNNING)
        return result


class TwoOwners(ControlDesk):
    def take_control(self, person: Person) -> None:
        self._give_to(person)


@pytest.mark.parametrize(
    ("parts", "said"),
    [
        ({"make_desk": NoCheck}, "who has no control|wants"),
        ({"make_desk": NoControl}, "who has no control"),
        ({"make_desk": NoRecord}, "is in no record"),
        ({"make_desk": Twice}, "which nobody pressed"),
        ({"make_desk": Raises}, "tendon|silence|estop|lock|cell"),
        ({"make_desk": HomesAtItsStart}, "while the panel was starting"),
        ({"make_worker": GoesOnAfterAPause}, "a run (grasps|swaps) for"),
    ],
)
def test_operators_find_a_panel_that_breaks_a_rule(tmp_path: Path, parts: dict[str, Any], said: str) -> None:
    with pytest.raises((AssertionError, KeyError), match=said):
        asyncio.run(Shift(tmp_path, 29, **parts).work(20_000))


def test_operators_find_a_control_that_has_two_owners(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("softgrip_panel.model.state.ControlDesk", TwoOwners)
    with pytest.raises(AssertionError):
        asyncio.run(Shift(tmp_path, 29).work(20_000))
