# SPDX-License-Identifier: Apache-2.0
"""``ros2 bag``: softgrip_bag's executables under the names ROS 2 users type."""

from __future__ import annotations

import argparse
import os
import subprocess

from embedded_ros import workspace

_PACKAGE = "softgrip_bag"
_VERBS = {"record": "record messages into an MCAP bag", "info": "print what a bag holds", "play": "play a bag"}


def run(argv: list[str]) -> int | str | None:
    """Run a verb."""
    parser = argparse.ArgumentParser(prog="ros2 bag", description="Record, inspect and play bags (by softgrip_bag).")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="verb")
    for name, text in _VERBS.items():
        verb = verbs.add_parser(name, help=text, add_help=False)
        verb.add_argument("rest", nargs=argparse.REMAINDER)
    chosen = parser.parse_args(argv[:1]).verb
    command = [*workspace.executable(_PACKAGE, chosen), *argv[1:]]
    if os.name == "posix":
        os.execvp(command[0], command)  # noqa: S606  signals and exit code are then the executable's own
    return subprocess.run(command, check=False).returncode
