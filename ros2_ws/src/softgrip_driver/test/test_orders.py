# SPDX-License-Identifier: Apache-2.0
"""What servos and stages are told, and in which order.

Nobody answers orders to a group of servos, so the driver sees to them itself. A stage knows no tension limit.
"""

from itertools import pairwise

import pytest

from softgrip_driver.dynamixel import registers as reg
from softgrip_driver.errors import NoReplyError
from softgrip_driver.stage.backend import StageBackend
from softgrip_driver.tendon.backend import Setpoint

INDEX = {"slot": "index"}


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
    servo, requested = quiet.plant.servos[0], quiet.servos[0].current_units(5.0)
    quiet.backend.write({"index": Setpoint(None, 5.0)})
    assert servo.registers.get("goal_current") == requested
    servo.registers.put("goal_current", 1200)
    for _ in range(40):
        quiet.pass_time(0.02)
        quiet.backend.write({"index": Setpoint(None, 5.0)})
    assert servo.registers.get("goal_current") == requested


def test_the_last_line_is_drawn_with_the_torque(quiet):
    """Each servo that pulls has its bus watchdog running; 80 ms of silence are 4 of its units."""
    assert [servo.registers.get("bus_watchdog") for servo in quiet.plant.servos] == [4, 4, 4]
    quiet.loop.power(on=False)
    assert [servo.registers.get("bus_watchdog") for servo in quiet.plant.servos] == [0, 0, 0]
    assert quiet.bus.read(1, reg.TORQUE_ENABLE) == 0


@pytest.mark.parametrize("bench", [{"rate": 400.0}], indirect=True)
def test_a_silent_servo_does_not_slow_the_others_down(bench):
    """It is left out of the group read, and asked now and then; waiting for it would cost 4 ms in every cycle."""
    bench.hold_taut(0.0)
    bench.cause("servo_silent", slot="middle")
    assert bench.until(lambda _: bench.drive("middle").fault == "no_reply")
    seen = bench.pass_time(1.0)
    assert len(seen) > 250


@pytest.mark.parametrize("bench", [{"rate": 100.0}], indirect=True)
@pytest.mark.parametrize(
    ("cause", "arguments", "periods"),
    [
        ("servo_silent", INDEX, 1), ("wrong_baud", INDEX, 1), ("silent_reboot", INDEX, 1), ("overload", INDEX, 1),
        ("alert", INDEX, 1), ("brown_out", {}, 1), ("bus_dead", {}, 1), ("crc_error", {}, 1), ("bus_unplugged", {}, 1),
        ("bytes_delayed", {"delay_s": 0.1}, 2), ("bytes_lost", {"share": 0.01}, 2),
        ("bytes_flipped", {"share": 0.01}, 2),
    ],
)  # fmt: skip
def test_nothing_that_is_asked_keeps_the_loop_for_longer_than_its_period(bench, cause, arguments, periods):
    """At the driver's own rate, from the cause until all is well; two periods where every question may go wrong."""
    bench.hold_taut(8.0)
    bench.cause(cause, **arguments)
    seen = bench.pass_time(1.5)
    bench.clear()
    seen += bench.pass_time(1.0)
    assert max(b.time - a.time for a, b in pairwise(seen)) < 0.010 * periods + 1e-6


def test_servos_that_wait_for_the_rest_of_a_damaged_packet_are_woken(bench):
    """Of "read 1 byte" the low byte of the length was lost: 02 00 02 is a packet of 512 bytes for all who listen."""
    bench.hold_taut(0.0)
    lost = bench.backend.counters.lost
    bench.bus_wire.exchange(
        bytes.fromhex("ff ff fd 00 02 00 02 62 00 01 00 39 c3"), bench.now(), bench.bus.port.baudrate
    )
    seen = bench.pass_time(0.3)
    assert bench.backend.counters.lost > lost + 3, "nobody was deaf: the test shows nothing"
    assert {drive.fault for one in seen for drive in one.drives} == {""}


class Stage:
    """Notes what it is told."""

    def __init__(self):
        self.goals = []

    def travel(self):
        return 0.001 * len(self.goals)

    def start(self, goal, _speed):
        self.goals.append(goal)

    def stop(self):
        self.goals.append("stop")


class Gauge:
    """Reads 1 N, or nothing."""

    silent = False

    def tension(self):
        if self.silent:
            raise NoReplyError("gauge: found silence")
        return 1.0


@pytest.fixture
def stage():
    return Stage()


@pytest.fixture
def pull(stage):
    """A stage under way to 20 mm, and its gauge."""
    gauge = Gauge()
    backend = StageBackend("pull", stage, gauge, 0.01)
    backend.power("pull", True)
    goals(backend, stage, Setpoint(0.020, 20.0))
    assert stage.goals == ["stop", 0.020]
    return backend, gauge


def goals(backend, stage, setpoint):
    """What one cycle tells the stage."""
    before = len(stage.goals)
    backend.read()
    backend.write({"pull": setpoint})
    return stage.goals[before:]


def test_a_stage_stops_at_the_first_reading_that_its_gauge_owes(stage, pull):
    """One missing line is no fault yet, but nobody pulls blind meanwhile."""
    backend, gauge = pull
    gauge.silent = True
    assert goals(backend, stage, Setpoint(0.021, 20.0)) == ["stop"]
    gauge.silent = False
    assert goals(backend, stage, Setpoint(0.022, 20.0)) == [0.022]


def test_a_stage_stops_at_the_tension_limit_and_may_always_let_out(stage, pull):
    backend, _ = pull
    assert goals(backend, stage, Setpoint(0.021, 0.5)) == ["stop"]
    assert goals(backend, stage, Setpoint(0.0, 0.5)) == [0.0]


def test_a_stage_without_a_goal_stops_once(stage, pull):
    backend, _ = pull
    assert goals(backend, stage, Setpoint(None, 20.0)) == ["stop"]
    assert goals(backend, stage, Setpoint(None, 20.0)) == []
