"""Predictions of a consensus camera, and which sightings agree with them."""

from __future__ import annotations

import math
from datetime import UTC, datetime

import numpy as np
import pytest
from tests.fixtures.calibration import SGP, small_camera, stated_calibration

from sunarc.archive import FileSighting
from sunarc.calibration.least_squares.priors import FREE_NAMES
from sunarc.detection import Expectation
from sunarc.offline.ingest.consensus import expectations, is_consistent
from sunarc.offline.ingest.index import ImageFile
from sunarc.optics import project
from sunarc.sky import sun_angles, sun_directions

CAMERA = small_camera()
NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC).timestamp()


def image(unix_s: float) -> ImageFile:
    return ImageFile("a.png", (round(unix_s * 1e6), 0.0, "a.png"))


def sighting(x: float | None, *, sigma: float | None = 1.0, accepted: bool = True) -> FileSighting:
    return FileSighting(0, 0.0, "a.png", "paper", accepted, "clear", 1, x, None if x is None else 50.0, sigma, 8.0)


def test_a_prediction_is_the_cameras_pixel_with_its_surroundings() -> None:
    (one,) = expectations(stated_calibration(CAMERA), [image(NOON)], site=SGP)
    assert one is not None
    direction = sun_directions(NOON, SGP)
    assert (one.x_px, one.y_px) == pytest.approx(project(CAMERA, direction).tolist())
    assert one.apparent_zenith == pytest.approx(math.radians(float(sun_angles(NOON, SGP).apparent_zenith)))
    assert 1.0 <= one.uncertainty_px < 10.0
    across = np.linalg.norm(np.array(one.stretch_px_per_rad), axis=0)
    assert np.all((across > 150.0) & (across < 300.0))  # about the focal length, 220 px


def test_outside_the_image_there_is_no_prediction() -> None:
    evening = datetime(2013, 5, 14, 1, 0, tzinfo=UTC).timestamp()
    small = stated_calibration(small_camera())
    assert expectations(small, [], site=SGP) == []
    beside = [one is None for one in expectations(small, [image(NOON), image(evening + 6 * 3600.0)], site=SGP)]
    assert beside == [False, True]


@pytest.mark.parametrize(("x", "sigma", "expected"), [
    (100.0, 1.0, True), (116.0, 1.0, True), (118.0, 1.0, False), (140.0, 10.0, True), (117.0, None, False)
])  # fmt: skip
def test_a_sighting_agrees_within_the_sigmas_of_both(x: float, sigma: float | None, expected: bool) -> None:  # noqa: FBT001
    place = Expectation(x_px=100.0, y_px=50.0, uncertainty_px=3.8)
    assert is_consistent(sighting(x, sigma=sigma), place) is expected


def test_what_is_rejected_or_not_predicted_agrees_with_nothing() -> None:
    place = Expectation(x_px=100.0, y_px=50.0)
    assert not is_consistent(sighting(100.0, accepted=False), place)
    assert not is_consistent(sighting(None, accepted=False), place)
    assert not is_consistent(sighting(100.0), None)


def test_a_prediction_is_no_better_than_the_scatter_of_what_it_was_fitted_to() -> None:
    calibration = stated_calibration(CAMERA, covariance=1e-12 * np.eye(len(FREE_NAMES)), sigma_px=4.0)
    (one,) = expectations(calibration, [image(NOON)], site=SGP)
    assert one is not None
    assert one.uncertainty_px == pytest.approx(4.0, rel=1e-3)
