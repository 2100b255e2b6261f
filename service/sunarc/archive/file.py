"""The database's file while it is in use: whether it still is the one that was opened."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from urllib.parse import quote

from sunarc.errors import OutsideError

DELETED = "was deleted while it was in use"
REPLACED = "was replaced while it was in use"
EMPTIED = "was emptied while it was in use"
DAMAGED = "has a malformed page"


class DatabaseFile:
    """A database file, identified by device and inode from the moment it was opened.

    A file that is deleted or replaced stays open in the connections that there are; what they write would be lost
    with the process. A connection that is opened later would even make a new, empty file.

    Parameters
    ----------
    path : the file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._identity: tuple[int, int] | None = None
        self._damaged = False

    def note_damage(self) -> None:
        """Take note that SQLite met a page that it cannot read: nothing is written until the file is put back."""
        self._damaged = True

    def remember(self) -> None:
        """Take the file that is there now for the one that is in use."""
        self._damaged = False
        found = self.path.stat()
        self._identity = (found.st_dev, found.st_ino)

    def problem(self) -> str | None:
        """Return what happened to the file since it was opened; None when it is in place."""
        try:
            found = self.path.stat()
        except FileNotFoundError:
            return DELETED
        except OSError as error:
            return f"cannot be reached: {error.strerror}"
        if self._identity is not None and (found.st_dev, found.st_ino) != self._identity:
            return REPLACED
        if self._damaged:
            return DAMAGED
        return EMPTIED if found.st_size == 0 and self._identity is not None else None

    def require_in_place(self) -> None:
        """Raise `OutsideError` when the file is not the one that was opened."""
        problem = self.problem()
        if problem is not None:
            raise OutsideError(f"the database {self.path} {problem}; nothing is written until it is back")

    def connect(self, *, create: bool = False) -> sqlite3.Connection:
        """Open a connection; never to another file than the one in use, and to a new one only with `create`."""
        mode = "rwc" if create else "rw"
        connection = sqlite3.connect(f"file:{quote(str(self.path))}?mode={mode}", uri=True, check_same_thread=False)
        # Checked after opening: a file that was exchanged just before would else be taken for the one in use.
        problem = None if create else self.problem()
        if problem is not None:
            connection.close()
            raise sqlite3.OperationalError(f"the file {problem}")
        return connection
