"""Circles through level sets: three-point cases by hand, discs of known radius, outliers."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from tests.detection.rendering import FloatArray

from sunarc.detection.photo.circles import Circle, _fitted, _inscribed, _opened, _outline, level_circle

START = Circle(48.0, 52.0, 18.0, 0.0, 0.0)


def ring(x: float, y: float, radius: float, *, angles: FloatArray | None = None) -> FloatArray:
    turn = np.linspace(0.0, 2.0 * math.pi, 144, endpoint=False) if angles is None else angles
    return np.column_stack([x + radius * np.cos(turn), y + radius * np.sin(turn)])


def disc(x: float, y: float, radius: float, *, size: int = 100) -> FloatArray:
    """Return a plane of an even disc, its edge a linear ramp of a pixel."""
    rows, columns = np.mgrid[:size, :size]
    return np.asarray(np.clip(radius + 0.5 - np.hypot(columns - x, rows - y), 0.0, 1.0))


def through(points: FloatArray) -> tuple[float, float, float]:
    """Return the circle through three points: |p|² = 2 x·p + c, three equations."""
    x, y, c = np.linalg.solve(np.column_stack([2.0 * points, np.ones(3)]), np.sum(points**2, axis=1))
    return float(x), float(y), math.sqrt(c + x * x + y * y)


@pytest.mark.parametrize("degrees", [(0.0, 120.0, 240.0), (10.0, 80.0, 200.0), (0.0, 90.0, 180.0)])
def test_three_points_have_the_circle_through_them(degrees: tuple[float, float, float]) -> None:
    points = ring(50.0, 50.0, 20.0, angles=np.radians(degrees))
    found = _fitted(points, START)
    assert (found.x, found.y, found.radius) == pytest.approx(through(points), abs=1e-3)
    assert found.scatter < 1e-3


def test_a_circle_by_hand() -> None:
    found = _fitted(np.array([[3.0, 4.0], [5.0, 0.0], [-4.0, 3.0]]), Circle(0.4, -0.3, 4.5, 0.0, 0.0))
    assert (found.x, found.y, found.radius) == pytest.approx((0.0, 0.0, 5.0), abs=1e-3)


def test_a_noisy_ring_has_the_circle_of_least_squares() -> None:
    rng = np.random.default_rng(0)
    points = ring(50.0, 50.0, 20.0) + rng.normal(0.0, 0.2, (144, 2))
    found = _fitted(points, START)
    assert (found.x, found.y) == pytest.approx((50.0, 50.0), abs=4.0 * 0.2 / math.sqrt(72.0))
    assert found.radius == pytest.approx(20.0, abs=4.0 * 0.2 / 12.0)
    assert found.scatter == pytest.approx(0.2, rel=0.3)
    assert found.share == 1.0


@pytest.mark.parametrize("pulled", [6, 14])
def test_a_part_that_bulges_out_is_an_outlier(pulled: int) -> None:
    points = ring(50.0, 50.0, 20.0)
    points[:pulled] = ring(50.0, 50.0, 29.0)[:pulled]
    found = _fitted(points, Circle(51.0, 51.0, 20.0, 0.0, 0.0))
    assert (found.x, found.y, found.radius) == pytest.approx((50.0, 50.0, 20.0), abs=0.05)
    assert found.share == pytest.approx(1.0 - pulled / 144.0, abs=2.0 / 72.0)


@pytest.mark.parametrize("arc_deg", [90.0, 180.0, 270.0])
def test_the_share_is_that_of_the_angles_with_an_outline(arc_deg: float) -> None:
    points = ring(50.0, 50.0, 20.0, angles=np.radians(np.arange(0.5, arc_deg, 1.0)))
    found = _fitted(points, START)
    assert (found.x, found.y, found.radius) == pytest.approx((50.0, 50.0, 20.0), abs=0.05)
    assert found.share == pytest.approx(arc_deg / 360.0, abs=1.0 / 72.0)


@pytest.mark.parametrize(("off", "followed"), [(1.9, True), (2.1, False)])
def test_points_within_a_tenth_of_the_radius_follow_the_circle(off: float, *, followed: bool) -> None:
    points = ring(50.0, 50.0, 20.0)
    points[:8] = ring(50.0, 50.0, 20.0 + off)[:8]
    share = _fitted(points, Circle(50.0, 50.0, 20.0, 0.0, 0.0)).share
    assert (share > 0.97) == followed


@pytest.mark.parametrize("radius", [4.0, 11.3, 30.0])
@pytest.mark.parametrize("place", [(50.0, 50.0), (47.3, 52.6)])
def test_a_disc_is_found_with_centre_and_radius(radius: float, place: tuple[float, float]) -> None:
    found = level_circle(disc(*place, radius).astype(np.float32), level=0.5, near=(50.0, 50.0))
    assert found is not None
    assert (found.x, found.y) == pytest.approx(place, abs=0.3)
    assert found.radius == pytest.approx(radius, abs=0.8)
    assert found.share == pytest.approx(
        min(5.65 * radius / 72.0, 1.0), abs=0.1
    )  # a chain of so many pixels, 72 sectors


@pytest.mark.parametrize("near", [(50.0, 50.0), (75.0, 50.0), (-10.0, 200.0)])
def test_the_region_next_to_the_point_is_taken(near: tuple[float, float]) -> None:
    plane = disc(47.0, 52.0, 12.0) + disc(6.0, 6.0, 5.0)
    found = level_circle(plane.astype(np.float32), level=0.5, near=near)
    assert found is not None
    assert found.radius == pytest.approx(12.0, abs=0.75)


def test_the_smaller_region_is_taken_where_the_point_lies_in_it() -> None:
    plane = disc(47.0, 52.0, 12.0) + disc(8.0, 8.0, 5.0)
    found = level_circle(plane.astype(np.float32), level=0.5, near=(9.0, 8.0))
    assert found is not None
    assert (found.x, found.y) == pytest.approx((8.0, 8.0), abs=0.4)


def test_a_streak_through_the_disc_does_not_move_it() -> None:
    plane = disc(47.3, 52.6, 14.0)
    plane[51:54, :] = 1.0
    found = level_circle(plane.astype(np.float32), level=0.5, near=(47.0, 52.0))
    assert found is not None
    assert (found.x, found.y) == pytest.approx((47.3, 52.6), abs=0.6)
    assert found.radius == pytest.approx(14.0, abs=0.9)


def test_a_hole_in_the_disc_does_not_move_it() -> None:
    plane = disc(50.0, 50.0, 20.0) - disc(56.0, 52.0, 2.0)
    found = level_circle(plane.astype(np.float32), level=0.5, near=(44.0, 50.0))
    assert found is not None
    assert (found.x, found.y) == pytest.approx((50.0, 50.0), abs=0.5)


def test_a_disc_cut_by_the_border_has_the_rest_of_its_outline() -> None:
    found = level_circle(disc(6.0, 50.0, 15.0).astype(np.float32), level=0.5, near=(7.0, 50.0))
    assert found is not None
    assert (found.x, found.y, found.radius) == pytest.approx((6.0, 50.0, 15.0), abs=1.0)
    assert 0.4 < found.share < 0.75


@pytest.mark.parametrize("radius", [0.0, 1.2])
def test_too_small_a_region_has_no_circle(radius: float) -> None:
    assert level_circle(disc(50.0, 50.0, radius).astype(np.float32), level=0.5, near=(50.0, 50.0)) is None


def test_a_plane_that_is_dark_has_no_circle() -> None:
    assert level_circle(np.ones((40, 40), np.float32), level=2.0, near=(20.0, 20.0)) is None


@pytest.mark.parametrize(("off", "followed"), [(1.9, True), (2.1, False), (5.0, False)])
def test_points_within_two_pixels_follow_a_small_circle(off: float, *, followed: bool) -> None:
    points = ring(50.0, 50.0, 10.0)
    points[:8] = ring(50.0, 50.0, 10.0 + off)[:8]
    share = _fitted(points, Circle(50.0, 50.0, 10.0, 0.0, 0.0)).share
    assert (share > 0.97) == followed


def test_the_inscribed_circle_is_the_largest_within_the_region_at_the_point() -> None:
    mask = (disc(40.0, 30.0, 12.0) + disc(80.0, 80.0, 15.0) >= 0.5).astype(np.uint8)
    distance = np.asarray(cv2.distanceTransform(mask, cv2.DIST_L2, 5), dtype=np.float64)
    found = _inscribed(mask, distance, (42.0, 33.0))
    assert found == Circle(40.0, 30.0, distance[30, 40], 0.0, 0.0)
    assert distance[30, 40] == distance[:60, :60].max()


def test_without_a_region_there_is_no_inscribed_circle() -> None:
    assert _inscribed(np.zeros((9, 9), np.uint8), np.zeros((9, 9)), (4.0, 4.0)) is None


def test_the_outline_is_the_innermost_that_holds_the_start() -> None:
    """A ring around a disc: OpenCV lists both outlines of the ring and that of the disc within it."""
    far = np.hypot(*(np.mgrid[:100, :100] - 50.0))
    mask = ((far < 10.0) | ((far > 20.0) & (far < 30.0))).astype(np.uint8)
    points = _outline(mask, Circle(50.0, 50.0, 9.0, 0.0, 0.0))
    assert np.all(np.hypot(*(points - 50.0).T) < 10.5)


def test_outline_points_on_the_border_of_the_image_are_left_out() -> None:
    points = _outline(np.ones((12, 15), np.uint8), Circle(7.0, 6.0, 5.0, 0.0, 0.0))
    assert len(points) == 0
    mask = np.zeros((12, 15), np.uint8)
    mask[1:11, 1:14] = 1
    assert len(_outline(mask, Circle(7.0, 6.0, 5.0, 0.0, 0.0))) == 2 * (10 + 13) - 4


@pytest.mark.parametrize(("width", "kept"), [(7, False), (9, True)])
def test_opening_cuts_off_what_is_thinner_than_the_disc(width: int, *, kept: bool) -> None:
    mask = np.zeros((60, 60), np.uint8)
    mask[30 : 30 + width, 5:55] = 1
    assert bool(_opened(mask, radius=4.2).any()) == kept
