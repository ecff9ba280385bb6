# SPDX-License-Identifier: Apache-2.0
"""One drive stepped by hand with readings made up for one rule each: faults, power, refusals, what is sent."""

from __future__ import annotations

import math

import pytest

from softgrip_driver.faults import FAULTS, Recovery
from softgrip_driver.tendon.drive import Drive
from softgrip_driver.tendon.guard_set import GuardSet
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.motions import DriveState, Hold, MoveOutcome, MoveToLength

LIMITS = TendonLimits()
DT = 0.005
ZERO = 0.1
"""[m] of the zero in the device's frame: far from 0, so that a frame that is forgotten shows."""


class Stepped:
    """A homed drive that holds, 10 mm pulled, and what its device is told."""

    def __init__(self, reading) -> None:  # type: ignore[no-untyped-def]  # the fixture
        self._reading = reading
        self.drive = Drive("a", LIMITS, 20.0, DT)
        self.now = 0.0
        self.step()
        self.drive.switch_on()
        self.drive.set_zero(ZERO, 1)
        self.step()

    def step(self, length: float = 0.010, tension: float = 5.0, **others):  # type: ignore[no-untyped-def]
        self.now += DT
        return self.drive.step(self.now, self._reading(self.now, ZERO + length, 0.0, tension, **others))

    def hold(self, ahead: float, tension: float = 8.0) -> None:
        """Pull with a set-point that is ahead of the drive [m]."""
        self.drive.start(lambda view: Hold(view.pulled_length_m + ahead, 35.0), self.now)
        for _ in range(5):
            self.step(tension=tension)

    def move(self, target: float = 0.020):  # type: ignore[no-untyped-def]
        return self.drive.start(lambda view: MoveToLength(target, 0.02, 35.0, view, LIMITS), self.now)


@pytest.fixture
def stepped(reading) -> Stepped:  # type: ignore[no-untyped-def]
    return Stepped(reading)


def test_what_it_is_sent_counts_from_its_zero(stepped: Stepped) -> None:
    stepped.hold(0.0)
    setpoint = stepped.step().setpoint
    assert setpoint is not None
    assert setpoint.position == pytest.approx(ZERO + 0.010, abs=1e-6)


def test_a_servo_that_is_being_set_up_again_takes_no_order(stepped: Stepped) -> None:
    assert stepped.drive.refusal() == ""
    stepped.drive.begin_restore(power=True)
    assert "is being set up again" in stepped.drive.refusal()
    assert not stepped.drive.homed, "its turns are lost"


@pytest.mark.parametrize("power", [True, False])
def test_after_it_was_set_up_again_it_has_the_power_that_was_asked_for(stepped: Stepped, power: bool) -> None:
    stepped.drive.begin_restore(power=power)
    assert stepped.drive.restored(success=True).power is (True if power else None)
    assert stepped.drive.powered is power


def test_a_set_up_that_failed_leaves_it_off(stepped: Stepped) -> None:
    stepped.drive.begin_restore(power=True)
    assert stepped.drive.restored(success=False).power is False
    assert not stepped.drive.powered


@pytest.mark.parametrize(("fault", "pulls"), [("tendon_broken", False), ("tension_exceeded", True)])
def test_a_drive_whose_position_is_void_does_not_go_on_pulling(stepped: Stepped, fault: str, pulls: bool) -> None:
    """It held with its set-point 2 mm ahead; whoever keeps pulling keeps some of that, at most the holding tension."""
    stepped.hold(0.002)
    stepped.drive.set_fault(fault, "")
    setpoint = stepped.step(tension=8.0).setpoint
    assert setpoint is not None
    assert (setpoint.position - (ZERO + 0.010) > 5e-4) is pulls
    assert setpoint.tension_limit <= LIMITS.tension_hold


@pytest.mark.parametrize("fault", [name for name, row in FAULTS.items() if row.recovery is Recovery.HOME])
def test_a_fault_that_costs_the_zero_says_so_and_ends_the_order(stepped: Stepped, fault: str) -> None:
    stepped.move()
    stepped.drive.set_fault(fault, "")
    assert (stepped.drive.homed, stepped.drive.zero_lost, stepped.drive.outcome) == (False, True, MoveOutcome.FAULT)


def test_the_first_latched_fault_stays_until_a_person_resets_it(stepped: Stepped) -> None:
    stepped.drive.set_fault("tension_exceeded", "")
    for consequence in ("stalled", "no_reply", "gauge_lost"):
        stepped.drive.set_fault(consequence, "")
        assert stepped.drive.fault == "tension_exceeded"
    for _ in range(100):
        stepped.step()
    assert stepped.drive.fault == "tension_exceeded"
    stepped.drive.reset()
    assert stepped.drive.fault == ""


@pytest.mark.parametrize("name", ["port_lost", "no_reply", "over_temperature", "input_voltage"])
def test_a_reset_does_not_hide_what_ends_by_itself(stepped: Stepped, name: str) -> None:
    stepped.drive.set_fault(name, "")
    stepped.drive.reset()
    assert stepped.drive.fault == name


@pytest.mark.parametrize("field", ["position", "velocity", "tension", "pull"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_reading_that_is_no_number_is_no_reading(reading, field: str, value: float) -> None:  # type: ignore[no-untyped-def]
    stepped = Stepped(reading)
    stepped.now += DT
    numbers = {"position": ZERO + 0.010, "velocity": 0.0, "tension": 5.0, "pull": 5.0, field: value}
    actions = stepped.drive.step(
        stepped.now,
        reading(stepped.now, numbers["position"], numbers["velocity"], numbers["tension"], pull=numbers["pull"]),
    )
    assert actions.setpoint is None
    assert stepped.drive.snapshot().lost_replies == 1


def test_switched_off_it_says_so_to_its_device_and_forgets_what_it_did(stepped: Stepped) -> None:
    stepped.move()
    assert stepped.drive.switch_off().power is False
    assert (stepped.drive.busy, stepped.drive.outcome) == (False, MoveOutcome.CANCELLED)
    assert stepped.drive.state is DriveState.IDENTIFIED
    assert stepped.step(powered=True).power is False, "a device that did not hear it is told again"
    assert stepped.step(powered=False).power is None


def test_a_drive_that_was_left_holding_is_not_switched_off_before_it_was_decided(reading) -> None:  # type: ignore[no-untyped-def]
    drive = Drive("a", LIMITS, 20.0, DT)
    drive.is_left_holding = True
    assert drive.step(DT, reading(DT, ZERO, 0.0, 8.0, powered=True)).power is None
    drive.take_over(ZERO + 0.002)
    setpoint = drive.step(2 * DT, reading(2 * DT, ZERO, 0.0, 8.0, powered=True)).setpoint
    assert setpoint is not None
    assert setpoint.position - ZERO > 1e-3, "it goes on pulling by what the device's goal is ahead"


def test_an_order_that_is_cancelled_ends_and_stops(stepped: Stepped) -> None:
    stepped.move()
    stepped.drive.cancel_motion("its owner is gone")
    assert (stepped.drive.outcome, stepped.drive.state) == (MoveOutcome.CANCELLED, DriveState.HOLDING)


def test_an_order_that_is_aborted_ends_as_a_fault_and_stops(stepped: Stepped) -> None:
    stepped.move()
    stepped.drive.abort("another tendon broke")
    assert (stepped.drive.outcome, stepped.drive.state) == (MoveOutcome.FAULT, DriveState.HOLDING)


def test_nothing_is_ready_that_has_not_answered_or_has_a_latched_fault(stepped: Stepped) -> None:
    assert not Drive("b", LIMITS, 20.0, DT).ready
    assert stepped.drive.ready
    stepped.drive.set_fault("stalled", "")
    assert stepped.drive.ready, "the next order ends it"
    stepped.drive.set_fault("tension_exceeded", "")
    assert not stepped.drive.ready


@pytest.mark.parametrize("fault", ["no_reply", "port_lost"])
def test_a_drive_that_nobody_hears_is_shown_as_disconnected_until_it_answers(stepped: Stepped, fault: str) -> None:
    stepped.drive.set_fault(fault, "")
    assert stepped.drive.state is DriveState.DISCONNECTED
    stepped.step()
    assert stepped.drive.fault == ""


def test_silence_is_a_fault_after_50_ms(stepped: Stepped) -> None:
    silent = 0
    while stepped.drive.fault == "":
        stepped.now += DT
        stepped.drive.step(stepped.now, None)
        silent += 1
    assert silent == pytest.approx(LIMITS.no_reply / DT, abs=1)


def test_a_servo_with_another_mark_or_without_torque_has_restarted_and_is_let_go(reading) -> None:  # type: ignore[no-untyped-def]
    for shown in ({"session_mark": 0}, {"powered": False}):
        stepped = Stepped(reading)
        assert stepped.step(**shown).power is False
        assert (stepped.drive.fault, stepped.drive.powered, stepped.drive.homed) == ("rebooted", False, False)


def test_an_overload_is_taken_hold_of_again_once_and_not_twice(stepped: Stepped) -> None:
    assert stepped.step(faults=("overload",)).restore
    stepped.drive.restored(success=True)
    assert not stepped.step(faults=("overload",), powered=True).restore


def test_a_late_step_moves_a_set_point_by_two_periods_at_most(stepped: Stepped) -> None:
    """At 20 mm/s: 0.2 mm in two periods of 5 ms, 2 mm in the tenth of a second that has passed."""
    stepped.move(0.030)
    for _ in range(60):
        before = stepped.step().setpoint
    stepped.now += 0.1
    after = stepped.step().setpoint
    assert before is not None
    assert after is not None
    assert after.position - before.position < 3e-4


def test_the_tension_that_counts_is_a_median_of_three(reading) -> None:  # type: ignore[no-untyped-def]
    watch = GuardSet(LIMITS, 20.0, DT)
    assert [watch.tension(reading(i * DT, 0.0, 0.0, tension)) for i, tension in enumerate((5.0, 5.0, 60.0, 5.0))] == [
        5.0, 5.0, 5.0, 5.0,
    ]  # fmt: skip


def test_while_a_break_is_suspected_it_gives_way_by_nothing(stepped: Stepped) -> None:
    """It stands beyond its goal then, where its trim would go back, and look as if the tension had been let out."""
    stepped.drive.start(lambda view: Hold(view.pulled_length_m + 1e-3, 35.0), stepped.now)
    for _ in range(60):
        stepped.step(tension=8.0)
    goals = []
    for _ in range(6):
        setpoint = stepped.step(length=0.0115, tension=0.1).setpoint
        assert setpoint is not None
        goals.append(setpoint.position)
    assert stepped.drive.fault == ""
    assert goals[-3:] == [goals[-1]] * 3
    for _ in range(60):
        stepped.step(length=0.0115, tension=0.1)
    assert stepped.drive.fault == "tendon_broken"


@pytest.mark.parametrize(("jerk", "fault"), [(0.002, ""), (-0.002, "tension_exceeded")])
def test_current_above_the_hard_limit_is_excused_while_the_motor_speeds_up_only(
    stepped: Stepped, reading, jerk: float, fault: str
) -> None:  # type: ignore[no-untyped-def]
    """0.002 m/s in 5 ms are 0.4 m/s^2: what the current then says is the motor's own inertia."""
    stepped.move()
    for i in range(10):
        stepped.now += DT
        stepped.drive.step(stepped.now, reading(stepped.now, ZERO + 0.010, 0.02 + jerk * i, LIMITS.tension_hard + 1.0))
    assert stepped.drive.fault == fault
