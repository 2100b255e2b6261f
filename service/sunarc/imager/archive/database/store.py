"""Base of the parts of the archive: one writer at a time, rows as values, and the space that writes need."""

from __future__ import annotations

import base64
import errno
import logging
import os
import sqlite3
import tempfile
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from datetime import datetime, timedelta
from functools import cache
from pathlib import Path
from time import perf_counter
from typing import Any, TypeVar, cast

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite

from sunarc.common.errors import InputError, OutsideError, StoreFullError
from sunarc.imager.archive.database import connections
from sunarc.imager.archive.database.tables import quarantine
from sunarc.imager.archive.images import replacing
from sunarc.imager.runtime.deadline import SingleCall

_log = logging.getLogger(__name__)

_UNREADABLE = "\ufffd"
"""Stands in a text for bytes that are no UTF-8; a key that has it would find no row."""

Value = TypeVar("Value")

_REMEMBERED_COMMITS = 1000
_REBUILT_WITHIN_S = 60.0
"""A read waits no longer for a database that is being put back."""


_TRIED_EVERY, _ROOM_TRIED_EVERY, _TRIED_AGAIN_AFTER = timedelta(seconds=10), timedelta(minutes=1), timedelta(seconds=5)
_TRIED_FOR_S = 5.0
_TRIED_BYTES, _NEEDED_BYTES = 32_768, 1_048_576
"""Stored to see whether there is room; and after a write that found none, when a page that is left is no room."""
_WITHOUT_CAMERA = ""


class CommitTimes:
    """Durations of recent commits, and of those that are under way; safe to use from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running: dict[object, float] = {}
        self._ended: deque[tuple[float, float]] = deque(maxlen=_REMEMBERED_COMMITS)

    def begin(self) -> object:
        """Take note of a commit that begins, and return the argument of `end`."""
        commit = object()
        with self._lock:
            self._running[commit] = perf_counter()
        return commit

    def end(self, commit: object) -> None:
        """Take note that a commit ended, or failed."""
        now_s = perf_counter()
        with self._lock:
            self._ended.append((now_s, now_s - self._running.pop(commit)))

    def slowest_s(self, within_s: float) -> float:
        """Return the longest time that a commit took which ended so lately or has not ended; 0 without any."""
        now_s = perf_counter()
        with self._lock:
            running = [now_s - began_s for began_s in self._running.values()]
            ended = [took_s for ended_s, took_s in self._ended if now_s - ended_s <= within_s]
        return max([*running, *ended], default=0.0)


class Database:
    """Reads and writes of one database; safe to use from any thread.

    Parameters
    ----------
    engine : an engine of `create_archive_engine`, on a database of the head revision.
    file : its file, as it was opened; None on PostgreSQL.
    """

    def __init__(self, engine: sa.Engine, file: connections.DatabaseFile | None) -> None:
        self.engine = engine
        self.file = file
        self._changes = connections.SnapshotVersion(engine) if file is None else Changes(engine, file)
        self.months = connections.Months(engine) if file is None else None
        self.commits = CommitTimes()
        self._usable = threading.Event()
        self._usable.set()
        # our own threads wait here and are woken at once; other processes poll in SQLite (busy_timeout)
        self._lock = threading.Lock()
        self._unstored: OutsideError | None = None
        """Why the last trial failed, or the last write that found the disk full; None when a trial succeeded since."""
        self._tried_at: datetime | None = None
        self._room_tried_at: datetime | None = None
        self._trial: SingleCall[None] = SingleCall(self._try_to_store, name="trial row")
        self._trial_bytes = 0
        self._trial_waited_s = 0.0

    def close(self) -> None:
        """Close the connections that are not in use."""
        self._changes.close()
        self.engine.dispose()

    def revision(self) -> int:
        """Return a number that changes with every write to the database, whoever wrote; takes microseconds."""
        self._usable.wait(_REBUILT_WITHIN_S)
        return self._changes.count()

    @contextmanager
    def reading(self) -> Iterator[sa.Connection]:
        """Yield a connection that reads one snapshot of the database."""
        self._usable.wait(_REBUILT_WITHIN_S)
        with connections.reading(self.engine) as connection:
            yield connection

    @contextmanager
    def writing(self, *, camera: str | None = None) -> Iterator[sa.Connection]:
        """Yield a connection that writes, and commit at the end; of one camera's rows alone where it is named."""
        # On PostgreSQL rows of different cameras are written at the same time.
        with self._remember_full_disk(), nullcontext() if camera is not None and self.file is None else self._lock:
            # A deleted file stays writable in the connections that are open, and is lost with the process.
            if self.file is not None:
                self.file.require_in_place()
            commit: object | None = None
            try:
                with connections.writing(self.engine, camera=camera) as connection:
                    yield connection
                    commit = self.commits.begin()
            finally:
                if commit is not None:
                    self.commits.end(commit)

    def prepare_months(self, times: Sequence[datetime]) -> None:
        """Make the partitions that sightings of these times go to; SQLite has none."""
        if self.months is not None:
            with self._remember_full_disk():
                self.months.require(times)

    @contextmanager
    def _remember_full_disk(self) -> Iterator[None]:
        """Remember that a write found the disk full."""
        try:
            yield
        except StoreFullError as error:
            if not isinstance(self._unstored, StoreFullError):
                self._tried_at = None
            self._unstored = error
            raise

    @contextmanager
    def suspend_use(self) -> Iterator[None]:
        """Let reads and writes wait, while the file is put back.

        Raises
        ------
        OutsideError : another thread reads.
        """
        with self._lock:
            self._usable.clear()
            try:
                # A reader between `wait` and its connection is not counted: a new connection is refused
                # (`DatabaseFile.connect`), a pooled one reads the former file once more.
                if cast("sa.QueuePool", self.engine.pool).checkedout():
                    where = "" if self.file is None else f" {self.file.path}"
                    raise OutsideError(f"the database{where} is being read; it is put back at the next look")
                yield
            finally:
                self._usable.set()

    def counts(self, statement: sa.Select[Any], by: sa.Column[str]) -> Mapping[str, int]:
        """Return the counts of a statement, grouped by a column."""
        with self.reading() as connection:
            rows = connection.execute(statement.group_by(by)).all()
        return {str(name): int(n) for name, n in rows if name is not None}

    def last_written(self) -> int | None:
        """Return a number that changes when a write to the file's log succeeds; None where there is no log."""
        if self.file is None:
            return None
        try:
            return self.file.path.with_name(f"{self.file.path.name}-wal").stat().st_mtime_ns
        except OSError:
            return None

    def require_storing(self, *, now: datetime, patience_s: float = _TRIED_FOR_S, room: bool = True) -> None:
        """Find out whether a row can be stored: a trial every 10 s, and every 5 s after one that failed.

        Parameters
        ----------
        now : dates the trial.
        patience_s : that a trial may take; each call waits 5 s of it, and says nothing while the trial may still end.
        room : whether trials also ask for space, once a minute; without it one writes 12 kB.

        Raises
        ------
        StoreFullError : the disk is full. The first call after a write that found it so only says so.
        OutsideError : the database does not answer, or takes no row in that time.
        """
        tried_at, failure = self._tried_at, self._unstored
        pause = _TRIED_EVERY if failure is None else _TRIED_AGAIN_AFTER
        waits = tried_at is not None and timedelta(0) <= now - tried_at < pause
        if failure is not None and (waits or tried_at is None):
            self._tried_at = tried_at or now
            raise type(failure)(str(failure))
        if waits:
            return
        self._tried_at = now
        self._trial_bytes = self._bytes_to_try(failure, now, room=room)
        try:
            self._trial.start().result(_TRIED_FOR_S)
        except OutsideError as error:
            self._unstored, self._trial_waited_s = error, 0.0
            raise
        except TimeoutError:
            self._trial_waited_s += _TRIED_FOR_S
            if self._trial_waited_s < patience_s:
                self._tried_at = tried_at
                if failure is not None:
                    raise type(failure)(str(failure)) from None
                return
            where = "" if self.file is None else f" {self.file.path}"
            self._unstored = OutsideError(f"the database{where} stored no row within {patience_s:g} s")
            raise self._unstored from None
        self._unstored, self._trial_waited_s = None, 0.0

    def _bytes_to_try(self, failure: OutsideError | None, now: datetime, *, room: bool) -> int:
        """Return the size of the next trial's row: once a minute more than is left of a page."""
        if isinstance(failure, StoreFullError):
            return _NEEDED_BYTES
        if not room:
            return 0
        if self._room_tried_at is not None and timedelta(0) <= now - self._room_tried_at < _ROOM_TRIED_EVERY:
            return 0
        self._room_tried_at = now
        return _TRIED_BYTES

    def _try_to_store(self) -> None:
        """Store a row of so many bytes, and roll it back."""
        count, time = self._trial_bytes, self._tried_at
        if self.file is not None and count:
            self._try_to_allocate(self.file.path, count)
        text = base64.b85encode(os.urandom(count)).decode()  # compressed by the server, it would be no smaller
        words = dict.fromkeys(("installation", "reason", "kind", "text"), "")
        row = {**words, "camera": _WITHOUT_CAMERA, "seq": 0, "data": text if self.file is None else "", "n": 0}
        with self.writing(camera=_WITHOUT_CAMERA) as connection, connection.begin_nested() as tried:
            connection.execute(sa.insert(quarantine).values(**row, first_at=time, last_at=time))
            tried.rollback()

    def _try_to_allocate(self, path: Path, count: int) -> None:
        try:
            with tempfile.TemporaryFile(dir=path.parent) as file:
                os.posix_fallocate(file.fileno(), 0, count)
        except OSError as error:
            if error.errno not in {errno.ENOSPC, errno.EDQUOT}:
                raise OutsideError(f"cannot write beside the database {path}: {error}") from error
            raise StoreFullError(f"the disk of the database {path} is full: {error}") from error

    def records(self, statement: sa.Select[Any], kind: type[Value]) -> tuple[Value, ...]:
        """Return one `kind` per row; see `read_records`."""
        with self.reading() as connection:
            return read_records(connection, statement, kind)


class Part:
    """Base of the stores of the archive, whose methods take and return values.

    Parameters
    ----------
    database : where they are.
    """

    def __init__(self, database: Database) -> None:
        self._database = database


def read_records(connection: sa.Connection, statement: sa.Select[Any], kind: type[Value]) -> tuple[Value, ...]:
    """Return one `kind` per row; the columns carry the names of its fields.

    Unreadable rows, whose required values cannot be read (see `types`), are left out and logged.
    """
    result = connection.execute(statement)
    columns = tuple(statement.selected_columns)
    names = [str(column.key) for column in columns]
    needed = [number for number, column in enumerate(columns) if _is_required(column)]
    keys = [number for number, column in enumerate(columns) if getattr(column, "primary_key", False)]
    rows = result.all()
    complete = [
        row
        for row in rows
        if all(row[number] is not None for number in needed) and not any(_UNREADABLE in str(row[key]) for key in keys)
    ]
    made = (_make_value(kind, dict(zip(names, row, strict=True))) for row in complete)
    found = tuple(value for value in made if value is not None)
    if len(found) < len(rows):
        lost, name = len(rows) - len(found), kind.__name__
        _log.warning("left out %d damaged rows of kind %s; sunarc db check lists what else is wrong", lost, name)
    return found


def _make_value(kind: type[Value], fields: dict[str, Any]) -> Value | None:
    """Return the value of a row; None where its fields contradict one another."""
    try:
        return kind(**fields)
    except InputError:
        return None


def _is_required(column: sa.ColumnElement[Any]) -> bool:
    return isinstance(column, sa.Column) and not column.nullable and isinstance(column.type, sa.TypeDecorator)


def given(*filters: tuple[Callable[[Any], Any], object | None]) -> list[sa.ColumnElement[bool]]:
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

    def __init__(self, engine: sa.Engine, file: connections.DatabaseFile) -> None:
        self.engine = engine
        self.file = file
        self._lock = threading.Lock()
        self._connection: sqlite3.Connection | None = None
        self._opened = 0

    def count(self) -> int:
        """Return a number that changes with every commit, of this process or another."""
        with self._lock, connections.outside_errors(self.engine):
            if self._connection is None:
                try:
                    self._connection = self.file.connect()
                except sqlite3.Error as error:
                    raise OutsideError(f"cannot use the database {self.file.path}: {error}") from error
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


def _new_insert_statement(connection: sa.Connection, table: sa.Table) -> sqlite.Insert | postgresql.Insert:
    return sqlite.insert(table) if connection.dialect.name == "sqlite" else postgresql.insert(table)


def insert_new(connection: sa.Connection, table: sa.Table, rows: Sequence[Mapping[str, Any]]) -> int:
    """Insert rows and return how many were new; one whose key is there already is left as it is."""
    statement = _new_insert_statement(connection, table).on_conflict_do_nothing()
    if connection.dialect.name == "sqlite":
        return connection.execute(statement, list(rows)).rowcount
    # psycopg does not count the rows of many statements; RETURNING makes one statement of many rows besides
    return len(connection.execute(statement.returning(next(iter(table.primary_key))), list(rows)).all())


def upsert(
    connection: sa.Connection,
    table: sa.Table,
    row: Mapping[str, Any],
    *,
    key: Sequence[str],
    of: str | None = None,
    changed: Mapping[str, Any] | None = None,
) -> int:
    """Insert a row, or write it over the one of the same key, and return how many rows were written.

    Parameters
    ----------
    connection, table, row : where to, and the columns' values by their keys.
    key : the columns of the unique key.
    of : a column that must have the same value in the row that is there; else nothing is written.
    changed : what is written over the row that is there; all of the row unless given.
    """
    statement = _new_insert_statement(connection, table).values(row)
    same = None if of is None else table.c[of] == row[of]
    statement = statement.on_conflict_do_update(index_elements=key, set_=dict(changed or row), where=same)
    return connection.execute(statement.execution_options(preserve_rowcount=True)).rowcount


def upsert_all(
    connection: sa.Connection,
    table: sa.Table,
    rows: Sequence[Mapping[str, Any]],
    *,
    key: Sequence[str],
    kept: Sequence[str] = (),
    added: Sequence[str] = (),
) -> None:
    """Insert rows that have the same columns, each over the one of the same key, in their order.

    Parameters
    ----------
    connection, table, rows, key : where to, the columns' values by their keys, and the columns of the unique key.
    kept, added : columns whose value stays as it is in the row that is there, or is added to that.
    """
    if not rows:
        return
    statement = _new_insert_statement(connection, table)
    written: dict[str, Any] = {name: statement.excluded[name] for name in rows[0] if name not in {*key, *kept}}
    written |= {name: table.c[name] + statement.excluded[name] for name in added}
    connection.execute(statement.on_conflict_do_update(index_elements=key, set_=written), list(rows))


def upsert_records(
    connection: sa.Connection,
    table: sa.Table,
    rows: Sequence[Mapping[str, Any]],
    *,
    columns: Sequence[str],
    key: Sequence[str],
) -> None:
    """Write rows as `upsert_all` does, on PostgreSQL, in one statement, with values as JSON has them.

    It takes half the processor time, here and in the server. Of rows of one key the last is stored, in the place of
    the first.
    """
    last = {tuple(row.get(name) for name in key): row for row in rows}
    statement = _upsert_statement(table.name, tuple(columns), tuple(key))
    connection.execute(statement, {"rows": connections.json_text(list(last.values()))})


@cache
def _upsert_statement(table: str, columns: tuple[str, ...], key: tuple[str, ...]) -> sa.TextClause:
    names = ", ".join(columns)
    written = ", ".join(f"{name} = excluded.{name}" for name in columns if name not in key)
    return sa.text(
        f"INSERT INTO {table} ({names}) "  # noqa: S608 - names of the table's own columns
        f"SELECT {names} FROM json_populate_recordset(NULL::{table}, CAST(:rows AS json)) "
        f"ON CONFLICT ({', '.join(key)}) DO UPDATE SET {written}"
    )


class Reserve:
    """A file that occupies space until the database needs it.

    Parameters
    ----------
    path : the file.
    size_bytes : how much it holds; 0 holds nothing.
    """

    def __init__(self, path: Path, *, size_bytes: int) -> None:
        self._path = path
        self.size_bytes = size_bytes

    def held(self) -> bool:
        """Return whether the reserve is allocated, or needs no space."""
        return self.size_bytes == 0 or self._path.exists()

    def hold(self) -> bool:
        """Allocate the reserve, and return whether there was enough space."""
        if self.held():
            return True
        try:
            with replacing(self._path) as file:
                # Blocks are taken, not a hole: a sparse file would set nothing aside.
                os.posix_fallocate(file.fileno(), 0, self.size_bytes)
        except OSError:
            return False
        return True

    def balance(self, free_bytes: int) -> None:
        """Release the reserve when less than a quarter of its size is free; allocate it again above twice its size."""
        if free_bytes < self.size_bytes / 4:
            self.release()
        elif free_bytes > 2 * self.size_bytes:
            self.hold()

    def release(self) -> None:
        """Delete the reserve's file, so that its space is free."""
        self._path.unlink(missing_ok=True)
