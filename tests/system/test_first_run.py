# SPDX-License-Identifier: Apache-2.0
"""From servos as they come to the first grasp, by the commands of docs/build alone, at an emulated bench.

The test types what docs/build/rehearsal.md says. It stands where the person does: it plugs servos in when the wizard
asks for them, presses Enter, and appends to the cell file.
"""

from __future__ import annotations

import json
import re
import shlex
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from softgrip_description.cell_file import load_cell
from softgrip_testing.scripts import load_script
from softgrip_testing.terminal import CommandTerminal

pytestmark = [pytest.mark.ros, pytest.mark.slow]
ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = ROOT / "docs" / "build"
pages = load_script(ROOT / "tools/pages/blocks.py")


def blocks(document: str) -> list[str]:
    """Return the blocks of a document that a person types, or puts into a file; a line that goes on below is one."""
    return [
        block.text.replace("\\\n", " ") for block in pages.blocks_of(DOCUMENTS / document) if block.mark != "hidden"
    ]


def words(line: str) -> list[str]:
    """Return a command line's words."""
    return shlex.split(line, comments=True)


def command(document: str, name: str) -> list[str]:
    """Return the words of the first command line of a document with a word in it."""
    return next(words(line) for block in blocks(document) for line in block.splitlines() if name in words(line))


Open = Callable[[str], CommandTerminal]


@pytest.fixture
def terminal(two_environments: tuple[dict[str, str], dict[str, str]], tmp_path: Path) -> Iterator[Open]:
    """Give terminals in one folder and one domain, and close them."""
    environment, second = two_environments
    opened: list[CommandTerminal] = []

    def open_terminal(line: str) -> CommandTerminal:
        # the page's second cell takes domain 1; beside other tests it is another one of this test's own
        line = re.sub(r"\bROS_DOMAIN_ID=1\b", f"ROS_DOMAIN_ID={second['ROS_DOMAIN_ID']}", line)
        opened.append(CommandTerminal(line, environment, tmp_path))
        return opened[-1]

    yield open_terminal
    for one in reversed(opened):
        one.end()
    for one in opened:
        try:
            one.process.wait(30.0)
        except subprocess.TimeoutExpired:
            one.end(signal.SIGKILL)


def test_the_rehearsal_has_the_commands_of_the_pages_that_it_stands_for() -> None:
    _, wizard, _, _, first_run = blocks("rehearsal.md")[:5]
    real = command("servos.md", "wizard")
    real[real.index("--port") + 1] = "wires/servos"
    assert words(wizard)[: len(real)] == real
    # the rest names what is not plugged in
    assert {word for word in words(wizard)[len(real) :] if word.startswith("--")} == {
        "--lockstep", "--camera", "--camera-calibration", "--stage", "--stage-kind", "--gauge", "--gauge-kind",
    }  # fmt: skip
    real = command("first_grasp.md", "first_run")
    assert words(first_run)[1 : 1 + len(real)] == real


@pytest.mark.long
@pytest.mark.timeout(600)
def test_from_the_boxes_to_the_first_grasp(terminal: Open, tmp_path: Path) -> None:
    bench, wizard, plug_in, sections, first_run, cell_that_works, egg = blocks("rehearsal.md")[:7]
    at_bench = terminal(bench)
    assert at_bench.read_until(("wires in wires",), 60.0), at_bench.text
    at_wizard = terminal(wizard)
    while at_wizard.read_until(("then press Enter", "]: ", "written to cell.yaml"), 240.0) != "written to cell.yaml":
        asked = at_wizard.text.rpartition("? ")[2]
        if "put the servo of" in asked:
            plugged = terminal(plug_in.replace("@index", f"@{asked.split(chr(39))[1]}"))
            assert plugged.read_until(("success=True",), 60.0), plugged.text
        at_wizard.press_enter()
    assert at_wizard.process.wait(20.0) == 0, at_wizard.text
    file = tmp_path / "cell.yaml"
    cell = load_cell(file)
    chain = cell.servos
    assert cell.rig is not None
    assert (cell.rig.stage.port, cell.rig.gauge.port) == ("wires/stand", "wires/gauge")
    assert cell.camera is not None
    assert cell.camera.calibration == tmp_path / "wires/camera_calibration.yaml"
    assert cell.folders.out == tmp_path / "out"
    assert chain is not None
    assert [(one.tendon, one.servo_id, one.direction) for one in chain.chain] == [
        ("index", 1, 1), ("middle", 2, -1), ("thumb", 3, 1),
    ]  # fmt: skip

    file.write_text(file.read_text() + sections)
    at_checklist = terminal(first_run)
    assert at_checklist.read_until(("Who ran it", "page:"), 540.0) == "Who ran it", at_checklist.text[-3000:]
    at_checklist.press_enter()
    assert at_checklist.read_until(("page: first_run/first_run.html",), 60.0), at_checklist.text[-3000:]
    assert at_checklist.process.wait(60.0) == 0
    verified = terminal(shlex.join(command("first_grasp.md", "--verify")))
    assert verified.read_until(("holds, run by",), 60.0), verified.text
    record = json.loads((tmp_path / "first_run" / "first_run.json").read_text())
    figures = {figure["name"]: figure["found"] for report in record["reports"] for figure in report["figures"]}
    assert (figures["points accepted"], figures["outcome"]) == ("9", "GRIPPED")
    assert {report["status"] for report in record["reports"]} == {"good"}
    page = (tmp_path / "first_run" / "first_run.html").read_text()
    assert "A rehearsal on an emulated bench" in page
    assert record["digest"] in page

    at_cell = terminal(cell_that_works)
    assert at_cell.read_until(("the page is at",), 120.0), at_cell.text[-3000:]
    at_egg = terminal(egg)
    assert at_egg.read_until(("egg: ",), 240.0), at_egg.text[-3000:]
    assert at_egg.process.wait(30.0) == 0, at_egg.text[-3000:]
    assert "egg: GRIPPED" in at_egg.text


#: What docs/bench.md ends with: servos that `wizard` has set up, a stand with its gauge, a camera; nothing here says
#: that they are emulated. Two processors for the bench and its cell: replies come later than a real servo's.
BENCH = """schema: 1
hardware: real
servos:
  port: wires/servos
  chain:
    - {tendon: index, model: XL330-M288, id: 1, direction: 1, spool_radius_m: 0.010, slack_m: 0.005}
    - {tendon: middle, model: XL330-M288, id: 2, direction: 1, spool_radius_m: 0.010, slack_m: 0.005}
    - {tendon: thumb, model: XL330-M288, id: 3, direction: 1, spool_radius_m: 0.010, slack_m: 0.005}
rig: {stage: {kind: mark10, port: wires/stand}, gauge: {kind: gcl2, port: wires/gauge}}
camera: {source: "@wires/camera.url", calibration: wires/camera_calibration.yaml}
folders: {out: out}
parameters:
  tendon_driver: {reply_margin_s: 0.05, no_reply_s: 0.5, bus_watchdog_s: 0.0}
"""


@pytest.mark.long
@pytest.mark.timeout(600)
def test_real_hardware_over_pseudo_terminals_goes_from_its_ports_to_the_first_grasp(
    terminal: Open, tmp_path: Path
) -> None:
    """In real time, by the command of docs/bench.md; the hands are the emulated bench's."""
    (tmp_path / "cell.yaml").write_text(BENCH)
    at_bench = terminal("ros2 run softgrip_emulator emulated_cell --ros-args -p wire_dir:=wires -p camera_fps:=6.0")
    assert at_bench.read_until(("wires in wires",), 60.0), at_bench.text
    line = shlex.join(command("../bench.md", "first_run"))
    at_checklist = terminal(f"{line} --hands emulator --launch-argument gripper:=false panel:=false")
    assert at_checklist.read_until(("Who ran it", "page:"), 540.0) == "Who ran it", at_checklist.text[-3000:]
    record = json.loads((tmp_path / "first_run" / "first_run.json").read_text())
    figures = {figure["name"]: figure["found"] for report in record["reports"] for figure in report["figures"]}
    assert (figures["points accepted"], figures["outcome"]) == ("9", "GRIPPED")
    assert {report["status"] for report in record["reports"]} == {"good"}
