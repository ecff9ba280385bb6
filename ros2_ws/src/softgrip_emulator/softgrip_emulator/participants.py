# SPDX-License-Identifier: Apache-2.0
"""Who takes part in the cell's time, whether they hold it, and how far they let it run. Pure: it never waits."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from softgrip_time.protocol import CancelRequest, Join, Packet, Progress, TimeRequest

if TYPE_CHECKING:
    from collections.abc import Mapping

#: [s] A stepper that waits for less time than this, and for no device, is at work; so is one that is woken.
_WORK_WAIT_S: Final = 0.03
#: [s] without work, after which the cell is at rest: a driver's readings then come at a quarter of their rate or less.
REST_AFTER_S: Final = 1.0
#: Lags of followers of the clock are so much longer at rest: still less than five readings, which subscriptions keep.
REST_LAG_FACTOR: Final = 3.0
#: [s] of the computer's time that bytes may take through the system to the device.
_ON_THE_WIRE_S: Final = 1.0
#: [s] by which a frame's stamp, seconds since the epoch in decimals, may be off.
_STAMP_ROUNDING_S: Final = 1e-4


@dataclass(eq=False)
class Participant:
    """One connection.

    Attributes:
        join: who it is.
        request: what a stepper waits for; None while it works.
        is_granted: its wait is over, and it knows: its time has come, or its device sends.
        progress_s: how far a follower has come [s].
        held_since: [s, the computer's] since when it holds the time; None while it does not.
        is_given_up: it held for too long; its next packet ends this.
    """

    join: Join
    request: TimeRequest | None = None
    is_granted: bool = False
    progress_s: float = 0.0
    held_since: float | None = None
    is_given_up: bool = False

    @property
    def label(self) -> str:
        """Who it is, for people: a stepper's name, or a follower's with what it follows."""
        return f"{self.join.name} ({self.join.follows})" if self.join.follows else self.join.name

    def update(self, packet: Packet) -> None:
        """Update from a packet that it has sent.

        Raises:
            ValueError: a packet that a participant of its kind does not send.
        """
        self.is_given_up, self.held_since = False, None
        if isinstance(packet, TimeRequest) and not self.join.follows:
            self.request, self.is_granted = packet, False
        elif isinstance(packet, CancelRequest) and not self.join.follows:
            self.request = None
        elif isinstance(packet, Progress) and self.join.follows:
            self.progress_s = max(self.progress_s, packet.time_s)
        else:
            kind = "progress of a follower" if self.join.follows else "requests of a stepper"
            raise ValueError(f"lock-step: {self.join.name}: expected {kind}, found {packet}")


@dataclass
class Participants:
    """All of them.

    Args:
        give_up_s: [s, the computer's] after which the time goes on without who holds it.
    """

    give_up_s: float
    all: list[Participant] = field(default_factory=list)
    #: no stepper works
    is_resting: bool = False
    #: [s] when one worked last
    worked_s: float = 0.0
    #: times of exposures that the follower of frames has not measured yet [s]
    exposures: list[float] = field(default_factory=list)

    def observe_work(self, before: TimeRequest | None, packet: Packet, now_s: float) -> None:
        """Record what a stepper asks for, after the request before, at a time of the cell [s]."""
        if isinstance(packet, TimeRequest):
            works = not packet.reads and packet.until_s - now_s < _WORK_WAIT_S
        else:
            works = isinstance(packet, CancelRequest) and before is not None and not before.reads
        if works:
            self.worked_s = now_s

    def update_rest(self, now_s: float) -> bool:
        """Decide whether the cell rests at a time [s]; return whether a rest has just ended."""
        rested = self.is_resting
        self.is_resting = now_s - self.worked_s > REST_AFTER_S
        return rested and not self.is_resting

    def names(self) -> set[str]:
        """Return the names of those who take part and answer."""
        return {one.join.name for one in self.all if not one.is_given_up}

    def find_holder(self, now_s: float, received: Mapping[str, int], computer_s: float) -> Participant | None:
        """Return one who holds the time at the cell's ``now_s``, None when it may go on.

        Args:
            now_s: time of the cell [s].
            received: bytes that the device on each terminal has received.
            computer_s: monotonic [s].
        """
        holder = None
        for one in self.all:
            if one.is_given_up or not self._holds(one, now_s, received, computer_s):
                one.held_since = None
            elif one.held_since is None:
                one.held_since = computer_s
                holder = one
            elif computer_s - one.held_since > self.give_up_s:
                one.is_given_up = True
            else:
                holder = one
        return holder

    def restart_timeouts(self) -> None:
        """Let everybody who holds the time have the whole of ``give_up_s`` again."""
        for one in self.all:
            one.held_since = None

    def limit_s(self) -> float:
        """Return how far the time may run without another packet of anybody [s]."""
        return min((self._limit_s(one) for one in self.all if not one.is_given_up), default=float("inf"))

    def due(self, now_s: float) -> list[Participant]:
        """Return the steppers whose requested time has come, and who do not know it yet."""
        return [one for one in self.all if one.request and not one.is_granted and one.request.until_s <= now_s]

    def readers(self, terminal: str) -> list[Participant]:
        """Return the steppers that wait for bytes of the device on a terminal."""
        return [one for one in self.all if one.request and not one.is_granted and one.request.reads == terminal]

    def add_exposure(self, now_s: float) -> None:
        """Add an exposure that the follower of frames will measure; no effect where there is none."""
        if any(one.join.follows == "frames" for one in self.all):
            self.exposures.append(now_s)

    def drop_exposure(self, time_s: float) -> None:
        """Drop an exposure whose frame was lost, so that nobody will measure it."""
        self.exposures = [one for one in self.exposures if one != time_s]

    def _holds(self, one: Participant, now_s: float, received: Mapping[str, int], computer_s: float) -> bool:
        if one.join.follows:
            return self._limit_s(one) <= now_s
        if one.request is None or one.is_granted:
            return True
        written = one.request.written.items()
        is_on_the_wire = any(size > received.get(terminal, size) for terminal, size in written)
        return is_on_the_wire and (one.held_since is None or computer_s - one.held_since < _ON_THE_WIRE_S)

    def _limit_s(self, one: Participant) -> float:
        if one.join.follows == "frames":
            self.exposures = [time_s for time_s in self.exposures if time_s > one.progress_s + _STAMP_ROUNDING_S]
            return self.exposures[0] + one.join.lag_s if self.exposures else float("inf")
        if one.join.follows:
            return one.progress_s + one.join.lag_s * (REST_LAG_FACTOR if self.is_resting else 1.0)
        return one.request.until_s if one.request is not None and not one.is_granted else float("inf")
