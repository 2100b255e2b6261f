"""What commands print: JSON and tables."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from typing import Any

from rich.table import Table

_NAME_CHARACTERS = 40  # half of a terminal's usual width


def print_json(value: Any) -> None:  # noqa: ANN401 - whatever JSON holds
    """Print a value as JSON; NaN is a bug."""
    print(json.dumps(value, indent=1, allow_nan=False))


def table(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> Table:
    """Return a table; None is an empty cell, a float has three places.

    The first column names a row; where the names are short (ids), a narrow terminal breaks the other columns first.
    """
    cells = [
        ["" if cell is None else f"{cell:.3f}" if isinstance(cell, float) else str(cell) for cell in row]
        for row in rows
    ]
    made = Table(*columns)
    for column in made.columns:
        column.overflow = "fold"  # a narrow terminal breaks a cell, and cuts none
    if columns and max((len(row[0]) for row in cells), default=0) <= _NAME_CHARACTERS:
        made.columns[0].no_wrap = True
        made.columns[0].overflow = "ignore"
    for row in cells:
        made.add_row(*row)
    return made
