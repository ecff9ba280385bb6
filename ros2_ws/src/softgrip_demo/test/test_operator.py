# SPDX-License-Identifier: Apache-2.0
"""The operator's patience: seat again, then take the next fingers, and say why when there are none left."""

from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

from softgrip_cell.swap.sequence import HANDS_OUT_TEXT
from softgrip_demo.errors import ShiftError
from softgrip_demo.nodes.operator import CellOperator

SLOTS = ("index", "middle", "thumb")


class Cell:
    """Answers swaps as told and keeps the serials it was shown."""

    def __init__(self, *reasons: str) -> None:
        self.reasons = list(reasons)
        self.shown: list[str] = []
        self.freed = 0

    def hands_out(self):
        self.freed += 1

    def swap(self, _finger_set, confirm, _serials):
        confirm("remove", "")
        self.shown.append(confirm("insert", "")[0])
        reason = self.reasons.pop(0) if self.reasons else ""
        return SimpleNamespace(outcome=2 if reason else 1, SUCCEEDED=1, reason=reason)


@pytest.mark.parametrize(
    ("reasons", "shown"),
    [
        ((), ["PI-I-01"]),
        (("index: stopped",), ["PI-I-01", "PI-I-01"]),
        (("check refused: worn",), ["PI-I-01", "PI-I-02"]),
        (("index: stopped", "index: stopped"), ["PI-I-01", "PI-I-01", "PI-I-02"]),
    ],
)
def test_fingers_are_seated_again_and_refused_ones_laid_aside(reasons, shown):
    cell, hands = Cell(*reasons), MagicMock()
    CellOperator(MagicMock(), hands, cell, SLOTS).swap("pinch")
    assert cell.shown == shown
    # the old fingers come out before others go in
    serials = [call.args[1] for call in hands.mount.call_args_list]
    assert serials[0::2] == [["", "", ""]] * len(shown)


def test_an_empty_store_is_said_with_the_reasons():
    cell = Cell(*["check refused: worn"] * 9)
    with pytest.raises(
        ShiftError, match=r"no pinch fingers passed: PI-I-01 .*worn.*PI-I-02 .*worn.*found 2 finger records"
    ):
        CellOperator(MagicMock(), MagicMock(), cell, SLOTS).swap("pinch")


def test_laid_aside_stays_aside():
    cell = Cell("check refused: worn")
    operator = CellOperator(MagicMock(), MagicMock(), cell, SLOTS)
    operator.swap("pinch")
    operator.swap("pinch")
    assert cell.shown == ["PI-I-01", "PI-I-02", "PI-I-02"]


def test_a_fault_of_the_drives_is_cleared_by_homing_and_no_fault_of_the_fingers():
    cell, link = Cell("tendon/home: no taut tendon", *["the driver has a fault: index: homing_failed"] * 2), MagicMock()
    CellOperator(link, MagicMock(), cell, SLOTS).swap("pinch")
    assert set(cell.shown) == {"PI-I-01"}
    assert [call.args[1] for call in link.call.call_args_list] == ["tendon/home"] * 2


def test_drives_that_stay_at_fault_are_given_up():
    link = MagicMock()
    link.call.side_effect = ShiftError("tendon/home refused")
    with pytest.raises(ShiftError, match="the driver has a fault"):
        CellOperator(link, MagicMock(), Cell(*["the driver has a fault: x"] * 9), SLOTS).swap("pinch")


def rig(*reasons):
    """A link whose rig ends plans with these reasons, "" for success; keeps whether each was a resumed one."""
    left, resumed = list(reasons), []

    def act(_kind, _name, goal, **_):
        resumed.append(bool(goal.resume))
        reason = left.pop(0)
        return SimpleNamespace(outcome=2 if reason else 1, SUCCEEDED=1, reason=reason)

    return MagicMock(act=act), resumed


def test_a_plan_that_broke_off_is_resumed():
    broken = "point 4 of 9 failed 3 times, last: x; put it right and resume the plan"
    link, resumed = rig(broken, broken, "")
    assert CellOperator(link, MagicMock(), Cell(), SLOTS).calibrate(1e-4, 1e-3).outcome == 1
    assert resumed == [False, True, True]
    link, resumed = rig(*[broken] * 9)
    with pytest.raises(ShiftError, match="point 4 of 9 failed"):
        CellOperator(link, MagicMock(), Cell(), SLOTS).calibrate(1e-4, 1e-3)
    assert len(resumed) == 4


def test_what_cannot_be_resumed_is_given_up_at_once():
    link, resumed = rig("expected a law of matte, ..., found x", "")
    with pytest.raises(ShiftError, match="expected a law"):
        CellOperator(link, MagicMock(), Cell(), SLOTS).calibrate(1e-4, 1e-3)
    assert resumed == [False]


def test_drives_that_a_swap_left_locked_are_unlocked_before_the_next_try():
    cell = Cell(f"not done within 5 s; {HANDS_OUT_TEXT}")
    CellOperator(MagicMock(), MagicMock(), cell, SLOTS).swap("pinch")
    assert cell.freed == 1
    assert len(cell.shown) == 2


def test_a_movement_is_ordered_with_its_speed_and_the_tension_it_may_have():
    sent = []

    def act(_kind, _name, goal, **_):
        sent.append(goal)
        return SimpleNamespace(outcome=1, REACHED=1, TENSION_LIMIT=2, reason="")

    CellOperator(MagicMock(act=act), MagicMock(), Cell(), SLOTS).move(0.02, 0.016)
    (goal,) = sent
    assert (goal.mode, list(goal.targets), goal.speed) == (goal.LENGTH, [0.02], 0.016)
    assert 0.0 < goal.tension_limit <= 35.0
    assert goal.lease == ""
