# SPDX-License-Identifier: Apache-2.0
"""The first run on emulated servos with fingers: a spool that is wound the other way round than the cell file says."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from softgrip_demo.first_run.bus_steps import BenchBus, ZeroStep
from softgrip_demo.first_run.figures import Figure
from softgrip_description.cell_file import CellFile, ChainServo, ServoChain
from softgrip_driver.errors import ConfigurationError
from softgrip_emulator.plant.cell import CellPlant, ServoPlace, Supply
from softgrip_emulator.servos import load_ratings, make_chain
from softgrip_model.profile import load_directory, shipped_directory
from softgrip_testing.scripts import load_script

worlds = load_script(Path(__file__).parents[2] / "softgrip_driver/test/worlds.py")
TENDONS = ("index", "middle", "thumb")
SLACK_M = 0.005


class Spools:
    """Three fingers, their tendons wound one way or the other, and a cell file that says all are wound the same way."""

    def __init__(self, folder: Path, world: Any, wound: tuple[int, ...], model: str = "XL330-M288") -> None:
        chain = [
            ServoPlace(name, device_id=number, model=model, spool_direction=direction)
            for number, (name, direction) in enumerate(zip(TENDONS, wound, strict=True), start=1)
        ]
        supply = Supply(load_ratings(model).nominal_voltage_v)
        self.plant = CellPlant(load_directory(shipped_directory()), seed=3, chain=chain, supply=supply)
        self.plant.mount(TENDONS, list("abc"), ["power"] * 3)
        self.plant.now_s = world.clock.now_s()
        bus = make_chain(self.plant.servos, self.plant.lock, self.plant.advance_to)
        self.port = world.port(folder / "servos", bus)
        world.live(self.plant.advance_to)
        rows = tuple(ChainServo(name, model, k, 1, 0.010, SLACK_M) for k, name in enumerate(TENDONS, 1))
        cell = CellFile(
            "real",
            servos=ServoChain(str(folder / "servos"), 1_000_000, rows, "feetech" if model == "STS3215" else None),
        )
        self.step = ZeroStep(BenchBus(cell))

    def powered(self) -> list[int]:
        return [servo.registers.get("torque_enable") for servo in self.plant.servos]


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    made = worlds.OwnWorld(monkeypatch)
    yield made
    made.close()


@pytest.mark.parametrize("model", ["XL330-M288", pytest.param("STS3215", marks=pytest.mark.long)])
def test_a_reversed_spool_is_named_and_nothing_is_homed(tmp_path: Path, world: Any, model: str) -> None:
    bench = Spools(tmp_path, world, (1, -1, 1), model)
    figures = list(bench.step.measure())
    directions = [figure for figure in figures if "pulls in direction" in figure.name]
    assert [(figure.found, figure.bound, figure.is_good) for figure in directions] == [
        ("1", "1", True), ("-1", "1", False), ("1", "1", True),
    ]  # fmt: skip
    assert "the tendon of 'middle' is wound the other way round" in directions[1].remedy
    assert not [figure for figure in figures if "zero moved" in figure.name]
    assert bench.powered() == [0, 0, 0]


def test_a_tendon_that_came_off_is_named(tmp_path: Path, world: Any) -> None:
    bench = Spools(tmp_path, world, (1, 1, 1))
    bench.plant.disturbances.broken_tendons.add("middle")
    found: list[Figure] = []
    with pytest.raises(ConfigurationError, match="middle: expected a tendon that holds the spool within 20 mm"):
        found.extend(bench.step.measure())
    assert bench.powered() == [0, 0, 0]
