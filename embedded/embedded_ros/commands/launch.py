# SPDX-License-Identifier: Apache-2.0
"""``ros2 launch``."""

from __future__ import annotations

import argparse
import os
import shlex
import time
from pathlib import Path

from embedded_ros import workspace
from embedded_ros.errors import LaunchError
from embedded_ros.launch_description import Argument
from embedded_ros.launch_file import LaunchReader
from embedded_ros.launch_run import LaunchRunner


def run(argv: list[str]) -> int:
    """Run a launch file, or show or print what it says."""
    parser = argparse.ArgumentParser(prog="ros2 launch", description="Run a YAML launch file.")
    parser.add_argument("-p", "--print", "--print-description", dest="show", action="store_true",
                        help="print the processes it would start")  # fmt: skip
    parser.add_argument("-s", "--show-args", "--show-arguments", dest="show_arguments", action="store_true",
                        help="show the arguments the launch file takes")  # fmt: skip
    parser.add_argument("-d", "--debug", action="store_true", help="print the command line of each process")
    parser.add_argument("package_name", help="name of the package, or path of a launch file")
    parser.add_argument("launch_file_name", nargs="?", help="name of the launch file in the package")
    parser.add_argument("launch_arguments", nargs="*", help="arguments of the launch file as name:=value")
    arguments = parser.parse_intermixed_args(argv)
    path, rest = _find(arguments.package_name, arguments.launch_file_name, arguments.launch_arguments)
    given = dict(_pair(item) for item in rest)
    reader = LaunchReader(given)
    try:
        description = reader.read(path)
    except LaunchError:
        if not arguments.show_arguments:
            raise
        description = reader.description
    if arguments.show_arguments:
        print(_describe(description.arguments))
        return 0
    if arguments.show or arguments.debug:
        for process in description.processes:
            print(f"{process.label}: {shlex.join(process.command)}")
        if arguments.show:
            return 0
    log_folder = _log_folder()
    print(f"[INFO] [launch]: All log files can be found below {log_folder}", flush=True)
    return LaunchRunner(description.processes, log_folder).run()


def _find(package_or_path: str, name: str | None, rest: list[str]) -> tuple[Path, list[str]]:
    path = Path(package_or_path)
    if path.is_file():
        return path.resolve(), [*([name] if name is not None else []), *rest]
    folder = workspace.package(package_or_path).folder
    if name is None:
        found = ", ".join(sorted(item.name for item in folder.rglob("*.launch.yaml"))) or "none"
        raise LaunchError(f"expected a launch file of '{package_or_path}' after its name; it has: {found}")
    matches = sorted(item for item in folder.rglob(name) if item.is_file())
    if not matches:
        found = ", ".join(sorted(item.name for item in folder.rglob("*.launch.*"))) or "none"
        raise LaunchError(f"file '{name}' was not found in package '{package_or_path}'; its launch files are: {found}")
    return matches[0].resolve(), rest


def _pair(item: str) -> tuple[str, str]:
    name, separator, value = item.partition(":=")
    if not separator or not name:
        raise LaunchError(f"malformed launch argument '{item}', expected format '<name>:=<value>'")
    return name, value


def _describe(arguments: list[Argument]) -> str:
    if not arguments:
        return "No arguments."
    lines = ["Arguments (pass arguments as '<name>:=<value>'):"]
    for argument in arguments:
        description = argument.description or "no description given"
        if argument.choices:
            description += f"{'' if description.endswith('.') else '.'} Valid choices are: {list(argument.choices)}"
        lines += ["", f"    '{argument.name}':", f"        {description}"]
        if argument.default is not None:
            lines.append(f"        (default: {argument.default!r})")
    return "\n".join(lines)


def _log_folder() -> Path:
    given = os.environ.get("ROS_LOG_DIR")
    home = os.environ.get("ROS_HOME")
    base = Path(given) if given else (Path(home) if home else Path.home() / ".ros") / "log"
    return base / f"{time.strftime('%Y-%m-%d-%H-%M-%S')}-{os.getpid()}"
