"""Rows spread evenly over a sequence, picked from a table, and stacked again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from sunarc.common.array_types import FloatArray, IntArray, even_parts, evenly_spread, picked, stacked


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


@pytest.mark.parametrize("size", [0, 1, 2, 3, 7, 8, 455])
@pytest.mark.parametrize("most", [2, 3])
def test_halves_and_thirds_are_those_of_numpy(size: int, most: int) -> None:
    parts = even_parts(np.arange(size), most=most)
    split = [part.tolist() for part in np.array_split(np.arange(size), most) if part.size]
    assert [np.flatnonzero(parts == part).tolist() for part in np.unique(parts)] == split


@pytest.mark.parametrize("n_days", [1, 4, 5, 17])
def test_days_are_never_parted(n_days: int) -> None:
    day = np.repeat(15_800 + 3 * np.arange(n_days), np.arange(1, n_days + 1))
    parts = even_parts(day, most=5)
    assert parts.max() + 1 == min(n_days, 5)
    days_of = [np.unique(day[parts == part]) for part in np.unique(parts)]
    np.testing.assert_array_equal(np.concatenate(days_of), np.unique(day))
    assert max(map(len, days_of)) - min(map(len, days_of)) <= 1


@dataclass(frozen=True)
class Table:
    """Columns of one and of two values a row."""

    number: IntArray
    place: FloatArray


def test_rows_that_were_picked_are_stacked_in_the_order_of_the_parts() -> None:
    table = Table(number=np.arange(5), place=np.arange(10.0).reshape(5, 2))
    again = stacked([picked(table, slice(3, None)), picked(table, slice(0, 0)), picked(table, slice(0, 3))])
    assert again.number.tolist() == [3, 4, 0, 1, 2]
    np.testing.assert_array_equal(again.place, table.place[again.number])
