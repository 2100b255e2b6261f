"""Rows that repeat and bits that do not change, in images of every type."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sunarc.imaging.transfer_faults import count_missing_levels, repeated_rows

NOISE = np.random.default_rng(1).integers(20, 236, (64, 80))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int16, np.uint32])
def test_levels_of_four_bits_are_counted_and_those_of_eight_are_sound(dtype: Any) -> None:  # noqa: ANN401 - a type
    assert count_missing_levels((NOISE & 0xF0).astype(dtype)) == (17 if dtype is np.uint8 else 15)
    assert count_missing_levels(NOISE.astype(dtype)) == 0


def test_counts_below_zero_and_floats_are_no_fault() -> None:
    assert count_missing_levels((NOISE - 100).astype(np.int16)) == 0  # type: ignore[arg-type]
    assert count_missing_levels(NOISE.astype(np.float32)) == 0  # type: ignore[arg-type]


@pytest.mark.parametrize("colours", [1, 3])
def test_rows_that_repeat_are_counted_where_they_have_structure(colours: int) -> None:
    image = np.repeat(NOISE[..., None], colours, axis=-1).squeeze().astype(np.uint8)
    assert repeated_rows(image) == 0
    image[40:] = image[40]
    assert repeated_rows(image) == 24
    image[40:] = 255
    assert repeated_rows(image) == 0
