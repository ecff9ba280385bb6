# SPDX-License-Identifier: Apache-2.0
"""Write each topic of a bag as a table (a row a message), its episodes as a LeRobotDataset, or a Rerun recording."""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Sequence
from pathlib import Path

from rclpy.serialization import deserialize_message
from rich.console import Console
from rich.progress import track

from softgrip_bag.errors import BagError
from softgrip_bag.extras import importing
from softgrip_bag.nodes.messages import flat, message_class, tree
from softgrip_bag.nodes.recorded_bag import RecordedBag

Row = dict[str, object]


def main(args: Sequence[str] | None = None) -> int:
    """Entry point: 0, or 2 when the bag cannot be read or the tables not written."""
    parser = argparse.ArgumentParser(
        prog="ros2 run softgrip_bag export",
        description=__doc__,
        epilog="Columns of tables are named as in `ros2 topic echo --csv`'s order: path.to.field, lists by index. "
        "Arrays of over 64 numbers (images, meshes) give their length only.",
    )
    parser.add_argument("bags", metavar="BAG", nargs="+", type=Path, help="folder of a bag, or one .mcap file")
    form = parser.add_mutually_exclusive_group(required=True)
    form.add_argument("--csv", action="store_true", help="one .csv per topic")
    form.add_argument("--parquet", action="store_true", help="one .parquet per topic")
    form.add_argument(
        "--lerobot",
        type=Path,
        metavar="OUT",
        help="grasps and teleoperated demonstrations as a LeRobotDataset v3.0 (docs/archive.md)",
    )
    form.add_argument(
        "--rerun",
        type=Path,
        metavar="OUT.rrd",
        help="a Rerun recording with a layout: camera, fingers, tendons, verdicts; needs `make rerun-setup`",
    )
    parser.add_argument("--fps", type=int, default=20, help="frames a second of --lerobot")
    parser.add_argument("--topics", nargs="+", help="only these")
    parser.add_argument("-o", "--output", type=Path, help="folder; default: BAG-tables beside the bag")
    options = parser.parse_args(args)
    if options.fps < 1:
        parser.error(f"expected at least one frame a second, found {options.fps}")
    if options.output and len(options.bags) > 1:
        parser.error("expected one bag with --output")
    if options.rerun and len(options.bags) > 1:
        parser.error("expected one bag with --rerun")
    try:
        if options.rerun:
            _write_scene(options.bags[0], options.rerun)
        elif options.lerobot:
            _write_dataset(options.bags, options.lerobot, options.fps)
        else:
            for path in options.bags:
                _write_tables(path, options)
    except BagError as error:
        print(error, file=sys.stderr)
        return 2
    except OSError as error:
        place = error.filename or options.lerobot or options.rerun or options.output
        print(f"{place}: cannot be written: {error.strerror}", file=sys.stderr)
        return 2
    return 0


def _write_dataset(bags: Sequence[Path], folder: Path, rate_hz: int) -> None:
    """Write the episodes of bags as one dataset; a bag without one is named and left out."""
    with importing("LeRobot's format"):
        from softgrip_bag.lerobot import write_lerobot  # noqa: PLC0415  an extra
    from softgrip_bag.nodes.recorded_episodes import recorded_episodes  # noqa: PLC0415  a second that tables need not wait for

    episodes = []
    for bag in track(bags, "reading", console=Console(stderr=True), disable=not sys.stderr.isatty()):
        found = recorded_episodes(bag, rate_hz)
        if not found:
            print(f"{bag}: no grasp and no demonstration in it", file=sys.stderr)
        episodes += found
    write_lerobot(folder, episodes, rate_hz)
    print(f"{folder}: {len(episodes)} episodes, {sum(one.is_success for one in episodes)} of them a success")


def _write_scene(bag: Path, path: Path) -> None:
    """Write what a bag shows as a Rerun recording."""
    from softgrip_bag.nodes.recorded_scene import recorded_scene  # noqa: PLC0415  tables need not wait for it
    from softgrip_bag.rerun_file import write_rerun  # noqa: PLC0415  as above

    with Console(stderr=True).status(f"reading {bag}"):
        scene = recorded_scene(bag)
        write_rerun(path, scene)
    poses = sum(map(len, scene.poses.values()))
    print(f"{path}: {len(scene.images)} images, {poses} finger poses, {len(scene.events)} events; open it with `rerun`")


def _write_tables(path: Path, options: argparse.Namespace) -> None:
    folder = options.output or path.with_name(f"{path.stem}-tables")
    bag = RecordedBag(path)
    for topic in bag.topics:
        if topic.messages and (options.topics is None or topic.name in options.topics):
            bag.check_definition(topic)
            print(write(bag, topic.name, folder, parquet=options.parquet))


def rows(bag: RecordedBag, topic: str) -> list[Row]:
    """Return the messages of a topic as flat rows; times in ns since the epoch.

    Raises:
        BagError: when the type is not installed or a message is no such type.
    """
    found = []
    for raw in bag.read({topic}):
        try:
            message = deserialize_message(raw.data, message_class(raw.type_name))
        except Exception as error:
            raise BagError(f"{topic}: expected a {raw.type_name}, found bytes that are none: {error}") from error
        found.append({"received_ns": raw.received, "published_ns": raw.published} | dict(flat(tree(message))))
    return found


def write(bag: RecordedBag, topic: str, folder: Path, *, parquet: bool) -> Path:
    """Write the table of one topic; returns its file."""
    table = rows(bag, topic)
    columns = list(dict.fromkeys(name for row in table for name in row))
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{topic.strip('/').replace('/', '.')}.{'parquet' if parquet else 'csv'}"
    if parquet:
        with importing("Parquet"):
            import pyarrow as pa  # noqa: PLC0415  an extra
            from pyarrow import parquet as files  # noqa: PLC0415  as above

        files.write_table(pa.table({name: [row.get(name) for row in table] for name in columns}), path)
    else:
        with path.open("w", newline="") as stream:
            writer = csv.DictWriter(stream, columns)
            writer.writeheader()
            writer.writerows(table)
    return path


if __name__ == "__main__":
    sys.exit(main())
