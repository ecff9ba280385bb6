# SPDX-License-Identifier: Apache-2.0
"""What the cell refuses, remembers and shows: every gate is closed once on its own, with all others open."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from datetime import date

import pytest
from sqlalchemy import update

from softgrip_cell import gates
from softgrip_cell.catalogue_file import read_catalogue
from softgrip_cell.cell import Cell, CellMode, Clocks
from softgrip_cell.errors import RefusedError
from softgrip_cell.finger_records import FingerRecord, FingerState, read_finger_records
from softgrip_cell.gates import DriverFacts, FrictionFacts, FrictionLimits, SafetyFacts
from softgrip_cell.grasp.reference import FreeReference
from softgrip_cell.grasp.values import GraspEvidence, GraspOutcome, GraspPhase, GraspVerdict
from softgrip_cell.observation import FreeMotion, ObservedPair, TendonSample
from softgrip_cell.products import TableMark
from softgrip_cell.storage import CellJournal, Database, Library, MountedSlot, SlotState
from softgrip_cell.storage.journal import SwapOutcome
from softgrip_cell.storage.schema import FINGER_RECORD
from softgrip_cell.swap.check import CheckSettings, EmptyClosing, Finding, FingerCheck
from softgrip_cell.swap.sequence import SwapSequence, SwapStep

SLOTS = ("index", "middle", "thumb")
POWER = ("PW-I-01", "PW-M-01", "PW-T-01")
PINCH = ("PI-I-01", "PI-M-01", "PI-T-01")
FREE = FreeReference((0.0, 0.02), (0.0, 0.0), (0.0, 15.0), 0.05, "model", "d1")
FRICTION = FrictionFacts("model", "d1", 1.0, 10.0, is_usable=True, reason="")
LIMITS = FrictionLimits(age_s=1000.0, range_factor=5.0)
WELL = DriverFacts(is_heard=True, estop=False)


def start(database: Database) -> Cell:
    """A manager's start; the driver is well, the friction model new."""
    cell = Cell(
        Library(database, lambda: 1), CellJournal(database, SLOTS, lambda: 1), 2, LIMITS, Clocks(lambda: 1, float)
    )
    cell.update_driver(WELL)
    cell.update_safety(SafetyFacts(is_heard=True))
    cell.update_friction(lambda: FRICTION)
    return cell


def swap_in(cell: Cell, serials: tuple[str, ...], finger_set: str = "power") -> None:
    """A whole swap whose check is passed."""
    good = {name: FingerCheck(name, Finding.GOOD, "", 1.0, math.nan, FREE) for name in SLOTS}
    sequence = cell.begin_swap(finger_set, serials)
    if not sequence.only_check:
        sequence.released()
        sequence.locked()
        for step, given in (("open_palm", ()), ("remove", ()), ("insert", serials)):
            cell.persist(sequence.confirm(step, given))
    cell.end_swap(sequence, SwapOutcome.SUCCEEDED, "good", 60.0, good)


@pytest.fixture
def cell(database: Database) -> Cell:
    """A cell that may grasp: verified power fingers."""
    made = start(database)
    swap_in(made, POWER)
    return made


def grasp(cell: Cell, product: str = "egg", **options: bool):  # type: ignore[no-untyped-def]
    return cell.begin_grasp(product, **{"confirm_lift": True, "trial": False, **options})


def operation(database: Database):  # type: ignore[no-untyped-def]
    """What a start after a kill now would find to have been going on."""
    return CellJournal(database, SLOTS, lambda: 1).recover()


def test_with_every_gate_open_it_grasps(cell: Cell) -> None:
    task = grasp(cell)
    assert (task.product.id, task.slots, task.references) == ("egg", SLOTS, (FREE,) * 3)
    assert cell.mode is CellMode.GRASPING


# --- the driver ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("driver", "expected"),
    [
        (replace(WELL, estop=True), "emergency stop is latched"),
        (replace(WELL, is_heard=False), "expected tendon/state and tendon/status, found silence"),
        (replace(WELL, faults=("tendon index: tendon_broken",)), "the driver has a fault: tendon index: tendon_broken"),
    ],
    ids=["stopped", "silent", "at fault"],
)
def test_neither_grasp_nor_swap_begins_with_a_driver_that_is_not_well(
    cell: Cell, database: Database, driver: DriverFacts, expected: str
) -> None:
    cell.update_driver(driver)
    with pytest.raises(RefusedError, match=expected):
        grasp(cell)
    with pytest.raises(RefusedError, match=expected):
        cell.begin_swap("power", ())
    assert operation(database) is None


def test_a_hand_without_a_zero_may_be_swapped_but_not_grasp(cell: Cell) -> None:
    cell.update_driver(replace(WELL, unhomed=("index", "thumb")))
    with pytest.raises(RefusedError, match="tendons index, thumb are not homed"):
        grasp(cell)
    assert cell.begin_swap("power", ()).step is SwapStep.RELEASE


@pytest.mark.parametrize(
    ("driver", "mode"),
    [
        (replace(WELL, estop=True, faults=("x",)), CellMode.ESTOP),
        (replace(WELL, faults=("x",)), CellMode.FAULT),
        (replace(WELL, is_heard=False), CellMode.UNKNOWN),
        (WELL, CellMode.IDLE),
    ],
)
def test_the_mode_shows_the_worst_of_the_driver(cell: Cell, driver: DriverFacts, mode: CellMode) -> None:
    cell.update_driver(driver)
    assert cell.mode is mode


# --- one thing at a time, and written down -------------------------------------------------------------------------


def test_while_it_grasps_nothing_else_begins_though_its_fingers_are_open(cell: Cell, database: Database) -> None:
    grasp(cell)
    for stamp in range(100):
        cell.observe_sample(TendonSample(stamp, (0.0,) * 3, (0.0,) * 3), 0.0015)
    for begin in (lambda: grasp(cell), lambda: cell.begin_swap("pinch", ())):
        with pytest.raises(RefusedError, match="the cell is grasping"):
            begin()
    cut = operation(database)
    assert (cut.kind, cut.subject) == ("grasp", "egg")


def test_while_it_swaps_nothing_else_begins_though_its_fingers_are_open(cell: Cell, database: Database) -> None:
    cell.begin_swap("pinch", ())
    for stamp in range(100):
        cell.observe_sample(TendonSample(stamp, (0.0,) * 3, (0.0,) * 3), 0.0015)
    for begin in (lambda: grasp(cell), lambda: cell.begin_swap("pinch", ())):
        with pytest.raises(RefusedError, match="the cell is swapping"):
            begin()
    cut = operation(database)
    assert (cut.kind, cut.subject, cut.step) == ("swap", "pinch", "release")


@pytest.mark.parametrize("outcome", list(GraspOutcome))
def test_only_what_was_gripped_is_held_and_what_is_held_is_not_let_fall(cell: Cell, outcome: GraspOutcome) -> None:
    cell.end_grasp(grasp(cell), GraspVerdict(outcome, "", 0.0), 1.0)
    if outcome is not GraspOutcome.GRIPPED:
        assert cell.mode is CellMode.IDLE
        return
    assert cell.mode is CellMode.HOLDING
    for begin in (lambda: grasp(cell), lambda: cell.begin_swap("pinch", ())):
        with pytest.raises(RefusedError, match="'egg' is held; call tendon/release"):
            begin()


def test_a_counted_grasp_names_the_fingers_that_made_it(cell: Cell, database: Database) -> None:
    evidence = GraspEvidence(GraspPhase.CLOSE, 7)
    cell.end_grasp(grasp(cell), GraspVerdict(GraspOutcome.EMPTY, "", 0.0, evidence), 1.0)
    (found,) = CellJournal(database, ("index", "middle", "thumb"), lambda: 0).grasps(1)
    assert found.serials == tuple(slot.serial for slot in cell.slots())
    assert all(found.serials)
    assert found.evidence == evidence


@pytest.mark.parametrize("closed", range(3))
def test_a_product_is_held_while_one_finger_is_closed(cell: Cell, closed: int) -> None:
    cell.end_grasp(grasp(cell), GraspVerdict(GraspOutcome.GRIPPED, "", 0.0), 1.0)
    pulled = tuple(0.008 if slot == closed else 0.0 for slot in range(3))
    for stamp in range(100):
        cell.observe_sample(TendonSample(stamp, pulled, (0.0,) * 3), 0.0015)
    assert cell.mode is CellMode.HOLDING


def test_after_a_kill_in_a_grasp_nobody_opens_the_hand_unasked(cell: Cell, database: Database) -> None:
    grasp(cell)
    again = start(database)
    assert again.mode is CellMode.UNKNOWN
    for begin in (lambda: grasp(again), lambda: again.begin_swap("pinch", ())):
        with pytest.raises(RefusedError, match=r"restarted during grasp 'egg'.*a product may be held"):
            begin()


# --- friction ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("facts", "expected"),
    [
        (None, "no friction model is active"),
        (replace(FRICTION, is_usable=False, reason="spread"), "'model' is not to be used: spread"),
        (replace(FRICTION, age_s=1000.1), "is 0.0 days old, the limit is"),
        (replace(FRICTION, digest="d2"), "checked with friction model 'model' with digest d1"),
        (replace(FRICTION, tension_high_n=1.0), r"is trusted up to 5\.0 N"),
    ],
    ids=["none", "not usable", "too old", "not that of the check", "of too light weights"],
)
def test_a_friction_model_that_can_not_be_trusted_grips_nothing(
    cell: Cell, facts: FrictionFacts | None, expected: str
) -> None:
    cell.update_friction(lambda: facts)
    with pytest.raises(RefusedError, match=expected):
        grasp(cell)
    assert cell.mode is CellMode.IDLE


@pytest.mark.parametrize(("pull_m", "fits"), [(0.0133, True), (0.0134, False)])
def test_a_closing_may_need_five_times_the_calibrated_tension(pull_m: float, fits: bool) -> None:
    """750 N/m by the reference, 2 N calibrated: 10 N are there at 13.33 mm."""
    facts = replace(FRICTION, tension_high_n=2.0)
    if fits:
        gates.check_friction(facts, LIMITS, [FREE], pull_m)
        return
    with pytest.raises(RefusedError, match="calibrate with a heavier weight"):
        gates.check_friction(facts, LIMITS, [FREE], pull_m)


# --- fingers -------------------------------------------------------------------------------------------------------


def slots(states: tuple[SlotState, ...], profiles: tuple[str, ...] = ("power",) * 3) -> tuple[MountedSlot, ...]:
    return tuple(MountedSlot(*row) for row in zip(SLOTS, states, POWER, profiles, strict=True))


VERIFIED = (SlotState.VERIFIED,) * 3


@pytest.mark.parametrize("position", range(3))
def test_a_hand_is_a_set_only_when_every_slot_is_known_to_have_it(position: int) -> None:
    sets = list(read_catalogue().finger_sets.values())
    assert gates.mounted_set(slots(VERIFIED), sets) is read_set(sets, "power")
    unknown = tuple(SlotState.UNKNOWN if slot == position else SlotState.VERIFIED for slot in range(3))
    assert gates.mounted_set(slots(unknown), sets) is None
    other = tuple("pinch" if slot == position else "power" for slot in range(3))
    assert gates.mounted_set(slots(VERIFIED, other), sets) is None


def read_set(sets, name: str):  # type: ignore[no-untyped-def]
    return next(one for one in sets if one.id == name)


@pytest.mark.parametrize("state", [SlotState.UNKNOWN, SlotState.TO_BE_VERIFIED])
@pytest.mark.parametrize("position", range(3))
def test_fingers_that_were_not_checked_grasp_nothing(state: SlotState, position: int) -> None:
    catalogue = read_catalogue()
    states = tuple(state if slot == position else SlotState.VERIFIED for slot in range(3))
    with pytest.raises(RefusedError, match=rf"slot {SLOTS[position]} is {state.value}; run cell/swap"):
        gates.check_fingers(
            slots(states), catalogue.finger_sets["power"], catalogue.products["egg"], TableMark.SUCCESS,
            trial=True, confirm_lift=True,
        )  # fmt: skip


def test_a_mixed_hand_is_refused_with_what_is_in_it() -> None:
    mixed = slots(VERIFIED, ("power", "pinch", "power"))
    with pytest.raises(RefusedError, match="found index power, middle pinch, thumb power"):
        gates.check_fingers(
            mixed, None, read_catalogue().products["egg"], TableMark.SUCCESS, trial=True, confirm_lift=True
        )


def test_what_a_set_is_known_to_drop_is_grasped_as_a_trial_only(database: Database) -> None:
    """Table 4.2 says that pinch fails on the watermelon-sized products that power holds; any failure will do."""
    catalogue = read_catalogue()
    dropped = next(p.id for p in catalogue.products.values() if p.marks.get("power") is TableMark.FAILURE)
    cell = start(database)
    swap_in(cell, POWER)
    with pytest.raises(RefusedError, match=f"'power' does not hold '{dropped}'"):
        grasp(cell, dropped)
    assert grasp(cell, dropped, trial=True).product.id == dropped


def test_a_finger_that_was_never_checked_is_refused_by_name(cell: Cell, database: Database) -> None:
    library = Library(database, lambda: 1)
    with database.write() as connection:
        connection.execute(update(FINGER_RECORD).where(FINGER_RECORD.c.serial == "PW-M-01").values(reference=None))
    assert library.finger_records()["PW-M-01"].state is FingerState.MOUNTED
    with pytest.raises(RefusedError, match="slot middle: the free motion was never checked"):
        grasp(cell)


@pytest.mark.parametrize("serial", POWER)
def test_a_finger_that_a_person_calls_worn_grasps_nothing_any_more(cell: Cell, database: Database, serial: str) -> None:
    Library(database, lambda: 1).set_finger_state(serial, FingerState.WORN, "a person")
    with pytest.raises(RefusedError, match=f"finger {serial} is worn"):
        grasp(cell)


PRINTED = FingerRecord("S", "power", "index", date(2026, 1, 1), "TPU", "PE", cycle_limit=100)


@pytest.mark.parametrize(
    ("finger_record", "usable", "spent"),
    [
        (PRINTED, True, False),
        (replace(PRINTED, state=FingerState.WORN), False, True),
        (replace(PRINTED, state=FingerState.RETIRED), False, True),
        (replace(PRINTED, state=FingerState.UNKNOWN), False, False),
        (replace(PRINTED, cycles=99), True, False),
        (replace(PRINTED, cycles=100), False, True),
    ],
    ids=["new", "worn", "retired", "unknown", "one closing left", "none left"],
)
def test_a_finger_is_usable_until_it_is_worn_retired_lost_or_spent(
    finger_record: FingerRecord, usable: bool, spent: bool
) -> None:
    assert (finger_record.objection() is None, finger_record.is_spent) == (usable, spent)
    if finger_record.state is FingerState.UNKNOWN:
        assert f"library finger {finger_record.serial} store" in (finger_record.objection() or "")


def test_a_residual_of_a_swap_condemns_no_finger(cell: Cell, database: Database) -> None:
    cell.begin_swap("pinch", ())
    for _ in range(20):
        cell.observe_residual("index", worn=True, reason="the tendon is slack")
    assert Library(database, lambda: 1).finger_records()["PW-I-01"].state is FingerState.MOUNTED


# --- what came of a swap -------------------------------------------------------------------------------------------


def checks(**findings: Finding) -> dict[str, FingerCheck]:
    given = {"index": Finding.GOOD, "middle": Finding.GOOD, "thumb": Finding.GOOD, **findings}
    return {name: FingerCheck(name, finding, "", 1.0, math.nan, FREE) for name, finding in given.items()}


def test_a_swap_that_failed_verifies_nothing_and_distrusts_what_the_check_refused(
    cell: Cell, database: Database
) -> None:
    sequence = cell.begin_swap("power", ())
    assert sequence.only_check
    cell.end_swap(sequence, SwapOutcome.FAILED, "", 60.0, checks(index=Finding.OFF, thumb=Finding.WORN))
    assert {slot.state for slot in cell.slots()} == {SlotState.UNKNOWN}
    states = {serial: Library(database, lambda: 1).finger_records()[serial].state for serial in POWER}
    assert states["PW-I-01"] is FingerState.UNKNOWN
    assert states["PW-T-01"] is FingerState.WORN


def test_a_swap_whose_check_saw_nothing_condemns_nobody_and_verifies_nobody(cell: Cell, database: Database) -> None:
    sequence = start(database).begin_swap("power", ())
    again = start(database)
    again.end_swap(sequence, SwapOutcome.FAILED, "", 60.0, checks(index=Finding.UNSEEN))
    assert SlotState.VERIFIED not in {slot.state for slot in again.slots()}
    assert FingerState.WORN not in {Library(database, lambda: 1).finger_records()[serial].state for serial in POWER}


def hand(state: SlotState = SlotState.UNKNOWN) -> tuple[MountedSlot, ...]:
    return tuple(MountedSlot(name, state) for name in SLOTS)


def swap() -> SwapSequence:
    return SwapSequence(read_catalogue().finger_sets["pinch"], hand(), read_finger_records())


def at_step(step: SwapStep) -> SwapSequence:
    """A swap that waits at a step."""
    sequence = swap()
    way = [
        sequence.released, sequence.locked, lambda: sequence.confirm("open_palm"), lambda: sequence.confirm("remove"),
        lambda: sequence.confirm("insert", PINCH), lambda: sequence.confirm("close_palm"), sequence.unlocked,
        sequence.homed,
    ]  # fmt: skip
    for advance in way:
        if sequence.step is step:
            return sequence
        advance()
    return sequence


@pytest.mark.parametrize("step", [one for one in SwapStep if one is not SwapStep.DONE])
def test_an_answer_that_belongs_to_another_step_moves_no_swap(step: SwapStep) -> None:
    """An answer of the driver that comes late, or a confirmation of somebody who looks at another page."""
    answers = {
        SwapStep.RELEASE: "released", SwapStep.LOCK: "locked", SwapStep.UNLOCK: "unlocked", SwapStep.HOME: "homed",
    }  # fmt: skip
    sequence = at_step(step)
    assert sequence.step is step
    for belongs, answer in answers.items():
        if belongs is not step:
            with pytest.raises(RefusedError):
                getattr(sequence, answer)()
    for confirmed in SwapStep:
        if confirmed is not step or step in answers or step is SwapStep.VERIFY:
            with pytest.raises(RefusedError):
                sequence.confirm(confirmed.value, PINCH)
    assert sequence.step is step


# --- the check, at its limits --------------------------------------------------------------------------------------


def judge_closing(
    gain: float, lengths_m: Sequence[float], objection: str = "", earlier: FreeReference | None = None
) -> FingerCheck:
    """Close one finger along these pulled lengths: predicted 0.8 N/mm, measured ``gain`` times that."""
    check = EmptyClosing(("index",), CheckSettings(), {"index": earlier} if earlier else None)
    for stamp, pulled in enumerate(lengths_m, start=1):
        free = FreeMotion(
            stamp, (pulled,), (800.0 * pulled,), ((0.0, 0.0),), "model", objection=objection, objections=("",)
        )
        check.observe(ObservedPair(TendonSample(stamp, (pulled,), (gain * 800.0 * pulled,)), free))
    return check.judge()["index"]


WHOLE = [0.016 * (i + 1) / 200 for i in range(200)]


@pytest.mark.parametrize(("gain", "finding"), [(0.80, Finding.WORN), (0.9, Finding.GOOD), (1.2, Finding.WORN)])
def test_a_finger_that_became_softer_or_stiffer_is_worn(gain: float, finding: Finding) -> None:
    before = judge_closing(1.0, WHOLE).reference
    assert before is not None
    assert judge_closing(gain, WHOLE, earlier=before).finding is finding


@pytest.mark.parametrize(("places", "finding"), [(6, Finding.UNSEEN), (7, Finding.GOOD)])
def test_fewer_than_twenty_samples_prove_nothing(places: int, finding: Finding) -> None:
    """Three samples at each place from 4 mm on: 18 are too few, 21 are enough."""
    lengths = [0.004 + 0.0015 * place + 1e-5 * i for place in range(places - 1) for i in range(3)]
    lengths += [0.0145 + 1e-5 * i for i in range(3)]
    assert judge_closing(1.0, lengths).finding is finding


def test_a_prediction_that_says_not_to_be_trusted_proves_nothing() -> None:
    found = judge_closing(1.0, WHOLE, objection="no friction model")
    assert found.finding is Finding.UNSEEN
    assert "cannot be predicted: no friction model" in found.reason


def test_samples_that_come_twice_count_once() -> None:
    """Ten samples, each ten times, are ten; eight of them lie beyond 4 mm."""
    check = EmptyClosing(("index",), CheckSettings())
    for i in range(100):
        stamp = i // 10 + 1
        # What comes again under the same stamp says that it went on a little.
        pulled = 0.0016 * stamp + 1e-6 * (i % 10)
        free = FreeMotion(stamp, (pulled,), (800.0 * pulled,), ((0.0, 0.0),), "model", objections=("",))
        check.observe(ObservedPair(TendonSample(stamp, (pulled,), (800.0 * pulled,)), free))
    found = check.judge()["index"]
    assert found.finding is Finding.UNSEEN
    assert "found 8 samples" in found.reason
