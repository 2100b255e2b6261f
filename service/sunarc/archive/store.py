"""Base of the parts of the archive: one engine, one writer at a time, rows as values."""

from __future__ import annotations

import logging
import sqlite3
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from datetime import datetime
from typing import Any, Self, TypeVar

from sqlalchemy import Column, ColumnElement, Connection, Engine, Select, TypeDecorator

from sunarc.archive.engine import outside_errors, reading, writing
from sunarc.archive.file import DatabaseFile
from sunarc.archive.server import Months, SnapshotVersion
from sunarc.errors import InputError, OutsideError, StoreFullError

_log = logging.getLogger(__name__)

_UNREADABLE = "\ufffd"
"""Stands in a text for what is no UTF-8; a key that has it would find no row."""

Value = TypeVar("Value")

_REBUILT_WITHIN_S = 60.0
"""A read waits no longer for a database that is being put back."""


class Store:
    """Reads and writes of one database; safe to use from any thread.

    Parameters
    ----------
    engine : an engine of `create_archive_engine`, on a database of the head revision.
    file : its file, as it was opened; None on PostgreSQL.
    """

    def __init__(self, engine: Engine, file: DatabaseFile | None) -> None:
        self._engine = engine
        self._file = file
        self._changes = SnapshotVersion(engine) if file is None else Changes(engine, file)
        self._months = Months(engine) if file is None else None
        self._usable = threading.Event()
        self._usable.set()
        self._lock = threading.Lock()  # our own threads queue here, fairly; other processes wait in SQLite
        self._full: str | None = None
        """What the last write said that found the disk full; None when there was room since (see `Room`)."""
        self._room_tried_at: datetime | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections that are not in use."""
        self._changes.close()
        self._engine.dispose()

    def revision(self) -> int:
        """Return a number that is another one after anything was written, by whomever; takes microseconds."""
        self._usable.wait(_REBUILT_WITHIN_S)
        return self._changes.count()

    @contextmanager
    def _reading(self) -> Iterator[Connection]:
        self._usable.wait(_REBUILT_WITHIN_S)
        with reading(self._engine) as connection:
            yield connection

    @contextmanager
    def _writing(self, *, camera: str | None = None) -> Iterator[Connection]:
        # On PostgreSQL rows of different cameras are written at the same time.
        with self._noticing_room(), nullcontext() if camera is not None and self._file is None else self._lock:
            # A deleted file stays writable in the connections that are open, and is lost with the process.
            if self._file is not None:
                self._file.require_in_place()
            with writing(self._engine, camera=camera) as connection:
                yield connection

    def _prepare_months(self, times: Sequence[datetime]) -> None:
        """Make the partitions that sightings of these times go to; SQLite has none."""
        if self._months is not None:
            with self._noticing_room():
                self._months.require(times)

    @contextmanager
    def _noticing_room(self) -> Iterator[None]:
        """Remember that a write found the disk full."""
        try:
            yield
        except StoreFullError as error:
            if self._full is None:
                self._room_tried_at = None
            self._full = str(error)
            raise

    def _values(self, statement: Select[Any], kind: type[Value]) -> tuple[Value, ...]:
        with self._reading() as connection:
            return values_of(connection, statement, kind)


def values_of(connection: Connection, statement: Select[Any], kind: type[Value]) -> tuple[Value, ...]:
    """Return one value per row; the columns carry the names of its fields.

    A row whose required values cannot be read (see `types`) is left out, and logged.
    """
    result = connection.execute(statement)
    columns = tuple(statement.selected_columns)
    names = [str(column.key) for column in columns]
    needed = [number for number, column in enumerate(columns) if _required(column)]
    keys = [number for number, column in enumerate(columns) if getattr(column, "primary_key", False)]
    rows = result.all()
    complete = [
        row
        for row in rows
        if all(row[number] is not None for number in needed) and not any(_UNREADABLE in str(row[key]) for key in keys)
    ]
    made = (_made(kind, dict(zip(names, row, strict=True))) for row in complete)
    found = tuple(value for value in made if value is not None)
    if len(found) < len(rows):
        lost, name = len(rows) - len(found), kind.__name__
        _log.warning("left out %d damaged rows of kind %s; sunarc db check lists what else is wrong", lost, name)
    return found


def _made(kind: type[Value], fields: dict[str, Any]) -> Value | None:
    """Return the value of a row; None where its fields contradict one another."""
    try:
        return kind(**fields)
    except InputError:
        return None


def _required(column: ColumnElement[Any]) -> bool:
    return isinstance(column, Column) and not column.nullable and isinstance(column.type, TypeDecorator)


def given(*filters: tuple[Callable[[Any], Any], object | None]) -> list[ColumnElement[bool]]:
    """Return the conditions whose argument is given: `given((column.__eq__, None))` filters nothing."""
    return [compare(argument) for compare, argument in filters if argument is not None]


# Detection of writes in microseconds, so that query results can be cached until the next one.


class Changes:
    """A connection of its own to a database, which sees every commit of all others.

    Parameters
    ----------
    engine : names the database in errors.
    file : its file.
    """

    def __init__(self, engine: Engine, file: DatabaseFile) -> None:
        self._engine = engine
        self._file = file
        self._lock = threading.Lock()
        self._connection: sqlite3.Connection | None = None
        self._opened = 0

    def count(self) -> int:
        """Return a number that is another one after any commit, of this process or another."""
        with self._lock, outside_errors(self._engine):
            if self._connection is None:
                try:
                    self._connection = self._file.connect()
                except sqlite3.Error as error:
                    raise OutsideError(f"cannot use the database {self._file.path}: {error}") from error
                self._opened += 1  # each connection counts from the start
            # SQLite counts commits of other connections only: this one writes nothing, so that it sees them all.
            (version,) = self._connection.execute("PRAGMA data_version").fetchone()
            return int(version) + (self._opened << 32)

    def close(self) -> None:
        """Close the connection; the next question opens another."""
        with self._lock:
            if self._connection is not None:
                self._connection.close()
            self._connection = None
