# SPDX-License-Identifier: Apache-2.0
"""Who holds the cell's time: rules alone, at given times."""

import pytest

from softgrip_emulator.participants import REST_AFTER_S, REST_LAG_FACTOR, Participant, Participants
from softgrip_time.protocol import CancelRequest, Join, Progress, TimeGrant, TimeRequest

WIRE = "/dev/pts/9"


@pytest.fixture
def everybody():
    return Participants(give_up_s=3.0)


def add(everybody, *join, **state):
    one = Participant(Join(*join), **state)
    everybody.all.append(one)
    return one


def holds(everybody, now_s=0.0, received=None, computer_s=100.0):
    return everybody.find_holder(now_s, received or {}, computer_s) is not None


def test_nobody_lets_the_time_run_without_bound(everybody):
    assert not holds(everybody)
    assert everybody.limit_s() == float("inf")


def test_a_stepper_holds_the_time_unless_it_waits(everybody):
    driver = add(everybody, "driver")
    assert holds(everybody)
    driver.update(TimeRequest(1, 0.5))
    assert not holds(everybody)
    assert everybody.limit_s() == 0.5
    assert everybody.due(0.499) == []
    assert everybody.due(0.5) == [driver]
    driver.is_granted = True
    assert holds(everybody, 0.5)
    driver.update(TimeRequest(2, 0.6))
    assert not holds(everybody, 0.5)
    driver.update(CancelRequest(2))
    assert holds(everybody, 0.5)


def test_bytes_of_its_device_end_a_steppers_wait_and_nobody_elses(everybody):
    driver, rig = add(everybody, "driver"), add(everybody, "rig")
    driver.update(TimeRequest(1, 0.5, WIRE))
    rig.update(TimeRequest(1, 0.5, "/dev/pts/4"))
    assert everybody.readers(WIRE) == [driver]
    driver.is_granted = True
    assert everybody.readers(WIRE) == []
    assert holds(everybody, computer_s=100.0)
    driver.update(TimeRequest(2, 0.4, WIRE))
    assert not holds(everybody, computer_s=100.2)
    assert everybody.readers(WIRE) == [driver]


def test_the_time_stands_while_bytes_are_on_their_way_to_a_device_but_not_for_ever(everybody):
    driver = add(everybody, "driver")
    driver.update(TimeRequest(1, 0.5, "", {WIRE: 14}))
    assert holds(everybody, received={WIRE: 13}, computer_s=100.0)
    assert not holds(everybody, received={WIRE: 14}, computer_s=100.1)
    assert holds(everybody, received={WIRE: 13}, computer_s=100.2)
    assert not holds(everybody, received={WIRE: 13}, computer_s=101.5)  # lost
    assert not holds(everybody, received={}, computer_s=101.6)  # unplugged


def test_the_time_runs_ahead_of_a_follower_by_its_lag(everybody):
    manager = add(everybody, "manager", "clock", 0.03, progress_s=1.0)
    assert everybody.limit_s() == pytest.approx(1.03)
    assert not holds(everybody, 1.02)
    assert holds(everybody, 1.03)
    manager.update(Progress(1.02))
    assert not holds(everybody, 1.03)
    manager.update(Progress(0.5))  # not back
    assert everybody.limit_s() == pytest.approx(1.05)


def test_the_time_waits_for_the_measurement_of_the_first_exposure_only_where_there_is_one(everybody):
    everybody.add_exposure(0.5)
    tracker = add(everybody, "tracker", "frames", 0.04)
    assert everybody.limit_s() == float("inf")
    for exposed_s in (1.0, 1.05):
        everybody.add_exposure(exposed_s)
    assert everybody.limit_s() == pytest.approx(1.04)
    assert holds(everybody, 1.04)
    tracker.update(Progress(1.0))
    assert everybody.limit_s() == pytest.approx(1.09)
    everybody.drop_exposure(1.05)
    assert everybody.limit_s() == float("inf")


def test_who_holds_the_time_for_too_long_is_left_behind_until_it_is_back(everybody):
    frozen = add(everybody, "frozen")
    other = add(everybody, "other", "clock", 0.05, progress_s=10.0)
    assert holds(everybody, computer_s=100.0)
    assert holds(everybody, computer_s=102.9)
    assert not holds(everybody, computer_s=103.1)
    assert frozen.is_given_up
    assert everybody.names() == {"other"}
    assert everybody.limit_s() == pytest.approx(other.progress_s + 0.05)
    frozen.update(TimeRequest(1, 4.0))
    assert everybody.names() == {"frozen", "other"}
    assert everybody.limit_s() == 4.0


def test_holding_again_and_again_for_a_short_time_is_not_given_up(everybody):
    driver = add(everybody, "driver")
    for k in range(50):
        assert holds(everybody, computer_s=100.0 + k)
        driver.update(TimeRequest(k, 1.0))
        assert not holds(everybody, computer_s=100.5 + k)
        driver.is_granted = True


def asked(everybody, one, packet, now_s):
    """A stepper sends a packet at a time of the cell; whether that ends a rest."""
    before = one.request
    one.update(packet)
    everybody.observe_work(before, packet, now_s)
    return everybody.update_rest(now_s)


def test_lags_are_longer_while_no_stepper_works(everybody):
    driver, manager = add(everybody, "driver"), add(everybody, "manager", "clock", 0.04, progress_s=9.0)
    assert not asked(everybody, driver, TimeRequest(1, 5.01), 5.0)
    assert everybody._limit_s(manager) == pytest.approx(9.04)
    for number in range(2, 40):  # a bus that is asked now and then, and the answers' bytes
        now_s = 5.0 + 0.04 * number
        asked(everybody, driver, TimeRequest(2 * number, now_s + 0.004, WIRE), now_s)
        asked(everybody, driver, TimeRequest(2 * number + 1, now_s + 0.038), now_s + 0.002)
    assert everybody.is_resting
    assert everybody._limit_s(manager) == pytest.approx(9.0 + 0.04 * REST_LAG_FACTOR)


def test_the_first_short_wait_and_the_first_one_that_is_ended_are_work(everybody):
    driver = add(everybody, "driver")
    for end in (TimeRequest(2, 7.01), CancelRequest(1)):
        now_s = 7.0
        everybody.worked_s = 0.0
        asked(everybody, driver, TimeRequest(1, now_s + 0.04), now_s)
        assert everybody.is_resting
        assert asked(everybody, driver, end, now_s)
        assert not everybody.is_resting
        assert not everybody.update_rest(now_s + REST_AFTER_S)
        assert not everybody.is_resting
        everybody.update_rest(now_s + REST_AFTER_S + 0.001)
        assert everybody.is_resting


def test_a_lag_at_rest_is_shorter_than_five_readings_at_rest():
    """100 Hz and 25 Hz; five messages are what subscriptions of streams keep (softgrip_nodekit.qos.SENSOR)."""
    assert 0.04 < 5 / 100.0
    assert 0.04 * REST_LAG_FACTOR < 5 / 25.0


@pytest.mark.parametrize(
    ("join", "packet"),
    [
        (Join("driver"), Progress(1.0)),
        (Join("tracker", "frames", 0.1), TimeRequest(1, 1.0)),
        (Join("tracker", "frames", 0.1), CancelRequest(1)),
        (Join("driver"), TimeGrant(1, 0.0, 0.0)),
    ],
)
def test_a_packet_of_another_kind_of_participant_is_refused(join, packet):
    with pytest.raises(ValueError, match="expected"):
        Participant(join).update(packet)
