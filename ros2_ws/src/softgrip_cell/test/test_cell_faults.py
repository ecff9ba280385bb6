# SPDX-License-Identifier: Apache-2.0
"""The cell when its database cannot be written, when messages come from elsewhere, and when hands may be inside."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy

from softgrip_cell.catalogue_file import read_catalogue
from softgrip_cell.cell import Cell, CellMode, Clocks
from softgrip_cell.errors import RefusedError, StorageError
from softgrip_cell.finger_records import read_finger_records
from softgrip_cell.gates import DriverFacts, FrictionFacts, FrictionLimits, SafetyFacts
from softgrip_cell.grasp.reference import FreeReference
from softgrip_cell.grasp.values import GraspOutcome, GraspTask, GraspVerdict
from softgrip_cell.observation import TendonSample
from softgrip_cell.storage import CellJournal, Database, HeldLock, Library, SlotState
from softgrip_cell.storage.journal import SwapOutcome
from softgrip_cell.swap.sequence import SwapSequence

SLOTS = ("index", "middle", "thumb")
POWER = ("PW-I-01", "PW-M-01", "PW-T-01")
FREE = FreeReference((0.0, 0.02), (0.0, 0.0), (0.0, 15.0), 0.05, "model", "d1")
LOCK = HeldLock("token of the driver", "token of the swap", "pinch")
OPEN, CLOSED = (0.0, 0.0005, 0.001), (0.012, 0.0, 0.011)
OPEN_M = 0.003


class Disk:
    """A database that can be full."""

    def __init__(self, folder: Path) -> None:
        self.url = f"sqlite:///{folder}/cell.db"
        self.database = Database(self.url)
        self._is_full = False
        # not once for a connection: SQLAlchemy 1.4 opens a new one for each transaction on a file
        sqlalchemy.event.listen(self.database._engine, "checkout", self._on_checkout)
        library = Library(self.database, lambda: 1)
        library.import_catalogue(read_catalogue(), "test")
        library.import_finger_records(read_finger_records().values(), "test")

    def _on_checkout(self, connection: Any, *_: object) -> None:
        connection.execute(f"PRAGMA query_only={'ON' if self._is_full else 'OFF'}")

    def set_full(self, full: bool) -> None:
        """Have SQLite refuse every write, as on a file system that is read-only."""
        self._is_full = full

    def journal(self) -> CellJournal:
        return CellJournal(self.database, SLOTS, lambda: 1)

    def cell(self) -> Cell:
        """A cell as after a start, with driver and friction as they should be."""
        limits, clocks = FrictionLimits(age_s=1e6, range_factor=5.0), Clocks(lambda: 1, lambda: 0.0)
        cell = Cell(Library(self.database, lambda: 1), self.journal(), 2, limits, clocks)
        cell.update_driver(DriverFacts(is_heard=True, estop=False))
        cell.update_safety(SafetyFacts(is_heard=True))
        cell.update_friction(lambda: FrictionFacts("model", "d1", 1.0, 10.0, is_usable=True, reason=""))
        return cell

    def ready_cell(self) -> Cell:
        """A cell with verified power fingers."""
        cell, journal = self.cell(), self.journal()
        journal.begin_operation("swap", "power", "insert")
        journal.read_in("close_palm", POWER)
        references = dict.fromkeys(POWER, FREE.document())
        journal.finish_swap("power", SwapOutcome.SUCCEEDED, "good", 1.0, changed=True, references=references)
        cell._slots = journal.slots()
        return cell


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Disk]:
    made = Disk(tmp_path)
    yield made
    made.database.close()


def sample(pulled_length_m: tuple[float, ...]) -> TendonSample:
    return TendonSample(1, pulled_length_m, (0.0, 0.0, 0.0))


def holding(cell: Cell) -> GraspTask:
    task = cell.begin_grasp("egg", confirm_lift=True, trial=False)
    cell.end_grasp(task, GraspVerdict(GraspOutcome.GRIPPED, "held", 0.0), 1.0)
    return task


def test_a_grasp_that_cannot_be_written_down_is_a_fault_and_is_written_later(disk: Disk) -> None:
    cell = disk.ready_cell()
    task = cell.begin_grasp("egg", confirm_lift=True, trial=False)
    disk.set_full(True)
    cell.end_grasp(task, GraspVerdict(GraspOutcome.GRIPPED, "held", 0.0), 1.0)
    assert cell.mode is CellMode.FAULT
    assert "readonly database" in cell.state()["fault"]
    assert cell.may_hold, "what is held is still held"
    cell.retry_writes()
    assert cell.mode is CellMode.FAULT
    disk.set_full(False)
    cell.retry_writes()
    assert cell.mode is CellMode.HOLDING
    assert cell.state()["gripped"] == 1
    assert disk.journal().counts().outcomes == {"GRIPPED": 1}


def test_nothing_begins_that_cannot_be_written_down(disk: Disk) -> None:
    cell = disk.ready_cell()
    disk.set_full(True)
    with pytest.raises(StorageError):
        cell.begin_grasp("egg", confirm_lift=True, trial=False)
    assert cell.mode is CellMode.FAULT
    for begin in (
        lambda: cell.begin_grasp("egg", confirm_lift=True, trial=False),
        lambda: cell.begin_swap("power", ()),
    ):
        with pytest.raises(RefusedError, match="could not be written down"):
            begin()
    disk.set_full(False)
    cell.retry_writes()
    assert cell.mode is CellMode.IDLE
    assert disk.journal().counts().outcomes == {}


def test_a_cell_starts_at_fault_where_the_database_cannot_be_written(disk: Disk) -> None:
    journal = disk.journal()
    journal.recover()
    journal.begin_operation("grasp", "egg", "power")
    disk.set_full(True)
    cell = disk.cell()
    assert cell.mode is CellMode.FAULT
    assert [slot.state for slot in cell.slots()] == [SlotState.UNKNOWN] * 3
    disk.set_full(False)
    cell.retry_writes()
    assert cell.mode is CellMode.UNKNOWN
    assert cell.state()["product"] == "egg"
    assert "call tendon/release" in cell.state()["reason"]


def test_wear_that_cannot_be_written_down_counts_at_once_and_is_written_later(disk: Disk) -> None:
    cell = disk.ready_cell()
    disk.set_full(True)
    for _ in range(5):
        cell.observe_residual("index", worn=True, reason="stiffness down")
    assert cell.mode is CellMode.FAULT
    disk.set_full(False)
    cell.retry_writes()
    with pytest.raises(RefusedError, match="PW-I-01 is worn"):
        cell.begin_grasp("egg", confirm_lift=True, trial=False)


@pytest.mark.parametrize("stray", [1, 9])
def test_some_samples_with_zeros_do_not_end_a_hold(disk: Disk, stray: int) -> None:
    cell = disk.ready_cell()
    holding(cell)
    for _ in range(50):
        for _ in range(stray):
            cell.observe_sample(sample(OPEN), OPEN_M)
        cell.observe_sample(sample(CLOSED), OPEN_M)
    assert cell.mode is CellMode.HOLDING


def test_samples_in_a_row_with_open_fingers_end_a_hold(disk: Disk) -> None:
    cell = disk.ready_cell()
    holding(cell)
    for _ in range(10):
        assert cell.mode is CellMode.HOLDING
        cell.observe_sample(sample(OPEN), OPEN_M)
    assert cell.mode is CellMode.IDLE


def swapping(cell: Cell) -> SwapSequence:
    """A swap whose drives are locked, with hands inside."""
    sequence = cell.begin_swap("pinch", ())
    cell.persist(sequence.released())
    cell.keep_lock(sequence.locked(), LOCK)
    return sequence


def test_a_swap_that_ends_while_the_drives_are_locked_refuses_everything_until_hands_are_out(disk: Disk) -> None:
    cell = disk.ready_cell()
    sequence = swapping(cell)
    cell.end_swap(sequence, SwapOutcome.CANCELLED, "take your hands out", 1.0, {})
    assert (cell.mode, cell.lock) == (CellMode.SWAPPING, LOCK)
    for begin in (
        lambda: cell.begin_grasp("egg", confirm_lift=True, trial=False),
        lambda: cell.begin_swap("power", ()),
    ):
        with pytest.raises(RefusedError, match="take your hands out"):
            begin()
    cell.drop_lock("hands are out")
    assert cell.mode is CellMode.IDLE
    cell.begin_swap("power", ())


def test_a_restart_knows_the_lock_and_waits_for_the_person(disk: Disk) -> None:
    swapping(disk.ready_cell())
    cell = disk.cell()
    assert (cell.mode, cell.lock) == (CellMode.SWAPPING, LOCK)
    assert "confirm step 'hands_out'" in cell.state()["reason"]
    cell.drop_lock("hands are out")
    assert disk.cell().mode is CellMode.IDLE


def test_a_lock_that_cannot_be_written_down_is_not_taken(disk: Disk) -> None:
    cell = disk.ready_cell()
    sequence = cell.begin_swap("pinch", ())
    cell.persist(sequence.released())
    disk.set_full(True)
    with pytest.raises(StorageError):
        cell.keep_lock(sequence.locked(), LOCK)
    assert cell.lock is None
    disk.set_full(False)
    assert disk.journal().lock() is None


def test_the_owner_of_a_foreign_lock_is_named_in_the_state(disk: Disk) -> None:
    cell = disk.cell()
    cell.update_safety(SafetyFacts(is_heard=True, locked=True, lock_owner="Ada", lock_reason="cleaning"))
    assert "the drives are locked by 'Ada': cleaning" in cell.state()["reason"]


def test_an_emergency_stop_is_the_mode_whoever_tells_of_it(disk: Disk) -> None:
    cell = disk.cell()
    cell.update_safety(SafetyFacts(is_heard=True, estop=True))
    assert cell.mode is CellMode.ESTOP
    cell.update_safety(SafetyFacts(is_heard=True))
    assert cell.mode is CellMode.IDLE
