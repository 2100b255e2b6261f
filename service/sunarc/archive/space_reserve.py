"""Room on the disk that is set aside for the database."""

from __future__ import annotations

import os
from pathlib import Path


class Reserve:
    """A file that takes up room until the database needs it.

    Parameters
    ----------
    path : the file.
    size_bytes : how much it holds; 0 holds nothing.
    """

    def __init__(self, path: Path, *, size_bytes: int) -> None:
        self._path = path
        self.size_bytes = size_bytes

    def held(self) -> bool:
        """Whether the room is set aside."""
        return self.size_bytes == 0 or self._path.exists()

    def hold(self) -> bool:
        """Set the room aside; return whether there was enough of it."""
        if self.held():
            return True
        part = self._path.with_suffix(".part")
        try:
            with part.open("wb") as file:
                # Blocks are taken, not a hole: a sparse file would set nothing aside.
                os.posix_fallocate(file.fileno(), 0, self.size_bytes)
            # Renamed when it has its size: one that a full disk cut short must not count as a reserve.
            part.replace(self._path)
        except OSError:
            part.unlink(missing_ok=True)
            return False
        return True

    def balance(self, free_bytes: int) -> None:
        """Give the room up when a quarter as much is all that is free; set it aside again when twice as much is."""
        if free_bytes < self.size_bytes / 4:
            self.release()
        elif free_bytes > 2 * self.size_bytes:
            self.hold()

    def release(self) -> None:
        """Give the room to whoever writes next."""
        self._path.unlink(missing_ok=True)
