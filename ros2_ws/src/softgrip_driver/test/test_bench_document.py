# SPDX-License-Identifier: Apache-2.0
"""The driver's commands of docs/bench.md, as they stand there, in a time of their own.

All commands of the document on one bench, in real time over pseudo-terminals: tests/system/test_bench_document.py.
"""

from __future__ import annotations

import builtins
import importlib
import shlex
from pathlib import Path

import pytest

from softgrip_driver.commands import common
from softgrip_driver.faults import FAULTS
from softgrip_driver.rig.gauge_calibration import read_calibration
from softgrip_driver.rig.line_format import FORMATS
from softgrip_emulator.dynamixel.chain import DynamixelChain
from softgrip_emulator.dynamixel.servo import EmulatedServo
from softgrip_emulator.dynamixel.table import load_model
from softgrip_emulator.rig import EmulatedRig

DOCUMENT = Path(__file__).resolve().parents[4] / "docs" / "bench.md"
TEXT = DOCUMENT.read_text().replace("\\\n", " ")  # a long line goes on below
LINES = [line for line in TEXT.splitlines() if line.startswith("ros2 run softgrip_driver ")]
#: the document's ports: servos, stage, gauge
PORTS = {"/dev/ttyUSB0": "servos", "/dev/ttyUSB1": "stand", "/dev/ttyACM0": "gauge"}
G = 9.81


def words_of(line: str, folder: Path) -> tuple[str, list[str]]:
    """Return command and options of a line, with the ports of a folder."""
    _, _, _, command, *words = shlex.split(line)
    return command, [str(folder / PORTS[word]) if word in PORTS else word for word in words]


@pytest.fixture
def bench(tmp_path, world, monkeypatch):
    """A bench on the day it arrives: two new servos with ID 1 at 57600 baud, a GRBL stage, an HX711 board."""
    monkeypatch.chdir(tmp_path)
    servos = [EmulatedServo(load_model("xl330_m288"), 1, baud=57_600) for _ in range(2)]
    servos[1].is_connected = False
    ports = [world.port(tmp_path / "servos", DynamixelChain(servos))]
    rig = EmulatedRig(clock=world.clock, stage="grbl", gauge="bogde_basic").open_ports(tmp_path, world.port)
    weights = iter([0.0, 0.2, 0.5, 1.0, 0.0])

    def hang(prompt: str) -> str:
        mass = next(weights)
        assert ("nothing" if mass == 0.0 else f"{mass * 1e3:g} g") in prompt
        rig.plant.force = mass * G
        return ""

    monkeypatch.setattr(builtins, "input", hang)
    yield rig, servos
    for port in ports:
        port.close()
    rig.close()
    world.close()


def test_the_lines_of_the_document_work_in_their_order(bench, tmp_path, capsys) -> None:
    (rig, servos), done = bench, []
    for line in LINES:
        command, words = words_of(line, tmp_path)
        if command == "calibrate_tension":
            continue
        if command == "setup" and "setup" in done:
            servos[1].is_connected = True
        # An emulated servo alone on its bus answers in no time: half a second is as good as five.
        words += ["--seconds", "0.5"] if command == "selftest" else []
        assert importlib.import_module(f"softgrip_driver.commands.{command}").main(words) == 0, line
        done.append(command)
    assert done == ["scan", "setup", "setup", "selftest", "calibrate_cell", "stage"]
    assert rig.plant.travel == pytest.approx(5e-3, abs=3e-5)
    found = read_calibration(tmp_path / "gauge.yaml")
    assert found.line == "hx711"
    assert "went +5.0" in capsys.readouterr().out


def test_calibrate_tension_of_the_document_is_understood(monkeypatch) -> None:
    (line,) = [one for one in LINES if "calibrate_tension" in one]
    module = importlib.import_module("softgrip_driver.commands.calibrate_tension")
    parsed = []

    def run(_, arguments, args) -> int:
        parsed.append(arguments.parse_args(args))
        return 0

    monkeypatch.setattr(module, "run", run)
    assert module.main(words_of(line, Path("/"))[1]) == 0
    settings = common.stream_settings(parsed[0])
    assert (settings.line, settings.calibration) == ("hx711", "gauge.yaml")


def test_gauges_and_faults_of_the_document_exist() -> None:
    text = DOCUMENT.read_text()
    assert all(name in text for name in ("gauge_unproven", "gauge_reversed", "gauge_negative"))
    assert {"gauge_unproven", "gauge_reversed", "gauge_negative"} <= FAULTS.keys()
    assert [name for name in FORMATS if name not in text and name not in {"time_raw", "hx711_full"}] == []
