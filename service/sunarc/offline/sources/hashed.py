"""A source whose files are hashed as they are read."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

from sunarc.offline.sources.values import ImageSource, SourceFile

_HASH_BYTES = 16
"""Two of 1e9 files have the same hash by chance with a probability of 1e-21."""


class HashedSource:
    """Another source, which keeps the content and hash of the file that was read last; see `ImageSource`."""

    def __init__(self, source: ImageSource) -> None:
        self._source = source
        self._last: tuple[str, bytes, str] | None = None

    @property
    def address(self) -> str:
        """What `open_source` opens the other one by."""
        return self._source.address

    def files(self) -> Iterator[SourceFile]:
        """Yield all files, in the order of their names."""
        return self._source.files()

    def read(self, name: str) -> bytes:
        """Return a file's content; that of the last file is not read again."""
        if self._last is None or self._last[0] != name:
            self._last = None  # two large files are not in memory at once
            content = self._source.read(name)
            self._last = (name, content, hashlib.blake2b(content, digest_size=_HASH_BYTES).hexdigest())
        return self._last[1]

    def path(self, name: str) -> Path | None:
        """Return where a file is on this disk; None where it is elsewhere."""
        return self._source.path(name)

    def content(self, name: str) -> str | None:
        """Return the hash of a file's bytes, 32 hexadecimal digits; None unless it was the last one that was read."""
        return self._last[2] if self._last is not None and self._last[0] == name else None
