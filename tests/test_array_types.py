"""Rows spread evenly over a sequence."""

from __future__ import annotations

import numpy as np
import pytest

from sunarc.array_types import evenly_spread


@pytest.mark.parametrize("size", [0, 1, 2, 7, 60, 61, 1000])
@pytest.mark.parametrize("most", [1, 2, 6, 60])
def test_rows_are_spread_evenly_from_the_first_to_the_last(size: int, most: int) -> None:
    rows = evenly_spread(size, most=most)
    assert rows.size == min(size, most)
    assert np.all(np.diff(rows) >= 1)
    if rows.size > 1:
        assert (rows[0], rows[-1]) == (0, size - 1)
        # rounding moves each row by half a step at most
        assert np.ptp(np.diff(rows)) <= 1
    elif size:
        assert rows.tolist() == [0]
