"""Classification of ordinary images: every limit from both sides, and images without a sun."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.detection.rendering import FloatArray

from sunarc.detection import Detection, Expectation, Lens, detect_sun_in_photo, radial_bias_px
from sunarc.detection.photo.aureole import Halo, halo_about
from sunarc.detection.photo.circles import Circle
from sunarc.detection.photo.ordinary_image import _Blob, _fault, _halo_of, _light_around, _verdict
from sunarc.detection.values import Verdict
from sunarc.errors import InputError

HALO = Halo(100.0, 90.0, 0.05, 0.05, 0.9, 0.01, 0.3, 0.6)
CIRCLES = (Circle(100.4, 90.2, 12.0, 1.0, 0.2), Circle(99.8, 89.9, 13.0, 0.9, 0.2), Circle(100.0, 90.0, 14.0, 0.8, 0.2))
SEEN = _Blob(CIRCLES, 0.5, HALO)


def glare_image(
    x: float = 100.0, y: float = 90.0, *, radius: float = 9.0, size: int = 200, seed: int = 0
) -> NDArray[np.uint16]:
    """Return a linear mono image of 12 bits: a saturated blob in its own glare."""
    rows, columns = np.mgrid[:size, :size]
    far = np.hypot(columns - x, rows - y)
    light = 0.08 + 0.75 / (1.0 + (far / (2.0 * radius)) ** 2) + np.where(far < radius, 1.0, 0.0)
    light = light + np.random.default_rng(seed).normal(0.0, 0.003, light.shape)
    return np.asarray(np.clip(light * 4095.0, 0, 4095)).astype(np.uint16)


def found_in(image: NDArray[np.uint16], **arguments: Any) -> Detection:  # noqa: ANN401 - detect_sun_in_photo's own
    return detect_sun_in_photo(image, full_scale=4095, **arguments)


def fault(spread_px: float = 0.5, **halo: float) -> Verdict | None:
    answer = _fault(HALO._replace(**halo), spread_px)
    return None if answer is None else answer[0]


@pytest.mark.parametrize(
    ("inside", "outside", "spread_px", "verdict"),
    [
        ({"edge": 0.35}, {"edge": 0.349}, 0.5, "hidden"),
        ({"share": 0.5}, {"share": 0.499}, 0.5, "partly_covered"),
        ({"share": 0.4}, {"share": 0.399}, 0.29, "partly_covered"),
        ({"scatter": 0.04}, {"scatter": 0.0401}, 0.5, "veiled"),
        ({"scatter": 0.1}, {"scatter": 0.1001}, 0.29, "veiled"),
        ({"ellipticity": 0.32}, {"ellipticity": 0.321}, 0.5, "veiled"),
    ],
)
def test_each_limit_of_the_light_around(
    inside: dict[str, float], outside: dict[str, float], spread_px: float, verdict: Verdict
) -> None:
    assert fault(spread_px, **inside) is None
    assert fault(spread_px, **outside) == verdict


def test_an_uncertain_centre_is_veiled() -> None:
    assert fault(1.5) is None
    assert fault(1.51) == "veiled"


@pytest.mark.parametrize(("share", "spread_px", "verdict"), [(0.45, 0.29, None), (0.45, 0.31, "partly_covered")])
def test_a_certain_centre_needs_less(share: float, spread_px: float, verdict: Verdict | None) -> None:
    assert fault(spread_px, share=share) == verdict


@pytest.mark.parametrize(("off", "verdict"), [(11.9, "clear"), (12.1, "reflection")])
def test_a_blob_far_from_the_prediction_is_a_reflection(off: float, verdict: Verdict) -> None:
    expectation = Expectation(x_px=100.0 + 0.6 * off, y_px=90.0 + 0.8 * off, uncertainty_px=2.0)
    assert _verdict(SEEN, expectation)[0] == verdict
    assert _verdict(SEEN, None)[0] == "clear"


def test_a_blob_without_light_around_it_is_partly_covered() -> None:
    bare = SEEN._replace(halo=None)
    assert _verdict(bare, None)[0] == "partly_covered"
    assert bare.center == (100.0, 90.0)
    assert bare.spread_px == math.inf


def test_centre_radius_and_spread_of_a_blob() -> None:
    assert SEEN.center == (100.0, 90.0)
    assert SEEN.radius == 13.0
    assert SEEN.spread_px == pytest.approx(0.15)
    assert SEEN._replace(halo=None, circles=CIRCLES[:2]).center == pytest.approx((100.1, 90.05))


def test_the_score_is_the_product_of_its_parts() -> None:
    expected = 0.5**2 * 0.9 * 3.0 * math.sqrt(13.0) * 0.6**2 / (1.0 + (0.01 / 0.03) ** 2)
    assert SEEN.score == pytest.approx(expected)
    assert SEEN._replace(halo=None).score == pytest.approx(0.5**2 * 0.9 * 3.0 * math.sqrt(13.0))


def test_the_light_around_is_the_median_between_one_and_a_half_and_two_and_a_half_radii() -> None:
    rows, columns = np.mgrid[:100, :100]
    far = np.hypot(columns - 50.0, rows - 48.0)
    grey = np.where(far < 15.0, 1.0, np.where(far < 25.0, far / 100.0, 0.9)).astype(np.float32)
    circle = Circle(50.0, 48.0, 10.0, 1.0, 0.1)
    median = float(np.median(far[(far > 15.0) & (far < 25.0)])) / 100.0
    assert _light_around(grey, circle) == pytest.approx(median, rel=1e-5)
    assert _light_around(grey, circle._replace(x=500.0)) == 0.0


@pytest.mark.parametrize("place", [(100.0, 90.0), (60.3, 120.7), (140.5, 55.2)])
def test_the_sun_in_its_glare_is_found(place: tuple[float, float]) -> None:
    found = found_in(glare_image(*place), exposure_us=30.0)
    assert (found.verdict, found.accepted, found.method) == ("clear", True, "paper")
    assert (found.x_px, found.y_px) == pytest.approx(place, abs=0.15)
    assert found.radius_px == pytest.approx(9.0, abs=2.0)
    assert (found.peak_fraction, found.exposure_us) == (1.0, 30.0)
    assert found.sigma_px == pytest.approx(math.hypot(0.43, 0.02 * (found.radius_px or 0.0)), abs=0.05)
    assert found.saturated_px == pytest.approx(math.pi * 81.0, rel=0.1)
    assert found.background_fraction == pytest.approx(float(np.median(glare_image(*place))) / 4095.0, abs=0.02)


def test_the_papers_medians_are_the_answer_where_asked_for() -> None:
    found = found_in(glare_image(), robust=False)
    assert found.accepted
    assert (found.x_px, found.y_px) == pytest.approx((100.0, 90.0), abs=1.0)
    assert found.spread_px is not None


def equidistant(angle: FloatArray) -> FloatArray:
    return 110.0 * np.asarray(angle)


def test_with_a_lens_the_bias_is_reported_and_not_subtracted() -> None:
    lens = Lens(axis_px=(100.0, 20.0), radius_px=equidistant)
    plain, biased = found_in(glare_image()), found_in(glare_image(), lens=lens)
    assert (biased.x_px, biased.y_px) == (plain.x_px, plain.y_px)
    assert plain.radial_bias_px is None
    angle = 70.0 / 110.0
    blob = (plain.radius_px or 0.0) / math.sqrt(110.0 * 70.0 / math.sin(angle))
    assert biased.radial_bias_px == pytest.approx(radial_bias_px(lens, angle=angle, blob_radius=blob), rel=0.02)


@pytest.mark.parametrize(("zenith_deg", "below"), [(89.59, False), (89.61, True)])
def test_the_limit_of_the_zenith_angle(zenith_deg: float, *, below: bool) -> None:
    expectation = Expectation(x_px=100.0, y_px=90.0, apparent_zenith=math.radians(zenith_deg))
    assert (found_in(glare_image(), expectation=expectation).verdict == "below_horizon") == below


@pytest.mark.parametrize(("peak", "dark"), [(0.849, True), (0.86, False)])
def test_an_image_darker_than_the_least_peak_has_no_sun(peak: float, *, dark: bool) -> None:
    image = np.minimum(glare_image(), round(peak * 4095)).astype(np.uint16)
    found = found_in(image)
    assert (found.x_px is None) == dark
    assert found.peak_fraction == pytest.approx(peak, abs=1e-3)


def test_a_small_prediction_error_does_not_matter_and_a_large_one_rejects() -> None:
    near = Expectation(x_px=101.0, y_px=91.0, uncertainty_px=1.0)
    assert found_in(glare_image(), expectation=near).accepted
    assert not found_in(glare_image(), expectation=replace(near, x_px=160.0)).accepted


@pytest.mark.parametrize("shape", [(1, 1), (3, 3), (10, 10), (50, 4), (4, 50), (64, 64, 3), (1, 1, 3)])
@pytest.mark.parametrize("level", [0, 2000, 4095])
def test_an_even_image_of_any_size_has_no_sun(shape: tuple[int, ...], level: int) -> None:
    assert not found_in(np.full(shape, level, np.uint16)).accepted


def test_an_image_mostly_white_is_saturated() -> None:
    image = np.full((80, 80), 4095, np.uint16)
    image[:30] = 300
    assert found_in(image).verdict == "saturated"


def test_one_bright_pixel_is_no_sun() -> None:
    image = np.full((64, 64), 100, np.uint16)
    image[30, 31] = 4095
    assert found_in(image).verdict == "hidden"


def test_a_white_disc_without_glare_is_no_sun() -> None:
    rows, columns = np.mgrid[:200, :200]
    image = np.where(np.hypot(columns - 100.0, rows - 90.0) < 9.0, 4095, 400).astype(np.uint16)
    assert not found_in(image).accepted


@pytest.mark.parametrize(("radius", "accepted"), [(14.0, True), (18.0, False), (60.0, False)])
def test_a_blob_wider_than_its_share_of_the_image_is_no_sun(radius: float, *, accepted: bool) -> None:
    assert found_in(glare_image(radius=radius)).accepted == accepted  # 0.08 of 200 px are 16 px


def test_a_blob_at_the_corner_is_near_its_place_or_not_accepted() -> None:
    found = found_in(glare_image(2.0, 3.0))
    assert not found.accepted or (found.x_px, found.y_px) == pytest.approx(
        (2.0, 3.0), abs=3.0 * (found.sigma_px or 0.0)
    )


@pytest.mark.parametrize("dtype", [np.float64, np.int32, np.bool_])
def test_another_type_is_refused(dtype: type[np.generic]) -> None:
    with pytest.raises(InputError) as error:
        detect_sun_in_photo(np.zeros((32, 32), dtype), full_scale=255)
    assert error.value.field == "image"


def test_the_order_of_the_colours_does_not_matter() -> None:
    grey = glare_image()
    colour = np.stack([0.9 * grey, 0.95 * grey, grey], axis=-1).astype(np.uint16)
    one, other = found_in(colour), found_in(np.ascontiguousarray(colour[..., ::-1]))
    assert (one.x_px, one.y_px) == pytest.approx((other.x_px, other.y_px), abs=1e-3)
    assert one.verdict == other.verdict


@pytest.mark.parametrize("circle", [(60.3, 44.8, 9.0), (3.2, 70.1, 8.0), (95.0, 2.0, 12.5), (50.0, 40.0, 3.4)])
def test_the_light_around_is_that_of_the_whole_ring_within_the_image(
    circle: tuple[float, float, float],
) -> None:
    grey = np.random.default_rng(7).uniform(0.0, 1.0, (80, 100)).astype(np.float32)
    rows, columns = np.mgrid[:80, :100]
    far = np.hypot(columns - circle[0], rows - circle[1])
    ring = grey[(far > 1.5 * circle[2]) & (far < 2.5 * circle[2])]
    assert _light_around(grey, Circle(*circle, 1.0, 0.0)) == pytest.approx(float(np.median(ring)))


@pytest.mark.parametrize("radius", [4.0, 9.0])
def test_the_light_around_a_blob_is_taken_from_all_that_the_rings_reach(radius: float) -> None:
    grey = glare_image(radius=radius).astype(np.float32)
    seen = _Blob((Circle(100.0, 90.0, radius, 1.0, 0.0),), 0.5)
    found = _halo_of(grey, 4095.0, seen, 1.0)
    whole = halo_about(grey.astype(np.float64) / 4095.0, center=(100.0, 90.0), radius=radius)
    assert found is not None
    assert whole is not None
    assert tuple(found) == pytest.approx(tuple(whole), rel=1e-6, abs=1e-9)


def test_tones_are_made_linear_before_the_light_is_measured() -> None:
    grey = glare_image().astype(np.float32)
    seen = _Blob((Circle(100.0, 90.0, 9.0, 1.0, 0.0),), 0.5)
    toned = (4095.0 * (grey / 4095.0) ** (1.0 / 2.2)).astype(np.float32)
    linear, corrected = _halo_of(grey, 4095.0, seen, 1.0), _halo_of(toned, 4095.0, seen, 2.2)
    assert linear is not None
    assert corrected is not None
    assert corrected.edge == pytest.approx(linear.edge, rel=1e-4)
