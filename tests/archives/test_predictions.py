"""Predictions of a camera, and which sightings agree with them."""

from __future__ import annotations

import math
from datetime import UTC, datetime

import numpy as np
import pytest
from tests.fixtures.calibration import SGP, small_camera, stated_calibration

from sunarc.archives.passes import FoundSun, Looked, scatter_beyond_px, without_lifted
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.solve.priors import FREE_NAMES
from sunarc.detection.values import Detection, Expectation
from sunarc.optics.forward import project
from sunarc.sky.sun import sun_angles, sun_directions
from sunarc.sources.expected_sun import as_predicted, expectations, is_consistent

CAMERA = small_camera()
NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC).timestamp()


def sighting(x: float | None, *, sigma: float | None = 1.0, accepted: bool = True) -> FoundSun:
    return FoundSun(accepted, "clear", x, None if x is None else 50.0, sigma)


def test_a_prediction_is_the_cameras_pixel_with_its_surroundings() -> None:
    (one,) = expectations(stated_calibration(CAMERA), np.array([NOON]), site=SGP)
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
    assert expectations(small, np.zeros(0), site=SGP) == []
    beside = [one is None for one in expectations(small, np.array([NOON, evening + 6 * 3600.0]), site=SGP)]
    assert beside == [False, True]


@pytest.mark.parametrize(("x", "sigma", "expected"), [
    (100.0, 1.0, True), (113.0, 1.0, True), (114.5, 1.0, False), (137.0, 10.0, True), (114.0, None, False)
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
    (one,) = expectations(calibration, np.array([NOON]), site=SGP)
    assert one is not None
    assert one.uncertainty_px == pytest.approx(4.0, rel=1e-3)


def test_what_is_beyond_the_sigmas_of_both_is_refused_as_displaced() -> None:
    place = Expectation(x_px=100.0, y_px=50.0, uncertainty_px=1.0)

    def found(x: float) -> Detection:
        return Detection(method="paper", accepted=True, verdict="clear", findings=(), x_px=x, y_px=50.0, sigma_px=1.0)

    assert as_predicted(found(104.9), place) == found(104.9)
    refused = as_predicted(found(105.1), place)
    assert (refused.accepted, refused.verdict, refused.findings[0].code) == (False, "reflection", "blob_displaced")
    assert refused.findings[0].data["distance_px"] == pytest.approx(5.1)
    assert as_predicted(found(200.0), None).accepted


@pytest.mark.parametrize(("sigma", "expected"), [(2.5, 0.0), (1.0, math.sqrt(3.0))])
def test_the_misfit_is_what_the_sightings_scatter_beyond_their_sigma(sigma: float, expected: float) -> None:
    rng = np.random.default_rng(3)
    times = np.array([NOON + 60.0 * n for n in range(150)])
    pixels = project(CAMERA, sun_directions(times, SGP))
    points = Sightings.of(
        unix_s=times, pixels=pixels + rng.normal(0.0, 2.0, pixels.shape), sigma_px=np.full(times.size, sigma)
    )
    camera = stated_calibration(CAMERA, sigma_px=7.0)
    assert scatter_beyond_px(camera, points, site=SGP) == pytest.approx(expected, abs=0.25)
    assert scatter_beyond_px(camera, points.select(np.arange(3)), site=SGP) == 7.0


def test_the_prediction_of_a_refused_epoch_lifts_no_refusal() -> None:
    veiled, moved = sighting(None, accepted=False), sighting(104.0)
    searched = Looked((), (veiled, veiled, sighting(100.0), sighting(100.0)))
    looked = Looked((), (sighting(161.0), sighting(161.0), moved, veiled))
    held = without_lifted(searched, looked, [True, False, True, True])
    # what the first pass refused stays refused; what it accepted may move, or be refused
    assert held.found == (veiled, sighting(161.0), moved, veiled)
