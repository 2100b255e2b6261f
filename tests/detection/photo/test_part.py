"""The window about a predicted place: the same pixels as the whole plane's, and room for a plateau's light."""

from __future__ import annotations

import numpy as np
import pytest

from sunarc.detection.photo.candidates import faintest_plane, part_near, whole_part
from sunarc.detection.values import Bayer, Expectation

RNG = np.random.default_rng(2)
COLOUR = RNG.integers(0, 256, (700, 900, 3), dtype=np.uint8)
MOSAIC = RNG.integers(0, 4096, (701, 901), dtype=np.uint16)


@pytest.mark.parametrize(("x", "y"), [(450.0, 350.0), (0.0, 0.0), (899.0, 699.0), (-80.0, 300.0), (2000.0, 90.0)])
@pytest.mark.parametrize("bayer", [None, "RGGB"])
@pytest.mark.parametrize("complete", [False, True])
def test_a_window_is_a_part_of_the_whole_plane(x: float, y: float, bayer: Bayer | None, *, complete: bool) -> None:
    image = COLOUR if bayer is None else MOSAIC
    static = RNG.random((100, 130)) > 0.7
    whole = whole_part(image, static=static, bayer=bayer)
    expectation = Expectation(x_px=x, y_px=y, uncertainty_px=3.0)
    part = part_near(image, expectation, step=6, static=static, bayer=bayer, complete=complete)
    rows, columns = part.plane.shape
    window = slice(part.top, part.top + rows), slice(part.left, part.left + columns)
    assert part.static is not None
    assert whole.static is not None
    assert np.array_equal(part.plane, whole.plane[window])
    assert np.array_equal(part.static, whole.static[window])
    assert (part.whole, part.cell, part.left % 6, part.top % 6) == (whole.plane.shape, whole.cell, 0, 0)
    assert part.near is not None
    assert part.cell * (part.near.x + part.left) + (part.cell - 1) / 2 == pytest.approx(x)
    assert (part.plane.shape == whole.plane.shape) or not complete


def test_a_window_grows_with_what_is_uncertain() -> None:
    areas = []
    for sigma in (1.0, 20.0, 1000.0):
        expectation = Expectation(x_px=450.0, y_px=350.0, uncertainty_px=sigma)
        areas.append(part_near(COLOUR, expectation, step=1, static=None, bayer=None).plane.size)
    assert areas[0] < areas[1] < areas[2] == 700 * 900


def test_there_is_room_within_a_window_and_at_the_edge_of_the_image_alone() -> None:
    expectation = Expectation(x_px=20.0, y_px=350.0, uncertainty_px=1.0)
    part = part_near(COLOUR, expectation, step=1, static=None, bayer=None)
    rows, columns = part.plane.shape
    assert (part.left, part.top > 0, columns < 900) == (0, True, True)
    reach = 3.0 * 5.0 + 14.0  # three radii, 10 px, and 4 px for the blur
    middle = rows / 2.0
    assert part.has_room(2.0, middle, 5.0)
    assert part.has_room(columns - 1 - reach, middle, 5.0)
    assert not part.has_room(columns - reach, middle, 5.0)
    assert not part.has_room(40.0, reach - 1.0, 5.0)
    assert part.holds(2.0, middle + part.top, 5.0)
    assert not part.holds(40.0, reach - 1.0 + part.top, 5.0)


def test_the_whole_of_an_image_has_room_for_everything() -> None:
    assert whole_part(COLOUR, static=None, bayer=None).has_room(450.0, 350.0, 400.0)
    assert np.array_equal(faintest_plane(COLOUR, None), COLOUR.min(axis=2))
