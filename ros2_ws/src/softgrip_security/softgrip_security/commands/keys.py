# SPDX-License-Identifier: Apache-2.0
"""Make, renew and check the keys of a cell: ``ros2 run softgrip_security keys FOLDER``.

Without an option it makes what is missing and replaces nothing.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from softgrip_security.errors import SecurityError
from softgrip_security.keystore import DAYS, Keystore, Report
from softgrip_security.policy import SHIPPED, read_policy


def main(argv: Sequence[str] | None = None) -> int:
    """Return 0, or 1 where something is wrong with the keystore."""
    arguments = _arguments(argv)
    try:
        policy = read_policy(arguments.policy, arguments.namespace)
        keystore = Keystore(arguments.folder, policy, arguments.hosts)
        if arguments.check:
            report = Report(warnings=tuple(keystore.warnings()))
        elif arguments.rotate or arguments.new_authority:
            report = keystore.rotate(arguments.days, authority=arguments.new_authority)
        else:
            report = keystore.make(arguments.days)
    except SecurityError as error:
        print(f"keys: {error}", file=sys.stderr)
        return 1
    if report.made:
        print(f"made keys and certificates of {', '.join(report.made)}")
    print(f"{len(report.written)} files written in {arguments.folder}")
    for warning in report.warnings:
        print(f"keys: {warning}", file=sys.stderr)
    return 1 if report.warnings else 0


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="the keystore")
    parser.add_argument(
        "--policy", type=Path, default=SHIPPED, help="who may do what; default: the shipped access.yaml"
    )
    parser.add_argument("--namespace", default="/", help="of the cell, default /")
    parser.add_argument(
        "--hosts",
        nargs="+",
        default=["localhost"],
        help="names and addresses of the cell's machines, the router's first",
    )
    parser.add_argument("--days", type=int, default=DAYS, help=f"how long a certificate is good, default {DAYS}")
    action = parser.add_mutually_exclusive_group()
    action.add_argument("--check", action="store_true", help="change nothing; report what is open or runs out")
    action.add_argument("--rotate", action="store_true", help="replace all keys and certificates")
    action.add_argument("--new-authority", action="store_true", help="replace the authority, too: a key was stolen")
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main())
