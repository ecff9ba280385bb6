# SPDX-License-Identifier: Apache-2.0
"""Ask an archive in SQL, or by the name of a shipped question; print a table, CSV or JSON, or draw a plot."""

from __future__ import annotations

import argparse
import csv
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from softgrip_bag.errors import BagError
from softgrip_bag.extras import importing

_DIGITS = 4


def main(args: Sequence[str] | None = None) -> int:
    """Entry point: 0, or 2 when there is no archive, no such question or no DuckDB."""
    parser = argparse.ArgumentParser(
        prog="ros2 run softgrip_bag query",
        description=__doc__,
        epilog="`query --list` shows the shipped questions, `query 'SHOW TABLES' --in PLACE` what can be asked. "
        "SQL is DuckDB's. See docs/archive.md.",
    )
    parser.add_argument("question", nargs="?", help="SQL, or the name of a shipped question")
    parser.add_argument("--in", dest="place", metavar="PLACE", help="the archive: folder or s3://bucket/path")
    parser.add_argument(
        "--option", metavar="NAME=VALUE", action="append", default=[], help="of the place, as fsspec has it"
    )
    parser.add_argument("--list", action="store_true", help="show the shipped questions")
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--csv", action="store_true", help="print CSV")
    form.add_argument("--json", action="store_true", help="print one JSON object a row")
    form.add_argument("--plot", type=Path, metavar="FILE", help="draw numbers over the first column (.svg, .png, .pdf)")
    options = parser.parse_args(args)
    if not options.list and (options.question is None or options.place is None):
        parser.error("expected a question and --in PLACE")
    try:
        with importing("query"):
            from softgrip_bag.archive import Archive, ask, place_options, shipped_queries  # noqa: PLC0415  an extra
        if options.list:
            return _list(shipped_queries())
        _show(options, *ask(Archive(options.place, place_options(options.option)), options.question))
    except BagError as error:
        print(error, file=sys.stderr)
    except OSError as error:
        print(f"{options.plot or options.place}: {error}", file=sys.stderr)
    else:
        return 0
    return 2


def _list(questions: Mapping[str, str]) -> int:
    table = Table("question", "answers")
    for name, text in questions.items():
        table.add_row(name, escape(text.splitlines()[0].removeprefix("--").strip()))
    Console().print(table)
    return 0


def _show(options: argparse.Namespace, names: list[str], rows: list[tuple[object, ...]]) -> None:
    if options.csv:
        writer = csv.writer(sys.stdout)
        writer.writerow(names)
        writer.writerows(rows)
    elif options.json:
        for row in rows:
            print(json.dumps(dict(zip(names, row, strict=True)), default=str))
    elif options.plot:
        _plot(options.plot, names, rows)
        print(options.plot)
    else:
        table = Table(*map(escape, names))
        for row in rows:
            table.add_row(*(_text(value) for value in row))
        Console().print(table)


def _text(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.{_DIGITS}g}" if isinstance(value, float) else escape(str(value))


def _plot(path: Path, names: list[str], rows: list[tuple[Any, ...]]) -> None:
    """Draw every column of numbers over the first column.

    Raises:
        BagError: there is no row, or no column of numbers.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415  half a second that a table need not wait for

    numbers = [
        i
        for i in range(1, len(names))
        if rows and all(isinstance(row[i], int | float) or row[i] is None for row in rows)
    ]
    if not numbers:
        raise BagError(f"plot: expected rows with numbers behind the first column, found {len(rows)} rows of {names}")
    figure = Figure(figsize=(8.0, 4.5), layout="constrained")
    axes = figure.subplots()
    first = [row[0] if not isinstance(row[0], str) else row[0][:24] for row in rows]
    for i in numbers:
        axes.plot(first, [row[i] for row in rows], "o-", label=names[i])
    axes.set_xlabel(names[0])
    axes.tick_params("x", rotation=30)
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(path)


if __name__ == "__main__":
    sys.exit(main())
