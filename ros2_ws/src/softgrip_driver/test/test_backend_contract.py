# SPDX-License-Identifier: Apache-2.0
"""One contract over every tendon backend, each against its emulated device."""

import time

import pytest

from softgrip_driver.rig.build import make_gauge, make_stage
from softgrip_driver.stage.backend import StageBackend
from softgrip_driver.tendon.backend import Setpoint
from softgrip_emulator.rig import EmulatedRig


class Dynamixel:
    """The servo of the bench, without its loop."""

    tolerance, moved = 1e-3, 0.004

    def __init__(self, request, _):
        self.bench = request.getfixturevalue("bench")
        self.bench.loop.stop()
        self.backend, self.name = self.bench.backend, "index"
        self.backend.disconnect()

    def close(self):
        pass


class Stand:
    """The test stand of the emulated rig, with its gauge."""

    tolerance, moved = 5e-4, 0.004

    def __init__(self, _, tmp_path):
        self.rig = EmulatedRig(1, 1.0)
        self.rig.open_ports(tmp_path)
        stage, gauge = make_stage("mark10", str(tmp_path / "stand")), make_gauge("gcl2", str(tmp_path / "gauge"))
        self.backend, self.name = StageBackend("pull", stage, gauge, 0.005), "pull"

    def close(self):
        self.rig.close()


@pytest.fixture(params=[Dynamixel, Stand], ids=lambda kind: kind.__name__.lower())
def device(request, tmp_path):
    one = request.param(request, tmp_path)
    yield one
    one.backend.disconnect()
    one.close()


def wait(device, condition, deadline=8.0):
    """Read until a condition holds."""
    end = time.monotonic() + deadline
    reading = None
    while time.monotonic() < end:
        reading = device.backend.read().get(device.name, reading)
        if reading is not None and condition(reading):
            return reading
    return pytest.fail(f"not within {deadline} s; last reading {reading}")


def test_it_connects_says_who_it_is_and_holds_nothing(device):
    names = [identity.tendon for identity in device.backend.connect()]
    assert device.name in names
    assert tuple(names) == tuple(device.backend.tendons)
    reading = wait(device, lambda now: now.powered is not None)
    assert reading.powered is False
    assert reading.tension >= 0.0


def test_it_moves_only_with_power_and_to_its_setpoint(device):
    device.backend.connect()
    start = wait(device, lambda now: now.powered is False).position
    goal = start + device.moved
    device.backend.write({device.name: Setpoint(goal, 20.0)})
    assert wait(device, lambda _: True).position == pytest.approx(start, abs=device.tolerance)
    device.backend.power(device.name, True)
    wait(device, lambda now: now.powered)
    end = time.monotonic() + 8.0
    while time.monotonic() < end:
        device.backend.write({device.name: Setpoint(goal, 20.0)})
        reading = device.backend.read().get(device.name)
        if reading is not None and abs(reading.position - goal) < device.tolerance:
            break
    assert reading.position == pytest.approx(goal, abs=device.tolerance)


def test_a_session_mark_lasts_as_long_as_the_device_knows_its_turns(device):
    device.backend.connect()
    device.backend.mark_session(device.name, 9)
    assert wait(device, lambda now: now.session_mark is not None).session_mark == 9
    for _ in device.backend.restore(device.name):
        pass
    assert wait(device, lambda now: now.session_mark is not None).session_mark != 9


def test_letting_go_and_closing_may_be_repeated(device):
    device.backend.connect()
    device.backend.power(device.name, True)
    device.backend.power(device.name, False)
    device.backend.power(device.name, False)
    device.backend.disconnect()
    device.backend.disconnect()
    assert [identity.tendon for identity in device.backend.connect()]
