"""MATLAB files of version 5: written by scipy, read here, as scipy's reader ends the process on some damaged ones.

Reference: MathWorks, "MAT-File Format", for versions 5 and 7: elements with a tag of type and length, compressed ones,
arrays of numbers and structs.
"""

from __future__ import annotations

import io
import math
import zlib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.io
from numpy.typing import NDArray

_HEADER = b"MATLAB 5.0 MAT-file, written by sunarc".ljust(116)
"""Text of a file: its first 116 bytes."""
_BEGIN = 128
_ORDERS = {b"IM": "<", b"MI": ">"}
"""Of bytes, by the mark at the header's end."""
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Types of an element of numbers."""
_MATRIX, _COMPRESSED = 14, 15
_STRUCT, _FIRST_NUMERIC, _LAST_NUMERIC = 2, 6, 15
_MOST_BYTES = 2**30
"""Of one variable, decompressed."""
_DEEPEST = 8

Variable = NDArray[Any] | list["Variable"]
"""An array, or the members of a struct in the order of the file."""


def matlab_bytes(content: Mapping[str, Any]) -> bytes:
    """Return a MATLAB file (version 5) of variables by name; a mapping is written as a struct.

    The same variables give the same bytes: the header's text, which has the time of writing, is replaced.
    """
    target = io.BytesIO()
    scipy.io.savemat(target, dict(content), do_compression=True)  # type: ignore[arg-type]
    return _HEADER + target.getvalue()[len(_HEADER) :]


def read_variables(content: bytes, names: Collection[str]) -> dict[str, Variable]:
    """Return the named variables of a file; the others are not read.

    Raises
    ------
    ValueError
        It is no such file, is damaged, or a named variable is missing or neither of real numbers nor a struct.
    """
    order = _ORDERS.get(content[_BEGIN - 2 : _BEGIN])
    if order is None:
        raise ValueError("no header of version 5")
    found: dict[str, Variable] = {}
    for element in _split_elements(memoryview(content)[_BEGIN:], order):
        whole = _decompress(element) if element.kind == _COMPRESSED else element.data
        for one in _split_elements(whole, order) if element.kind == _COMPRESSED else (element,):
            parts = _split_elements(one.data, order)
            flags, shape, name = _read_array_head(parts, order)
            if one.kind == _MATRIX and name in names:
                found[name] = _read_array(flags, shape, parts, order, depth=1)
    if missing := sorted(set(names) - set(found)):
        raise ValueError(f"no {' and '.join(missing)}")
    return found


@dataclass(frozen=True, slots=True)
class _Element:
    kind: int
    data: memoryview


def _split_elements(data: memoryview, order: str) -> Iterator[_Element]:
    """Yield the elements that lie one after another."""
    place = 0
    while place < len(data):
        kind, size = np.frombuffer(data, dtype=f"{order}u4", count=2, offset=place).tolist()
        begin, length = place + 8, 8 + size
        if kind >> 16:  # a small one, its data within the tag
            kind, size, begin, length = kind & 0xFFFF, kind >> 16, place + 4, 8
        elif kind != _COMPRESSED:
            length += -size % 8
        if begin + size > min(place + length, len(data)):
            raise ValueError("an element is longer than what holds it")
        yield _Element(kind, data[begin : begin + size])
        place += length


def _decompress(element: _Element) -> memoryview:
    stream = zlib.decompressobj()
    try:
        whole = stream.decompress(element.data, _MOST_BYTES)
    except zlib.error as error:
        raise ValueError(str(error)) from None
    if not stream.eof:
        raise ValueError("a compressed variable is cut off, or too large")
    return memoryview(whole)


def _read_array_head(parts: Iterator[_Element], order: str) -> tuple[int, tuple[int, ...], str]:
    """Return an array's flags, shape and name."""
    flags, shape, name = (next(parts, _Element(0, memoryview(b""))) for _ in range(3))
    lengths = tuple(_read_numbers(shape, order).tolist())
    if not lengths or not all(isinstance(length, int) and length >= 0 for length in lengths):
        raise ValueError("an array without a shape")
    return int(_read_numbers(flags, order)[:1].sum()), lengths, bytes(name.data).decode("ascii")


def _read_numbers(element: _Element, order: str) -> NDArray[Any]:
    if element.kind not in _NUMBERS:
        raise ValueError(f"an element of numbers is of type {element.kind}")
    return np.frombuffer(element.data, dtype=order + _NUMBERS[element.kind])


def _read_array(flags: int, shape: tuple[int, ...], parts: Iterator[_Element], order: str, *, depth: int) -> Variable:
    """Return an array whose flags, shape and name were read."""
    kind, n = flags & 0xFF, math.prod(shape)
    if kind == _STRUCT and depth < _DEEPEST:
        next(parts, None), next(parts, None)  # the length and the names of its fields
        return [_read_member(part, order, depth=depth + 1) for part in parts]
    if not _FIRST_NUMERIC <= kind <= _LAST_NUMERIC or flags & 0x0800:
        raise ValueError("a variable is not of real numbers")
    values = _read_numbers(next(parts, _Element(0, memoryview(b""))), order)
    if len(values) != n:
        raise ValueError("an array is not as long as its shape says")
    return values.reshape(shape, order="F")


def _read_member(element: _Element, order: str, *, depth: int) -> Variable:
    parts = _split_elements(element.data, order)
    if element.kind != _MATRIX:
        raise ValueError("a member is no array")
    flags, shape, _ = _read_array_head(parts, order)
    return _read_array(flags, shape, parts, order, depth=depth)
