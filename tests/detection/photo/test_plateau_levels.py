"""Plateaus of the lowest level, and their place in an image that is searched reduced."""

from __future__ import annotations

import numpy as np
import pytest

from sunarc.detection.photo.plateau import plateaus


@pytest.mark.parametrize(("count", "n_found"), [(0, 0), (1, 1), (2, 1)])
def test_a_plateau_of_one_count_is_the_lowest(count: int, n_found: int) -> None:
    rows, columns = np.mgrid[:60, :80]
    plane = np.where(np.hypot(columns - 30.0, rows - 25.0) < 8.0, count, 0).astype(np.uint8)
    found = plateaus(plane, least_level=0.0)
    assert [each.level for each in found] == [float(count)] * n_found
    for each in found:
        assert (each.x, each.y) == pytest.approx((30.0, 25.0), abs=0.1)


@pytest.mark.parametrize(("x", "y"), [(400, 300), (121, 555)])
def test_the_middle_of_four_pixels_is_one_and_a_half_beyond_the_first(x: int, y: int) -> None:
    """Four pixels of the image are one of the search's, so that the disc is symmetric about that one's middle."""
    rows, columns = np.mgrid[:900, :960]
    disc = np.where(np.hypot(columns - x, rows - y) < 10.0, 250, 20).astype(np.uint8)
    (found,) = plateaus(disc.repeat(4, axis=0).repeat(4, axis=1), least_level=100.0)
    assert (found.x, found.y) == pytest.approx((4 * x + 1.5, 4 * y + 1.5), abs=0.1)
    assert found.radius == pytest.approx(40.0, abs=4.0)
