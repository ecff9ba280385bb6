# SPDX-License-Identifier: Apache-2.0
"""The emulated cell as one thing: plant, servo bus, camera and friction rig behind their wires.

Wires made in the wire folder: `servos`, `stand`, `gauge` (links to pseudo-terminals), `camera.url`,
`camera_calibration.yaml`.
"""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Self

import numpy as np

from softgrip_emulator.camera.camera_process import CameraProcess
from softgrip_emulator.camera.exposure_sample import CameraSettings, ExposureSample, Pose
from softgrip_emulator.clock import CellClock
from softgrip_emulator.dynamixel.chain import DynamixelChain
from softgrip_emulator.errors import EmulatorError
from softgrip_emulator.faults import FaultBoard
from softgrip_emulator.plant.cell import CellPlant, ServoPlace, Supply
from softgrip_emulator.rig import EmulatedRig
from softgrip_emulator.rig.sensor import OtherLine
from softgrip_emulator.wire.faulty import FaultyWire
from softgrip_emulator.wire.folder import open_wire_folder
from softgrip_emulator.wire.pty import PtyPort

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from softgrip_emulator.plant.grasp import GraspState
    from softgrip_model.profile import Profile

    Array = NDArray[np.float64]

_log = logging.getLogger(__name__)

SEEN_SLOT: Final = "index"
"""The camera looks at this finger from the side, and at what is behind it."""
_PLANT_PERIOD_S: Final = 0.004
_EXPOSURE_S: Final = 0.008


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
    """Owns plant, wires, camera and rig. Use as a context manager, or call `open` and `close`."""

    def __init__(
        self,
        profiles: Mapping[str, Profile],
        wire_dir: Path,
        *,
        seed: int = 1,
        rig_time_scale: float = 1.0,
        time_scale: float = 1.0,
        chain: Sequence[ServoPlace] | None = None,
        supply: Supply | None = None,
        camera: CameraSettings | None = None,
        gauge_on: str = "",
    ) -> None:
        """Prepare a cell; nothing exists before `open`.

        Args:
            profiles: finger sets by id, as printed.
            wire_dir: folder the wires are made in.
            seed: of everything that is drawn.
            rig_time_scale: how much faster than the cell's clock the friction rig lives.
            time_scale: cell seconds per wall second for everything else.
            chain: servos on the bus.
            supply: of the servos.
            camera: resolution, rate, port.
            gauge_on: slot whose tendon the force gauge hangs in; empty = the rig's cable.

        Raises:
            EmulatorError: no such slot.
        """
        self.wire_dir = wire_dir
        self.seed = seed
        self.clock = CellClock(time_scale)
        self._epoch_s = time.time()
        self.plant = CellPlant(profiles, seed=seed, chain=chain, supply=supply)
        self.rig = EmulatedRig(seed, rig_time_scale * time_scale)
        if gauge_on:
            index = self.plant.index(gauge_on)
            self.rig.cell.hang(OtherLine(self.rig.truth, lambda: float(self.plant.bank.tension_n[index])))
        self.chain = DynamixelChain(self.plant.servos, lock=self.plant.lock, before=self.plant.advance_to)
        self.bus_wire = FaultyWire(self.chain, seed)
        self.bus_port = PtyPort(wire_dir / "servos", self.bus_wire, clock=self.clock)
        self._settings = camera or CameraSettings()
        timed = replace(self._settings, fps=self._settings.fps * time_scale)
        self.camera = CameraProcess(timed, seed, SEEN_SLOT, self._look)
        self.faults = FaultBoard(self)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._live, name="plant", daemon=True)

    def open(self) -> Self:
        """Make all wires and start living.

        Raises:
            EmulatorError: a wire cannot be made; says which and what to do.
        """
        try:
            open_wire_folder(self.wire_dir)
            self.bus_port.start()
            self.rig.open_ports(self.wire_dir)
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
        self._thread.start()
        return self

    def close(self) -> None:
        """Take all wires away. May be called more than once."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(2.0)
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
        """The cell's time in seconds since the epoch: the wall's at real time, else what /clock says."""
        if self.clock.scale == 1.0:
            return time.time()
        return self._epoch_s + self.clock.now_s()

    @property
    def stream_url(self) -> str:
        """Address of the camera's stream; empty before `open`."""
        return self.camera.stream_url

    def truth(self) -> Truth:
        """What is so now."""
        plant = self.plant
        with plant.lock:
            bank = plant.bank
            chain, _ = bank.chain()
            pulled = plant.wound_m() - plant.taken_slack_m()
            fingers = tuple(
                EmulatedFingerReading(
                    slot=slot,
                    profile=finger.profile,
                    pulled_length_m=float(pulled[i]),
                    tension_n=float(bank.tension_n[i]),
                    joint_angles_rad=bank.q[i, : finger.joints].copy(),
                    tip_m=chain[i, finger.joints].copy(),
                    span_tensions_n=bank.span_tension_n[i, : 2 * finger.joints].copy(),
                )
                for i, (slot, finger) in enumerate(zip(plant.slots, plant.mounted, strict=True))
                if finger is not None
            )
            return Truth(fingers, plant.grasp.state(), self.faults.active)

    def _look(self) -> ExposureSample:
        """The seen finger now, and where it was when the exposure began (from its joint speeds)."""
        plant, faults = self.plant, replace(self.camera.faults)
        with plant.lock:
            stamp_s = self.epoch_time_s()
            index = plant.index(SEEN_SLOT)
            finger = plant.mounted[index]
            if finger is None:
                empty = Pose(np.zeros((0, 2)), np.zeros(0))
                return ExposureSample(empty, empty, stamp_s, faults)
            chain, heading = plant.bank.chain()
            joints = finger.joints
            product = plant.grasp.outline_m(index)
            now = Pose(chain[index, : joints + 1], heading[index, :joints], finger.body_height_m, product)
            earlier, earlier_heading = plant.bank.chain(plant.bank.q - _EXPOSURE_S * plant.bank.joint_speed)
            before = Pose(earlier[index, : joints + 1], earlier_heading[index, :joints], finger.body_height_m, product)
            return ExposureSample(now, before, stamp_s, faults)

    def _live(self) -> None:
        while not self._stop.is_set():
            began_s = time.monotonic()
            now_s = self.clock.now_s()
            self.faults.tick(now_s)
            self.plant.advance_to(now_s)
            spent_s = time.monotonic() - began_s
            self._stop.wait(max(0.0005, self.clock.wall_duration_s(_PLANT_PERIOD_S) - spent_s))
