"""Twenty clean sightings: none is dropped until the camera passes through the rest, and what is stated holds."""

from __future__ import annotations

import numpy as np
import pytest
from tests.fixtures.clear_day import times_of
from tests.fixtures.finding_codes import codes

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.sky.sun import sun_directions

N = 20
DRAWN = 5
_CHI_SQUARE_95 = 5.991


def _drawn(seed: int, days: int, sigma_px: float, n: int = N) -> tuple[Camera, Sightings]:
    truth, rng = true_camera(seed), np.random.default_rng(1000 + seed)
    times = times_of(tuple(7.0 * day for day in range(days)), site=SGP, cadence_s=60.0)
    pixels = project(truth, sun_directions(times, SGP))
    inside = np.all((pixels > 0.0) & (pixels < truth.width), axis=-1)
    some = np.sort(rng.choice(np.flatnonzero(inside), n, replace=False))
    return truth, Sightings.of(unix_s=times[some], pixels=pixels[some] + rng.normal(0.0, sigma_px, (n, 2)))


def _covered(fit: Calibration, truth: Camera) -> float:
    """Return the share of the sky within the stated 95 %."""
    sky = hemisphere(300)
    found, covariance = project_with_covariance(fit, sky)
    error = found - project(truth, sky)
    square = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0])
    return float(np.mean(square < _CHI_SQUARE_95))


@pytest.mark.parametrize("sigma_px", [0.05, 0.5])
@pytest.mark.parametrize("days", [1, 4])
def test_the_noise_of_twenty_sightings_is_found(days: int, sigma_px: float) -> None:
    noise, covered = [], []
    for seed in range(DRAWN):
        truth, points = _drawn(seed, days, sigma_px)
        fit = calibrate(points, site=SGP, image_size=(truth.width, truth.height))
        # of 40 numbers nearly all are needed for 20 unknowns
        assert fit.evidence.n_used >= N - 2
        assert fit.verdict.accepted or set(codes(fit.verdict.findings)) <= {
            "direction_sigma_too_large",
            "hours_missing",
            "sightings_determine",
            "declinations_alike",
        }
        noise.append(fit.evidence.sigma_px / sigma_px)
        covered.append(_covered(fit, truth))
    assert 0.7 < np.median(noise) < 1.3
    assert min(noise) > 0.3
    assert np.mean(covered) > 0.85


def test_gross_errors_among_few_sightings_are_not_served() -> None:
    truth, points = _drawn(0, 1, 0.05)
    pixels = points.pixels.copy()
    pixels[[3, 9, 15]] += [[60.0, 0.0], [0.0, -80.0], [50.0, 50.0]]
    fit = calibrate(Sightings.of(unix_s=points.unix_s, pixels=pixels), site=SGP, image_size=(truth.width, truth.height))
    error = np.linalg.norm(project(fit.camera, hemisphere(200)) - project(truth, hemisphere(200)), axis=-1)
    assert not fit.verdict.accepted or np.nanmedian(error) < 10.0


def test_a_day_of_one_sighting_does_not_tell_how_the_camera_is_turned() -> None:
    # of the four days one has a single sighting, in the pixel of which two angles show, exactly
    truth, points = _drawn(37, 4, 0.05)
    fit = calibrate(points, site=SGP, image_size=(truth.width, truth.height))
    assert 0.0 <= fit.evidence.held_out["excess"] < 1.0


@pytest.mark.parametrize("seed", range(2))
def test_forty_sightings_of_two_days_and_a_start_are_a_calibration(seed: int) -> None:
    truth, points = _drawn(seed, 2, 0.5, n=40)
    fit = calibrate(points, site=SGP, image_size=(truth.width, truth.height), start=truth)
    assert fit.verdict.accepted
    assert not {"epoch_does_not_explain_its_days", "half_days_deviate"} & set(codes(fit.verdict.findings))
    assert _covered(fit, truth) > 0.8
