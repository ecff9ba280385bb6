# SPDX-License-Identifier: Apache-2.0
"""`ros2 run softgrip_driver stage`: who a linear stage or test stand is, its lock left, its direction tried."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from softgrip_driver.commands.common import DONE, number, parser, run
from softgrip_driver.errors import DeviceRefusedError, StageStalledError
from softgrip_driver.rig.build import STAGES, make_stage
from softgrip_driver.rig.devices import Stage
from softgrip_driver.rig.grbl import GrblStage, StageStart
from softgrip_driver.tendon.safety_store import check_port_is_free_to_move
from softgrip_time import Clock, WallClock

TEXT = """Connect to the stage that pulls and say who it is and what is not well. Nothing moves unless asked:

    stage --port /dev/ttyUSB1 --kind grbl                   who is it, is it locked, what do its settings mean
    stage --port /dev/ttyUSB1 --kind grbl --start home      drive to its switches ($H), at once: take the cable off
    stage --port /dev/ttyUSB1 --kind grbl --jog 5           go 5 mm: this must pull; else swap its direction (GRBL: $3)

Opening the port resets most GRBL boards, and one with switches ($22=1) is locked again by that: give the driver the
same choice as its parameter stage_start."""

#: [mm] that counts as arrived
_ARRIVED = 0.03
_PERIOD = 0.1


def jog(stage: Stage, way_mm: float, speed_mm_s: float, clock: Clock) -> float:
    """Go a way [mm] from here at a speed [mm/s] and return where it stands then [mm].

    Raises:
        DriverError: of the stage, which is told to stop on every path.
    """
    stage.zero()
    stage.start(way_mm * 1e-3, speed_mm_s * 1e-3)
    due = clock.now_s() + 3.0 * abs(way_mm) / speed_mm_s + 2.0
    try:
        while abs((here := stage.travel() * 1e3) - way_mm) > _ARRIVED:
            if clock.now_s() > due:
                raise StageStalledError(f"stage: expected {way_mm:g} mm, found {here:.2f} mm; look for a jam")
            clock.wait(clock.now_s() + _PERIOD)
    finally:
        stage.stop()
    return here


def home(stage: Stage) -> None:
    """Drive a stage to its switches, which moves it at once, unless it was driven there when it was opened.

    Raises:
        RefusedError: it has none, or did not find them.
    """
    if not isinstance(stage, GrblStage):
        raise DeviceRefusedError("stage: expected --kind grbl, whose switches are a zero, with --start home", 0)
    if not stage.is_homed:
        stage.home()
        stage.zero()


def work(options: argparse.Namespace) -> int:
    """Connect, say, jog."""
    if options.jog or options.start == StageStart.HOME:
        check_port_is_free_to_move(options.port)
    clock = WallClock()
    stage = make_stage(options.kind, options.port, start=StageStart(options.start), clock=clock)
    try:
        identity = stage.open()
        print(f"{identity.model} {identity.serial}".strip())
        for warning in identity.warnings:
            print(f"-> {warning}")
        if options.start == StageStart.HOME:
            home(stage)
            print("stands at its switches")
        if options.jog:
            print(f"went {jog(stage, options.jog, options.speed, clock):+.2f} mm; {_question(options.jog)}")
    finally:
        stage.close()
    return DONE


def _question(way_mm: float) -> str:
    return f"did it {'pull' if way_mm > 0.0 else 'let out'}? Where not, swap its direction"


def main(args: Sequence[str] | None = None) -> int:
    """Run the command."""
    arguments = parser("stage", TEXT)
    arguments.add_argument("--port", required=True, help="serial port of the stage")
    arguments.add_argument("--kind", choices=STAGES, default="grbl", help="default %(default)s")
    arguments.add_argument(
        "--start", choices=[one.value for one in StageStart], default=StageStart.REFUSE.value,
        help="home: drive to its switches, locked or not; refuse, unlock: what to do where it is locked; "
        "default %(default)s",
    )  # fmt: skip
    arguments.add_argument(
        "--jog", type=number(-50.0, 50.0), default=0.0, metavar="MM", help="go so far; positive must pull"
    )
    arguments.add_argument(
        "--speed", type=number(0.1, 20.0), default=2.0, metavar="MM/S", help="of the jog, default %(default)s"
    )
    return run(work, arguments, args)


if __name__ == "__main__":
    sys.exit(main())
