"""The header of a .npy file, read by the grammar that numpy writes; no part of it is evaluated as Python.

The format is numpy.lib.format's: a magic string, two version bytes, the header's length (little-endian, two bytes in
version 1, four in versions 2 and 3), and one line that looks like a Python dictionary with exactly the keys ``descr``,
``fortran_order`` and ``shape``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

_MAGIC = b"\x93NUMPY"
_LENGTH_BYTES = {1: 2, 2: 4, 3: 4}
_MAX_HEADER_BYTES = 10_000  # numpy.load's own limit; the header of a plain array has about a hundred
_MAX_DIMENSIONS = 64  # numpy's own limit

_KEY = re.compile(r" *'(descr|fortran_order|shape)' *: *")
_VALUES = {
    "descr": re.compile(r"'([<>|=]?[A-Za-z][0-9]{0,10}(?:\[[0-9A-Za-z]{1,16}\])?)'"),
    "fortran_order": re.compile(r"(True|False)"),
    "shape": re.compile(r"\(((?: *[0-9]{1,19} *,)*+(?: *[0-9]{1,19})?+ *)\)"),
}
_COMMA = re.compile(r" *, *")
_END = re.compile(r" *} *\n?")
_NUMERIC = re.compile(r"[<>|=]?(?:[iufc][0-9]{1,2}|b1)")


class NpyHeaderError(ValueError):
    """The bytes do not begin with the header of a plain array."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NpyHeader:
    """What a .npy file says of its array.

    Attributes
    ----------
    descr : the type as it is written, "<f8".
    fortran_order : whether the first index varies fastest.
    shape : lengths of the dimensions.
    offset : index of the first byte after the header.
    """

    descr: str
    fortran_order: bool
    shape: tuple[int, ...]
    offset: int

    @property
    def dtype(self) -> np.dtype[np.generic] | None:
        """The type as numpy's; None for all but booleans, integers and floating-point numbers."""
        if not _NUMERIC.fullmatch(self.descr):
            return None
        try:
            return np.dtype(self.descr)
        except TypeError:  # a size that no number has
            return None


def read_npy_header(body: bytes) -> NpyHeader:
    """Return the header of a .npy file of version 1, 2 or 3.

    Parameters
    ----------
    body : the file, or its first bytes.

    Raises
    ------
    NpyHeaderError : it is cut short, longer than 10 000 bytes, or is not of the grammar; arrays of structured types,
        which numpy describes by a list, are among these.
    """
    if body[: len(_MAGIC)] != _MAGIC:
        raise NpyHeaderError("does not begin as a .npy file")
    size = _LENGTH_BYTES.get(body[6] if len(body) > 6 else 0)
    if size is None or body[7:8] != b"\0":
        raise NpyHeaderError("is of no known version")
    start = 8 + size
    length = int.from_bytes(body[8:start], "little")
    if length > _MAX_HEADER_BYTES or len(body) < start + length:
        raise NpyHeaderError("has a header that is cut short, or too long")
    try:
        text = body[start : start + length].decode("ascii")
    except UnicodeDecodeError:
        raise NpyHeaderError("has a header that is not of a plain array") from None
    found = _dictionary(text)
    return NpyHeader(
        descr=found["descr"],
        fortran_order=found["fortran_order"] == "True",
        shape=_shape(found["shape"]),
        offset=start + length,
    )


def _dictionary(text: str) -> dict[str, str]:
    """Return the three entries as they are written; in any order, as the format's definition allows."""
    found: dict[str, str] = {}
    if not text.startswith("{"):
        raise NpyHeaderError("has a header that is no dictionary")
    position = 1
    while key := _KEY.match(text, position):
        name = key[1]
        value = _VALUES[name].match(text, key.end())
        if value is None or name in found:
            raise NpyHeaderError(f"has a header whose {name} is not understood")
        found[name] = value[1]
        comma = _COMMA.match(text, value.end())
        position = value.end() if comma is None else comma.end()
        if comma is None:
            break
    if len(found) != len(_VALUES) or not _END.fullmatch(text, position):
        raise NpyHeaderError("has a header that is not of a plain array")
    return found


def _shape(text: str) -> tuple[int, ...]:
    """Return the lengths; "3" alone, without its comma, is a number and no shape."""
    lengths = tuple(int(part) for part in text.split(",") if part.strip())
    if (len(lengths) == 1 and "," not in text) or len(lengths) > _MAX_DIMENSIONS or text.strip() == ",":
        raise NpyHeaderError("has a header whose shape is not understood")
    if any(length > np.iinfo(np.int64).max for length in lengths):
        raise NpyHeaderError("has a header whose shape is not understood")
    return lengths
