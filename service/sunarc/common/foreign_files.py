"""Files that others made: opened only where they are regular and of a bounded size; their names as text.

A name is bytes to the system, and any bytes but NUL and "/". Here it is a text that JSON, HTML, a line of the journal,
SQLite and PostgreSQL take as it is: `name_text` makes it at the edge, and `name_path` gives the system its bytes back.
"""

from __future__ import annotations

import errno
import os
import re
import stat
from pathlib import Path
from typing import BinaryIO

MOST_BYTES = 1 << 30
"""Size of a file that is still read: larger ones are no images, and would take a worker's memory."""
MOST_SECRET_BYTES = 1 << 16
"""Size of a file that holds a token or a password."""
MOST_SETTINGS_BYTES = 1 << 20
"""Size of a file of settings."""
_FLAGS = os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC
"""A pipe without a writer does not block, and a terminal does not become the process's own."""


class UnfitFileError(OSError):
    """Error of a file that is never read: not a regular one, or too large."""


def open_regular(path: Path) -> BinaryIO:
    """Open a file for reading; links are followed.

    Raises
    ------
    UnfitFileError : it is a pipe, a socket, a device or a folder.
    OSError : it cannot be opened.
    """
    require_regular(path.stat(), path)  # before it is opened: that alone winds a tape
    descriptor = os.open(path, _FLAGS)
    try:
        require_regular(os.fstat(descriptor), path)
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def read_regular(path: Path, *, most_bytes: int = MOST_BYTES) -> bytes:
    """Return the content of a file; see `open_regular`. UnfitFileError also where it is, or grows, larger."""
    with open_regular(path) as file:
        is_larger = os.fstat(file.fileno()).st_size > most_bytes
        content = b"" if is_larger else file.read(most_bytes + 1)
    if is_larger or len(content) > most_bytes:
        raise UnfitFileError(errno.EFBIG, f"larger than {most_bytes} bytes", str(path))
    return content


def is_regular(path: Path) -> bool:
    """Return whether a path is that of a regular file; one that the system does not take is of none."""
    try:
        return stat.S_ISREG(path.stat().st_mode)
    except OSError:
        return False


def require_regular(state: os.stat_result, path: Path | str) -> None:
    """Raise UnfitFileError where a state is not that of a regular file."""
    if not stat.S_ISREG(state.st_mode):
        raise UnfitFileError(errno.EINVAL, "not a regular file", str(path))


_UNPRINTABLE = re.compile(
    "[\\x00-\\x1f\\x7f-\\x9f\\u061c\\u200e\\u200f\\u2028-\\u202e\\u2066-\\u2069\\ud800-\\udfff\\ufeff]"
    r"|\\(?=x[0-9a-f]{2})"
)
"""Control characters, marks of another direction, bytes that are not UTF-8, and a backslash that would be read."""
_BYTE = re.compile(rb"\\x([0-9a-f]{2})")


def name_text(name: str | os.PathLike[str]) -> str:
    r"""Return a file's name, or a path, as a text without control characters; `name_path` reverts it.

    A byte that is not UTF-8, or of a control character, is written as `\xff`; of other names the text is the name.
    """
    text = os.fsencode(name).decode("utf-8", "surrogateescape")
    return _UNPRINTABLE.sub(lambda found: _escape_bytes(found[0]), text)


def name_path(text: str) -> str:
    """Return the name that a text of `name_text` stands for, as the functions of `os` take it."""
    return os.fsdecode(_BYTE.sub(lambda found: bytes.fromhex(found[1].decode()), text.encode()))


def _escape_bytes(character: str) -> str:
    return "".join(f"\\x{byte:02x}" for byte in character.encode("utf-8", "surrogateescape"))
