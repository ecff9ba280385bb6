# SPDX-License-Identifier: Apache-2.0
"""Products, finger sets and finger records in the database: versions never overwritten, every change audited."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from datetime import date
from typing import Any

from sqlalchemy import func, insert, select, update
from sqlalchemy.engine import Connection, Row

from softgrip_cell.catalogue_file import finger_set_document, product_document, read_finger_set, read_product
from softgrip_cell.errors import ConflictError, RefusedError
from softgrip_cell.finger_records import FingerRecord, FingerState, finger_record_document
from softgrip_cell.products import Catalogue, Product
from softgrip_cell.storage.engine import Database
from softgrip_cell.storage.schema import (
    ACTION_LENGTH,
    AUDIT,
    ENTRY,
    FINGER_RECORD,
    SUBJECT_LENGTH,
    WHO_LENGTH,
)
from softgrip_cell.yaml_fields import Fields


@dataclass(frozen=True)
class AuditEntry:
    """Who did what when; ``at_ns`` in nanoseconds since the Unix epoch."""

    at_ns: int
    who: str
    action: str
    subject: str
    detail: object


class Library:
    """What the cell knows about products and fingers.

    Args:
        database: an open database.
        now_ns: clock for audit entries [ns since the Unix epoch].
    """

    def __init__(self, database: Database, now_ns: Callable[[], int]) -> None:
        self._database = database
        self._now_ns = now_ns
        self._last_ns = 0

    def catalogue(self) -> Catalogue:
        """Return the version in force of every product and finger set."""
        with self._database.read() as connection:
            rows = _entries_in_force(connection)
        sets = {
            row.id: read_finger_set(row.id, Fields(f"finger set {row.id}", json.loads(row.document)))
            for row in rows
            if row.kind == "finger_set"
        }
        products = {
            row.id: read_product(row.id, Fields(f"product {row.id}", json.loads(row.document)), set(sets))
            for row in rows
            if row.kind == "product"
        }
        return Catalogue(finger_sets=sets, products=products)

    def is_empty(self) -> bool:
        """Return whether no product was ever stored."""
        with self._database.read() as connection:
            return not connection.execute(select(func.count()).select_from(ENTRY)).scalar_one()

    def save_product(self, product: Product, who: str) -> Product:
        """Store a changed or new product as the next version.

        Args:
            product: as edited; its ``version`` is the one it was read at (new products: 1 or anything).
            who: name for the audit.

        Returns:
            the product with its new version; the same one when nothing changed.

        Raises:
            ConflictError: it was changed by somebody else since; nothing is written.
        """
        with self._database.write() as connection:
            version = self._save(connection, "product", product.id, product_document(product), product.version, who)
        return replace(product, version=version)

    def import_catalogue(self, catalogue: Catalogue, who: str) -> list[str]:
        """Store every changed or new entry of a catalogue, all or nothing.

        Returns:
            ids of what was written.

        Raises:
            ConflictError: an entry differs and was changed in the database since the file was written.
        """
        written: list[str] = []
        with self._database.write() as connection:
            before = {(row.kind, row.id): row.version for row in _entries_in_force(connection)}
            for item in catalogue.finger_sets.values():
                # A finger set has no version of its own in a file: its content names the profile and nothing else.
                found = before.get(("finger_set", item.id), 1)
                version = self._save(connection, "finger_set", item.id, finger_set_document(item), found, who)
                if version != before.get(("finger_set", item.id)):
                    written.append(item.id)
            for product in catalogue.products.values():
                document = product_document(product)
                version = self._save(connection, "product", product.id, document, product.version, who)
                if version != before.get(("product", product.id)):
                    written.append(product.id)
        return written

    def product_history(self, product_id: str) -> list[tuple[int, str, int, object]]:
        """Return (version, who, at_ns, document) of every version of a product, oldest first."""
        query = select(ENTRY).where(ENTRY.c.kind == "product", ENTRY.c.id == product_id).order_by(ENTRY.c.version)
        with self._database.read() as connection:
            return [(r.version, r.who, r.at_ns, json.loads(r.document)) for r in connection.execute(query)]

    def finger_records(self) -> dict[str, FingerRecord]:
        """Return every finger by serial."""
        with self._database.read() as connection:
            rows = connection.execute(select(FINGER_RECORD).order_by(FINGER_RECORD.c.serial)).all()
        return {row.serial: _finger_record(row) for row in rows}

    def save_finger_record(self, finger_record: FingerRecord, who: str) -> FingerRecord:
        """Store a changed or new finger record; its ``version`` is the one it was read at.

        Raises:
            ConflictError: it was changed by somebody else since; nothing is written.
        """
        with self._database.write() as connection:
            return self._save_finger_record(connection, finger_record, who)

    def import_finger_records(self, finger_records: Iterable[FingerRecord], who: str) -> list[str]:
        """Store every changed or new finger record, all or nothing; return the serials written."""
        written: list[str] = []
        with self._database.write() as connection:
            for finger_record in finger_records:
                found = connection.execute(
                    select(FINGER_RECORD).where(FINGER_RECORD.c.serial == finger_record.serial)
                ).one_or_none()
                if found is None or replace(_finger_record(found), version=finger_record.version) != finger_record:
                    self._save_finger_record(connection, finger_record, who)
                    written.append(finger_record.serial)
        return written

    def set_finger_state(self, serial: str, state: FingerState, who: str) -> FingerRecord:
        """Change where a finger is or whether it may be used, e.g. after a person looked at it.

        Raises:
            RefusedError: there is no such finger.
        """
        found = self.finger_records().get(serial)
        if found is None:
            raise RefusedError(f"expected the serial of a known finger, found '{serial}'")
        return self.save_finger_record(replace(found, state=state), who)

    def retire_finger(self, serial: str, who: str, reason: str) -> FingerRecord:
        """Take a finger out of use for good; name and reason go into the audit table.

        Raises:
            RefusedError: there is no such finger, or it is retired.
        """
        found = self.finger_records().get(serial)
        if found is None or found.state is FingerState.RETIRED:
            raise RefusedError(f"expected the serial of a finger that is not retired, found '{serial}'")
        with self._database.write() as connection:
            saved = self._save_finger_record(connection, replace(found, state=FingerState.RETIRED), who)
            self._database.audit(connection, self._now_ns(), who, "retire finger", serial, {"reason": reason})
        return saved

    def write_audit(self, who: str, action: str, subject: str, detail: str) -> None:
        """Write into the audit table what a person did; texts longer than its columns are cut."""
        with self._database.write() as connection:
            self._database.audit(
                connection,
                self._now_ns(),
                who[:WHO_LENGTH],
                action[:ACTION_LENGTH],
                subject[:SUBJECT_LENGTH],
                {"detail": detail},
            )

    def audit(self, limit: int = 100) -> list[AuditEntry]:
        """Return the latest changes, newest first."""
        query = select(AUDIT).order_by(AUDIT.c.id.desc()).limit(limit)
        with self._database.read() as connection:
            return [
                AuditEntry(row.at_ns, row.who, row.action, row.subject, json.loads(row.detail))
                for row in connection.execute(query)
            ]

    def _save(
        self, connection: Connection, kind: str, key: str, document: dict[str, object], read_version: int, who: str
    ) -> int:
        row = connection.execute(
            select(ENTRY).where(ENTRY.c.kind == kind, ENTRY.c.id == key).order_by(ENTRY.c.version.desc()).limit(1)
        ).one_or_none()
        if row is None:
            version = 1
        else:
            if _content(json.loads(row.document)) == _content(document):
                return int(row.version)
            if row.version != read_version:
                raise ConflictError(
                    f"{kind} '{key}': expected version {read_version} in the database, found {row.version} written by "
                    f"{row.who}; export it, carry your change over and try again. Nothing was written"
                )
            version = row.version + 1
        document = {**document, "version": version} if kind == "product" else document
        at_ns = self._next_stamp_ns()
        connection.execute(
            insert(ENTRY).values(
                kind=kind, id=key, version=version, document=json.dumps(document), who=who, at_ns=at_ns
            )
        )
        self._database.audit(connection, at_ns, who, f"save {kind}", key, {"version": version})
        return version

    def _next_stamp_ns(self) -> int:
        """Return the time, but later than the one before: entries are ordered by it, and simulated time stands."""
        self._last_ns = max(self._now_ns(), self._last_ns + 1)
        return self._last_ns

    def _save_finger_record(self, connection: Connection, finger_record: FingerRecord, who: str) -> FingerRecord:
        values = _finger_record_values(finger_record)
        row = connection.execute(
            select(FINGER_RECORD).where(FINGER_RECORD.c.serial == finger_record.serial)
        ).one_or_none()
        if row is None:
            saved = replace(finger_record, version=1)
            connection.execute(insert(FINGER_RECORD).values(**{**values, "version": 1}))
        elif row.version != finger_record.version:
            raise ConflictError(
                f"finger '{finger_record.serial}': expected version {finger_record.version} in the database, found "
                f"{row.version}; read it again and carry your change over. Nothing was written"
            )
        else:
            saved = replace(finger_record, version=finger_record.version + 1)
            connection.execute(
                update(FINGER_RECORD)
                .where(FINGER_RECORD.c.serial == finger_record.serial)
                .values(**_finger_record_values(saved))
            )
        detail = finger_record_document(saved)
        self._database.audit(connection, self._now_ns(), who, "save finger record", finger_record.serial, detail)
        return saved


def _entries_in_force(connection: Connection) -> list[Row[Any]]:
    latest = select(ENTRY.c.kind, ENTRY.c.id, func.max(ENTRY.c.version).label("version")).group_by(
        ENTRY.c.kind, ENTRY.c.id
    )
    newest = latest.subquery()
    query = select(ENTRY).join(
        newest,
        (ENTRY.c.kind == newest.c.kind) & (ENTRY.c.id == newest.c.id) & (ENTRY.c.version == newest.c.version),
    )
    # In the order in which entries were first stored, so that an export keeps the file's order.
    first = select(ENTRY.c.kind, ENTRY.c.id, func.min(ENTRY.c.at_ns).label("at_ns")).group_by(ENTRY.c.kind, ENTRY.c.id)
    oldest = first.subquery()
    query = query.join(oldest, (ENTRY.c.kind == oldest.c.kind) & (ENTRY.c.id == oldest.c.id))
    return list(connection.execute(query.order_by(oldest.c.at_ns, ENTRY.c.kind, ENTRY.c.id)))


def _content(document: dict[str, object]) -> dict[str, object]:
    return {key: value for key, value in document.items() if key != "version"}


def _finger_record(row: Row[Any]) -> FingerRecord:
    return FingerRecord(
        serial=row.serial,
        profile=row.profile,
        finger=row.finger,
        printed=date.fromisoformat(row.printed),
        material=row.material,
        cable=row.cable,
        state=FingerState(row.state),
        cycles=row.cycles,
        cycle_limit=row.cycle_limit,
        calibrated=date.fromisoformat(row.calibrated) if row.calibrated else None,
        version=row.version,
    )


def _finger_record_values(finger_record: FingerRecord) -> dict[str, Any]:
    document = finger_record_document(finger_record)
    return {
        **document,
        "serial": finger_record.serial,
        "calibrated": finger_record.calibrated and finger_record.calibrated.isoformat(),
    }
