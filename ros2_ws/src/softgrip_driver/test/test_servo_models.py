# SPDX-License-Identifier: Apache-2.0
"""What differs between servo models and operating modes: bring-up of a servo in any state, units, whole moves."""

import struct
from dataclasses import replace

import numpy as np
import pytest

from softgrip_driver.dynamixel import registers as reg
from softgrip_driver.dynamixel.backend import DynamixelBackend
from softgrip_driver.dynamixel.bringup import ServoConfiguration, identify, required_eeprom, set_up
from softgrip_driver.dynamixel.bus import Bus
from softgrip_driver.dynamixel.registers import MODELS, CurrentSensing, OperatingMode
from softgrip_driver.errors import ConfigurationError, DeviceNotFoundError, DriverError, WrongDeviceError
from softgrip_driver.tendon.gripper import MoveMode
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.motions import DriveState, MoveOutcome
from softgrip_driver.tendon.trajectory import TendonTrajectory
from softgrip_driver.tendon.units import Spool, TorqueModel
from softgrip_emulator.dynamixel.chain import DynamixelChain
from softgrip_emulator.dynamixel.servo import EmulatedServo
from softgrip_emulator.dynamixel.table import load_model

CURRENT, EXTENDED = OperatingMode.CURRENT_BASED_POSITION, OperatingMode.EXTENDED_POSITION
TENDONS = ("index", "middle", "thumb")
SYNC_READ, FAST_SYNC_READ = 0x82, 0x8A
WITH_CURRENT = [name for name, model in MODELS.items() if model.senses is not CurrentSensing.NONE]


def servo_of(model, mode=None):
    """A servo in a mode; in current-based position control where the model has it."""
    table = MODELS[model]
    mode = mode or (EXTENDED if table.senses is CurrentSensing.NONE else CURRENT)
    return ServoConfiguration(
        "t", 1, table, Spool(0.01, 1), TorqueModel(table.torque_per_ampere, table.no_load_current), mode
    )


@pytest.fixture(params=MODELS)
def wired(request, tmp_path, world):
    """A servo as it comes out of the box, on a port, and the bus to it."""
    device = EmulatedServo(load_model(request.param), 1, baud=1_000_000)
    port = world.port(tmp_path / "servos", DynamixelChain([device]))
    bus = Bus(str(tmp_path / "servos"), 1_000_000)
    bus.open()
    yield request.param, device, bus
    bus.close()
    port.close()
    world.close()


@pytest.fixture
def two(tmp_path, world):
    """Two servos out of the box, their tables as far as they last, and a backend for them and what it reports."""
    devices = [EmulatedServo(load_model("XL330-M288"), number, baud=1_000_000) for number in (1, 2)]
    port = world.port(tmp_path / "servos", DynamixelChain(devices))
    reports = []

    def lasting():
        return [bytes(device.registers.snapshot()[7:64]) for device in devices]

    def backend(second=2, **options):
        bus = Bus(str(tmp_path / "servos"), 1_000_000)
        servos = [replace(servo_of("XL330-M288"), tendon="one"), replace(servo_of("XL330-M288"), servo_id=second)]
        return DynamixelBackend(bus, servos, report=lambda text: reports.append((text, lasting())), **options)

    yield devices, lasting, reports, backend
    port.close()
    world.close()


@pytest.fixture
def taut(bench):
    """A bench whose drives are held and know the true zero."""
    bench.hold_taut(0.0)
    return bench


# model, unit of current [A], raw current limit, stall tension [N] on a spool of 10 mm, temperature limit: e-manual
@pytest.mark.parametrize(
    ("model", "unit", "limit", "stall", "hot"),
    [
        ("XL330-M288", 0.001, 1750, 52.0, 70.0),
        ("XC330-M288", 0.001, 2352, 93.0, 70.0),
        ("XC330-T288", 0.001, 910, 92.0, 70.0),
        ("XM430-W350", 0.00269, 1193, 410.0, 80.0),
    ],
)
def test_units_and_limits_of_the_data_sheets(model, unit, limit, stall, hot):
    table = MODELS[model]
    assert (table.ampere_per_unit, table.current_limit_units, table.temperature_limit) == (unit, limit, hot)
    assert table.torque_per_ampere * table.stall_current / 0.01 == pytest.approx(stall)
    servo = servo_of(model)
    block = struct.pack("<hhi", 0, 100, 0)
    assert servo.motor_reading(block, 5.0, 25.0).current == pytest.approx(100 * unit)
    # A limit beyond the servo's own is the servo's own, a tenth above the hard limit of 45 N; it would refuse more.
    assert servo.current_units(10_000.0) == servo.current_units(49.5) <= limit


@pytest.mark.parametrize("wired", WITH_CURRENT, indirect=True)
@pytest.mark.parametrize("mode", [CURRENT, EXTENDED])
def test_bring_up_from_factory_settings(wired, mode):
    model, device, bus = wired
    assert device.registers.get("operating_mode") == 3
    servo = servo_of(model, mode)
    corrected = [text for text in set_up(bus, servo, write_eeprom=True) if text]
    assert any("operating mode is 3, needs " + str(int(mode)) in text for text in corrected)
    assert any("return delay time is 250, needs 0" in text for text in corrected)
    for item, value in required_eeprom(servo).items():
        assert bus.read(1, item) == value
    # A change of mode puts the goal current to its limit and the profile to 0; both are written after it.
    assert bus.read(1, reg.GOAL_CURRENT) == servo.current_units(0.0) < bus.read(1, reg.CURRENT_LIMIT)
    assert bus.read(1, reg.PROFILE_VELOCITY) > 0
    assert bus.read(1, reg.TORQUE_ENABLE) == 0


@pytest.mark.parametrize(
    ("servos", "text"),
    [
        (
            [(1, 57_600), (2, 57_600)],
            r"ID 1, 2 at 57600 baud \(as new\); set each with .*setup --port .* --new-baud 1000000",
        ),
        (
            [(1, 1_000_000), (3, 1_000_000), (1, 57_600)],
            r"ID 1, 3 instead, and ID 1 at 57600 baud \(as new\); set each with .*setup --port .* --new-baud 1000000",
        ),
        ([(7, 1_000_000)], r"ID 7 instead; press in the plugs .* correct its `id` in the cell file .*setup --new-id"),
        ([(7, 1_000_000), (7, 1_000_000)], r"several servos with ID 7; connect them one at a time"),
        ([], r"nobody at any baud rate; check that the servos' supply is on .*LED stays lit.*DYNAMIXEL Wizard"),
    ],
    ids=["factory baud rate", "one at the factory's beside others", "another ID", "one ID for two", "boot loader"],
)
def test_a_servo_that_is_not_there_is_looked_for_and_the_way_to_it_named(tmp_path, world, servos, text):
    devices = [EmulatedServo(load_model("XL330-M288"), number, baud=baud) for number, baud in servos]
    for turned, device in enumerate(devices):
        device.shaft.angle_rad = 1.0 + turned
    port = world.port(tmp_path / "servos", DynamixelChain(devices))
    bus = Bus(str(tmp_path / "servos"), 1_000_000)
    bus.open()
    with pytest.raises(DeviceNotFoundError, match=text):
        identify(bus, replace(servo_of("XL330-M288"), servo_id=9))
    bus.close()
    port.close()
    world.close()


@pytest.mark.parametrize("wired", WITH_CURRENT, indirect=True)
def test_bring_up_a_second_time_changes_nothing_that_is_kept(wired):
    model, device, bus = wired
    list(set_up(bus, servo_of(model), write_eeprom=True))
    device.shaft.angle_rad += 40.0
    turns = bus.read(1, reg.PRESENT_POSITION)
    bus.write(1, reg.GOAL_PWM, bus.read(1, reg.PWM_LIMIT) - 5)
    assert not [text for text in set_up(bus, servo_of(model), write_eeprom=True) if text]
    assert bus.read(1, reg.PRESENT_POSITION) == turns
    assert bus.read(1, reg.GOAL_PWM) == bus.read(1, reg.PWM_LIMIT) - 5


def test_bring_up_of_a_servo_that_holds_lets_go_first(wired):
    model, _, bus = wired
    bus.write(1, reg.TORQUE_ENABLE, 1)
    list(set_up(bus, servo_of(model), write_eeprom=True))
    assert bus.read(1, reg.TORQUE_ENABLE) == 0


@pytest.mark.parametrize("level", [0, 1])
def test_bring_up_of_a_servo_that_was_told_not_to_answer(wired, level):
    model, _, bus = wired
    bus.sync_write(reg.STATUS_RETURN_LEVEL, {1: level})
    list(set_up(bus, servo_of(model), write_eeprom=True))
    assert bus.read(1, reg.STATUS_RETURN_LEVEL) == 2


def test_a_supply_that_sags_does_not_open_a_hand(wired):
    """The XL330 cuts its torque then by factory setting; a servo that was brought up only tells."""
    model, device, bus = wired
    list(set_up(bus, servo_of(model), write_eeprom=True))
    bus.write(1, reg.TORQUE_ENABLE, 1)
    device.forced_error_bits = 0x01
    device.step(0.0, 0.001)
    assert bus.read(1, reg.HARDWARE_ERROR) == 0x01
    assert bus.read(1, reg.TORQUE_ENABLE) == 1


def test_a_servo_that_would_let_go_before_it_is_too_warm_for_the_driver_is_corrected(wired):
    """The driver reduces the tension 15 degC below the servo's limit, and stops 5 below; the e-manual's is the most."""
    model, _, bus = wired
    factory = bus.read(1, reg.TEMPERATURE_LIMIT)
    bus.write(1, reg.TEMPERATURE_LIMIT, 50)
    corrected = list(set_up(bus, servo_of(model), write_eeprom=True))
    assert any(f"temperature limit is 50, needs {factory}" in text for text in corrected)
    assert bus.read(1, reg.TEMPERATURE_LIMIT) == factory


def test_settings_are_reported_and_left_alone_where_writing_is_not_allowed(wired):
    model, device, bus = wired
    with pytest.raises(ConfigurationError, match=r"return delay time is 250, needs 0;.*set write_eeprom"):
        list(set_up(bus, servo_of(model), write_eeprom=False))
    assert device.registers.get("return_delay_time") == 250


def test_what_differs_is_reported_before_any_of_it_is_written(two):
    devices, lasting, reports, backend = two
    factory = lasting()
    one = backend()
    one.connect()
    one.disconnect()
    assert reports[0][0] == "tendon 'one', ID 1: return delay time is 250, needs 0; it is written now"
    for number in (1, 2):
        reported = [text for text, _ in reports if f"ID {number}:" in text]
        assert sum("operating mode is 3, needs 5" in text for text in reported) == 1
    assert all(then == factory for _, then in reports)
    assert [device.registers.get("operating_mode") for device in devices] == [5, 5]
    reports.clear()
    one.connect()
    one.disconnect()
    assert reports == []


@pytest.mark.parametrize(
    ("spoil", "options", "text"),
    [
        (lambda _: None, {"second": 9}, "ID 9"),
        (lambda devices: setattr(devices[1], "forced_error_bits", 0x20), {}, "OVERLOAD"),
        (lambda _: None, {"write_eeprom": False}, "ID 1: return delay.*ID 2: return delay.*set write_eeprom"),
    ],
    ids=["a servo is missing", "a servo is in error", "not allowed"],
)
def test_no_servo_is_changed_for_good_unless_all_are_there_and_well(two, spoil, options, text):
    """The port may be that of another machine."""
    devices, lasting, reports, backend = two
    factory = lasting()
    spoil(devices)
    for device in devices:
        device.step(0.0, 0.001)
    with pytest.raises(DriverError, match=text):
        backend(**options).connect()
    assert lasting() == factory
    assert reports == []


@pytest.mark.parametrize(
    ("model", "firmwares", "instruction"),
    [
        ("XL330-M288", (46, 52), FAST_SYNC_READ),
        ("XL330-M288", (45, 52), SYNC_READ),
        ("XM430-W350", (45, 45), FAST_SYNC_READ),
        ("XM430-W350", (44, 44), SYNC_READ),
    ],
)
def test_the_group_is_read_the_fast_way_where_every_firmware_has_it(model, firmwares, instruction, tmp_path, world):
    numbered = list(enumerate(firmwares, start=1))
    devices = [EmulatedServo(replace(load_model(model), firmware=each), i, baud=1_000_000) for i, each in numbered]
    chain, sent = DynamixelChain(devices), []
    port = world.port(tmp_path / "servos", chain)
    answer = chain.exchange
    chain.exchange = lambda data, *rest: (sent.append(data[7]) if len(data) > 7 else None, answer(data, *rest))[1]
    servos = [replace(servo_of(model), tendon=f"t{i}", servo_id=i) for i, _ in numbered]
    backend = DynamixelBackend(Bus(str(tmp_path / "servos"), 1_000_000), servos)
    backend.connect()
    sent.clear()
    assert set(backend.read()) == {"t1", "t2"}
    assert [one for one in sent if one in {SYNC_READ, FAST_SYNC_READ}] == [instruction]
    assert backend.counters.lost == 0
    backend.disconnect()
    port.close()
    world.close()


def test_a_servo_with_a_hardware_error_is_not_set_up(wired):
    model, device, bus = wired
    device.forced_error_bits = 0x20
    device.step(0.0, 0.001)
    with pytest.raises(WrongDeviceError, match=r"OVERLOAD.*remove the cause, then reboot"):
        list(set_up(bus, servo_of(model), write_eeprom=True))


#: A big motor on a small spool shows its own inertia as tension, so it is brought up to speed gently; what its gears
#: hide is no slack and no break.
GENTLE = TendonLimits(no_reply=0.3, speed=0.02, acceleration=0.05)
STRONG = replace(GENTLE, tension_soft=80.0, tension_hard=100.0, break_drop_from=40.0)
WHOLE = [
    {"model": "XL330-M288"}, {"model": "XL330-M288", "mode": EXTENDED}, {"model": "XC330-M288", "limits": GENTLE},
    {"model": "XM430-W350", "limits": STRONG},
]  # fmt: skip


@pytest.mark.parametrize(
    "bench", WHOLE, ids=lambda row: f"{row['model']} {row.get('mode', CURRENT).name.lower()}", indirect=True
)
def test_moves_and_a_tension_limit_on_every_model(taut):
    """Also where the servo itself has no limit (extended position): the controller stops at what it measures."""
    outcome, reason = taut.run(taut.move([0.007], 0.01))
    assert outcome is MoveOutcome.REACHED, reason
    limit = 20.0 if taut.controller.drives["index"].limits is STRONG else 12.0
    outcome, reason = taut.run(taut.move([0.034], 0.01, limit, ["index"]))
    assert outcome is MoveOutcome.TENSION_LIMIT, reason
    # Twice what the gears' friction may hide, and the torque constant's own error.
    assert taut.plant.bank.tension_n[0] == pytest.approx(limit, abs=0.5 * limit)


def test_homing_finds_the_truth(bench):
    """The zero is where the emulated finger's slack is taken up, as far as a motor's current can tell."""
    bench.loop.power(on=True)
    outcome, reason = bench.run(bench.loop.call(lambda controller, now: controller.home(now)), 25.0)
    assert outcome is MoveOutcome.REACHED, reason
    slack = bench.plant.bank.slack_m - bench.plant.wound_m()
    for index, name in enumerate(TENDONS):
        drive = bench.controller.drives[name]
        assert drive.zero == pytest.approx(drive.position + slack[index], abs=1e-3)


@pytest.mark.parametrize("bench", [{"grippers": {"index": "left", "middle": "left", "thumb": "right"}}], indirect=True)
def test_two_grippers_on_one_bus(taut):
    """A broken tendon stops and opens its own gripper; the other one goes on as if nothing had been."""
    outcome, reason = taut.run(taut.move([8.0], mode=MoveMode.TENSION))
    assert outcome is MoveOutcome.REACHED, reason
    taut.pass_time(0.4)
    other = taut.move([0.012], 0.002, tendons=["thumb"])
    taut.cause("tendon_break", slot="index")
    taut.pass_time(0.3)
    assert taut.drive("index").fault == "tendon_broken"
    assert taut.drive("middle").state is DriveState.RELEASING
    assert taut.drive("thumb").fault == ""
    outcome, reason = taut.run(other)
    assert outcome is not MoveOutcome.FAULT, reason


def test_a_streamed_trajectory_reaches_the_servos_within_its_limits(taut):
    """Points sent ahead of time again and again, as a planner does, over the emulated bus."""
    taut.run(taut.move([0.004]))
    lengths, seen = [], []
    taut.world.live(lambda _: lengths.append(float(taut.plant.wound_m()[0] - taut.plant.bank.slack_m[0])))
    for step in range(1, 9):
        trajectory = TendonTrajectory.checked([0.1], [0.004 + 0.001 * step], [], 0.035, 0.05)
        ticket = taut.loop.call(lambda controller, now, one=trajectory: controller.follow({"index": one}, now))
        assert not ticket.refusal
        seen += taut.pass_time(0.1)
    seen += taut.watched(ticket)
    assert lengths[-1] == pytest.approx(0.012, abs=1.0e-3)
    assert np.diff(lengths).min() > -3e-4, "it never steps back"
    assert max(abs(one.drives[0].speed) for one in seen) < TendonLimits().speed


@pytest.mark.parametrize("bench", [{}, {"mode": EXTENDED}], indirect=True)
def test_a_move_does_not_overshoot(taut):
    """20 mm at 20 mm/s: what a servo is behind while it moves goes by itself when it stops."""
    for start, end in ((0.002, 0.022), (0.022, 0.002)):
        outcome, reason = taut.run(taut.move([start], tendons=["index", "middle"]))
        assert outcome is MoveOutcome.REACHED, reason
        taut.pass_time(0.5)
        seen = taut.watched(taut.move([end], 0.02, tendons=["index", "middle"])) + taut.pass_time(1.0)
        direction = 1.0 if end > start else -1.0
        for index in (0, 1):
            beyond = max(direction * (one.drives[index].pulled_length_m - end) for one in seen)
            assert beyond < 1e-4
            assert seen[-1].drives[index].pulled_length_m == pytest.approx(end, abs=1e-4)


@pytest.mark.parametrize("bench", [{}, {"mode": EXTENDED}], indirect=True)
@pytest.mark.parametrize(
    ("first", "then"),
    [
        ({"targets": [8.0], "mode": MoveMode.TENSION}, {"targets": [12.0], "mode": MoveMode.TENSION}),
        ({"targets": [0.030], "tension_limit": 8.0}, {"targets": [12.0], "mode": MoveMode.TENSION}),
        ({"targets": [8.0], "mode": MoveMode.TENSION}, {"targets": [0.030], "tension_limit": 14.0}),
        ({"targets": [8.0], "mode": MoveMode.TENSION}, {"targets": [8.0], "mode": MoveMode.TENSION}),
        ({"targets": [10.0], "mode": MoveMode.TENSION}, {"targets": [8.0], "mode": MoveMode.TENSION}),
        ({"targets": [20.0], "mode": MoveMode.TENSION}, {"targets": [15.0], "mode": MoveMode.TENSION}),
    ],
    ids=["tension to tension", "limit to tension", "tension to length", "the same again", "less", "much less"],
)
def test_a_taut_finger_stays_taut_when_the_next_move_begins(taut, first, then):
    """The true tension goes from where it is to what is asked: never below both by more than a sixth."""
    names = ["index", "thumb"]
    outcome, reason = taut.run(taut.move(**first, speed=0.03, tendons=names))
    assert outcome in {MoveOutcome.REACHED, MoveOutcome.TENSION_LIMIT}, reason
    taut.pass_time(0.5)
    before = taut.plant.bank.tension_n.copy()
    tensions = []
    taut.world.live(lambda _: tensions.append(taut.plant.bank.tension_n.copy()))
    outcome, reason = taut.run(taut.move(**then, speed=0.03, tendons=names))
    assert outcome in {MoveOutcome.REACHED, MoveOutcome.TENSION_LIMIT}, reason
    taut.pass_time(0.3)
    requested = then["targets"][0] if "mode" in then else then["tension_limit"]
    for index in (0, 2):
        assert min(tension[index] for tension in tensions) > 5.0 / 6.0 * min(before[index], requested)
