"""Appendix A of the paper: its five estimators, their literal and their fast path."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import fftconvolve
from tests.detection.photographs import sky
from tests.detection.rendering import FloatArray, Image

from sunarc.common.errors import InputError
from sunarc.detection.photo import urquhart2016
from sunarc.detection.photo import urquhart2016 as centroids
from sunarc.detection.photo.plateau import Blob
from sunarc.detection.photo.urquhart2016 import (
    Estimates,
    Plane,
    Planes,
    gaussian_sigma_px,
    kernels,
    locate,
    smear_column,
    split_planes,
    sun_blob,
)

ALPHA_PX = 601.32


@pytest.mark.parametrize(("zenith_deg", "sigma"), [(0.0, 24.0), (60.0, 24.0), (89.6, 1.0 + 3.0 * math.log(1.4) ** 2)])
def test_sigma_is_the_papers(zenith_deg: float, sigma: float) -> None:
    assert gaussian_sigma_px(math.radians(zenith_deg)) == pytest.approx(sigma)


@pytest.mark.parametrize("place", [(300.0, 280.0), (150.0, 420.0), (60.0, 90.0)])
@pytest.mark.parametrize("radius", [5.0, 20.0])
@pytest.mark.parametrize("zenith_deg", [20.0, 85.0])
def test_the_fast_path_answers_as_the_literal_one(place: tuple[float, float], radius: float, zenith_deg: float) -> None:
    planes = split_planes(sky(x=place[0], y=place[1], radius=radius, smear=0.05), full_scale=4095)
    zenith = math.radians(zenith_deg)
    fast, literal = (locate(planes, apparent_zenith=zenith, full_image=full) for full in (False, True))
    assert fast is not None
    assert literal is not None
    assert np.allclose(fast.columns, literal.columns, atol=0.5)
    assert np.allclose(fast.rows, literal.rows, atol=0.5)


def test_the_literal_path_is_a_convolution_of_the_whole_image() -> None:
    planes = split_planes(sky(x=212.0, y=251.0, radius=12.0), full_scale=4095)
    found = locate(planes, apparent_zenith=math.radians(50), full_image=True)
    assert found is not None
    for index, kernel in enumerate(kernels(diameter=found.diameter, sigma=found.sigma)):
        response = fftconvolve(planes.value().astype(np.float64), kernel, mode="same")
        row, column = np.unravel_index(int(np.argmax(response)), response.shape)
        assert abs(found.columns[index] - column) <= 1.0
        assert abs(found.rows[index] - row) <= 1.0


def test_medians_of_four_rows_and_five_columns_find_the_blob() -> None:
    planes = split_planes(sky(x=330.0, y=210.0, radius=15.0, smear=0.05), full_scale=4095)
    found = locate(planes, apparent_zenith=math.radians(40))
    assert found is not None
    assert (len(found.rows), len(found.columns)) == (4, 5)
    assert found.position == pytest.approx((330.0, 210.0), abs=1.0)
    assert found.spread_px < 3.0


def test_without_smear_there_are_four_columns() -> None:
    rng = np.random.default_rng(1)
    assert smear_column(rng.normal(0.1, 0.003, 600), rng.normal(0.3, 0.005, 600)) is None


def equisolid(angle: FloatArray) -> FloatArray:
    return 2 * ALPHA_PX * np.sin(angle / 2)


@pytest.mark.parametrize("shape", [(5, 5, 4), (5,), (0, 5)])
def test_what_is_no_image_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="shape"):
        split_planes(np.zeros(shape, np.uint8), full_scale=255)


@pytest.mark.parametrize(
    ("image", "full_scale"),
    [
        (np.zeros((5, 5), np.float32), 255),
        (np.zeros((5, 5), np.uint8), 256),
        (np.zeros((5, 5), np.uint8), 0),
        (np.zeros((5, 5, 3), np.int16), 255),
        (np.zeros((5, 5), np.uint16), 65536),
    ],
)
def test_another_type_or_full_scale_is_refused(image: NDArray[np.uint8], full_scale: int) -> None:
    with pytest.raises(InputError) as error:
        split_planes(image, full_scale=full_scale)
    assert error.value.field == "image"


COLOURS = np.random.default_rng(0).integers(0, 256, (6, 7, 3))


@pytest.mark.parametrize("image", [COLOURS.astype(np.uint8), COLOURS.astype(np.uint16)])
def test_v_is_the_largest_colour_and_grey_their_mean(image: Image) -> None:
    planes = split_planes(image, full_scale=255)
    assert planes.shape == (6, 7)
    assert planes.value() == pytest.approx(image.max(axis=2) / 255.0, abs=1e-6)
    assert planes.grey() == pytest.approx(image.mean(axis=2) / 255.0, abs=1e-6)
    part = planes.part(slice(1, 4), slice(2, 7))
    assert part.value() == pytest.approx(planes.value(slice(1, 4), slice(2, 7)))
    assert part.grey() == pytest.approx(planes.grey()[1:4, 2:7])


def test_a_mono_image_is_its_own_v_and_grey() -> None:
    image = np.arange(42, dtype=np.uint8).reshape(6, 7)
    planes = split_planes(image, full_scale=42)
    assert planes.value() == pytest.approx(image / 42.0, abs=1e-6)
    assert planes.grey() == pytest.approx(image / 42.0, abs=1e-6)


def estimates(columns: tuple[float, ...], rows: tuple[float, ...]) -> Estimates:
    found = locate(split_planes(sky(x=100.0, y=90.0, radius=8.0, size=200), full_scale=4095), apparent_zenith=1.0)
    assert found is not None
    return found._replace(columns=columns, rows=rows)


def test_the_position_is_the_medians_and_the_spread_that_of_four_estimators() -> None:
    found = estimates((10.0, 12.0, 11.0, 30.0, 11.5), (5.0, 7.0, 6.0, 6.5))
    assert found.position == (11.5, 6.25)
    squares = [1.5**2 + 1.25**2, 0.5**2 + 0.75**2, 0.5**2 + 0.25**2, 18.5**2 + 0.25**2]
    assert found.spread_px == pytest.approx(math.sqrt(sum(squares) / 4.0))
    moved = found.shifted(100.0, -5.0)
    assert moved.position == (111.5, 1.25)
    assert moved.spread_px == pytest.approx(found.spread_px)


def test_without_a_zenith_angle_the_kernels_are_as_wide_as_the_blob() -> None:
    planes = split_planes(sky(x=300.0, y=280.0, radius=20.0), full_scale=4095)
    found = locate(planes, apparent_zenith=None)
    assert found is not None
    assert found.sigma == pytest.approx(0.5 * found.diameter)
    assert found.position == pytest.approx((300.0, 280.0), abs=1.0)


def test_the_diameter_is_that_of_the_saturated_area() -> None:
    planes = split_planes(sky(x=300.0, y=280.0, radius=20.0), full_scale=4095)
    found = locate(planes, apparent_zenith=1.0)
    assert found is not None
    saturated = np.count_nonzero(planes.counts == 4095)
    assert found.diameter == pytest.approx(2.0 * math.sqrt(saturated / math.pi), rel=0.01)


@pytest.mark.parametrize("level", [0, 100])
def test_an_even_image_has_its_middle_and_single_pixels_have_nothing(level: int) -> None:
    image = np.full((60, 80), level, np.uint8)
    found = locate(split_planes(image, full_scale=255), apparent_zenith=1.5)
    assert found is not None
    assert found.diameter == pytest.approx(2.0 * math.sqrt(60.0 * 80.0 / math.pi))
    image[::9, ::9] = 255
    assert locate(split_planes(image, full_scale=255), apparent_zenith=1.5) is None


def test_a_blob_at_the_corner_is_found() -> None:
    planes = split_planes(sky(x=6.0, y=9.0, radius=5.0, size=300), full_scale=4095)
    fast, literal = (locate(planes, apparent_zenith=math.radians(86.0), full_image=full) for full in (False, True))
    assert fast is not None
    assert literal is not None
    assert fast.position == pytest.approx((6.0, 9.0), abs=4.0)  # half of it is outside
    assert fast.position == pytest.approx(literal.position, abs=0.5)


def test_the_fast_path_has_half_a_kernel_around_the_blob(monkeypatch: pytest.MonkeyPatch) -> None:
    reaches: list[int] = []
    around = urquhart2016.surroundings

    def noted(planes: Planes, blob: Blob, reach: int) -> tuple[slice, slice]:
        reaches.append(reach)
        return around(planes, blob, reach)

    monkeypatch.setattr(urquhart2016, "surroundings", noted)
    planes = split_planes(sky(x=212.0, y=251.0, radius=12.0), full_scale=4095)
    locate(planes, apparent_zenith=math.radians(20.0))
    blob = sun_blob(planes.counts)
    assert blob is not None
    (first, *_) = kernels(diameter=blob.diameter, sigma=gaussian_sigma_px(math.radians(20.0)))
    assert reaches == [(first.shape[0] - 1) // 2]


def test_forstners_strip_is_as_wide_on_either_side_of_the_sun(monkeypatch: pytest.MonkeyPatch) -> None:
    widths: list[int] = []

    def middle(value: Plane, **_: object) -> tuple[float, float]:
        widths.append(value.shape[1])
        return (value.shape[1] - 1) / 2.0, 0.0

    monkeypatch.setattr(centroids, "forstner", middle)
    planes = split_planes(sky(x=300.0, y=280.0, radius=12.0), full_scale=4095)
    found = locate(planes, apparent_zenith=math.radians(83.0))
    assert found is not None
    sun = float(np.median(found.columns[:3]))
    assert sun == 300.0
    assert found.columns[3] == sun
    assert widths == [2 * round(5.0 * found.sigma + 0.5 * found.diameter) + 1]


@pytest.mark.parametrize(
    ("box", "first", "rows", "columns"),
    [
        ((50, 40, 5, 6), (30, 20), (12, 34), (12, 33)),  # 8 px around the blob, counted from the window's first
        ((2, 3, 5, 6), (0, 0), (0, 17), (0, 15)),
        ((110, 88, 5, 6), (0, 0), (80, 100), (102, 120)),
        ((0, 0, 3, 3), (40, 30), (0, 1), (0, 1)),  # at least one place
    ],
)
def test_the_centre_is_sought_in_the_blobs_box_and_8_px_around_as_far_as_the_window_reaches(
    box: tuple[int, int, int, int], first: tuple[int, int], rows: tuple[int, int], columns: tuple[int, int]
) -> None:
    found = urquhart2016.centre_window((100, 120), Blob(0.0, 0.0, 5.0, box), first=first)
    assert found == (slice(*rows), slice(*columns))
