"""Sightings that are no track: many of one moment, of stated directions, beside the sun's or without them."""

from __future__ import annotations

import numpy as np
import population as pop
import pytest
from numpy.typing import NDArray

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings, apparent_directions, filter_sightings
from sunarc.calibration.solve.problem import time_bins
from sunarc.common.errors import InputError
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.sky.directions import direction_from_angles
from sunarc.sky.sun import sun_directions

FloatArray = NDArray[np.float64]

NIGHT = pop.MAY_13 + 6 * 3600.0
"""Midnight at the site."""


def _spread(rng: np.random.Generator, count: int) -> FloatArray:
    """Return directions evenly over the sky down to 80 degrees from the zenith."""
    zenith = np.degrees(np.arccos(rng.uniform(np.cos(np.radians(80.0)), 1.0, count)))
    return direction_from_angles(zenith_deg=zenith, azimuth_deg=rng.uniform(0.0, 360.0, count))


def _fitted(camera: Camera, points: Sightings) -> Calibration:
    x, y = camera.principal_point_px
    circle = ImageCircle(x=x + 1.0, y=y - 1.0, radius=camera.focal_length_px[0] * np.sqrt(2.0) + 1.5)
    return calibrate(points, site=pop.SGP, image_size=(pop.SIZE, pop.SIZE), options=CalibrationOptions(), circle=circle)


def _sky_error_px(fit: Calibration, camera: Camera) -> float:
    error = project(fit.camera, hemisphere()) - project(camera, hemisphere())
    return float(np.sqrt(np.nanmean(np.sum(error**2, axis=-1))))


@pytest.mark.parametrize("seed", [1, 2])
def test_six_hundred_stars_of_one_moment_are_as_good_as_theory(seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = pop.random_camera(rng)
    directions = _spread(rng, 600)
    pixels = project(camera, directions) + rng.normal(0.0, 0.28, (600, 2))
    fit = _fitted(camera, Sightings.of(unix_s=np.full(600, NIGHT), pixels=pixels, directions=directions))
    assert fit.verdict.accepted
    assert fit.evidence.n_used > 590
    assert fit.evidence.sigma_px == pytest.approx(0.28, rel=0.1)
    # 20 free parameters: 0.28 px √(2 · 20 / 1200) = 0.05 px over the stars; a little more towards the horizon
    assert 0.02 < _sky_error_px(fit, camera) < 0.12


@pytest.mark.parametrize("factor", [1.0, 3.0])
def test_stars_beside_the_sun_help_even_where_their_sigma_is_stated_wrong(factor: float) -> None:
    rng = np.random.default_rng(5)
    camera = pop.random_camera(rng)
    times = pop.sun_track(np.zeros(1), cadence_s=120.0)
    sun = pop.sightings(camera, times, pop.white_noise(rng, times.size, 0.5))
    directions = _spread(rng, 150)
    stars = project(camera, directions) + rng.normal(0.0, 0.005 * factor, (150, 2))
    joint = Sightings.of(
        unix_s=np.r_[times, np.full(150, NIGHT)],
        pixels=np.concatenate([sun.pixels, stars]),
        sigma_px=np.r_[np.full(times.size, 0.5), np.full(150, 0.005)],
        directions=np.concatenate([np.full((times.size, 3), np.nan), directions]),
    )
    alone, together = (_sky_error_px(_fitted(camera, points), camera) for points in (sun, joint))
    assert together < 0.25 * alone
    assert 0.0 < together < 0.05 * factor


def test_a_stated_direction_is_taken_and_the_others_are_the_sun_s() -> None:
    times = pop.MAY_13 + 3600.0 * np.array([18.0, 19.0])
    east = np.array([[0.6, 0.0, 0.8], [np.nan] * 3])
    points = Sightings.of(unix_s=times, pixels=np.ones((2, 2)), directions=2.0 * east)
    found = apparent_directions(points, site=pop.SGP)
    np.testing.assert_allclose(found[0], [0.6, 0.0, 0.8])
    np.testing.assert_allclose(found[1], sun_directions(times[1:], pop.SGP)[0])
    alone = filter_sightings(points, site=pop.SGP).alone
    assert alone.tolist() == [False, True]


def test_the_track_comes_first_and_stars_of_one_moment_stay_but_for_repeated_ones() -> None:
    times = pop.MAY_13 + 3600.0 * np.array([19.0, 18.0, 18.0, 18.0, 18.0, 18.0])
    stars = direction_from_angles(zenith_deg=np.array([20.0, 40.0, 40.0]), azimuth_deg=np.array([10.0, 80.0, 80.0]))
    nothing = np.full(3, np.nan)
    directions = np.stack([nothing, stars[0], nothing, stars[1], stars[2], nothing])
    pixels = np.array([[9.0, 9.0], [1.0, 1.0], [8.0, 8.0], [2.0, 2.0], [2.0, 2.0], [8.0, 8.0]])
    found = filter_sightings(Sightings.of(unix_s=times, pixels=pixels, directions=directions), site=pop.SGP)
    assert found.alone.tolist() == [False, False, True, True]
    assert found.unix_s.tolist() == [times[1], times[0], times[1], times[1]]
    assert {tuple(one) for one in found.pixels[2:]} == {(1.0, 1.0), (2.0, 2.0)}
    assert [(one.code, one.data["n"]) for one in found.filtering.dropped] == [("dropped_duplicate_time", 2)]
    assert time_bins(found).member.tolist() == [0, 1, 2, 3]


def test_stated_sigmas_keep_their_ratios_and_those_of_the_sun_are_bounded() -> None:
    times = pop.MAY_13 + 3600.0 * 18.0 + 60.0 * np.arange(12.0)
    directions = np.full((12, 3), np.nan)
    directions[6:] = _spread(np.random.default_rng(0), 6)
    sigma = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 0.01, 0.1, 0.1, 0.1, 0.1, 0.1, 0.5])
    points = Sightings.of(unix_s=times, pixels=np.arange(24.0).reshape(12, 2), sigma_px=sigma, directions=directions)
    found = filter_sightings(points, site=pop.SGP)
    relative = found.sigma_px / found.sigma_px[0]
    np.testing.assert_allclose(relative[:6], [1.0, 1.0, 1.0, 1.0, 1.0, 1.0 / 3.0])
    np.testing.assert_allclose(np.sort(relative[6:]), [0.1, 0.1, 0.1, 0.1, 0.1, 0.5])


@pytest.mark.parametrize("direction", [[0.0, 0.0, 0.0], [np.inf, 0.0, 0.0]])
def test_a_vector_without_a_direction_is_refused(direction: list[float]) -> None:
    with pytest.raises(InputError) as refused:
        Sightings.of(unix_s=np.zeros(1), pixels=np.ones((1, 2)), directions=np.array([direction]))
    assert refused.value.field == "directions"


def test_a_field_is_not_lost_where_stars_outnumber_a_finer_sun() -> None:
    """Most sightings are stars of 0.2 px, the sun's are six times finer: what moves both by 0.3 px is a field."""
    rng = np.random.default_rng(7001)
    camera = pop.random_camera(rng)
    field = pop.smooth_field(rng, amplitude_px=0.3, length_px=425.0)
    times = pop.sun_track(np.zeros(1), cadence_s=120.0)
    sun = pop.sightings(camera, times, pop.white_noise(rng, times.size, 0.03), field=field)
    directions = _spread(rng, 1200)
    pixels, sigma = project(camera, directions), rng.uniform(0.1, 0.3, 1200)
    stars = pixels + field(pixels) + rng.normal(size=pixels.shape) * sigma[:, None]
    points = Sightings.of(
        unix_s=np.r_[sun.unix_s, np.full(1200, NIGHT)],
        pixels=np.r_[sun.pixels, stars],
        sigma_px=np.r_[np.full(times.size, 0.03), sigma],
        directions=np.r_[np.full((times.size, 3), np.nan), directions],
    )
    fit = _fitted(camera, points)
    assert 0.15 < fit.field.amplitude_px < 0.6
    truth = project(camera, directions)
    error = project(fit.camera, directions) - truth - field(truth)
    assert 0.005 < np.sqrt(np.mean(np.sum(error**2, axis=-1))) < 0.08
