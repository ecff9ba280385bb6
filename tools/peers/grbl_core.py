# SPDX-License-Identifier: Apache-2.0
"""The stage driver against GRBL's and grblHAL's own cores, compiled as simulators: how many checks hold.

A simulator is a program that speaks on its standard input and output. It is started anew whenever its port is opened,
as an Arduino is reset. Built from their makers' sources (gnea/grbl with grbl/grbl-sim; grblHAL/Simulator):

    python tools/peers/grbl_core.py grbl /tmp/grbl/grbl-sim/grbl_sim.exe
    python tools/peers/grbl_core.py grblhal /tmp/Simulator/build/grblHAL_sim

Settings are written to it with its own $-commands before each check, and stay in its own EEPROM file.
"""

from __future__ import annotations

import argparse
import os
import pty
import subprocess
import sys
import tempfile
import time
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Any

from softgrip_driver.errors import DeviceRefusedError, DriverError
from softgrip_driver.rig.grbl import BAUD, GrblStage, StageStart
from softgrip_driver.rig.line_port import LinePort

#: [s] for an answer: the simulator is a thread of a busy machine
REPLY_S, BOOT_S, ARRIVES_S = 30.0, 60.0, 120.0
NEAR_M = 3e-5
SPEED_M_S = 0.005


class Core:
    """A simulator behind a pseudo-terminal, started anew by whoever opens its port."""

    def __init__(self, program: Path, folder: Path) -> None:
        self._program, self._folder = program, folder
        self._process: subprocess.Popen[bytes] | None = None
        self._ends: tuple[int, ...] = ()

    def start(self) -> str:
        """Start it; return the path of its port."""
        self.stop()
        driver, simulator = pty.openpty()
        for end in (driver, simulator):
            tty.setraw(end)
        path = os.ttyname(simulator)
        self._ends = (driver, simulator)
        self._process = subprocess.Popen(
            [self._program.resolve(), "-n"], stdin=driver, stdout=driver, stderr=subprocess.DEVNULL, cwd=self._folder
        )
        return path

    def stop(self) -> None:
        """End it."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        for end in self._ends:
            os.close(end)
        self._process, self._ends = None, ()

    def configure(self, settings: dict[int, float]) -> None:
        """Write settings with its own commands."""
        port = LinePort(self.start(), BAUD, REPLY_S)
        port.open()
        deadline = time.monotonic() + BOOT_S
        while time.monotonic() < deadline:
            try:
                if port.read_line(1.0).lower().startswith(b"grbl"):
                    break
            except DriverError:
                continue
        for number, value in settings.items():
            port.drain()
            port.write(f"${number}={value:g}\n".encode())
            answer = port.read_line(REPLY_S)
            while answer != b"ok":
                if answer.startswith(b"error"):
                    raise SystemExit(f"${number}={value:g}: {answer!r}")
                answer = port.read_line(REPLY_S)
        port.close()
        self.stop()

    def open(self, start: StageStart = StageStart.REFUSE) -> tuple[GrblStage, Any]:
        """Open it with the driver; return the stage and what it says of itself."""
        stage = GrblStage(LinePort(self.start(), BAUD, REPLY_S), BOOT_S, start)
        return stage, stage.open()


class Checks:
    """Counts what holds."""

    def __init__(self) -> None:
        self.done = 0
        self.failed: list[str] = []

    def __call__(self, name: str, *, holds: bool, found: object = "") -> None:
        """Count a check."""
        self.done += 1
        if not holds:
            self.failed.append(f"{name}: found {found}")


def settled(stage: GrblStage, target_m: float) -> float:
    """Wait until it is where it was sent, or for as long as that may take; return where it is [m]."""
    deadline = time.monotonic() + ARRIVES_S
    while abs((where := stage.travel()) - target_m) > NEAR_M and time.monotonic() < deadline:
        time.sleep(0.05)
    return where


def goes(stage: GrblStage, check: Checks, what: str) -> None:
    """Zero, 5 mm, back, half way and stop."""
    stage.zero()
    check(f"{what}: zero", holds=abs(stage.travel()) < NEAR_M, found=stage.travel())
    for target_m in (0.005, 0.0, -0.003):
        stage.start(target_m, SPEED_M_S)
        where = settled(stage, target_m)
        check(f"{what}: goes to {target_m * 1e3:g} mm", holds=abs(where - target_m) <= NEAR_M, found=where)
    stage.start(0.017, SPEED_M_S)
    time.sleep(0.5)
    stage.stop()
    time.sleep(1.5)
    stopped = stage.travel()
    time.sleep(0.5)
    stands = abs(stage.travel() - stopped) < NEAR_M
    check(f"{what}: stops on the way", holds=stands and -0.003 < stopped < 0.0165, found=stopped)
    stage.start(0.0, SPEED_M_S)
    check(f"{what}: goes on after a stop", holds=abs(settled(stage, 0.0)) <= NEAR_M)


def refused(act: Callable[[], object], text: str) -> tuple[bool, str]:
    """Return whether something is refused with a text, and what was said."""
    try:
        act()
    except DeviceRefusedError as error:
        return text in str(error), str(error)
    except DriverError as error:
        return False, repr(error)
    return False, "not refused"


def checked(core: Core, kind: str, check: Checks) -> None:
    """Run all checks."""
    plain = {10: 1, 13: 0, 22: 0, 21: 0, 20: 0, 100: 250, 110: 1000, 120: 100}
    core.configure(plain)
    stage, identity = core.open()
    name = "grblHAL 1.1" if kind == "grblhal" else "GRBL 1.1"
    check("it is named", holds=identity.model.startswith(name), found=identity.model)
    check("no switches are named", holds=any("$22=0" in text for text in identity.warnings), found=identity.warnings)
    goes(stage, check, "machine position, millimetres")
    holds, said = refused(stage.home, "$22=1")
    check("homing without switches is refused", holds=holds, found=said)
    holds, said = refused(lambda: stage.start(0.01, -1.0), "GRBL")
    check("a negative feed is refused", holds=holds, found=said)
    stage.close()

    for what, settings in (
        ("inches", {13: 1}), ("work position", {10: 0}), ("work position in inches", {10: 0, 13: 1}),
        ("all reports", {10: 511 if kind == "grblhal" else 3}),
    ):  # fmt: skip
        core.configure(plain | settings)
        stage, identity = core.open()
        warned = any("inches" in text for text in identity.warnings)
        check(f"{what}: said", holds=warned == (13 in settings), found=identity.warnings)
        goes(stage, check, what)
        stage.close()

    core.configure(plain | {100: 10})
    stage, identity = core.open()
    check("coarse steps are said", holds=any("$100=10" in text for text in identity.warnings), found=identity.warnings)
    stage.close()

    core.configure(plain | {22: 1})
    holds, said = refused(core.open, "set stage_start to home")
    check("a lock is named with its remedy", holds=holds, found=said)
    for time_opened in (1, 2):
        stage, _ = core.open(StageStart.UNLOCK)
        goes(stage, check, f"unlocked, opened {time_opened}")
        stage.close()
    if kind == "grblhal":
        core.configure(plain | {22: 5})
        holds, said = refused(lambda: core.open(StageStart.UNLOCK), "stage_start to home")
        check("a lock that only homing ends is named", holds=holds, found=said)
    core.configure(plain)


def main() -> int:
    """Print the count and what differs."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("kind", choices=("grbl", "grblhal"))
    arguments.add_argument("program", type=Path)
    options = arguments.parse_args()
    check, ended = Checks(), ""
    with tempfile.TemporaryDirectory() as folder:
        core = Core(options.program, Path(folder))
        try:
            checked(core, options.kind, check)
        except DriverError as error:
            ended = f"; ended early by {error}"
        finally:
            core.stop()
    print(f"{options.kind}: {check.done - len(check.failed)} of {check.done} checks hold{ended}")
    for text in check.failed:
        print(f"  {text}")
    return 0 if not check.failed and not ended else 1


if __name__ == "__main__":
    sys.exit(main())
