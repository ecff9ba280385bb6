# SPDX-License-Identifier: Apache-2.0
"""The first run on Feetech servos: a good bus passes, and what a beginner does wrong is named as of Dynamixel."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from softgrip_demo.errors import FirstRunError
from softgrip_demo.first_run.bus_steps import BenchBus, IdsStep, LatencyStep, RateStep, SupplyStep, TensionStep
from softgrip_demo.first_run.checklist import CheckStep
from softgrip_demo.first_run.figures import Figure
from softgrip_description.cell_file import CellFile, ChainServo, ServoChain
from softgrip_emulator.feetech.chain import FeetechChain
from softgrip_emulator.feetech.memory import load_model
from softgrip_emulator.feetech.servo import EmulatedFeetechServo
from softgrip_emulator.wire.usb_adapter import UsbAdapter
from softgrip_testing.scripts import load_script

worlds = load_script(Path(__file__).parents[2] / "softgrip_driver/test/worlds.py")


class FeetechBench:
    """Two STS3215 of a cell file with `drive: feetech`."""

    def __init__(self, folder: Path, world: Any, latency_s: float | None = None, supply_v: float = 7.4) -> None:
        self.servos = [EmulatedFeetechServo(load_model("STS3215"), number) for number in (2, 3)]
        for servo in self.servos:
            servo.shaft.supply_v = supply_v
            servo.step(0.0, 0.001)
        chain = FeetechChain(self.servos, before=self._live)
        world.port(folder / "servos", chain if latency_s is None else UsbAdapter(chain, latency_s))
        rows = tuple(
            ChainServo(name, "STS3215", number, 1, 0.010, 0.005) for number, name in enumerate(("index", "thumb"), 2)
        )
        self.cell = CellFile("real", servos=ServoChain(str(folder / "servos"), 1_000_000, rows, "feetech"))
        self.bench = BenchBus(self.cell, selftest_s=0.3)

    def _live(self, now_s: float) -> None:
        for servo in self.servos:
            servo.step(now_s, 0.001)


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    made = worlds.OwnWorld(monkeypatch)
    yield made
    made.close()


@pytest.fixture
def feetech(tmp_path: Path, world: Any) -> FeetechBench:
    return FeetechBench(tmp_path, world)


def wrong(step: CheckStep) -> list[Figure]:
    return [figure for figure in step.measure() if not figure.is_good]


def test_a_good_feetech_bus_passes_and_its_tension_is_said_to_be_the_data_sheets(feetech: FeetechBench) -> None:
    for kind in (IdsStep, RateStep, LatencyStep, SupplyStep, TensionStep):
        assert wrong(kind(feetech.bench)) == []
    share, _ = tuple(TensionStep(feetech.bench).measure())[:2]
    assert (share.found, "+-20 %" in share.remark) == ("20 %", True)


def test_a_feetech_servo_at_another_baud_rate_or_without_its_plug_is_named(feetech: FeetechBench) -> None:
    feetech.servos[1].registers.put("baud_rate", 1)
    (figure,) = wrong(IdsStep(feetech.bench))
    assert (figure.name, figure.found) == ("thumb, ID 3", "nobody")
    assert "ID 3 at 500000 baud; set each with `ros2 run softgrip_driver setup --drive feetech" in figure.remedy
    feetech.servos[1].is_connected = False
    (figure,) = wrong(IdsStep(feetech.bench))
    assert figure.remedy.index("plugs at both ends of its cable") < figure.remedy.index("`id` in the cell file")


def test_a_feetech_bus_without_supply_and_one_with_a_wrong_supply_are_named(feetech: FeetechBench) -> None:
    for servo in feetech.servos:
        servo.shaft.supply_v = 12.0
    assert {figure.found for figure in wrong(SupplyStep(feetech.bench))} == {"12 V", "VOLTAGE"}
    for servo in feetech.servos:
        servo.is_connected = False
    with pytest.raises(FirstRunError, match=r"found nobody at any baud rate; check that the servos' supply is on"):
        wrong(IdsStep(feetech.bench))


def test_two_feetech_servos_with_one_id_are_named(feetech: FeetechBench) -> None:
    feetech.servos[1].registers.put("id", 2)
    feetech.servos[1].shaft.angle_rad = 1.7
    found = {figure.name: figure for figure in wrong(IdsStep(feetech.bench))}
    assert found["index, ID 2: servos with this ID"].found == "several"
    assert "--drive feetech" in found["index, ID 2: servos with this ID"].remedy


def test_a_feetech_servos_error_is_named_with_what_causes_it(feetech: FeetechBench) -> None:
    feetech.servos[0].forced_error_bits = 0x04  # memory table, servo status (65): temperature
    feetech.servos[0].step(0.0, 0.001)
    (figure,) = wrong(IdsStep(feetech.bench))
    assert (figure.found, figure.remedy) == (
        "TEMPERATURE", "let it cool down, then switch the supply of ID 2 off and on",
    )  # fmt: skip


def test_a_feetech_adapter_with_its_16_ms_is_named(tmp_path: Path, world: Any) -> None:
    bench = FeetechBench(tmp_path, world, latency_s=0.016).bench
    (figure,) = wrong(LatencyStep(bench))
    assert "make udev" in figure.remedy
    assert any("make udev" in one.remedy for one in wrong(RateStep(bench)))
