# SPDX-License-Identifier: Apache-2.0
"""The cell's memory on SQLite and PostgreSQL: versions, conflicts, audit, recovery, unusable databases."""

from __future__ import annotations

import itertools
import json
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from sqlalchemy import event, insert, text, update

from softgrip_cell.catalogue_file import catalogue_text, read_catalogue
from softgrip_cell.errors import ConflictError, OccupiedError, RefusedError, StorageError
from softgrip_cell.finger_records import FingerState, read_finger_records
from softgrip_cell.grasp.contact import ContactState
from softgrip_cell.grasp.values import FingerEvidence, GraspEvidence, GraspPhase
from softgrip_cell.outcomes import Tally
from softgrip_cell.storage import CellJournal, Database, HeldLock, Library, PendingWrites, SlotState
from softgrip_cell.storage.engine import POSTGRES_DRIVER
from softgrip_cell.storage.journal import SwapOutcome
from softgrip_cell.storage.schema import LOCK as LOCK_TABLE
from softgrip_cell.storage.schema import META, OUTCOME
from softgrip_testing.waiting import wait_until

SLOTS = ("index", "middle", "thumb")
POWER = ("PW-I-01", "PW-M-01", "PW-T-01")
LOCK = HeldLock("token of the driver", "token of the swap", "pinch")


HOLD_THE_CELL = """
import sys, time
from softgrip_cell.storage import Database
database = Database(sys.argv[1], exclusive=True)
print('open', flush=True)
time.sleep(60)
"""


class Clock:
    """Counts seconds from a fixed day, 2026-11-21 10:00 UTC."""

    def __init__(self) -> None:
        self.now_ns = 1_795_255_200 * 1_000_000_000

    def __call__(self) -> int:
        self.now_ns += 1_000_000_000
        return self.now_ns


@pytest.fixture
def database(database_url: str) -> Iterator[Database]:
    with Database(database_url, exclusive=True) as opened:
        yield opened


@pytest.fixture
def library(database: Database) -> Library:
    made = Library(database, Clock())
    made.import_catalogue(read_catalogue(), "test")
    made.import_finger_records(read_finger_records().values(), "test")
    return made


@pytest.fixture
def journal(database: Database, library: Library) -> CellJournal:
    made = CellJournal(database, SLOTS, Clock())
    made.recover()
    return made


def mount(journal: CellJournal, serials: tuple[str, ...] = POWER, *, verify: bool = True) -> None:
    journal.begin_operation("swap", "power", "release")
    journal.forget_slots("open_palm", LOCK)
    journal.park_fingers("insert")
    journal.read_in("close_palm", serials)
    if verify:
        journal.finish_swap(
            "power", SwapOutcome.SUCCEEDED, "ok", 42.0, changed=True, references={s: {"x": 1} for s in serials}
        )


def test_catalogue_goes_in_and_comes_out_the_same(library: Library) -> None:
    assert library.catalogue() == read_catalogue()
    assert list(library.catalogue().products) == list(read_catalogue().products)


@pytest.mark.parametrize("tick_after", [1, 2, 100])
def test_a_time_that_stands_keeps_the_order(database: Database, tick_after: int) -> None:
    """Simulated time stands, or ticks anywhere in an import; the order decides which of two equal plans is taken."""
    asked = itertools.count()
    library = Library(database, lambda: next(asked) // tick_after)
    library.import_catalogue(read_catalogue(), "test")
    assert list(library.catalogue().finger_sets) == list(read_catalogue().finger_sets)
    assert list(library.catalogue().products) == list(read_catalogue().products)


def test_importing_twice_writes_nothing(library: Library) -> None:
    assert library.import_catalogue(read_catalogue(), "test") == []
    assert library.import_finger_records(read_finger_records().values(), "test") == []


def test_every_change_is_a_version_with_its_author(library: Library) -> None:
    egg = library.catalogue().products["egg"]
    saved = library.save_product(replace(egg, mass_kg=0.065), "Ada")
    assert saved.version == 2
    assert library.catalogue().products["egg"].mass_kg == pytest.approx(0.065)
    history = library.product_history("egg")
    assert [(version, who) for version, who, _, _ in history] == [(1, "test"), (2, "Ada")]
    assert history[0][3]["mass_kg"] == pytest.approx(0.060)
    newest = library.audit()[0]
    assert (newest.who, newest.action, newest.subject, newest.detail) == ("Ada", "save product", "egg", {"version": 2})


def test_an_edit_made_meanwhile_is_never_overwritten(library: Library) -> None:
    read_before = library.catalogue().products["egg"]
    library.save_product(replace(read_before, mass_kg=0.065), "Ada")
    with pytest.raises(ConflictError, match="expected version 1 in the database, found 2 written by Ada"):
        library.save_product(replace(read_before, mass_kg=0.070), "Bob")
    assert library.catalogue().products["egg"].mass_kg == pytest.approx(0.065)


def test_a_file_exported_before_an_edit_is_refused_whole(library: Library, tmp_path: Path) -> None:
    path = tmp_path / "export.yaml"
    path.write_text(catalogue_text(library.catalogue()).replace("mass_kg: 0.2", "mass_kg: 0.25"))
    library.save_product(replace(library.catalogue().products["orange"], mass_kg=0.21), "Ada")
    edited = read_catalogue(path)
    edited.products["apple"] = replace(edited.products["apple"], mass_kg=0.19)  # type: ignore[index]  # a dict in fact
    with pytest.raises(ConflictError, match="'orange'"):
        library.import_catalogue(edited, "Bob")
    assert library.catalogue().products["apple"].mass_kg == pytest.approx(0.18), "half of the file was written"


def test_a_passport_changed_meanwhile_is_never_overwritten(library: Library) -> None:
    finger = library.finger_records()["PW-I-01"]
    library.set_finger_state("PW-I-01", FingerState.WORN, "Ada")
    with pytest.raises(ConflictError):
        library.save_finger_record(replace(finger, cycles=7), "Bob")
    assert library.finger_records()["PW-I-01"].state is FingerState.WORN
    with pytest.raises(RefusedError, match="known finger"):
        library.set_finger_state("PW-X-99", FingerState.WORN, "Ada")


def test_a_retired_finger_stays_retired_and_the_audit_says_by_whom_and_why(library: Library) -> None:
    assert library.retire_finger("PW-I-02", "Ada", "tore at joint 1").state is FingerState.RETIRED
    assert "retired" in (library.finger_records()["PW-I-02"].objection() or "")
    reasons = [(one.who, one.subject, one.detail) for one in library.audit() if one.action == "retire finger"]
    assert reasons == [("Ada", "PW-I-02", {"reason": "tore at joint 1"})]
    for serial in ("PW-I-02", "nobody's"):
        with pytest.raises(RefusedError, match="not retired"):
            library.retire_finger(serial, "Ada", "again")


def test_what_a_person_did_is_audited_whatever_its_length(library: Library) -> None:
    library.write_audit("w" * 200, "a" * 200, "s" * 500, "d" * 5000)
    newest = library.audit(1)[0]
    assert (newest.who, newest.action, newest.subject) == ("w" * 80, "a" * 40, "s" * 160)
    assert newest.detail == {"detail": "d" * 5000}


def test_grasps_are_listed_newest_first(library: Library, journal: CellJournal) -> None:
    for outcome in ("GRIPPED", "EMPTY", "SLIPPED"):
        journal.finish_grasp("egg", 1, "power", outcome, f"because {outcome}", 1.5)
    found = journal.grasps(2)
    assert [(one.product, one.outcome, one.reason, one.duration_s) for one in found] == [
        ("egg", "SLIPPED", "because SLIPPED", 1.5),
        ("egg", "EMPTY", "because EMPTY", 1.5),
    ]
    assert found[0].at_ns > found[1].at_ns


def test_a_grasp_is_kept_with_its_fingers_and_the_numbers_behind_it(database: Database, journal: CellJournal) -> None:
    evidence = GraspEvidence(
        GraspPhase.HOLD,
        1_234_567_890,
        (
            FingerEvidence("index", ContactState.BLOCKED, 3.1, 0.9, 0.2, 3.4, 1.5),
            FingerEvidence("thumb", ContactState.FREE, 0.1, 0.9, 0.2, 0.3, 0.4, 0.002),
        ),
    )
    serials = ("PW-I-01", "PW-M-01", "PW-T-01")
    journal.finish_grasp("egg", 1, "power", "GRIPPED", "both sides press", 1.5, serials=serials, evidence=evidence)
    journal.finish_grasp("egg", 1, "power", "ABORTED", "asked for", 0.5, serials=serials)
    aborted, gripped = journal.grasps(2)
    assert (gripped.serials, gripped.evidence) == (serials, evidence)
    assert (aborted.serials, aborted.evidence) == (serials, None)
    database.load(database.save())
    assert journal.grasps(2) == [aborted, gripped]


def test_a_grasp_that_an_older_release_counted_has_no_fingers(database_url: str) -> None:
    with Database(database_url) as opened, opened.write() as connection:
        connection.execute(text("DROP TABLE softgrip_grasp_evidence"))
        connection.execute(update(META).where(META.c.key == "schema").values(value="2"))
        connection.execute(
            insert(OUTCOME).values(
                product="egg", product_version=1, finger_set="power", outcome="GRIPPED", reason="", duration_s=1.0,
                at_ns=1,
            )
        )  # fmt: skip
    with Database(database_url) as opened:
        (found,) = CellJournal(opened, ("index",), Clock()).grasps(1)
    assert (found.outcome, found.serials, found.evidence) == ("GRIPPED", (), None)


def test_a_verified_set_is_to_be_verified_after_a_restart(database: Database, journal: CellJournal) -> None:
    mount(journal)
    assert {slot.state for slot in journal.slots()} == {SlotState.VERIFIED}
    again = CellJournal(database, SLOTS, Clock())
    assert again.recover() is None
    assert [(slot.state, slot.serial, slot.profile) for slot in again.slots()] == [
        (SlotState.TO_BE_VERIFIED, serial, "power") for serial in POWER
    ]


@pytest.mark.parametrize(
    ("steps", "slots", "fingers"),
    [
        (1, SlotState.TO_BE_VERIFIED, FingerState.MOUNTED),  # begun, nobody has touched anything
        (2, SlotState.UNKNOWN, FingerState.UNKNOWN),  # the palm may be open
        (3, SlotState.UNKNOWN, FingerState.STORE),  # parked; what is being inserted is not known
        (4, SlotState.TO_BE_VERIFIED, FingerState.STORE),  # the new ones were read in
    ],
)
def test_a_kill_in_a_swap_leaves_the_truth_or_unknown(
    database: Database, library: Library, journal: CellJournal, steps: int, slots: SlotState, fingers: FingerState
) -> None:
    mount(journal)
    journal.begin_operation("swap", "pinch", "release")
    if steps > 1:
        journal.forget_slots("open_palm", LOCK)
    if steps > 2:
        journal.park_fingers("insert")
    if steps > 3:
        journal.read_in("close_palm", ("PI-I-01", "PI-M-01", "PI-T-01"))
    again = CellJournal(database, SLOTS, Clock())
    cut = again.recover()
    assert cut is not None
    assert (cut.kind, cut.subject) == ("swap", "pinch")
    assert {slot.state for slot in again.slots()} == {slots}
    assert {library.finger_records()[serial].state for serial in POWER} == {fingers}
    assert again.recover() is None


def test_outcomes_are_tallied_and_cycles_counted(library: Library, journal: CellJournal) -> None:
    mount(journal)
    for outcome in ("GRIPPED", "GRIPPED", "EMPTY", "SLIPPED", "ABORTED", "TENDON_FAULT"):
        journal.begin_operation("grasp", "egg", "power")
        journal.finish_grasp("egg", 1, "power", outcome, "reason", 2.0)
    assert journal.tallies() == {("egg", "power"): Tally(gripped=2, failed=2)}
    counts = journal.counts()
    assert sum(counts.outcomes.values()) == 6
    assert (counts.swaps, counts.mean_swap_s) == (1, pytest.approx(42.0))
    assert library.finger_records()["PW-I-01"].cycles == 1 + 6  # the check of the swap and six grasps


def test_a_distrusted_finger_does_not_come_back_by_being_parked(library: Library, journal: CellJournal) -> None:
    mount(journal, verify=False)
    journal.distrust(["PW-I-01"], ["PW-T-01"])
    assert {slot.state for slot in journal.slots()} == {SlotState.UNKNOWN}
    journal.begin_operation("swap", "power", "release")
    journal.forget_slots("open_palm", LOCK)
    journal.park_fingers("insert")
    states = [library.finger_records()[serial].state for serial in POWER]
    assert states == [FingerState.UNKNOWN, FingerState.STORE, FingerState.WORN]


def test_two_managers_on_one_cell_are_refused(database_url: str, database: Database) -> None:
    with pytest.raises(OccupiedError, match="another grasp_mix_manager runs this cell"):
        Database(database_url, exclusive=True)
    Database(database_url).close()  # a tool may read beside it


def test_the_cell_is_free_again_after_kill_9(database_url: str) -> None:
    holder = subprocess.Popen(
        [
            sys.executable,
            "-c",
            HOLD_THE_CELL,
            database_url,
        ],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert holder.stdout is not None
    assert holder.stdout.readline() == "open\n"
    with pytest.raises(OccupiedError):
        Database(database_url, exclusive=True)
    holder.kill()
    holder.communicate()
    wait_until(lambda: _opens(database_url))


def test_the_lock_outlives_the_swap_and_a_restart_until_it_is_dropped(database: Database, journal: CellJournal) -> None:
    assert journal.lock() is None
    journal.begin_operation("swap", "pinch", "release")
    journal.forget_slots("open_palm", LOCK)
    journal.finish_swap("pinch", SwapOutcome.CANCELLED, "", 1.0, changed=True)
    again = CellJournal(database, SLOTS, Clock())
    again.recover()
    assert again.lock() == LOCK
    again.drop_lock()
    assert journal.lock() is None


def test_the_lock_and_unknown_slots_are_written_together_or_not_at_all(
    database: Database, journal: CellJournal
) -> None:
    mount(journal)
    journal.drop_lock()
    journal.begin_operation("swap", "pinch", "release")
    with database.write() as connection:
        LOCK_TABLE.drop(connection)
    with pytest.raises(StorageError):
        journal.forget_slots("open_palm", LOCK)
    assert {slot.state for slot in journal.slots()} == {SlotState.VERIFIED}


def test_a_database_of_the_release_before_gets_the_tables_that_it_lacks(database_url: str) -> None:
    with Database(database_url) as opened, opened.write() as connection:
        LOCK_TABLE.drop(connection)
        connection.execute(update(META).values(value="1"))
    with Database(database_url) as opened:
        library = Library(opened, Clock())
        library.import_catalogue(read_catalogue(), "test")
        journal = CellJournal(opened, SLOTS, Clock())
        journal.recover()
        assert journal.lock() is None
        journal.forget_slots("open_palm", LOCK)
        assert journal.lock() == LOCK


def test_what_an_older_release_remembered_is_put_back(database: Database, journal: CellJournal) -> None:
    mount(journal)
    tables = json.loads(database.save())
    del tables[LOCK_TABLE.name]
    database.load(json.dumps(tables).encode())
    assert journal.lock() is None
    assert [slot.serial for slot in journal.slots()] == list(POWER)


def test_every_connection_to_sqlite_writes_through_to_the_disk(tmp_path: Path) -> None:
    """synchronous=FULL (2): what was committed survives a power cut; the connection itself is asked."""
    with Database(f"sqlite:///{tmp_path}/cell.db") as opened:
        for _ in range(3):
            with opened.write() as connection:
                assert connection.exec_driver_sql("PRAGMA synchronous").scalar() == 2
                assert connection.exec_driver_sql("PRAGMA journal_mode").scalar() == "wal"
                assert connection.exec_driver_sql("PRAGMA foreign_keys").scalar() == 1


def test_writes_that_fail_are_kept_in_their_order_until_they_can_be_done() -> None:
    done: list[str] = []
    full = True

    def write(what: str) -> Callable[[], None]:
        def attempt() -> None:
            if full:
                raise StorageError("disk full")
            done.append(what)

        return attempt

    writes = PendingWrites()
    assert writes.fault == ""
    writes.do(write("first"))
    assert writes.fault == "disk full"
    full = False
    writes.do(write("second"))  # not before the first
    assert done == []
    writes.retry()
    assert done == ["first", "second"]
    assert writes.fault == ""


def test_a_database_that_could_not_be_opened_is_opened_later(tmp_path: Path) -> None:
    blocker = tmp_path / "folder"
    blocker.write_text("not a folder")
    database = Database(f"sqlite:///{blocker}/cell.db", exclusive=True, deferred=True)
    with pytest.raises(StorageError):
        database.open()
    blocker.unlink()
    database.open()
    database.open()  # it is open already
    Library(database, Clock()).import_catalogue(read_catalogue(), "test")
    database.close()


def test_a_newer_schema_is_refused(database_url: str) -> None:
    with Database(database_url) as opened, opened.write() as connection:
        connection.execute(update(META).values(value="99"))
    with pytest.raises(StorageError, match="expected schema 3, found 99"):
        Database(database_url)


def test_a_locked_database_is_a_refusal_and_nothing_is_written(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path}/cell.db"
    with Database(url) as opened:
        library = Library(opened, Clock())
        library.import_catalogue(read_catalogue(), "test")
        other = sqlite3.connect(tmp_path / "cell.db", isolation_level=None)
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(StorageError, match="database is locked; nothing was written"):
            library.save_product(replace(read_catalogue().products["egg"], mass_kg=0.07), "Ada")
        other.execute("ROLLBACK")
        other.close()
        assert library.catalogue().products["egg"].version == 1


def test_an_unwritable_place_is_named(tmp_path: Path) -> None:
    blocker = tmp_path / "file"
    blocker.write_text("not a folder")
    with pytest.raises(StorageError, match="expected to be able to create it"):
        Database(f"sqlite:///{blocker}/sub/cell.db")


def test_a_read_only_database_is_named_and_nothing_is_written(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path}/cell.db"
    with Database(url) as opened:
        library = Library(opened, Clock())
        # what a read-only file system answers, for root as well; SQLAlchemy 1.4 opens a connection for each use
        event.listen(opened._engine, "connect", lambda connection, _: connection.execute("PRAGMA query_only=ON"))
        opened._engine.dispose()
        with pytest.raises(StorageError, match="attempt to write a readonly database; nothing was written"):
            library.import_catalogue(read_catalogue(), "test")


def test_postgresql_without_its_driver_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, POSTGRES_DRIVER, None)  # as where it is not installed
    with pytest.raises(StorageError, match=f"expects the module {POSTGRES_DRIVER}, found none; install it"):
        Database("postgresql://me@127.0.0.1:9/none")


def test_a_folder_in_place_of_the_database_is_named(tmp_path: Path) -> None:
    (tmp_path / "cell.db").mkdir()
    with pytest.raises(StorageError, match="unable to open database file"):
        Database(f"sqlite:///{tmp_path}/cell.db")


@pytest.mark.parametrize(
    ("url", "expected"),
    [
        ("nonsense", "expected sqlite:///path or postgresql://user@host/name, found 'nonsense'"),
        ("oracle://x", "expected sqlite or postgresql, found 'oracle'"),
        ("postgresql://me:hidden@127.0.0.1:9/none", "~/.pgpass"),
        ("postgresql://me@127.0.0.1:9/none?password=hidden", "~/.pgpass"),
        ("postgresql://nobody@127.0.0.1:9/none", "expected to be able to use it"),
    ],
)
def test_urls_that_lead_nowhere(url: str, expected: str) -> None:
    with pytest.raises(StorageError, match=expected):
        Database(url)


def test_a_file_that_is_no_database(tmp_path: Path) -> None:
    (tmp_path / "cell.db").write_bytes(b"this is not a database, it is a letter" * 100)
    with pytest.raises(StorageError, match="file is not a database"):
        Database(f"sqlite:///{tmp_path}/cell.db")


def _opens(url: str) -> bool:
    try:
        Database(url, exclusive=True).close()
    except OccupiedError:
        return False
    return True
