# SPDX-License-Identifier: Apache-2.0
"""Add bags to an archive: Parquet tables of every topic and of what happened, beside the untouched MCAP."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import track
from rich.table import Table

from softgrip_bag.errors import BagError
from softgrip_bag.extras import importing
from softgrip_bag.nodes.digest import digest

if TYPE_CHECKING:
    import pyarrow as pa

    from softgrip_bag.archive import Added


def main(args: Sequence[str] | None = None) -> int:
    """Entry point: 0, 1 when a bag was skipped, 2 when the archive cannot be written or an extra is missing."""
    parser = argparse.ArgumentParser(
        prog="ros2 run softgrip_bag archive",
        description=__doc__,
        epilog="A bag that is in the archive already is left alone, whatever its name. Ask with `ros2 run softgrip_bag "
        "query`. See docs/archive.md.",
    )
    parser.add_argument("bags", metavar="BAG", nargs="+", type=Path, help="a bag, or a folder with bags in it")
    parser.add_argument("--to", metavar="PLACE", required=True, help="folder, or s3://bucket/path (needs s3fs)")
    parser.add_argument("--tables-only", action="store_true", help="do not copy the bags' own files")
    parser.add_argument(
        "--option", metavar="NAME=VALUE", action="append", default=[], help="of the place, as fsspec has it"
    )
    options = parser.parse_args(args)
    try:
        with importing("archive"):
            from softgrip_bag.archive import Archive, place_options  # noqa: PLC0415  an extra
        archive = Archive(options.to, place_options(options.option))
        found = list(_bags(options.bags))
        steps = track(found, "archive", console=Console(stderr=True), disable=not sys.stderr.isatty())
        results = [archive.add(bag, _tables, with_mcap=not options.tables_only) for bag in steps]
    except BagError as error:
        print(error, file=sys.stderr)
        return 2
    except OSError as error:
        print(f"archive {options.to}: cannot be written: {error}", file=sys.stderr)
        return 2
    _print(results)
    return 1 if any(result.state == "skipped" for result in results) else 0


def _tables(bag: Path, bag_digest: str) -> Mapping[str, pa.Table]:
    from softgrip_bag.archive.tables import story_tables  # noqa: PLC0415  an extra

    return story_tables(bag, bag_digest, digest(bag))


def _bags(given: Iterable[Path]) -> Iterator[Path]:
    """Yield each bag; of a folder without .mcap files those in it."""
    for path in given:
        if path.is_dir() and not any(path.glob("*.mcap")):
            inside = sorted(one for one in path.iterdir() if one.is_dir() and any(one.glob("*.mcap")))
            if not inside:
                raise BagError(f"{path}: expected a bag or a folder with bags, found no .mcap file in it")
            yield from inside
        else:
            yield path


def _print(results: Sequence[Added]) -> None:
    table = Table("bag", "digest", "state", "rows")
    for one in results:
        cells: list[Any] = [one.bag.name, one.digest, one.state, str(one.rows) if one.rows else ""]
        table.add_row(*cells)
    Console().print(table)
    for one in results:
        if one.reason:
            print(f"{one.bag}: skipped: {one.reason}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
