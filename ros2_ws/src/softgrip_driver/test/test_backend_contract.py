# SPDX-License-Identifier: Apache-2.0
"""One contract over every tendon backend, each against its emulated device: servo models and modes, stand, stage.

An installed package adds its own by an entry point in the group `softgrip.drive_contracts`: a class that is made with a
folder and a world, and has what `StageDevice` has (docs/how-to/write-a-backend.md).
"""

from importlib.metadata import entry_points

import pytest

from softgrip_driver.dynamixel.registers import MODELS, CurrentSensing, OperatingMode
from softgrip_driver.errors import DriverError, PortLostError
from softgrip_driver.rig.build import StreamSettings, make_gauge, make_stage
from softgrip_driver.stage.backend import StageBackend
from softgrip_driver.tendon.backend import Setpoint
from softgrip_emulator.rig import EmulatedRig
from softgrip_emulator.rig.truth import RigTruth
from softgrip_testing.spring_plant import SpringPlant

CURRENT, EXTENDED = OperatingMode.CURRENT_BASED_POSITION, OperatingMode.EXTENDED_POSITION
#: every model that the driver knows, in the mode that is asked of it
SERVOS = [
    *((name, CURRENT) for name, model in MODELS.items() if model.senses is not CurrentSensing.NONE),
    *((name, EXTENDED) for name, model in MODELS.items() if model.senses is CurrentSensing.NONE),
    ("XL330-M288", EXTENDED), ("XM430-W350", EXTENDED), ("STS3215", CURRENT), ("DM-J4310-2EC", CURRENT),
]  # fmt: skip
#: [m] an XM540 wants a large spool (docs/driver.md)
SPOOL_M = {"XM540-W150": 0.025, "XM540-W270": 0.025}
STAGES = [("mark10", "gcl2"), ("grbl", "newtons")]
MOVED = 0.004


class ServoDevice:
    """The servos of the bench, without its loop."""

    #: [m] the servo's own control leaves a little under the fingers' load
    tolerance = 1e-3

    def __init__(self, request, model, mode):
        self.bench = request.getfixturevalue("bench")
        self.world = self.bench.world
        self.bench.loop.stop()
        self.backend, self.name = self.bench.backend, "index"
        self.backend.disconnect()
        # An XL430 or XC430 has no mode 5: its goal PWM limits what position control puts out.
        self.limits_tension = mode is CURRENT or MODELS[model].senses is CurrentSensing.NONE
        #: [N] above what the gears' friction is worth where it matters, and the share that it and the torque may be off
        self.limit = 3.0 if not self.limits_tension else 6.0 if "330" in model else 15.0
        self.tension_error = 0.5

    def tension(self):
        return float(self.bench.plant.bank.tension_n[0])

    def pulls(self):
        return self.bench.plant.servos[0].holds

    def fall_silent(self):
        self.bench.cause("bus_dead")

    def unplug(self):
        self.bench.cause("bus_unplugged")

    def recover(self):
        self.bench.clear()

    def close(self):
        pass


class StageDevice:
    """A stage of the emulated rig on a springy tendon, with its gauge."""

    tolerance = 5e-4
    limits_tension = True
    limit = 6.0
    #: it goes on until the gauge was read again
    tension_error = 0.5

    def __init__(self, tmp_path, world, stage, gauge):
        self.world = world
        self.rig = EmulatedRig(1, stage=stage, gauge=gauge, plant=SpringPlant(RigTruth.from_seed(1)), clock=world.clock)
        self.rig.open_ports(tmp_path, world.port)
        stream = StreamSettings(line=gauge)
        self.backend, self.name = (
            StageBackend(
                "pull",
                make_stage(stage, str(tmp_path / "stand")),
                make_gauge("gcl2" if gauge == "gcl2" else "stream", str(tmp_path / "gauge"), stream),
                0.005,
            ),
            "pull",
        )

    def tension(self):
        return self.rig.plant.force

    def pulls(self):
        self.rig.plant.advance(self.rig.clock.now_s())
        return self.rig.plant.velocity != 0.0

    def fall_silent(self):
        self.rig.inject("stand_silent")

    def unplug(self):
        self.rig.inject("unplugged", port="stand")

    def recover(self):
        self.rig.clear()

    def close(self):
        self.rig.close()


def pytest_generate_tests(metafunc):
    if "device" not in metafunc.fixturenames:
        return
    kinds = [("servo", *row) for row in SERVOS] + [("stage", *row) for row in STAGES]
    kinds += [("installed", one.name, one) for one in entry_points(group="softgrip.drive_contracts")]
    benches = [
        {"model": kind[1], "mode": kind[2], "radius": SPOOL_M.get(kind[1], 0.010)} if kind[0] == "servo" else {}
        for kind in kinds
    ]
    names = [f"{model} mode {mode}" if kind == "servo" else model for kind, model, mode in kinds]
    # The bench opens its port only when a servo device asks for it.
    metafunc.parametrize(("kind", "bench_settings"), list(zip(kinds, benches, strict=True)), ids=names)


@pytest.fixture
def bench_settings():
    return {}


@pytest.fixture
def device(request, kind, bench_settings, tmp_path, world):
    one = {
        "servo": lambda: ServoDevice(request, *kind[1:]),
        "stage": lambda: StageDevice(tmp_path, world, *kind[1:]),
        "installed": lambda: kind[2].load()(tmp_path, world),
    }[kind[0]]()
    yield one
    one.recover()
    one.backend.disconnect()
    one.close()


def wait(device, condition, deadline=8.0):
    """Read until a condition holds."""
    end = device.world.now() + deadline
    reading = None
    while device.world.now() < end:
        device.world.breathe()
        reading = device.backend.read().get(device.name, reading)
        if reading is not None and condition(reading):
            return reading
    return pytest.fail(f"not within {deadline} s; last reading {reading}")


def drive_to(device, goal, tension_limit, done, deadline=8.0, begin=None):
    """Send a setpoint each cycle, moving from ``begin`` at 15 mm/s, until something holds; the last reading."""
    began = device.world.now()
    end = began + deadline
    reading = None
    while (now := device.world.now()) < end:
        device.world.breathe()
        setpoint = goal if begin is None else min(goal, begin + 0.015 * (now - began))
        device.backend.write({device.name: Setpoint(setpoint, tension_limit)})
        reading = device.backend.read().get(device.name, reading)
        if reading is not None and done(reading):
            return reading
    return reading


def start(device):
    """Connect, power, and return the position."""
    device.backend.connect()
    position = wait(device, lambda now: now.powered is False).position
    device.backend.power(device.name, True)
    wait(device, lambda now: now.powered)
    return position


def test_it_connects_says_who_it_is_and_holds_nothing(device):
    names = [identity.tendon for identity in device.backend.connect()]
    assert device.name in names
    assert tuple(names) == tuple(device.backend.tendons)
    reading = wait(device, lambda now: now.powered is not None)
    assert reading.powered is False
    assert reading.tension >= 0.0
    assert not device.pulls()


def test_it_moves_only_with_power_and_to_its_setpoint(device):
    device.backend.connect()
    begin = wait(device, lambda now: now.powered is False).position
    goal = begin + MOVED
    device.backend.write({device.name: Setpoint(goal, 20.0)})
    assert wait(device, lambda _: True).position == pytest.approx(begin, abs=device.tolerance)
    device.backend.power(device.name, True)
    wait(device, lambda now: now.powered)
    reading = drive_to(device, goal, 20.0, lambda now: abs(now.position - goal) < device.tolerance)
    assert reading.position == pytest.approx(goal, abs=device.tolerance)


def test_it_keeps_a_tension_limit_by_itself_where_the_device_can(device):
    begin = start(device)
    limit = device.limit
    until = device.world.now() + 1.7
    drive_to(device, begin + 0.02, limit, lambda _: device.world.now() > until, begin=begin)
    if device.limits_tension:
        assert 0.5 * limit < device.tension() < (1.0 + device.tension_error) * limit
    else:
        # Extended position: the servo pulls as hard as it can; the controller's own limit is the only one.
        assert device.tension() > (1.0 + device.tension_error) * limit


def test_letting_go_ends_the_pull(device):
    begin = start(device)
    drive_to(device, begin + 0.02, 20.0, lambda now: now.position > begin + 0.001)
    device.backend.power(device.name, False)
    assert wait(device, lambda now: now.powered is False)
    assert not device.pulls()


def test_disconnecting_leaves_it_safe(device):
    begin = start(device)
    drive_to(device, begin + 0.02, 20.0, lambda now: now.position > begin + 0.001)
    device.backend.disconnect()
    deadline = device.world.now() + 3.0
    while device.pulls():
        assert device.world.now() < deadline
        device.world.breathe()


def test_silence_gives_no_reading_is_counted_and_ends(device):
    device.backend.connect()
    wait(device, lambda _: True)
    lost = device.backend.counters.lost
    device.fall_silent()
    end = device.world.now() + 8.0
    while device.backend.read():
        assert device.world.now() < end, "a silent device gave readings"
    assert device.backend.counters.lost > lost
    device.recover()
    assert wait(device, lambda _: True)


def test_an_unplugged_port_is_told_and_taken_up_again(device):
    device.backend.connect()
    wait(device, lambda _: True)
    device.unplug()
    with pytest.raises(PortLostError, match="plug"):
        wait(device, lambda _: False, 3.0)
    assert not device.backend.reconnect()
    device.recover()
    assert device.backend.reconnect()
    assert device.backend.counters.reopened == 1
    assert wait(device, lambda _: True)


def test_a_session_mark_lasts_as_long_as_the_device_knows_its_turns(device):
    device.backend.connect()
    device.backend.mark_session(device.name, 9)
    assert wait(device, lambda now: now.session_mark is not None).session_mark == 9
    for _ in device.backend.restore(device.name):
        device.world.breathe()
    assert wait(device, lambda now: now.session_mark is not None).session_mark != 9


def test_letting_go_and_closing_may_be_repeated(device):
    device.backend.connect()
    device.backend.power(device.name, True)
    device.backend.power(device.name, False)
    device.backend.power(device.name, False)
    device.backend.disconnect()
    device.backend.disconnect()
    assert [identity.tendon for identity in device.backend.connect()]


def test_connecting_to_nothing_says_where_and_what_to_check(device):
    device.unplug()
    with pytest.raises(DriverError, match=r"port .*(servos|stand)"):
        device.backend.connect()
    device.recover()
    device.backend.connect()
