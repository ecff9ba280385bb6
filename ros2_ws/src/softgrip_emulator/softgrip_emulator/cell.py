# SPDX-License-Identifier: Apache-2.0
"""The emulated cell as one thing: plant, servo bus, camera and friction rig behind their wires.

Wires made in the wire folder: `servos`, `stand`, `gauge` (links to pseudo-terminals), `camera.url`,
`camera_calibration.yaml`, and `time`, the socket of the cell's time (`time_server`).
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Self

import numpy as np

from softgrip_emulator.camera.camera_process import CameraProcess
from softgrip_emulator.camera.exposure_sample import CameraSettings, ExposureSample, Pose
from softgrip_emulator.camera.optics import draw_optics
from softgrip_emulator.clock import ScaledCellClock, SetClock
from softgrip_emulator.errors import EmulatorError
from softgrip_emulator.faults import FaultBoard, FaultyDevices
from softgrip_emulator.plant.cell import CellPlant, ServoPlace, Supply
from softgrip_emulator.rig import EmulatedRig
from softgrip_emulator.servos import make_chain
from softgrip_emulator.thermometer import Thermometer
from softgrip_emulator.time_server import GIVE_UP_S, TimeServer
from softgrip_emulator.wire.faulty import FaultyWire
from softgrip_emulator.wire.folder import open_wire_folder
from softgrip_emulator.wire.pty import DrivenPort
from softgrip_emulator.wire.usb_adapter import UsbAdapter

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from softgrip_emulator.camera.exposure_sample import ExposureReport
    from softgrip_emulator.plant.grasp import GraspState
    from softgrip_emulator.wire.device import WireDevice
    from softgrip_model.profile import Profile

    Array = NDArray[np.float64]

TIME_SOCKET: Final = "time"
"""Socket in the wire folder that participants of the cell's time connect to."""
SEEN_SLOT: Final = "index"
"""The camera looks at this finger from the side, and at what is behind it."""
_EXPOSURE_S: Final = 0.008
_ROUNDING_S: Final = 1e-6
_HOST_POLL_S: Final = 0.02


@dataclass(frozen=True)
class EmulatedFingerReading:
    """The truth about one mounted finger, SI units."""

    slot: str
    profile: str
    pulled_length_m: float
    tension_n: float
    joint_angles_rad: Array
    tip_m: Array
    span_tensions_n: Array


@dataclass(frozen=True)
class Truth:
    """Everything that is so at one instant."""

    fingers: tuple[EmulatedFingerReading, ...]
    grasp: GraspState
    active_faults: tuple[str, ...]


class EmulatedCell:
    """Owns plant, wires, camera, rig and their time. Use as a context manager, or call `open` and `close`."""

    def __init__(
        self,
        profiles: Mapping[str, Profile],
        wire_dir: Path,
        *,
        seed: int = 1,
        rig_time_scale: float = 1.0,
        speed: float = 1.0,
        expected: Collection[str] = (),
        on_tick: Callable[[], None] = lambda: None,
        chain: Sequence[ServoPlace] | None = None,
        supply: Supply | None = None,
        camera: CameraSettings | None = None,
        gauge_on: str = "",
        stage: str = "mark10",
        gauge: str = "gcl2",
        adapter_latency_s: float = 0.0,
    ) -> None:
        """Prepare a cell; nothing exists before `open`.

        Args:
            profiles: finger sets by id, as printed.
            wire_dir: folder the wires are made in.
            seed: of everything that is drawn.
            rig_time_scale: how much faster than the cell's clock the friction rig lives.
            speed: cell seconds a second at most; 0 = as fast as all participants keep up.
            expected: names of participants without which it goes no faster than the computer's time.
            on_tick: called in the thread of the cell's time when that has gone on.
            chain: servos on the bus.
            supply: of the servos.
            camera: resolution, rate, port.
            gauge_on: slot whose tendon the force gauge hangs in; empty = the rig's cable.
            stage: of the rig, as `EmulatedRig` names it.
            gauge: likewise.
            adapter_latency_s: latency timer of the servos' USB adapter [s], 0 = none.

        Raises:
            EmulatorError: no such slot.
        """
        self.wire_dir = wire_dir
        self.seed = seed
        self.clock = SetClock()
        self.plant = CellPlant(profiles, seed=seed, chain=chain, supply=supply)
        self.thermometer = Thermometer(lambda: self.plant.temperature_c, seed)
        self.rig = EmulatedRig(seed, clock=ScaledCellClock(self.clock, rig_time_scale), stage=stage, gauge=gauge)
        if gauge_on:
            index = self.plant.index(gauge_on)
            self.rig.hang_gauge(lambda: float(self.plant.bank.tension_n[index]))
        self.chain = make_chain(self.plant.servos, self.plant.lock, self.plant.advance_to)
        self.bus_wire = FaultyWire(self.chain, seed)
        self.time_server = TimeServer(
            wire_dir / TIME_SOCKET,
            self.clock,
            lambda: self._ports,
            self._advance_to,
            speed=speed,
            expected=expected,
            is_busy=self._is_exposing,
        )
        self.adapter = UsbAdapter(self.bus_wire, adapter_latency_s)
        self.bus_port = DrivenPort(wire_dir / "servos", self.adapter, self.clock, wake=self.time_server.wake)
        self._ports = [self.bus_port]
        self._on_tick = on_tick
        self._settings = camera or CameraSettings()
        self._optics = draw_optics(self._settings.width, self._settings.height, seed)
        self.camera = CameraProcess(self._settings, seed, SEEN_SLOT, self._on_exposed)
        self._exposed_s = self._exposure_due_s = 0.0
        self._exposing_since = 0.0
        self.faults = FaultBoard(
            FaultyDevices(self.clock, self.plant, self.bus_wire, self.adapter, self.bus_port, self.camera, self.rig)
        )

    def open(self) -> Self:
        """Make all wires and start living.

        Raises:
            EmulatorError: a wire cannot be made; says which and what to do.
        """
        try:
            open_wire_folder(self.wire_dir)
            self.time_server.open()
            self.bus_port.open(self.time_server.thread)
            self.rig.open_ports(self.wire_dir, self._make_port)
        except OSError as error:
            self.close()
            raise EmulatorError(f"wire folder {self.wire_dir}: expected to make ports in it, found: {error}") from error
        try:
            self.camera.open(self.wire_dir / "camera.url", self.wire_dir / "camera_calibration.yaml")
        except OSError as error:
            self.close()
            raise EmulatorError(
                f"camera stream on port {self._settings.port}: expected a free port on 127.0.0.1 and a folder "
                f"{self.wire_dir} to write to, found: {error}; choose another port (0 = any free one) or wire_dir"
            ) from error
        self.time_server.start()
        return self

    def _make_port(self, path: Path, device: WireDevice) -> DrivenPort:
        port = DrivenPort(path, device, self.rig.clock, wake=self.time_server.wake)
        port.open(self.time_server.thread)
        self._ports.append(port)
        return port

    def await_hosts(self, limit_s: float) -> None:
        """Live on until no program has a wire open, for so long at most [s, the computer's]: as devices do.

        Who ends at the same moment still has to tell its drives to let go, and to hear that they did.
        """
        deadline_s = time.monotonic() + limit_s
        while any(port.attached for port in self._ports) and time.monotonic() < deadline_s:
            time.sleep(_HOST_POLL_S)

    def close(self) -> None:
        """Take all wires away. May be called more than once."""
        self.time_server.close()
        self.camera.close()
        self.bus_port.close()
        self.rig.close()
        for name in ("camera.url", "camera_calibration.yaml"):
            (self.wire_dir / name).unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self.open()

    def __exit__(self, *_: object) -> None:
        self.close()

    def epoch_time_s(self) -> float:
        """The cell's time in seconds since the epoch."""
        return self.time_server.epoch_s + self.clock.now_s()

    def frame_time_s(self) -> float:
        """When a frame is taken, in seconds since the epoch.

        The cell's time where somebody follows it, has followed it or is expected to. Else it is the computer's, which
        everybody else stamps by: the cell's falls behind it on a computer that is too slow for real time.
        """
        return self.epoch_time_s() if self.time_server.is_followed else time.time()

    @property
    def stream_url(self) -> str:
        """Address of the camera's stream; empty before `open`."""
        return self.camera.stream_url

    def truth(self) -> Truth:
        """What is so now."""
        plant = self.plant
        with plant.lock:
            bank = plant.bank
            pulled = plant.wound_m() - plant.taken_slack_m()
            fingers = tuple(
                EmulatedFingerReading(
                    slot=slot,
                    profile=finger.profile,
                    pulled_length_m=float(pulled[i]),
                    tension_n=float(bank.tension_n[i]),
                    joint_angles_rad=bank.q[i, : finger.joints].copy(),
                    tip_m=plant.points_m(i)[0][-1, :2],
                    span_tensions_n=bank.span_tension_n[i, : 2 * finger.joints].copy(),
                )
                for i, (slot, finger) in enumerate(zip(plant.slots, plant.mounted, strict=True))
                if finger is not None
            )
            return Truth(fingers, plant.grasp.state(), self.faults.active)

    def _sample(self) -> ExposureSample:
        """The seen finger now, and where it was when the exposure began (from its joint speeds)."""
        plant, faults = self.plant, replace(self.camera.faults)
        with plant.lock:
            stamp_s = self.frame_time_s()
            index = plant.index(SEEN_SLOT)
            finger = plant.mounted[index]
            if finger is None:
                empty = Pose(np.zeros((0, 2)), np.zeros(0))
                return ExposureSample(empty, empty, stamp_s, faults)
            product = plant.grasp.outline_m(index)
            now, before = (
                Pose(self._optics.in_plane(points), headings, finger.body_height_m, product)
                for points, headings in (plant.points_m(index), plant.points_m(index, _EXPOSURE_S))
            )
            return ExposureSample(now, before, stamp_s, faults)

    def _advance_to(self, now_s: float) -> None:
        """Advance faults, plant and camera to a time [s]; in the thread of the cell's time."""
        self.faults.tick(now_s)
        self.plant.advance_to(now_s)
        if now_s > self._exposure_due_s - _ROUNDING_S:
            self._expose(now_s)
        self._on_tick()

    def _expose(self, now_s: float) -> None:
        period_s = 1.0 / self._settings.fps
        self._exposure_due_s = max(self._exposure_due_s + period_s, now_s)
        if self.camera.viewers and not self.camera.is_exposing:
            self._exposed_s, self._exposing_since = now_s, time.monotonic()
            self.time_server.participants.add_exposure(now_s)
            self.camera.expose(self._sample())

    def _is_exposing(self, target_s: float) -> bool:
        """Whether the last exposure must be rendered first; one that takes too long is waited for no more.

        Where nobody follows the cell's time, devices answer at the computer's; a camera that is late misses a frame.
        """
        if not self.time_server.is_followed:
            return False
        is_due = target_s > self._exposure_due_s - _ROUNDING_S
        return is_due and self.camera.is_exposing and time.monotonic() - self._exposing_since < GIVE_UP_S

    def _on_exposed(self, report: ExposureReport) -> None:
        exposed_s = self._exposed_s
        if report.is_rendered and not report.is_shown:
            self.time_server.post(lambda: self.time_server.participants.drop_exposure(exposed_s))
        self.time_server.wake()
