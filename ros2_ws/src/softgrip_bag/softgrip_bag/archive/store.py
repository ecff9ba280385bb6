# SPDX-License-Identifier: Apache-2.0
"""The archive's files: what is where, how a bag gets in, and what is in it.

    manifest/<digest>.json                                    one bag; it is in the archive when this file is there
    tables/<table>/cell=<cell>/date=<day>/<digest>.parquet    what happened: grasps, closings, friction, alarms, ...
    topics/cell=<cell>/date=<day>/topic=<topic>/<digest>.parquet
    mcap/cell=<cell>/date=<day>/<bag>-<digest>/...            the bag itself, not one byte changed

All names follow from the bag's content, and the manifest comes last: adding a bag again changes nothing, a crash
leaves nothing that counts, and two machines may add to one archive at a time.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import fsspec
import pyarrow as pa
from pyarrow import parquet

from softgrip_bag.archive.columns import message_row, message_schema
from softgrip_bag.cell_namespace import cell_namespace
from softgrip_bag.definition import decode, parse_definitions
from softgrip_bag.errors import BagError
from softgrip_bag.reader import TopicSummary, bag_digest, read, topic_summaries
from softgrip_bag.repair import is_being_written, is_broken
from softgrip_time.units import to_s

SCHEMA = 1
#: Messages in memory at a time, and rows of a Parquet row group.
ROWS = 20_000
#: The cell whose nodes have no namespace.
ROOT_CELL = "root"
_BLOCK = 1 << 20


@dataclass(frozen=True)
class Added:
    """What became of a bag.

    Attributes:
        bag: as it was given.
        digest: first digits of the SHA-256 of its files; empty where it could not be read.
        state: "added", "present" (it was in the archive already) or "skipped".
        reason: why it was skipped.
        rows: written, over all topics and tables.
    """

    bag: Path
    digest: str
    state: str
    reason: str = ""
    rows: int = 0


#: Makes the tables of what happened in a bag, name -> table, given the first column of each: the bag's digest.
MakeTables = Callable[[Path, str], Mapping[str, pa.Table]]


class Archive:
    """A folder, or whatever else fsspec has a name for, that holds bags as tables.

    Args:
        place: folder, or URL: "s3://bucket/path".
        options: for fsspec: keys, endpoint_url.

    Raises:
        BagError: there is no such kind of place, or its library is not installed.
    """

    def __init__(self, place: str, options: Mapping[str, object] | None = None) -> None:
        self.place = place
        try:
            self.files, self.root = fsspec.core.url_to_fs(place, **(options or {}))
        except (ValueError, ImportError) as error:
            raise BagError(
                f"archive {place}: expected a folder or a URL that fsspec knows, found: {error}; s3://... needs s3fs"
            ) from error

    def add(self, bag: Path, make_tables: MakeTables, *, with_mcap: bool = True) -> Added:
        """Add a bag; one that is there already, is broken or is being recorded stays out, and says so.

        Args:
            bag: folder or .mcap file.
            make_tables: of what happened in it.
            with_mcap: copy the bag's own files as well.

        Raises:
            OSError: the archive cannot be written.
        """
        try:
            if is_being_written(bag):
                return Added(bag, "", "skipped", "a recorder still writes it; stop it first")
            if is_broken(bag):
                return Added(bag, "", "skipped", "it has no end; `ros2 run softgrip_bag repair` gives it one")
            digest = bag_digest(bag)
            if self.files.exists(self._manifest(digest)):
                return Added(bag, digest, "present")
            manifest = self._write_bag(bag, digest, make_tables, with_mcap=with_mcap)
        except BagError as error:
            return Added(bag, "", "skipped", str(error))
        self._write(self._manifest(digest), json.dumps(manifest, indent=1).encode())
        return Added(bag, digest, "added", rows=sum(file["rows"] for file in manifest["files"]))

    def manifests(self) -> list[dict[str, Any]]:
        """Return what is known of every bag, in order of their beginning.

        Raises:
            BagError: a manifest is none.
        """
        found = []
        for path in self.files.glob(f"{self.root}/manifest/*.json"):
            try:
                found.append(json.loads(self.files.cat_file(path)))
            except ValueError as error:
                raise BagError(f"{path}: expected a manifest of softgrip_bag archive, found: {error}") from error
        return sorted(found, key=lambda one: (one["start_ns"], one["digest"]))

    def url(self, path: str) -> str:
        """Return the address of a file of a manifest, as DuckDB and fsspec take it."""
        return str(self.files.unstrip_protocol(f"{self.root}/{path}"))

    def _manifest(self, digest: str) -> str:
        return f"{self.root}/manifest/{digest}.json"

    def _write_bag(self, bag: Path, digest: str, make_tables: MakeTables, *, with_mcap: bool) -> dict[str, Any]:
        topics = [topic for topic in topic_summaries(bag) if topic.messages]
        cell = cell_namespace(topic.name for topic in topics)
        start_ns = min((message.received for message in read(bag)), default=0)
        name = cell.strip("/").replace("/", ".") or ROOT_CELL
        part = f"cell={name}/date={datetime.fromtimestamp(to_s(start_ns), UTC):%Y-%m-%d}"
        files = []
        for table, content in make_tables(bag, digest).items():
            path = f"tables/{table}/{part}/{digest}.parquet"
            with self._open(path) as stream:
                parquet.write_table(content, stream)
            files.append({"path": path, "table": table, "rows": content.num_rows})
        for topic in topics:
            own = topic.name.removeprefix(cell)
            path = f"topics/{part}/topic={own.strip('/').replace('/', '.')}/{digest}.parquet"
            files.append({"path": path, "topic": own, "rows": self._write_topic(bag, topic, path, digest)})
        if with_mcap:
            self._copy(bag, f"mcap/{part}/{bag.stem}-{digest}")
        return {
            "schema": SCHEMA,
            "digest": digest,
            "bag": bag.name,
            "cell": name,
            "start_ns": start_ns,
            "messages": sum(topic.messages for topic in topics),
            "files": files,
        }

    def _write_topic(self, bag: Path, topic: TopicSummary, path: str, digest: str) -> int:
        definitions = parse_definitions(topic.type_name, topic.schema)
        schema = message_schema(topic.type_name, definitions)
        rows = 0
        with self._open(path) as stream, parquet.ParquetWriter(stream, schema) as writer:
            for batch in _batches(_rows(bag, topic, digest)):
                writer.write_table(pa.Table.from_pylist(batch, schema=schema))
                rows += len(batch)
        return rows

    def _open(self, path: str) -> Any:
        full = f"{self.root}/{path}"
        self._make_folder(full)
        return self.files.open(full, "wb")

    def _write(self, path: str, data: bytes) -> None:
        self._make_folder(path)
        new = f"{path}.new"
        self.files.pipe_file(new, data)
        self.files.mv(new, path)

    def _make_folder(self, path: str) -> None:
        """Make the folder of a file where there are folders; S3 has none, and would make a bucket of a wrong name."""
        if "file" in self.files.protocol:
            self.files.makedirs(path.rpartition("/")[0], exist_ok=True)

    def _copy(self, bag: Path, target: str) -> None:
        files = sorted(path for path in bag.iterdir() if path.is_file()) if bag.is_dir() else [bag]
        for path in files:
            with path.open("rb") as source, self._open(f"{target}/{path.name}") as stream:
                shutil.copyfileobj(source, stream, _BLOCK)


def place_options(given: Iterable[str]) -> dict[str, str]:
    """Return NAME=VALUE as a mapping.

    Raises:
        BagError: one has no "=".
    """
    pairs = [one.partition("=") for one in given]
    wrong = [name for name, sign, _ in pairs if not sign]
    if wrong:
        raise BagError(f"--option: expected NAME=VALUE, found {wrong[0]!r}")
    return {name: value for name, _, value in pairs}


def _rows(bag: Path, topic: TopicSummary, digest: str) -> Iterator[dict[str, object]]:
    definitions = parse_definitions(topic.type_name, topic.schema)
    for raw in read(bag, {topic.name}):
        common = {"bag": digest, "received": raw.received, "published": raw.published}
        yield common | message_row(decode(topic.type_name, definitions, raw.data))


def _batches(rows: Iterator[dict[str, object]]) -> Iterator[list[dict[str, object]]]:
    batch: list[dict[str, object]] = []
    for row in rows:
        batch.append(row)
        if len(batch) == ROWS:
            yield batch
            batch = []
    if batch:
        yield batch
