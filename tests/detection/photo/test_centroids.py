"""The estimators of Appendix A one by one, on images whose answer is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, sobel
from scipy.signal import fftconvolve
from tests.detection.rendering import FloatArray, Image

from sunarc.detection.photo.urquhart2016 import (
    Plane,
    find_peak,
    forstner,
    gaussian_sigma_px,
    kernels,
    smear_column,
    strongest,
    sun_blob,
)


def disc(x: float, y: float, radius: float, *, size: tuple[int, int] = (90, 110), inside: float = 1.0) -> Plane:
    rows, columns = np.mgrid[: size[0], : size[1]]
    edge = np.clip(radius + 0.5 - np.hypot(columns - x, rows - y), 0.0, 1.0)
    return np.asarray(0.1 + inside * edge, dtype=np.float32)


@pytest.mark.parametrize("zenith_deg", [0.0, 45.0, 75.0, 80.0, 85.0, 88.0, 89.9, 90.0, 100.0])
def test_sigma_is_the_equation_of_the_paper_and_capped(zenith_deg: float) -> None:
    literal = 3.0 * math.log(max(91.0 - zenith_deg, 1.0)) ** 2 + 1.0
    found = gaussian_sigma_px(math.radians(zenith_deg))
    assert found == pytest.approx(min(literal, 24.0))
    assert 1.0 <= found <= 24.0


def test_the_cap_is_reached_at_75_degrees() -> None:
    assert gaussian_sigma_px(math.radians(76.0)) < 24.0
    assert gaussian_sigma_px(math.radians(75.0)) == 24.0


@pytest.mark.parametrize(("diameter", "sigma"), [(10.0, 4.0), (60.0, 2.0), (21.0, 24.0)])
def test_kernels_are_the_papers(diameter: float, sigma: float) -> None:
    found = kernels(diameter=diameter, sigma=sigma)
    half = found[0].shape[0] // 2
    assert half == math.ceil(max(diameter / 2.0, 4.0 * sigma) + 1.0)
    rows, columns = np.mgrid[-half : half + 1, -half : half + 1]
    square = rows**2 + columns**2
    inside = square <= (diameter / 2.0) ** 2
    gaussian = np.exp(-square / (2.0 * sigma**2))
    top = math.exp(-((diameter / 2.0) ** 2) / (2.0 * sigma**2))
    for kernel, shape in zip(found, (inside, gaussian, np.minimum(gaussian, top)), strict=True):
        assert kernel == pytest.approx(shape / shape.sum(), abs=1e-7)
        assert kernel.sum() == pytest.approx(1.0, abs=1e-5)


def test_the_blob_is_the_largest_region_of_the_brightest_ten_thousandth() -> None:
    counts = np.full((1000, 1000), 100, np.uint16)
    counts[300:310, 400:410] = 900  # 100 pixels, 1e-4 of all
    counts[700:703, 100:103] = 850
    blob = sun_blob(counts)
    assert blob is not None
    assert (blob.x, blob.y, blob.diameter) == pytest.approx((404.5, 304.5, 2.0 * math.sqrt(96.0 / math.pi)))


def test_where_more_is_saturated_all_of_it_is_the_blob() -> None:
    counts = np.full((200, 200), 100, np.uint8)
    counts[50:80, 60:90] = 255
    blob = sun_blob(counts)
    assert blob is not None
    assert (blob.x, blob.y) == (74.5, 64.5)
    assert blob.diameter == pytest.approx(2.0 * math.sqrt(896.0 / math.pi))  # its corners are eroded


def test_single_bright_pixels_are_eroded() -> None:
    counts = np.full((200, 200), 100, np.uint16)
    counts[::20, ::20] = 4000
    assert sun_blob(counts) is None


@pytest.mark.parametrize("image", [np.full((40, 60), 7, np.uint8), np.full((40, 60), 7, np.uint16)])
def test_an_even_image_is_one_blob(image: Image) -> None:
    blob = sun_blob(image)
    assert blob is not None
    assert (blob.x, blob.y) == (29.5, 19.5)


@pytest.mark.parametrize("place", [(55.0, 45.0), (40.0, 61.0), (3.0, 4.0)])
def test_the_strongest_response_is_that_of_scipys_convolution(place: tuple[float, float]) -> None:
    value = disc(*place, 8.0)
    for kernel in kernels(diameter=16.0, sigma=5.0):
        response = fftconvolve(value.astype(np.float64), kernel.astype(np.float64), mode="same")
        row, column = np.unravel_index(int(np.argmax(response)), response.shape)
        assert strongest(value, kernel) == pytest.approx((column, row), abs=0.51)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.3, -0.4)])
def test_each_kernel_finds_a_disc_to_half_a_pixel(shift: tuple[float, float]) -> None:
    place = (55.0 + shift[0], 45.0 + shift[1])
    for kernel in kernels(diameter=16.0, sigma=5.0):
        assert strongest(disc(*place, 8.0), kernel) == pytest.approx(place, abs=0.51)


def test_equal_maxima_are_averaged() -> None:
    response = np.zeros((5, 9), np.float32)
    response[2, 2] = response[2, 6] = 1.0
    response[4, 4] = 1.0 - 1e-6
    response[0, 8] = 1.0 - 4e-6
    assert find_peak(response) == pytest.approx((4.0, 8.0 / 3.0))


def test_a_dark_plane_has_its_peak_in_the_middle() -> None:
    assert find_peak(np.zeros((5, 9), np.float32)) == (4.0, 2.0)


def row_with(column: int, height: float, *, size: int = 600, noise: float = 0.003, seed: int = 0) -> FloatArray:
    rng = np.random.default_rng(seed)
    return 0.1 + height * np.exp(-0.5 * ((np.arange(size) - column) / 1.5) ** 2) + rng.normal(0.0, noise, size)


@pytest.mark.parametrize("column", [40, 333, 570])
def test_smear_is_the_column_that_stands_out(column: int) -> None:
    rows = row_with(column, 0.1, seed=1), row_with(column, 0.3, seed=2)
    assert smear_column(*rows) == pytest.approx(column, abs=1.0)


@pytest.mark.parametrize(("height", "found"), [(0.004, False), (0.1, True)])
def test_smear_must_stand_out_of_the_noise(height: float, *, found: bool) -> None:
    rows = row_with(333, height, seed=1), row_with(333, 3.0 * height, seed=2, noise=0.005)
    assert (smear_column(*rows) is not None) == found


@pytest.mark.parametrize(("size", "found"), [(199, False), (200, True)])
def test_a_row_of_less_than_two_averages_has_no_smear(size: int, *, found: bool) -> None:
    rows = row_with(100, 0.1, size=size, seed=1), row_with(100, 0.3, size=size, seed=2)
    assert (smear_column(*rows) is not None) == found


@pytest.mark.parametrize("sigma", [4.0, 7.5])
def test_forstner_is_the_minor_eigenvalue_of_scipys_gradients(sigma: float) -> None:
    value = disc(52.0, 41.0, 7.0)
    dx, dy = (sobel(value.astype(np.float64), axis=axis) for axis in (1, 0))
    xx, xy, yy = (
        gaussian_filter(p, sigma, mode="constant", radius=math.ceil(3.75 * sigma)) for p in (dx * dx, dx * dy, dy * dy)
    )
    minor = np.linalg.eigvalsh(np.stack([xx, xy, xy, yy], axis=-1).reshape(*value.shape, 2, 2))[..., 0]
    row, column = np.unravel_index(int(np.argmax(minor)), minor.shape)
    assert forstner(value, sigma=sigma) == pytest.approx((column, row), abs=1.0)
    assert forstner(value, sigma=sigma) == pytest.approx((52.0, 41.0), abs=1.0)


def test_forstner_among_some_places_is_the_same_as_in_all() -> None:
    value = disc(52.0, 41.0, 7.0)
    within = slice(30, 55), slice(40, 70)
    assert forstner(value, sigma=5.0, within=within) == pytest.approx(forstner(value, sigma=5.0))
    beside = slice(0, 20), slice(80, 110)
    x, y = forstner(value, sigma=5.0, within=beside)
    assert 80.0 <= x < 110.0
    assert 0.0 <= y < 20.0


@pytest.mark.parametrize(("below", "tied"), [(1e-6, True), (4e-6, False)])
def test_places_as_high_to_two_millionths_are_averaged(below: float, *, tied: bool) -> None:
    response = np.zeros((20, 30), dtype=np.float64)
    response[4, 6], response[10, 12] = 1.0, 1.0 - below
    assert find_peak(response) == ((9.0, 7.0) if tied else (6.0, 4.0))  # type: ignore[arg-type]


def test_a_dark_response_has_its_middle_as_the_peak() -> None:
    assert find_peak(np.zeros((5, 9), dtype=np.float32)) == (4.0, 2.0)


@pytest.mark.parametrize(("first_column", "peak"), [(41, 43.0), (40, 40.0)])
def test_forstners_window_ends_at_three_and_three_quarter_sigmas(first_column: int, peak: float) -> None:
    """Of a disc about column 20 the gradient ends at column 25; 3.75 · 4 = 15 px further nothing is told of it."""
    within = slice(20, 40), slice(first_column, 46)
    x, _ = forstner(disc(20.0, 30.0, 4.0), sigma=4.0, within=within)
    assert x == peak  # the middle of the places where nothing is told, else the nearest of them
