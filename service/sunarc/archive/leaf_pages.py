"""Rows of a SQLite table whose inner pages are broken, read from its leaf pages themselves.

Reference: "Database File Format", https://www.sqlite.org/fileformat2.html, sections 1.3 to 2.1.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

Value = int | float | str | bytes | None

_LEAF = 13  # of a table's b-tree
_FIRST_TRUNK = 32
_BYTES = (0, 1, 2, 3, 4, 6, 8, 8, 0, 0)
"""Of the serial types 0 to 9."""
_FITS: dict[str, tuple[type, ...]] = {"TEXT": (str,), "REAL": (int, float), "INTEGER": (int,), "BLOB": (bytes,)}


class Column(NamedTuple):
    """A column: its name, its declared type, whether it may not be NULL, and whether it is the row id."""

    name: str
    type: str
    required: bool
    is_rowid: bool


def leaf_rows(path: Path, columns: tuple[Column, ...]) -> Iterator[tuple[Value, ...]]:
    """Yield the rows of a database's leaf pages that have these columns; pages that cannot be read are left out.

    Parameters
    ----------
    path : the database, its write-ahead log copied into it.
    columns : of the table; rows of another number of columns or of other types are another table's.
    """
    data = path.read_bytes()
    size = int.from_bytes(data[16:18], "big")
    size = 65_536 if size == 1 else size
    free = set(_free_pages(data, size))
    for number in range(2, len(data) // size + 1):
        page = data[(number - 1) * size : number * size]
        if number in free or page[0] != _LEAF:
            continue
        for cell in range(int.from_bytes(page[3:5], "big")):
            try:
                row = _row(data, page, int.from_bytes(page[8 + 2 * cell : 10 + 2 * cell], "big"), columns, size)
            except (IndexError, struct.error, ValueError):
                continue
            if row is not None:
                yield row


def _free_pages(data: bytes, size: int) -> Iterator[int]:
    trunk = int.from_bytes(data[_FIRST_TRUNK : _FIRST_TRUNK + 4], "big")
    for _ in range(len(data) // size):  # a broken list may be a ring
        if not 0 < trunk <= len(data) // size:
            return
        yield trunk
        page = data[(trunk - 1) * size : trunk * size]
        count = min(int.from_bytes(page[4:8], "big"), size // 4 - 2)
        yield from struct.unpack_from(f">{count}I", page, 8)
        trunk = int.from_bytes(page[:4], "big")


def _row(data: bytes, page: bytes, at: int, columns: tuple[Column, ...], size: int) -> tuple[Value, ...] | None:
    """Return the row of a cell; None where it is not of these columns."""
    length, at = _varint(page, at)
    rowid, at = _varint(page, at)
    record = _payload(data, page, at, length, size)
    header, place = _varint(record, 0)
    values: list[Value] = []
    offset = header
    while place < header:
        kind, place = _varint(record, place)
        count = _BYTES[kind] if kind < len(_BYTES) else (kind - 12) // 2
        values.append(_value(kind, record[offset : offset + count], count))
        offset += count
    if len(values) != len(columns):
        return None
    row = tuple(rowid if column.is_rowid else value for column, value in zip(columns, values, strict=True))
    return row if all(map(_fits, row, columns)) else None


def _fits(value: Value, column: Column) -> bool:
    if value is None:
        return not column.required
    kinds = next((kinds for name, kinds in _FITS.items() if column.type.startswith(name)), None)
    return kinds is None or isinstance(value, kinds)


def _value(kind: int, stored: bytes, count: int) -> Value:
    if len(stored) != count:
        raise ValueError("cut short")
    if kind == 0:
        return None
    if kind == 7:
        return float(struct.unpack(">d", stored)[0])
    if kind < 10:
        return kind - 8 if kind >= 8 else int.from_bytes(stored, "big", signed=True)
    return stored.decode("utf-8", "replace") if kind % 2 else stored


def _payload(data: bytes, page: bytes, at: int, length: int, size: int) -> bytes:
    """Return a cell's payload, with what of it lies on overflow pages (section 1.6)."""
    most, least = size - 35, (size - 12) * 32 // 255 - 23
    if length <= most:
        return page[at : at + length]
    here = least + (length - least) % (size - 4)
    here = here if here <= most else least
    parts, left = [page[at : at + here]], length - here
    following = int.from_bytes(page[at + here : at + here + 4], "big")
    while left > 0 and 0 < following <= len(data) // size:
        overflow = data[(following - 1) * size : following * size]
        parts.append(overflow[4 : 4 + left])
        left -= len(parts[-1])
        following = int.from_bytes(overflow[:4], "big")
    return b"".join(parts)


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """Return a variable-length integer and the place after it (section 1.6)."""
    value = 0
    for count in range(9):
        byte = data[at + count]
        if count == 8:
            value = value << 8 | byte
            break
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            break
    return value - (1 << 64) if value >= 1 << 63 else value, at + count + 1
