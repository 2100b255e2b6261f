"""Stand-ins rendered from what real photographs showed: suns are placed, frames without one are refused."""

from __future__ import annotations

import numpy as np
import pytest
from tests.detection.photo.facts import KINDS, SUNLESS, accepted_without_a_sun, outcome_of, sun_photo, sunless_photo
from tests.detection.photo.predicted import compared, distance_px, stand_ins

from sunarc.detection.photo.ordinary_image import Photo, detect_sun_in_photo
from sunarc.detection.values import Expectation

FEW = {"haze": 1, "HDR, Raspberry Pi": 2, "thin cloud": 2}  # of five are accepted


@pytest.mark.parametrize(("kind", "least"), [(kind, FEW.get(kind, 3)) for kind in KINDS])
def test_suns_of_every_kind_are_placed(kind: str, least: int) -> None:
    found = outcome_of(kind, 5, np.random.default_rng(7), size=480)
    assert len(found.error_px) >= least
    assert float(np.median(found.error_px)) < (0.015 if kind == "thin cloud" else 0.008) * 480
    assert 0.02 <= found.chi2 < 8.0


@pytest.mark.parametrize("kind", SUNLESS)
def test_frames_without_a_sun_are_refused(kind: str) -> None:
    assert accepted_without_a_sun(kind, 6, np.random.default_rng(2)) == (0, 0)


def test_a_hill_of_cloud_that_is_clipped_round_and_alone_is_refused_by_the_light_about_it() -> None:
    hill = sunless_photo("overcast", np.random.default_rng(1675))
    found = detect_sun_in_photo(Photo(hill, 255))
    assert not found.accepted
    assert found.x_px is not None
    # nor does a prediction at its place, or beside it, make it the sun
    for away in (0.0, 15.0):
        place = Expectation(x_px=found.x_px + away, y_px=found.y_px or 0.0, uncertainty_px=2.0)
        assert not detect_sun_in_photo(Photo(hill, 255), expectation=place).accepted


def test_an_overlay_brighter_than_a_clipped_sun_is_not_taken_for_it() -> None:
    image, place = sun_photo(KINDS["clipped at 160"], np.random.default_rng(4))
    found = detect_sun_in_photo(Photo(image, 255))
    assert int(image.max()) > 200
    assert found.peak_fraction == pytest.approx(160.0 / 255.0, abs=0.02)
    assert (found.x_px, found.y_px) == pytest.approx(place, abs=3.0)


@pytest.mark.parametrize("kind", KINDS)
def test_the_window_about_a_prediction_places_suns_as_the_whole_image_does(kind: str) -> None:
    rng = np.random.default_rng(12)
    for image, place in stand_ins(kind, 4, 720, rng):
        one = compared(image, place, rng)
        assert one.window.verdict == one.whole.verdict
        if one.whole.verdict == "clear":
            assert distance_px(one) < 0.01


@pytest.mark.parametrize("kind", SUNLESS)
def test_a_window_accepts_nothing_that_the_whole_image_does_not(kind: str) -> None:
    rng = np.random.default_rng(13)
    for image, place in stand_ins(kind, 6, 480, rng):
        one = compared(image, place, rng)
        assert (one.window.verdict == "clear") <= (one.whole.verdict == "clear")
