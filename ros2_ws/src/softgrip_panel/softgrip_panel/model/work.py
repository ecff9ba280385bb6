# SPDX-License-Identifier: Apache-2.0
"""An order list at work: planned, run item by item, paused and taken up again; counters, rate and OEE with formulas."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from softgrip_panel.errors import ActRefusedError, PanelError
from softgrip_panel.model import acts
from softgrip_panel.model.acts import Act, ActResult
from softgrip_panel.model.desk import ActDesk
from softgrip_panel.model.orders import OrderLine
from softgrip_panel.model.roles import Person
from softgrip_panel.model.work_file import LEFT_OUT, MAX_ITEMS, VERDICTS, KeptWork, WorkFile, WorkItem, WorkPhase
from softgrip_panel.texts import say

#: Between looks whether the run goes on [s].
_POLL_S: Final = 0.1
#: What a run says that went on when the panel ended.
RESTARTED: Final = "the panel was started again; the product that was under way then is still to come"


@dataclass(frozen=True)
class PlannedStep:
    """One order as the manager planned it."""

    product: str
    quantity: int
    finger_set: str
    swap_before: bool
    expected_success: float
    predicted_time_s: float
    reason: str = ""


@dataclass(frozen=True)
class WorkOptions:
    """How the run grasps."""

    confirm_lift: bool = True
    trial: bool = False
    pause_on_failure: bool = True
    emulated_hands: bool = False


@dataclass(frozen=True)
class WorkFigures:
    """Figures of the run; NaN where nothing has been done yet.

    Attributes:
        done, gripped: counts, without what was left out.
        total: of the list, without what was left out.
        rate_per_h: done / time running.
        availability: time not paused / time since the start.
        performance: predicted time of what is done / time running.
        quality: gripped / done.
    """

    done: int
    total: int
    gripped: int
    rate_per_h: float
    availability: float
    performance: float
    quality: float

    @property
    def oee(self) -> float:
        """Overall equipment effectiveness: availability x performance x quality (ISO 22400-2)."""
        return self.availability * self.performance * self.quality


@dataclass
class WorkRun:
    """What is planned and what came of it.

    Attributes:
        now_s: monotonic clock [s].
        problem: why the run is not kept on disk, or why none was found there; empty = it is.
    """

    now_s: Callable[[], float]
    phase: WorkPhase = WorkPhase.EMPTY
    items: tuple[WorkItem, ...] = ()
    swaps: int = 0
    predicted_time_s: float = 0.0
    expected_success: float = math.nan
    redundant_sets: tuple[str, ...] = ()
    message: str = ""
    running_s: float = 0.0
    paused_s: float = 0.0
    problem: str = ""
    _since_s: float = field(default=0.0, repr=False)
    _file: WorkFile | None = field(default=None, repr=False)
    _epoch_s: Callable[[], float] = field(default=time.time, repr=False)

    def keep_in(self, file: Path, epoch_s: Callable[[], float] = time.time) -> None:
        """Keep the run in a file, and take up the one that an earlier panel left there; what went on is paused.

        Args:
            file: of this user alone.
            epoch_s: seconds since the Unix epoch; the time without a panel counts as paused.
        """
        self._file, self._epoch_s = WorkFile(file), epoch_s
        try:
            kept = self._file.read()
        except PanelError as error:
            self.problem = str(error)
            return
        if kept is None:
            return
        self.items, self.swaps, self.redundant_sets = kept.items, kept.swaps, kept.redundant_sets
        self.predicted_time_s, self.expected_success = kept.predicted_time_s, kept.expected_success
        self.running_s, self.paused_s = kept.running_s, kept.paused_s
        self.phase, self.message = kept.phase, kept.message
        self._since_s = self.now_s()
        if self.phase is WorkPhase.RUNNING:
            self.phase, self.message = WorkPhase.PAUSED, RESTARTED
        if self.phase is WorkPhase.PAUSED:
            self.paused_s += max(0.0, epoch_s() - kept.at_s)

    def plan(self, steps: Sequence[PlannedStep], answer: Any) -> None:
        """Take a plan; what was planned before is gone."""
        self.items = tuple(
            WorkItem(step.product, step.finger_set, step.predicted_time_s / max(1, step.quantity))
            for step in steps
            for _ in range(step.quantity)
        )
        self.swaps = int(answer.swaps)
        self.predicted_time_s = float(answer.predicted_time)
        self.expected_success = float(answer.expected_success)
        self.redundant_sets = tuple(answer.redundant_sets)
        self.running_s = self.paused_s = 0.0
        self.message = ""
        self.phase = WorkPhase.PLANNED
        self._keep()

    def go_to(self, phase: WorkPhase, message: str = "") -> None:
        """Change the phase; time counts where it was spent."""
        now_s = self.now_s()
        self._count(now_s)
        self.phase, self.message = phase, message
        self._keep()

    def finish(self, number: int, outcome: str, reason: str, took_s: float) -> None:
        """Write what came of an item."""
        done = replace(self.items[number], outcome=outcome, reason=reason, took_s=took_s)
        self.items = (*self.items[:number], done, *self.items[number + 1 :])
        self._keep()

    @property
    def next_number(self) -> int | None:
        """The item that is to come; None when all are done."""
        return next((k for k, item in enumerate(self.items) if not item.outcome), None)

    def figures(self) -> WorkFigures:
        """Return the figures now."""
        self._count(self.now_s())
        kept = [item for item in self.items if item.outcome != LEFT_OUT]
        done = [item for item in kept if item.outcome]
        gripped = sum(item.outcome == "GRIPPED" for item in done)
        predicted_s = sum(item.predicted_time_s for item in done)
        span_s = self.running_s + self.paused_s
        return WorkFigures(
            done=len(done),
            total=len(kept),
            gripped=gripped,
            rate_per_h=_share(3600.0 * len(done), self.running_s),
            availability=_share(self.running_s, span_s),
            performance=_share(predicted_s, self.running_s),
            quality=_share(gripped, len(done)),
        )

    def _keep(self) -> None:
        """Write the run to disk; a disk that takes nothing is a `problem`, not an end."""
        if self._file is None:
            return
        self._count(self.now_s())
        kept = KeptWork(
            self._epoch_s(), self.phase, self.message, self.items, self.swaps, self.predicted_time_s,
            self.expected_success, self.redundant_sets, self.running_s, self.paused_s,
        )  # fmt: skip
        try:
            self._file.write(kept)
            self.problem = ""
        except PanelError as error:
            self.problem = str(error)

    def _count(self, now_s: float) -> None:
        passed_s, self._since_s = now_s - self._since_s, now_s
        if self.phase is WorkPhase.RUNNING:
            self.running_s += passed_s
        elif self.phase is WorkPhase.PAUSED:
            self.paused_s += passed_s


def _share(part: float, whole: float) -> float:
    return part / whole if whole > 0.0 else math.nan


class Worker:
    """Plans and runs an order list, in the name of whoever pressed the button.

    Args:
        desk: does acts.
        run: what is planned.
    """

    def __init__(self, desk: ActDesk, run: WorkRun) -> None:
        self._desk = desk
        self.run = run
        self._task: asyncio.Task[None] | None = None

    async def plan(self, person: Person, orders: Sequence[OrderLine], *, keep_order: bool) -> ActResult:
        """Ask the manager for the order of work."""
        if self.run.phase is WorkPhase.RUNNING:
            return self._desk.refuse(person, "plan", say("error.run_goes_on"))
        if sum(order.quantity for order in orders) > MAX_ITEMS:
            return self._desk.refuse(person, "plan", say("error.run_long", limit=MAX_ITEMS))
        act = acts.plan(
            [order.product for order in orders], [order.quantity for order in orders], keep_order=keep_order
        )
        result = await self._desk.perform(person, act)
        if result.success and result.answer is not None:
            steps = [
                PlannedStep(
                    step.product,
                    orders[step.order].quantity,
                    step.finger_set,
                    bool(step.swap_before),
                    float(step.expected_success),
                    float(step.predicted_time),
                    step.reason,
                )
                for step in result.answer.steps
            ]
            self.run.plan(steps, result.answer)
        return result

    def start(self, person: Person, options: WorkOptions) -> ActResult:
        """Begin, or go on after a pause."""

        def begin() -> str:
            if self.run.phase not in (WorkPhase.PLANNED, WorkPhase.PAUSED):
                raise ActRefusedError(say("error.run_not_ready", phase=self.run.phase))
            if self._task is not None and not self._task.done():
                raise ActRefusedError(say("error.product_under_way"))
            self.run.go_to(WorkPhase.RUNNING)
            self._task = asyncio.get_running_loop().create_task(self._work(person, options))
            return say("done.runs", count=sum(not item.outcome for item in self.run.items))

        return self._desk.carry_out(person, "start_run", "", begin, needs_control=True)

    def pause(self, person: Person) -> ActResult:
        """Begin nothing new; what goes on is brought to its end. Whoever operates may, since it ends motions."""

        def pause() -> str:
            if self.run.phase is not WorkPhase.RUNNING:
                raise ActRefusedError(say("error.run_not_going_on", phase=self.run.phase))
            self.run.go_to(WorkPhase.PAUSED)
            return say("done.paused")

        return self._desk.carry_out(person, "pause_run", "", pause, needs_control=False)

    def leave_out(self, person: Person) -> ActResult:
        """Take the next item as one that is not to be grasped, as where it is refused whenever it is tried."""
        number = self.run.next_number
        product = "" if number is None else self.run.items[number].product

        def leave() -> str:
            if self.run.phase is not WorkPhase.PAUSED or number is None:
                raise ActRefusedError(say("error.run_not_paused", phase=self.run.phase))
            if self._task is not None and not self._task.done():
                raise ActRefusedError(say("error.product_under_way"))
            why = self.run.message
            self.run.finish(
                number, LEFT_OUT, f"{say('done.left_out_by', name=person.name)}{': ' if why else ''}{why}", 0.0
            )
            ended = self.run.next_number is None
            self.run.go_to(WorkPhase.ENDED if ended else WorkPhase.PAUSED)
            return say("done.left_out", number=number + 1, count=len(self.run.items))

        return self._desk.carry_out(person, "leave_out", product, leave, needs_control=True)

    async def _work(self, person: Person, options: WorkOptions) -> None:
        while self.run.phase is WorkPhase.RUNNING:
            number = self.run.next_number
            if number is None:
                self.run.go_to(WorkPhase.ENDED)
                return
            problem = await self._one(person, number, options)
            if problem:
                self.run.go_to(WorkPhase.PAUSED, problem)
            await asyncio.sleep(0)

    async def _one(self, person: Person, number: int, options: WorkOptions) -> str:
        """Do one item; returns why the run has to pause, empty where it goes on."""
        item = self.run.items[number]
        problem = await self._with_fingers(person, item)
        if not problem and self._goes_on() and options.emulated_hands:
            problem = await self._must(person, acts.place_object(item.product))
        if problem or not self._goes_on():
            return problem  # paused while fingers were swapped: a grasp would be something new
        began_s = self.run.now_s()
        grasp = acts.grasp(item.product, confirm_lift=options.confirm_lift, trial=options.trial)
        result = await self._desk.perform(person, grasp)
        outcome = result.message.partition(":")[0]
        if result.answer is None or outcome not in VERDICTS:
            return result.message  # nothing was judged: the item is still to come
        self.run.finish(number, outcome, result.message, self.run.now_s() - began_s)
        problem = await self._must(person, acts.release())
        if options.emulated_hands:
            problem = problem or await self._must(person, acts.place_object(""))
        failed = not result.success and options.pause_on_failure
        return problem or (result.message if failed else "")

    def _goes_on(self) -> bool:
        """Whether nobody has paused the run since."""
        return self.run.phase is WorkPhase.RUNNING

    async def _with_fingers(self, person: Person, item: WorkItem) -> str:
        """Order the right fingers to be mounted."""
        cell = self._desk.state.cell
        if (
            cell is not None
            and cell.finger_set == item.finger_set
            and all(one.state == "verified" for one in cell.mounted)
        ):
            return ""
        return await self._must(person, acts.swap(item.finger_set))

    async def _must(self, person: Person, act: Act) -> str:
        result = await self._desk.perform(person, act)
        return "" if result.success else f"{act.name}: {result.message}"
