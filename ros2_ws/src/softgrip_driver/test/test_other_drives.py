# SPDX-License-Identifier: Apache-2.0
"""Drives whose duty cycle or torque is limited: homing, tension, slack, break, stop, faults, silence."""

import pytest

from softgrip_driver.dynamixel.registers import MODELS as DYNAMIXELS
from softgrip_driver.dynamixel.registers import OperatingMode
from softgrip_driver.tendon.gripper import MoveMode
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.motions import DriveState, MoveOutcome
from softgrip_driver.tendon.needs import fitted_limits

#: [m] within which a zero is found: heavy gears want a high homing tension, and a finger stiffens on its way in
ZERO_M = {"STS3215": 9e-4, "DM-J4310-2EC": 9e-4, "XL430-W250": 4e-4}
#: [N] from which a break shows: what the gears hold without a tendon must be less than a quarter
BREAKS_FROM_N = {"STS3215": 20.0, "DM-J4310-2EC": 34.0, "XL430-W250": 20.0}
#: [degC] at which it lets go
HOT_DEGC = {"STS3215": 71.0, "DM-J4310-2EC": 101.0, "XL430-W250": 73.0}
MODELS = tuple(ZERO_M)


def settings_of(name):
    if name not in DYNAMIXELS:
        return {"model": name}
    limits = fitted_limits(TendonLimits(no_reply=0.05), DYNAMIXELS[name], 0.010)
    return {"model": name, "mode": OperatingMode.EXTENDED_POSITION, "limits": limits}


pytestmark = pytest.mark.parametrize("bench", [settings_of(name) for name in MODELS], ids=MODELS, indirect=True)


def limits_of(bench):
    return bench.controller.drives["index"].limits


def true_tension(bench, index=0):
    return float(bench.plant.bank.tension_n[index])


def test_it_homes_where_the_tendon_becomes_taut_and_closes_a_finger(bench):
    bench.loop.power(on=True)
    outcome, reason = bench.run(bench.loop.call(lambda c, now: c.home(now)), 40.0)
    assert outcome is MoveOutcome.REACHED, reason
    taut = bench.plant.wound_m() - bench.plant.bank.slack_m
    assert [drive.pulled_length_m for drive in bench.loop.snapshot.drives] == pytest.approx(
        taut, abs=ZERO_M[bench.model]
    )
    outcome, reason = bench.run(bench.move([0.015], limits_of(bench).speed))
    assert outcome is MoveOutcome.REACHED, reason  # a Damiao's torque, read between two goals, shows less in motion
    assert bench.plant.wound_m() - bench.plant.bank.slack_m == pytest.approx(0.015, abs=ZERO_M[bench.model] + 2e-4)
    bench.pass_time(1.0)
    assert [drive.pulled_length_m for drive in bench.loop.snapshot.drives] == pytest.approx([0.015] * 3, abs=2e-4)


@pytest.mark.parametrize("asked", [12.0, 20.0])
def test_it_pulls_to_a_tension_and_says_how_sure_it_is(bench, asked):
    bench.hold_taut(0.0)
    outcome, reason = bench.run(bench.move([asked], 0.01, mode=MoveMode.TENSION))
    assert outcome is MoveOutcome.REACHED, reason
    drive = bench.drive("index")
    assert abs(drive.tension - true_tension(bench)) < 2.0 * drive.tension_stddev


def test_a_slack_tendon_is_named(bench):
    bench.hold_taut(0.0)
    bench.cause("slack", slot="index", length_m=0.03)
    outcome, reason = bench.run(bench.move([0.02], limits_of(bench).speed))
    assert (outcome, bench.drive("index").fault) == (MoveOutcome.FAULT, "tendon_slack"), reason


def test_a_tendon_that_breaks_is_named_and_opens_the_others(bench):
    bench.hold_taut(BREAKS_FROM_N[bench.model])
    bench.pass_time(0.3)
    bench.cause("tendon_break", slot="index")
    assert bench.until(lambda seen: seen.drives[0].fault == "tendon_broken", 1.0), bench.drive("index")
    assert bench.until(lambda seen: all(one.state is DriveState.RELEASING for one in seen.drives[1:]))


def test_a_stop_lets_go_and_a_reset_takes_hold(bench):
    bench.hold_taut(12.0)
    assert bench.stop() == ""
    bench.pass_time(0.5)
    assert [servo.shaft.duty for servo in bench.plant.servos] == [0.0] * 3
    bench.reset()
    assert bench.until(lambda seen: all(one.state is DriveState.HOLDING for one in seen.drives), 2.0)
    outcome, reason = bench.run(bench.move([12.0], 0.01, mode=MoveMode.TENSION))
    assert outcome is MoveOutcome.REACHED, reason


@pytest.mark.parametrize(
    ("cause", "fault"),
    [("servo_silent", "no_reply"), ("silent_reboot", "rebooted"), ("overload", "overload"),
     ("overheating", "overheated")],
)  # fmt: skip
def test_its_faults_are_named_and_end(bench, cause, fault):
    bench.hold_taut(12.0)
    arguments = {"temperature_c": HOT_DEGC[bench.model]} if cause == "overheating" else {}
    bench.cause(cause, slot="index", **arguments)
    # a Damiao that comes back beyond half a turn of its origin shows another turn before its marks are looked at
    named = {fault, "position_jump"} if (cause, bench.model) == ("silent_reboot", "DM-J4310-2EC") else {fault}
    assert bench.until(lambda seen: seen.drives[0].fault in named, 2.0), bench.drive("index")
    bench.clear()
    with bench.plant.lock:
        shaft = bench.plant.servos[0].shaft
        shaft.temperature_c = shaft.winding_c = 30.0
    bench.pass_time(0.6)
    bench.reset()
    assert bench.until(lambda seen: not seen.drives[0].fault, 6.0), bench.drive("index")
    if fault != "no_reply":
        assert not bench.drive("index").homed


def test_a_computer_that_falls_silent_leaves_it_standing(bench):
    bench.hold_taut(0.0)
    ticket = bench.move([0.03], limits_of(bench).speed)
    bench.pass_time(0.3)
    ahead = limits_of(bench).max_following_error
    before = bench.plant.wound_m()[0]
    bench.world.clock.advance(bench.now() + 2.0)
    assert bench.plant.wound_m()[0] - before < ahead + 1e-3
    assert bench.result(ticket)[0] is None
