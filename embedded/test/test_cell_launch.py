# SPDX-License-Identifier: Apache-2.0
"""What the cell's launch file comes to on real hardware: which nodes, and whose word each of their parameters has."""

from __future__ import annotations

import contextlib
import io
import itertools
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import pytest

from embedded_ros import substitutions, workspace
from embedded_ros.arguments import parse
from embedded_ros.errors import LaunchError
from embedded_ros.launch_description import Description
from embedded_ros.launch_file import LaunchReader
from softgrip_description.cell_file import load_cell, node_parameters, read_shipped
from softgrip_description.commands import cell_file

BRINGUP = workspace.package("softgrip_bringup").folder
LAUNCH = Path(BRINGUP) / "launch" / "cell.launch.yaml"
#: a cell that differs in everything
BENCH = """
schema: 1
hardware: real
servos:
  port: /dev/ttyACM7
  chain:
    - {tendon: index, model: XL330-M288, id: 11, direction: 1}
    - {tendon: middle, model: XL330-M288, id: 12, direction: -1, spool_radius_m: 0.012, slack_m: 0.004}
    - {tendon: thumb, model: XC330-M288, id: 13, direction: 1, torque: {friction_current_a: 0.03}}
rig:
  stage: {kind: grbl, port: /dev/grbl}
  gauge: {kind: stream, port: /dev/gauge, line: raw}
camera: {source: /dev/video4, calibration: lens/camera.yaml, exposure_s: 0.01}
folders: {out: made, profiles: /srv/profiles}
parameters:
  tendon_driver: {homing_speed_m_s: 0.003, no_reply_s: 0.07, loop_rate: 50, zero_file: /var/lib/softgrip/zero.yaml}
  friction_rig: {time_scale: 60.0}
  grasp_mix_manager: {lift_window_s: 2.0, database_url: "sqlite:////srv/cell.db"}
  recorder: {root: /srv/bags, record_on_start: false}
"""
#: what it comes to
EXPECTED: dict[str, dict[str, Any]] = {
    "tendon_driver": {
        "port": "/dev/ttyACM7", "tendons": ["index", "middle", "thumb"], "servo_ids": [11, 12, 13],
        "servo_models": ["XL330-M288", "XL330-M288", "XC330-M288"], "directions": [1, -1, 1],
        "spool_radii_m": [0.010, 0.012, 0.010], "friction_currents_a": [0.0, 0.0, 0.03], "homing_speed_m_s": 0.003,
        "no_reply_s": 0.07, "loop_rate": 50.0, "zero_file": "/var/lib/softgrip/zero.yaml",
    },
    "friction_rig": {
        "stage": "grbl", "stage_port": "/dev/grbl", "gauge": "stream", "gauge_port": "/dev/gauge", "stream_line": "raw",
    },
    "camera": {"source": "/dev/video4", "exposure_s": 0.01},
    "kinematics_predictor": {"profiles_directory": "/srv/profiles"},
    "grasp_mix_manager": {"lift_window_s": 2.0, "database_url": "sqlite:////srv/cell.db"},
    "recorder": {"root": "/srv/bags", "record_on_start": False},
}  # fmt: skip
#: nodes that a bench has without any device
ALWAYS = {"recorder", "friction_rig", "kinematics_predictor", "hand_description", "gdfe_simulator", "camera", "panel"}


def described(**arguments: str) -> Description:
    """Read the launch file with arguments."""
    return LaunchReader({"hardware": "real", "out": "/tmp/out", **arguments}).read(LAUNCH)


def values_of(node: str, **arguments: str) -> dict[str, Any]:
    """Return the parameters that a node is started with: all layers, the strongest last."""
    (process,) = [one for one in described(**arguments).processes if one.label.rpartition("-")[0] == node]
    given = parse(process.command).parameters_of(f"/{node}")
    return {name: value for name, (value, _) in given.items() if not name.startswith("not_given_")}


def nodes(**arguments: str) -> set[str]:
    """Return the names of the nodes that are started."""
    return {one.label.rpartition("-")[0] for one in described(**arguments).processes}


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Run the command of the launch in this process: a process for each of these tests would take half a minute."""

    def run(words: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = cell_file.main(words[words.index("cell_file") + 2 :])
        return subprocess.CompletedProcess(words, code, out.getvalue(), err.getvalue())

    monkeypatch.setattr(substitutions.subprocess, "run", run)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))


@pytest.fixture
def bench(tmp_path: Path) -> str:
    """A cell that differs in everything."""
    path = tmp_path / "bench.yaml"
    path.write_text(BENCH)
    return str(path)


@pytest.mark.parametrize(("servos", "rig", "camera"), list(itertools.product(("true", "false"), repeat=3)))
def test_each_device_may_be_absent_and_the_nodes_that_remain_know_it(servos: str, rig: str, camera: str) -> None:
    devices = {"servos": servos, "rig": rig, "camera": camera}
    of_servos = {"tendon_driver", "grasp_mix_manager", "gripper_command"}
    expected = ALWAYS | (of_servos if servos == "true" else set()) | ({"marker_tracker"} if camera == "true" else set())
    assert nodes(**devices) == expected
    measured = values_of("friction_rig", **devices)
    assert measured["stage"] == ("mark10" if rig == "true" else "none")
    assert measured.get("safety_source", "topic") == ("topic" if servos == "true" else "none")
    assert values_of("camera", **devices)["source"] == ("0" if camera == "true" else "none")


def test_no_argument_is_handed_on_that_was_not_given() -> None:
    driver = values_of("tendon_driver")
    assert (driver["port"], driver["servo_ids"], driver["directions"]) == ("/dev/ttyUSB0", [1, 2, 3], [1])
    assert values_of("friction_rig")["stage_port"] == "/dev/softgrip/stand"
    assert values_of("grasp_mix_manager")["database_url"] == "sqlite:////tmp/out/cell.db"
    assert values_of("recorder")["root"] == "/tmp/out/bags"


@pytest.mark.parametrize("node", EXPECTED)
def test_the_cell_file_wins_over_everything_that_is_shipped(bench: str, node: str) -> None:
    found = values_of(node, cell_file=bench)
    assert {name: found[name] for name in EXPECTED[node]} == EXPECTED[node]


def test_paths_of_a_cell_file_are_relative_to_it(bench: str, tmp_path: Path) -> None:
    calibration = str(tmp_path / "lens/camera.yaml")
    assert values_of("camera", cell_file=bench)["calibration_file"] == calibration
    assert values_of("marker_tracker", cell_file=bench)["calibration_file"] == calibration
    found = values_of("recorder", cell_file=bench)["attachment_roots"]
    assert found == f"/srv/profiles:{calibration}"
    (process,) = [
        one for one in LaunchReader({"cell_file": bench}).read(LAUNCH).processes if one.label.startswith("friction_rig")
    ]
    given = parse(process.command).parameters_of("/friction_rig")
    assert given["model_dir"][0] == str(tmp_path / "made/friction")


def test_a_device_that_the_cell_file_leaves_out_is_absent(tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text("schema: 1\nhardware: real\ncamera: {source: '0'}\n")
    assert nodes(cell_file=str(path)) == ALWAYS | {"marker_tracker"}
    assert values_of("friction_rig", cell_file=str(path))["stage"] == "none"


def test_a_cell_file_of_a_bench_lacks_nothing_when_it_is_emulated(tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text("schema: 1\nhardware: real\n")
    found = nodes(cell_file=str(path), hardware="emulated")
    assert {"emulated_cell", "tendon_driver", "marker_tracker"} <= found


def test_a_wrong_cell_file_ends_the_launch_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text("schema: 1\nhardware: reel\n")
    with pytest.raises(LaunchError, match=r'cell.yaml:2: hardware: expected one of "real", "emulated", found "reel"'):
        nodes(cell_file=str(path))


@pytest.mark.parametrize(
    ("node", "argument", "given", "parameter", "value"),
    [
        ("tendon_driver", "servo_port", "/dev/ttyUSB3", "port", "/dev/ttyUSB3"),
        ("tendon_driver", "servo_ids", "[4, 5, 6]", "servo_ids", [4, 5, 6]),
        ("tendon_driver", "servo_models", "[XM430-W350]", "servo_models", ["XM430-W350"]),
        ("tendon_driver", "directions", "[-1]", "directions", [-1]),
        ("tendon_driver", "spool_radii", "[0.012]", "spool_radii_m", [0.012]),
        ("friction_rig", "stage", "mark10", "stage", "mark10"),
        ("friction_rig", "stage_port", "/dev/ttyUSB1", "stage_port", "/dev/ttyUSB1"),
        ("friction_rig", "gauge", "gcl2", "gauge", "gcl2"),
        ("friction_rig", "gauge_port", "/dev/ttyUSB2", "gauge_port", "/dev/ttyUSB2"),
        ("friction_rig", "stream_baud", "9600", "stream_baud", 9600),
        ("friction_rig", "stream_line", r"F=(?P<value>-?\d+)", "stream_line", r"F=(?P<value>-?\d+)"),
        ("friction_rig", "counts_per_newton", "-2280.0", "counts_per_newton", -2280.0),
        ("friction_rig", "gauge_calibration", "/etc/cell.yaml", "gauge_calibration", "/etc/cell.yaml"),
        ("camera", "camera_source", "2", "source", "2"),
        ("camera", "calibration", "/etc/c.yaml", "calibration_file", "/etc/c.yaml"),
        ("marker_tracker", "calibration", "/etc/c.yaml", "calibration_file", "/etc/c.yaml"),
        ("marker_tracker", "frames_priority", "10", "realtime_priority", 10),
        ("grasp_mix_manager", "lift_window_s", "1.5", "lift_window_s", 1.5),
        ("grasp_mix_manager", "database", "/x/cell.db", "database_url", "sqlite:////x/cell.db"),
        ("recorder", "bags", "/x/bags", "root", "/x/bags"),
        ("recorder", "record", "true", "record_on_start", True),
    ],
)
def test_an_argument_wins_over_the_cell_file(
    bench: str, node: str, argument: str, given: str, parameter: str, value: Any
) -> None:
    assert values_of(node, cell_file=bench, **{argument: given})[parameter] == value


def test_real_hardware_lives_in_real_time_whatever_anybody_says(bench: str) -> None:
    assert values_of("friction_rig")["time_scale"] == 1.0
    assert values_of("friction_rig", cell_file=bench, rig_time_scale="60.0")["time_scale"] == 1.0
    assert values_of("friction_rig", hardware="emulated", rig_time_scale="20.0")["time_scale"] == 20.0


NODES = (*sorted(ALWAYS), "tendon_driver", "grasp_mix_manager", "gripper_command", "marker_tracker")


@pytest.mark.parametrize("node", NODES)
def test_all_nodes_live_in_the_emulated_cells_time_and_in_the_computers_with_real_hardware(node: str) -> None:
    emulated = values_of(node, hardware="emulated", wire_dir="/run/wires")
    assert emulated["use_sim_time"] is True
    waited_for = node not in {"gdfe_simulator", "hand_description", "camera", "panel"}
    assert emulated.get("lockstep", "") == ("/run/wires/time" if waited_for else "")
    real = values_of(node)
    assert (real["use_sim_time"], real.get("lockstep", "")) == (False, "")


def test_no_time_limit_of_the_drives_or_of_the_manager_is_another_one_on_emulated_hardware() -> None:
    for node in ("tendon_driver", "grasp_mix_manager", "friction_rig"):
        real, emulated = values_of(node), values_of(node, hardware="emulated")
        differing = {name for name in real.keys() & emulated.keys() if real[name] != emulated[name]}
        wires = {"port", "stage_port", "gauge_port", "time_scale"}
        # simulated time needs no priority; a real stop is the port's, not the folder's
        assert differing <= {"use_sim_time", "lockstep", "realtime_priority", "safety_file"} | wires
        assert "use_sim_time" in differing


@pytest.mark.parametrize(("speed", "value"), [("1.0", 1.0), ("max", 0.0), ("0.5", 0.5)])
def test_the_speed_of_the_cells_time_is_that_of_the_launch(speed: str, value: float) -> None:
    found = values_of("emulated_cell", hardware="emulated", speed=speed)
    assert found["speed"] == value
    assert not found.get("use_sim_time", False)
    assert set(found["expected"]) <= set(NODES)


def test_the_emulated_cell_never_touches_the_devices_of_the_cell_file(bench: str) -> None:
    emulated = {"hardware": "emulated", "cell_file": bench, "wire_dir": "/run/wires"}
    assert values_of("tendon_driver", **emulated)["port"] == "/run/wires/servos"
    assert values_of("friction_rig", **emulated)["stage_port"] == "/run/wires/stand"
    assert values_of("friction_rig", **emulated)["gauge_port"] == "/run/wires/gauge"
    assert values_of("camera", **emulated)["source"] == "@/run/wires/camera.url"


def test_the_cell_file_to_copy_says_what_holds_without_it() -> None:
    cell = load_cell(BRINGUP / "settings" / "bench_cell.yaml")
    shipped = read_shipped(BRINGUP / "config")
    found = node_parameters(cell, shipped)
    assert found["tendon_driver"].pop("port").startswith("/dev/serial/by-id/")
    for node, values in found.items():
        for name, value in values.items():
            default = shipped[node][name]
            one_for_all = isinstance(default, list) and len(default) == 1
            assert value == (default * 3 if one_for_all else default), name


@pytest.mark.parametrize("document", ["README.md", "docs/bench.md"])
def test_the_launch_lines_of_the_documents_are_read(document: str) -> None:
    lines = [line.split("#")[0].split() for line in (BRINGUP.parents[2] / document).read_text().splitlines()]
    launches = [words[4:] for words in lines if words[:4] == ["ros2", "launch", "softgrip_bringup", "cell.launch.yaml"]]
    assert launches
    for words in launches:
        given = dict(word.split(":=", 1) for word in words if not word.endswith("..."))
        given.pop("cell_file", None)  # the reader's own
        assert LaunchReader(given).read(LAUNCH).processes
