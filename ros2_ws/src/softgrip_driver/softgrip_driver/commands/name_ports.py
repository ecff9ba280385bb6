# SPDX-License-Identifier: Apache-2.0
"""`ros2 run softgrip_driver name_ports`: udev rules that give serial ports names that stay."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from softgrip_driver.commands.common import DONE, parser, run
from softgrip_driver.errors import ConfigurationError
from softgrip_driver.port_names import FOLDER, naming_rules

FILE = "61-softgrip-names.rules"
TEXT = f"""Write udev rules that make /dev/{FOLDER}/NAME of adapters that are plugged in now, known by serial number.

    name_ports servos=/dev/ttyUSB0 stand=/dev/ttyUSB1 gauge=/dev/ttyACM0

friction_rig looks for its stage at /dev/{FOLDER}/stand and for its gauge at /dev/{FOLDER}/gauge unless it is told
otherwise. `make udev` installs the file; `ls -l /dev/{FOLDER}` shows the names."""


def _pair(text: str) -> tuple[str, str]:
    name, equals, port = text.partition("=")
    if not (name and equals and port):
        raise argparse.ArgumentTypeError(f"expected NAME=PORT, such as stand=/dev/ttyUSB1, found {text!r}")
    return name, port


def work(options: argparse.Namespace) -> int:
    """Write the rules.

    Raises:
        ConfigurationError: a name or a port that cannot be used.
    """
    rules = naming_rules(dict(options.ports))
    try:
        options.out.write_text(rules, encoding="utf-8")
    except OSError as error:
        raise ConfigurationError(f"{options.out}: expected a file that can be written, found: {error}") from error
    sys.stdout.write(
        f"{rules}written to {options.out}; install it with `make udev` in the project's folder, or\n"
        f"  sudo install -m 644 {options.out} /etc/udev/rules.d/\n"
        "  sudo udevadm control --reload && sudo udevadm trigger\n"
    )
    return DONE


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; exit code 0 when the file was written."""
    arguments = parser("name_ports", TEXT)
    arguments.add_argument("ports", nargs="+", type=_pair, metavar="NAME=PORT", help="a name and its port")
    arguments.add_argument("--out", type=Path, default=Path(FILE), metavar="FILE", help="default %(default)s")
    return run(work, arguments, args)


if __name__ == "__main__":
    sys.exit(main())
