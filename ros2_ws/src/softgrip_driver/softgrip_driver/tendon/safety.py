# SPDX-License-Identifier: Apache-2.0
"""Emergency stop and lock of one gripper: latched, on disk before a change counts as done, ended by a person only."""

from __future__ import annotations

import hmac
import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime

from softgrip_driver.tendon.safety_store import (
    SafetyRecord,
    SafetyStore,
    SafetyStoreError,
    StopCause,
    token_digest,
)
from softgrip_time.units import to_s

#: [s] A driver that stood still for longer counts as killed: its links may have ended, and a stop with them
MAX_DEAF_S = 2.0
ESTOP_IS_ON = "emergency stop is on; make the cell safe, then call estop_reset"


class SafetyRefusal(Exception):  # noqa: N818  an answer, not a failure
    """A lock that can not be had or released; says why and what to do."""


class Safety:
    """The state, shared by the threads of a driver.

    A stop holds in memory from the moment it is asked for, and on disk when `persist` returned no problem. Whatever
    makes the cell less safe (reset, unlock) is on disk first: where it can not be written it does not happen.

    Args:
        store: the file.
        on_change: called with the new record after each change, without the lock.
        epoch_ns: [ns] since the epoch, by which middlewares say when a message was sent.
    """

    def __init__(
        self,
        store: SafetyStore,
        on_change: Callable[[SafetyRecord], None] = lambda _: None,
        epoch_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self._store = store
        self._on_change = on_change
        self._epoch_ns = epoch_ns
        self._free_since_ns = 0  # since when nothing forbids to move; 0 = since before this process
        #: a disk may take seconds: only `_writing` is held while it is written to, and no stop waits for that
        self._mutex, self._writing = threading.Lock(), threading.Lock()
        self._stops = 0
        self._on_disk: SafetyRecord | None = None
        self._record = self._start(store.load())

    @staticmethod
    def _start(found: SafetyRecord) -> SafetyRecord:
        """Return the state of a new process: latched where the one before ended without letting go of its drives."""
        if found.is_armed and not found.is_stopped:
            return replace(
                found,
                cause=StopCause.UNCLEAN_END,
                stop_reason="the driver before this one ended without letting go of its drives (killed, crashed, or a "
                "power cut)",
            )
        return found

    @property
    def record(self) -> SafetyRecord:
        """The present state."""
        return self._record

    @property
    def refusal(self) -> str:
        """Return why nothing may move now, empty when it may."""
        record = self._record
        reasons = []
        if record.is_stopped:
            reasons.append(f"{ESTOP_IS_ON} ({record.stop_reason})")
        if record.is_locked:
            reasons.append(
                f"the cell is locked by {record.lock_owner} ({record.lock_reason}); wait until the same owner calls "
                "tendon/unlock"
            )
        return "; ".join(reasons)

    def refusal_of_sent(self, sent_ns: int) -> str:
        """Return why what was sent at a moment may not move anything, though all else may; empty when it may.

        A middleware may deliver late: what was sent while hands were inside is no order for the time after.

        Args:
            sent_ns: [ns] since the epoch, by the sender's clock; 0 = nobody knows.
        """
        since_ns = self._free_since_ns
        if not sent_ns or sent_ns >= since_ns:
            return ""
        return (
            f"it was sent {to_s(since_ns - sent_ns):.3f} s before the emergency stop or the lock ended; send it again. "
            "Where it was sent after that, synchronise the clocks of the two computers"
        )

    # --- emergency stop --------------------------------------------------------------------------------------------

    def latch_stop(self, reason: str, cause: StopCause = StopCause.REQUESTED) -> None:
        """Latch the stop in memory, at once; `announce` it when the drives are safe, `persist` puts it on disk."""
        with self._mutex:
            self._stops += 1
            if self._record.cause is not StopCause.REQUESTED:
                self._record = _next(self._record, cause=cause, stop_reason=reason)

    def latch_standstill(self, stood_s: float) -> str:
        """Latch a stop where the process stood still for so long [s] that one may be lost; return why, else nothing."""
        if stood_s < MAX_DEAF_S:
            return ""
        reason = f"the driver stood still for {stood_s:.1f} s, and a stop that was asked for meanwhile may be lost"
        self.latch_stop(reason, StopCause.STANDSTILL)
        return reason

    def announce(self) -> None:
        """Call `on_change` with the present record."""
        self._on_change(self._record)

    def persist(self) -> str:
        """Put the state on disk if it is not there yet; return the problem in words, empty for none."""
        with self._writing:
            record = self._record
            if self._on_disk == record:
                return ""
            try:
                self._store.save(record)
            except SafetyStoreError as error:
                return str(error)
            self._on_disk = record
            return ""

    def reset_stop(self) -> None:
        """End the stop; a lock stays.

        Raises:
            SafetyStoreError: it could not be written, so the stop stays.
        """
        self._replace(cause=StopCause.NONE, stop_reason="")

    def set_armed(self, *, armed: bool) -> None:
        """Note on disk that torque may be on, or that this process has let go of its drives.

        Raises:
            SafetyStoreError: it could not be written; an unclean end would not be seen, so nothing may be armed.
        """
        if self._record.is_armed != armed or self._on_disk != self._record:
            self._replace(is_armed=armed)

    # --- lock ------------------------------------------------------------------------------------------------------

    def acquire_lock(self, owner: str, reason: str, token: str = "") -> str:
        """Take the lock, or confirm with its token that it still stands; return the token.

        Raises:
            SafetyRefusal: no owner or reason given, somebody else has the lock, or the token is another lock's.
            SafetyStoreError: it could not be written; there is no lock then.
        """
        record = self._record
        if token:
            self._check_token(token)
            return token
        if not owner.strip() or not reason.strip():
            raise SafetyRefusal("expected an owner and a reason, found none; say who locks the cell and what for")
        if record.is_locked:
            raise SafetyRefusal(f"already locked by {record.lock_owner} ({record.lock_reason})")
        token = secrets.token_urlsafe(16)
        self._replace(lock_owner=owner.strip(), lock_reason=reason.strip(), lock_digest=token_digest(token))
        return token

    def release_lock(self, token: str, *, override_owner: bool = False, reason: str = "") -> str:
        """End the lock; return in words what was released.

        Raises:
            SafetyRefusal: no lock, another token, or an override without a latched stop and a reason.
            SafetyStoreError: it could not be written, so the lock stays.
        """
        record = self._record
        if not record.is_locked:
            raise SafetyRefusal("expected a lock, found none")
        if override_owner:
            if not record.is_stopped or not reason.strip():
                raise SafetyRefusal(
                    "an override needs a latched emergency stop and a reason; call estop, see that nobody's hands are "
                    "in the cell, and say who releases the lock and why"
                )
        else:
            self._check_token(token)
        self._replace(lock_owner="", lock_reason="", lock_digest="")
        by = f", overridden: {reason.strip()}" if override_owner else ""
        return f"released the lock of {record.lock_owner}{by}"

    # --- helpers ---------------------------------------------------------------------------------------------------

    def _check_token(self, token: str) -> None:
        record = self._record
        if not record.is_locked:
            raise SafetyRefusal("expected a lock with this token, found none; the lock was released")
        if not hmac.compare_digest(token_digest(token), record.lock_digest):
            raise SafetyRefusal(f"another token; the cell is locked by {record.lock_owner} ({record.lock_reason})")

    def _replace(self, **values: object) -> None:
        """Change the state on disk first, then in memory; a stop that is latched meanwhile stands."""
        with self._writing:
            with self._mutex:
                changed, stops = _next(self._record, **values), self._stops
            self._store.save(changed)
            self._on_disk = changed
            with self._mutex:
                if self._stops != stops:
                    stop = self._record
                    changed = _next(changed, cause=stop.cause, stop_reason=stop.stop_reason)
                if self._record.is_blocked and not changed.is_blocked:
                    self._free_since_ns = self._epoch_ns()
                self._record = changed
        self.announce()


def _next(record: SafetyRecord, **values: object) -> SafetyRecord:
    now = datetime.now(UTC).isoformat(timespec="milliseconds")
    return replace(record, sequence=record.sequence + 1, changed_at=now, **values)  # type: ignore[arg-type]
