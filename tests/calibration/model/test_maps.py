"""The map of every pixel against the answers to single pixels, and the table's own kernels as plain Python."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures.calibration import small_camera, spread_directions, stated_calibration

from sunarc.calibration.answers.covariance import project_with_covariance, sigma_deg
from sunarc.calibration.answers.direction_table import Lookup, back_projection_map, lookup
from sunarc.optics.forward import project
from sunarc.optics.inverse import unproject
from sunarc.sky.directions import angles_from_direction


@pytest.fixture(scope="module")
def ready() -> Lookup:
    return lookup(stated_calibration(small_camera(), amplitude_px=0.2))


def test_the_map_says_what_single_pixels_are_answered(ready: Lookup) -> None:
    found = back_projection_map(ready)
    assert found.zenith_deg.shape == found.sigma_deg.shape == (480, 640)
    assert found.directions.shape == (480, 640, 3)
    pixels = np.array([[300.0, 200.0], [5.0, 7.0], [639.0, 479.0], [320.0, 16.0]])
    rows = ready.back_project(pixels)
    for (x, y), row in zip(pixels.astype(int), rows, strict=True):
        if not found.inside[y, x]:
            assert np.isnan(row[0])
            continue
        np.testing.assert_allclose(found.zenith_deg[y, x], row[0], atol=1e-4)
        np.testing.assert_allclose(found.azimuth_deg[y, x], row[1], atol=1e-3)
        np.testing.assert_allclose(found.directions[y, x], row[2:5], atol=1e-6)
        np.testing.assert_allclose(found.sigma_deg[y, x], row[5], rtol=1e-5)


def test_angles_are_those_of_the_directions(ready: Lookup) -> None:
    pixels = np.random.default_rng(1).uniform([150.0, 100.0], [500.0, 400.0], (30, 2))
    rows = ready.back_project(pixels)
    directions = unproject(small_camera(), pixels)
    np.testing.assert_allclose(rows[:, 2:5], directions, atol=1e-8)
    zenith, azimuth = angles_from_direction(directions)
    np.testing.assert_allclose(rows[:, 0], zenith, atol=1e-6)
    np.testing.assert_allclose(rows[:, 1], azimuth, atol=1e-5)
    assert np.all((rows[:, 1] >= 0.0) & (rows[:, 1] < 360.0))
    assert np.all(rows[:, 6] == 1.0)


def test_the_table_s_sigma_and_covariance_are_the_exact_ones(ready: Lookup) -> None:
    calibration = stated_calibration(small_camera(), amplitude_px=0.2)
    directions = spread_directions(50, widest_deg=70.0)
    pixels, covariance = project_with_covariance(calibration, directions)
    rows = ready.project(directions)
    np.testing.assert_allclose(rows[:, :2], pixels, atol=1e-7)
    np.testing.assert_allclose(rows[:, 3], covariance[:, 0, 0], rtol=0.01)
    np.testing.assert_allclose(rows[:, 5], covariance[:, 1, 1], rtol=0.01)
    np.testing.assert_allclose(rows[:, 4], covariance[:, 0, 1], atol=0.01 * float(np.max(covariance)))
    np.testing.assert_allclose(rows[:, 2], np.sqrt(0.5 * (rows[:, 3] + rows[:, 5])), rtol=1e-9)
    np.testing.assert_allclose(ready.back_project(pixels)[:, 5], sigma_deg(calibration, directions), rtol=0.01)


def test_beyond_the_field_and_the_image(ready: Lookup) -> None:
    down = ready.project(np.array([[0.0, 0.0, -1.0]]))
    assert np.all(np.isnan(down[0, :6]))
    assert down[0, 6] == 0.0
    far = ready.back_project(np.array([[1e5, 1e5]]))
    assert np.all(np.isnan(far[0, :6]))
    assert far[0, 6] == 0.0
    beside = ready.back_project(np.array([[315.0, 479.6], [315.0, 479.4], [-0.6, 243.0], [-0.4, 243.0]]))
    assert beside[:, 6].tolist() == [0.0, 1.0, 0.0, 1.0]


def test_many_rows_are_answered_as_few(ready: Lookup) -> None:
    pixels = np.random.default_rng(2).uniform([0.0, 0.0], [640.0, 480.0], (33_000, 2))
    some = [0, 32_767, 32_768, 32_999]
    np.testing.assert_array_equal(ready.back_project(pixels)[some], ready.back_project(pixels[some]))


def test_a_mirrored_image_has_its_places_on_the_other_side() -> None:
    camera = small_camera()
    plain, mirrored = (
        lookup(stated_calibration(replace(camera, mirrored=flag), amplitude_px=0.2)) for flag in (False, True)
    )
    directions = spread_directions(10, widest_deg=60.0)
    one, other = plain.project(directions), mirrored.project(directions)
    np.testing.assert_allclose(other[:, 0], 639.0 - one[:, 0], atol=1e-7)
    np.testing.assert_allclose(other[:, 3], one[:, 3], rtol=1e-3)
    np.testing.assert_allclose(other[:, 4], -one[:, 4], atol=1e-3 * float(one[:, 3].max()))
    np.testing.assert_allclose(project(camera, directions), one[:, :2], atol=1e-7)
