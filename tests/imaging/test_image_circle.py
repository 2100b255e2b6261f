"""The image circle: circles through points by hand, and drawn frames."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from sunarc.common.errors import InputError
from sunarc.imaging.image_circle import as_grey, circle_through, find_image_circle, refined_circle


def _frame(x: float, y: float, radius: float, *, size: tuple[int, int] = (240, 320)) -> NDArray[np.uint8]:
    rows, columns = np.mgrid[: size[0], : size[1]]
    distance = np.hypot(columns - x, rows - y)
    sky = 40.0 + 120.0 * np.clip(radius - distance + 0.5, 0.0, 1.0)
    return np.asarray(sky + np.random.default_rng(1).normal(0.0, 2.0, size), dtype=np.uint8)


def test_three_points_by_hand() -> None:
    found = circle_through(np.array([3.0, 1.0, -1.0]), np.array([2.0, 4.0, 2.0]))
    np.testing.assert_allclose(found, [1.0, 2.0, 2.0], rtol=1e-9)


def test_points_off_the_circle_count_less() -> None:
    angle = np.linspace(0.0, 2.0 * math.pi, 60, endpoint=False)
    radius = np.where(np.arange(60) % 10 == 0, 115.0, 100.0)
    x, y, found = circle_through(50.0 + radius * np.cos(angle), 60.0 + radius * np.sin(angle))
    np.testing.assert_allclose([x, y, found], [50.0, 60.0, 100.0], atol=0.1)


@pytest.mark.parametrize(("x", "y", "radius"), [(160.0, 120.0, 100.0), (150.3, 124.7, 92.4), (168.0, 118.0, 118.0)])
def test_a_drawn_circle_is_found_to_half_a_pixel(x: float, y: float, radius: float) -> None:
    found = find_image_circle(_frame(x, y, radius))
    assert found is not None
    assert math.hypot(found.x - x, found.y - y) < 0.5
    assert found.radius == pytest.approx(radius, abs=1.0)


def test_a_large_frame_is_looked_at_in_small_and_refined_in_full() -> None:
    found = find_image_circle(_frame(700.0, 500.0, 440.0, size=(1000, 1400)))
    assert found is not None
    np.testing.assert_allclose([found.x, found.y], [700.0, 500.0], atol=0.7)
    assert found.radius == pytest.approx(440.0, abs=1.0)


def test_colour_and_16_bits_are_as_good() -> None:
    grey = _frame(160.0, 120.0, 100.0)
    colour = find_image_circle(np.stack([grey, grey, grey], axis=-1))
    deep = find_image_circle(grey.astype(np.uint16) * 250)
    assert colour is not None
    assert deep is not None
    assert colour.radius == pytest.approx(deep.radius, abs=0.3)


def test_noise_has_no_circle() -> None:
    noise = np.random.default_rng(3).integers(90, 110, (120, 160)).astype(np.uint8)
    assert find_image_circle(noise) is None


def test_grey_is_the_root_of_the_share_of_the_brightest_percentile() -> None:
    image = np.zeros((40, 40), dtype=np.uint16)
    image[:20], image[20:] = 1000, 250
    found = as_grey(image)
    assert found.dtype == np.uint8
    assert (int(found[0, 0]), int(found[-1, -1])) == (255, 127)
    assert int(as_grey(np.zeros((40, 40), dtype=np.uint8)).max()) == 0


@pytest.mark.parametrize("shape", [(31, 100), (100, 31), (100,), (2, 40, 40, 3), (0, 0)])
def test_what_is_no_frame_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError):
        find_image_circle(np.zeros(shape, dtype=np.uint8))


def test_rays_whose_steepest_drop_is_weak_do_not_bend_the_circle() -> None:
    """Trees hide 60 % of the edge; the light drops a little where they begin, 4 px inside it."""
    rows, columns = np.mgrid[:240, :320]
    distance, angle = np.hypot(columns - 160.0, rows - 120.0), np.arctan2(rows - 120.0, columns - 160.0)
    edge = 20.0 + 180.0 * np.clip(100.5 - distance, 0.0, 1.0)
    trees = 20.0 + 18.0 * np.clip(96.5 - distance, 0.0, 1.0)
    found = refined_circle(np.where(np.abs(angle) < 0.6 * math.pi, trees, edge), 160.0, 120.0, 100.0)
    np.testing.assert_allclose(found, [160.0, 120.0, 100.0], atol=0.3)
