# SPDX-License-Identifier: Apache-2.0
"""What is given to a launch file arrives where it is meant for."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
LAUNCH = ROOT / "ros2_ws/src/softgrip_bringup/launch"


#: Launch files of a cell that can be secure: all but that of programs of others which have no keys of their own.
SECURE = [path.name for path in sorted(LAUNCH.glob("*.launch.yaml")) if path.name != "ros2_control.launch.yaml"]


def entities(name: str, kind: str) -> list[dict[str, Any]]:
    """All entities of a kind of a launch file."""
    return [entity[kind] for entity in yaml.safe_load((LAUNCH / name).read_text())["launch"] if kind in entity]


def parameters(executable: str) -> dict[str, str]:
    """Named parameters that the cell's launch file gives to a node, or hands on."""
    node = next(node for node in entities("cell.launch.yaml", "node") if node["exec"] == executable)
    return {row["name"].rpartition(")")[2]: row["value"] for row in node["param"] if "name" in row}


@pytest.mark.parametrize("name", [path.name for path in sorted(LAUNCH.glob("*.launch.yaml"))])
def test_every_argument_is_used(name: str) -> None:
    # the parameter files beside it are filled in with its arguments
    text = "".join(path.read_text() for path in (LAUNCH / name, *(LAUNCH.parent / "settings").glob("*.yaml")))
    for argument in entities(name, "arg"):
        assert re.search(rf"\$\(var {argument['name']}\)", text), argument["name"]


def test_the_demo_hands_on_what_the_cell_takes_with_the_cells_default() -> None:
    of_cell = {argument["name"]: argument["default"] for argument in entities("cell.launch.yaml", "arg")}
    include = entities("demo.launch.yaml", "include")[0]
    handed_on = {argument["name"]: argument["value"] for argument in include["arg"]}
    assert handed_on.keys() <= of_cell.keys()
    for argument in entities("demo.launch.yaml", "arg"):
        name = argument["name"]
        if name in of_cell:
            assert handed_on[name] == f"$(var {name})"
        if argument["description"] == "as in cell.launch.yaml":
            assert argument["default"] == of_cell[name]


@pytest.mark.parametrize(
    ("executable", "parameter"),
    [
        ("emulated_cell", "camera_realtime_priority"),
        ("camera", "realtime_priority"),
        ("marker_tracker", "realtime_priority"),
    ],
)
def test_frames_priority_reaches_all_that_a_frame_passes(executable: str, parameter: str) -> None:
    assert parameters(executable)[parameter] == "$(var frames_priority)"


def test_every_node_that_names_frames_gets_the_cells_prefix() -> None:
    config = (yaml.safe_load(path.read_text()) for path in (LAUNCH.parent / "config").glob("*.yaml"))
    takes = {
        key.removeprefix("/**/")
        for file in config
        for key, values in file.items()
        if "frame_prefix" in values["ros__parameters"]
    }
    assert takes == {"hand_description", "kinematics_predictor", "gdfe_simulator", "camera"}
    for node in takes:
        assert parameters(node)["frame_prefix"] == "'$(var frame_prefix)'"


@pytest.mark.parametrize("name", ["servo_port", "stage_port", "gauge_port", "camera_source", "calibration"])
def test_real_hardware_takes_nothing_from_the_folder_of_the_emulated_one(name: str) -> None:
    (argument,) = [one for one in entities("cell.launch.yaml", "arg") if one["name"] == name]
    found = re.fullmatch(r"\$\(if \$\(var is_emulated\) (?P<emulated>\S+ \S+) (?P<real>\S+)\)", argument["default"])
    assert found is not None, argument["default"]
    assert "$(var wire_dir)" in found["emulated"]
    assert "$" not in found["real"]


@pytest.mark.parametrize("name", SECURE)
def test_every_node_of_a_secure_launch_has_the_keys_of_its_own_name(name: str) -> None:
    for node in entities(name, "node"):
        environment = {row["name"]: row["value"] for row in node["env"]}
        own = node["name"]
        assert environment["ZENOH_SESSION_CONFIG_URI"] == (
            f"$(if $(var secure) $(var keys)/zenoh/{own}.json5 $(var own_session))"
        )
        assert environment["ROS_SECURITY_ENCLAVE_OVERRIDE"] == f"$(if $(var secure) /softgrip/{own} $(var own_enclave))"


@pytest.mark.parametrize("name", SECURE)
def test_a_launch_is_either_secure_on_every_middleware_or_on_this_machine_alone(name: str) -> None:
    made = {row["name"]: row for row in entities(name, "set_env")}
    for variable in (
        "ZENOH_ROUTER_CONFIG_URI",
        "ROS_SECURITY_KEYSTORE",
        "ROS_SECURITY_ENABLE",
        "ROS_SECURITY_STRATEGY",
    ):
        assert made[variable]["if"] == "$(var secure)"
    assert made["ROS_SECURITY_STRATEGY"]["value"] == "Enforce"
    assert made["ROS_AUTOMATIC_DISCOVERY_RANGE"]["value"] == "LOCALHOST"
    assert made["ROS_AUTOMATIC_DISCOVERY_RANGE"]["unless"] == "$(var secure)"
    (secure,) = [one for one in entities(name, "arg") if one["name"] == "secure"]
    assert secure["default"] == "false"


def test_a_launch_that_can_not_be_secure_stays_on_this_machine() -> None:
    (made,) = entities("ros2_control.launch.yaml", "set_env")
    assert made == {"name": "ROS_AUTOMATIC_DISCOVERY_RANGE", "value": "LOCALHOST"}


def test_only_nodes_that_hold_hardware_end_the_cell_when_they_are_gone() -> None:
    nodes = entities("cell.launch.yaml", "node")
    ends = {node["exec"] for node in nodes if node.get("on_exit") == "shutdown"}
    assert ends == {"emulated_cell", "tendon_driver", "friction_rig"}
    # without its page a cell works all the same
    never = {"panel"}
    for node in nodes:
        # the others end it only where they refuse to start
        is_other = node["exec"] not in ends | never
        assert node["launch-prefix"].endswith(" --end-launch-on-refusal") == is_other


def test_the_container_of_a_bench_gives_the_launch_what_it_takes_and_the_devices_that_it_passes_on() -> None:
    service = yaml.safe_load((ROOT / "docker/compose.yaml").read_text())["services"]["bench"]
    words = [word.partition(":=") for word in service["entrypoint"] if ":=" in word]
    taken = {argument["name"] for argument in entities("cell.launch.yaml", "arg")}
    assert {name for name, _, _ in words} <= taken
    inside = {device.rpartition(":")[2] for device in service["devices"]}
    assert {value for _, _, value in words if value.startswith("/dev/")} == inside
    (cell_file,) = (Path(value) for name, _, value in words if name == "cell_file")
    # the whole folder: a cell file names its calibrations beside itself
    assert str(cell_file.parent) in {mount.split(":")[-2] for mount in service["volumes"] if mount.endswith(":ro")}


def test_the_stop_of_a_bench_outlives_its_container() -> None:
    """In the container's own home, which is memory, a stop would be forgotten with it."""
    service = yaml.safe_load((ROOT / "docker/compose.yaml").read_text())["services"]["bench"]
    kept = service["environment"]["ROS_HOME"]
    (mount,) = (mount for mount in service["volumes"] if mount.endswith(f":{kept}"))
    assert mount.startswith("${ROS_HOME:-${HOME}/.ros}:")
    real = yaml.safe_load((ROOT / "ros2_ws/src/softgrip_bringup/settings/real.yaml").read_text())
    for node in ("tendon_driver", "friction_rig"):
        assert real[f"/**/{node}"]["ros__parameters"]["safety_file"] == ""  # that is, in ROS_HOME
