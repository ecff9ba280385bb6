# SPDX-License-Identifier: Apache-2.0
"""Opening the database: one manager at a time, a known schema, every failure a StorageError."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, Final, Self

from sqlalchemy import __version__ as sqlalchemy_version
from sqlalchemy import create_engine, delete, event, insert, inspect, select, text, update
from sqlalchemy.engine import URL, Connection, Engine, make_url
from sqlalchemy.exc import ArgumentError, NoSuchModuleError, SQLAlchemyError

from softgrip_cell.errors import OccupiedError, SchemaError, StorageError
from softgrip_cell.storage.schema import AUDIT, EXTENSIBLE_VERSIONS, META, METADATA, SCHEMA_VERSION

#: Tables that nothing is decided by.
_NOT_REMEMBERED: Final = {AUDIT.name, META.name}

#: Where the database lives unless told otherwise.
SHIPPED_URL: Final = "sqlite:///~/.local/state/softgrip/cell.db"

#: How long a statement waits for another writer [s].
LOCK_WAIT_S: Final = 2.0

#: SQLAlchemy 1.4, which Ubuntu 24.04 has, does not know version 3.
POSTGRES_DRIVER: Final = "psycopg2" if sqlalchemy_version.startswith("1.") else "psycopg"

#: Key of PostgreSQL's advisory lock that the manager of a cell holds ("softgrip" read as a number).
POSTGRES_LOCK: Final = 0x736F6674


class Database:
    """An open database.

    Args:
        url: SQLAlchemy URL; ``sqlite:///path`` (``~`` is the home folder) or ``postgresql://user@host/name``.
        exclusive: take the cell: refuse when another process has it. Tools that only read or edit entries do not.
        deferred: do not open it yet; `open` does, as often as it has to be tried.

    Raises:
        OccupiedError: another manager runs this cell.
        SchemaError: it was written by another release.
        StorageError: it cannot be opened or written, or the URL names none.
    """

    def __init__(self, url: str = SHIPPED_URL, *, exclusive: bool = False, deferred: bool = False) -> None:
        self.url = _parse(url)
        self._exclusive = exclusive
        self._is_open = False
        self._lock_file: BinaryIO | None = None
        self._lock_connection: Connection | None = None
        self._engine: Engine = self._make_engine()
        if not deferred:
            self.open()

    def open(self) -> None:
        """Take the cell where asked to, and create or check the tables.

        Raises:
            OccupiedError, SchemaError, StorageError: see the class; nothing is held then.
        """
        if self._is_open:
            return
        try:
            if self._is_file():
                self._make_folder(Path(str(self.url.database)).parent)
            if self._exclusive:
                self._occupy()
            self._prepare()
            self._is_open = True
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def place(self) -> str:
        """Where it is, without a password."""
        return self.url.render_as_string(hide_password=True)

    def close(self) -> None:
        """Close every connection and give the cell back."""
        self._is_open = False
        if self._lock_connection is not None:
            self._lock_connection.close()
            self._lock_connection = None
        self._engine.dispose()
        if self._lock_file is not None:
            self._lock_file.close()
            self._lock_file = None

    @contextmanager
    def write(self) -> Iterator[Connection]:
        """All or nothing: what is done in the block is committed at its end, or never happened."""
        with self._translated(), self._engine.begin() as connection:
            yield connection

    read = write  # one path: a reader sees one consistent state as well

    def audit(
        self, connection: Connection, at_ns: int, who: str, action: str, subject: str, detail: object = None
    ) -> None:
        """Write down who did what, in the transaction that does it."""
        connection.execute(
            insert(AUDIT).values(at_ns=at_ns, who=who, action=action, subject=subject, detail=json.dumps(detail))
        )

    def save(self) -> bytes:
        """Return everything that the cell decides by, as JSON of tables."""
        with self.read() as connection:
            tables = {
                table.name: [dict(row) for row in connection.execute(select(table)).mappings()]
                for table in METADATA.sorted_tables
                if table.name not in _NOT_REMEMBERED
            }
        return json.dumps(tables).encode()

    def load(self, saved: bytes) -> None:
        """Put back what `save` returned; what is there now is gone."""
        rows = json.loads(saved)
        with self.write() as connection:
            for table in METADATA.sorted_tables:
                if table.name not in _NOT_REMEMBERED:
                    connection.execute(delete(table))
                    if rows.get(table.name):  # an older release had fewer tables
                        connection.execute(insert(table), rows[table.name])

    def _make_engine(self) -> Engine:
        if self.url.get_backend_name() != "sqlite":
            try:
                return create_engine(self.url, future=True, pool_pre_ping=True, connect_args={"connect_timeout": 5})
            except ModuleNotFoundError as error:
                raise StorageError(
                    f"database_url: PostgreSQL expects the module {POSTGRES_DRIVER}, found none; install it, as "
                    f"python3-{POSTGRES_DRIVER} or with pip, or name a file: sqlite:///path"
                ) from error
        # future: SQLAlchemy 1.4, which Ubuntu 24.04 has, behaves as 2 then
        engine = create_engine(self.url, future=True, connect_args={"timeout": LOCK_WAIT_S, "check_same_thread": False})

        @event.listens_for(engine, "connect")
        def _configure(connection: Any, _record: Any) -> None:
            connection.isolation_level = None  # SQLAlchemy begins transactions, not the sqlite3 module
            for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"):
                connection.execute(f"PRAGMA {pragma}")

        @event.listens_for(engine, "begin")
        def _begin(connection: Connection) -> None:
            connection.exec_driver_sql("BEGIN IMMEDIATE")

        return engine

    def _make_folder(self, folder: Path) -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StorageError(f"database folder {folder}: expected to be able to create it: {error}") from error

    def _prepare(self) -> None:
        """Create the tables of an empty database; refuse a newer or foreign one."""
        with self.write() as connection:
            if not inspect(connection).has_table(META.name):
                METADATA.create_all(connection)
                connection.execute(insert(META).values(key="schema", value=str(SCHEMA_VERSION)))
                return
            found = connection.execute(select(META.c.value).where(META.c.key == "schema")).scalar_one_or_none()
            if found in {str(version) for version in EXTENSIBLE_VERSIONS}:
                METADATA.create_all(connection)
                connection.execute(update(META).where(META.c.key == "schema").values(value=str(SCHEMA_VERSION)))
            elif found != str(SCHEMA_VERSION):
                raise SchemaError(
                    f"database {self.place}: expected schema {SCHEMA_VERSION}, found {found}; "
                    "run the softgrip release that wrote it, or name another database_url"
                )

    def _occupy(self) -> None:
        """Take the cell until this process ends, however it ends."""
        busy = f"database {self.place}: another grasp_mix_manager runs this cell; stop it or name another database_url"
        if self.url.get_backend_name() == "postgresql":
            with self._translated():
                self._lock_connection = self._engine.connect().execution_options(isolation_level="AUTOCOMMIT")
                taken = self._lock_connection.execute(text("SELECT pg_try_advisory_lock(:k)"), {"k": POSTGRES_LOCK})
                if not taken.scalar_one():
                    raise OccupiedError(busy)
            return
        if not self._is_file():
            return
        path = Path(f"{self.url.database}.lock")
        try:
            self._lock_file = path.open("ab+", buffering=0)
            fcntl.flock(self._lock_file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._lock_file.truncate(0)
            self._lock_file.write(f"{os.getpid()}\n".encode())
        except BlockingIOError:
            raise OccupiedError(busy) from None
        except OSError as error:
            raise StorageError(f"lock file {path}: expected to be able to write it: {error}") from error

    def _is_file(self) -> bool:
        return self.url.get_backend_name() == "sqlite" and self.url.database not in (None, "", ":memory:")

    @contextmanager
    def _translated(self) -> Iterator[None]:
        try:
            yield
        except SQLAlchemyError as error:
            cause = str(getattr(error, "orig", None) or error).strip().splitlines()[0]
            raise StorageError(
                f"database {self.place}: expected to be able to use it, found: {cause}; nothing was written"
            ) from error


Clock = Callable[[], int]  # nanoseconds since the epoch


def _parse(url: str) -> URL:
    try:
        parsed = make_url(url)
        backend = parsed.get_backend_name()
    except (ArgumentError, NoSuchModuleError) as error:
        raise StorageError(
            f"database_url: expected sqlite:///path or postgresql://user@host/name, found {url!r}"
        ) from error
    if parsed.password is not None or "password" in parsed.query:
        raise StorageError(
            "database_url: expected postgresql://user@host/name without a password, found one, which everybody could "
            "read as a parameter; put it into ~/.pgpass (mode 600) or into PGPASSWORD in the manager's environment"
        )
    if backend == "postgresql":
        return parsed.set(drivername=f"postgresql+{POSTGRES_DRIVER}")
    if backend != "sqlite":
        raise StorageError(f"database_url: expected sqlite or postgresql, found {backend!r}")
    if parsed.database and parsed.database != ":memory:":
        return parsed.set(database=str(Path(parsed.database).expanduser()))
    return parsed
