# SPDX-License-Identifier: Apache-2.0
"""The whole emulated cell over its wires: a hand closes, every fault by name shows on the wire and ends."""

import os
import random
import signal
import socket
import time
import urllib.request
from contextlib import contextmanager

import dynamixel_sdk
import numpy as np
import pytest
import serial

from softgrip_emulator.camera.exposure_sample import CameraSettings
from softgrip_emulator.cell import TIME_SOCKET, EmulatedCell
from softgrip_emulator.dynamixel.packets import Instruction, encode
from softgrip_emulator.errors import EmulatorError
from softgrip_emulator.faults import BUS_FAULTS, CAMERA_FAULTS, random_plan, read_plan
from softgrip_emulator.time_server import TICK_S
from softgrip_emulator.wire.pty import host_baud
from softgrip_time import SimulatedClock

OK, TIMEOUT = dynamixel_sdk.COMM_SUCCESS, dynamixel_sdk.COMM_RX_TIMEOUT
SLOTS = ("index", "middle", "thumb")


@pytest.fixture
def cell(profiles, tmp_path):
    with EmulatedCell(profiles, tmp_path / "wires", seed=2, camera=CameraSettings(320, 240)) as cell:
        cell.plant.mount(SLOTS, ("a", "b", "c"), ("power",) * 3)
        yield cell


@pytest.fixture
def host(cell):
    return open_host(cell)


def open_host(cell):
    port = dynamixel_sdk.PortHandler(str(cell.wire_dir / "servos"))
    assert port.openPort()
    assert port.setBaudRate(1_000_000)
    return port, dynamixel_sdk.PacketHandler(2.0)


@contextmanager
def stepping_host(cell, at_s=0.0):
    """The servos' port as a host opens it that steps with the cell's time, from a time [s] on."""
    clock = SimulatedClock(cell.wire_dir / TIME_SOCKET, "host")
    with clock.stepping(), serial.Serial(str(cell.wire_dir / "servos"), 1_000_000, timeout=0) as bus:
        clock.attach(bus.fd)
        clock.wait(max(at_s, clock.now_s() + 0.02))
        yield clock, bus
        clock.detach(bus.fd)


def exchange(clock, bus, instruction, parameters):
    """Send an instruction to servo 1; returns its reply and the time it came."""
    clock.count_written(bus.fd, bus.write(encode(1, instruction, parameters)))
    assert clock.wait_readable([bus.fd], clock.now_s() + 0.1) == [bus.fd]
    return bus.read(200), clock.now_s()


def torque_on_and_pull(clock, bus, pulses):
    """Current-based position control, 0.9 A, to a goal so many pulses on."""
    for address, value in ((11, b"\x05"), (102, (900).to_bytes(2, "little")), (64, b"\x01")):
        exchange(clock, bus, Instruction.WRITE, address.to_bytes(2, "little") + value)
    reply, _ = exchange(clock, bus, Instruction.READ, bytes((132, 0, 4, 0)))
    goal = int.from_bytes(reply[9:13], "little", signed=True) + pulses
    exchange(clock, bus, Instruction.WRITE, (116).to_bytes(2, "little") + goal.to_bytes(4, "little", signed=True))


def ping(host, number=1):
    port, packets = host
    return packets.ping(port, number)[1:]


def read4(host, number, address):
    port, packets = host
    value, result, error = packets.read4ByteTxRx(port, number, address)
    return (value - (1 << 32) if value >> 31 else value), result, error


def torque_on(host, number=1, current=900):
    port, packets = host
    for done in (
        packets.write1ByteTxRx(port, number, 11, 5),
        packets.write2ByteTxRx(port, number, 102, current),
        packets.write1ByteTxRx(port, number, 64, 1),
    ):
        assert done == (OK, 0)


def pull(host, number, pulses):
    port, packets = host
    goal = read4(host, number, 132)[0] + pulses
    assert packets.write4ByteTxRx(port, number, 116, goal & 0xFFFFFFFF) == (OK, 0)


def test_wires_exist_while_open_and_not_after(profiles, tmp_path):
    folder = tmp_path / "wires"
    with EmulatedCell(profiles, folder) as cell:
        names = {path.name for path in folder.iterdir()}
        assert names >= {"servos", "stand", "gauge", "camera.url", "camera_calibration.yaml"}
        assert (folder / "camera.url").read_text().strip() == cell.stream_url
    assert list(folder.iterdir()) == []


def test_a_taken_port_is_said_so(profiles, tmp_path):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        settings = CameraSettings(port=taken.getsockname()[1])
        with pytest.raises(EmulatorError, match="choose another port"):
            EmulatedCell(profiles, tmp_path / "wires", camera=settings).open()


def test_winding_closes_the_finger_and_the_tension_shows_in_the_current(cell, host, until):
    torque_on(host)
    pull(host, 1, 1200)
    assert until(lambda: cell.truth().fingers[0].joint_angles_rad.sum() > 1.0)
    reading = cell.truth().fingers[0]
    assert reading.tension_n > 3.0
    assert reading.tip_m[1] < -0.02
    assert np.all(np.diff(reading.span_tensions_n) <= 0.0)
    port, packets = host
    assert 50 < packets.read2ByteTxRx(port, 1, 126)[0] < 900
    assert cell.truth().fingers[1].tension_n == 0.0


def test_mounting_changes_the_finger_and_loosens_its_cable(cell):
    cell.plant.mount(["index", "thumb"], ["PI-I-01", ""], ["pinch", ""])
    fingers = {finger.slot: finger for finger in cell.truth().fingers}
    assert set(fingers) == {"index", "middle"}
    assert fingers["index"].profile == "pinch"
    assert fingers["index"].pulled_length_m < 0.0
    with pytest.raises(EmulatorError, match="expected a slot"):
        cell.plant.mount(["ring"], ["x"], ["power"])
    with pytest.raises(EmulatorError, match="expected a profile"):
        cell.plant.mount(["index"], ["x"], ["claw"])


# -- faults ------------------------------------------------------------------------------------------------------------


def test_the_names_of_the_issue_are_there(cell):
    assert set(BUS_FAULTS) | set(CAMERA_FAULTS) <= set(cell.faults.known)
    assert {"bytes_lost", "bytes_flipped", "bytes_delayed", "bytes_duplicated", "crc_error"} <= set(cell.faults.known)
    assert {"servo_silent", "alert", "overload", "brown_out", "bus_unplugged", "wrong_baud"} <= set(cell.faults.known)
    assert {"position_glitch", "tendon_break", "slack", "cell_stuck"} <= set(cell.faults.known)
    assert {"camera_frozen", "camera_dropped", "camera_dark", "camera_overexposed"} <= set(cell.faults.known)


@pytest.mark.parametrize(
    ("fault", "arguments"),
    [
        ("bytes_lost", {"share": 0.3}),
        ("bytes_flipped", {"share": 0.3}),
        ("bytes_duplicated", {"share": 0.5}),
        ("bytes_delayed", {"delay_s": 0.5}),
        ("crc_error", {}),
        ("bus_dead", {}),
        ("servo_silent", {}),
        ("wrong_baud", {}),
        ("brown_out", {}),
        ("silent_reboot", {}),
    ],
)
def test_faults_that_spoil_replies_end_when_cleared(cell, host, until, fault, arguments):
    assert ping(host) == (OK, 0)
    cell.faults.inject(fault, arguments=arguments)
    assert fault in cell.faults.active[0]
    # the supply sags with the plant's next step; the others at once
    assert until(lambda: any(ping(host)[0] != OK for _ in range(5)), 1.0)
    cell.faults.clear()
    assert cell.faults.active == ()
    assert until(lambda: ping(host) == (OK, 0))


def test_unplug_and_replug(cell, host):
    cell.faults.inject("bus_unplugged")
    assert not (cell.wire_dir / "servos").exists()
    cell.faults.clear("bus_unplugged")
    assert ping(open_host(cell)) == (OK, 0)


@pytest.mark.parametrize(("fault", "bits"), [("alert", 0x10), ("overload", 0x20)])
def test_error_bits_stay_until_a_reboot(cell, host, until, fault, bits):
    port, packets = host
    torque_on(host, 2)
    cell.faults.inject(fault, "middle")
    assert until(lambda: packets.read1ByteTxRx(port, 2, 70) == (bits, OK, 128))
    assert packets.read1ByteTxRx(port, 2, 64)[0] == 0
    cell.faults.clear()
    assert packets.read1ByteTxRx(port, 2, 70)[0] == bits
    packets.reboot(port, 2)
    assert until(lambda: ping(host, 2) == (OK, 0))
    assert packets.read1ByteTxRx(port, 2, 70) == (0, OK, 0)


def test_overheating_shuts_down_and_heating_warms(cell, host, until):
    port, packets = host
    cell.faults.inject("overheating", "1", arguments={"temperature_c": 75.0})
    assert until(lambda: packets.read1ByteTxRx(port, 1, 70)[0] == 0x04)
    before_c = cell.plant.servos[1].shaft.temperature_c
    cell.faults.inject("heating", "middle", arguments={"power_w": 50.0})
    assert until(lambda: cell.plant.servos[1].shaft.temperature_c > before_c + 0.2)


def test_a_brown_out_costs_turns_and_torque_without_an_error_bit(cell, host, until):
    port, packets = host
    # an empty slot: the spool may turn as far as it likes
    cell.plant.mount(["index"], [""], [""])
    torque_on(host)
    turns = read4(host, 1, 132)[0]
    pull(host, 1, 4200)
    assert until(lambda: read4(host, 1, 132)[0] > turns + 4000)
    forgotten = cell.plant.servos[0]._fold_pulses
    cell.faults.inject("brown_out", duration_s=0.1)
    assert until(lambda: ping(host)[0] == TIMEOUT)
    assert until(lambda: ping(host) == (OK, 0))
    assert until(lambda: cell.faults.active == ())
    assert packets.read1ByteTxRx(port, 1, 64) == (0, OK, 0)
    assert packets.read1ByteTxRx(port, 1, 70) == (0, OK, 0)
    lost = cell.plant.servos[0]._fold_pulses - forgotten
    assert lost != 0
    assert lost % 4096 == 0


def test_position_glitch(cell, host):
    before = read4(host, 1, 132)[0]
    cell.faults.inject("position_glitch", arguments={"pulses": -4095})
    assert abs(read4(host, 1, 132)[0] - before + 4095) <= 1
    cell.faults.clear()
    assert abs(read4(host, 1, 132)[0] - before) <= 1


def test_tendon_break_slack_and_jam(cell, host, until):
    torque_on(host)
    pull(host, 1, 1000)
    assert until(lambda: cell.truth().fingers[0].tension_n > 3.0)
    cell.faults.inject("slack", "index", arguments={"length_m": 0.02})
    assert until(lambda: cell.truth().fingers[0].tension_n == 0.0)
    cell.faults.clear("slack")
    assert until(lambda: cell.truth().fingers[0].tension_n > 3.0)
    cell.faults.inject("tendon_break", "index")
    assert until(lambda: cell.truth().fingers[0].tension_n == 0.0)
    cell.faults.clear()
    cell.faults.inject("spool_jammed", "index")
    place = read4(host, 1, 132)[0]
    pull(host, 1, 500)
    assert not until(lambda: abs(read4(host, 1, 132)[0] - place) > 20, 0.3)


def test_mounting_a_new_finger_mends_a_broken_tendon(cell):
    cell.faults.inject("tendon_break", "index")
    cell.plant.mount(["index"], ["PW-I-02"], ["power"])
    assert "index" not in cell.plant.disturbances.broken_tendons


def test_faults_of_the_rig_go_through_the_same_door(cell):
    cell.faults.inject("cell_stuck")
    assert cell.rig.active_faults == ("cell_stuck",)
    cell.faults.clear()
    assert cell.rig.active_faults == ()


def test_camera_faults_reach_the_camera(cell):
    cell.faults.inject("camera_dark")
    assert cell.camera.faults.gain < 0.2
    cell.faults.inject("camera_frozen")
    assert cell.camera.faults.frozen
    cell.faults.clear()
    assert (cell.camera.faults.gain, cell.camera.faults.frozen) == (1.0, False)


def test_a_fault_ends_by_itself(cell, until):
    cell.faults.inject("camera_dark", duration_s=0.05)
    assert cell.faults.active == ("camera_dark",)
    assert until(lambda: cell.faults.active == ())
    assert cell.camera.faults.gain == 1.0


def held(cell):
    """Everything that faults of the pairs below change."""
    servo, shaft = cell.plant.servos[0], cell.plant.disturbances
    return (
        vars(cell.bus_wire.faults).copy(), vars(cell.camera.faults).copy(), servo.forced_error_bits, servo.silenced,
        servo.registers.get("baud_rate"), set(shaft.broken_tendons), dict(shaft.extra_slack_m), cell.rig.cell.capacity,
        cell.rig.active_faults, cell.bus_port.link.exists(),
    )  # fmt: skip


def test_faults_that_overlap_leave_nothing_behind(cell):
    """A random plan draws the same fault twice now and then."""
    twice = ("bus_dead", "bytes_lost", "bus_unplugged", "saturated", "camera_dark", "servo_silent@index",
             "wrong_baud@index", "tendon_break@index", "slack@index")  # fmt: skip
    others = (("alert@index", "overload@index"), ("camera_dark", "camera_overexposed"), ("bus_dead", "bytes_lost"))
    before = held(cell)
    for pair in (*((name, name) for name in twice), *others):
        for order in ((0, 1), (1, 0)):
            for label in pair:
                cell.faults.inject(*label.split("@"))
            assert held(cell) != before, pair
            for index in order:
                cell.faults.clear(pair[index])
            assert held(cell) == before, (pair, order)
            assert cell.faults.active == ()


def test_of_two_faults_on_one_thing_the_one_that_is_left_still_counts(cell):
    cell.faults.inject("camera_dark")
    cell.faults.inject("camera_overexposed")
    cell.faults.clear("camera_dark")
    assert cell.camera.faults.gain == 3.0
    cell.faults.inject("bytes_lost", arguments={"share": 0.5})
    cell.faults.inject("bytes_lost", arguments={"share": 0.1})
    assert cell.faults.active == ("camera_overexposed", "bytes_lost")
    assert cell.bus_wire.faults.lost == 0.1
    cell.faults.clear()


def test_a_plan_is_followed(cell, until):
    now_s = cell.clock.now_s()
    cell.faults.follow(
        read_plan(f"""
        - {{fault: servo_silent, at_s: {now_s + 0.05}, target: thumb, duration_s: 1.0}}
        - {{fault: camera_dark, at_s: {now_s}}}
    """)
    )
    assert until(lambda: set(cell.faults.active) == {"camera_dark", "servo_silent@thumb"})
    assert until(lambda: cell.faults.active == ("camera_dark",))


@pytest.mark.parametrize(
    ("fault", "target", "arguments", "message"),
    [
        ("meteorite", "", {}, "expected one of"),
        ("servo_silent", "ring", {}, "expected a slot"),
        ("servo_silent", "9", {}, "expected a slot"),
        ("bytes_lost", "", {"sher": 1}, "expected arguments of"),
        ("bytes_lost", "", {"share": "many"}, "expected arguments of"),
        ("bytes_lost", "index", {}, "expected no target"),
    ],
)
def test_wrong_requests_say_what_is_expected(cell, fault, target, arguments, message):
    with pytest.raises(EmulatorError, match=message):
        cell.faults.inject(fault, target, 0.0, arguments)
    assert cell.faults.active == ()


def test_random_plans_are_reproducible_and_bounded():
    plan = random_plan(seed=3, count=50, within_s=20.0, longest_s=1.0)
    assert plan == random_plan(seed=3, count=50, within_s=20.0, longest_s=1.0)
    assert plan != random_plan(seed=4, count=50, within_s=20.0, longest_s=1.0)
    assert all(0 <= row.at_s <= 20 and 0 < row.duration_s <= 1 and row.fault in BUS_FAULTS for row in plan)
    assert read_plan("random: {seed: 3, count: 50, within_s: 20.0, longest_s: 1.0}") == plan
    assert {row.target for row in plan} == {""}
    aimed = random_plan(seed=3, count=200, targets=["index", "2"])
    drives = {row.fault for row in aimed if row.target}
    assert {row.target for row in aimed} == {"", "index", "2"}
    assert {"servo_silent", "tendon_break"} <= drives
    assert not drives & {"bus_dead", "bytes_lost"}


@pytest.mark.parametrize("text", ["- 1", "{a: 1}", "- {fault: alert}", "random: {sheed: 1}", "- [", "3"])
def test_a_bad_plan_is_refused(text):
    with pytest.raises(EmulatorError, match="fault plan"):
        read_plan(text)


# -- time --------------------------------------------------------------------------------------------------------------


def test_the_cell_can_live_faster_than_the_computer(profiles, tmp_path):
    with EmulatedCell(profiles, tmp_path / "wires", speed=0.0, camera=CameraSettings(320, 240)) as cell:
        cell.plant.mount(SLOTS, ("a", "b", "c"), ("power",) * 3)
        began = time.monotonic()
        with stepping_host(cell) as (clock, bus):
            start_s = clock.now_s()
            torque_on_and_pull(clock, bus, 600)
            clock.wait(start_s + 20.0)
            assert clock.now_s() == start_s + 20.0
            assert cell.truth().fingers[0].joint_angles_rad.sum() > 0.5
        assert time.monotonic() - began < 20.0
    assert cell.epoch_time_s() == pytest.approx(clock.epoch_ns(clock.now_s()) * 1e-9, abs=TICK_S)


def test_frames_are_stamped_by_the_computers_time_unless_somebody_follows_the_cells(profiles, tmp_path):
    """A cell that falls behind, as on a computer that is too slow: its servos' readings are stamped by the computer."""
    with EmulatedCell(profiles, tmp_path / "wires", speed=0.2, camera=CameraSettings(320, 240)) as cell:
        time.sleep(1.0)
        assert time.time() - cell.epoch_time_s() > 0.5
        assert cell.frame_time_s() == pytest.approx(time.time(), abs=0.1)
        with stepping_host(cell):
            assert cell.frame_time_s() == pytest.approx(cell.epoch_time_s(), abs=0.1)
            assert time.time() - cell.frame_time_s() > 0.5
        time.sleep(0.2)  # its host has gone, perhaps between two waits: the next frame is no later than the last
        assert not cell.time_server.participants.all
        assert cell.frame_time_s() == pytest.approx(cell.epoch_time_s(), abs=0.1)
        assert time.time() - cell.frame_time_s() > 0.5


@pytest.mark.parametrize("is_followed", [False, True])
def test_a_camera_that_is_late_holds_the_time_only_of_those_who_follow_it(profiles, tmp_path, until, is_followed):
    """Nobody follows: devices answer at the computer's time, as real ones do, and the camera misses frames."""
    with EmulatedCell(profiles, tmp_path / "wires", camera=CameraSettings(320, 240)) as cell:
        cell.time_server.is_followed = is_followed
        with urllib.request.urlopen(cell.stream_url, timeout=5):
            assert until(lambda: cell.camera.frames_taken > 2)
            child = cell.camera._process.pid
            os.kill(child, signal.SIGSTOP)
            try:
                time.sleep(0.3)  # for the frame in progress to be late
                began_s = cell.clock.now_s()
                time.sleep(1.0)
                lived_s = cell.clock.now_s() - began_s
            finally:
                os.kill(child, signal.SIGCONT)
            assert (lived_s < 0.2) == is_followed
            assert (lived_s > 0.5) != is_followed
            taken = cell.camera.frames_taken
            assert until(lambda: cell.camera.frames_taken > taken + 2)


def test_the_same_questions_at_the_same_times_get_the_same_answers_however_busy_the_computer(profiles, tmp_path):
    """The truth after a closing is the same to the bit, though one host is held up at random by its computer."""
    ends = []
    for number, pause_s in enumerate((0.0, 0.004)):
        folder = tmp_path / f"wires{number}"
        pauses = random.Random(number)
        with (
            EmulatedCell(profiles, folder, seed=2, speed=0.0, camera=CameraSettings(320, 240)) as cell,
            stepping_host(cell, at_s=1.0) as (clock, bus),
        ):
            # not before the host holds the time: fingers relax from when they were mounted
            cell.plant.mount(SLOTS, ("a", "b", "c"), ("power",) * 3)
            torque_on_and_pull(clock, bus, 900)
            readings = []
            for step in range(100):
                clock.wait(2.0 + 0.01 * step)
                time.sleep(pauses.uniform(0.0, pause_s))
                readings.append(exchange(clock, bus, Instruction.READ, bytes((126, 0, 10, 0))))
            truth = cell.truth()
        ends.append((readings, [finger.joint_angles_rad.tolist() for finger in truth.fingers]))
    assert ends[0] == ends[1]
    assert len(set(ends[0][0])) > 20


def test_the_stream_of_a_cell_can_be_read(cell):
    with urllib.request.urlopen(cell.stream_url, timeout=5) as response:
        assert b"image/jpeg" in response.read(200)


def test_host_baud_of_something_else_is_unknown(tmp_path):
    with (tmp_path / "file").open("wb") as file:
        assert host_baud(file.fileno()) is None


@pytest.mark.parametrize(("away_s", "lost_s"), [(0.010, 0.0), (0.090, 0.0), (0.300, 0.3)])
def test_a_servo_that_is_asked_after_a_pause_answers_with_what_is(profiles, tmp_path, away_s, lost_s):
    """Nobody else brings this plant up to date; what is too long to make up for is left out, and counted."""
    plant = (cell := EmulatedCell(profiles, tmp_path / "wires")).plant
    asked_s = plant.now_s + away_s
    cell.chain.exchange(encode(1, Instruction.PING), asked_s, 57600)
    assert plant.now_s == pytest.approx(asked_s, abs=0.0041)
    assert plant.lost_time_s == pytest.approx(lost_s, abs=0.0041)
