# SPDX-License-Identifier: Apache-2.0
"""Tensioning by the driver's own services: home, hold, let go, home again, until no zero moves any more.

As the wizard does it: each round is compared with the one before.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from softgrip_driver.wizard.tensioning import SETTLED_M, TensioningPlan
from softgrip_panel.model import acts
from softgrip_panel.model.acts import Act
from softgrip_panel.model.bench import BenchView
from softgrip_panel.model.desk import ActDesk
from softgrip_panel.model.roles import Person
from softgrip_panel.texts import say

PLAN: Final = TensioningPlan()
#: A zero that moves less between two rounds has settled [mm].
SETTLED_MM: Final = 1e3 * SETTLED_M
#: Rounds that are kept to be shown.
MAX_ROUNDS: Final = 20
#: The driver says its zeros once a second; so long a wait is too long [s].
ZEROS_WAIT_S: Final = 10.0
_POLL_S: Final = 0.1


@dataclass(frozen=True)
class TensioningRound:
    """By how much each zero has moved in a round [mm]."""

    number: int
    shifts_mm: Mapping[str, float]

    @property
    def has_settled(self) -> bool:
        """Whether it left every zero where it was."""
        return bool(self.shifts_mm) and all(abs(one) < SETTLED_MM for one in self.shifts_mm.values())


class Tensioning:
    """Does rounds, one at a time, in the name of whoever pressed the button.

    Args:
        desk: does acts.
        bench: what the driver says now.
    """

    def __init__(self, desk: ActDesk, bench: Callable[[], BenchView]) -> None:
        self._desk = desk
        self._bench = bench
        self.rounds: tuple[TensioningRound, ...] = ()
        self.is_running = False
        self.step = ""
        self.problem = ""
        #: after the last round
        self._zeros_mm: dict[str, float] = {}

    async def run_round(self, person: Person, tension_n: float = PLAN.tension_n) -> None:
        """Do one round; what refuses it is `problem`. Ends with the tendons homed and slack."""
        if self.is_running:
            return
        self.is_running, self.problem = True, ""
        try:
            self.problem = await self._round(person, tension_n)
        finally:
            self.is_running, self.step = False, ""

    async def _round(self, person: Person, tension_n: float) -> str:
        # like with like: a finger that was just pulled is taut a little later than one at rest
        before, problem = self._zeros_mm, ""
        if not before or before != self._bench().zeros_mm:
            problem, before = await self._home(person)
        if problem:
            return problem
        for act in (acts.pull(tension_n, PLAN.speed_m_s), acts.slacken(PLAN.speed_m_s, tension_n)):
            problem = await self._do(person, act)
            if problem:
                return problem
            await asyncio.sleep(PLAN.hold_s if act.name == "pull" else 0.0)
        problem, after = await self._home(person)
        if problem:
            return problem
        self._zeros_mm = after
        number = self.rounds[-1].number + 1 if self.rounds else 1
        shifts = {name: after[name] - before[name] for name in after if name in before}
        self.rounds = (*self.rounds, TensioningRound(number, shifts))[-MAX_ROUNDS:]
        return ""

    async def _home(self, person: Person) -> tuple[str, dict[str, float]]:
        problem = await self._do(person, acts.home())
        if problem:
            return problem, {}
        # the next but one /diagnostics was surely made after the homing
        needed, deadline_s = self._bench().reports + 2, ZEROS_WAIT_S
        while self._bench().reports < needed:
            if deadline_s <= 0.0:
                return say("error.no_diagnostics", wait=ZEROS_WAIT_S), {}
            deadline_s -= _POLL_S
            await asyncio.sleep(_POLL_S)
        return "", self._bench().zeros_mm

    async def _do(self, person: Person, act: Act) -> str:
        if self._desk.state.control.view.is_lost:
            return say("error.not_watched")
        self.step = act.name
        result = await self._desk.perform(person, act)
        return "" if result.success else result.message
