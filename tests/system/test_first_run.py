# SPDX-License-Identifier: Apache-2.0
"""From servos as they come to the first grasp, by the commands of docs/build alone, at an emulated bench.

The test stands where the person does: it plugs servos in when the wizard asks for them and presses Enter.
"""

from __future__ import annotations

import json
import shlex
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from softgrip_description.cell_file import load_cell
from softgrip_testing.terminal import Terminal

pytestmark = [pytest.mark.ros, pytest.mark.slow]
Launch = Callable[..., Any]
DOCUMENTS = Path(__file__).resolve().parents[2] / "docs" / "build"
#: What a person adds to the wizard's file, with the ports of the emulated bench. The cell that the first run starts is
#: emulated with the same spools: an emulated one keeps up however busy the computer is.
SECTIONS = """
camera: {{source: "@{wires}/camera.url", calibration: {wires}/camera_calibration.yaml}}
rig: {{stage: {{kind: mark10, port: {wires}/stand}}, gauge: {{kind: gcl2, port: {wires}/gauge}}}}
folders: {{out: out}}
parameters:
  emulated_cell: {{spool_directions: [1, -1, 1]}}
"""
EMULATED = ("hardware:=emulated", "speed:=max", "gripper:=false", "record:=false")


def commands(document: str) -> list[list[str]]:
    """Return the command lines of a document, as words."""
    lines = (DOCUMENTS / document).read_text().splitlines()
    return [shlex.split(line, comments=True) for line in lines if line.startswith("    ros2 ")]


@pytest.mark.long
@pytest.mark.timeout(400)
def test_from_the_boxes_to_the_first_grasp(launch: Launch, tmp_path: Path) -> None:
    wires = tmp_path / "wires"
    parameters = ("wire_dir:=" + str(wires), "factory_fresh:=true", "spool_directions:=[1, -1, 1]", "speed:=0.0")
    words = [word for one in parameters for word in ("-p", one)]
    cell = launch("ros2", "run", "softgrip_emulator", "emulated_cell", "--ros-args", *words)
    cell.wait_for("wires in", 30.0)

    (wizard,) = [words for words in commands("servos.md") if "wizard" in words]
    wizard[wizard.index("--port") + 1] = f"{wires}/servos"
    terminal = Terminal([*wizard, "--lockstep", f"{wires}/time"], cell.environment, tmp_path)
    while terminal.read_until(("then press Enter", "start: ros2 launch"), 120.0) == "then press Enter":
        asked = terminal.text.rpartition("? ")[2]
        if "put the servo of" in asked:
            request = f"{{fault: clear, target: 'servo_unplugged@{asked.split(chr(39))[1]}'}}"
            answer = cell.ask(
                "service", "call", "emulator/inject_fault", "softgrip_interfaces/srv/InjectFault", request
            )
            assert "success=True" in answer, answer
        terminal.press_enter()
    assert terminal.process.wait(20.0) == 0, terminal.text
    file = tmp_path / "cell.yaml"
    chain = load_cell(file).servos
    assert chain is not None
    assert [(one.tendon, one.servo_id, one.direction) for one in chain.chain] == [
        ("index", 1, 1), ("middle", 2, -1), ("thumb", 3, 1),
    ]  # fmt: skip

    environment = cell.environment | {"ROS_DOMAIN_ID": str(cell.domain + 1)}
    file.write_text(file.read_text() + SECTIONS.format(wires=wires))
    for words in commands("first_grasp.md"):
        options = ("--hands", "emulator", "--yes", "--lockstep", f"{wires}/time") if "first_run" in words else ()
        options += ("--launch-argument", *EMULATED, f"wire_dir:={tmp_path}/wires-2") if options else ()
        done = subprocess.run(
            [*words, *options], env=environment, cwd=tmp_path, capture_output=True, text=True, check=False
        )
        log = tmp_path / "first_run" / "cell.log"
        assert done.returncode == 0, (
            f"{words}:\n{done.stdout}{done.stderr}\n{log.read_text()[-3000:] if log.exists() else ''}"
        )
    record = json.loads((tmp_path / "first_run" / "first_run.json").read_text())
    figures = {figure["name"]: figure["found"] for report in record["reports"] for figure in report["figures"]}
    assert (figures["points accepted"], figures["outcome"]) == ("9", "GRIPPED")
    assert {report["status"] for report in record["reports"]} == {"good"}
    page = (tmp_path / "first_run" / "first_run.html").read_text()
    assert record["digest"] in page
