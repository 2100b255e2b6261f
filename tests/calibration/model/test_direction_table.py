from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance, sigma_px, unproject_with_sigma
from sunarc.calibration.answers.direction_table import Lookup, lookup
from sunarc.sky.directions import angles_from_direction

if TYPE_CHECKING:
    from sunarc.calibration.model.result import Calibration


@pytest.fixture(scope="module")
def ready(calibrated: Calibration) -> Lookup:
    return lookup(calibrated)


def test_pixels_look_where_the_camera_says(calibrated: Calibration, ready: Lookup) -> None:
    pixels = np.random.default_rng(0).uniform(-60.0, 1810.0, (3000, 2))
    directions, _, inside = unproject_with_sigma(calibrated, pixels)
    zenith, azimuth = angles_from_direction(directions)
    describe_change = ready.back_project(pixels)
    np.testing.assert_allclose(describe_change[:, 0], zenith, atol=1e-8)
    assert (
        np.nanmax(np.abs((describe_change[:, 1] - azimuth + 180.0) % 360.0 - 180.0) * np.sin(np.radians(zenith))) < 1e-8
    )
    assert np.all((describe_change[:, 1] >= 0.0) & (describe_change[:, 1] < 360.0) | np.isnan(zenith))
    np.testing.assert_allclose(describe_change[:, 2:5], directions, atol=1e-10)
    np.testing.assert_array_equal(describe_change[:, 6] == 1.0, inside)
    assert np.any(np.isnan(zenith))


def test_the_tables_uncertainty_is_the_exact_one_to_a_few_percent(calibrated: Calibration, ready: Lookup) -> None:
    pixels = np.random.default_rng(1).uniform(-60.0, 1810.0, (3000, 2))
    directions, sigma, _ = unproject_with_sigma(calibrated, pixels)
    describe_change = ready.back_project(pixels)[:, 5]
    np.testing.assert_array_equal(np.isnan(describe_change), np.isnan(sigma))
    off = np.abs(describe_change / sigma - 1.0)
    assert np.nanmax(off) < 0.03
    assert np.nanquantile(off, 0.99) < 0.01
    known = np.isfinite(sigma)
    landed, covariance = project_with_covariance(calibrated, directions[known])
    projected = ready.project(directions[known])
    np.testing.assert_array_equal(projected[:, :2], landed)
    assert np.max(np.abs(projected[:, 2] / sigma_px(covariance) - 1.0)) < 0.03
    apart = projected[:, [3, 4, 4, 5]].reshape(-1, 2, 2) - covariance
    assert np.max(np.abs(apart) / sigma_px(covariance)[:, None, None] ** 2) < 0.1


def test_covariances_of_directions_are_across_them_and_as_large_as_sigma(
    calibrated: Calibration, ready: Lookup
) -> None:
    directions = hemisphere(400)
    pixels = ready.project(directions)[:, :2]
    covariance = ready.direction_covariance(directions)
    along = np.einsum("nij,nj->ni", covariance, directions)
    size = np.trace(covariance, axis1=1, axis2=2)
    assert np.nanmax(np.abs(along) / size[:, None]) < 1e-9
    exact = unproject_with_sigma(calibrated, pixels)[1]
    assert np.nanmax(np.abs(np.degrees(np.sqrt(0.5 * size)) / exact - 1.0)) < 0.03


def test_single_precision_is_answered_in_single_precision(ready: Lookup) -> None:
    pixels = np.random.default_rng(2).uniform(300.0, 1400.0, (70_000, 2)).astype(np.float32)
    describe_change, exact = ready.back_project(pixels), ready.back_project(pixels.astype(np.float64))
    assert [describe_change.dtype.name, exact.dtype.name] == ["float32", "float64"]
    assert np.max(np.abs(describe_change - exact)) < 2e-5


def test_a_mirrored_image_has_the_same_uncertainty_on_the_other_side(calibrated: Calibration) -> None:
    camera = calibrated.camera
    mirrored = lookup(replace(calibrated, camera=replace(camera, mirrored=True)))
    pixels = np.random.default_rng(3).uniform(300.0, 1400.0, (200, 2))
    other_side = np.stack([camera.width - 1.0 - pixels[:, 0], pixels[:, 1]], axis=-1)
    np.testing.assert_allclose(
        mirrored.back_project(other_side)[:, 2:5], lookup(calibrated).back_project(pixels)[:, 2:5], atol=1e-12
    )


def test_few_rows_of_single_precision_are_answered_in_single_precision(ready: Lookup) -> None:
    pixels = np.array([[400.0, 500.0], [900.0, 1200.0]], dtype=np.float32)
    assert ready.back_project(pixels).dtype == np.float32
    assert ready.project(ready.back_project(pixels)[:, 2:5]).dtype == np.float32
