# SPDX-License-Identifier: Apache-2.0
"""`ros2 run softgrip_description cell_file`: check a cell file, or turn it into what the launch takes."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import yaml

from softgrip_description.cell_file import (
    CellFile,
    device_arguments,
    launch_arguments,
    load_cell,
    node_parameters,
    read_shipped,
)
from softgrip_description.commands.launch_folder import make_launch_folder
from softgrip_description.errors import CellFileError
from softgrip_description.json_schema import schema_path

EPILOG = """examples:
  ros2 run softgrip_description cell_file check cell.yaml
  ros2 run softgrip_description cell_file schema > cell.schema.json      for the completion of an editor

`launch` is what cell.launch.yaml calls: it writes a folder and prints its name.
"""
#: what the launch includes, and the parameters of all nodes
ARGUMENTS, PARAMETERS = "cell_arguments.launch.yaml", "parameters.yaml"


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; exit code 1 with a reason when the file cannot be used."""
    options = _parser().parse_args(args)
    try:
        return int(options.work(options))
    except (CellFileError, OSError) as error:
        print(f"[cell_file] {error}", file=sys.stderr)
        return 1


def check(options: argparse.Namespace) -> int:
    """Print what the file describes, or what is wrong with it."""
    cell = load_cell(options.file)
    if options.known:
        node_parameters(cell, read_shipped(options.known))
    print(f"{options.file}: {summary(cell)}")
    return 0


def summary(cell: CellFile) -> str:
    """Return what a cell has, in one line."""
    tendons = ", ".join(servo.tendon for servo in cell.servos.chain) if cell.servos else "none"
    rig = f"{cell.rig.stage.kind} and {cell.rig.gauge.kind}" if cell.rig else "none"
    camera = cell.camera.source if cell.camera else "none"
    name = f" {cell.name!r}" if cell.name else ""
    return f"{cell.hardware} cell{name}: tendons {tendons}; rig {rig}; camera {camera}"


def write_launch_files(cell: CellFile, known: Path, folder: Path) -> None:
    """Write what cell.launch.yaml takes: its arguments, and the parameters of all nodes.

    Arguments are declared with the file's word as their default, so that one which is given wins.

    Raises:
        CellFileError: the cell file cannot be used.
    """
    nodes = node_parameters(cell, read_shipped(known))
    sections = {f"/**/{node}": {"ros__parameters": values} for node, values in nodes.items() if values}
    # ROS takes no empty parameter file
    text = yaml.safe_dump(sections or {"/**": {"ros__parameters": {"not_given_anything": True}}}, sort_keys=False)
    (folder / PARAMETERS).write_text(text, encoding="utf-8")
    actions = [
        *_declared(launch_arguments(cell)),
        {"let": {"name": "cell_parameters", "value": str(folder / PARAMETERS)}},
    ]
    if cell.hardware == "real":
        only_real = {"if": "$(equals $(var hardware) real)", "scoped": False}
        actions.append({"group": only_real | {"children": _declared(device_arguments(cell))}})
    (folder / ARGUMENTS).write_text(yaml.safe_dump({"launch": actions}, sort_keys=False), encoding="utf-8")


def _declared(arguments: Mapping[str, str]) -> list[dict[str, object]]:
    return [{"arg": {"name": name, "default": value}} for name, value in arguments.items()]


def launch(options: argparse.Namespace) -> int:
    """Write the files of the launch into a folder of their own and print it, without a line break as launch asks."""
    cell = load_cell(options.file)
    folder = make_launch_folder()
    write_launch_files(cell, options.known, folder)
    print(folder, end="")
    return 0


def schema(_: argparse.Namespace) -> int:
    """Print the schema."""
    print(schema_path("cell").read_text(encoding="utf-8"), end="")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="ros2 run softgrip_description cell_file",
        description="Check a cell file (docs/cell_file.md), or turn it into what the launch takes.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(required=True, metavar="check | launch | schema")
    for name, work in (("check", check), ("launch", launch)):
        command = commands.add_parser(name, help=(work.__doc__ or "").splitlines()[0])
        command.add_argument("file", type=Path)
        command.add_argument(
            "--known", type=Path, required=name == "launch", metavar="DIR", help="parameter files of all nodes"
        )
        command.set_defaults(work=work)
    commands.add_parser("schema", help="print the JSON schema").set_defaults(work=schema)
    return parser


if __name__ == "__main__":
    sys.exit(main())
