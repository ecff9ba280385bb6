# SPDX-License-Identifier: Apache-2.0
"""What a cell file means to the nodes: their parameters, and the arguments of the launch."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import yaml

from softgrip_description.cell_file.cell import CellCamera, CellFile, CellRig, ChainServo, ServoChain
from softgrip_description.errors import CellFileError
from softgrip_description.json_schema import guess

Values = dict[str, Any]

#: compiled where it can be: some hundred lines for each node are read at every launch
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

#: parameter of tendon_driver -> what a servo of the chain says; a list that no servo fills is left to the driver
_BY_SERVO: Mapping[str, Callable[[ChainServo], Any]] = {
    "directions": lambda servo: servo.direction,
    "spool_radii_m": lambda servo: servo.spool_radius_m,
    "torque_per_ampere_nm_a": lambda servo: servo.torque.torque_per_ampere_nm_a,
    "friction_currents_a": lambda servo: servo.torque.friction_current_a,
    "friction_slopes_a_s_m": lambda servo: servo.torque.friction_slope_a_s_m,
    "gear_load_shares": lambda servo: servo.torque.gear_load_share,
    "quick_stddevs_n_s2_m2": lambda servo: servo.torque.quick_stddev_n_s2_m2,
    "tension_stddev_share": lambda servo: servo.torque.tension_stddev_share,
    "winding_resistances_ohm": lambda servo: servo.torque.winding_resistance_ohm,
    "back_emfs_v_s": lambda servo: servo.torque.back_emf_v_s,
    "winding_stddev_share": lambda servo: servo.torque.winding_stddev_share,
    "limited_currents": lambda servo: servo.torque.limited_current,
}


def node_parameters(cell: CellFile, shipped: Mapping[str, Values]) -> dict[str, Values]:
    """Return the parameters of each node that the cell file speaks of.

    Args:
        cell: the cell.
        shipped: node -> parameter -> default; a list for all tendons is filled up with its default.

    Raises:
        CellFileError: a servo without direction, or a parameter that no node has.
    """
    nodes: dict[str, Values] = {}
    if cell.servos is not None:
        nodes["tendon_driver"] = _driver(cell.servos, shipped["tendon_driver"])
    if cell.rig is not None:
        nodes["friction_rig"] = _rig(cell.rig)
    if cell.camera is not None:
        nodes["camera"] = _camera(cell.camera)
    if cell.hand is not None:
        nodes |= {name: {"hand_file": str(cell.hand)} for name in ("hand_description", "gripper_command")}
    for node, values in cell.parameters.items():
        nodes[node] = nodes.get(node, {}) | dict(values)
    return _checked(nodes, shipped)


def launch_arguments(cell: CellFile) -> dict[str, str]:
    """Return the arguments of cell.launch.yaml that the cell file speaks of, whatever the hardware is.

    Raises:
        CellFileError: a text that the launch would carry out.
    """
    folders = cell.folders
    given = {"cell": cell.name, "out": folders.out, "bags": folders.bags, "profiles": folders.profiles}
    return _texts(({"hardware": "real"} if cell.hardware == "real" else {}) | given)


def device_arguments(cell: CellFile) -> dict[str, str]:
    """Return those that hold with real hardware only; raises CellFileError as `launch_arguments` does."""
    present = {"servos": cell.servos, "rig": cell.rig, "camera": cell.camera}
    given: Values = {name: str(section is not None).lower() for name, section in present.items()}
    return _texts(given | {"calibration": cell.camera.calibration if cell.camera else None})


def _texts(given: Values) -> dict[str, str]:
    texts = {name: str(value) for name, value in given.items() if value not in {None, ""}}
    for name, text in texts.items():
        if "$(" in text:
            raise CellFileError(f"{name}: expected a plain path, found {text}; leave $(...) out")
    return texts


def read_shipped(folder: Path) -> dict[str, Values]:
    """Return node -> parameter -> default of a folder of parameter files (softgrip_bringup/config).

    Raises:
        CellFileError: none there.
    """
    found: dict[str, Values] = {}
    for path in sorted(folder.glob("*.yaml")):
        for section, body in yaml.load(path.read_text(encoding="utf-8"), _LOADER).items():  # noqa: S506  a safe one
            found[section.removeprefix("/**/")] = body["ros__parameters"]
    if not found:
        raise CellFileError(
            f"{folder}: expected the parameter files of the nodes, found none; install softgrip_bringup"
        )
    return found


def _driver(servos: ServoChain, shipped: Values) -> Values:
    if not servos.chain:
        raise CellFileError("servos.chain: expected a servo for each tendon, found none; run the wizard")
    values: Values = {
        "port": servos.port,
        "tendons": [servo.tendon for servo in servos.chain],
        "servo_ids": [servo.servo_id for servo in servos.chain],
        "servo_models": [servo.model for servo in servos.chain],
    }
    if servos.baud is not None:
        values["baud"] = servos.baud
    if servos.drive is not None:
        values["backend"] = servos.drive
    for servo in servos.chain:
        if servo.direction is None:
            raise CellFileError(
                f"servos.chain, tendon {servo.tendon}: expected a direction of 1 or -1, found none; the wizard finds it"
            )
    for name, value_of in _BY_SERVO.items():
        found = [value_of(servo) for servo in servos.chain]
        if any(value is not None for value in found):
            values[name] = [shipped[name][0] if value is None else value for value in found]
    return values


def _rig(rig: CellRig) -> Values:
    gauge = rig.gauge
    values = {
        "stage": rig.stage.kind, "stage_port": rig.stage.port, "stage_start": rig.stage.start,
        "gauge": gauge.kind, "gauge_port": gauge.port, "stream_line": gauge.line, "stream_baud": gauge.baud,
        "stream_request": gauge.request, "counts_per_newton": gauge.counts_per_newton,
        "gauge_calibration": gauge.calibration,
    }  # fmt: skip
    return _given(values)


def _camera(camera: CellCamera) -> Values:
    return _given({one.name: getattr(camera, one.name) for one in fields(camera) if one.name != "calibration"})


def _given(values: Values) -> Values:
    return {
        name: str(value) if isinstance(value, Path) else value for name, value in values.items() if value is not None
    }


def _checked(nodes: Mapping[str, Values], shipped: Mapping[str, Values]) -> dict[str, Values]:
    """Return the values in the types that the nodes declare: 2 is no number with a fraction to ROS.

    Raises:
        CellFileError: a node, a parameter or a type that is not there.
    """
    problems = []
    checked: dict[str, Values] = {}
    for node, values in nodes.items():
        if node not in shipped:
            problems.append(f"parameters.{node}: expected a node of {', '.join(shipped)}{guess(node, {*shipped})}")
            continue
        checked[node] = {}
        for name, value in values.items():
            if name not in shipped[node]:
                close = guess(name, {*shipped[node]})
                problems.append(
                    f"parameters.{node}.{name}: expected a parameter of {node}, found none of this name{close}"
                )
                continue
            default = shipped[node][name]
            checked[node][name] = _converted(value, default)
            if not _is_like(checked[node][name], default):
                problems.append(f"parameters.{node}.{name}: expected a value like {default!r}, found {value!r}")
    if problems:
        raise CellFileError("\n".join(problems))
    return checked


def _converted(value: Any, default: Any) -> Any:
    if isinstance(value, list) and isinstance(default, list) and default:
        return [_converted(one, default[0]) for one in value]
    is_whole = isinstance(value, int) and not isinstance(value, bool)
    return float(value) if isinstance(default, float) and is_whole else value


def _is_like(value: Any, default: Any) -> bool:
    if isinstance(default, list) and isinstance(value, list):
        return not default or all(_is_like(one, default[0]) for one in value)
    return type(value) is type(default)
