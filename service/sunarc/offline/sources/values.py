"""What an archive of images is, wherever it is kept."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, Protocol


class SourceFile(NamedTuple):
    """A file of a source: its name below the source, its size in bytes, and what changes with its content."""

    name: str
    size: int
    stamp: str


class ImageSource(Protocol):
    """Files that can be listed and read, in any number of processes at once.

    Attributes
    ----------
    address : what `open_source` opens it by.
    """

    @property
    def address(self) -> str:
        """What `open_source` opens it by."""

    def files(self) -> Iterator[SourceFile]:
        """Yield all files, in the order of their names."""

    def read(self, name: str) -> bytes:
        """Return a file's content.

        Raises
        ------
        OSError : it cannot be read.
        """

    def path(self, name: str) -> Path | None:
        """Return where a file is on this disk; None where it is within another file, or elsewhere."""
