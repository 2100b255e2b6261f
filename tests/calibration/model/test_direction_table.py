from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, get_args

import numpy as np
import population as pop
import pytest
from tests.fixtures.calibration import small_camera, stated_calibration

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance, sigma_px, unproject_with_sigma
from sunarc.calibration.answers.direction_table import Lookup, lookup
from sunarc.calibration.calibrate import calibrate
from sunarc.optics.forward import project
from sunarc.optics.projections import Projection
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
    found = ready.back_project(pixels)
    np.testing.assert_allclose(found[:, 0], zenith, atol=1e-8)
    assert np.nanmax(np.abs((found[:, 1] - azimuth + 180.0) % 360.0 - 180.0) * np.sin(np.radians(zenith))) < 1e-8
    assert np.all((found[:, 1] >= 0.0) & (found[:, 1] < 360.0) | np.isnan(zenith))
    np.testing.assert_allclose(found[:, 2:5], directions, atol=1e-10)
    np.testing.assert_array_equal(found[:, 6] == 1.0, inside)
    assert np.any(np.isnan(zenith))


def test_the_tables_uncertainty_is_the_exact_one_to_one_percent(calibrated: Calibration, ready: Lookup) -> None:
    pixels = np.random.default_rng(1).uniform(-60.0, 1810.0, (3000, 2))
    directions, sigma, inside = unproject_with_sigma(calibrated, pixels)
    found = ready.back_project(pixels)[:, 5]
    np.testing.assert_array_equal(np.isnan(found), np.isnan(sigma))
    off = np.abs(found / sigma - 1.0)
    assert np.nanmax(off) < 0.01
    assert np.nanquantile(off, 0.99) < 0.001
    landed, covariance = project_with_covariance(calibrated, directions[inside])
    projected = ready.project(directions[inside])
    np.testing.assert_array_equal(projected[:, :2], landed)
    assert np.max(np.abs(projected[:, 2] / sigma_px(covariance) - 1.0)) < 0.01
    apart = projected[:, [3, 4, 4, 5]].reshape(-1, 2, 2) - covariance
    assert np.max(np.abs(apart) / sigma_px(covariance)[:, None, None] ** 2) < 0.03


@pytest.mark.parametrize("projection", get_args(Projection))
@pytest.mark.parametrize("decentering", [1.0, 2.0])
@pytest.mark.parametrize("amplitude_px", [0.0, 0.2])
def test_every_lens_has_the_exact_uncertainty_to_one_percent_out_to_its_edge(
    projection: Projection, decentering: float, amplitude_px: float
) -> None:
    """An orthographic lens hardly stretches at its edge, where the 1-sigma grows by a hundred within a degree."""
    camera = small_camera(projection)
    p1, p2, *higher = camera.decentering
    camera = replace(camera, decentering=(decentering * p1, decentering * p2, *higher))
    stated = stated_calibration(camera, amplitude_px=amplitude_px)
    pixels = np.random.default_rng(4).uniform([0.0, 0.0], [640.0, 480.0], (2000, 2))
    directions, sigma, _ = unproject_with_sigma(stated, pixels)
    seen = np.isfinite(sigma)
    assert np.sum(seen) > 900
    served = lookup(stated)
    assert np.max(np.abs(served.back_project(pixels[seen])[:, 5] / sigma[seen] - 1.0)) < 0.01
    exact = sigma_px(project_with_covariance(stated, directions[seen])[1])
    assert np.max(np.abs(served.project(directions[seen])[:, 2] / exact - 1.0)) < 0.01


def test_along_the_track_of_a_lens_with_a_field_the_uncertainty_is_the_exact_one_to_twelve_percent() -> None:
    """The field is known there and unknown beside it: the 1-sigma has a kink that no spline follows."""
    rng = np.random.default_rng(8000)
    truth, times = pop.random_camera(rng), pop.sun_track(np.zeros(1), cadence_s=300.0)
    field = pop.smooth_field(rng, amplitude_px=0.4, length_px=425.0)
    points = pop.sightings(truth, times, pop.white_noise(rng, times.size, 0.02), field=field)
    fit = calibrate(points, site=pop.SGP, image_size=(pop.SIZE, pop.SIZE))
    assert fit.field.amplitude_px > 0.1
    near = project(fit.camera, pop.track((0,), cadence_s=300.0).directions) + rng.normal(0.0, 15.0, (times.size, 2))
    for pixels, most, quantile in ((near, 0.12, 1.0), (rng.uniform(0.0, pop.SIZE - 1.0, (3000, 2)), 0.03, 0.99)):
        _, sigma, inside = unproject_with_sigma(fit, pixels)
        off = np.abs(lookup(fit).back_project(pixels)[inside, 5] / sigma[inside] - 1.0)
        assert np.quantile(off, quantile) < most


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
    assert np.nanmax(np.abs(np.degrees(np.sqrt(0.5 * size)) / exact - 1.0)) < 0.01


def test_single_precision_is_answered_in_single_precision(ready: Lookup) -> None:
    pixels = np.random.default_rng(2).uniform(300.0, 1400.0, (70_000, 2)).astype(np.float32)
    found, exact = ready.back_project(pixels), ready.back_project(pixels.astype(np.float64))
    assert [found.dtype.name, exact.dtype.name] == ["float32", "float64"]
    assert np.max(np.abs(found - exact)) < 2e-5


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
