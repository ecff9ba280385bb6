# SPDX-License-Identifier: Apache-2.0
"""What a beginner does wrong, as docs/build/rehearsal.md causes it at the emulated bench: the checklist names it.

Each row of the page's table is injected as it stands there; its step must be bad and say the row's words, and good
when the fault is cleared.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from softgrip_demo.first_run import bus_steps, camera_steps
from softgrip_demo.first_run.bus_steps import BenchBus
from softgrip_demo.first_run.camera_steps import BenchCamera
from softgrip_demo.first_run.checklist import Checklist, CheckStep
from softgrip_demo.first_run.figures import StepReport, StepStatus
from softgrip_demo.first_run.record import load_record
from softgrip_description.cell_file import (
    CellCamera,
    CellFile,
    CellRig,
    ChainServo,
    RigGauge,
    RigStage,
    ServoChain,
    load_cell,
    save_cell,
)
from softgrip_driver.commands import setup
from softgrip_driver.commands.person import GivenAnswers, WrittenAnswers
from softgrip_driver.commands.wizard import SECTION_OPTIONS
from softgrip_driver.errors import ConfigurationError
from softgrip_driver.wizard.drive_setup import drive_setup
from softgrip_driver.wizard.naming import find_new_servo
from softgrip_driver.wizard.sections import CellSections, FoundDevices
from softgrip_emulator.cell import EmulatedCell
from softgrip_emulator.dynamixel.servo import FACTORY_BAUD, FACTORY_ID
from softgrip_emulator.plant.cell import STEP_S, ServoPlace
from softgrip_model.profile import load_directory, shipped_directory
from softgrip_time import SimulatedClock

PAGE = Path(__file__).parents[2] / "docs/build/rehearsal.md"
SLOTS = ("index", "middle", "thumb")
DIRECTIONS = (1, -1, 1)
ROW = re.compile(r"^\| ([^|]+) \| `(\{fault: [^`]+)` \| (\w+) \| ([^|]+) \|$", re.MULTILINE)
ROWS = [tuple(row) for row in ROW.findall(PAGE.read_text(encoding="utf-8"))]
#: step zero pulls every tendon several times: half a minute of one processor
CHECKED = [pytest.param(*row, id=row[0], marks=[pytest.mark.long] if row[2] == "zero" else []) for row in ROWS]


class Bench:
    """The emulated bench of the page, its time waiting for the checklist, and the cell file that the wizard wrote."""

    def __init__(
        self, folder: Path, directions: tuple[int, ...] = DIRECTIONS, *, is_fresh: bool = False, latency_s: float = 0.0
    ) -> None:
        self.folder, self.wires = folder, folder / "wires"
        chain = [
            ServoPlace(
                slot,
                FACTORY_ID if is_fresh else number,
                "xl330_m288",
                FACTORY_BAUD if is_fresh else 1_000_000,
                0,
                spool_direction=direction,
            )
            for number, (slot, direction) in enumerate(zip(SLOTS, directions, strict=True), start=1)
        ]
        self.cell = EmulatedCell(
            load_directory(shipped_directory()), self.wires, speed=0.0, chain=chain, adapter_latency_s=latency_s
        )
        self.cell.plant.mount(SLOTS, ("PW-I-01", "PW-M-01", "PW-T-01"), ("power",) * 3)
        if is_fresh:
            for slot in SLOTS:
                self.cell.faults.inject("servo_unplugged", slot)
        self.cell.open()
        rows = tuple(
            ChainServo(slot, "XL330-M288", number, direction, slack_m=0.005)
            for number, (slot, direction) in enumerate(zip(SLOTS, DIRECTIONS, strict=True), start=1)
        )
        camera = CellCamera(f"@{self.wires}/camera.url", self.wires / "camera_calibration.yaml")
        self.file = CellFile("real", servos=ServoChain(str(self.wires / "servos"), 1_000_000, rows), camera=camera)
        (folder / "cell.yaml").write_text("schema: 1\nhardware: real\n")

    def look(self, key: str) -> StepReport:
        """Do a step, as a new run of the command does some seconds later, and return what it came to."""
        clock = SimulatedClock(self.wires / "time", "bench")
        clock.wait(clock.now_s() + 3.0)
        bus = BenchBus(self.file, selftest_s=0.5, clock=clock)
        assert self.file.camera is not None
        camera = BenchCamera(self.file.camera, clock=clock)
        kinds = [*vars(bus_steps).values(), *vars(camera_steps).values()]
        (kind,) = [one for one in kinds if getattr(one, "key", None) == key]
        step: CheckStep = kind(bus if kind.__module__ == bus_steps.__name__ else camera)
        path = self.folder / "record.json"
        record = Checklist([step], load_record(path, self.folder / "cell.yaml"), path, lambda _: None)
        return record.run(self.file, again=(key,)).reports[key]


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    made = Bench(tmp_path)
    yield made
    made.cell.close()


def test_the_page_has_the_faults_that_its_neighbour_lists() -> None:
    """docs/build/first_grasp.md names what goes wrong most often; two of it are caused without a request."""
    assert len(ROWS) >= 12
    text = PAGE.read_text(encoding="utf-8")
    for wrong in (
        "Two servos with one ID",
        "baud rate",
        "wound the other way",
        "no supply",
        "16 ms",
        "focus",
        "marker",
    ):
        assert wrong in text


@pytest.mark.parametrize(("wrong", "request_text", "key", "words"), CHECKED)
def test_a_fault_of_the_page_is_named_by_its_step(
    bench: Bench, wrong: str, request_text: str, key: str, words: str
) -> None:
    request = yaml.safe_load(request_text)
    arguments = {one["name"]: one["value"]["double_value"] for one in request.get("arguments", [])}
    bench.cell.faults.inject(request["fault"], request.get("target", ""), 0.0, arguments)
    bad = bench.look(key)
    assert bad.status is StepStatus.BAD, wrong
    assert any(words in complaint for complaint in bad.complaints), bad.complaints
    bench.cell.faults.clear()
    for line in re.findall(r"`ros2 run softgrip_driver setup ([^`]+ --reboot)`", " ".join(bad.complaints)):
        assert setup.main(shlex.split(line)) == 0  # what outlives its cause is ended as the step says
    good = bench.look(key)
    assert good.status is StepStatus.GOOD, good.complaints


def test_a_tendon_wound_the_other_way_round_is_named(tmp_path: Path) -> None:
    bench = Bench(tmp_path, (1, 1, 1))
    try:
        report = bench.look("zero")
        (complaint,) = report.complaints
        assert "middle: pulls in direction: expected -1, found 1; the tendon of 'middle' is wound" in complaint
    finally:
        bench.cell.close()


@pytest.mark.long
def test_a_knot_that_slips_while_the_wizard_pulls_is_named(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    plant, step = bench.cell.plant, bench.cell.plant.step

    def slipping(dt_s: float = STEP_S) -> None:
        step(dt_s)
        if plant.bank.tension_n[1] > 4.0:
            slack_m = plant.disturbances.extra_slack_m
            slack_m["middle"] = slack_m.get("middle", 0.0) + 1e-3 * dt_s

    monkeypatch.setattr(plant, "step", slipping)
    (complaint,) = bench.look("zero").complaints
    assert "middle: zero moved by" in complaint
    assert "a knot that slips" in complaint


def test_two_new_servos_at_once_are_named(tmp_path: Path) -> None:
    bench = Bench(tmp_path, is_fresh=True)
    try:
        for slot in ("index", "middle"):
            bench.cell.faults.clear(f"servo_unplugged@{slot}")
        clock = SimulatedClock(bench.wires / "time", "bench")
        with pytest.raises(ConfigurationError, match="found several with ID 1"):
            find_new_servo(drive_setup(None), str(bench.wires / "servos"), 1_000_000, (), clock)
    finally:
        bench.cell.close()


def test_what_the_page_tells_the_wizard_of_camera_and_rig_is_so(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The options of the page's wizard command; stage and gauge have answered over their wires."""
    monkeypatch.chdir(tmp_path)
    line = next(
        text for text in PAGE.read_text(encoding="utf-8").replace("\\\n", " ").splitlines() if " wizard " in text
    )
    words = shlex.split(line)
    given = {
        key: words[words.index(option) + 1]
        for key in SECTION_OPTIONS
        if (option := "--" + key.replace(".", "-")) in words
    }
    assert {*given} == {"camera", "camera.calibration", "stage", "stage.kind", "gauge", "gauge.kind"}
    person = GivenAnswers(given, WrittenAnswers({}, takes_defaults=True))
    clock = SimulatedClock(bench.wires / "time", "bench")
    cell = CellFile("real")
    for _, fill in [*CellSections(person, FoundDevices(), tmp_path, clock).missing(cell)]:
        cell = fill(cell)
    assert cell.rig == CellRig(RigStage("mark10", "wires/stand"), RigGauge("gcl2", "wires/gauge"))
    assert cell.camera == CellCamera("@wires/camera.url", tmp_path / "wires/camera_calibration.yaml")
    save_cell(cell, tmp_path / "cell.yaml")
    assert load_cell(tmp_path / "cell.yaml") == cell


def test_an_adapter_may_have_its_16_ms_from_the_start(tmp_path: Path) -> None:
    bench = Bench(tmp_path, latency_s=0.016)
    try:
        assert any("make udev" in complaint for complaint in bench.look("latency").complaints)
    finally:
        bench.cell.close()
