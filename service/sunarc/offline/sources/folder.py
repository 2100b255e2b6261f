"""A folder of files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from sunarc.offline.sources.values import SourceFile


@dataclass(frozen=True, slots=True)
class Folder:
    """The files below a folder, or a single file; see `ImageSource`."""

    address: str

    def files(self) -> Iterator[SourceFile]:
        """Yield all files below it; stamped with the time of their last change."""
        root = Path(self.address)
        paths = [root] if root.is_file() else sorted(root.rglob("*"))
        for path in paths:
            if path.is_file():
                state = path.stat()
                name = path.relative_to(self._root).as_posix()
                yield SourceFile(name, state.st_size, str(state.st_mtime_ns))

    def read(self, name: str) -> bytes:
        """Return a file's content."""
        return self.path(name).read_bytes()

    def path(self, name: str) -> Path:
        """Return where a file is."""
        return self._root / name

    @property
    def _root(self) -> Path:
        root = Path(self.address)
        return root.parent if root.is_file() else root
