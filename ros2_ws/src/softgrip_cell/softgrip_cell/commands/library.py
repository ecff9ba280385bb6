# SPDX-License-Identifier: Apache-2.0
"""`ros2 run softgrip_cell library`: see and edit products and fingers in the database, beside a running cell."""

from __future__ import annotations

import argparse
import getpass
import sys
import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path

import yaml

from softgrip_cell.catalogue_file import catalogue_text, read_catalogue
from softgrip_cell.classify import classify, flexion_shares, read_demonstration
from softgrip_cell.errors import CellError
from softgrip_cell.finger_records import KIND, SCHEMA, FingerState, finger_record_document, read_finger_records
from softgrip_cell.outcomes import Tally, estimate
from softgrip_cell.products import Fragility, ProductShape
from softgrip_cell.storage import SHIPPED_URL, CellJournal, Database, Library
from softgrip_time.units import to_s

EPILOG = """examples:
  ros2 run softgrip_cell library export products.yaml     edit the file, then
  ros2 run softgrip_cell library import products.yaml     refused when somebody else changed an entry meanwhile
  ros2 run softgrip_cell library outcomes                 success per product and finger set, with 95 % intervals
  ros2 run softgrip_cell library finger PW-I-01 retired
  ros2 run softgrip_cell library classify rod 0.18 0.04 0.04 --demonstration hand.csv
"""


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; exit code 1 with a reason when it is refused."""
    options = _parser().parse_args(args)
    run: Callable[[argparse.Namespace], None] = options.run
    try:
        run(options)
    except CellError as error:
        print(f"[library] {error}", file=sys.stderr)
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="library",
        description="Products, finger sets and finger records of a cell.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--database-url", default=SHIPPED_URL, help="as the manager's parameter (default: %(default)s)")
    parser.add_argument("--who", default=getpass.getuser(), help="name for the audit (default: %(default)s)")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for name, run, text in (
        ("export", _export, "write products and finger sets to a YAML file"),
        ("import", _import, "take products and finger sets from a YAML file, all or nothing"),
        ("export-fingers", _export_fingers, "write the finger records to a YAML file"),
        ("import-fingers", _import_fingers, "take finger records from a YAML file, all or nothing"),
    ):
        command = commands.add_parser(name, help=text, description=text)
        command.add_argument("file", type=Path)
        command.set_defaults(run=run)
    for name, run, text in (
        ("outcomes", _outcomes, "expected success of every product with every finger set"),
        ("audit", _audit, "the latest changes: when, who, what"),
    ):
        commands.add_parser(name, help=text, description=text).set_defaults(run=run)
    finger = commands.add_parser("finger", help="say where a finger is or whether it may be used")
    finger.add_argument("serial")
    finger.add_argument("state", choices=[state.value for state in FingerState])
    finger.set_defaults(run=_finger)
    new = commands.add_parser("classify", help="how a new product is to be grasped, and why")
    new.add_argument("shape", choices=[shape.value for shape in ProductShape])
    new.add_argument("size_m", type=float, nargs=3, metavar="SIZE_M", help="length, width, height [m]")
    new.add_argument("--fragility", choices=[f.value for f in Fragility], default=Fragility.ROBUST.value)
    new.add_argument("--demonstration", type=Path, help="CSV, last three columns = joint angles base to tip [rad]")
    new.set_defaults(run=_classify)
    return parser


def _open(options: argparse.Namespace) -> tuple[Database, Library]:
    database = Database(options.database_url)
    return database, Library(database, time.time_ns)


def _export(options: argparse.Namespace) -> None:
    database, library = _open(options)
    with database:
        options.file.write_text(catalogue_text(library.catalogue()), encoding="utf-8")


def _import(options: argparse.Namespace) -> None:
    catalogue = read_catalogue(options.file)
    database, library = _open(options)
    with database:
        written = library.import_catalogue(catalogue, options.who)
    print(f"written: {', '.join(written) or 'nothing, all is as in the database'}")


def _export_fingers(options: argparse.Namespace) -> None:
    database, library = _open(options)
    with database:
        fingers = {
            serial: finger_record_document(finger_record) for serial, finger_record in library.finger_records().items()
        }
    document = {"schema": SCHEMA, "kind": KIND, "fingers": fingers}
    options.file.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")


def _import_fingers(options: argparse.Namespace) -> None:
    finger_records = read_finger_records(options.file)
    database, library = _open(options)
    with database:
        written = library.import_finger_records(finger_records.values(), options.who)
    print(f"written: {', '.join(written) or 'nothing, all is as in the database'}")


def _finger(options: argparse.Namespace) -> None:
    database, library = _open(options)
    with database:
        saved = library.set_finger_state(options.serial, FingerState(options.state), options.who)
    print(f"{saved.serial}: {saved.state.value}, version {saved.version}")


def _outcomes(options: argparse.Namespace) -> None:
    database, library = _open(options)
    with database:
        catalogue = library.catalogue()
        tallies = CellJournal(database, (), time.time_ns).tallies()
    print(f"{'product':<16}" + "".join(f"{name:<30}" for name in catalogue.finger_sets))
    for product in catalogue.products.values():
        cells = []
        for name in catalogue.finger_sets:
            known = estimate(product.marks.get(name), tallies.get((product.id, name), Tally()))
            cells.append(f"{known.mark.value:<8}{known.mean:.2f} [{known.low:.2f}, {known.high:.2f}] {known.grasps:<5}")
        print(f"{product.id:<16}" + "".join(f"{cell:<30}" for cell in cells).rstrip())


def _audit(options: argparse.Namespace) -> None:
    database, library = _open(options)
    with database:
        entries = library.audit()
    for entry in entries:
        when = datetime.fromtimestamp(to_s(entry.at_ns), tz=UTC).isoformat(timespec="seconds")
        print(f"{when} {entry.who}: {entry.action} {entry.subject} {entry.detail or ''}".rstrip())


def _classify(options: argparse.Namespace) -> None:
    shares = flexion_shares(read_demonstration(options.demonstration)) if options.demonstration else None
    length, width, height = options.size_m
    found = classify(ProductShape(options.shape), (length, width, height), Fragility(options.fragility), shares)
    print(f"{found.grasp.value} (confidence {found.confidence:.2f})")
    for reason in found.reasons:
        print(f"  {reason}")


if __name__ == "__main__":
    sys.exit(main())
