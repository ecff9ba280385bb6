# SPDX-License-Identifier: Apache-2.0
"""The bench commands against emulated servos, as a person types them."""

import argparse
import csv
import os
import re
import signal
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from softgrip_driver.autogroup import has_autogroups
from softgrip_driver.commands import calibrate_tension, common, scan, selftest, setup, tension_recording
from softgrip_driver.commands.selftest import causes
from softgrip_driver.dynamixel.bus import Bus
from softgrip_driver.dynamixel.registers import MODELS
from softgrip_driver.errors import LimitError
from softgrip_driver.tendon.backend import DriveReading
from softgrip_driver.usb_adapter import latency_timer
from softgrip_driver.wizard.drive_setup import BusMeasurement
from softgrip_emulator.dynamixel.chain import DynamixelChain
from softgrip_emulator.dynamixel.servo import EmulatedServo
from softgrip_emulator.dynamixel.table import load_model


@pytest.fixture
def chain(tmp_path, world):
    """Put servos (model, ID, baud) on a port."""
    ports = []

    def make(*rows):
        servos = [EmulatedServo(load_model(model), number, baud=baud) for model, number, baud in rows]
        ports.append(world.port(tmp_path / "servos", DynamixelChain(servos)))
        return str(tmp_path / "servos"), servos

    yield make
    for port in ports:
        port.close()
    world.close()


def test_scan_finds_servos_at_every_baud_rate(chain, capsys):
    port, _ = chain(("xl330_m288", 1, 57_600), ("xm430_w350", 7, 3_000_000))
    assert scan.main(["--port", port, "--wait", "0.1"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any("57600" in line and "XL330-M288" in line and line.split()[2] == "1" for line in lines)
    assert any("3000000" in line and "XM430-W350" in line and line.split()[2] == "7" for line in lines)
    assert len(lines) == 3


def test_scan_of_nothing_says_what_to_check(chain, capsys, tmp_path):
    port, _ = chain()
    assert scan.main(["--port", port, "--wait", "0.02"]) == 1
    assert "check power, cable and adapter" in capsys.readouterr().err
    assert scan.main(["--port", str(tmp_path / "none"), "--wait", "0.02"]) == 1
    assert "expected a free serial port" in capsys.readouterr().err


def test_scan_without_an_adapter_says_so(chain, capsys, monkeypatch):
    monkeypatch.setattr(list_ports, "comports", list)
    assert scan.main([]) == 1
    out, err = capsys.readouterr()
    assert "expected a USB adapter such as a U2D2, found no serial port; plug its USB cable in" in err
    assert "no servo answered" not in err
    assert out == ""
    port, _ = chain()
    monkeypatch.setattr(list_ports, "comports", lambda: [ListPortInfo(port)])
    assert scan.main(["--baud", "57600", "--wait", "0.02"]) == 1
    assert f"found only ports of the computer itself ({port}); plug" in capsys.readouterr().err


def test_scan_of_a_usb_adapter_says_nothing_of_a_missing_one(chain, capsys, monkeypatch):
    port, _ = chain(("xl330_m288", 1, 57_600))
    adapter = ListPortInfo(port)
    adapter.vid, adapter.pid = 0x0403, 0x6014  # FT232H: FTDI's default numbers, as a U2D2 has them
    monkeypatch.setattr(list_ports, "comports", lambda: [adapter])
    assert scan.main(["--baud", "57600", "--wait", "0.1"]) == 0
    assert capsys.readouterr().err == ""


def test_scan_of_a_port_that_is_not_there_does_not_blame_the_servos(capsys, tmp_path):
    assert scan.main(["--port", str(tmp_path / "none"), "--wait", "0.02"]) == 1
    assert "no servo answered" not in capsys.readouterr().err


def test_setup_gives_a_new_servo_its_id_and_baud_rate(chain, capsys):
    port, (servo,) = chain(("xl330_m288", 1, 57_600))
    options = ["--port", port, "--baud", "57600", "--id", "1", "--new-id", "5", "--new-baud", "1000000"]
    assert setup.main(options) == 0
    assert "baud rate is now 1000000" in capsys.readouterr().out
    assert (servo.device_id, servo.baud, servo.registers.get("return_delay_time")) == (5, 1_000_000, 0)
    bus = Bus(port, 1_000_000, 0.05)
    bus.open()
    assert bus.ping(5)[0] == 1200
    bus.close()


def test_setup_refuses_an_id_that_is_taken(chain, capsys):
    port, servos = chain(("xl330_m288", 1, 1_000_000), ("xl330_m288", 2, 1_000_000))
    assert setup.main(["--port", port, "--id", "1", "--new-id", "2"]) == 1
    assert "a servo with ID 2 already" in capsys.readouterr().err
    assert [servo.device_id for servo in servos] == [1, 2]


def test_servos_that_share_an_id_are_named_by_every_command(chain, capsys):
    """Three servos as they come. They answer a ping as one; of what they measure the bus carries a mixture."""
    port, servos = chain(*[("xl330_m288", 1, 57_600)] * 3)
    for turned, servo in enumerate(servos):
        servo.shaft.angle_rad = 0.5 + turned
    assert scan.main(["--port", port, "--baud", "57600"]) == 1
    out, err = capsys.readouterr()
    assert "several servos with this ID" in out
    assert "one at a time" in err
    assert setup.main(["--port", port, "--baud", "57600", "--id", "1", "--new-id", "5"]) == 1
    assert "expected one servo with ID 1, found several; connect them one at a time" in capsys.readouterr().err
    assert [servo.device_id for servo in servos] == [1, 1, 1]


def test_a_servo_of_its_own_id_is_not_taken_for_several(chain, capsys):
    port, _ = chain(("xl330_m288", 1, 57_600), ("xl330_m288", 2, 57_600))
    assert scan.main(["--port", port, "--baud", "57600"]) == 0
    assert "several" not in capsys.readouterr().out


def test_scan_of_nobody_names_the_boot_loader(chain, capsys):
    port, _ = chain()
    assert scan.main(["--port", port, "--wait", "0.05"]) == 1
    assert "LED stays lit after power-on" in capsys.readouterr().err


def test_setup_reboots_and_waits(chain, capsys):
    port, _ = chain(("xl330_m288", 1, 1_000_000))
    assert setup.main(["--port", port, "--id", "1", "--reboot"]) == 0
    assert "ID 1 is back, hardware error: none" in capsys.readouterr().out


def test_setup_says_so_where_nobody_is_to_be_rebooted(chain, capsys):
    port, _ = chain(("xl330_m288", 1, 1_000_000))
    assert setup.main(["--port", port, "--id", "7", "--reboot"]) == 1
    assert "servo 7: expected a reply" in capsys.readouterr().err


def test_selftest_measures_and_names_the_return_delay(chain, capsys):
    port, _ = chain(("xl330_m288", 1, 1_000_000), ("xl330_m288", 2, 1_000_000))
    selftest.main(["--port", port, "--seconds", "0.3", "--rate", "1"])
    out = capsys.readouterr().out
    assert "2 at 1000000 baud" in out
    assert "servos [1, 2] wait up to 500 us" in out
    assert "setup --id" in out


@pytest.mark.parametrize(("setting", "known"), [("0\n", False), ("1\n", True), ("", False), (None, False)])
def test_whether_sessions_share_the_processors_is_read_from_the_kernel(tmp_path, setting, known):
    """sched(7): the file is there only in a kernel that was built with autogroups."""
    file = tmp_path / "sched_autogroup_enabled"
    if setting is not None:
        file.write_text(setting)
    assert has_autogroups(file) is known


def test_selftest_names_the_sessions_where_single_cycles_are_too_long():
    uneven = BusMeasurement(2, 1_000_000, 400.0, 0.002, 0.04, 0.001, 0.0, 0, {}, None, 0.001)
    assert "sched_autogroup_enabled=0" in causes(uneven, 100.0, autogroups=True)[-1]
    assert causes(uneven, 100.0) == []
    assert causes(replace(uneven, p99=0.004), 100.0, autogroups=True) == []
    slow = causes(replace(uneven, rate=30.0, median=0.03), 100.0, autogroups=True)
    assert slow, "there is a cause, which is in every cycle"
    assert "autogroup" not in " ".join(slow)
    lossy = causes(replace(uneven, p99=0.004, lost_share=0.01), 100.0, autogroups=True)
    assert [text.split(";")[0] for text in lossy] == [
        "1.00% of the answers are lost and 0 packets damaged: check cable, connectors, common ground and supply"
    ]


def test_selftest_of_an_empty_bus_says_so(chain, capsys):
    port, _ = chain()
    assert selftest.main(["--port", port, "--seconds", "0.1"]) == 1
    assert "found none; run scan" in capsys.readouterr().err


def measurement(**others):
    values = {
        "servos": 4, "baud": 1_000_000, "rate": 400.0, "median": 0.0025, "p99": 0.003, "turnaround": 0.001,
        "lost_share": 0.0, "corrupt": 0, "return_delays": {1: 0.0}, "latency_timer": 0.001,
    }  # fmt: skip
    return BusMeasurement(**(values | others))


@pytest.mark.parametrize(
    ("found", "text"),
    [
        (measurement(latency_timer=0.016), "waits 16 ms.*make udev"),
        (measurement(latency_timer=None, turnaround=0.016), "takes 16 ms beyond its bytes.*make udev"),
        (measurement(return_delays={1: 5e-4, 2: 0.0}), r"servos \[1\] wait"),
        (measurement(baud=57600, wire_time=0.0256), "raise the baud rate"),
        (measurement(lost_share=0.05), "5.00% of the answers are lost"),
        (measurement(rate=60.0), "the rest is this computer"),
    ],
)
def test_each_cause_has_its_fix(found, text):
    (only,) = causes(found, 100.0)
    assert re.search(text, only)


def test_a_good_bus_has_no_causes():
    assert causes(measurement(), 100.0) == []


def test_the_latency_timer_is_read_from_sysfs(tmp_path):
    (tmp_path / "ttyUSB0").mkdir()
    (tmp_path / "ttyUSB0" / "latency_timer").write_text("16\n")
    assert latency_timer("/dev/ttyUSB0", tmp_path) == 0.016
    assert latency_timer("/dev/ttyACM0", tmp_path) is None


def test_calibration_of_a_recording_gives_its_parameters(tmp_path, capsys):
    rng = np.random.default_rng(3)
    path = tmp_path / "samples.csv"
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("current_a", "speed_m_s", "tension_n"))
        for tension, sign in zip(rng.uniform(2.0, 15.0, 100), [1, -1] * 50, strict=True):
            writer.writerow((tension * 0.010 / 0.33 + 0.04 * sign, 0.003 * sign, tension))
    assert calibrate_tension.main(["--csv", str(path)]) == 0
    out = capsys.readouterr().out
    assert "torque_per_ampere_nm_a: [0.33000]" in out
    assert "friction_currents_a: [0.04000]" in out


HEADS = "current_a,speed_m_s,tension_n\n"


@pytest.mark.parametrize(
    ("recording", "text"),
    [
        ("a,b\n1,2\n", "expected columns current_a"),
        (HEADS + "0.1,0.003\n", "expected columns current_a"),
        (HEADS + "0.1,0.003,many\n", "expected columns current_a"),
        (HEADS + "0.1,0.003,1.0\n0.1,0.003,nan\n", "row 2; leave it out"),
        (HEADS + "0.1," + "9" * 140_000 + ",1\n", "expected columns current_a"),
        (HEADS + "0.1,0.003,1.0\n", "expected at least 6 points"),
        (HEADS + "0.1,0.003,1.0\n0.02,-0.003,1.0\n" * 4, "a spread of only 0.000 A up to 0.100 A"),
        (HEADS + "0.1,0.003,-3.0\n0.2,-0.003,-6.0\n0.4,0.003,-12\n" * 4, "tension that grows with current"),
    ],
    ids=["columns", "cut", "words", "no number", "a field too long", "too short", "no spread", "wrong sign"],
)
def test_a_bad_recording_is_named(tmp_path, capsys, recording, text):
    path = tmp_path / "bad.csv"
    path.write_text(recording)
    assert calibrate_tension.main(["--csv", str(path)]) == 1
    assert text in capsys.readouterr().err


# A speed or a number of rounds of none would never end, with a tendon under tension.
@pytest.mark.parametrize(
    ("command", "options"),
    [
        (calibrate_tension, "--speed 0"),
        (calibrate_tension, "--speed -0.003"),
        (calibrate_tension, "--rounds 0"),
        (calibrate_tension, "--rounds 1.5"),
        (calibrate_tension, "--tension nan"),
        (calibrate_tension, "--travel 30"),
        (calibrate_tension, "--radius 10"),
        (calibrate_tension, "--id 254"),
        (calibrate_tension, "--reply-margin -1"),
        (selftest, "--seconds 0"),
        (selftest, "--rate 0"),
        (scan, "--wait inf"),
        (scan, "--baud 12345"),
        (setup, "--new-id 253 --id 1"),
        (setup, "--new-baud 4500000 --id 1"),
    ],
)
def test_an_option_that_makes_no_sense_is_refused_before_anything_is_opened(command, options, capsys, monkeypatch):
    monkeypatch.setattr(command, "Bus" if command is calibrate_tension else "drive_setup", None)
    with pytest.raises(SystemExit) as refused:
        command.main(["--port", "/dev/ttyUSB0", *options.split()])
    assert refused.value.code == 2
    assert re.search(r"expected a|invalid choice", capsys.readouterr().err)


def test_a_recording_that_cannot_be_kept_is_refused_before_the_measurement(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(calibrate_tension, "Bus", None)
    record = tmp_path / "missing" / "samples.csv"
    options = ["--port", "/dev/ttyUSB0", "--gauge", "/dev/ttyUSB1", "--record", str(record)]
    assert calibrate_tension.main(options) == 1
    assert "choose another --record" in capsys.readouterr().err


@pytest.fixture
def signals():
    """Signals as a terminal leaves them: a background job's or nohup's are ignored."""
    usual = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL, signal.SIGHUP: signal.SIG_DFL}
    before = {one: signal.signal(one, handler) for one, handler in usual.items()}
    yield usual
    for one, handler in before.items():
        signal.signal(one, handler)


@pytest.mark.parametrize("ends", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_command_that_is_ended_leaves_things_safe_and_no_second_signal_cuts_in(ends, signals):
    """Ctrl-C, kill, the terminal closed; the default of the latter two is to end at once, with the servo pulling."""
    steps = []

    def work(_):
        try:
            os.kill(os.getpid(), ends)
            steps.append("went on")
        finally:
            os.kill(os.getpid(), signal.SIGINT)
            os.kill(os.getpid(), signal.SIGTERM)
            steps.append("let go")

    assert common.run(work, argparse.ArgumentParser(), []) == common.FAILED
    assert steps == ["let go"]
    assert {one: signal.getsignal(one) for one in signals} == signals


def test_calibration_against_a_gauge_finds_the_servo_s_true_constant(bench, monkeypatch, tmp_path):
    """The gauge reads the tendon of the emulated finger, which is the truth."""

    class Gauge:
        def tension(self):
            return float(bench.plant.bank.tension_n[0])

    bench.loop.stop()
    bench.backend._live = {"index": bench.backend._live["index"]}
    samples = calibrate_tension.measure(bench.backend, Gauge(), 8.0, 0.012, 0.03, 2)
    tension_recording.write_csv(tmp_path / "samples.csv", samples)
    taut = [s for s in tension_recording.read_csv(tmp_path / "samples.csv") if s.tension_n > 1.0]
    found = calibrate_tension.calibrate(taut, MODELS["XL330-M288"], 0.010, "gauge")
    motor = bench.plant.motors[0]
    truth = motor.ratings.torque_constant_nm_per_a * 0.010 / motor.spool_radius_m
    assert found.torque.torque_per_ampere == pytest.approx(truth, rel=0.05)
    assert found.winding.resistance == pytest.approx(motor.resistance_ohm(25.0), rel=0.03)
    assert found.winding.back_emf == pytest.approx(motor.ratings.back_emf_vs_per_rad, rel=0.05)
    assert found.scatter < 0.3
    assert bench.plant.servos[0].registers.get("torque_enable") == 0


def test_under_nohup_a_closed_terminal_ends_nothing():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        hang_up = lambda _: os.kill(os.getpid(), signal.SIGHUP) or common.DONE  # noqa: E731
        assert common.run(hang_up, argparse.ArgumentParser(), []) == common.DONE
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize(
    ("model", "expected"),
    [
        ("STS3215", "With the backend feetech tensions are those of the maker's values"),
        ("DM-J4310-2EC", "With the backend damiao tensions are those of the maker's values"),
        ("XL-330", "expected one of XC330-M288"),
    ],
)
def test_calibrate_tension_refuses_a_servo_that_it_can_not_move_by_name(model, expected, capsys):
    with pytest.raises(SystemExit) as ended:
        calibrate_tension.main(["--port", "/dev/null", "--model", model, "--weights", "0.1", "0.3"])
    assert ended.value.code == 2
    assert expected in " ".join(capsys.readouterr().err.split())


class GivesUp:
    """A drive of which a reading shows that it pulls no more."""

    tendons = ("tendon",)

    def __init__(self, **shown):
        self.is_on, self._shown, self._writes = False, shown, 0
        self.bus = SimpleNamespace(clock=SimpleNamespace(now_s=lambda: 0.01 * self._writes))

    def power(self, _tendon, on):
        self.is_on = on

    def write(self, _setpoints):
        self._writes += 1

    def read(self):
        shown = self._shown if self._writes > 50 else {}
        return {"tendon": DriveReading(0.0, 0.0, 0.0, 24.0, 1.0, 24.0, **shown)}


@pytest.mark.parametrize(
    ("shown", "text"), [({"faults": ("overload",)}, "found overload"), ({"powered": False}, "found its torque off")]
)
def test_a_servo_that_drops_a_weight_ends_the_calibration(shown, text):
    drive = GivesUp(**shown)
    with pytest.raises(LimitError, match=f"{text}; .*lighter weights"):
        calibrate_tension.measure(drive, calibrate_tension.Weight(2.4), 60.0, 1.0, 0.003, 2)
    assert not drive.is_on
