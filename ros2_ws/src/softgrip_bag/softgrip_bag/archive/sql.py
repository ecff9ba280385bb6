# SPDX-License-Identifier: Apache-2.0
"""SQL over an archive: DuckDB reads the Parquet files that the manifests name.

Every table of `tables.SCHEMAS` is a view of its name, every topic one named after it with `_` for `/` (`tendon_state`,
`finger_residual`), and `finger_life` is made of these. All have the columns `cell` and `date`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib.resources import files
from pathlib import PurePosixPath
from typing import Any

import duckdb

from softgrip_bag.archive.store import Archive
from softgrip_bag.archive.tables import SCHEMAS
from softgrip_bag.errors import BagError


def ask(archive: Archive, question: str) -> tuple[list[str], list[tuple[Any, ...]]]:
    """Return the names of an answer's columns, and its rows.

    Args:
        archive: what is asked.
        question: SQL, or the name of a shipped question.

    Raises:
        BagError: there is no archive there, it cannot be read, or the SQL is wrong.
    """
    try:
        result = connect(archive).execute(shipped_queries().get(question, question))
        return [column[0] for column in result.description or ()], result.fetchall()
    except duckdb.Error as error:
        raise BagError(f"{error}\nAsk for one of {', '.join(shipped_queries())}, or in SQL") from error


def connect(archive: Archive) -> duckdb.DuckDBPyConnection:
    """Return a connection with a view of every table and topic of an archive.

    Raises:
        BagError: there is no archive there, or it cannot be read.
    """
    manifests = archive.manifests()
    if not manifests:
        raise BagError(
            f"{archive.place}: expected an archive, found no manifest; make one with `ros2 run softgrip_bag archive "
            "BAG... --to FOLDER`"
        )
    connection = duckdb.connect()
    connection.execute("SET TimeZone = 'UTC'")
    if not isinstance(archive.files.protocol, str) or archive.files.protocol != "file":
        connection.register_filesystem(archive.files)
    found: dict[str, list[str]] = {name: [] for name in SCHEMAS}
    for manifest in manifests:
        for file in manifest["files"]:
            name = file["table"] if "table" in file else view_name(file["topic"])
            found.setdefault(name, []).append(archive.url(file["path"]))
    for name, urls in found.items():
        _create_view(connection, name, urls)
    for name, text in _texts("views").items():
        _create_query_view(connection, name, text)
    return connection


def view_name(topic: str) -> str:
    """Return the view of a topic: "/cell/grasp/_action/status" is `cell_grasp_action_status`."""
    name = "_".join(part.strip("_") for part in topic.strip("/").split("/"))
    return re.sub(r"\W", "_", name, flags=re.ASCII)


def shipped_queries() -> Mapping[str, str]:
    """Return name -> SQL of the questions that come with softgrip_bag; the first line of each is a comment."""
    return _texts("queries")


def _create_view(connection: duckdb.DuckDBPyConnection, name: str, urls: list[str]) -> None:
    relation = connection.read_parquet(urls, union_by_name=True, hive_partitioning=True)
    relation.create_view(name)


def _create_query_view(connection: duckdb.DuckDBPyConnection, name: str, text: str) -> None:
    try:
        connection.execute(f'CREATE VIEW "{name}" AS {text}')
    except duckdb.CatalogException:
        return  # no bag has the topics it is made of


def _texts(folder: str) -> dict[str, str]:
    place: Any = files("softgrip_bag.archive") / folder
    found = {PurePosixPath(one.name).stem: one.read_text(encoding="utf-8") for one in place.iterdir()}
    return dict(sorted(found.items()))
