# SPDX-License-Identifier: Apache-2.0
"""`ros2 run softgrip_driver wizard`: from servos as they come to the cell file of a whole cell."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from softgrip_description.errors import CellFileError
from softgrip_driver.commands.common import (
    BAUDS,
    DONE,
    FAILED,
    add_drive_option,
    add_lockstep_option,
    clock_of,
    number,
    parser,
    run,
)
from softgrip_driver.commands.person import GivenAnswers, Terminal, TerminalPerson, WrittenAnswers, read_answers
from softgrip_driver.errors import ConfigurationError
from softgrip_driver.rig.build import GAUGES, STAGES
from softgrip_driver.usb_adapter import stable_names
from softgrip_driver.wizard.direction import SpoolPull
from softgrip_driver.wizard.tensioning import TensioningPlan
from softgrip_driver.wizard.wizard import SetupWizard, WizardSettings

TEXT = """Lead from servos as they come to a chain that is ready, and write it into a cell file.

Servos are Dynamixel (ID 1, 57600 baud), or Feetech with --drive feetech (ID 1, 1 Mbaud).

1. each servo gets its ID: put them on the cable one after the other, as you are asked to
2. the direction of each spool, by a small pull (about 2 N, 20 mm at most)
3. tensioning: wind, hold, release until the zero stays; ends with a stated slack
4. self-test
5. the rest of the cell: its name, hand, folders, camera and friction rig; devices are found by names that stay, and
   what is not there is left out

It can be left at any time (Ctrl-C lets go of everything) and goes on where it was: what the cell file has is done.
To do a step again take its value out of the file: the servo, its direction, its slack_m, a section.
An option answers its question before it is asked; what is asked besides is asked here.

    wizard --port /dev/serial/by-id/usb-FTDI_... --tendons index middle thumb --file cell.yaml"""


#: key of a question -> (what an option gives, its help)
SECTION_OPTIONS = {
    "cell": ("NAME", "of the cell, or none"),
    "hand": ("FILE", "hand file, or shipped"),
    "out": ("FOLDER", "for bags, database and friction models"),
    "profiles": ("FOLDER", "of finger profiles, or shipped"),
    "camera": ("SOURCE", "device, file or address, or none"),
    "camera.calibration": ("FILE", "of calibrate_camera, or none"),
    "stage": ("PORT", "of the rig's stage, or none"),
    "stage.kind": ("KIND", ", ".join(STAGES)),
    "gauge": ("PORT", "of the rig's force gauge, or none"),
    "gauge.kind": ("KIND", ", ".join(GAUGES)),
    "gauge.line": ("FORMAT", "of a gauge that speaks in lines"),
    "gauge.calibration": ("FILE", "of calibrate_cell, or none"),
}


def work(options: argparse.Namespace) -> int:
    """Lead."""
    person = GivenAnswers(_given(options), _person(options))
    settings = WizardSettings(
        options.file,
        _stable(options.port, person),
        options.drive or "",
        options.baud,
        tuple(options.tendons),
        options.spool_radius_mm * 1e-3,
        options.slack_mm * 1e-3,
        SpoolPull(reach_m=options.reach_mm * 1e-3),
        TensioningPlan(tension_n=options.tension),
        options.reply_margin,
        options.seconds,
        options.rate,
        clock_of(options),
    )
    try:
        is_good = SetupWizard(settings, person).run()
    except CellFileError as error:
        raise ConfigurationError(str(error)) from error
    person.print_line(
        f"written to {options.file}; start: ros2 launch softgrip_bringup cell.launch.yaml cell_file:={options.file}"
    )
    return DONE if is_good else FAILED


def _person(options: argparse.Namespace) -> Terminal:
    if options.answers is not None:
        return WrittenAnswers(read_answers(options.answers), takes_defaults=options.yes)
    return WrittenAnswers({}, takes_defaults=True) if options.yes else TerminalPerson()


def _given(options: argparse.Namespace) -> dict[str, str]:
    """Return what the options answer, by the keys of the questions."""
    answers = {key: getattr(options, key.replace(".", "_")) for key in SECTION_OPTIONS}
    return {key: answer for key, answer in answers.items() if answer is not None}


def _stable(port: str, person: Terminal) -> str:
    """Return the name of a port that stays, where it has one; ask where none was given and several are there."""
    names = dict(stable_names())
    if not port and len(names) == 1:
        port = str(*names)
    for name, device in names.items():
        if str(device) == port:
            person.print_line(f"{port} is {name}; that name stays")
            return str(name)
    return port


def main(args: Sequence[str] | None = None) -> int:
    """Run the command."""
    arguments = parser("wizard", TEXT)
    arguments.add_argument("--file", type=Path, default=Path("cell.yaml"), help="cell file, default %(default)s")
    arguments.add_argument(
        "--port", default="", help="of the servo bus; default: that of the file, or the only one there is"
    )
    add_drive_option(arguments)
    arguments.add_argument(
        "--tendons", nargs="+", default=[], metavar="NAME", help="one for each servo, in order of the chain"
    )
    arguments.add_argument("--baud", type=int, choices=sorted(BAUDS), default=1_000_000, help="default %(default)s")
    arguments.add_argument(
        "--spool-radius-mm", type=number(1.0, 100.0), default=10.0, metavar="MM", help="to the middle of the tendon"
    )
    arguments.add_argument("--slack-mm", type=number(0.0, 50.0), default=5.0, metavar="MM", help="left at the end")
    arguments.add_argument("--reach-mm", type=number(2.0, 100.0), default=20.0, metavar="MM", help="of a small pull")
    arguments.add_argument("--tension", type=number(2.0, 35.0), default=5.0, metavar="N", help="of the tensioning")
    arguments.add_argument(
        "--reply-margin", type=number(5e-4, 1.0), default=0.02, metavar="S", help="default %(default)s s"
    )
    arguments.add_argument("--seconds", type=number(0.1, 60.0), default=3.0, metavar="S", help="of the self-test")
    arguments.add_argument(
        "--rate", type=number(1.0, 1000.0), default=100.0, metavar="HZ", help="that the bus must reach"
    )
    sections = arguments.add_argument_group("the rest of the cell", "what is not given is asked for")
    for key, (value, text) in SECTION_OPTIONS.items():
        sections.add_argument("--" + key.replace(".", "-"), metavar=value, help=text)
    add_lockstep_option(arguments)
    arguments.add_argument("--answers", type=Path, metavar="FILE", help="YAML, key: answer; for runs without a person")
    arguments.add_argument("--yes", action="store_true", help="take all defaults and wait for nobody")
    return run(work, arguments, args)


if __name__ == "__main__":
    sys.exit(main())
