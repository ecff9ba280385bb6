# SPDX-License-Identifier: Apache-2.0
"""What a cell has besides its servos: name, hand, camera, rig, folders; found on this computer, asked for, verified."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from softgrip_description.cell_file import CellCamera, CellFile, CellFolders, CellRig, RigGauge, RigStage
from softgrip_description.errors import HandError
from softgrip_description.hand import load_hand
from softgrip_driver.commands.person import Terminal
from softgrip_driver.errors import ConfigurationError, DeviceRefusedError
from softgrip_driver.port_names import FOLDER
from softgrip_driver.rig.build import GAUGES, STAGES, StreamSettings, make_gauge, make_stage
from softgrip_driver.rig.devices import Gauge, Stage
from softgrip_driver.rig.line_format import FORMATS
from softgrip_driver.usb_adapter import BY_ID, stable_names
from softgrip_time import Clock, WallClock

CAMERAS, OWN_NAMES = Path("/dev/v4l/by-id"), Path("/dev") / FOLDER
#: the picture of a camera; its other nodes carry metadata (linux/Documentation, uvcvideo)
_PICTURE = "-video-index0"
NONE, SHIPPED = "none", "shipped"
#: in the names of boards that speak GRBL or print lines: CH340, Arduino, Teensy, SparkFun's and Raspberry's boards
_BOARDS = ("1a86", "arduino", "teensy", "sparkfun", "raspberry", "ch340")

Fill = Callable[[CellFile], CellFile]


@dataclass(frozen=True)
class FoundDevices:
    """What is plugged in, by names that stay.

    Attributes:
        cameras: devices.
        ports: serial ports, without that of the servos.
    """

    cameras: tuple[str, ...] = ()
    ports: tuple[str, ...] = ()


def find_devices(
    servo_port: str, serial: Path = BY_ID, cameras: Path = CAMERAS, own_names: Path = OWN_NAMES
) -> FoundDevices:
    """Return the cameras and serial ports of this computer; a port that `name_ports` has named goes by that name."""
    taken = {Path(servo_port).resolve()}
    ports = []
    for name, device in [*stable_names(own_names), *stable_names(serial)]:
        if device not in taken:
            taken.add(device)
            ports.append(str(name))
    pictures = [str(name) for name, _ in stable_names(cameras) if name.name.endswith(_PICTURE)]
    return FoundDevices(tuple(pictures), tuple(ports))


class CellSections:
    """Asks for what a cell file lacks. A section that is there is kept as it is.

    Args:
        person: who answers.
        found: what is plugged in.
        folder: of the cell file, whose files are offered.
        clock: that the rig's devices are waited for on; None = the computer's.
    """

    def __init__(self, person: Terminal, found: FoundDevices, folder: Path, clock: Clock | None = None) -> None:
        self._person, self._found, self._folder, self._clock = person, found, folder, clock

    def missing(self, cell: CellFile) -> Iterator[tuple[str, Fill]]:
        """Yield (key, what asks for it) of each section that the cell lacks.

        Name and hand have no section where they are as shipped: they are asked for with the folders, which have.
        """
        if cell.folders == CellFolders():
            if not cell.name:
                yield "cell", self._with_name
            if cell.hand is None:
                yield "hand", self._with_hand
            yield "out", self._with_folders
        if cell.camera is None:
            yield "camera", self._with_camera
        if cell.rig is None:
            yield "rig", self._with_rig

    # --- sections --------------------------------------------------------------------------------------------------

    def _with_name(self, cell: CellFile) -> CellFile:
        name = self._person.ask(
            "cell", f"Name of the cell, where there are several (letters, digits, _), or {NONE}", NONE
        )
        return cell if name == NONE else replace(cell, name=name)

    def _with_hand(self, cell: CellFile) -> CellFile:
        answer = self._person.ask("hand", f"Hand file (docs/description.md), or {SHIPPED}", SHIPPED)
        if answer == SHIPPED:
            return cell
        path = _existing("hand", answer)
        try:
            load_hand(path)
        except HandError as error:
            raise ConfigurationError(str(error)) from error
        return replace(cell, hand=path)

    def _with_folders(self, cell: CellFile) -> CellFile:
        out = self._person.ask("out", "Folder for bags, database and friction models", "out")
        profiles = self._person.ask("profiles", f"Folder of finger profiles, or {SHIPPED}", SHIPPED)
        folders = CellFolders(out=self._folder / Path(out).expanduser())
        if profiles != SHIPPED:
            folders = replace(folders, profiles=_existing("profiles", profiles))
        return replace(cell, folders=folders)

    def _with_camera(self, cell: CellFile) -> CellFile:
        found = self._found.cameras
        self._list("camera", found)
        question = f"Camera: {'its number, ' * bool(found)}a device, file or address, or {NONE}"
        source = _chosen(self._person.ask("camera", question, "1" if len(found) == 1 else NONE), found)
        if source == NONE:
            self._left_out("camera", "the cell measures no fingers")
            return cell
        _check_device("camera", source, "plug it in, see `ls /dev/v4l/by-id`; be in the group video")
        calibration = self._file("camera.calibration", "Its calibration, by calibrate_camera", "camera.yaml")
        return replace(cell, camera=CellCamera(source, calibration))

    def _with_rig(self, cell: CellFile) -> CellFile:
        ports = self._found.ports
        self._list("serial port", ports)
        numbers = "its number, " * bool(ports)
        question = f"Stage of the friction rig: {numbers}a port, or {NONE} for a cell without rig"
        stage_port = _chosen(self._person.ask("stage", question, _named("stand", ports)), ports)
        if stage_port == NONE:
            self._left_out("rig", "the shipped friction model stays active")
            return cell
        stage = RigStage(self._kind("stage", stage_port, STAGES, board="grbl"), stage_port)
        self._verify("stage", make_stage(stage.kind, stage.port, clock=self._clock))
        gauge_port = _chosen(
            self._person.ask("gauge", f"Its force gauge: {numbers}a port, or {NONE}", _named("gauge", ports)), ports
        )
        if gauge_port == NONE:
            self._left_out("rig", "it wants a stage and a gauge")
            return cell
        gauge = RigGauge(self._kind("gauge", gauge_port, GAUGES, board="stream"), gauge_port)
        if gauge.kind == "stream":
            line = self._person.ask("gauge.line", f"Its lines: {', '.join(FORMATS)}, or a pattern", "hx711")
            calibration = self._file("gauge.calibration", "Its calibration, by calibrate_cell", "gauge.yaml")
            gauge = replace(gauge, line=line, calibration=calibration)
        stream = StreamSettings(line=gauge.line or StreamSettings.line, calibration=str(gauge.calibration or ""))
        self._verify("gauge", make_gauge(gauge.kind, gauge.port, stream, clock=self._clock))
        return replace(cell, rig=CellRig(stage, gauge))

    # --- helpers ---------------------------------------------------------------------------------------------------

    def _list(self, what: str, found: Sequence[str]) -> None:
        for number, name in enumerate(found, start=1):
            self._person.print_line(f"{what} {number}: {name}")
        if not found:
            self._person.print_line(f"no {what} found by a name that stays")

    def _left_out(self, section: str, meaning: str) -> None:
        self._person.print_line(f"{section}: left out, {meaning}; run the wizard again when it is there")

    def _kind(self, what: str, port: str, kinds: Sequence[str], *, board: str) -> str:
        """Ask for the kind of a device; the adapter's name proposes one."""
        is_board = any(word in Path(port).name.lower() for word in _BOARDS)
        kind = self._person.ask(
            f"{what}.kind", f"Kind of the {what}: {' or '.join(kinds)}", board if is_board else kinds[0]
        )
        if kind not in kinds:
            raise ConfigurationError(f"{what}: expected a kind of {', '.join(kinds)}, found '{kind}'")
        return kind

    def _file(self, key: str, what: str, usual: str) -> Path | None:
        default = usual if (self._folder / usual).is_file() else NONE
        answer = self._person.ask(key, f"{what}: a file, or {NONE}", default)
        if answer == NONE:
            return None
        beside = self._folder / Path(answer).expanduser()
        return beside if beside.is_file() else _existing(key, answer)

    def _verify(self, what: str, device: Stage | Gauge) -> None:
        """See that a device answers as what it is said to be; nothing moves. Raises DriverError."""
        with (self._clock or WallClock()).stepping():
            try:
                identity = device.open()
            except DeviceRefusedError as error:
                self._person.print_line(f"{what}: it answers, and says: {error}")
            else:
                self._person.print_line(f"{what}: {identity.model} {identity.serial}".rstrip())
            finally:
                device.close()


def _named(name: str, ports: Sequence[str]) -> str:
    """Return the port of a name that `name_ports` has given, to be the default."""
    own = str(OWN_NAMES / name)
    return own if own in ports else NONE


def _chosen(answer: str, found: Sequence[str]) -> str:
    """Return what an answer stands for: a number of the list, or itself."""
    if answer.isdigit() and 1 <= int(answer) <= len(found):
        return found[int(answer) - 1]
    return answer


def _existing(key: str, answer: str) -> Path:
    path = Path(answer).expanduser().resolve()
    if not path.exists():
        raise ConfigurationError(f"{key}: expected a file or folder, found nothing at {path}; correct its name")
    return path


def _check_device(what: str, source: str, remedy: str) -> None:
    """Raise ConfigurationError where a device is not there, or belongs to others; other sources are not looked at."""
    if not source.startswith("/dev/"):
        return
    if not Path(source).exists():
        raise ConfigurationError(f"{what}: expected a device, found nothing at {source}; {remedy}")
    if not os.access(source, os.R_OK | os.W_OK):
        raise ConfigurationError(f"{what}: expected a device that may be opened, found {source} of others; {remedy}")
