"""Connections to the SQLite file: durable, with foreign keys, and with transactions that begin where we say.

Reads and writes are the same on PostgreSQL (`server`).
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from weakref import WeakKeyDictionary

from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.exc import DatabaseError, DBAPIError, IntegrityError, OperationalError

from sunarc.archive import server
from sunarc.archive.file import DAMAGED, DatabaseFile
from sunarc.archive.json_text import json_text, parsed_json
from sunarc.archive.server import ONE_CAMERA, WRITES, contradiction, server_errors
from sunarc.errors import ConfigurationError, OutsideError, StoreFullError

_BUSY_TIMEOUT_MS = 30_000
_OF_THE_ROW = frozenset(
    {
        sqlite3.SQLITE_ERROR,
        sqlite3.SQLITE_TOOBIG,
        sqlite3.SQLITE_CONSTRAINT,
        sqlite3.SQLITE_MISMATCH,
        sqlite3.SQLITE_RANGE,
    }
)
"""Result codes of SQLite that say something of a row; the others are of the file, its disk and its locks."""
_FILES: WeakKeyDictionary[Engine, DatabaseFile] = WeakKeyDictionary()


def create_archive_engine(
    path: Path, *, foreign_keys: bool = True, create: bool = False, file: DatabaseFile | None = None
) -> Engine:
    """Return an engine on a database file; migrations alone switch the foreign keys off, and make the file."""
    opened = file or DatabaseFile(path)
    engine = create_engine(
        f"sqlite:///{path}",
        creator=lambda: opened.connect(create=create),
        pool_size=8,
        max_overflow=32,
        pool_timeout=30.0,
        json_serializer=json_text,
        json_deserializer=parsed_json,
    )

    _FILES[engine] = opened

    @event.listens_for(engine, "connect")
    def _prepare(connection: sqlite3.Connection, _record: object) -> None:
        connection.isolation_level = None  # the driver begins nothing by itself
        connection.text_factory = _text  # else one flipped bit makes every query that meets it fail
        connection.execute(f"PRAGMA busy_timeout={_BUSY_TIMEOUT_MS}")
        # WAL: readers never wait for a writer. FULL: each commit is on the disk before it is reported, since a field
        # computer loses power without notice.
        connection.execute("PRAGMA journal_mode=WAL")
        connection.execute("PRAGMA synchronous=FULL")
        connection.execute(f"PRAGMA foreign_keys={'ON' if foreign_keys else 'OFF'}")

    @event.listens_for(engine, "begin")
    def _begin(connection: Connection) -> None:
        writes = connection.get_execution_options().get(WRITES, False)
        # IMMEDIATE: a transaction that reads first and writes later could find another's commit between, and fail.
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

    return engine


@contextmanager
def reading(engine: Engine) -> Iterator[Connection]:
    """Yield a connection that reads one snapshot of the database."""
    with outside_errors(engine), engine.connect() as connection:
        yield connection


@contextmanager
def writing(engine: Engine, *, camera: str | None = None) -> Iterator[Connection]:
    """Yield a connection that holds the database's write lock, and commit at the end.

    With `camera` only rows of that camera are written: PostgreSQL then lets other cameras' be written meanwhile.
    """
    options = {WRITES: True, ONE_CAMERA: camera}
    with outside_errors(engine), engine.execution_options(**options).begin() as connection:
        yield connection


@contextmanager
def outside_errors(engine: Engine) -> Iterator[None]:
    """Raise the database's errors as this package's, in one line with the remedy."""
    with server_errors(engine) if engine.dialect.name == "postgresql" else _file_errors(engine):
        yield


def is_of_row(connection: Connection, error: DBAPIError) -> bool:
    """Return whether the database refused a row itself; else no row could be stored: server, disk, locks."""
    if connection.dialect.name == "postgresql":
        return server.is_of_row(error)
    return _result_code(error) in _OF_THE_ROW


def _result_code(error: DBAPIError) -> int:
    """Return SQLite's result code, without what is added to it; of an error of the driver, that of a row."""
    return getattr(error.orig, "sqlite_errorcode", sqlite3.SQLITE_ERROR) & 0xFF


@contextmanager
def _file_errors(engine: Engine) -> Iterator[None]:
    path = engine.url.database
    try:
        yield
    except IntegrityError as error:
        raise contradiction(str(error.orig)) from error
    except OperationalError as error:
        if _result_code(error) == sqlite3.SQLITE_FULL:
            raise StoreFullError(f"the disk of the database {path} is full: {error.orig}") from error
        may = os.access(str(path), os.R_OK | os.W_OK) or not Path(str(path)).exists()
        remedy = "" if may else "; give the file to the service's user (chown), or ask as that user"
        raise OutsideError(f"cannot use the database {path}: {error.orig}{remedy}") from error
    except DatabaseError as error:
        if _result_code(error) == sqlite3.SQLITE_CORRUPT:
            _FILES[engine].note_damage()
            raise OutsideError(f"the database {path} {DAMAGED} ({error.orig}); it is put together anew") from error
        raise ConfigurationError(
            f"{path} is no sound SQLite database ({error.orig}); put the newest copy in its place: "
            f"sunarc db restore --latest --state {Path(str(path)).parent}"
        ) from error


def _text(stored: bytes) -> str:
    return stored.decode("utf-8", "replace")
