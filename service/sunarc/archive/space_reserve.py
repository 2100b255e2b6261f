"""Disk space for the database: what is reserved, and whether there is any."""

from __future__ import annotations

import base64
import errno
import os
import tempfile
from datetime import datetime, timedelta
from pathlib import Path

from sqlalchemy import insert

from sunarc.archive.images import replacing
from sunarc.archive.store import Store
from sunarc.archive.tables import quarantine
from sunarc.errors import OutsideError, StoreFullError

_TRIED_EVERY, _TRIED_AGAIN_AFTER = timedelta(minutes=1), timedelta(seconds=5)
_TRIED_BYTES, _NEEDED_BYTES = 32_768, 1_048_576
"""Stored to see whether there is room; and after a write that found none, when a page that is left is no room."""
_WITHOUT_CAMERA = ""


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


class Room(Store):
    """The part of the archive that tells whether a row can be stored."""

    def require_room(self, *, now: datetime) -> None:
        """Find out whether a row can be stored: once a minute, and every 5 s after a write that found the disk full.

        Raises
        ------
        StoreFullError : it cannot. The first call after such a write only says so.
        OutsideError : the database does not answer.
        """
        tried_at, full = self._room_tried_at, self._full
        waits = tried_at is not None and timedelta(0) <= now - tried_at < (_TRIED_AGAIN_AFTER if full else _TRIED_EVERY)
        if full is not None and (waits or tried_at is None):
            self._room_tried_at = tried_at or now
            raise StoreFullError(full)
        if waits:
            return
        self._room_tried_at = now
        self._try_to_store(_NEEDED_BYTES if full else _TRIED_BYTES)
        self._full = None

    def _try_to_store(self, count: int) -> None:
        """Store so many bytes, and take them back."""
        if self._file is not None:
            try:
                with tempfile.TemporaryFile(dir=self._file.path.parent) as file:
                    os.posix_fallocate(file.fileno(), 0, count)
            except OSError as error:
                if error.errno not in {errno.ENOSPC, errno.EDQUOT}:
                    raise OutsideError(f"cannot write beside the database {self._file.path}: {error}") from error
                self._full = f"the disk of the database {self._file.path} is full: {error}"
                raise StoreFullError(self._full) from error
            return
        text = base64.b85encode(os.urandom(count)).decode()  # compressed by the server, it would be no smaller
        words = dict.fromkeys(("installation", "reason", "kind", "text"), "")
        row = {**words, "camera": _WITHOUT_CAMERA, "seq": 0, "data": text, "n": 0}
        time = self._room_tried_at
        with self._writing(camera=_WITHOUT_CAMERA) as connection, connection.begin_nested() as tried:
            connection.execute(insert(quarantine).values(**row, first_at=time, last_at=time))
            tried.rollback()
