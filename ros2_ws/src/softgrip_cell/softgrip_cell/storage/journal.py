# SPDX-License-Identifier: Apache-2.0
"""What is mounted, what is going on, what came of it: a kill at any moment leaves the truth or "unknown".

A swap writes "unknown" before a person may touch a finger, and what is mounted only after it was told and checked.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from enum import IntEnum, StrEnum
from typing import Any

from sqlalchemy import delete, func, insert, select, update
from sqlalchemy.engine import Connection, CursorResult, Row

from softgrip_cell.finger_records import FingerState
from softgrip_cell.grasp.contact import ContactState
from softgrip_cell.grasp.values import FingerEvidence, GraspEvidence, GraspPhase
from softgrip_cell.outcomes import Tally
from softgrip_cell.storage.engine import Database
from softgrip_cell.storage.schema import FINGER_RECORD, GRASP_EVIDENCE, LOCK, META, OPERATION, OUTCOME, SLOT, SWAP
from softgrip_time.units import to_s


class SwapOutcome(IntEnum):
    """How a swap ended (outcome of SwapFingers.Result); stored by name."""

    UNSET = 0
    SUCCEEDED = 1
    CANCELLED = 2
    REFUSED = 3
    FAILED = 4


class SlotState(StrEnum):
    """How sure the cell is of what sits in a slot (softgrip_interfaces/MountedFinger)."""

    UNKNOWN = "unknown"
    TO_BE_VERIFIED = "to be verified"
    VERIFIED = "verified"


@dataclass(frozen=True)
class MountedSlot:
    """One slot; ``serial`` and ``profile`` are empty unless a finger was read in."""

    name: str
    state: SlotState = SlotState.UNKNOWN
    serial: str = ""
    profile: str = ""


@dataclass(frozen=True)
class OpenOperation:
    """A swap or grasp that was going on when the manager last wrote."""

    kind: str
    subject: str
    step: str

    @property
    def text(self) -> str:
        """What a node says of it that was started again in its midst."""
        return f"restarted during {self.kind} '{self.subject}' at step '{self.step}'"


@dataclass(frozen=True)
class HeldLock:
    """The lock of the drives that this cell holds: hands may be inside until a person says otherwise.

    Attributes:
        token: of tendon/lock; releases it.
        confirm_token: of the swap that took it; a person's confirmation carries it.
        subject: finger set of that swap.
    """

    token: str
    confirm_token: str
    subject: str


@dataclass(frozen=True)
class Counts:
    """Everything ever counted in this database."""

    outcomes: Mapping[str, int]
    swaps: int
    mean_swap_s: float


@dataclass(frozen=True)
class CountedGrasp:
    """One grasp of the outcome table.

    Attributes:
        at_ns: of its end, in nanoseconds since the Unix epoch.
        serials: of the fingers that grasped, slot order; empty where an older release counted it.
        evidence: the numbers behind the outcome; None where nothing was observed.
    """

    at_ns: int
    product: str
    finger_set: str
    outcome: str
    reason: str
    duration_s: float
    serials: tuple[str, ...] = ()
    evidence: GraspEvidence | None = None


class CellJournal:
    """Slots, the open operation, outcomes and swaps.

    Args:
        database: an open database.
        slots: names of the slots, in order.
        now_ns: clock for what is written [ns since the Unix epoch].
    """

    def __init__(self, database: Database, slots: Sequence[str], now_ns: Callable[[], int]) -> None:
        self._database = database
        self._names = tuple(slots)
        self._now_ns = now_ns

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the slots, in order."""
        return self._names

    def recover(self) -> OpenOperation | None:
        """Bring the record into a state that can be true after a start: what was verified is to be verified again.

        Returns:
            the operation that was cut off, if any; its slots already say "unknown" where they have to.
        """
        with self._database.write() as connection:
            row = connection.execute(select(OPERATION)).one_or_none()
            known = set(connection.execute(select(SLOT.c.slot)).scalars())
            for name in self._names:
                if name not in known:
                    connection.execute(insert(SLOT).values(slot=name, serial="", state=SlotState.UNKNOWN.value))
            connection.execute(
                update(SLOT)
                .where(SLOT.c.state == SlotState.VERIFIED.value)
                .values(state=SlotState.TO_BE_VERIFIED.value)
            )
            if row is None:
                return None
            cut = OpenOperation(row.kind, row.subject, row.step)
            connection.execute(delete(OPERATION))
            self._audit(connection, "recover", f"{cut.kind} {cut.subject}", {"step": cut.step})
            return cut

    def slots(self) -> tuple[MountedSlot, ...]:
        """Return what the slots hold, in slot order."""
        query = select(SLOT, FINGER_RECORD.c.profile).outerjoin(FINGER_RECORD, SLOT.c.serial == FINGER_RECORD.c.serial)
        with self._database.read() as connection:
            rows = {row.slot: row for row in connection.execute(query)}
        return tuple(
            MountedSlot(name, SlotState(rows[name].state), rows[name].serial, rows[name].profile or "")
            if name in rows
            else MountedSlot(name)
            for name in self._names
        )

    def begin_operation(self, kind: str, subject: str, step: str) -> None:
        """Write that a swap or grasp starts."""
        with self._database.write() as connection:
            connection.execute(delete(OPERATION))
            connection.execute(
                insert(OPERATION).values(id=1, kind=kind, subject=subject, step=step, at_ns=self._now_ns())
            )

    def reach(self, step: str) -> None:
        """Write that the open operation comes to a step that changes nothing about the slots."""
        with self._database.write() as connection:
            self._set_step(connection, step)

    def abandon(self) -> None:
        """Write that the open operation never began: nothing moved, nothing is counted."""
        with self._database.write() as connection:
            connection.execute(delete(OPERATION))

    def probe(self) -> None:
        """Write something that changes nothing, to see whether the database can be written."""
        with self._database.write() as connection:
            connection.execute(update(META).where(META.c.key == "schema").values(value=META.c.value))

    def lock(self) -> HeldLock | None:
        """Return the lock of the drives that is held, None when there is none."""
        with self._database.read() as connection:
            row = connection.execute(select(LOCK)).one_or_none()
        return None if row is None else HeldLock(row.token, row.confirm_token, row.subject)

    def drop_lock(self) -> None:
        """Write that the drives are not locked by this cell any more."""
        with self._database.write() as connection:
            connection.execute(delete(LOCK))
            self._audit(connection, "unlock", "drives", None)

    def forget_slots(self, step: str, lock: HeldLock) -> None:
        """A person may touch the fingers from here on: slots and the fingers in them become unknown.

        Args:
            step: of the swap.
            lock: of the drives; on disk before anybody reaches in, so that a restart can release it.
        """
        with self._database.write() as connection:
            self._set_step(connection, step)
            connection.execute(delete(LOCK))
            connection.execute(
                insert(LOCK).values(
                    id=1,
                    token=lock.token,
                    confirm_token=lock.confirm_token,
                    subject=lock.subject,
                    at_ns=self._now_ns(),
                )
            )
            self._audit(connection, "lock", lock.subject, None)
            mounted = select(SLOT.c.serial).where(SLOT.c.serial != "").scalar_subquery()
            connection.execute(
                update(FINGER_RECORD)
                .where(FINGER_RECORD.c.serial.in_(mounted), FINGER_RECORD.c.state == FingerState.MOUNTED.value)
                .values(state=FingerState.UNKNOWN.value, version=FINGER_RECORD.c.version + 1)
            )
            connection.execute(update(SLOT).values(state=SlotState.UNKNOWN.value))

    def park_fingers(self, step: str) -> None:
        """A person says that the fingers are out and back in the store; what goes in next nobody knows yet."""
        with self._database.write() as connection:
            self._set_step(connection, step)
            out = list(connection.execute(select(SLOT.c.serial).where(SLOT.c.serial != "")).scalars())
            connection.execute(
                update(FINGER_RECORD)
                .where(FINGER_RECORD.c.serial.in_(out), FINGER_RECORD.c.state == FingerState.UNKNOWN.value)
                .values(state=FingerState.STORE.value, version=FINGER_RECORD.c.version + 1)
            )
            connection.execute(update(SLOT).values(serial=""))
            self._audit(connection, "park", ", ".join(out) or "nothing", None)

    def read_in(self, step: str, serials: Sequence[str]) -> None:
        """A person says which fingers are in the slots now (slot order)."""
        with self._database.write() as connection:
            self._set_step(connection, step)
            for name, serial in zip(self._names, serials, strict=True):
                connection.execute(
                    update(SLOT).where(SLOT.c.slot == name).values(serial=serial, state=SlotState.TO_BE_VERIFIED.value)
                )
            connection.execute(
                update(FINGER_RECORD)
                .where(FINGER_RECORD.c.serial.in_(list(serials)))
                .values(state=FingerState.MOUNTED.value, version=FINGER_RECORD.c.version + 1)
            )
            self._audit(connection, "read in", ", ".join(serials), None)

    def finish_swap(
        self,
        finger_set: str,
        outcome: SwapOutcome,
        reason: str,
        duration_s: float,
        *,
        changed: bool,
        references: Mapping[str, object] | None = None,
    ) -> None:
        """Close a swap.

        Args:
            finger_set: what was asked for.
            outcome: how it ended.
            reason: in words.
            duration_s: from accepting to finishing [s].
            changed: fingers were changed (a mere check is not counted as a swap).
            references: per serial, the free motion that the check saw: the slots become verified.
        """
        at_ns = self._now_ns()
        day = datetime.fromtimestamp(to_s(at_ns), tz=UTC).date().isoformat()
        with self._database.write() as connection:
            for serial, reference in (references or {}).items():
                connection.execute(
                    update(FINGER_RECORD)
                    .where(FINGER_RECORD.c.serial == serial)
                    .values(
                        reference=json.dumps(reference),
                        calibrated=day,
                        cycles=FINGER_RECORD.c.cycles + 1,
                        version=FINGER_RECORD.c.version + 1,
                    )
                )
                connection.execute(update(SLOT).where(SLOT.c.serial == serial).values(state=SlotState.VERIFIED.value))
            connection.execute(
                insert(SWAP).values(
                    finger_set=finger_set,
                    outcome=outcome.name,
                    counted=changed and outcome is SwapOutcome.SUCCEEDED,
                    reason=reason,
                    duration_s=duration_s,
                    at_ns=at_ns,
                )
            )
            connection.execute(delete(OPERATION))
            self._audit(connection, "swap", finger_set, {"outcome": outcome.name, "reason": reason})

    def distrust(self, unknown: Sequence[str], worn: Sequence[str] = ()) -> None:
        """The check refused these fingers: they become unknown or worn, and the slots unknown."""
        with self._database.write() as connection:
            for serials, state in ((unknown, FingerState.UNKNOWN), (worn, FingerState.WORN)):
                connection.execute(
                    update(FINGER_RECORD)
                    .where(FINGER_RECORD.c.serial.in_(list(serials)))
                    .values(state=state.value, version=FINGER_RECORD.c.version + 1)
                )
            refused = [*unknown, *worn]
            connection.execute(update(SLOT).where(SLOT.c.serial.in_(refused)).values(serial=""))
            connection.execute(update(SLOT).values(state=SlotState.UNKNOWN.value))
            self._audit(connection, "distrust", ", ".join(refused), {"worn": list(worn)})

    def wear(self, slot: str, reason: str) -> str:
        """Call the finger in a slot worn, as its own closings show, in its finger record; the slot is unverified.

        Returns:
            its serial; empty when nobody knows what is in the slot, and then nothing is written.
        """
        with self._database.write() as connection:
            found = select(SLOT.c.serial).where(SLOT.c.slot == slot, SLOT.c.state != SlotState.UNKNOWN.value)
            serial = str(connection.execute(found).scalar() or "")
            if serial:
                connection.execute(
                    update(FINGER_RECORD)
                    .where(FINGER_RECORD.c.serial == serial)
                    .values(state=FingerState.WORN.value, version=FINGER_RECORD.c.version + 1)
                )
                connection.execute(update(SLOT).where(SLOT.c.slot == slot).values(state=SlotState.TO_BE_VERIFIED.value))
                self._audit(connection, "worn", serial, {"slot": slot, "reason": reason})
        return serial

    def finish_grasp(
        self,
        product: str,
        product_version: int,
        finger_set: str,
        outcome: str,
        reason: str,
        duration_s: float,
        *,
        serials: Sequence[str] = (),
        evidence: GraspEvidence | None = None,
    ) -> None:
        """Count a grasp and a cycle of every mounted finger, and close the operation.

        Args:
            product: that was grasped.
            product_version: of it.
            finger_set: that grasped.
            outcome: how it ended.
            reason: in words.
            duration_s: from accepting to the outcome [s].
            serials: of the fingers, slot order.
            evidence: the numbers behind the outcome; None = nothing was observed.
        """
        with self._database.write() as connection:
            counted = connection.execute(
                insert(OUTCOME).values(
                    product=product,
                    product_version=product_version,
                    finger_set=finger_set,
                    outcome=outcome,
                    reason=reason,
                    duration_s=duration_s,
                    at_ns=self._now_ns(),
                )
            )
            connection.execute(
                insert(GRASP_EVIDENCE).values(
                    outcome_id=_new_id(counted),
                    serials=json.dumps(list(serials)),
                    decided_ns=evidence.decided_ns if evidence else 0,
                    phase=evidence.phase.value if evidence else "",
                    fingers=json.dumps([asdict(one) for one in evidence.fingers] if evidence else []),
                )
            )
            mounted = select(SLOT.c.serial).where(SLOT.c.serial != "").scalar_subquery()
            connection.execute(
                update(FINGER_RECORD)
                .where(FINGER_RECORD.c.serial.in_(mounted))
                .values(cycles=FINGER_RECORD.c.cycles + 1, version=FINGER_RECORD.c.version + 1)
            )
            connection.execute(delete(OPERATION))

    def reference(self, serial: str) -> Mapping[str, object] | None:
        """Return the free motion stored by the last passed check of a finger, None before the first."""
        with self._database.read() as connection:
            found = connection.execute(
                select(FINGER_RECORD.c.reference).where(FINGER_RECORD.c.serial == serial)
            ).scalar()
        if found is None:
            return None
        reference: Mapping[str, object] = json.loads(found)
        return reference

    def grasps(self, limit: int) -> list[CountedGrasp]:
        """Return the newest counted grasps, newest first."""
        query = (
            select(OUTCOME, GRASP_EVIDENCE)
            .outerjoin(GRASP_EVIDENCE, OUTCOME.c.id == GRASP_EVIDENCE.c.outcome_id)
            .order_by(OUTCOME.c.id.desc())
            .limit(limit)
        )
        with self._database.read() as connection:
            return [_counted_grasp(row) for row in connection.execute(query)]

    def tallies(self) -> dict[tuple[str, str], Tally]:
        """Return counted grasps per (product, finger set)."""
        query = select(OUTCOME.c.product, OUTCOME.c.finger_set, OUTCOME.c.outcome, func.count()).group_by(
            OUTCOME.c.product, OUTCOME.c.finger_set, OUTCOME.c.outcome
        )
        tallies: dict[tuple[str, str], Tally] = {}
        with self._database.read() as connection:
            for product, finger_set, outcome, count in connection.execute(query):
                known = tallies.get((product, finger_set), Tally())
                if outcome == "GRIPPED":
                    known = Tally(known.gripped + count, known.failed)
                elif outcome in ("EMPTY", "SLIPPED"):
                    known = Tally(known.gripped, known.failed + count)
                tallies[product, finger_set] = known
        return tallies

    def counts(self) -> Counts:
        """Return counters over the life of the database."""
        with self._database.read() as connection:
            per_outcome = select(OUTCOME.c.outcome, func.count()).group_by(OUTCOME.c.outcome)
            outcomes = {name: int(count) for name, count in connection.execute(per_outcome)}
            swaps, mean = connection.execute(
                select(func.count(), func.avg(SWAP.c.duration_s)).where(SWAP.c.counted)
            ).one()
        return Counts(outcomes=outcomes, swaps=int(swaps), mean_swap_s=float(mean or 0.0))

    def _set_step(self, connection: Connection, step: str) -> None:
        connection.execute(update(OPERATION).values(step=step, at_ns=self._now_ns()))

    def _audit(self, connection: Connection, action: str, subject: str, detail: object) -> None:
        self._database.audit(connection, self._now_ns(), "grasp_mix_manager", action, subject, detail)


def _counted_grasp(row: Row[Any]) -> CountedGrasp:
    evidence = None
    if row.phase:
        fingers = tuple(
            FingerEvidence(**{**one, "state": ContactState(one["state"])}) for one in json.loads(row.fingers)
        )
        evidence = GraspEvidence(GraspPhase(row.phase), row.decided_ns, fingers)
    serials = tuple(json.loads(row.serials)) if row.serials else ()
    return CountedGrasp(
        row.at_ns, row.product, row.finger_set, row.outcome, row.reason, row.duration_s, serials, evidence
    )


def _new_id(inserted: CursorResult[Any]) -> int:
    key = inserted.inserted_primary_key
    assert key is not None
    return int(key[0])
