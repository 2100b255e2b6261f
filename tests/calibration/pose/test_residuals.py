"""Noise of sightings for a pose, and neighbours taken together."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures.calibration import small_camera, stated_calibration, sun_arc

from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.pose import MOST, gathered, noise_px, variance_inflation
from sunarc.common.robust_statistics import finite
from sunarc.optics.forward import project


def _with(calibration: Calibration, **evidence: float) -> Calibration:
    return replace(calibration, evidence=replace(calibration.evidence, **evidence))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    return stated_calibration(small_camera(), sigma_px=0.1)


def test_a_stated_sigma_counts_where_it_is_larger_than_the_calibration_s(calibration: Calibration) -> None:
    found = noise_px(calibration, np.array([0.3, 0.02, np.nan, 0.0, -1.0]))
    np.testing.assert_allclose(found, [0.3, 0.1, 0.1, 0.1, 0.1])


@pytest.mark.parametrize("own", [math.nan, 0.0, -1.0, math.inf])
def test_a_calibration_without_its_noise_has_half_a_pixel(calibration: Calibration, own: float) -> None:
    np.testing.assert_allclose(noise_px(_with(calibration, sigma_px=own), np.array([np.nan, 0.7])), [0.5, 0.7])


def test_noise_is_never_below_a_two_hundredth_of_a_pixel(calibration: Calibration) -> None:
    np.testing.assert_allclose(noise_px(_with(calibration, sigma_px=1e-6), np.array([np.nan, 1e-4])), 0.005)


@pytest.mark.parametrize(("stated", "expected"), [(1.0, 1.0), (4.0, 4.0), (0.2, 1.0), (100.0, 25.0), (math.nan, 1.0)])
def test_the_inflation_lies_between_1_and_25(calibration: Calibration, stated: float, expected: float) -> None:
    assert variance_inflation(_with(calibration, inflation=stated)) == expected


def test_residuals_of_what_is_not_seen_lie_far_off() -> None:
    np.testing.assert_array_equal(finite(np.array([1.0, np.nan, np.inf])), [1.0, 1e4, 1e4])


def _seen(count: int, *, variance: float = 0.04) -> Sightings:
    directions = sun_arc(count)
    return Sightings(
        directions=directions,
        pixels=project(small_camera(), directions),
        sigma_px=np.full(count, math.sqrt(variance)),
    )


def test_few_sightings_stay_as_they_are_but_for_the_inflation() -> None:
    seen = _seen(MOST)
    found = gathered(small_camera(), seen, np.ones(MOST, dtype=bool), inflation=3.0)
    np.testing.assert_allclose(found.directions, seen.directions, atol=1e-12)
    np.testing.assert_allclose(found.pixels, seen.pixels, atol=1e-8)
    np.testing.assert_allclose(found.variance, 0.12)


def test_many_sightings_are_averaged_to_at_most_eighty() -> None:
    found = gathered(small_camera(), _seen(400), np.ones(400, dtype=bool), inflation=1.0)
    assert found.variance.size == 80
    np.testing.assert_allclose(found.variance, 0.04 / 5.0)
    # a mean of residuals of nothing lies on the model
    np.testing.assert_allclose(found.pixels, project(small_camera(), found.directions), atol=1e-8)


def test_outliers_have_no_part() -> None:
    seen = _seen(160)
    pixels = seen.pixels.copy()
    pixels[::4] += 50.0
    inlier = np.arange(160) % 4 != 0
    found = gathered(small_camera(), replace(seen, pixels=pixels), inlier, inflation=1.0)
    assert found.variance.size == 60
    np.testing.assert_allclose(found.pixels, project(small_camera(), found.directions), atol=1e-8)


def test_a_mean_residual_is_carried_by_its_bin() -> None:
    seen = _seen(160)
    shift = np.where(np.arange(160) % 2 == 0, 0.2, 0.6)[:, None] * [1.0, -1.0]
    found = gathered(small_camera(), replace(seen, pixels=seen.pixels + shift), np.ones(160, dtype=bool), inflation=1.0)
    residual = found.pixels - project(small_camera(), found.directions)
    np.testing.assert_allclose(residual, np.tile([0.4, -0.4], (80, 1)), atol=1e-8)


def test_no_inlier_gives_nothing() -> None:
    assert gathered(small_camera(), _seen(5), np.zeros(5, dtype=bool), inflation=1.0).variance.size == 0


def test_a_selection_keeps_the_columns_together() -> None:
    some = _seen(10).select(np.array([7, 2]))
    np.testing.assert_allclose(some.directions, sun_arc(10)[[7, 2]])
    assert some.variance.size == some.false_density.size == 2
