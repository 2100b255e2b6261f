"""Appendix A of the paper: its five estimators, their literal and their fast path, and the bias they share."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import fftconvolve
from tests.detection.rendering import FloatArray

from sunarc.detection import Lens, locate, planes_of, radial_bias_px
from sunarc.detection.photo.centroids import gaussian_sigma_px, kernels, smear_column
from sunarc.errors import InputError

ALPHA_PX = 601.32


def sky(*, x: float, y: float, radius: float, size: int = 600, smear: float = 0.0, seed: int = 0) -> NDArray[np.uint16]:
    """Return an RGB image of a saturated blob with glare, on a graded sky."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[:size, :size]
    far = np.hypot(columns - x, rows - y)
    light = 0.1 + 1.2 / (1 + np.exp(np.minimum((far - radius) / 1.5, 50.0))) + 0.4 / (1 + (far / (2 * radius)) ** 2)
    light = light + smear * np.exp(-0.5 * ((columns - x) / 1.5) ** 2)
    colour = np.stack([light * c for c in (0.9, 1.0, 1.1)], axis=-1) + rng.normal(0, 0.003, (size, size, 3))
    return np.clip(colour * 4095, 0, 4095).astype(np.uint16)


@pytest.mark.parametrize(("zenith_deg", "sigma"), [(0.0, 24.0), (60.0, 24.0), (89.6, 1.0 + 3.0 * math.log(1.4) ** 2)])
def test_sigma_is_the_papers(zenith_deg: float, sigma: float) -> None:
    assert gaussian_sigma_px(math.radians(zenith_deg)) == pytest.approx(sigma)


@pytest.mark.parametrize("place", [(300.0, 280.0), (150.0, 420.0), (60.0, 90.0)])
@pytest.mark.parametrize("radius", [5.0, 20.0])
@pytest.mark.parametrize("zenith_deg", [20.0, 85.0])
def test_the_fast_path_answers_as_the_literal_one(place: tuple[float, float], radius: float, zenith_deg: float) -> None:
    planes = planes_of(sky(x=place[0], y=place[1], radius=radius, smear=0.05), full_scale=4095)
    zenith = math.radians(zenith_deg)
    fast, literal = (locate(planes, apparent_zenith=zenith, full_image=full) for full in (False, True))
    assert fast is not None
    assert literal is not None
    assert np.allclose(fast.columns, literal.columns, atol=0.5)
    assert np.allclose(fast.rows, literal.rows, atol=0.5)


def test_the_literal_path_is_a_convolution_of_the_whole_image() -> None:
    planes = planes_of(sky(x=212.0, y=251.0, radius=12.0), full_scale=4095)
    found = locate(planes, apparent_zenith=math.radians(50), full_image=True)
    assert found is not None
    for index, kernel in enumerate(kernels(diameter=found.diameter, sigma=found.sigma)):
        response = fftconvolve(planes.value().astype(np.float64), kernel, mode="same")
        row, column = np.unravel_index(int(np.argmax(response)), response.shape)
        assert abs(found.columns[index] - column) <= 1.0
        assert abs(found.rows[index] - row) <= 1.0


def test_medians_of_four_rows_and_five_columns_find_the_blob() -> None:
    planes = planes_of(sky(x=330.0, y=210.0, radius=15.0, smear=0.05), full_scale=4095)
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


@pytest.mark.parametrize(
    ("angle_deg", "blob_deg", "bias"),
    [
        (50, 2, -0.08),
        (50, 5, -0.51),
        (50, 8, -1.3),
        (50, 10, -2.0),
        (80, 2, -0.14),
        (80, 5, -0.87),
        (80, 8, -2.2),
        (80, 10, -3.5),
    ],
)
def test_the_blobs_bias_is_the_known_one(angle_deg: float, blob_deg: float, bias: float) -> None:
    lens = Lens(axis_px=(0.0, 0.0), radius_px=equisolid)
    found = radial_bias_px(lens, angle=math.radians(angle_deg), blob_radius=math.radians(blob_deg))
    assert found == pytest.approx(bias, rel=0.04, abs=0.006)


def test_a_stereographic_lens_has_another_bias_than_an_equisolid_one() -> None:
    stereographic = Lens(axis_px=(0.0, 0.0), radius_px=lambda angle: 2 * ALPHA_PX * np.tan(angle / 2))
    assert radial_bias_px(stereographic, angle=1.0, blob_radius=0.1) > 0.0


def test_a_blob_on_the_axis_has_no_bias() -> None:
    lens = Lens(axis_px=(0.0, 0.0), radius_px=equisolid)
    assert radial_bias_px(lens, angle=0.0, blob_radius=0.1) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("shape", [(5, 5, 4), (5,), (0, 5)])
def test_what_is_no_image_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="shape"):
        planes_of(np.zeros(shape, np.uint8), full_scale=255)
