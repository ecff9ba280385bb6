# SPDX-License-Identifier: Apache-2.0
"""The first run: figures beside bounds, going on where it was left, the signed page; faults of the bus."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from softgrip_cell.storage import Database, Library
from softgrip_demo.errors import FirstRunError
from softgrip_demo.first_run import bus_steps, figures
from softgrip_demo.first_run.bus_steps import (
    BenchBus,
    IdsStep,
    LatencyStep,
    PortsStep,
    RateStep,
    SupplyStep,
    TensionStep,
    ZeroStep,
)
from softgrip_demo.first_run.checklist import Checklist
from softgrip_demo.first_run.cube import TEST_CUBE, add_test_cube
from softgrip_demo.first_run.figures import Figure, StepReport, StepStatus
from softgrip_demo.first_run.record import FirstRunRecord, load_record, render, save_record
from softgrip_demo.nodes.first_run import cell_steps, sign, verify
from softgrip_description.cell_file import CellFile, ChainServo, ServoChain, TorqueValues
from softgrip_driver.wizard.drive_setup import BusMeasurement
from softgrip_driver.wizard.tensioning import SettledZero, Tensioner
from softgrip_emulator.dynamixel.chain import DynamixelChain
from softgrip_emulator.dynamixel.servo import EmulatedServo
from softgrip_emulator.dynamixel.table import load_model
from softgrip_emulator.wire.pty import PtyPort
from softgrip_emulator.wire.usb_adapter import UsbAdapter

CELL = CellFile("real")


@dataclass
class Step:
    """A step that gives the figures it was made with."""

    key: str
    figures: tuple[Figure, ...] = ()
    error: Exception | None = None
    needs: tuple[str, ...] = ()
    title: str = "A step"
    runs: int = 0

    def measure(self) -> Iterator[Figure]:
        self.runs += 1
        yield from self.figures
        if self.error:
            raise self.error


GOOD = figures.at_most("length", 1.0, 2.0, "mm", "shorten it")
BAD = figures.at_most("length", 3.0, 2.0, "mm", "shorten it")


@pytest.fixture
def cell_file(tmp_path: Path) -> Path:
    path = tmp_path / "cell.yaml"
    path.write_text("schema: 1\nhardware: real\n")
    return path


def run(steps: list[Step], tmp_path: Path, lines: list[str], again: tuple[str, ...] = ()) -> FirstRunRecord:
    path = tmp_path / "record.json"
    return Checklist(steps, load_record(path, tmp_path / "cell.yaml"), path, lines.append).run(CELL, again)


@pytest.mark.parametrize(
    ("figure", "is_good"),
    [
        (figures.at_most("a", 2.0, 2.0, "", ""), True),
        (figures.at_most("a", 2.001, 2.0, "", ""), False),
        (figures.at_most("a", float("nan"), 2.0, "", ""), False),
        (figures.at_least("a", 2.0, 2.0, "", ""), True),
        (figures.at_least("a", 1.999, 2.0, "", ""), False),
        (figures.within("a", 3.7, (3.7, 6.0), "V", ""), True),
        (figures.within("a", 6.1, (3.7, 6.0), "V", ""), False),
        (figures.equal_to("a", 9, 9, ""), True),
        (figures.equal_to("a", 8, 9, ""), False),
    ],
)
def test_a_figure_is_good_within_its_bound(figure: Figure, is_good: bool) -> None:
    assert figure.is_good is is_good


def test_it_stops_at_the_first_bad_step_and_goes_on_there(tmp_path: Path, cell_file: Path) -> None:
    lines: list[str] = []
    steps = [Step("one", (GOOD,)), Step("two", (GOOD, BAD)), Step("three", (GOOD,))]
    record = run(steps, tmp_path, lines)
    assert [report.status for report in record.reports.values()] == [StepStatus.GOOD, StepStatus.BAD]
    assert "  -> length: expected at most 2 mm, found 3 mm; shorten it" in lines
    assert not record.is_good
    steps[1].figures = (GOOD,)
    record = run(steps, tmp_path, lines)
    assert [step.runs for step in steps] == [1, 2, 1]
    assert record.is_good
    run(steps, tmp_path, lines, again=("one",))
    assert [step.runs for step in steps] == [2, 2, 1]


def test_a_step_that_can_not_go_on_keeps_what_it_measured(tmp_path: Path, cell_file: Path) -> None:
    record = run([Step("one", (GOOD,), FirstRunError("expected a, found b; do c"))], tmp_path, [])
    (report,) = record.reports.values()
    assert (report.status, report.figures, report.complaints) == (
        StepStatus.BAD,
        (GOOD,),
        ["expected a, found b; do c"],
    )


def test_a_device_that_the_cell_lacks_is_left_out(tmp_path: Path, cell_file: Path) -> None:
    step = Step("rig", (BAD,), needs=("servos", "rig"))
    (report,) = run([step], tmp_path, []).reports.values()
    assert (step.runs, report.status, report.problem) == (
        0,
        StepStatus.LEFT_OUT,
        "the cell file has no servos and no rig",
    )


def test_servos_that_are_not_set_up_here_leave_the_bus_out_and_say_why(tmp_path: Path, cell_file: Path) -> None:
    """Damiao motors: homing, checks and grasp are done all the same."""
    rows = (ChainServo("index", "DM-J4310-2EC", 1, 1, 0.0157),)
    cell = CellFile("real", servos=ServoChain("/dev/none", 1_000_000, rows, "damiao"))
    lines: list[str] = []
    record = load_record(tmp_path / "record.json", cell_file)
    steps = [IdsStep(BenchBus(cell)), RateStep(BenchBus(cell)), Step("home", (GOOD,))]
    reports = Checklist(steps, record, tmp_path / "record.json", lines.append).run(cell).reports
    assert [report.status for report in reports.values()] == [
        StepStatus.LEFT_OUT, StepStatus.LEFT_OUT, StepStatus.GOOD,
    ]  # fmt: skip
    assert "with the maker's tool" in reports["ids"].problem
    assert [one.key for one in cell_steps(None, None, cell, "power")] == ["home", "friction", "checks", "grasp"]  # type: ignore[arg-type]


def test_another_cell_file_begins_from_the_first_step(tmp_path: Path, cell_file: Path) -> None:
    step = Step("one", (GOOD,))
    run([step], tmp_path, [])
    cell_file.write_text("schema: 1\nhardware: emulated\n")
    run([step], tmp_path, [])
    assert step.runs == 2


def test_a_damaged_record_is_named(tmp_path: Path, cell_file: Path) -> None:
    (tmp_path / "record.json").write_text("{")
    with pytest.raises(FirstRunError, match="delete it to begin from the first step"):
        load_record(tmp_path / "record.json", cell_file)


def test_the_signature_holds_for_every_figure(tmp_path: Path, cell_file: Path) -> None:
    path, said = tmp_path / "record.json", []
    checklist = Checklist([Step("one", (GOOD,))], load_record(path, cell_file), path, said.append)
    record = sign(checklist.run(CELL), "Ada")
    assert replace(record, name="Bob").digest != record.digest
    save_record(replace(record, name="", signed_at=""), path)
    assert verify(path, cell_file, said.append) == 1
    assert "nobody has signed" in said[-1]
    save_record(record, path)
    assert verify(path, cell_file, said.append) == 0
    data = json.loads(path.read_text())
    data["reports"][0]["figures"][0]["found"] = "0.5 mm"
    path.write_text(json.dumps(data))
    assert verify(path, cell_file, said.append) == 1
    assert record.with_report(record.reports["one"]).name == ""


def test_a_rehearsal_is_named_for_good(tmp_path: Path, cell_file: Path) -> None:
    """A page of an emulated bench must not pass for one of real devices, even if the rest was done on them."""
    path = tmp_path / "record.json"
    real = sign(Checklist([Step("one", (GOOD,))], load_record(path, cell_file), path, [].append).run(CELL), "Ada")
    assert "rehearsal on an" not in render(real)
    rehearsal = real.on_emulated_bench()
    assert rehearsal.name == ""
    assert rehearsal.digest != replace(real, name="", signed_at="").digest
    save_record(rehearsal, path)
    found = load_record(path, cell_file)
    assert found.is_emulated
    assert found.on_emulated_bench() is found
    assert "rehearsal on an emulated bench" in render(found)


def test_the_page_shows_every_figure_and_runs_nothing_of_what_it_shows(tmp_path: Path, cell_file: Path) -> None:
    hostile = figures.equal_to("<script>alert(1)</script>", "<b>", "a", "<i>do</i>")
    record = run([Step("one", (GOOD,)), Step("two", (hostile,), FirstRunError("<u>"))], tmp_path, [])
    page = render(record)
    assert all(text in page for text in ("1 mm", "at most 2 mm", "not good", "Not signed", "&lt;script&gt;"))
    assert not any(text in page for text in ("<script", "<b>", "<i>", "<u>"))
    signed = sign(record, "Ada")
    assert signed.digest in render(signed)


def test_the_cube_is_put_beside_the_shipped_products_once(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path}/cell.db"
    add_test_cube(url, "test")
    add_test_cube(url, "test")
    database = Database(url)
    with database:
        products = Library(database, lambda: 0).catalogue().products
    assert len(products) == 15 + 1
    assert products[TEST_CUBE.id] == TEST_CUBE


# --- the bus, over a pseudo-terminal ----------------------------------------------------------------------------------


class Bus:
    """Servos on a port, and the cell file that they should be."""

    def __init__(self, folder: Path, latency_s: float | None = None, supply_v: float = 5.0) -> None:
        self.servos = [EmulatedServo(load_model("xl330_m288"), number, baud=1_000_000) for number in (1, 2)]
        for servo in self.servos:
            servo.shaft.supply_v = supply_v
            servo.registers.put("return_delay_time", 0)
            servo.step(0.0, 0.001)
        chain = DynamixelChain(self.servos, before=self._live)
        self.port = PtyPort(folder / "servos", chain if latency_s is None else UsbAdapter(chain, latency_s)).start()
        rows = tuple(
            ChainServo(name, "XL330-M288", number, 1, 0.010, 0.005) for number, name in enumerate(("index", "thumb"), 1)
        )
        self.cell = CellFile("real", servos=ServoChain(str(folder / "servos"), 1_000_000, rows))
        self.bench = BenchBus(self.cell, reply_margin_s=0.1, selftest_s=0.3)

    def _live(self, now_s: float) -> None:
        for servo in self.servos:
            servo.step(now_s, 0.001)


@pytest.fixture
def bus(tmp_path: Path) -> Iterator[Bus]:
    made = Bus(tmp_path)
    yield made
    made.port.close()


def wrong(step: object) -> list[Figure]:
    return [figure for figure in step.measure() if not figure.is_good]  # type: ignore[attr-defined]


def test_a_good_bus_passes(bus: Bus) -> None:
    for kind in (PortsStep, IdsStep, SupplyStep, TensionStep):
        assert wrong(kind(bus.bench)) == []


def test_two_servos_with_one_id_are_named(bus: Bus) -> None:
    bus.servos[1].registers.put("id", 1)
    bus.servos[1].shaft.angle_rad = 1.7
    found = {figure.name: figure for figure in wrong(IdsStep(bus.bench))}
    assert found["index, ID 1: servos with this ID"].found == "several"
    assert "one at a time" in found["index, ID 1: servos with this ID"].remedy
    assert found["thumb, ID 2"].found == "nobody"


def test_a_servo_whose_plug_came_off_is_named_by_the_plug_first(bus: Bus) -> None:
    bus.servos[1].is_connected = False
    (figure,) = wrong(IdsStep(bus.bench))
    assert (figure.name, figure.found) == ("thumb, ID 2", "nobody")
    assert figure.remedy.index("plugs at both ends of its cable") < figure.remedy.index("`id` in the cell file")


def test_a_servo_at_another_baud_rate_is_named(bus: Bus) -> None:
    bus.servos[1].registers.put("baud_rate", 1)
    (figure,) = wrong(IdsStep(bus.bench))
    assert (figure.name, figure.found) == ("thumb, ID 2", "nobody")
    assert "ID 2 at 57600 baud (as new); set each with `ros2 run softgrip_driver setup" in figure.remedy


def test_a_bus_without_supply_is_named(bus: Bus) -> None:
    for servo in bus.servos:
        servo.is_connected = False
    with pytest.raises(FirstRunError, match=r"found nobody at any baud rate; check that the servos' supply is on"):
        wrong(IdsStep(bus.bench))


def test_a_wrong_supply_is_named(bus: Bus) -> None:
    for servo in bus.servos:
        servo.shaft.supply_v = 7.4
    found = wrong(SupplyStep(bus.bench))
    # an XL330 keeps the error until it is reset, so a supply that is right again is not all
    assert {figure.found for figure in found} == {"7.4 V", "INPUT_VOLTAGE"}
    assert all("use another supply" in figure.remedy or "--reboot" in figure.remedy for figure in found)


@pytest.mark.parametrize(
    ("bit", "cause"),
    [
        (0x01, "its supply is or was not 3.7 to 6 V"),
        (0x20, "free its tendon"),
        (0x04, "let it cool down"),
        (0x10, "remove"),
    ],
)  # bits: e-manual XL330-M288, Hardware Error Status (70)
def test_a_hardware_error_is_named_with_what_causes_it(bus: Bus, bit: int, cause: str) -> None:
    bus.servos[0].forced_error_bits = bit
    bus.servos[0].step(0.0, 0.001)
    port = bus.bench.chain.port
    for kind in (IdsStep, SupplyStep):
        (figure,) = [one for one in wrong(kind(bus.bench)) if "hardware error" in one.name]
        assert cause in figure.remedy
        assert f"`ros2 run softgrip_driver setup --port {port} --baud 1000000 --id 1 --reboot`" in figure.remedy


def test_an_adapter_with_its_16_ms_is_named(tmp_path: Path) -> None:
    bus = Bus(tmp_path, latency_s=0.016)
    try:
        (figure,) = wrong(LatencyStep(bus.bench))
        assert "make udev" in figure.remedy
        assert any("make udev" in one.remedy for one in wrong(RateStep(bus.bench)))
    finally:
        bus.port.close()


def test_an_adapters_timer_is_looked_at_where_it_has_one() -> None:
    bench = BenchBus(CELL)
    bench.__dict__["measured"] = BusMeasurement(3, 1_000_000, 400.0, 0.002, 0.003, 0.001, 0.0, 0, {1: 0.0}, 0.016)
    (figure,) = wrong(LatencyStep(bench))
    assert (figure.name, figure.found) == ("latency timer of the adapter", "16 ms")


def test_an_unknown_direction_and_a_missing_port_are_named(bus: Bus, tmp_path: Path) -> None:
    assert bus.cell.servos is not None
    row = replace(bus.cell.servos.chain[0], direction=None, slack_m=None)
    bench = replace(bus.bench, cell=replace(bus.cell, servos=replace(bus.cell.servos, chain=(row,))))
    assert [(figure.name, figure.found) for figure in wrong(ZeroStep(bench))] == [
        ("index: direction", "unknown"), ("index: tensioned", "no"),
    ]  # fmt: skip
    missing = replace(bus.bench, cell=CellFile("real", servos=ServoChain(str(tmp_path / "none"))))
    (figure,) = wrong(PortsStep(missing))
    assert figure.found == "nothing there"


def test_the_fingers_are_let_go_after_the_zero(bus: Bus, monkeypatch: pytest.MonkeyPatch) -> None:
    """The camera's steps look for a straight finger next."""
    settled = {"index": SettledZero(0.030, 1e-4, 2), "thumb": SettledZero(0.020, 0.0, 2)}
    monkeypatch.setattr(Tensioner, "settle", lambda _: settled)
    monkeypatch.setattr(bus_steps, "measure_direction", lambda _, servo, __: servo.direction)
    let_go: dict[str, float] = {}
    monkeypatch.setattr(bus_steps, "release", lambda _, goals, __: let_go.update(goals))
    assert wrong(ZeroStep(bus.bench)) == []
    assert let_go == pytest.approx({"index": 0.025, "thumb": 0.015})  # slack_m of the cell file


def tension_figures(bus: Bus, torque: TorqueValues, model: str = "XL330-M288") -> list[Figure]:
    """The step's figures of one servo with these values in the cell file."""
    assert bus.cell.servos is not None
    row = replace(bus.cell.servos.chain[0], torque=torque, model=model)
    cell = replace(bus.cell, servos=replace(bus.cell.servos, chain=(row,)))
    return list(TensionStep(replace(bus.bench, cell=cell)).measure())


def test_tensions_that_nobody_calibrated_are_remarked_upon(bus: Bus) -> None:
    share, hidden = tension_figures(bus, TorqueValues())
    assert (share.name, share.found, share.bound, share.is_good) == (
        "index: uncertainty, from data sheet", "15 %", "at most 15 %", True,
    )  # fmt: skip
    # e-manual: 0.52 N m at 1.47 A; 50 mA of friction on a spool of 10 mm, either way: a uniform half width
    assert "not calibrated: data-sheet values, +-15 % and 1.0 N" in share.remark
    assert "calibrate_tension" in share.remark
    assert (hidden.found, hidden.bound, hidden.is_good) == ("1.02 N", "at most 1.5 N", True)
    (report,) = [StepReport("tension", "t", StepStatus.GOOD, (share, hidden))]
    assert report.remarks == [f"{share.name}: {share.remark}"]
    assert report.complaints == []


def test_calibrated_tensions_want_no_remark_and_a_poor_calibration_is_named(bus: Bus) -> None:
    good = TorqueValues(0.36, 0.03, tension_stddev_share=0.04)
    share, hidden = tension_figures(bus, good)
    assert (share.name, share.found, share.remark, share.is_good) == (
        "index: uncertainty, from calibrate_tension", "4 %", "", True,
    )  # fmt: skip
    assert hidden.found == "0.624 N"  # 0.36 / 0.010 * 0.03 / sqrt(3)
    poor, gears = tension_figures(bus, replace(good, tension_stddev_share=0.3, friction_current_a=0.2))
    assert [(poor.is_good, "calibrate_tension" in poor.remedy), (gears.is_good, gears.found)] == [
        (False, True), (False, "4.16 N"),
    ]  # fmt: skip


def test_the_page_says_at_its_head_and_beside_the_figure_what_was_not_calibrated(
    tmp_path: Path, cell_file: Path
) -> None:
    lines: list[str] = []
    plain = run([Step("one", (GOOD,))], tmp_path, lines)
    assert "remark" not in json.dumps(json.loads((tmp_path / "record.json").read_text()))
    assert "Good with" not in render(plain)
    remarked = run([Step("two", (GOOD.with_remark("not calibrated: +-15 %"),))], tmp_path, lines)
    assert remarked.is_good
    assert "  -- length: not calibrated: +-15 %" in lines
    page = render(sign(remarked, "Ada"))
    assert "Good with 1 remark: length: not calibrated: +-15 %" in page
    assert page.count("not calibrated: +-15 %") == 2
    assert load_record(tmp_path / "record.json", cell_file).digest == remarked.digest


@pytest.mark.skipif(shutil.which("chromium") is None, reason="no Chromium here (make panel-setup)")
def test_the_signed_page_prints_to_pdf(tmp_path: Path, cell_file: Path) -> None:
    record = run([Step(f"step {number}", (GOOD,) * 9) for number in range(15)], tmp_path, [])
    page, pdf = tmp_path / "page.html", tmp_path / "page.pdf"
    page.write_text(render(sign(record, "Ada")), encoding="utf-8")
    options = ("--headless", "--no-sandbox", "--disable-gpu", "--no-pdf-header-footer", f"--print-to-pdf={pdf}")
    subprocess.run(["chromium", *options, page.as_uri()], capture_output=True, check=True, timeout=60)
    printed = pdf.read_bytes()
    assert printed.startswith(b"%PDF")
    # two or three whole sections to a page, which none of them is broken across
    assert 5 <= len(re.findall(rb"/Type\s*/Page\b", printed)) <= 8
