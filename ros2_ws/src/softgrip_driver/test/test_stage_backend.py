# SPDX-License-Identifier: Apache-2.0
"""A stage has no limit of its own: what its backend sends it while the gauge sees, sees too much, or sees nothing."""

from __future__ import annotations

import pytest

from softgrip_driver.errors import GaugeRestartedError, NoReplyError, SaturatedError
from softgrip_driver.rig.devices import DeviceIdentity
from softgrip_driver.stage.backend import StageBackend
from softgrip_driver.tendon.backend import Setpoint


class RecordingStage:
    """Stands where a test puts it and writes down what it is told."""

    def __init__(self) -> None:
        self.where = 0.0
        self.orders: list[tuple[str, float]] = []

    def open(self) -> DeviceIdentity:
        return DeviceIdentity("stage")

    def start(self, target: float, speed: float) -> None:
        assert speed == 0.01
        self.orders.append(("start", target))

    def travel(self) -> float:
        return self.where

    def stop(self) -> None:
        self.orders.append(("stop", self.where))

    def close(self) -> None:
        pass


class SetGauge:
    """Shows what a test sets, or raises it."""

    def __init__(self) -> None:
        self.shows: float | Exception = 1.0

    def open(self) -> DeviceIdentity:
        return DeviceIdentity("gauge")

    def tension(self) -> float:
        if isinstance(self.shows, Exception):
            raise self.shows
        return self.shows

    def close(self) -> None:
        pass


class Rig:
    def __init__(self) -> None:
        self.stage, self.gauge = RecordingStage(), SetGauge()
        self.backend = StageBackend("pull", self.stage, self.gauge, 0.01)
        self.backend.connect()

    def tell(self, length: float | None, tension_limit: float = 10.0) -> list[tuple[str, float]]:
        """One cycle; return what the stage was told."""
        self.reading = self.backend.read()["pull"]
        self.stage.orders.clear()
        self.backend.write({"pull": Setpoint(length, tension_limit)})
        return list(self.stage.orders)


@pytest.fixture
def rig() -> Rig:
    made = Rig()
    made.backend.power("pull", True)
    return made


def test_it_goes_where_a_setpoint_is(rig: Rig) -> None:
    assert rig.tell(0.005) == [("start", 0.005)]
    assert rig.tell(0.005) == [], "it is on its way"


def test_one_unreadable_line_of_the_gauge_stops_it(rig: Rig) -> None:
    rig.tell(0.005)
    rig.gauge.shows = NoReplyError("silent")
    assert rig.tell(0.006) == [("stop", 0.0)]
    assert rig.reading.faults == (), "one line may be damaged"
    rig.gauge.shows = 1.1
    assert rig.tell(0.006) == [("start", 0.006)]


def test_a_gauge_that_stays_silent_is_a_fault_by_the_third_time(rig: Rig) -> None:
    rig.gauge.shows = NoReplyError("silent")
    found = []
    for _ in range(3):
        rig.tell(0.005)
        found.append(rig.reading.faults)
    assert found == [(), (), ("gauge_lost",)]


@pytest.mark.parametrize("powered", [True, False])
def test_a_gauge_that_restarted_is_a_fault_whether_the_tendon_is_held_or_not(rig: Rig, powered: bool) -> None:
    rig.backend.power("pull", powered)
    rig.gauge.shows = GaugeRestartedError("a banner")
    assert ("start", 0.005) not in rig.tell(0.005)
    assert rig.reading.faults == ("gauge_restarted",)
    rig.gauge.shows = 0.0
    rig.tell(0.005)
    assert rig.reading.faults == (), "once: what stays is the drive's"


def test_a_tension_beyond_the_gauge_s_range_is_one_that_a_person_has_to_reset(rig: Rig) -> None:
    rig.tell(0.005)
    rig.gauge.shows = SaturatedError("beyond its capacity")
    rig.tell(0.006)
    assert rig.reading.faults == ("tension_exceeded",)


def test_at_its_limit_it_stops_and_can_still_be_let_out(rig: Rig) -> None:
    rig.stage.where = 0.010
    rig.gauge.shows = 10.0
    assert rig.tell(0.012, tension_limit=10.0) == [("stop", 0.010)]
    assert rig.tell(0.004, tension_limit=10.0) == [("start", 0.004)]


def test_one_reading_below_nothing_stops_it_and_is_no_fault_yet(rig: Rig) -> None:
    rig.stage.where = 0.010
    rig.gauge.shows = -2.1
    assert rig.tell(0.012) == [("stop", 0.010)]
    assert rig.reading.faults == ()
    assert rig.tell(0.004) == [("start", 0.004)]


def test_a_gauge_that_shows_the_same_digits_over_a_pull_is_not_believed(rig: Rig) -> None:
    rig.gauge.shows = 5.0
    rig.tell(0.020)
    rig.stage.where = 0.0025
    assert rig.tell(0.020) == [("stop", 0.0025)]


def test_it_turns_back_only_after_it_was_stopped(rig: Rig) -> None:
    """A stage with a queue would first go to where it was sent before."""
    rig.tell(0.010)
    rig.stage.where = 0.005
    rig.gauge.shows = 1.2
    assert rig.tell(0.002) == [("stop", 0.005), ("start", 0.002)]


def test_without_power_it_goes_nowhere_and_switching_off_stops_it() -> None:
    rig = Rig()
    assert rig.tell(0.005) == []
    rig.backend.power("pull", True)
    rig.tell(0.005)
    rig.stage.orders.clear()
    rig.backend.power("pull", False)
    assert rig.stage.orders == [("stop", 0.0)]
    assert rig.tell(0.006) == []


def test_opened_again_it_has_neither_power_nor_the_mark_of_its_zero(rig: Rig) -> None:
    rig.backend.mark_session("pull", 7)
    rig.tell(None)
    assert rig.reading.session_mark == 7
    assert rig.backend.reconnect()
    assert rig.tell(0.005) == []
    assert (rig.reading.session_mark, rig.reading.powered) == (0, False)


def test_a_gauge_that_is_not_believed_lets_it_out_but_not_in() -> None:
    rig = Rig()
    rig.backend = StageBackend("pull", rig.stage, rig.gauge, 0.01, proof=2.0)
    rig.backend.connect()
    rig.stage.where = 0.010
    rig.backend.power("pull", True)
    assert rig.tell(0.012) == [("stop", 0.010)]
    assert rig.reading.faults == ("gauge_unproven",)
    assert rig.tell(0.004) == [("start", 0.004)]
    for rig.gauge.shows in (1.0, 1.0, 1.0, 1.0, 1.0, 3.5):
        rig.tell(0.004)
    assert rig.tell(0.012) == [("stop", 0.010), ("start", 0.012)]
    assert rig.reading.faults == ()
