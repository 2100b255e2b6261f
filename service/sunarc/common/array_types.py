"""Names of the array types, and rows of a table of columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
NameArray = NDArray[np.str_]
Image = NDArray[np.uint8] | NDArray[np.uint16]
"""An image as the sensor counted it, (height, width)."""

Rows = slice | BoolArray | IntArray
"""Some rows of a column: a slice, a mask or an index."""
_Table = TypeVar("_Table")


def evenly_spread(size: int, *, most: int) -> IntArray:
    """Return the rows of at most so many of a sequence, spread evenly over it, the first and the last with them."""
    return np.linspace(0, size - 1, min(size, most)).round().astype(np.int64)


def even_parts(values: IntArray, *, most: int) -> IntArray:
    """Return (n,): part numbers from 0, at most `most`, each a run of about as many distinct values.

    Of days they are runs of whole days; of the rows of a record halves or thirds of it.
    """
    distinct, number = np.unique(values, return_inverse=True)
    return np.asarray(number * min(distinct.size, most) // max(distinct.size, 1))


def picked(table: _Table, which: Rows) -> _Table:
    """Return a frozen dataclass of columns, each (n, ...), with some of its rows."""
    columns: Any = table
    rows: _Table = replace(columns, **{field.name: getattr(table, field.name)[which] for field in fields(columns)})
    return rows


def stacked(parts: Sequence[_Table]) -> _Table:
    """Return a frozen dataclass of columns (n, ...) with the rows of several such, in their order."""
    columns: Any = parts[0]
    names = [one.name for one in fields(columns) if isinstance(getattr(columns, one.name), np.ndarray)]
    rows: _Table = replace(columns, **{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})
    return rows
