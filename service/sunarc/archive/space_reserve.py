"""Disk space reserved for the database."""

from __future__ import annotations

import os
from pathlib import Path

from sunarc.archive.images import replacing


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
