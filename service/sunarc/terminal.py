"""What commands print: JSON and tables."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from typing import Any

from rich.table import Table


def print_json(value: Any) -> None:  # noqa: ANN401 - whatever JSON holds
    """Print a value as JSON; NaN is a bug."""
    print(json.dumps(value, indent=1, allow_nan=False))  # noqa: T201 - printing is its work


def table(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> Table:
    """Return a table; None is an empty cell, a float has three places."""
    made = Table(*columns)
    for row in rows:
        made.add_row(*("" if cell is None else f"{cell:.3f}" if isinstance(cell, float) else str(cell) for cell in row))
    return made
