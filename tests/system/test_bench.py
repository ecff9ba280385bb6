# SPDX-License-Identifier: Apache-2.0
"""The launch for a bench (`hardware:=real`), over pseudo-terminals: an emulated cell's wires stand in for the devices'.

Which nodes start with which devices, and whose configuration wins, is in embedded/test/test_cell_launch.py.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("rosbags")
from rosbags.highlevel import AnyReader

from softgrip_driver.autogroup import has_autogroups

#: Emulated servos answer later than real ones and, on a busy machine, live more slowly: this bench's own file says so.
CELL_FILE = """
schema: 1
hardware: real
parameters:
  tendon_driver:
    {reply_margin_s: 0.1, no_reply_s: 5.0, bus_watchdog_s: 0.0, homing_timeout_s: 60.0, loop_rate: 50.0}
"""

SETTINGS = Path(__file__).parents[2] / "ros2_ws/src/softgrip_bringup/settings"
TENDONS = ("index", "middle", "thumb")

pytestmark = [pytest.mark.ros, pytest.mark.slow]
Launch = Callable[..., Any]


@pytest.fixture
def wires(launch: Launch, tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    """A folder with the ports of an emulated cell that lives in a domain of its own; its servos' model may be given."""
    folder, model = tmp_path / "wires", getattr(request, "param", "xl330_m288")
    arguments = ("-p", f"wire_dir:={folder}", "-p", "camera_fps:=5.0", "-p", f"servo_model:={model}")
    launch("ros2", "run", "softgrip_emulator", "emulated_cell", "--ros-args", *arguments).wait_for("wires in", 30.0)
    return folder


def start(launch: Launch, tmp_path: Path, cell_file: str) -> Any:
    """Start the launch for a bench."""
    (tmp_path / "cell.yaml").write_text(cell_file)
    given = (f"cell_file:={tmp_path}/cell.yaml", f"out:={tmp_path}/out", "gripper:=false")
    return launch("ros2", "launch", "softgrip_bringup", "cell.launch.yaml", *given)


def diagnosed(folder: Path) -> dict[str, tuple[int, str]]:
    """Return the last status of every component that a bag holds: level and message."""
    (bag,) = (folder / "bags").iterdir()
    found = {}
    with AnyReader([bag]) as reader:
        (connection,) = [one for one in reader.connections if one.topic == "/diagnostics"]
        for _, _, data in reader.messages([connection]):
            for status in reader.deserialize(data, connection.msgtype).status:
                found[status.name] = (int(status.level), status.message)
    return found


def end(cell: Any, out: Path, *required: str) -> None:
    """End it once its bag has some seconds of everybody's diagnostics, the required components' too."""
    for name in required:
        cell.ask_until(
            ("topic", "echo", "--once", "--filter", f"any(s.name == {name!r} for s in m.status)", "/diagnostics"), name
        )
    deadline = time.monotonic() + 60.0
    while not list((out / "bags").glob("*")):
        assert time.monotonic() < deadline, f"expected a bag, found none:\n{cell.output[-4000:]}"
        time.sleep(0.2)
    time.sleep(5.0)
    cell.interrupt()
    cell.wait_for_end(30.0)
    assert cell.survivors() == []


CHAIN = "".join(f"{{tendon: {name}, model: XL330-M288, id: {i}, direction: 1}}, " for i, name in enumerate(TENDONS, 1))
#: a section of the cell file for each device; WIRES is the folder of its ports
SECTIONS = {
    "servos": f"servos: {{port: WIRES/servos, chain: [{CHAIN}]}}\n",
    "rig": "rig: {stage: {kind: mark10, port: WIRES/stand}, gauge: {kind: gcl2, port: WIRES/gauge}}\n",
    "camera": 'camera: {source: "@WIRES/camera.url", calibration: WIRES/camera_calibration.yaml}\n',
}
#: what shows that a device works: a question, and what its answer holds
QUESTIONS = {
    "servos": (("service", "call", "tendon/home", "std_srvs/srv/Trigger"), "success=True"),
    "rig": (("topic", "echo", "--once", "load_cell/wrench"), "force"),
    "camera": (("topic", "echo", "--once", "camera/camera_info"), "width: 640"),
}
EVERY = [
    pytest.param(
        chosen,
        id=" and ".join(chosen) or "nothing",
        marks=[] if chosen in {(), ("servos",), (*SECTIONS,)} else [pytest.mark.long],
    )
    for count in range(4)
    for chosen in itertools.combinations(SECTIONS, count)
]


@pytest.mark.timeout(240)
@pytest.mark.parametrize("devices", EVERY)
def test_a_bench_with_any_of_its_devices_uses_them_and_says_what_it_lacks(
    launch: Launch, tmp_path: Path, wires: Path, devices: tuple[str, ...]
) -> None:
    sections = "".join(SECTIONS[name].replace("WIRES", str(wires)) for name in devices)
    cell = start(launch, tmp_path, CELL_FILE + sections)
    for name in devices:
        cell.ask_until(*QUESTIONS[name])
    capture = "camera: frames" if "camera" in devices else "camera: capture"
    end(cell, tmp_path / "out", "friction_rig: rig", capture)
    assert ("kernel.sched_autogroup_enabled=0" in cell.output) == ("servos" in devices and has_autogroups())
    found = diagnosed(tmp_path / "out")
    started = {name.partition(":")[0] for name in found}
    assert started.isdisjoint({"tendon_driver", "grasp_mix_manager"}) == ("servos" not in devices)
    assert ("marker_tracker" in started) == ("camera" in devices)
    level, text = found["friction_rig: rig"]
    assert (level, "no rig" in text) == (0, "rig" not in devices)
    if "rig" in devices:
        assert text == "connected"
        _, safety = found.get("friction_rig: safety", (0, ""))
        assert ("no tendon_driver here" in safety) == ("servos" not in devices)
    level, text = found[capture]
    assert (level, ("of the calibrated size" if "camera" in devices else "no camera") in text) == (0, True)


#: of `CELL_FILE`; the limits that other drives can keep are those of the shipped settings
PATIENT = {"reply_margin_s": 0.1, "no_reply_s": 5.0, "bus_watchdog_s": 0.0, "homing_timeout_s": 60.0}
OTHER_DRIVES = [
    pytest.param("sts3215", "feetech", id="feetech"),
    pytest.param("dm_j4310_2ec", "damiao", id="damiao", marks=pytest.mark.long),
]


@pytest.mark.timeout(240)
@pytest.mark.parametrize(("wires", "drive"), OTHER_DRIVES, indirect=["wires"])
def test_a_bench_with_servos_of_another_maker_homes(launch: Launch, tmp_path: Path, wires: Path, drive: str) -> None:
    shipped = yaml.safe_load((SETTINGS / f"drives_{drive}.yaml").read_text())["/**/tendon_driver"]["ros__parameters"]
    (model,) = shipped.pop("servo_models")
    assert shipped.pop("backend") == drive
    chain = [{"tendon": name, "model": model, "id": i, "direction": 1} for i, name in enumerate(TENDONS, 1)]
    servos = {"port": str(wires / "servos"), "drive": drive, "chain": chain}
    parameters = {"tendon_driver": shipped | PATIENT}
    mine = {"schema": 1, "hardware": "real", "servos": servos, "parameters": parameters}
    cell = start(launch, tmp_path, yaml.safe_dump(mine))
    cell.ask_until(*QUESTIONS["servos"])
    end(cell, tmp_path / "out")
    driver = {
        name: level for name, (level, _) in diagnosed(tmp_path / "out").items() if name.startswith("tendon_driver")
    }
    assert driver
    assert not any(driver.values())
