# SPDX-License-Identifier: Apache-2.0
"""When the test stand may move."""

import pytest

from softgrip_driver.rig.stop_guard import HeardState, StopGuard

FREE = HeardState(is_stopped=False, stop_reason="", is_locked=False, lock_owner="")


@pytest.fixture
def guard():
    return StopGuard(max_absence_s=1.0)


def test_nothing_moves_before_a_state_was_heard(guard):
    guard.take_publishers(1, 0.0)
    assert "found none yet" in guard.refusal(0.0)
    guard.take_state(FREE)
    assert guard.refusal(0.0) == ""


@pytest.mark.parametrize(
    ("state", "word"),
    [
        (HeardState(True, "a person", False, ""), "a person"),
        (HeardState(False, "", True, "manager"), "locked by manager"),
    ],
)
def test_a_stop_or_a_lock_holds_until_it_is_heard_to_have_ended(guard, state, word):
    guard.take_state(FREE)
    guard.take_state(state)
    assert word in guard.refusal(100.0)
    guard.take_state(FREE)
    assert guard.refusal(100.0) == ""


def test_a_publisher_that_is_gone_for_longer_than_it_may_be_stops_the_stand(guard):
    guard.take_state(FREE)
    guard.take_publishers(0, 10.0)
    assert guard.refusal(11.0) == ""
    assert "nobody publishes" in guard.refusal(11.01)
    guard.take_publishers(0, 11.5)
    assert "nobody publishes" in guard.refusal(11.6)
    guard.take_publishers(1, 12.0)
    assert guard.refusal(20.0) == ""


def test_a_source_that_does_not_answer_stops_the_stand_until_it_does(guard):
    guard.take_state(FREE)
    guard.take_answering(is_answering=False)
    assert "tendon_driver does not answer" in guard.refusal(0.0)
    guard.take_answering(is_answering=True)
    assert guard.refusal(0.0) == ""


def test_two_publishers_of_which_each_would_undo_the_others_stop_stop_the_stand(guard):
    guard.take_state(FREE)
    guard.take_publishers(1, 0.0)
    assert guard.refusal(0.0) == ""
    guard.take_publishers(2, 0.2)
    assert "2 nodes publish safety/state" in guard.refusal(0.2)
    guard.take_publishers(1, 0.4)
    assert guard.refusal(0.4) == ""
