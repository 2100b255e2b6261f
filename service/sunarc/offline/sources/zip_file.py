"""The files in a zip archive, read in place."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

from sunarc.errors import InputError
from sunarc.offline.sources.values import SourceFile


@dataclass(frozen=True, slots=True)
class ZipFile:
    """The files in a zip archive; see `ImageSource`."""

    address: str

    def files(self) -> Iterator[SourceFile]:
        """Yield all files in it; stamped with the checksum of their content."""
        for info in sorted(_opened(self.address).infolist(), key=lambda one: one.filename):
            if not info.is_dir():
                yield SourceFile(info.filename, info.file_size, f"{info.CRC:08x}")

    def read(self, name: str) -> bytes:
        """Return a file's content."""
        try:
            return _opened(self.address).read(name)
        except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, KeyError) as error:
            raise OSError(f"{type(error).__name__}: {error}") from None

    def path(self, name: str) -> None:
        """Return None: it is within the archive."""
        del name


@cache  # the directory of a large archive takes seconds to read, and a process reads it once
def _opened(address: str) -> zipfile.ZipFile:
    try:
        return zipfile.ZipFile(address)
    except (zipfile.BadZipFile, OSError) as error:
        raise InputError(field=address, problem=f"is no whole zip archive ({error})", remedy="copy it again") from None
