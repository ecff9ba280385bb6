# SPDX-License-Identifier: Apache-2.0
"""What servos are told, and in which order: nobody answers orders to a group, so the driver sees to them itself."""

import pytest

from softgrip_driver.dynamixel import registers as reg
from softgrip_driver.tendon.backend import Setpoint


@pytest.fixture
def quiet(bench):
    """A bench whose loop gives no orders of its own."""
    bench.hold_taut(0.0)
    bench.loop._controller.step = lambda *_: {}
    return bench


def sent(bench, monkeypatch, setpoint):
    """Names of the group orders that a setpoint becomes."""
    names = []
    monkeypatch.setattr(bench.bus, "sync_write", lambda item, values: names.append(item.name) if values else None)
    bench.backend.write({"index": setpoint})
    return names


def test_the_tension_limit_goes_out_before_the_position(quiet, monkeypatch):
    """A goal further in must never meet yesterday's higher limit."""
    assert sent(quiet, monkeypatch, Setpoint(0.010, 5.0)) == ["goal current", "goal position"]


def test_without_a_position_only_the_limit_goes_out(quiet, monkeypatch):
    assert sent(quiet, monkeypatch, Setpoint(None, 5.0)) == ["goal current"]


def test_a_tension_limit_that_got_lost_is_told_again(quiet):
    """A group write that nobody heard: the register read back now and then shows it."""
    servo, wanted = quiet.plant.servos[0], quiet.servos[0].current_units(5.0)
    quiet.backend.write({"index": Setpoint(None, 5.0)})
    assert servo.registers.get("goal_current") == wanted
    servo.registers.put("goal_current", 1200)
    for _ in range(40):
        quiet.pass_time(0.02)
        quiet.backend.write({"index": Setpoint(None, 5.0)})
    assert servo.registers.get("goal_current") == wanted


def test_the_last_line_is_drawn_with_the_torque(quiet):
    """Each servo that pulls has its bus watchdog running; 80 ms of silence are 4 of its units."""
    assert [servo.registers.get("bus_watchdog") for servo in quiet.plant.servos] == [4, 4, 4]
    quiet.loop.power(on=False)
    assert [servo.registers.get("bus_watchdog") for servo in quiet.plant.servos] == [0, 0, 0]
    assert quiet.bus.read(1, reg.TORQUE_ENABLE) == 0
