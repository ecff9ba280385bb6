# SPDX-License-Identifier: Apache-2.0
"""Whether the test stand may move: it follows the cell's one emergency stop and the lock around hands."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class HeardState:
    """The cell's safety state as it was last published.

    Attributes:
        is_stopped, stop_reason: the emergency stop is latched, and why.
        is_locked, lock_owner: hands are in the cell, and whose.
    """

    is_stopped: bool
    stop_reason: str
    is_locked: bool
    lock_owner: str


class StopGuard:
    """What the stand has heard, and what follows from it.

    It does not move before it has heard a state, and stops when nobody is left who would publish a change, when who
    does so does not answer, or when several publish, of whom each would undo another one's stop: a stop that can not
    arrive is as good as one that did.

    Args:
        max_absence_s: [s] without a publisher after which the stand stops.
    """

    def __init__(self, max_absence_s: float) -> None:
        self._max_absence_s = max_absence_s
        self._heard: HeardState | None = None
        self._absent_since: float | None = None
        self._publishers = 1
        self._is_answering = True

    def take_state(self, state: HeardState) -> None:
        """Take a published state."""
        self._heard = state

    def take_publishers(self, count: int, now: float) -> None:
        """Take how many nodes publish the state at a steady time [s]."""
        self._publishers = count
        if count:
            self._absent_since = None
        elif self._absent_since is None:
            self._absent_since = now

    def take_answering(self, *, is_answering: bool) -> None:
        """Take whether the node that publishes the state answers its ping, or has never been asked."""
        self._is_answering = is_answering

    def refusal(self, now: float) -> str:
        """Return why the stand may not move at a steady time [s], empty when it may."""
        heard = self._heard
        if heard is None:
            return (
                "expected the cell's safety state on safety/state, found none yet; start tendon_driver, or set "
                "safety_source to none on a bench without tendons"
            )
        if heard.is_stopped:
            return f"the emergency stop is on ({heard.stop_reason}); make the cell safe, then call estop_reset"
        if heard.is_locked:
            return f"the cell is locked by {heard.lock_owner}; wait until the same owner calls tendon/unlock"
        return self._source_refusal(now)

    def _source_refusal(self, now: float) -> str:
        """Return why a stop could not arrive."""
        if self._publishers > 1:
            return f"{self._publishers} nodes publish safety/state, expected one: each would undo another one's stop"
        if self._absent_since is not None and now - self._absent_since > self._max_absence_s:
            return "nobody publishes safety/state any more, so a stop could not arrive; see why tendon_driver has gone"
        if not self._is_answering:
            return "tendon_driver does not answer its ping, so a stop might not arrive; see what it waits for"
        return ""
