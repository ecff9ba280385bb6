# SPDX-License-Identifier: Apache-2.0
"""`ros2 run softgrip_bringup first_run`: a checklist from ports to a grasp of a test cube, ending in a signed page."""

from __future__ import annotations

import argparse
import getpass
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import rclpy
from rclpy.utilities import remove_ros_args

from softgrip_demo.errors import FirstRunError, ShiftError
from softgrip_demo.first_run.bus_steps import (
    BenchBus,
    IdsStep,
    LatencyStep,
    PortsStep,
    RateStep,
    SupplyStep,
    TensionStep,
    ZeroStep,
)
from softgrip_demo.first_run.camera_steps import BenchCamera, ExposureStep, FocusStep, MarkersStep, PlaneStep
from softgrip_demo.first_run.checklist import Checklist, CheckStep
from softgrip_demo.first_run.cube import add_test_cube
from softgrip_demo.first_run.record import FirstRunRecord, load_record, render, save_record
from softgrip_demo.nodes.bench_hands import BenchHands, EmulatorHands, PersonHands
from softgrip_demo.nodes.cell_session import CellSession
from softgrip_demo.nodes.cell_steps import ChecksStep, FrictionStep, GraspCubeStep, HomeStep
from softgrip_description.cell_file import CellCamera, CellFile, load_cell
from softgrip_description.errors import CellFileError
from softgrip_driver.commands.common import add_lockstep_option, clock_of
from softgrip_driver.commands.person import Terminal, TerminalPerson, WrittenAnswers, read_answers
from softgrip_driver.errors import DriverError, NoSetupError
from softgrip_driver.tendon.needs import SHIPPED_LOOP_RATE
from softgrip_driver.wizard.chain import chain_rate

TEXT = """Run a new cell from its ports to its first grasp, and write every figure beside its bound into one page.

ports, IDs, rate, latency, supply, zero, tension constants; the camera's exposure, focus, markers and plane; then the
cell is started: homing, nine friction points, the check of each finger, a grasp of a test cube. It stops at the first
step that is not good, says what to do, and goes on there when it is run again. A device that the cell file does not
name is left out. Nobody else may use the devices meanwhile.

    first_run --cell-file cell.yaml --out first_run

OUT/first_run.html is the page (print it from the browser), OUT/first_run.json the record, OUT/cell.log what the cell
said."""

RECORD, PAGE, LOG = "first_run.json", "first_run.html", "cell.log"
GOOD, BAD = 0, 1
#: [N] shipped tension_soft_n of the driver
TENSION_SOFT_N = 35.0


def bus_steps(bench: BenchBus) -> list[CheckStep]:
    """Return the steps on ports and bus, in order."""
    return [
        PortsStep(bench), IdsStep(bench), RateStep(bench), LatencyStep(bench), SupplyStep(bench), ZeroStep(bench),
        TensionStep(bench),
    ]  # fmt: skip


def camera_steps(bench: BenchCamera) -> list[CheckStep]:
    """Return the steps on the camera, in order."""
    return [ExposureStep(bench), FocusStep(bench), MarkersStep(bench), PlaneStep(bench)]


def cell_steps(session: CellSession, hands: BenchHands, cell: CellFile, finger_set: str) -> list[CheckStep]:
    """Return the steps on the running cell, in order."""
    slots = [servo.tendon for servo in cell.servos.chain] if cell.servos else []
    values = cell.parameters.get("tendon_driver", {})
    rate_hz = float(values.get("loop_rate", _rate_of(cell)))
    return [
        HomeStep(session, rate_hz),
        FrictionStep(session, hands),
        ChecksStep(session, hands, finger_set, slots),
        GraspCubeStep(session, hands, float(values.get("tension_soft_n", TENSION_SOFT_N))),
    ]


def _rate_of(cell: CellFile) -> float:
    """Return the rate [Hz] that the servos ask of the loop; the shipped one where nothing is known of them."""
    if cell.servos is None or not cell.servos.chain:
        return 0.0
    try:
        return chain_rate(cell.servos)
    except NoSetupError:
        return SHIPPED_LOOP_RATE


def work(options: argparse.Namespace, person: Terminal) -> int:
    """Run the checklist, sign, write the page.

    Raises:
        FirstRunError, CellFileError, DriverError, ShiftError: it cannot be begun.
    """
    cell = load_cell(options.cell_file)
    path = options.out / RECORD
    record = load_record(path, options.cell_file)
    out = cell.folders.out or options.out / "cell"
    session = CellSession(
        options.cell_file.resolve(), cell.name, [f"out:={out}", *options.launch_argument], options.out / LOG
    )
    session.before_start = lambda: add_test_cube(_database(cell, out), "first_run")
    slots = [servo.tendon for servo in cell.servos.chain] if cell.servos else []
    emulated = options.hands == "emulator"
    if emulated or cell.hardware == "emulated" or "hardware:=emulated" in options.launch_argument:
        record = record.on_emulated_bench()
    hands = (
        EmulatorHands(options.finger_set, slots, cell.name)
        if emulated
        else PersonHands(person, options.finger_set, slots)
    )
    clock = clock_of(options)
    camera = BenchCamera(
        cell.camera or CellCamera("none"), options.finger, options.finger_set, cell.folders.profiles, clock=clock
    )
    steps = [
        *bus_steps(BenchBus(cell, options.reply_margin, options.seconds, clock, person.print_line)),
        *camera_steps(camera),
        *cell_steps(session, hands, cell, options.finger_set),
    ]
    try:
        record = Checklist(steps, record, path, person.print_line).run(cell, options.again)
    finally:
        hands.close()
        session.close()
    if record.is_good and not record.name:
        record = sign(record, person.ask("name", "Everything is good. Who ran it", getpass.getuser()))
        save_record(record, path)
    (options.out / PAGE).write_text(render(record), encoding="utf-8")
    person.print_line(f"page: {options.out / PAGE}")
    return GOOD if record.is_good else BAD


def sign(record: FirstRunRecord, name: str) -> FirstRunRecord:
    """Return the record with a name and the time; its digest holds for both."""
    return replace(record, name=name, signed_at=datetime.now(tz=UTC).isoformat(timespec="seconds"))


def verify(path: Path, cell_file: Path, say: Callable[[str], object]) -> int:
    """Return whether a record is the one that its digest was made for, and of this cell file."""
    import json  # noqa: PLC0415  only this looks at the raw text

    record = load_record(path, cell_file)
    written = json.loads(path.read_text(encoding="utf-8"))["digest"] if path.exists() else ""
    if written and written == record.digest and record.name:
        say(f"{path}: holds, run by {record.name} {record.signed_at}".rstrip())
        return GOOD
    if written and written == record.digest:
        say(f"{path}: expected a name, found a record that nobody has signed; run first_run to its end")
        return BAD
    say(f"{path}: expected a record of this cell file with digest {record.digest}, found {written or 'none'}")
    return BAD


def _database(cell: CellFile, out: Path) -> str:
    given = cell.parameters.get("grasp_mix_manager", {}).get("database_url")
    return str(given or f"sqlite:///{out.resolve()}/cell.db")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="ros2 run softgrip_bringup first_run",
        description=TEXT,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--cell-file", type=Path, default=Path("cell.yaml"), help="default %(default)s")
    parser.add_argument("--out", type=Path, default=Path("first_run"), help="folder, default %(default)s")
    parser.add_argument("--again", nargs="+", default=[], metavar="STEP", help="steps to do again, such as focus")
    parser.add_argument("--finger-set", default="power", help="that is mounted, default %(default)s")
    parser.add_argument("--finger", default="index", help="in front of the camera, default %(default)s")
    parser.add_argument(
        "--hands", choices=("person", "emulator"), default="person", help="emulator: of an emulated cell"
    )
    parser.add_argument(
        "--reply-margin", type=float, default=0.02, metavar="S", help="of the bus, default %(default)s s"
    )
    parser.add_argument(
        "--seconds", type=float, default=3.0, metavar="S", help="of the self-test, default %(default)s s"
    )
    parser.add_argument(
        "--launch-argument", nargs="+", default=[], metavar="NAME:=VALUE", help="of the launch, besides"
    )
    add_lockstep_option(parser)
    parser.add_argument("--answers", type=Path, metavar="FILE", help="YAML, key: answer; for runs without a person")
    parser.add_argument("--yes", action="store_true", help="take all defaults and wait for nobody")
    parser.add_argument("--verify", action="store_true", help="only say whether the record is as it was signed")
    return parser


def _person(options: argparse.Namespace) -> Terminal:
    if options.answers is not None:
        return WrittenAnswers(read_answers(options.answers), takes_defaults=options.yes)
    return WrittenAnswers({}, takes_defaults=True) if options.yes else TerminalPerson()


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; exit code 0 when every step is good or left out."""
    options = _parser().parse_args(remove_ros_args(sys.argv if args is None else ["first_run", *args])[1:])
    try:
        person = _person(options)
        if options.verify:
            return verify(options.out / RECORD, options.cell_file, person.print_line)
        rclpy.init(args=list(args) if args is not None else None)
        return work(options, person)
    except (FirstRunError, CellFileError, DriverError, ShiftError, OSError) as error:
        print(f"[first_run] {error}", file=sys.stderr)  # noqa: T201  its output
        return BAD
    except KeyboardInterrupt:
        return 130
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
