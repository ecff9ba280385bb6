# SPDX-License-Identifier: Apache-2.0
"""The stage driver against GRBL's and grblHAL's own cores, compiled as simulators: how many checks hold.

A simulator is a program that speaks on its standard input and output. It is started again whenever its port is opened,
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
import threading
import time
import tty
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from checks import Checks

from softgrip_driver.errors import DeviceRefusedError, DriverError, NotReadyError
from softgrip_driver.rig.grbl import BAUD, GrblStage, StageStart
from softgrip_driver.rig.line_port import LinePort

#: [s] for an answer: the simulator is a thread of a busy machine
REPLY_S, BOOT_S, ARRIVES_S = 30.0, 60.0, 120.0
#: [s] after which a setting is in the simulator's file: it says ok before
SAVED_S = 2.0
#: [s] that the threads between terminal and simulator may take to end
ENDS_S = 5.0
NEAR_M = 3e-5
SPEED_M_S = 0.005


def carry(source: int, sink: int) -> None:
    """Carry bytes from one end to another until either is closed."""
    try:
        while data := os.read(source, 4096):
            while data:
                data = data[os.write(sink, data) :]
    except OSError:
        return


class Core:
    """A simulator behind a pseudo-terminal, started again by whoever opens its port.

    It has pipes of its own. A simulator that shares the terminal changes it for the driver, too: grbl-sim sets its
    modes with each byte, and grblHAL's makes it non-blocking, so that what finds no room is lost.
    """

    def __init__(self, program: Path, folder: Path) -> None:
        self._program, self._folder = program, folder
        self._process: subprocess.Popen[bytes] | None = None
        self._ends: tuple[int, ...] = ()
        self._carriers: list[threading.Thread] = []

    def start(self) -> str:
        """Start it; return the path of its port."""
        self.stop()
        simulator, driver = pty.openpty()
        tty.setraw(driver)
        path = os.ttyname(driver)
        self._ends = (driver, simulator)
        # Without stdbuf a simulator that reads by stdio sees the end of a line with the next only, and answers late.
        self._process = subprocess.Popen(
            ["stdbuf", "-i0", "-o0", self._program.resolve(), "-n"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            cwd=self._folder,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        heard, said = self._process.stdin.fileno(), self._process.stdout.fileno()
        ways = ((simulator, heard), (said, simulator))
        self._carriers = [threading.Thread(target=carry, args=way, daemon=True) for way in ways]
        for carrier in self._carriers:
            carrier.start()
        return path

    def stop(self) -> None:
        """End it."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        # the terminal's last open end ends who waits for bytes from it
        for end in self._ends[:1]:
            os.close(end)
        for carrier in self._carriers:
            carrier.join(ENDS_S)
        for end in self._ends[1:]:
            os.close(end)
        self._process, self._ends, self._carriers = None, (), []

    def configure(self, settings: Mapping[int, float]) -> None:
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
        time.sleep(SAVED_S)
        self.stop()

    def open(self, start: StageStart = StageStart.REFUSE) -> tuple[GrblStage, Any]:
        """Open it with the driver; return the stage and what it says of itself."""
        stage = GrblStage(LinePort(self.start(), BAUD, REPLY_S), BOOT_S, start)
        return stage, stage.open()


def settled(stage: GrblStage, target_m: float) -> float:
    """Wait until it is where it was sent, or for as long as that may take; return where it is [m]."""
    deadline = time.monotonic() + ARRIVES_S
    while abs((where := stage.travel()) - target_m) > NEAR_M and time.monotonic() < deadline:
        time.sleep(0.05)
    return where


def sent(stage: GrblStage, target_m: float) -> None:
    """Send it somewhere, once it has come to rest."""
    deadline = time.monotonic() + ARRIVES_S
    while True:
        try:
            return stage.start(target_m, SPEED_M_S)
        except NotReadyError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.05)


def at_rest(stage: GrblStage) -> float:
    """Wait until it stands; return where [m]."""
    deadline, before = time.monotonic() + ARRIVES_S, stage.travel()
    while time.monotonic() < deadline:
        time.sleep(1.0)
        where = stage.travel()
        if where == before:
            break
        before = where
    return before


def goes(stage: GrblStage, check: Checks, what: str) -> None:
    """Zero, 5 mm, back, half way and stop."""
    stage.zero()
    check(f"{what}: zero", holds=abs(stage.travel()) < NEAR_M, found=stage.travel())
    for target_m in (0.005, 0.0, -0.003):
        sent(stage, target_m)
        where = settled(stage, target_m)
        check(f"{what}: goes to {target_m * 1e3:g} mm", holds=abs(where - target_m) <= NEAR_M, found=where)
    sent(stage, 0.017)
    while stage.travel() < 0.001:
        time.sleep(0.02)
    stage.stop()
    stopped = at_rest(stage)
    check(f"{what}: stops on the way", holds=0.0 < stopped < 0.0165, found=stopped)
    sent(stage, 0.0)
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
    at_rest(stage)
    holds, said = refused(stage.home, "$22=1")
    check("homing without switches is refused", holds=holds, found=said)
    holds, said = refused(lambda: stage.start(0.01, -1.0), "GRBL")
    check("a negative feed is refused", holds=holds, found=said)
    stage.close()

    # The work offset is in grblHAL's reports with the bit 5 of $10 only (report.c); GRBL tells it unasked.
    work = 32 if kind == "grblhal" else 0
    for what, settings in (
        ("inches", {13: 1}), ("work position", {10: work}), ("work position in inches", {10: work, 13: 1}),
        ("all reports", {10: 511 if kind == "grblhal" else 3}),
    ):  # fmt: skip
        core.configure(plain | settings)
        stage, identity = core.open()
        warned = any("inches" in text for text in identity.warnings)
        check(f"{what}: said", holds=warned == (13 in settings), found=identity.warnings)
        goes(stage, check, what)
        stage.close()

    if kind == "grblhal":
        core.configure(plain | {10: 0})
        try:
            core.open()
            said = "not refused"
        except DriverError as error:
            said = str(error)
        check("a work position without its offset is refused", holds="set $10=1" in said, found=said)

    core.configure(plain | {100: 10})
    stage, identity = core.open()
    check("coarse steps are said", holds=any("$100=10" in text for text in identity.warnings), found=identity.warnings)
    stage.close()

    # grblHAL is locked at start with the bit 4 of $22 only.
    core.configure(plain | {22: 5 if kind == "grblhal" else 1})
    holds, said = refused(core.open, "set stage_start to home")
    check("a lock is named with its remedy", holds=holds, found=said)
    core.configure(plain | {22: 1})
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
    failed = check.report(options.kind, ended)
    return 1 if ended else failed


if __name__ == "__main__":
    sys.exit(main())
