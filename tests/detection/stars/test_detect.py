"""Stars of made images: found where they are, as well as their light allows; nothing else is a star."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from tests.detection.stars.rendering import (
    FULL_SCALE,
    GAIN_E,
    READ_E,
    SKY,
    counted,
    expected,
    spread_places,
)

from sunarc.common.errors import InputError
from sunarc.detection.stars.detect import Background, clipped_cores, detect_stars, ellipse_axes, find_maxima
from sunarc.detection.values import Stars

FloatArray = NDArray[np.float64]
SIZE, WIDTH = 512, 1.1


def nearest(stars: Stars, places: FloatArray) -> tuple[FloatArray, NDArray[np.intp]]:
    apart, row = cKDTree(stars.pixels).query(places)
    return np.asarray(apart), np.asarray(row)


def bound_px(electrons: float, width: float) -> float:
    """Return the Cramer-Rao bound of a centre per axis, the flux and the background free, by its definition."""
    at, reach, step = np.array([20.3, 20.4]), 41, 1e-3

    def light(x: float, y: float, flux: float, level: float) -> FloatArray:
        return expected(np.array([[x, y]]), np.array([flux]), size=reach, width=width).ravel() + level

    truth = np.array([*at, electrons, 1.25 * SKY * GAIN_E])
    slopes = np.stack([(light(*(truth + d)) - light(*(truth - d))) / (2.0 * step) for d in step * np.eye(4)], axis=-1)
    information = slopes.T @ (slopes / (light(*truth) + READ_E**2)[:, None])
    return float(np.sqrt(np.mean(np.diag(np.linalg.inv(information))[:2])))


@pytest.mark.parametrize("electrons", [1500.0, 6000.0, 40_000.0])
def test_centres_are_as_good_as_the_light_allows_and_their_sigma_says_so(electrons: float) -> None:
    rng = np.random.default_rng(3)
    error, sigma = [], []
    for _ in range(2):
        places = spread_places(rng, SIZE)
        image = counted(rng, expected(places, np.full(len(places), electrons), size=SIZE, width=WIDTH))
        stars = detect_stars(image, full_scale=FULL_SCALE, gain_e_per_count=GAIN_E)
        apart, row = nearest(stars, places)
        assert np.mean(apart < 1.0) > 0.99
        assert len(stars) <= len(places) + 2
        found = apart < 1.0
        error.append((stars.pixels[row] - places)[found])
        sigma.append(stars.sigma_px[row][found])
    rms = float(np.sqrt(np.mean(np.concatenate(error) ** 2)))
    bound = bound_px(electrons, WIDTH)
    assert 0.9 * bound < rms < 1.3 * bound
    assert float(np.sqrt(np.mean(np.concatenate(sigma) ** 2))) == pytest.approx(np.hypot(rms, 0.01), rel=0.15)
    assert abs(np.concatenate(error).mean()) < 4.0 * rms / np.sqrt(2.0 * 2.0 * 225.0)


def test_a_lens_that_draws_stars_out_towards_the_edge_costs_nothing() -> None:
    rng = np.random.default_rng(5)
    places = spread_places(rng, SIZE)
    y, x = np.mgrid[0:SIZE, 0:SIZE]
    light = np.zeros((SIZE, SIZE))
    middle = (SIZE - 1) / 2.0
    length = 1.0 + 0.8 * (np.hypot(*(places - middle).T) / middle) ** 2
    outward = (places - middle) / np.linalg.norm(places - middle, axis=-1, keepdims=True)
    for (px, py), far, (ox, oy) in zip(places, length, outward, strict=True):
        along, across = (x - px) * ox + (y - py) * oy, (x - px) * oy - (y - py) * ox
        light += 20_000.0 / (2.0 * np.pi * far) * np.exp(-0.5 * (along**2 / far**2 + across**2))
    stars = detect_stars(counted(rng, light), full_scale=FULL_SCALE, gain_e_per_count=GAIN_E)
    apart, row = nearest(stars, places)
    assert np.mean(apart < 1.0) > 0.98
    assert np.sqrt(np.mean(apart[apart < 1.0] ** 2) / 2.0) < 0.03
    assert np.corrcoef(stars.ellipticity[row], 1.0 - 1.0 / length)[0, 1] > 0.9
    np.testing.assert_allclose(np.median(stars.width_px[row] / np.sqrt(length)), 1.0, atol=0.03)


def test_flux_and_noise_are_those_of_sep() -> None:
    sep = pytest.importorskip("sep")
    rng = np.random.default_rng(7)
    places = spread_places(rng, SIZE)
    electrons = 10.0 ** rng.uniform(3.3, 4.8, len(places))
    image = counted(rng, expected(places, electrons, size=SIZE, width=WIDTH))
    stars = detect_stars(image, full_scale=FULL_SCALE, gain_e_per_count=GAIN_E)
    plane = image.astype(np.float64)
    ground = sep.Background(plane)
    theirs = sep.extract(plane - ground.back(), 4.0, err=ground.globalrms)
    x, y, _ = sep.winpos(plane - ground.back(), theirs["x"], theirs["y"], 2.35 * WIDTH / 2.0)
    flux, _, _ = sep.sum_circle(plane - ground.back(), x, y, 6.0 * WIDTH)
    apart, row = nearest(stars, np.stack([x, y], axis=-1))
    bright = (flux * GAIN_E > 4000.0) & (apart < 1.0)
    assert bright.sum() > 100
    assert np.median(apart[bright]) < 0.02
    np.testing.assert_allclose(np.median(stars.flux[row][bright] / flux[bright]), 1.0, atol=0.03)
    mine, his = nearest(stars, places)[0], np.asarray(cKDTree(np.stack([x, y], axis=-1)).query(places)[0])
    assert np.mean(mine[mine < 1.0] ** 2) < 1.1 * np.mean(his[his < 1.0] ** 2)


def test_a_clipped_star_says_so_and_the_others_do_not() -> None:
    rng = np.random.default_rng(9)
    places = spread_places(rng, 256)
    electrons = np.full(len(places), 20_000.0)
    electrons[[9, 30]] = 900_000.0
    stars = detect_stars(
        counted(rng, expected(places, electrons, size=256, width=WIDTH)), full_scale=FULL_SCALE, gain_e_per_count=GAIN_E
    )
    apart, row = nearest(stars, places)
    assert {int(row[9]), int(row[30])} == set(np.flatnonzero(stars.saturated).tolist())
    # most of their light is cut off: placed to a part of a pixel, by no more than their rims
    assert apart[[9, 30]].max() < 0.4
    assert stars.peak_fraction[row[9]] > 0.99
    assert stars.flux[row[9]] > 5.0 * np.median(stars.flux)


@pytest.mark.parametrize("bayer", ["RGGB", "GBRG"])
def test_a_mosaic_shifts_no_star_of_any_colour(bayer: str) -> None:
    rng = np.random.default_rng(11)
    places = spread_places(rng, 256)
    light = expected(places, np.full(len(places), 60_000.0), size=256, width=1.3)
    for k, letter in enumerate(bayer):
        light[k // 2 :: 2, k % 2 :: 2] *= {"R": 0.9, "G": 0.6, "B": 0.3}[letter]
    stars = detect_stars(counted(rng, light), full_scale=FULL_SCALE, bayer=bayer)  # type: ignore[arg-type]
    apart, row = nearest(stars, places)
    assert np.mean(apart < 1.0) > 0.95
    assert np.sqrt(np.mean(apart[apart < 1.0] ** 2) / 2.0) < 0.1
    assert np.abs(np.median((stars.pixels[row] - places)[apart < 1.0], axis=0)).max() < 0.02


def test_hot_pixels_and_lamps_are_no_stars_and_neither_is_noise() -> None:
    rng = np.random.default_rng(13)
    places = spread_places(rng, SIZE)
    light = expected(places, np.full(len(places), 20_000.0), size=SIZE, width=1.3)
    hot = rng.integers(8, SIZE - 8, (60, 2))
    hot = hot[np.asarray(cKDTree(places).query(hot)[0]) > 8.0]
    light[hot[:, 1], hot[:, 0]] += 8_000.0
    light += 30.0 * expected(np.array([[16.0, 250.0]]), np.array([50_000.0]), size=SIZE, width=6.0)
    stars = detect_stars(counted(rng, light), full_scale=FULL_SCALE, gain_e_per_count=GAIN_E)
    assert np.mean(nearest(stars, places)[0] < 1.0) > 0.95
    false = np.asarray(cKDTree(places).query(stars.pixels)[0]) > 1.5
    assert np.count_nonzero(false) <= 3
    empty = detect_stars(counted(rng, np.zeros((SIZE, SIZE))), full_scale=FULL_SCALE)
    assert len(empty) <= 2


def test_eight_bits_and_colours_of_a_jpeg_do() -> None:
    rng = np.random.default_rng(15)
    places = spread_places(rng, 256)
    counts = counted(rng, expected(places, np.full(len(places), 40_000.0), size=256, width=1.4))
    grey = np.clip(255.0 * (counts / FULL_SCALE) ** 0.5, 0, 255).astype(np.uint8)
    _, file = cv2.imencode(".jpg", cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), [cv2.IMWRITE_JPEG_QUALITY, 92])
    image = np.asarray(cv2.imdecode(file, cv2.IMREAD_UNCHANGED), dtype=np.uint8)
    stars = detect_stars(image, full_scale=255)
    apart, _ = nearest(stars, places)
    assert np.mean(apart < 1.0) > 0.98
    assert 0.01 < np.sqrt(np.mean(apart[apart < 1.0] ** 2) / 2.0) < 0.1


def test_a_mask_hides_and_what_is_no_image_is_refused() -> None:
    rng = np.random.default_rng(17)
    places = spread_places(rng, 256)
    image = counted(rng, expected(places, np.full(len(places), 20_000.0), size=256, width=WIDTH))
    mask = np.zeros(image.shape, dtype=bool)
    mask[:, :128] = True
    stars = detect_stars(image, full_scale=FULL_SCALE, mask=mask)
    assert 20 < len(stars) < 40
    assert stars.pixels[:, 0].min() > 127.0
    assert len(detect_stars(np.full((64, 64), FULL_SCALE, dtype=np.uint16), full_scale=FULL_SCALE)) == 0
    with pytest.raises(InputError):
        detect_stars(np.zeros((8, 8), dtype=np.float64), full_scale=255)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("lights", "found"),
    [
        pytest.param([(1.1, 700.0)], 1, id="one faint star"),
        pytest.param([(1.1, 700.0), (1.1, 900.0)], 2, id="two"),
        pytest.param([(0.3, 20_000.0), (3.5, 60_000.0)], 0, id="a hot pixel and a cloud's edge"),
    ],
)
def test_the_shape_of_one_or_two_lights(lights: list[tuple[float, float]], found: int) -> None:
    rng = np.random.default_rng(1)
    places = np.array([[60.0, 50.0], [30.7, 90.1]])[: len(lights)]
    light = np.zeros((128, 128))
    for place, (width, electrons) in zip(places, lights, strict=True):
        light += expected(place[None], np.array([electrons]), size=128, width=width)
    stars = detect_stars(counted(rng, light), full_scale=FULL_SCALE, gain_e_per_count=GAIN_E)
    assert len(stars) == found
    if found:
        assert nearest(stars, places)[0].max() < 0.5


def test_the_axes_of_a_covariance_are_the_roots_of_its_eigenvalues() -> None:
    factors = np.random.default_rng(4).normal(size=(50, 2, 2))
    covariances = factors @ factors.swapaxes(-1, -2)
    expected_axes = np.sqrt(np.linalg.eigvalsh(covariances))
    minor, major = ellipse_axes(np.stack([covariances[:, 0, 0], covariances[:, 0, 1], covariances[:, 1, 1]], axis=-1))
    np.testing.assert_allclose(np.stack([minor, major], axis=-1), expected_axes, atol=1e-7)


@pytest.mark.parametrize(
    ("columns", "rows", "kept", "like_star"),
    [(4, 3, False, False), (7, 2, True, False), (5, 3, True, True), (10, 20, True, True), (10, 21, True, False),
     (30, 30, True, True), (30, 31, True, False)],
)  # fmt: skip
def test_a_clipped_core_is_a_star_s_unless_it_is_too_large_or_long(
    columns: int,
    rows: int,
    kept: bool,  # noqa: FBT001
    like_star: bool,  # noqa: FBT001
) -> None:
    clipped = np.zeros((80, 90), dtype=bool)
    clipped[12 : 12 + rows, 40 : 40 + columns] = True
    light = np.random.default_rng(5).uniform(1.0, 2.0, clipped.shape).astype(np.float32)
    cores = clipped_cores(light, clipped, usable=np.ones_like(clipped))
    assert len(cores.pixels) == kept
    if kept:
        np.testing.assert_allclose(cores.pixels[0], [40 + (columns - 1) / 2, 12 + (rows - 1) / 2])
        assert cores.radius[0] == pytest.approx(np.sqrt(rows * columns / np.pi))
        assert cores.flux[0] == pytest.approx(light[clipped].sum())
        assert cores.like_star[0] == like_star


@pytest.mark.parametrize("width", [1.1, 3.0])
@pytest.mark.parametrize(("snr", "expected_maxima"), [(4.5, 0), (5.5, 1)])
def test_a_maximum_is_weighed_over_all_of_a_star_s_width(width: float, snr: float, expected_maxima: int) -> None:
    y, x = np.mgrid[:200, :200]
    # of the matched filter: a Gaussian's squares sum to pi width^2
    height = snr / (np.sqrt(np.pi) * width)
    plane = (height * np.exp(-0.5 * ((x - 80.0) ** 2 + (y - 120.0) ** 2) / width**2)).astype(np.float32)
    ground = Background(level=np.zeros_like(plane), noise=np.ones_like(plane))
    none, every = np.zeros(x.shape, dtype=bool), np.ones(x.shape, dtype=bool)
    assert find_maxima(plane, ground, none, every, width).tolist() == [[80.0, 120.0]] * expected_maxima
