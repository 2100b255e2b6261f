"""The sun in ordinary images: its place, what is reported, and images without a sun."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.detection.photo.suns import glare_image, with_text
from tests.fixtures.finding_codes import codes

from sunarc.common.errors import InputError
from sunarc.detection.photo.ordinary_image import Photo, detect_sun_in_photo
from sunarc.detection.values import Detection, Expectation


def found_in(image: NDArray[Any], **arguments: Any) -> Detection:  # noqa: ANN401 - those of Photo and of the detection
    of_photo = {name: arguments.pop(name) for name in ("exposure_us", "static", "bayer") if name in arguments}
    return detect_sun_in_photo(Photo(image, 4095, **of_photo), **arguments)


@pytest.mark.parametrize("place", [(100.0, 90.0), (60.3, 120.7), (140.5, 55.2)])
def test_the_sun_in_its_glare_is_found(place: tuple[float, float]) -> None:
    found = found_in(glare_image(*place), exposure_us=30.0)
    assert (found.verdict, found.accepted, found.method) == ("clear", True, "paper")
    assert (found.x_px, found.y_px) == pytest.approx(place, abs=0.15)
    assert found.radius_px == pytest.approx(9.0, abs=2.0)
    assert (found.peak_fraction, found.exposure_us) == (1.0, 30.0)
    assert found.sigma_px == pytest.approx(math.hypot(0.3, 0.015 * (found.radius_px or 0.0)), abs=0.08)
    assert found.saturated_px == pytest.approx(math.pi * 81.0, rel=0.1)
    assert found.background_fraction == pytest.approx(float(np.median(glare_image(*place))) / 4095.0, abs=0.02)


def test_the_papers_medians_are_the_answer_where_asked_for() -> None:
    found = found_in(glare_image(), robust=False)
    assert found.accepted
    assert (found.x_px, found.y_px) == pytest.approx((100.0, 90.0), abs=1.0)
    assert found.spread_px is not None


@pytest.mark.parametrize(("zenith_deg", "below"), [(89.59, False), (89.61, True)])
def test_the_limit_of_the_zenith_angle(zenith_deg: float, *, below: bool) -> None:
    expectation = Expectation(x_px=100.0, y_px=90.0, apparent_zenith=math.radians(zenith_deg))
    assert (found_in(glare_image(), expectation=expectation).verdict == "below_horizon") == below


@pytest.mark.parametrize(("peak", "dark"), [(0.34, True), (0.37, False)])
def test_an_image_darker_than_the_least_peak_has_no_sun(peak: float, *, dark: bool) -> None:
    image = (peak * glare_image()).astype(np.uint16)
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


@pytest.mark.parametrize(
    ("radius", "alone", "predicted"), [(18.0, True, True), (20.0, False, True), (27.0, False, False)]
)
def test_a_blob_wider_than_its_share_of_the_image_is_no_sun(radius: float, *, alone: bool, predicted: bool) -> None:
    image = glare_image(radius=radius)  # 0.09 and 0.12 of 200 px are 18 and 24 px; the rim is 1 px within
    assert found_in(image).accepted == alone
    assert found_in(image, expectation=Expectation(x_px=101.0, y_px=91.0, uncertainty_px=2.0)).accepted == predicted


def test_a_blob_at_the_corner_is_near_its_place_or_not_accepted() -> None:
    found = found_in(glare_image(2.0, 3.0))
    assert not found.accepted or (found.x_px, found.y_px) == pytest.approx(
        (2.0, 3.0), abs=3.0 * (found.sigma_px or 0.0)
    )


@pytest.mark.parametrize("dtype", [np.float64, np.int32, np.bool_])
def test_another_type_is_refused(dtype: type[np.generic]) -> None:
    with pytest.raises(InputError) as error:
        detect_sun_in_photo(Photo(np.zeros((32, 32), dtype), 255))
    assert error.value.field == "image"


def test_the_order_of_the_colours_does_not_matter() -> None:
    grey = glare_image()
    colour = np.stack([0.9 * grey, 0.95 * grey, grey], axis=-1).astype(np.uint16)
    one, other = found_in(colour), found_in(np.ascontiguousarray(colour[..., ::-1]))
    assert (one.x_px, one.y_px) == pytest.approx((other.x_px, other.y_px), abs=1e-3)
    assert one.verdict == other.verdict


def test_text_and_boxes_are_no_sun() -> None:
    assert not found_in(with_text(np.full((200, 200), 800, np.uint16))).accepted
    found = found_in(with_text(np.minimum(glare_image(radius=7.0), 2600).astype(np.uint16)))
    assert found.accepted
    assert (found.x_px, found.y_px) == pytest.approx((100.0, 90.0), abs=0.3)
    assert found.peak_fraction == pytest.approx(2600.0 / 4095.0, rel=0.01)


@pytest.mark.parametrize("reduced", [1, 4])
def test_what_stands_still_is_left_out_in_any_size(reduced: int) -> None:
    static = np.zeros((200 // reduced, 200 // reduced), np.bool_)
    static[60 // reduced : 120 // reduced, 70 // reduced : 130 // reduced] = True
    assert found_in(glare_image()).accepted
    assert not found_in(glare_image(), static=static).accepted


def test_a_raw_mosaic_gives_the_place_in_its_own_pixels() -> None:
    mosaic = glare_image(100.0, 90.0, radius=12.0)
    mosaic[::2, ::2] = (0.6 * mosaic[::2, ::2]).astype(np.uint16)
    mosaic[100::2, 100::2] = mosaic[100::2, 100::2]
    raw = np.clip(2.0 * mosaic.astype(np.float64), 0, 4095).astype(np.uint16)
    found = found_in(raw, bayer="RGGB")
    assert (found.x_px, found.y_px) == pytest.approx((100.0, 90.0), abs=1.0)
    assert found.radius_px == pytest.approx(17.0, abs=8.0)


def test_with_a_prediction_the_sun_is_chosen_between_two_suns() -> None:
    twins = np.maximum(glare_image(60.0, 100.0), glare_image(150.0, 60.0, radius=8.0))
    for x, y in ((60.0, 100.0), (150.0, 60.0)):
        found = found_in(twins, expectation=Expectation(x_px=x + 2.0, y_px=y - 2.0, uncertainty_px=3.0))
        assert found.accepted
        assert (found.x_px, found.y_px) == pytest.approx((x, y), abs=0.5)


def test_of_two_suns_alike_none_is_accepted_and_a_reflection_alone_is_one() -> None:
    sun, other = glare_image(60.0, 100.0), glare_image(150.0, 60.0)
    twins = found_in(np.maximum(sun, other))
    assert (twins.accepted, codes(twins.findings)) == (False, ["blob_not_alone"])
    reflection = found_in(other, expectation=Expectation(x_px=60.0, y_px=100.0))
    assert (reflection.accepted, reflection.verdict) == (False, "reflection")
    assert codes(reflection.findings) == ["blob_displaced"]


def test_a_sun_elsewhere_is_hidden_where_it_is_not_asked_for() -> None:
    image = glare_image(150.0, 100.0, size=900)
    expectation = Expectation(x_px=700.0, y_px=600.0)
    anywhere, there = (
        found_in(image, expectation=expectation),
        found_in(image, expectation=expectation, elsewhere=False),
    )
    assert (anywhere.verdict, codes(anywhere.findings)) == ("reflection", ["blob_displaced"])
    assert (there.verdict, codes(there.findings), there.x_px) == ("hidden", ["image_dark"], None)


def test_a_sun_too_wide_for_the_window_is_found_in_the_whole_image() -> None:
    image = glare_image(300.0, 400.0, radius=85.0, size=900)
    expectation = Expectation(x_px=301.0, y_px=399.0, uncertainty_px=1.0)
    found = found_in(image, expectation=expectation, elsewhere=False)
    assert found.radius_px == pytest.approx(85.0, abs=8.0)
    assert (found.x_px, found.y_px) == pytest.approx((300.0, 400.0), abs=0.5)


@pytest.mark.parametrize("bayer", [None, "RGGB"])
def test_the_background_of_a_window_is_the_whole_images(bayer: Any) -> None:  # noqa: ANN401 - the detector's own
    image = glare_image(300.0, 200.0, radius=11.0, size=900)
    expectation = Expectation(x_px=303.0, y_px=198.0, uncertainty_px=2.0)
    near, whole = (found_in(image, bayer=bayer, expectation=one) for one in (expectation, None))
    assert near.background_fraction == whole.background_fraction
    assert (near.accepted, near.x_px, near.sigma_px) == pytest.approx((True, whole.x_px, whole.sigma_px))


def test_the_background_of_a_mosaic_is_that_of_its_faintest_colour() -> None:
    grey = glare_image(300.0, 200.0, radius=11.0, size=900)
    reddish = grey.copy()
    reddish[::2, ::2] = np.minimum(2 * reddish[::2, ::2].astype(np.int64), 4095)
    seen, plain = (found_in(image, bayer="RGGB").background_fraction for image in (reddish, grey))
    assert seen == pytest.approx(plain, rel=0.03)  # of three noisy pixels of a cell, not of four


@pytest.mark.parametrize("margin", [60, 101, 200])
@pytest.mark.parametrize("predicted", [False, True])
def test_a_dark_frame_about_a_small_image_circle_changes_no_answer(margin: int, *, predicted: bool) -> None:
    rows, columns = np.mgrid[:200, :200]
    circle = np.where(np.hypot(columns - 99.5, rows - 99.5) < 98.0, glare_image(70.3, 120.7), 20).astype(np.uint16)
    framed = np.full((200 + 2 * margin, 200 + 2 * margin + 40), 20, dtype=np.uint16)
    framed[margin : margin + 200, margin : margin + 200] = circle
    still = np.zeros(framed.shape, dtype=np.bool_)
    place = Expectation(x_px=71.0, y_px=120.0) if predicted else None
    there = None if place is None else replace(place, x_px=71.0 + margin, y_px=120.0 + margin)
    alone, found = found_in(circle, expectation=place), found_in(framed, expectation=there, static=still)
    assert (alone.verdict, found.verdict) == ("clear", "clear")
    assert found.x_px == pytest.approx((alone.x_px or 0.0) + margin, abs=0.02)
    assert found.y_px == pytest.approx((alone.y_px or 0.0) + margin, abs=0.02)
    assert found.sigma_px == pytest.approx(alone.sigma_px, rel=0.1)
