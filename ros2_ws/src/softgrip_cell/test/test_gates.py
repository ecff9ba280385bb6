# SPDX-License-Identifier: Apache-2.0
"""Who may grasp with what: worn fingers are refused for good, and without a lift only what is known to hold."""

from __future__ import annotations

import pytest

from softgrip_cell.catalogue_file import read_catalogue
from softgrip_cell.cell import Cell, CellMode, Clocks
from softgrip_cell.errors import RefusedError
from softgrip_cell.finger_records import FingerState, read_finger_records
from softgrip_cell.gates import DriverFacts, FrictionFacts, FrictionLimits, SafetyFacts, carried_kg
from softgrip_cell.grasp.reference import FreeReference
from softgrip_cell.storage import CellJournal, Database, Library
from softgrip_cell.storage.journal import SwapOutcome

SLOTS = ("index", "middle", "thumb")
POWER = ("PW-I-01", "PW-M-01", "PW-T-01")
FREE = FreeReference((0.0, 0.02), (0.0, 0.0), (0.0, 15.0), 0.05, "model", "d1")


def start(database: Database, *, verified: bool = True) -> Cell:
    """A cell with verified power fingers, its driver and friction as they should be."""
    journal = CellJournal(database, SLOTS, lambda: 1)
    limits = FrictionLimits(age_s=1e6, range_factor=5.0)
    cell = Cell(Library(database, lambda: 1), journal, 2, limits, Clocks(lambda: 1, lambda: 0.0))
    if verified:
        journal.begin_operation("swap", "power", "insert")
        journal.read_in("close_palm", POWER)
        references = dict.fromkeys(POWER, FREE.document())
        journal.finish_swap("power", SwapOutcome.SUCCEEDED, "good", 1.0, changed=True, references=references)
        cell = Cell(Library(database, lambda: 1), journal, 2, limits, Clocks(lambda: 1, lambda: 0.0))
        journal.finish_swap("power", SwapOutcome.SUCCEEDED, "good", 1.0, changed=False, references=references)
        cell._slots = journal.slots()
    cell.update_driver(DriverFacts(is_heard=True, estop=False))
    cell.update_safety(SafetyFacts(is_heard=True))
    cell.update_friction(lambda: FrictionFacts("model", "d1", 1.0, 10.0, is_usable=True, reason=""))
    return cell


def call_worn(cell: Cell, slot: str, reason: str) -> None:
    """So many residuals that it is believed."""
    for _ in range(5):
        cell.observe_residual(slot, worn=True, reason=reason)


def test_a_single_outburst_of_residuals_writes_nothing(database: Database) -> None:
    cell = start(database)
    for _ in range(3):
        for _ in range(4):
            cell.observe_residual("index", worn=True, reason="spoofed")
        cell.observe_residual("index", worn=False, reason="")
    assert Library(database, lambda: 1).finger_records()["PW-I-01"].state is FingerState.MOUNTED


def test_a_worn_finger_is_marked_and_refused_with_the_reason_of_its_residual(database: Database) -> None:
    cell = start(database)
    call_worn(cell, "index", "stiffness down by 31 %")
    assert Library(database, lambda: 1).finger_records()["PW-I-01"].state is FingerState.WORN
    with pytest.raises(RefusedError, match=r"slot index: finger PW-I-01 is worn.*stiffness down by 31 %"):
        cell.begin_grasp("egg", confirm_lift=True, trial=False)
    assert cell.mode is CellMode.IDLE
    audited = next(entry for entry in Library(database, lambda: 1).audit() if entry.action == "worn")
    assert (audited.subject, audited.detail["slot"]) == ("PW-I-01", "index")
    # Neither a restart nor another verdict of the same kind changes that.
    call_worn(cell, "index", "again")
    again = start(database, verified=False)
    with pytest.raises(RefusedError, match="finger PW-I-01 is worn"):
        again.begin_grasp("egg", confirm_lift=True, trial=False)


def test_the_next_swap_takes_another_finger_than_the_worn_one(database: Database) -> None:
    cell = start(database)
    call_worn(cell, "index", "friction up by 60 %")
    spare = {serial for serial, p in read_finger_records().items() if p.profile == "power" and p.finger == "index"} - {
        "PW-I-01"
    }
    if spare:
        sequence = cell.begin_swap("power", ())
        assert not sequence.only_check
        assert sequence._proposed[0] in spare
    else:
        with pytest.raises(RefusedError, match="no usable index finger"):
            cell.begin_swap("power", ())


def test_wear_of_a_slot_that_nobody_knows_writes_nothing(database: Database) -> None:
    cell = start(database, verified=False)
    before = Library(database, lambda: 1).finger_records()
    call_worn(cell, "index", "whatever")
    call_worn(cell, "toe", "whatever")
    assert Library(database, lambda: 1).finger_records() == before


def test_without_a_lift_only_what_is_known_to_hold_is_grasped(database: Database) -> None:
    cell = start(database)
    with pytest.raises(RefusedError, match=r"'power' is not known to hold 'cheese_slice'.*partial.*confirm_lift"):
        cell.begin_grasp("cheese_slice", confirm_lift=False, trial=False)
    with pytest.raises(RefusedError, match="only a lift can tell"):
        cell.begin_grasp("grape", confirm_lift=False, trial=True)
    assert cell.begin_grasp("egg", confirm_lift=False, trial=False).product.id == "egg"


def test_what_friction_alone_does_not_carry_is_lifted_before_it_counts_as_held(database: Database) -> None:
    """Power on a tomato vine: 3 fingers x 9 N x 0.8 / 4.5 = 4.8 N, of which 0.5 carry 2.4 N or, shaken, 0.21 kg."""
    vine = read_catalogue().products["tomato_vine"]
    assert carried_kg(vine, "power") == pytest.approx(2.4 / (1.15 * 9.81), rel=1e-9)
    cell = start(database)
    with pytest.raises(RefusedError, match=r"weighs 0.45 kg.*friction carries 0.21 kg; only a lift can tell"):
        cell.begin_grasp("tomato_vine", confirm_lift=False, trial=False)
    assert cell.begin_grasp("tomato_vine", confirm_lift=True, trial=False).product.id == "tomato_vine"


@pytest.mark.parametrize(
    ("safety", "expected"),
    [
        (SafetyFacts(is_heard=False), "expected safety/state, found none"),
        (SafetyFacts(is_heard=True, estop=True, estop_reason="button"), r"emergency stop is latched \(button\)"),
        (
            SafetyFacts(is_heard=True, locked=True, lock_owner="Ada", lock_reason="cleaning"),
            "the drives are locked by 'Ada': cleaning",
        ),
    ],
)
def test_nothing_begins_while_the_cell_must_not_move(database: Database, safety: SafetyFacts, expected: str) -> None:
    cell = start(database)
    cell.update_safety(safety)
    with pytest.raises(RefusedError, match=expected):
        cell.begin_grasp("egg", confirm_lift=True, trial=False)
    with pytest.raises(RefusedError, match=expected):
        cell.begin_swap("power", ())
    assert CellJournal(database, SLOTS, lambda: 1).recover() is None, "nothing began"


def test_fingers_checked_with_a_model_of_the_same_name_but_other_numbers_are_checked_again(database: Database) -> None:
    cell = start(database)
    cell.update_friction(lambda: FrictionFacts("model", "d2", 1.0, 10.0, is_usable=True, reason=""))
    expected = r"checked with friction model 'model' with digest d1, active is friction model 'model' with digest d2"
    with pytest.raises(RefusedError, match=expected):
        cell.begin_grasp("egg", confirm_lift=True, trial=False)


def test_a_model_that_is_not_to_be_used_is_refused_with_its_reason(database: Database) -> None:
    cell = start(database)
    cell.update_friction(lambda: FrictionFacts("model", "d1", 1.0, 10.0, is_usable=False, reason="no verdict"))
    with pytest.raises(RefusedError, match="'model' is not to be used: no verdict"):
        cell.begin_grasp("egg", confirm_lift=True, trial=False)


def test_a_closing_beyond_the_trusted_tension_is_refused(database: Database) -> None:
    cell = start(database)
    cell.update_friction(lambda: FrictionFacts("model", "d1", 1.0, 1.0, is_usable=True, reason=""))
    with pytest.raises(RefusedError, match=r"is trusted up to 5\.0 N"):
        cell.begin_grasp("egg", confirm_lift=True, trial=False)
