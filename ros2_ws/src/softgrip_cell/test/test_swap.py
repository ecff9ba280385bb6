# SPDX-License-Identifier: Apache-2.0
"""The guided swap and the check by an empty closing."""

from __future__ import annotations

import math
import random
from dataclasses import replace

import pytest

from softgrip_cell.catalogue_file import read_catalogue
from softgrip_cell.errors import RefusedError
from softgrip_cell.finger_records import FingerState, read_finger_records
from softgrip_cell.grasp.reference import FreeReference
from softgrip_cell.observation import FreeMotion, ObservedPair, SeenTip, TendonSample
from softgrip_cell.storage import MountedSlot, SlotState
from softgrip_cell.swap.check import CheckSettings, EmptyClosing, Finding
from softgrip_cell.swap.sequence import PersistAction, SwapSequence, SwapStep

SETS = read_catalogue().finger_sets
EMPTY_HAND = tuple(MountedSlot(name) for name in ("index", "middle", "thumb"))
POWER = ("PW-I-01", "PW-M-01", "PW-T-01")
PINCH = ("PI-I-01", "PI-M-01", "PI-T-01")


def mounted(serials=POWER, profile: str = "power", state: SlotState = SlotState.VERIFIED) -> tuple[MountedSlot, ...]:
    return tuple(
        MountedSlot(slot.name, state, serial, profile) for slot, serial in zip(EMPTY_HAND, serials, strict=True)
    )


def test_a_swap_goes_through_its_steps_and_writes_before_it_acts() -> None:
    sequence = SwapSequence(SETS["pinch"], mounted(), read_finger_records())
    turns = [sequence.start(), sequence.released(), sequence.locked()]
    turns.append(sequence.confirm("open_palm"))
    turns.append(sequence.confirm("remove"))
    turns.append(sequence.confirm("insert", PINCH))
    turns.append(sequence.confirm("close_palm"))
    turns.append(sequence.unlocked())
    turns.append(sequence.homed())
    assert [(turn.step, turn.persist) for turn in turns] == [
        (SwapStep.RELEASE, PersistAction.NOTHING),
        (SwapStep.LOCK, PersistAction.NOTHING),
        (SwapStep.OPEN_PALM, PersistAction.FORGET_SLOTS),
        (SwapStep.REMOVE, PersistAction.NOTHING),
        (SwapStep.INSERT, PersistAction.PARK_FINGERS),
        (SwapStep.CLOSE_PALM, PersistAction.READ_IN),
        (SwapStep.UNLOCK, PersistAction.NOTHING),
        (SwapStep.HOME, PersistAction.NOTHING),
        (SwapStep.VERIFY, PersistAction.NOTHING),
    ]
    assert [turn.confirmation for turn in turns] == [False, False, True, True, True, True, False, False, False]
    assert "take out PW-I-01 from index" in turns[3].instruction
    assert "PI-T-01 into thumb" in turns[4].instruction
    assert turns[5].serials == PINCH


def test_fingers_that_are_in_already_are_only_checked() -> None:
    sequence = SwapSequence(SETS["power"], mounted(state=SlotState.TO_BE_VERIFIED), read_finger_records())
    assert sequence.only_check
    assert sequence.released().step is SwapStep.HOME
    assert sequence.serials == POWER


@pytest.mark.parametrize(
    ("slots", "requested"),
    [
        (EMPTY_HAND, ()),
        (mounted(state=SlotState.UNKNOWN), ()),
        (mounted(PINCH, "pinch"), ()),
        (mounted(), ("PW-I-02", "PW-M-02", "PW-T-02")),
    ],
)
def test_anything_less_certain_is_a_whole_swap(slots, requested) -> None:
    assert not SwapSequence(SETS["power"], slots, read_finger_records(), requested).only_check


def test_the_least_used_fingers_are_proposed() -> None:
    finger_records = read_finger_records()
    finger_records["PI-I-01"] = replace(finger_records["PI-I-01"], cycles=900)
    sequence = SwapSequence(SETS["pinch"], EMPTY_HAND, finger_records)
    sequence.start()
    sequence.released()
    sequence.locked()
    sequence.confirm("open_palm")
    assert "PI-I-02 into index, PI-M-01 into middle" in sequence.confirm("remove").instruction


@pytest.mark.parametrize(
    ("serials", "expected"),
    [
        (("PI-I-01", "PI-M-01"), "expected one serial per slot .index, middle, thumb., found 2"),
        ((), "found 0"),
        (("PI-I-01", "PI-M-01", "PX-T-07"), "slot thumb: finger 'PX-T-07' has no finger record"),
        (
            ("PW-I-01", "PI-M-01", "PI-T-01"),
            "expected its finger of profile 'pinch', found PW-I-01: index finger of",
        ),
        (("PI-M-01", "PI-I-01", "PI-T-01"), "slot index: expected its finger"),
        (("PI-I-01", "PI-M-02", "PI-T-01"), "PI-M-02 is worn"),
        (("PI-I-01", "PI-M-01", "PI-T-02"), "PI-T-02 has closed 25000 times, its limit is 25000"),
    ],
)
def test_wrong_worn_and_unknown_fingers_are_refused_when_read_in(serials, expected: str) -> None:
    finger_records = read_finger_records()
    finger_records["PI-M-02"] = replace(finger_records["PI-M-02"], state=FingerState.WORN)
    finger_records["PI-T-02"] = replace(finger_records["PI-T-02"], cycles=25_000)
    sequence = SwapSequence(SETS["pinch"], EMPTY_HAND, finger_records)
    sequence.start()
    sequence.released()
    sequence.locked()
    sequence.confirm("open_palm")
    sequence.confirm("remove")
    with pytest.raises(RefusedError, match=expected):
        sequence.confirm("insert", serials)
    assert sequence.step is SwapStep.INSERT, "the step goes on waiting"
    assert sequence.confirm("insert", PINCH).step is SwapStep.CLOSE_PALM


@pytest.mark.parametrize("state", [FingerState.WORN, FingerState.RETIRED, FingerState.UNKNOWN])
def test_a_set_without_usable_fingers_is_refused_at_once(state: FingerState) -> None:
    finger_records = {
        serial: replace(finger_record, state=state) if finger_record.finger == "thumb" else finger_record
        for serial, finger_record in read_finger_records().items()
    }
    with pytest.raises(RefusedError, match="no usable thumb finger of profile 'hook'"):
        SwapSequence(SETS["hook"], EMPTY_HAND, finger_records)


def test_confirmations_out_of_turn_are_refused() -> None:
    sequence = SwapSequence(SETS["pinch"], EMPTY_HAND, read_finger_records())
    with pytest.raises(RefusedError, match="no step waits"):
        sequence.confirm("open_palm")
    sequence.released()
    with pytest.raises(RefusedError, match="no step waits"):
        sequence.confirm("open_palm")
    sequence.locked()
    with pytest.raises(RefusedError, match="expected a confirmation of step 'open_palm', found 'insert'"):
        sequence.confirm("insert", PINCH)


def test_every_step_names_the_condition_it_leaves_when_cancelled() -> None:
    sequence = SwapSequence(SETS["pinch"], mounted(), read_finger_records())
    said = [sequence.safe_condition()]
    sequence.released()
    sequence.locked()
    for step, serials in (("open_palm", ()), ("remove", ()), ("insert", PINCH), ("close_palm", ())):
        said.append(sequence.safe_condition())
        sequence.confirm(step, serials)
    said.append(sequence.safe_condition())
    sequence.unlocked()
    said.append(sequence.safe_condition())
    assert said[0] == "tendons slack, fingers as before but to be verified"
    assert said[3] == "tendons slack, palm open, slots unknown: run the swap again before any grasp"
    assert said[-2] == "tendons slack, fingers to be verified before any grasp"
    assert said[-1] == "tendons released, fingers to be verified before any grasp"


# --- the check -----------------------------------------------------------------------------------------------------

SETTINGS = CheckSettings()


def closing(
    gain: float = 1.0,
    noise_n: float = 0.1,
    tip_off_m: float = 0.0,
    reach_m: float = 0.016,
    bend: float = 1.0,
    broken=(),
    earlier=None,
) -> EmptyClosing:
    """Close three equal fingers: predicted tension 0.8 N/mm, measured one gain times that to a power, tip on a line."""
    rng = random.Random(0)
    check = EmptyClosing(("index", "middle", "thumb"), SETTINGS, earlier)
    for i in range(200):
        pulled = reach_m * i / 199
        predicted = 800.0 * pulled
        tension = tuple(0.05 if s in broken else gain * predicted**bend + rng.gauss(0.0, noise_n) for s in range(3))
        stamp = i * 5_000_000
        tip = (0.1 - 2.0 * pulled, -3.0 * pulled)
        sample = TendonSample(stamp, (pulled,) * 3, tension)
        check.observe(ObservedPair(sample, FreeMotion(stamp, (pulled,) * 3, (predicted,) * 3, (tip,) * 3, "fm")))
        if i % 6 == 0:
            check.observe_tip(SeenTip(stamp, "index", (tip[0] + tip_off_m, tip[1]), 0.0003))
    return check


@pytest.mark.parametrize("gain", [0.85, 1.0, 1.15])
def test_a_finger_inside_the_interval_is_good_and_teaches_its_free_motion(gain: float) -> None:
    results = closing(gain=gain, noise_n=0.1).judge()
    for result in results.values():
        assert result.finding is Finding.GOOD
        assert result.tension_ratio == pytest.approx(gain, abs=0.02)
        assert result.reference is not None
        assert result.reference.offset(0.010) == pytest.approx((gain - 1.0) * 8.0, abs=0.1)
        assert result.reference.tension(0.010) == pytest.approx(gain * 8.0, abs=0.15)
        assert result.reference.stddev_n == pytest.approx(0.1, rel=0.4)
        assert FreeReference.from_document(result.reference.document()) == result.reference
    assert "fingertip within 0.0 mm" in results["index"].reason
    assert "not seen by the camera" in results["thumb"].reason


@pytest.mark.parametrize("gain", [0.5, 1.5, 2.0])
def test_a_tension_outside_the_interval_is_refused(gain: float) -> None:
    assert {result.finding for result in closing(gain=gain).judge().values()} == {Finding.OFF}


def test_a_tension_that_rises_otherwise_is_refused_whatever_its_size() -> None:
    """0.0067 p^3 has the predicted size about, but not its course."""
    result = closing(gain=0.0067, bend=3.0).judge()["thumb"]
    assert abs(result.tension_ratio - 1.0) < SETTINGS.tension_fraction
    assert result.finding is Finding.OFF
    assert "course is off" in result.reason


@pytest.mark.parametrize(
    ("stop_mm", "gain", "finding"), [(12.0, 1.1, Finding.GOOD), (14.0, 1.1, Finding.GOOD), (12.0, 1.6, Finding.OFF)]
)
def test_nothing_is_compared_where_grooves_close(stop_mm: float, gain: float, finding: Finding) -> None:
    """The real groove closes 1 mm after or before the predicted one, at 13 mm, with 8 N/mm from there on."""
    check = EmptyClosing(("index",), SETTINGS)
    for i in range(320):
        pulled_mm = 0.05 * i
        predicted, measured = (0.5 * pulled_mm + 8.0 * max(0.0, pulled_mm - stop) for stop in (13.0, stop_mm))
        sample = TendonSample(i * 5_000_000, (1e-3 * pulled_mm,), (gain * measured,))
        free = FreeMotion(sample.stamp_ns, (1e-3 * pulled_mm,), (predicted,), ((0.0, 0.0),), "fm")
        check.observe(ObservedPair(sample, free))
    result = check.judge()["index"]
    assert result.finding is finding
    assert result.tension_ratio == pytest.approx(gain, abs=0.02)


@pytest.mark.parametrize(("gain", "finding"), [(1.0, Finding.GOOD), (1.1, Finding.GOOD), (1.25, Finding.WORN)])
def test_a_finger_that_changed_since_its_last_check_is_worn(gain: float, finding: Finding) -> None:
    before = closing().judge()["index"].reference
    assert before is not None
    assert closing(gain=gain, earlier={"index": before}).judge()["index"].finding is finding
    assert closing(gain=gain).judge()["index"].finding is Finding.GOOD, "nothing to compare with"


def test_a_tip_elsewhere_is_refused_even_with_the_right_tension() -> None:
    results = closing(tip_off_m=0.018).judge()
    assert results["index"].finding is Finding.OFF
    assert "18.0 mm from the prediction, expected at most" in results["index"].reason
    assert results["thumb"].finding is Finding.GOOD


def test_a_broken_tendon_is_named() -> None:
    results = closing(broken=(1,)).judge()
    assert results["middle"].finding is Finding.BROKEN
    assert results["index"].finding is Finding.GOOD


def test_too_short_a_closing_proves_nothing() -> None:
    result = closing(reach_m=0.008).judge()["index"]
    assert result.finding is Finding.UNSEEN
    assert "expected a closing to 10.0 mm or more" in result.reason


def test_samples_that_were_lost_before_the_end_prove_nothing() -> None:
    """A finger that is known to 12 of 16 mm would be taken for one at its end where a grasp closes it farther."""
    check = closing(reach_m=0.012)
    check.end({"index": 0.016, "middle": 0.0135, "thumb": 0.012})
    results = check.judge()
    assert {name: result.finding for name, result in results.items()} == {
        "index": Finding.UNSEEN,
        "middle": Finding.GOOD,
        "thumb": Finding.GOOD,
    }
    assert "whole closing, to 16.0 mm, found none beyond 12.0 mm" in results["index"].reason


def test_no_closing_at_all_proves_nothing() -> None:
    result = EmptyClosing(("index",), SETTINGS).judge()["index"]
    assert result.finding is Finding.UNSEEN
    assert math.isnan(result.tension_ratio)
