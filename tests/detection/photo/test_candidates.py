"""Candidates of an image: tones of deep images, mosaics, and the distance to the middle of the glare."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from tests.detection.photo.suns import glare_image

from sunarc.common.array_types import Image
from sunarc.detection.photo.candidates import (
    Candidate,
    ImagePart,
    candidates_near,
    faintest_plane,
    part_near,
    sigma_px,
    whole_part,
    window_step,
)
from sunarc.detection.photo.candidates import candidates_in as candidates_in_part
from sunarc.detection.photo.rim import Rim, light_radius
from sunarc.detection.values import Bayer, Expectation


def candidates_in(image: Image, *, full_scale: int, bayer: Bayer | None = None) -> list[Candidate]:
    return candidates_in_part(whole_part(image, static=None, bayer=bayer), full_scale=full_scale)


def test_the_light_of_deep_images_is_compared_by_the_tones_of_eight_bits() -> None:
    linear = glare_image(radius=12.0)
    toned = np.round(255.0 * (linear / 4095.0) ** (1.0 / 2.2)).astype(np.uint8)
    deep, eight = candidates_in(linear, full_scale=4095)[0].rim, candidates_in(toned, full_scale=255)[0].rim
    assert deep.near == pytest.approx(eight.near, abs=0.02)
    assert deep.far == pytest.approx(eight.far, abs=0.02)


def test_a_candidate_of_a_mosaic_is_twice_that_of_its_cells() -> None:
    cells = glare_image(90.0, 80.0, radius=12.0)
    mosaic = np.repeat(np.repeat(cells, 2, axis=0), 2, axis=1)
    small, large = candidates_in(cells, full_scale=4095)[0], candidates_in(mosaic, full_scale=4095, bayer="RGGB")[0]
    assert np.array_equal(faintest_plane(mosaic, "RGGB"), cells)
    assert (large.rim.x, large.rim.y) == pytest.approx((2.0 * small.rim.x + 0.5, 2.0 * small.rim.y + 0.5))
    lengths = ("radius", "scatter", "spread", "offset")
    assert [getattr(large.rim, name) for name in lengths] == pytest.approx(
        [2.0 * getattr(small.rim, name) for name in lengths]
    )
    assert tuple(large[1:5]) == pytest.approx([2.0 * value for value in small[1:5]])
    assert large[5:] == small[5:]


def test_the_middle_of_the_glare_is_the_largest_suns() -> None:
    twins = np.maximum(glare_image(60.0, 100.0, radius=14.0), glare_image(150.0, 60.0, radius=5.0))
    seen = {round(each.rim.x, -1): each for each in candidates_in(twins, full_scale=4095)}
    larger, smaller = seen[60.0], seen[150.0]
    assert larger.off_glare_px < 3.0
    assert smaller.off_glare_px == pytest.approx(math.hypot(90.0, 40.0), abs=4.0)
    assert smaller.off_local_glare_px < 4.0


@pytest.mark.parametrize(("of_level", "area"), [(1.0, 0.025), (0.81, 0.025), (0.77, 0.0)])
def test_what_is_as_light_elsewhere_is_counted_by_its_area(of_level: float, area: float) -> None:
    image = glare_image(60.0, 100.0, radius=6.0)
    assert candidates_in(image, full_scale=4095)[0].other_area == 0.0
    image[20:40, 120:170] = round(4095 * of_level)  # 0.9 of 8 bits' tones are 0.793 of the light
    seen = [each for each in candidates_in(image, full_scale=4095) if abs(each.rim.x - 60.0) < 2.0]
    assert seen[0].other_area == pytest.approx(area)


@pytest.mark.parametrize("shape", [(1, 1), (2, 7), (9, 9), (30, 4)])
def test_an_image_of_any_size_has_no_candidates_or_some(shape: tuple[int, int]) -> None:
    for level in (0, 255):
        assert candidates_in(np.full(shape, level, np.uint8), full_scale=255) == []


@pytest.mark.parametrize("bayer", [None, "RGGB"])
def test_near_a_predicted_place_candidates_are_those_of_the_whole_image(bayer: Bayer | None) -> None:
    image = glare_image(300.0, 200.0, radius=11.0, size=900)
    expectation = Expectation(x_px=303.0, y_px=198.0, uncertainty_px=2.0)
    part = part_near(image, expectation, step=window_step(image, bayer), static=None, bayer=bayer)
    seen = candidates_near(part, full_scale=4095)
    assert seen is not None
    assert part.plane.size < 0.5 * image.size / part.cell**2
    (whole,) = candidates_in(image, full_scale=4095, bayer=bayer)
    (found,) = seen
    assert tuple(found.rim) == pytest.approx(tuple(whole.rim), abs=1e-9)
    assert tuple(found[1:5]) == pytest.approx(tuple(whole[1:5]), abs=1e-9)


@pytest.mark.parametrize(("x", "count"), [(300.0, 1), (345.0, 1), (700.0, 0)])
def test_only_plateaus_within_reach_are_candidates(x: float, count: int) -> None:
    image = glare_image(300.0, 200.0, radius=11.0, size=900)  # 5 times 9 and 2 px, and 2 px, and the radius
    expectation = Expectation(x_px=x, y_px=200.0, uncertainty_px=2.0)
    part = part_near(image, expectation, step=window_step(image, None), static=None, bayer=None)
    seen = candidates_near(part, full_scale=4095)
    assert seen is not None
    assert len(seen) == count


def test_a_plateau_without_room_in_the_window_is_left_to_the_whole_image() -> None:
    image = glare_image(300.0, 400.0, radius=85.0, size=900)
    expectation = Expectation(x_px=300.0, y_px=400.0, uncertainty_px=1.0)
    step = window_step(image, None)
    assert candidates_near(part_near(image, expectation, step=step, static=None, bayer=None), full_scale=4095) is None
    complete = part_near(image, expectation, step=step, static=None, bayer=None, complete=True)
    assert len(candidates_near(complete, full_scale=4095) or []) == 1


@pytest.mark.parametrize("cell", [1, 2])
@pytest.mark.parametrize(("column", "row"), [(-1, 0), (1, 0), (0, -1), (0, 1)])
@pytest.mark.parametrize("beyond", [-0.01, 0.01])
def test_a_part_holds_a_plateau_whose_rays_end_within_it(cell: int, column: int, row: int, beyond: float) -> None:
    radius, left, top, shape = 3.0, 70, 50, (101, 121)
    part = ImagePart(np.zeros(shape, dtype=np.uint16), None, left, top, (400, 500), cell)
    room = [(shape[1] - 1) / 2.0 - light_radius(radius), (shape[0] - 1) / 2.0 - light_radius(radius)]
    middle = np.array([left + (shape[1] - 1) / 2.0, top + (shape[0] - 1) / 2.0])
    cells = middle + np.array([column * (room[0] + beyond), row * (room[1] + beyond)])
    x, y = cell * cells + (cell - 1) / 2.0  # a cell's middle lies between its pixels
    assert part.holds(x, y, cell * radius) == (beyond < 0.0)
    at_edge = part._replace(left=0, top=0, whole=shape)  # nothing is hidden beyond the edge of the image
    assert at_edge.holds(x - cell * left, y - cell * top, cell * radius)


def test_the_sigma_of_a_rim_and_how_sun_like_it_is_by_their_formulas() -> None:
    rng = np.random.default_rng(1)
    for k in range(12):
        radius, scatter, share, spread, offset, flat, near, far, uneven, pull, lopsided = (
            rng.uniform(4.0, 40.0), *rng.uniform(0.1, 1.0, 2), *rng.uniform(0.0, 2.0, 2), *rng.uniform(0.2, 1.2, 6),
        )  # fmt: skip
        near = (0.29, 0.31, near)[k % 3]
        rim = Rim(
            50.0, 60.0, radius, scatter, share, spread, offset, 0.1, 4095.0, flat, near, far, uneven, pull, lopsided, 3,
            k % 2 > 0,
        )  # fmt: skip
        cut = k % 2 > 0 and near >= 0.3
        parts = [
            0.2, (0.04 if cut else 0.015) * radius, 7.0 * (scatter / share) ** 2 / radius, 0.5 * spread, 0.45 * offset,
            0.9 * radius * uneven**2 * cut, 0.25 * radius * (1.0 - share) * (cut or k % 2 == 0),
            *((0.35 * pull, 0.7 * radius * max(uneven - 0.9, 0.0), 0.25 * radius * lopsided) if k % 2 == 0 else ()),
        ]  # fmt: skip
        assert sigma_px(rim) == pytest.approx(math.hypot(*parts), rel=1e-12)
        apart = rng.uniform(0.0, 40.0)
        one = Candidate(rim, 0.5, apart, 0.0, 500.0, 0.0)
        even = 1.0 + (scatter / (0.1 * radius)) ** 2 + (spread / (0.2 * radius)) ** 2
        glare = math.exp(-((apart / (3.0 * 0.009 * 500.0)) ** 2))
        assert one.score == pytest.approx(radius * flat * max(1.0 - far, 0.01) * share**2 / even * glare, rel=1e-12)


def test_what_is_about_a_rim_in_a_large_image_is_counted_in_its_cells() -> None:
    """Of 720 px three by three are one: what lies beyond 2.6 radii, and where the blurred image is brightest."""
    image = np.maximum(
        glare_image(430.0, 300.0, radius=20.0, size=720), glare_image(200.0, 560.0, radius=13.0, size=720)
    )
    image = (image >> 4).astype(np.uint8)
    image[100:160, 500:640] = 250
    small = np.rint(image.reshape(240, 3, 240, 3).mean(axis=(1, 3)))
    rows, columns = 3.0 * np.mgrid[:240, :240] + 1.0
    seen = candidates_in(image, full_scale=255)
    assert len(seen) >= 2
    for one in seen:
        away = np.hypot(columns - one.rim.x, rows - one.rim.y)
        others = small[away > 2.6 * one.rim.radius]
        assert one.other_area == pytest.approx(np.count_nonzero(others >= 0.9 * one.rim.level) / 240.0**2, abs=1e-9)
        lit = others[others > 0.06 * one.rim.level] / one.rim.level
        assert one.sky == pytest.approx(float(np.median(lit)), rel=1e-6)
        assert one.lighter == pytest.approx(float(np.mean(lit > min(one.rim.near, one.rim.far))), abs=1e-9)
        blurred = gaussian_filter(np.minimum(small, one.rim.level), 4.0, mode="mirror")
        around = np.where(away <= one.rim.radius + 0.08 * 720.0, blurred, -1.0)
        for plane, off in ((blurred, one.off_glare_px), (around, one.off_local_glare_px)):
            row, column = np.unravel_index(int(np.argmax(plane)), plane.shape)
            x, y = (one.rim.x - 1.0) / 3.0, (one.rim.y - 1.0) / 3.0
            assert off == pytest.approx(3.0 * math.hypot(float(column) - x, float(row) - y), abs=3.1)
