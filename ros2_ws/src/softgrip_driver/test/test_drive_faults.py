# SPDX-License-Identifier: Apache-2.0
"""One drive after a fault, a reset and a homing: what it is told, in whose frame, with how much tension."""

from __future__ import annotations

import pytest

from softgrip_driver.dynamixel.registers import TORQUE_ENABLE
from softgrip_driver.errors import NoReplyError
from softgrip_driver.faults import FAULTS, Reaction, Recovery
from softgrip_driver.tendon.drive import Drive
from softgrip_driver.tendon.homing import Homing
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.motions import Hold

LIMITS = TendonLimits()
DT = 0.005
ZERO, HERE = 0.1, 0.110
"""[m] of the zero, and of where the drive stands, in the device's frame."""


class Standing:
    """A homed drive that stands 10 mm from its zero."""

    def __init__(self, reading) -> None:  # type: ignore[no-untyped-def]  # the fixture
        self._reading = reading
        self.drive, self.now = Drive("a", LIMITS, 20.0, DT), 0.0
        self.step()
        self.drive.switch_on()
        self.drive.set_zero(ZERO, 1)

    def step(self, position: float = HERE, **others):  # type: ignore[no-untyped-def]
        self.now += DT
        return self.drive.step(self.now, self._reading(self.now, position, 0.0, 5.0, **others))


@pytest.fixture
def standing(reading) -> Standing:  # type: ignore[no-untyped-def]
    return Standing(reading)


@pytest.mark.parametrize("fault", [name for name, row in FAULTS.items() if row.reaction is Reaction.HOLD])
@pytest.mark.parametrize("tension_limit", [5.0, 35.0])
def test_whatever_the_fault_it_holds_where_it_stands(standing: Standing, fault: str, tension_limit: float) -> None:
    """A lost zero changes what lengths count from, also for a hold that is gentle enough to stay as it is."""
    standing.drive.start(lambda view: Hold(view.pulled_length_m, tension_limit), standing.now)
    for _ in range(5):
        standing.step()
    standing.drive.set_fault(fault, "")
    setpoint = standing.step().setpoint
    assert setpoint is not None
    if setpoint.position is not None:
        assert setpoint.position == pytest.approx(HERE, abs=1e-3)
    assert setpoint.tension_limit <= LIMITS.tension_hold


@pytest.mark.parametrize("fault", [name for name, row in FAULTS.items() if row.reaction is Reaction.LET_GO])
def test_a_fault_that_lets_go_switches_off_in_the_same_step(standing: Standing, fault: str) -> None:
    shown = {"session_mark": 0} if fault == "rebooted" else {"faults": (fault,)}
    actions = standing.step(**shown)
    assert (standing.drive.fault, actions.power, standing.drive.powered) == (fault, False, False)


@pytest.mark.parametrize("fault", [name for name, row in FAULTS.items() if row.recovery is not Recovery.SELF])
def test_a_person_s_reset_ends_every_fault_that_does_not_end_by_itself(standing: Standing, fault: str) -> None:
    standing.drive.set_fault(fault, "")
    assert standing.drive.fault == fault
    standing.drive.reset()
    assert standing.drive.fault == ""


def test_a_drive_that_does_not_know_where_it_is_keeps_its_goal_with_the_holding_tension(standing: Standing) -> None:
    standing.drive.start(lambda view: Hold(view.pulled_length_m, 35.0), standing.now)
    standing.step()
    for _ in range(6):
        standing.step(position=HERE + 0.0628)
    assert standing.drive.fault == "position_jump"
    setpoint = standing.step(position=HERE + 0.0628).setpoint
    assert setpoint is not None
    assert setpoint.position is None
    assert setpoint.tension_limit == pytest.approx(LIMITS.tension_hold)


def test_a_homing_far_from_the_device_s_zero_finds_where_the_tendon_gets_taut(spring_finger, reading) -> None:  # type: ignore[no-untyped-def]
    """The finger is taut at 503 mm of the device; afterwards it stands there, and the mark of the old zero is void."""
    finger, drive, now = spring_finger(taut=0.503, position=0.500), Drive("a", LIMITS, 20.0, DT), 0.0

    def cycle(**others):  # type: ignore[no-untyped-def]
        nonlocal now
        now += DT
        finger.time = now
        actions = drive.step(now, finger.read(reading, **others))
        if actions.setpoint is not None:
            finger.advance(DT, actions.setpoint)
        return actions

    cycle()
    drive.switch_on()
    drive.set_zero(0.499, 1)
    drive.start(lambda view: Homing(view, LIMITS), now)
    while drive.outcome is None and now < 20.0:
        cycle()
    assert drive.zero == pytest.approx(0.503, abs=3e-4)
    for _ in range(20):
        setpoint = cycle(session_mark=9).setpoint
    assert drive.fault == "", "the device gets its new mark afterwards"
    assert setpoint is not None
    assert setpoint.position == pytest.approx(drive.zero, abs=1e-4)


def test_a_servo_that_took_hold_without_being_heard_has_not_restarted(bench, monkeypatch):  # type: ignore[no-untyped-def]
    """On a busy computer the answers come too late: what was read before the order must not pass for its result."""
    write = bench.backend.bus.write

    def unheard(servo_id, item, value, attempts=1):  # type: ignore[no-untyped-def]
        write(servo_id, item, value, attempts)
        if servo_id == 1 and item is TORQUE_ENABLE and value == 1:
            raise NoReplyError("servo 1: too late")

    assert bench.until(lambda _: bench.backend._live["index"].powered is False)
    monkeypatch.setattr(bench.backend.bus, "write", unheard)
    bench.loop.power(on=True)
    seen = bench.pass_time(1.0)
    assert {drive.fault for one in seen for drive in one.drives} <= {"", "no_reply"}
    assert bench.plant.servos[0].registers.get("torque_enable") == 1
