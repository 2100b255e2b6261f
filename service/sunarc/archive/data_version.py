"""Detection of writes in microseconds, so that query results can be cached until the next one."""

from __future__ import annotations

import sqlite3
import threading

from sqlalchemy import Engine

from sunarc.archive.engine import outside_errors
from sunarc.archive.file import DatabaseFile
from sunarc.errors import OutsideError


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
