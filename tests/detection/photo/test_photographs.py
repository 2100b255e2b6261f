"""Ordinary photographs without site or calibration."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from tests.detection.photographs import Photograph, photograph

from sunarc.detection.photo.ordinary_image import Photo, detect_sun_in_photo
from sunarc.detection.values import Expectation


def errors(count: int, seed: int = 3, **scene: Any) -> list[tuple[float, bool]]:  # noqa: ANN401 - the scene's own fields
    """Return the distance to the sun and whether it was accepted, for every picture with a position."""
    rng, found = np.random.default_rng(seed), []
    for _ in range(count):
        picture = Photograph(zenith_deg=rng.uniform(10, 75), azimuth_deg=rng.uniform(0, 360), **scene)
        seen = detect_sun_in_photo(Photo(photograph(picture, rng), 255))
        if seen.x_px is not None and seen.y_px is not None:
            x, y = picture.sun_px
            found.append((math.hypot(seen.x_px - x, seen.y_px - y), seen.accepted))
    return found


@pytest.mark.parametrize(
    "scene",
    [
        pytest.param({}, id="clear"),
        pytest.param({"streaks": 4}, id="streaks"),
        pytest.param({"haze": 1.2}, id="haze, drawn out by the lens"),
        pytest.param({"exposure": 0.4}, id="a short exposure"),
        pytest.param({"dirt": 3}, id="dirt beside the sun"),
        pytest.param({"snow": True, "wider": 100, "smear": 0.5}, id="snow, smear, not square"),
        pytest.param({"bright_cloud": True}, id="saturated cloud beside the sun"),
        pytest.param({"ghost": True}, id="reflection opposite the sun"),
        pytest.param({"quality": 60}, id="poor JPEG"),
    ],
)
def test_the_sun_is_found_to_two_pixels(scene: dict[str, Any]) -> None:
    found = errors(2, **scene)
    assert len(found) == 2
    assert np.median([distance for distance, _ in found]) < 2.0
    assert all(distance < 5.0 for distance, accepted in found if accepted)


@pytest.mark.parametrize(
    ("scene", "least"), [({}, 2), ({"streaks": 6}, 2), ({"haze": 1.2}, 2), ({"dirt": 2}, 1), ({"contrails": 1}, 1)]
)
def test_most_clear_suns_are_accepted(scene: dict[str, Any], least: int) -> None:
    assert sum(accepted for _, accepted in errors(2, **scene)) >= least


@pytest.mark.parametrize("scene", [{"thin_cloud": 0.1}, {"thin_cloud": 0.5}, {"thin_cloud": 2.0}, {"contrails": 4}])
def test_a_blob_pulled_far_off_the_sun_is_not_accepted(scene: dict[str, Any]) -> None:
    assert not [distance for distance, accepted in errors(2, **scene) if accepted and distance > 16.0]


@pytest.mark.parametrize("level", [0, 100, 255])
def test_a_blank_picture_holds_no_sun(level: int) -> None:
    seen = detect_sun_in_photo(Photo(np.full((300, 300, 3), level, np.uint8), 255))
    assert not seen.accepted


def test_a_sun_far_from_the_expectation_is_not_accepted() -> None:
    picture = Photograph()
    expectation = Expectation(x_px=picture.sun_px[0] - 200.0, y_px=picture.sun_px[1], uncertainty_px=3.0)
    image = photograph(picture, np.random.default_rng(1))
    assert not detect_sun_in_photo(Photo(image, 255), expectation=expectation).accepted
