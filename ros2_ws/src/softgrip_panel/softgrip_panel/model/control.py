# SPDX-License-Identifier: Apache-2.0
"""Who has control of the cell: one person at a time, with hand-over; e-stop and letting go need none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from softgrip_panel.errors import ActRefusedError
from softgrip_panel.model.roles import Person, Role
from softgrip_panel.texts import say

#: Without an open page for so long its owner counts as lost, and anybody with the role may take control [s].
LOST_S = 10.0


@dataclass(frozen=True)
class ControlView:
    """What pages show of it.

    Attributes:
        owner: who has control, None = nobody.
        is_lost: the owner has no page open.
        asked_by: who asks the owner for it.
    """

    owner: Person | None = None
    is_lost: bool = False
    asked_by: Person | None = None


class ControlDesk:
    """Gives control to one person.

    Args:
        now_s: monotonic clock [s].
        lost_s: see `LOST_S` [s].
    """

    def __init__(self, now_s: Callable[[], float], lost_s: float = LOST_S) -> None:
        self._now_s = now_s
        self._lost_s = lost_s
        self._owner: Person | None = None
        self._asked_by: Person | None = None
        self._seen_s: dict[str, float] = {}

    @property
    def view(self) -> ControlView:
        """Who has it now."""
        asked_by = self._asked_by if self._asked_by and not self._is_lost(self._asked_by) else None
        return ControlView(self._owner, self._owner is not None and self._is_lost(self._owner), asked_by)

    def observe_page(self, session: str) -> None:
        """Take that a page of a session is open now."""
        self._seen_s[session] = self._now_s()
        if len(self._seen_s) > 1000:
            limit_s = self._now_s() - self._lost_s
            self._seen_s = {key: seen_s for key, seen_s in self._seen_s.items() if seen_s >= limit_s}

    def has(self, person: Person) -> bool:
        """Whether this person's session has control."""
        return self._owner is not None and self._owner.session == person.session

    def take_control(self, person: Person) -> None:
        """Take control that nobody has, or whose owner has no page open.

        Raises:
            ActRefusedError: somebody has it, or the role does not allow it.
        """
        if person.role < Role.OPERATE:
            raise ActRefusedError(say("error.control_role", found=person.role.word))
        if self._owner is not None and not self.has(person) and not self._is_lost(self._owner):
            raise ActRefusedError(say("error.control_taken", name=self._owner.name))
        self._give_to(person)

    def ask(self, person: Person) -> None:
        """Ask the owner to hand over; where there is none, take it.

        Raises:
            ActRefusedError: the role does not allow it.
        """
        if self._owner is None or self._is_lost(self._owner) or person.role < Role.OPERATE:
            self.take_control(person)
        elif not self.has(person):
            self._asked_by = person

    def hand_over(self, person: Person) -> Person:
        """Give control to whoever asked; returns them.

        Raises:
            ActRefusedError: this person does not have it, or nobody asked.
        """
        self.check(person)
        asked_by = self.view.asked_by
        if asked_by is None:
            raise ActRefusedError(say("error.nobody_asks"))
        self._give_to(asked_by)
        return asked_by

    def give_back(self, person: Person) -> None:
        """Give control up."""
        if self.has(person):
            self._owner = None
            if self.view.asked_by is not None:
                self._give_to(self.view.asked_by)

    def force(self, person: Person, reason: str) -> None:
        """Take control from somebody who does not hand it over.

        Raises:
            ActRefusedError: not an engineer, or without a reason.
        """
        if person.role < Role.ENGINEER:
            raise ActRefusedError(say("error.force_role", found=person.role.word))
        if not reason.strip():
            raise ActRefusedError(say("error.force_reason"))
        self._give_to(person)

    def check(self, person: Person) -> None:
        """Let only the owner pass.

        Raises:
            ActRefusedError: somebody else has control, or nobody.
        """
        if not self.has(person):
            owner = self._owner
            raise ActRefusedError(say("error.control_other", name=owner.name) if owner else say("error.control_nobody"))

    def forget(self, session: str) -> None:
        """A session has ended: what it had is free."""
        self._seen_s.pop(session, None)
        if self._asked_by is not None and self._asked_by.session == session:
            self._asked_by = None
        if self._owner is not None and self._owner.session == session:
            self.give_back(self._owner)

    def _give_to(self, person: Person) -> None:
        self._owner, self._asked_by = person, None
        self.observe_page(person.session)

    def _is_lost(self, person: Person) -> bool:
        return self._now_s() - self._seen_s.get(person.session, -1e9) > self._lost_s
