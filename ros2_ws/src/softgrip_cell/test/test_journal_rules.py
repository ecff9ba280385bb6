# SPDX-License-Identifier: Apache-2.0
"""What each step of a swap or a grasp leaves in the record, for slots, fingers and whoever starts after a kill."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from sqlalchemy import delete, select, update

from softgrip_cell.errors import ConflictError, OccupiedError, RefusedError, StorageError
from softgrip_cell.finger_records import FingerState
from softgrip_cell.outcomes import Tally
from softgrip_cell.storage import CellJournal, Database, HeldLock, Library, OpenOperation, SlotState
from softgrip_cell.storage.journal import SwapOutcome
from softgrip_cell.storage.schema import SLOT

SLOTS = ("index", "middle", "thumb")
POWER = ("PW-I-01", "PW-M-01", "PW-T-01")
LOCK = HeldLock("token", "confirm", "power")
UNKNOWN, UNSURE, VERIFIED = SlotState.UNKNOWN, SlotState.TO_BE_VERIFIED, SlotState.VERIFIED


@pytest.fixture
def library(database: Database) -> Library:
    return Library(database, lambda: 1)


@pytest.fixture
def journal(database: Database, library: Library) -> CellJournal:
    made = CellJournal(database, SLOTS, lambda: 1)
    made.recover()
    return made


@pytest.fixture
def verified(journal: CellJournal) -> CellJournal:
    """A hand of verified power fingers."""
    journal.begin_operation("swap", "power", "release")
    journal.read_in("close_palm", POWER)
    journal.finish_swap(
        "power", SwapOutcome.SUCCEEDED, "", 60.0, changed=True, references={serial: {"x": 1} for serial in POWER}
    )
    return journal


def hand(journal: CellJournal) -> list[tuple[str, SlotState]]:
    return [(slot.serial, slot.state) for slot in journal.slots()]


def states(library: Library, serials: tuple[str, ...] = POWER) -> set[FingerState]:
    return {library.finger_records()[serial].state for serial in serials}


def test_whoever_starts_after_a_kill_is_told_once_what_was_going_on_and_where(verified: CellJournal) -> None:
    verified.begin_operation("grasp", "egg", "close")
    assert verified.recover() == OpenOperation("grasp", "egg", "close")
    assert verified.recover() is None
    assert hand(verified) == [(serial, UNSURE) for serial in POWER]


def test_before_a_person_reaches_in_slots_and_fingers_are_unknown(verified: CellJournal, library: Library) -> None:
    verified.begin_operation("swap", "power", "release")
    verified.forget_slots("open_palm", LOCK)
    assert {state for _, state in hand(verified)} == {UNKNOWN}
    assert states(library) == {FingerState.UNKNOWN}
    assert verified.recover() == OpenOperation("swap", "power", "open_palm")


def test_what_is_taken_out_is_in_the_store_but_a_worn_finger_stays_worn(
    verified: CellJournal, library: Library
) -> None:
    verified.wear("index", "soft")
    verified.begin_operation("swap", "power", "release")
    verified.forget_slots("open_palm", LOCK)
    verified.park_fingers("insert")
    assert hand(verified) == [("", UNKNOWN)] * 3
    assert states(library, POWER[:1]) == {FingerState.WORN}
    assert states(library, POWER[1:]) == {FingerState.STORE}


def test_what_is_put_in_is_mounted_in_its_own_slot_and_not_yet_verified(journal: CellJournal, library: Library) -> None:
    journal.begin_operation("swap", "power", "release")
    journal.read_in("close_palm", POWER)
    assert hand(journal) == [(serial, UNSURE) for serial in POWER]
    assert states(library) == {FingerState.MOUNTED}


def test_only_fingers_whose_check_was_passed_are_verified(journal: CellJournal) -> None:
    journal.begin_operation("swap", "power", "release")
    journal.read_in("close_palm", POWER)
    journal.finish_swap("power", SwapOutcome.FAILED, "", 60.0, changed=True, references={POWER[1]: {"x": 1}})
    assert hand(journal) == [(POWER[0], UNSURE), (POWER[1], VERIFIED), (POWER[2], UNSURE)]
    assert journal.recover() is None, "the swap has ended"
    assert journal.counts().swaps == 0, "it is no swap that failed"


def test_a_check_alone_is_no_swap(verified: CellJournal) -> None:
    verified.finish_swap("power", SwapOutcome.SUCCEEDED, "", 20.0, changed=False, references={})
    assert (verified.counts().swaps, verified.counts().mean_swap_s) == (1, 60.0)


def test_fingers_that_the_check_refused_are_nobody_s_any_more(verified: CellJournal, library: Library) -> None:
    verified.distrust([POWER[0]], [POWER[2]])
    assert hand(verified) == [("", UNKNOWN), (POWER[1], UNKNOWN), ("", UNKNOWN)]
    assert states(library, POWER[:1]) == {FingerState.UNKNOWN}
    assert states(library, POWER[2:]) == {FingerState.WORN}


def test_a_finger_that_wears_out_takes_its_slot_s_verification_with_it(verified: CellJournal, library: Library) -> None:
    assert verified.wear("middle", "soft") == POWER[1]
    assert hand(verified)[1] == (POWER[1], UNSURE)
    assert states(library, POWER[1:2]) == {FingerState.WORN}
    verified.forget_slots("open_palm", LOCK)
    assert verified.wear("index", "whatever") == "", "nobody knows what is in there"
    assert states(library, POWER[:1]) == {FingerState.UNKNOWN}


def test_a_grasp_costs_each_mounted_finger_a_closing_and_no_other_one(verified: CellJournal, library: Library) -> None:
    before = {serial: finger_record.cycles for serial, finger_record in library.finger_records().items()}
    verified.begin_operation("grasp", "egg", "approach")
    verified.finish_grasp("egg", 1, "power", "GRIPPED", "", 2.0)
    after = {serial: finger_record.cycles for serial, finger_record in library.finger_records().items()}
    assert {serial for serial in after if after[serial] != before[serial]} == set(POWER)
    assert {after[serial] - before[serial] for serial in POWER} == {1}
    assert verified.recover() is None, "the grasp has ended"


def test_only_what_was_gripped_lost_or_missed_says_something_of_a_finger_set(verified: CellJournal) -> None:
    for outcome in ("GRIPPED", "EMPTY", "SLIPPED", "ABORTED", "TENDON_FAULT"):
        verified.finish_grasp("egg", 1, "power", outcome, "", 2.0)
    assert verified.tallies() == {("egg", "power"): Tally(1, 2)}


# --- the database --------------------------------------------------------------------------------------------------


def test_what_fails_in_the_middle_was_never_begun(database: Database, verified: CellJournal) -> None:
    def fail_half_way() -> None:
        with database.write() as connection:
            connection.execute(delete(SLOT))
            raise RuntimeError("a defect")

    with pytest.raises(RuntimeError):
        fail_half_way()
    assert hand(verified) == [(serial, VERIFIED) for serial in POWER]


def test_who_has_begun_a_change_can_end_it_though_it_only_looked_at_first(
    tmp_path: Path, verified: CellJournal
) -> None:
    """Another process that writes meanwhile has to wait, and gives up; else the first one would fail in its middle."""
    url = f"sqlite:///{tmp_path}/cell.db"
    with Database(url) as first, Database(url) as second, first.write() as connection:
        assert len(connection.execute(select(SLOT)).all()) == 3
        with pytest.raises(StorageError, match="locked"), second.write() as other:
            other.execute(delete(SLOT))
        connection.execute(update(SLOT).values(state=UNKNOWN.value))
    assert {state for _, state in hand(verified)} == {UNKNOWN}


def test_a_cell_has_one_manager_and_is_free_once_it_was_closed(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path}/one.db"
    first = Database(url, exclusive=True)
    with pytest.raises(OccupiedError):
        Database(url, exclusive=True)
    first.close()
    Database(url, exclusive=True).close()


def test_a_password_is_never_shown() -> None:
    with pytest.raises(StorageError) as refused:
        Database("postgresql://cell:secret@127.0.0.1:1/none")
    assert "secret" not in str(refused.value)


def test_an_edit_of_what_was_changed_meanwhile_is_refused_and_the_newest_is_in_force(library: Library) -> None:
    read = library.catalogue().products["egg"]
    library.save_product(replace(read, mass_kg=0.07), "one")
    with pytest.raises(ConflictError):
        library.save_product(replace(read, mass_kg=0.08), "another")
    assert library.catalogue().products["egg"].mass_kg == 0.07
    finger = library.finger_records()[POWER[0]]
    library.save_finger_record(replace(finger, state=FingerState.WORN), "one")
    with pytest.raises(ConflictError):
        library.save_finger_record(finger, "another")
    assert library.finger_records()[POWER[0]].state is FingerState.WORN
    assert [(entry.who, entry.subject) for entry in library.audit(1)] == [("one", POWER[0])]


def test_a_finger_that_nobody_knows_can_not_be_called_good(library: Library) -> None:
    with pytest.raises(RefusedError, match="found 'PW-X-99'"):
        library.set_finger_state("PW-X-99", FingerState.STORE, "a person")
