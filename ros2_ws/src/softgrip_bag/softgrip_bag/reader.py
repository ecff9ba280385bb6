# SPDX-License-Identifier: Apache-2.0
"""Read a bag: raw CDR messages in the order they were received, with their types."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

import yaml
from mcap.exceptions import McapError
from mcap.reader import make_reader

from softgrip_bag.errors import BagError


@dataclass(frozen=True)
class RawMessage:
    """One recorded message: times in ns since the epoch, ``data`` CDR with its header."""

    topic: str
    type_name: str
    received: int
    published: int
    data: bytes


def bag_files(bag: Path) -> list[Path]:
    """Return the MCAP files of a bag: a folder, or a single file.

    Raises:
        BagError: when there is none.
    """
    files = sorted(bag.glob("*.mcap")) if bag.is_dir() else [bag]
    if not files or not all(file.is_file() for file in files):
        raise BagError(f"expected a bag (a folder with .mcap files, or one such file), found none at {bag}")
    return files


def read(bag: Path, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
    """Yield the messages of a bag in order of reception.

    Args:
        bag: folder or .mcap file.
        topics: only these; None = all.

    Raises:
        BagError: when a file is not MCAP.
    """
    for path in bag_files(bag):
        with path.open("rb") as stream:
            try:
                for schema, channel, message in make_reader(stream).iter_messages(
                    topics=None if topics is None else list(topics), log_time_order=True
                ):
                    type_name = schema.name if schema else ""
                    yield RawMessage(channel.topic, type_name, message.log_time, message.publish_time, message.data)
            except McapError as error:
                raise BagError(f"{path}: expected MCAP, found {error}") from error


def topic_types(bag: Path) -> dict[str, str]:
    """Return topic -> type of everything in a bag."""
    found: dict[str, str] = {}
    for path in bag_files(bag):
        with path.open("rb") as stream:
            try:
                summary = make_reader(stream).get_summary()
            except McapError as error:
                raise BagError(f"{path}: expected MCAP, found {error}") from error
            if summary is not None:
                found |= {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()}
    return found


def latched_topics(bag: Path) -> set[str]:
    """Return the topics whose every publisher offered transient-local durability."""
    found = set()
    for path in bag_files(bag):
        with path.open("rb") as stream:
            summary = make_reader(stream).get_summary()
            for channel in summary.channels.values() if summary is not None else ():
                offered = yaml.safe_load(channel.metadata.get("offered_qos_profiles", "")) or []
                # words since metadata version 9, numbers before (rmw: 1 = transient local)
                if offered and all(qos.get("durability") in {"transient_local", 1} for qos in offered):
                    found.add(channel.topic)
    return found
