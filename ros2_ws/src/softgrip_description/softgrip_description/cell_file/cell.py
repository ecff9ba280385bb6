# SPDX-License-Identifier: Apache-2.0
"""One cell as frozen values: servos, hand, camera, rig, folders, parameters that differ; read from YAML, written to it.

A device whose section is left out is one that the cell does not have. Paths in a file are relative to its folder.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, TypeVar

import yaml

from softgrip_description.checked_yaml import FileKind
from softgrip_description.errors import CellFileError
from softgrip_description.marked_yaml import Place, place_text
from softgrip_model.durable import write_durably

Section = TypeVar("Section")

SCHEMA = 1
_KIND = FileKind("cell", CellFileError, "`wizard` makes one")
_HEADER = """# yaml-language-server: $schema=cell.schema.json
# One cell (docs/cell_file.md). `ros2 run softgrip_description cell_file check FILE` says what is wrong with it;
# `ros2 launch softgrip_bringup cell.launch.yaml cell_file:=FILE` starts it.
"""


@dataclass(frozen=True)
class TorqueValues:
    """What calibrate_tension found of a servo; None = the data sheet's."""

    torque_per_ampere_nm_a: float | None = None
    friction_current_a: float | None = None
    friction_slope_a_s_m: float | None = None
    gear_load_share: float | None = None
    quick_stddev_n_s2_m2: float | None = None
    tension_stddev_share: float | None = None
    winding_resistance_ohm: float | None = None
    back_emf_v_s: float | None = None
    winding_stddev_share: float | None = None
    limited_current: str | None = None


@dataclass(frozen=True)
class ChainServo:
    """One servo of the chain.

    Attributes:
        tendon: on its spool; the name of the finger's slot.
        model, servo_id: as `scan` shows them.
        direction: 1 where a positive rotation pulls, else -1; None = not found yet.
        spool_radius_m: to the middle of the tendon; None = as shipped.
        slack_m: loose tendon that the tensioning left; None = not tensioned yet.
        torque: of calibrate_tension.
    """

    tendon: str
    model: str
    servo_id: int
    direction: int | None = None
    spool_radius_m: float | None = None
    slack_m: float | None = None
    torque: TorqueValues = field(default_factory=TorqueValues)


@dataclass(frozen=True)
class ServoChain:
    """Servos on one bus: its port, baud rate [1/s] and backend (None = as shipped), and who is on it."""

    port: str
    baud: int | None = None
    chain: tuple[ChainServo, ...] = ()
    drive: str | None = None

    def with_servo(self, servo: ChainServo) -> ServoChain:
        """Return the chain with a servo, in place of the one of the same tendon."""
        others = {one.tendon: one for one in self.chain} | {servo.tendon: servo}
        return replace(self, chain=tuple(others.values()))


@dataclass(frozen=True)
class CellCamera:
    """The camera; None = as the camera node's own parameter has it."""

    source: str
    calibration: Path | None = None
    width: int | None = None
    height: int | None = None
    fps: float | None = None
    exposure_s: float | None = None
    gain: int | None = None
    focus: int | None = None
    white_balance_k: int | None = None
    power_line_hz: int | None = None


@dataclass(frozen=True)
class RigStage:
    """What pulls on the rig."""

    kind: str
    port: str
    start: str | None = None


@dataclass(frozen=True)
class RigGauge:
    """What measures force on the rig."""

    kind: str
    port: str
    line: str | None = None
    baud: int | None = None
    request: str | None = None
    counts_per_newton: float | None = None
    calibration: Path | None = None


@dataclass(frozen=True)
class CellRig:
    """The friction rig."""

    stage: RigStage
    gauge: RigGauge


@dataclass(frozen=True)
class CellFolders:
    """Where the cell keeps what it makes and finds its fingers; None = as shipped."""

    out: Path | None = None
    bags: Path | None = None
    profiles: Path | None = None


@dataclass(frozen=True)
class CellFile:
    """A cell.

    Attributes:
        name: namespace of its nodes; empty = none.
        hardware: "real" or "emulated".
        servos, camera, rig: None = the cell has none.
        hand: None = the shipped hand.
        folders: where things are.
        parameters: node -> parameter -> value; they win over all that is shipped.
    """

    hardware: str
    name: str = ""
    servos: ServoChain | None = None
    hand: Path | None = None
    camera: CellCamera | None = None
    rig: CellRig | None = None
    folders: CellFolders = field(default_factory=CellFolders)
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


def load_cell(path: Path) -> CellFile:
    """Read and check a cell file.

    Raises:
        CellFileError: it cannot be read, or does not describe a cell; names every problem with its line.
    """
    path = path.expanduser()
    return parse_cell(_KIND.read(path), path)


def parse_cell(text: str, path: Path) -> CellFile:
    """Return the cell of a text that stands, or could stand, at a path; raises CellFileError as `load_cell` does."""
    document = _KIND.parse(text, path)
    _refuse_other_formats(document.value, path)
    _KIND.check(document, path)
    cell = _Reader(path.resolve().parent).read(document.value)
    _KIND.refuse(_contradictions(cell), document, path)
    return cell


def _refuse_other_formats(value: Any, path: Path) -> None:
    if isinstance(value, dict) and any("ros__parameters" in body for body in value.values() if isinstance(body, dict)):
        raise CellFileError(
            f"{path}: expected a cell file (schema, hardware, servos, ...), found parameters of nodes; put them under "
            "`parameters:` of a cell file, as `parameters: {tendon_driver: {homing_speed_m_s: 0.01}}`"
        )


def _contradictions(cell: CellFile) -> list[tuple[Place, str]]:
    """Return what no schema can say: names, IDs and ports that are there twice."""
    chain = cell.servos.chain if cell.servos else ()
    problems: list[tuple[Place, str]] = []
    for index, servo in enumerate(chain):
        before = chain[:index]
        place: Place = ("servos", "chain", index)
        if any(one.tendon == servo.tendon for one in before):
            problems.append(((*place, "tendon"), f"expected each tendon once, found {servo.tendon} again"))
        if any(one.servo_id == servo.servo_id for one in before):
            remedy = "give it one of its own: `ros2 run softgrip_driver wizard`"
            problems.append(((*place, "id"), f"expected each ID once, found {servo.servo_id} again; {remedy}"))
    ports: list[tuple[Place, str]] = [(("servos", "port"), cell.servos.port)] if cell.servos else []
    if cell.rig:
        ports += [(("rig", "stage", "port"), cell.rig.stage.port), (("rig", "gauge", "port"), cell.rig.gauge.port)]
    used: dict[str, Place] = {}
    for at, port in ports:
        if port in used:
            problems.append((at, f"expected a port of its own, found that of {place_text(used[port])}, {port}"))
        used[port] = at
    return problems


class _Reader:
    """Turns checked values into a cell.

    Args:
        folder: that paths are relative to.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def read(self, data: Mapping[str, Any]) -> CellFile:
        """Return the cell."""
        folders = data.get("folders", {})
        return CellFile(
            hardware=data["hardware"],
            name=data.get("cell", ""),
            servos=self._servos(data["servos"]) if "servos" in data else None,
            hand=self._path(data.get("hand")),
            camera=self._section(CellCamera, data["camera"]) if "camera" in data else None,
            rig=self._rig(data["rig"]) if "rig" in data else None,
            folders=CellFolders(**{name: self._path(folder) for name, folder in folders.items()}),
            parameters=data.get("parameters", {}),
        )

    def _servos(self, data: Mapping[str, Any]) -> ServoChain:
        chain = tuple(
            ChainServo(
                servo_id=row["id"],
                torque=TorqueValues(**row.get("torque", {})),
                **{name: value for name, value in row.items() if name not in {"id", "torque"}},
            )
            for row in data["chain"]
        )
        return ServoChain(data["port"], data.get("baud"), chain, data.get("drive"))

    def _rig(self, data: Mapping[str, Any]) -> CellRig:
        return CellRig(self._section(RigStage, data["stage"]), self._section(RigGauge, data["gauge"]))

    def _section(self, kind: type[Section], data: Mapping[str, Any]) -> Section:
        return kind(**{name: self._path(value) if name == "calibration" else value for name, value in data.items()})

    def _path(self, text: str | None) -> Path | None:
        return None if text is None else self._folder / Path(text).expanduser()


def cell_text(cell: CellFile, folder: Path | None = None) -> str:
    """Return a cell file's text; what is as shipped is left out, and paths within ``folder`` are relative to it."""
    data: dict[str, object] = {"schema": SCHEMA, "cell": cell.name, "hardware": cell.hardware}
    if cell.servos is not None:
        rows = [_row(servo) for servo in cell.servos.chain]
        servos = cell.servos
        data["servos"] = {"drive": servos.drive, "port": servos.port, "baud": servos.baud, "chain": rows}
    data |= {"hand": cell.hand, "camera": cell.camera, "rig": cell.rig, "folders": cell.folders}
    data["parameters"] = {node: dict(values) for node, values in cell.parameters.items()}
    return _HEADER + yaml.safe_dump(_plain(data, folder), sort_keys=False, width=110)


def save_cell(cell: CellFile, path: Path) -> None:
    """Write a cell file whole, or not at all; raises CellFileError where that cannot be done."""
    path = path.expanduser()
    try:
        write_durably(path, cell_text(cell, path.resolve().parent).encode())
    except OSError as error:
        raise CellFileError(f"{path}: expected a file that can be written, found: {error}; choose another") from error


def _row(servo: ChainServo) -> dict[str, object]:
    values = {one.name: getattr(servo, one.name) for one in fields(servo)}
    values["id"] = values.pop("servo_id")
    order = ("tendon", "model", "id", "direction", "spool_radius_m", "slack_m", "torque")
    return {name: values[name] for name in order}


def _plain(value: Any, folder: Path | None) -> Any:
    """Return plain values without what is None or empty, paths within a folder relative to it."""
    if hasattr(value, "__dataclass_fields__"):
        value = {one.name: getattr(value, one.name) for one in fields(value)}
    if isinstance(value, dict):
        inner = {name: _plain(one, folder) for name, one in value.items()}
        return {name: one for name, one in inner.items() if one is not None and one not in ({}, "")}
    if isinstance(value, list | tuple):
        return [_plain(one, folder) for one in value]
    if isinstance(value, Path):
        return str(value.relative_to(folder) if folder is not None and value.is_relative_to(folder) else value)
    return value
