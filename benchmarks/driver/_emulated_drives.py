# SPDX-License-Identifier: Apache-2.0
"""The emulated servos of a hand in a process of their own, and the driver beside them: what a stop does to torque."""

from __future__ import annotations

import multiprocessing
import multiprocessing.connection
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from ctypes import Array, c_double
from dataclasses import dataclass
from pathlib import Path

from softgrip_emulator.clock import RealTimeClock
from softgrip_emulator.dynamixel.chain import DynamixelChain
from softgrip_emulator.plant.cell import CellPlant
from softgrip_emulator.wire.pty import PtyPort
from softgrip_model.profile import load_directory, shipped_directory
from softgrip_nodekit import claim_processor

SLOTS = ("index", "middle", "thumb")
PERIOD_S = 0.001
EMULATOR_PRIORITY = 30
#: places in the shared record: when torque was last seen on and off [s, monotonic], and how many drives have it
_ON_AT, _OFF_AT, _POWERED = range(3)


def _emulate(port: str, shared: Array[c_double], stop: multiprocessing.connection.Connection) -> None:
    """Serve the servos and write down, a thousand times a second, how many have torque."""
    claim_processor(EMULATOR_PRIORITY)
    plant = CellPlant(load_directory(shipped_directory()), seed=1)
    plant.mount(list(SLOTS), ["a", "b", "c"], ["power"] * 3)
    clock = RealTimeClock()
    plant.now_s = clock.now_s()
    ended = threading.Event()

    def live() -> None:
        while not ended.wait(PERIOD_S):
            plant.advance_to(clock.now_s())
            powered = sum(bool(servo.registers.get("torque_enable")) for servo in plant.servos)
            shared[_ON_AT if powered else _OFF_AT] = time.monotonic()
            shared[_POWERED] = powered

    chain = DynamixelChain(plant.servos, lock=plant.lock, before=plant.advance_to)
    with PtyPort(Path(port), chain, clock=clock):
        threading.Thread(target=live, daemon=True).start()
        stop.send("ready")
        stop.recv()
        ended.set()


@dataclass
class Servos:
    """The truth about the emulated servos."""

    port: str
    _shared: Array[c_double]

    @property
    def powered(self) -> int:
        """How many have torque now."""
        return round(self._shared[_POWERED])

    @property
    def last_on_s(self) -> float:
        """When a servo last had torque [s, monotonic]."""
        return float(self._shared[_ON_AT])

    def wait_for(self, powered: int, timeout_s: float) -> bool:
        """Wait until so many servos have torque, as seen twice in a row; False when that did not come."""
        end = time.monotonic() + timeout_s
        while time.monotonic() < end:
            if self.powered == powered:
                return True
            time.sleep(PERIOD_S)
        return False


@contextmanager
def emulated_servos(folder: Path) -> Iterator[Servos]:
    """Give three servos with fingers on a bus, emulated in a process of their own."""
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe()
    shared = spawn.Array("d", 3)
    port = str(folder / "servos")
    process = spawn.Process(target=_emulate, args=(port, shared, theirs), daemon=True)
    process.start()
    ours.recv()
    try:
        yield Servos(port, shared.get_obj())
    finally:
        ours.send("stop")
        process.join(5.0)


def start_driver(servos: Servos, folder: Path, domain: int, parameters: Sequence[str] = ()) -> subprocess.Popen[bytes]:
    """Start tendon_driver on these servos, its files in a folder."""
    given = (
        f"port:={servos.port}", f"safety_file:={folder / 'safety.yaml'}", f"zero_file:={folder / 'zeros.yaml'}",
        "no_reply_s:=0.5", "bus_watchdog_s:=1.0", "reply_margin_s:=0.02", *parameters,
    )  # fmt: skip
    words = [word for parameter in given for word in ("-p", parameter)]
    return subprocess.Popen(
        [sys.executable, "-m", "softgrip_driver.nodes.tendon_driver", "--ros-args", *words],
        env={**os.environ, "ROS_DOMAIN_ID": str(domain)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
