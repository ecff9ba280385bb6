# SPDX-License-Identifier: Apache-2.0
"""``ros2 run``."""

from __future__ import annotations

import argparse
import os
import shlex
import subprocess
import sys

from embedded_ros import workspace


def run(argv: list[str]) -> int:
    """Run an executable of a package in place of this process."""
    parser = argparse.ArgumentParser(prog="ros2 run", description="Run an executable of a package.")
    parser.add_argument("--prefix", help="command to put before the executable, such as 'gdb -ex run --args'")
    parser.add_argument("package_name", help="name of the package")
    parser.add_argument("executable_name", help="name of the executable (ros2 pkg executables PACKAGE lists them)")
    parser.add_argument(
        "argv", nargs=argparse.REMAINDER, help="arguments for the executable, such as --ros-args -p key:=value"
    )
    arguments = parser.parse_args(argv)
    command = workspace.executable(arguments.package_name, arguments.executable_name)
    command = [*shlex.split(arguments.prefix or ""), *command, *arguments.argv]
    if os.name == "posix":
        sys.stdout.flush()
        os.execvp(command[0], command)  # noqa: S606  signals and exit code are then the executable's own
    return subprocess.run(command, check=False).returncode
