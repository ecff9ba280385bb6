# SPDX-License-Identifier: Apache-2.0
"""Where every act passes: role, control, the cell's answer, the record, and a notice for all pages."""

from __future__ import annotations

from collections import deque
from collections.abc import Awaitable, Callable
from typing import Final, Protocol

from softgrip_panel.access.record import ActRecord
from softgrip_panel.errors import ActRefusedError
from softgrip_panel.model import acts
from softgrip_panel.model.acts import Act, ActResult
from softgrip_panel.model.control import ControlDesk
from softgrip_panel.model.friction import Refusal
from softgrip_panel.model.roles import Person, Role
from softgrip_panel.model.state import PanelState
from softgrip_panel.texts import say

#: What is refused to strangers reaches other records so often at most; this panel's own has all of it.
MAX_STRANGERS: Final = 10
#: Counted over so long [s].
STRANGERS_S: Final = 60.0


class CellCalls(Protocol):
    """The way to the cell; the node is one, tests have another."""

    def call(self, act: Act, who: str) -> Awaitable[ActResult]:
        """Do it and wait for what comes of it; never raises for what the cell refuses."""
        ...

    def cancel(self, act_name: str) -> None:
        """Ask for the end of a running action."""
        ...


class ActDesk:
    """Checks, does, and writes down.

    Args:
        state: what pages show.
        calls: the way to the cell.
        record: of acts.
    """

    def __init__(self, state: PanelState, calls: CellCalls, record: ActRecord) -> None:
        self.state = state
        self._calls = calls
        self._record = record
        self._refused_s: deque[float] = deque(maxlen=MAX_STRANGERS)
        #: Called with who, act, subject and what came of it, for other records.
        self.on_done: Callable[[str, str, str, str], object] = lambda *_: None

    async def perform(self, person: Person, act: Act) -> ActResult:
        """Do an act and return what came of it; a refusal is a result, too.

        That it begins is written down before: who ends the panel in the midst of it ends no record.
        """
        try:
            self._check(person, act.role, needs_control=act.needs_control)
        except ActRefusedError as error:
            return self._done(person, act.name, act.subject, ActResult(success=False, message=str(error)))
        if not act.is_urgent:
            self.record_event(person.name, act.name, act.subject, success=True, message=say("done.begun"))
        return self._done(person, act.name, act.subject, await self._calls.call(act, person.name))

    def carry_out(
        self,
        person: Person,
        name: str,
        subject: str,
        change: Callable[[], str],
        *,
        needs_control: bool,
        role: Role = Role.OPERATE,
    ) -> ActResult:
        """Do what the panel does itself, with the checks, the record and the notice of an act.

        Args:
            person: who wants it.
            name: of the act, for texts ("act.NAME") and the record.
            subject: what it is about.
            change: does it and returns what was done; may raise ActRefusedError.
            needs_control: as of an Act.
            role: at least needed.
        """
        try:
            self._check(person, role, needs_control=needs_control)
            message = change()
        except ActRefusedError as error:
            return self._done(person, name, subject, ActResult(success=False, message=str(error)))
        return self._done(person, name, subject, ActResult(success=True, message=message))

    def stop_action(self, person: Person, act_name: str) -> ActResult:
        """Cancel a running grasp or swap: whoever operates may, since it ends a motion."""

        def cancel() -> str:
            self._calls.cancel(act_name)
            return say("done.asked_to_end")

        return self.carry_out(person, f"cancel_{act_name}", "", cancel, needs_control=False)

    def take_control(self, person: Person) -> ActResult:
        """Take control, or ask its owner for it."""
        owner = self.state.control.view.owner

        def ask(desk: ControlDesk) -> str:
            desk.ask(person)
            return say("done.has_control") if desk.has(person) else say("done.asked", name=owner.name if owner else "-")

        return self._change_control(person, "take_control", ask)

    def hand_over(self, person: Person) -> ActResult:
        """Give control to whoever asks."""
        return self._change_control(
            person, "hand_over", lambda desk: say("done.handed_over", name=desk.hand_over(person).name)
        )

    def give_back(self, person: Person) -> ActResult:
        """Give control up."""

        def give(desk: ControlDesk) -> str:
            desk.give_back(person)
            return say("done.gave_back")

        return self._change_control(person, "give_back", give)

    def force_control(self, person: Person, reason: str) -> ActResult:
        """Take control from its owner, with a reason."""

        def force(desk: ControlDesk) -> str:
            desk.force(person, reason)
            return say("done.forced", reason=reason.strip())

        return self._change_control(person, "force_control", force)

    def acknowledge(self, person: Person, key: str) -> ActResult:
        """Acknowledge an alarm."""

        def acknowledge() -> str:
            with self.state.locked():
                self.state.alarms.acknowledge(key, person.name)
            return say("done.acknowledged")

        return self.carry_out(person, "acknowledge", key, acknowledge, needs_control=False)

    async def activate_model(self, person: Person, model: str, reason: str) -> ActResult:
        """Make a friction model the active one, with a reason; a refusal of before is lifted by it."""
        if not reason.strip():
            return self.refuse(person, "activate_friction", say("friction.reason_missing"))
        result = await self.perform(person, acts.activate_friction(model, reason.strip()))
        if result.success:
            with self.state.locked():
                self.state.refusals.lift(model)
        return result

    async def refuse_model(self, person: Person, model: str, reason: str) -> ActResult:
        """Refuse a friction model, with a reason that pages show beside it from then on; nothing else changes."""
        if not reason.strip():
            return self.refuse(person, "refuse_friction", say("friction.reason_missing"))
        result = await self.perform(person, acts.refuse_friction(model, person.name, reason.strip()))
        if result.success:
            with self.state.locked():
                self.state.refusals.add(model, Refusal(person.name, reason.strip(), self.state.now_s()))
        return result

    def refuse(self, person: Person, act: str, message: str) -> ActResult:
        """Write down that something was asked for that cannot be done."""
        return self._done(person, act, "", ActResult(success=False, message=message))

    def record_event(self, who: str, act: str, subject: str, *, success: bool, message: str) -> None:
        """Write down what happened beside acts: what begins, log-ins, refused requests."""
        self._record.write(who, act, subject, success=success, message=message)
        if success or self._has_room_for_a_stranger():
            self.on_done(who, act, subject, message if success else f"refused: {message}")

    def _has_room_for_a_stranger(self) -> bool:
        """Whether few enough of them were refused lately: nobody without an account fills the cell's database."""
        now_s = self.state.monotonic_s()
        if len(self._refused_s) == MAX_STRANGERS and now_s - self._refused_s[0] < STRANGERS_S:
            return False
        self._refused_s.append(now_s)
        return True

    def _check(self, person: Person, role: Role, *, needs_control: bool) -> None:
        if person.role < role:
            raise ActRefusedError(say("error.role", role=role.word, found=person.role.word))
        if needs_control:
            with self.state.locked():
                self.state.control.check(person)

    def _change_control(self, person: Person, name: str, change: Callable[[ControlDesk], str]) -> ActResult:
        try:
            with self.state.locked():
                message = change(self.state.control)
        except ActRefusedError as error:
            return self._done(person, name, "", ActResult(success=False, message=str(error)))
        return self._done(person, name, "", ActResult(success=True, message=message))

    def _done(self, person: Person, act: str, subject: str, result: ActResult) -> ActResult:
        self._record.write(person.name, act, subject, success=result.success, message=result.message)
        self.state.add_notice(person.name, act, subject, success=result.success, message=result.message)
        self.on_done(person.name, act, subject, f"{'done' if result.success else 'refused'}: {result.message}")
        return result
