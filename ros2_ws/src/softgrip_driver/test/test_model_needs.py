# SPDX-License-Identifier: Apache-2.0
"""Each servo model with the very limits that its table allows: it homes, closes the emulated fingers and holds them."""

import pytest

from softgrip_driver.configuration import checked_configuration
from softgrip_driver.dynamixel.registers import MODELS, CurrentSensing, OperatingMode
from softgrip_driver.errors import ConfigurationError
from softgrip_driver.nodes.tendon_parameters import PARAMETERS
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.motions import DriveState, MoveOutcome
from softgrip_driver.tendon.needs import fitted_limits
from softgrip_emulator.dynamixel.table import load_model

CURRENT = OperatingMode.CURRENT_BASED_POSITION
RADIUS_M = 0.010
#: an XL330's table allows less, but not with the shipped bus watchdog
SHIPPED_RATE_HZ = 100.0
#: [s] by which a hold is longer than a servo's own overload shutdown takes, and of trimming before it
HOLDS_ON_S, TRIMMED_S = 1.0, 2.0
PROVEN = (
    "XL330-M288",
    "XC330-M288",
    "XC330-T288",
    "XM430-W210",
    "XM430-W350",
    "XL430-W250",
    "XC430-W150",
    "XC430-W240",
)


PROVEN_WIDE = ("XM540-W150", "XM540-W270")
#: an XM540's gears hide 25 N on 10 mm; on a larger spool they hide less
WIDE_RADIUS_M = 0.025


def bench_of(name, radius=RADIUS_M):
    needs = MODELS[name].needs
    limits = fitted_limits(TendonLimits(no_reply=0.05), MODELS[name], radius)
    mode = OperatingMode.EXTENDED_POSITION if MODELS[name].senses is CurrentSensing.NONE else CURRENT
    rate = max(needs.loop_rate, SHIPPED_RATE_HZ)
    return {"model": name, "mode": mode, "limits": limits, "rate": rate, "radius": radius}


@pytest.mark.parametrize(
    "bench",
    [*map(bench_of, PROVEN), *(bench_of(name, WIDE_RADIUS_M) for name in PROVEN_WIDE)],
    ids=PROVEN + PROVEN_WIDE,
    indirect=True,
)
def test_a_model_homes_closes_and_holds_within_its_limits(bench):
    limits = bench.controller.drives["index"].limits
    bench.loop.power(on=True)
    outcome, reason = bench.run(bench.loop.call(lambda c, now: c.home(now)), 30.0)
    assert outcome is MoveOutcome.REACHED, reason
    taut = bench.plant.wound_m() - bench.plant.bank.slack_m
    assert [drive.pulled_length_m for drive in bench.loop.snapshot.drives] == pytest.approx(taut, abs=4.5e-4)
    outcome, reason = bench.run(bench.move([0.015], limits.speed))
    assert outcome is MoveOutcome.REACHED, reason
    # What position control leaves over under load is trimmed away after the end of a motion.
    bench.pass_time(TRIMMED_S)
    held = bench.plant.wound_m()
    for seen in bench.pass_time(load_model(bench.model).overload.seconds + HOLDS_ON_S):
        assert [(drive.state, drive.fault) for drive in seen.drives] == [(DriveState.HOLDING, "")] * 3
    assert bench.plant.wound_m() == pytest.approx(held, abs=2e-4)
    assert [drive.pulled_length_m for drive in bench.loop.snapshot.drives] == pytest.approx([0.015] * 3, abs=2e-4)
    assert (bench.plant.bank.tension_n > 1.0).all()


@pytest.mark.parametrize("bench", [bench_of("XM540-W270")], indirect=True)
def test_a_drive_too_strong_for_light_fingers_ends_safely(bench):
    """On 10 mm its gears hide 25 N: homing meets the hard limit, says so, and pulls no harder than a tendon stands."""
    bench.loop.power(on=True)
    ticket = bench.loop.call(lambda c, now: c.home(now))
    pulled = 0.0
    while bench.result(ticket)[0] is None:
        bench.pass_time(0.05)
        pulled = max(pulled, float(bench.plant.bank.tension_n.max()))
    outcome, reason = bench.result(ticket)
    assert outcome is MoveOutcome.FAULT
    assert "tension above the hard limit" in reason
    assert pulled < 60.0


@pytest.mark.parametrize("name", MODELS)
def test_no_tension_is_allowed_that_a_servo_was_seen_to_shut_down_at(name):
    """Of the emulated servo, whose table has it from users (docs/emulator.md): the driver is to stay below."""
    overload = load_model(name).overload
    assert MODELS[name].needs.lasting_share < overload.share


@pytest.mark.parametrize(
    ("model", "changes", "text"),
    [
        (
            "XM430-W210",
            {"homing_tension_n": 2.0, "spool_radii_m": [0.025], "tension_soft_n": 45.0, "acceleration_m_s2": 0.2},
            "tension_soft_n: expected at most 43.2 N, 36% of a XM430-W210's stall on a spool of 25 mm, found 45",
        ),
        ("XM540-W270", {}, "homing_tension_n of at least 25 N"),
        ("XM540-W150", {"homing_tension_n": 25.0}, "speed_m_s of at most 0.02 m/s"),
        ("XM430-W210", {}, "homing_tension_n of at least 4 N"),
        ("XC330-T288", {}, "loop_rate of at least 200 Hz"),
        ("XL430-W250", {"homing_tension_n": 3.0, "operating_mode": 5}, "operating_mode: expected 4 with a XL430-W250"),
        ("XC430-W150", {"homing_tension_n": 3.0, "operating_mode": 5}, "operating_mode: expected 4 with a XC430-W150"),
        ("XC430-W240", {"homing_tension_n": 3.0, "operating_mode": 5}, "operating_mode: expected 4 with a XC430-W240"),
    ],
)
def test_a_model_is_refused_what_it_cannot_do(model, changes, text):
    slow = {"loop_rate": 200.0, "speed_m_s": 0.03, "acceleration_m_s2": 0.05} if changes else {}
    values = {row.name: row.default for row in PARAMETERS.rows} | {"servo_models": [model]} | slow | changes
    with pytest.raises(ConfigurationError, match=text):
        checked_configuration(values)
