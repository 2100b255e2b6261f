"""Files of a source, the images in them, and the refusal of those that cannot be used."""

from __future__ import annotations

import gzip
import io
import os
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from errno import EFBIG
from pathlib import Path
from typing import BinaryIO, NamedTuple, Protocol

from sunarc.common.errors import InputError
from sunarc.common.findings import Finding, FindingError
from sunarc.common.foreign_files import MOST_BYTES, UnfitFileError


class SourceFile(NamedTuple):
    """A file of a source: its name below the source, its size in bytes, and a stamp that changes with its content."""

    name: str
    size: int
    stamp: str


UPRIGHT_ADDRESS = "exif:"
"""Before the address of a source whose pictures are turned as their EXIF orientation states."""


def stored_address(address: str) -> str:
    """Return the address of the same source, whose pictures are read as they are stored."""
    return address.removeprefix(UPRIGHT_ADDRESS)


class ImageSource(Protocol):
    """Files that can be listed and read, in any number of processes at once.

    Attributes
    ----------
    address : what `open_source` opens it by.
    """

    @property
    def address(self) -> str:
        """Address that `open_source` opens it by."""

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


class FileImage(NamedTuple):
    """An image in a file: its number there, its mid-exposure time (aware, UTC) and exposure, None where not known."""

    number: int
    time: datetime | None = None
    exposure_us: float | None = None


NOT_READ = "file_not_read"


def unreadable(name: str, error: str) -> FindingError:
    """Return the refusal of a file that is no image, with the reader that was tried."""
    return FindingError(name, Finding("file_not_image", {"error": error}))


def not_read(name: str, error: OSError) -> FindingError:
    """Return the refusal of a file that cannot be read: one that is there may be readable later."""
    text = error.strerror or str(error)
    if isinstance(error, FileNotFoundError | NotADirectoryError | UnfitFileError):
        return unreadable(name, text)
    return FindingError(name, Finding(NOT_READ, {"error": text}))


def require_size(shape: tuple[int, ...], name: str, size: tuple[int, int] | None) -> None:
    """Refuse an image, (rows, columns[, colours]), that has another size than it must have.

    Raises
    ------
    FindingError : it has.
    """
    height, width = shape[:2]
    if size is not None and (width, height) != size:
        sizes = {"width": width, "height": height, "camera_width": size[0], "camera_height": size[1]}
        raise FindingError(name, Finding("file_size_differs", sizes))


@contextmanager
def refusing(name: str, what: str) -> Iterator[None]:
    """Refuse a file that a library does not bear: of damaged ones each raises errors of any kind."""
    try:
        yield
    except InputError:
        raise
    except EOFError:  # of a compressed file
        raise FindingError(name, Finding("file_truncated")) from None
    except UnfitFileError as error:
        raise not_read(name, error) from None
    except Exception as error:  # noqa: BLE001 - of any kind
        raise unreadable(name, f"{what} ({type(error).__name__})") from None


# Files as they are opened, inflated where they are compressed by gzip.

MOST_PIXELS = 100_000_000
"""Of an image that a running service decodes: its camera has the size that it always has."""
_RATIO, _LEAST_INFLATED = 100, 1 << 26
"""A compressed file is inflated to so many times its size, or so many bytes: images do not compress further."""


def read_content(source: ImageSource, name: str) -> bytes:
    """Return a file's content as it is stored; FindingError where it cannot be read."""
    try:
        return source.read(name)
    except OSError as error:
        raise not_read(name, error) from None


@contextmanager
def opened(source: ImageSource, name: str) -> Iterator[BinaryIO]:
    """Open a file for reading forwards; one whose name ends with .gz is inflated as it is read.

    Raises
    ------
    FindingError : it cannot be read, it is damaged, or it inflates to far more than images do.
    """
    content = io.BytesIO(read_content(source, name))
    try:
        yield Inflated(content) if name.lower().endswith(".gz") else content  # type: ignore[misc] # what is read of it
    except EOFError:
        raise FindingError(name, Finding("file_truncated")) from None
    except (gzip.BadGzipFile, zlib.error) as error:
        raise unreadable(name, f"no sound gzip file ({type(error).__name__})") from None
    except OSError as error:
        raise not_read(name, error) from None


class Inflated(io.RawIOBase):
    """The content of a gzip file, of which a bounded number of bytes is inflated.

    Raises UnfitFileError where more is asked for.

    Parameters
    ----------
    file : that is compressed.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._inflated, self._at = gzip.GzipFile(fileobj=file), 0
        self._left = min(max(_RATIO * file.seek(0, os.SEEK_END), _LEAST_INFLATED), MOST_BYTES)
        file.seek(0)

    def readable(self) -> bool:
        """Return True."""
        return True

    def seekable(self) -> bool:
        """Return True: backwards it is inflated from its beginning."""
        return True

    def tell(self) -> int:
        """Return how many bytes are before this place."""
        return self._at

    def readinto(self, buffer: bytearray) -> int:  # type: ignore[override] # what is written to
        """Fill a buffer, and return by how much."""
        part = self._inflated.read(len(buffer))
        self._left -= len(part)
        if self._left < 0:
            raise UnfitFileError(EFBIG, "it inflates to far more than images do")
        buffer[: len(part)] = part
        self._at += len(part)
        return len(part)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a place, at most to the end."""
        target = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: 0}[whence]
        if whence == os.SEEK_END:
            while self.read(_PART):
                pass
            target += self._at
        if target < self._at:
            self._inflated.rewind()
            self._left, self._at = self._left + self._at, 0
        while self._at < target and self.read(min(target - self._at, _PART)):
            pass
        return self._at


_PART = 1 << 20
