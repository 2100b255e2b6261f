"""Smear of an interline CCD, estimated from the rows beyond a window."""

from __future__ import annotations

import numpy as np
import pytest
from tests.detection.rendering import FloatArray, Image

from sunarc.detection.disc.window import column_excess, column_smear


def frame(smear: FloatArray, *, rows: int = 800, noise: float = 2.0, seed: int = 0) -> Image:
    """Return counts of 100 with noise and the smear of each column."""
    rng = np.random.default_rng(seed)
    return np.rint(100.0 + smear + rng.normal(0.0, noise, (rows, smear.size))).astype(np.uint16)


def peak(height: float, columns: int = 30) -> FloatArray:
    return np.asarray(height * np.exp(-0.5 * ((np.arange(columns) - 14.0) / 2.0) ** 2))


def estimated(image: Image, *, mosaic: bool = False) -> FloatArray:
    return column_smear(image, x0=5, x1=25, y0=390, y1=411, mosaic=mosaic)


def test_the_smear_of_every_row_is_that_of_the_columns_beyond() -> None:
    found = estimated(frame(peak(60.0)))
    assert found.shape == (21, 20)
    assert found == pytest.approx(np.broadcast_to(peak(60.0)[5:25], found.shape), abs=1.5)
    assert found.min() == 0.0


def test_what_lies_within_the_window_does_not_count() -> None:
    image = frame(peak(60.0))
    image[390:411] = 4000
    assert estimated(image) == pytest.approx(estimated(frame(peak(60.0))), abs=1.0)


def test_a_sensor_without_smear_loses_nothing() -> None:
    for seed in range(10):
        assert estimated(frame(peak(0.0), seed=seed)).max() <= 2.0  # medians of counts are rounded


@pytest.mark.parametrize(("height", "found"), [(10.0, False), (60.0, True)])
def test_smear_is_subtracted_where_it_stands_out_of_the_noise(height: float, *, found: bool) -> None:
    assert estimated(frame(peak(height), noise=30.0)).any() == found


def test_even_and_odd_rows_of_a_mosaic_have_their_own() -> None:
    image = frame(peak(0.0), noise=0.5)
    image[::2] += np.rint(peak(80.0)).astype(np.uint16)
    found = estimated(image, mosaic=True)
    assert found[::2] == pytest.approx(np.broadcast_to(peak(80.0)[5:25], (11, 20)), abs=1.5)  # row 390 is even
    assert not found[1::2].any()


@pytest.mark.parametrize(("rows", "found"), [(248, False), (249, True)])
def test_eight_rows_beyond_the_window_every_32_are_needed(rows: int, *, found: bool) -> None:
    image = frame(peak(60.0), rows=rows, noise=0.2)
    assert column_smear(image, x0=5, x1=25, y0=0, y1=21, mosaic=False).any() == found


def test_an_empty_window_has_no_smear() -> None:
    assert column_smear(frame(peak(60.0)), x0=5, x1=5, y0=0, y1=9, mosaic=False).shape == (9, 0)


@pytest.mark.parametrize("rows", [8, 9, 12, 13])
def test_the_excess_of_a_column_is_its_median_above_the_lowest(rows: int) -> None:
    image = frame(peak(300.0), rows=rows, noise=20.0)
    median = np.median(image, axis=0)
    np.testing.assert_allclose(column_excess(image), median - median.min(), atol=1e-12)
