"""A lens that is not as modelled: what is stated holds the truth, and the camera does not follow the field."""

from __future__ import annotations

import numpy as np
import population as pop
import pytest
from numpy.typing import NDArray

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.result import Calibration
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project

FloatArray = NDArray[np.float64]

_CHI_SQUARE_95 = 5.991


def _fitted(seed: int, *, field_px: float) -> tuple[Calibration, Camera, pop.Field]:
    """Return the fit to one day of sightings of 0.03 px through a lens that a smooth field displaces."""
    rng = np.random.default_rng(seed)
    truth = pop.random_camera(rng)
    times = pop.sun_track(np.zeros(1), cadence_s=150.0)
    field = pop.smooth_field(rng, amplitude_px=field_px, length_px=425.0)
    points = pop.sightings(truth, times, pop.white_noise(rng, times.size, 0.03), field=field)
    return calibrate(points, site=pop.SGP, image_size=(pop.SIZE, pop.SIZE)), truth, field


def _judged(fit: Calibration, truth: Camera, field: pop.Field) -> tuple[float, float]:
    """Return the error over the sky, RMS px, and the share of the sky within the stated 95 %."""
    seen, covariance = project_with_covariance(fit, hemisphere(400))
    true = project(truth, hemisphere(400))
    error = seen - true - field(true)
    square = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)
    return float(np.sqrt(np.mean(np.sum(error**2, axis=-1)))), float(np.mean(square < _CHI_SQUARE_95))


@pytest.mark.parametrize("seed", [8000, 8001, 8003])
def test_a_field_of_tenths_of_a_pixel_is_in_the_stated_uncertainty(seed: int) -> None:
    # When the camera had to meet the sightings as least squares does, it bent to the field: 0 to 7 % of the sky was
    # within what was stated.
    fit, truth, field = _fitted(seed, field_px=0.3)
    error, covered = _judged(fit, truth, field)
    assert fit.verdict.accepted
    assert 0.1 < error < 2.0
    assert covered > 0.75
    assert 0.1 < fit.field.amplitude_px < 1.0


def test_without_a_field_none_is_stated() -> None:
    fit, truth, field = _fitted(8000, field_px=0.0)
    error, covered = _judged(fit, truth, field)
    assert error < 0.06
    assert covered > 0.9
    assert fit.field.amplitude_px < 0.02


def test_a_field_of_more_than_a_pixel_is_not_taken_away() -> None:
    # where the camera had to meet the sightings to 1 px the field was bounded to 0.02 px, whatever its odds: the sky
    # was 2.4 px off, and 8 % of it within what was stated
    rng = np.random.default_rng(33)
    truth = pop.random_camera(rng)
    field = pop.smooth_field(rng, amplitude_px=1.2, length_px=600.0)
    sun = pop.track((0, 1, 20, 29), cadence_s=600.0)
    noise = pop.white_noise(rng, sun.unix_s.size, 0.1)
    points = pop.sightings_of(truth, sun.unix_s, sun.directions, noise, field=field)
    fit = calibrate(points, site=pop.SGP, image_size=(pop.SIZE, pop.SIZE), start=truth)
    error, covered = _judged(fit, truth, field)
    assert 0.6 < fit.field.amplitude_px < 2.5
    assert 0.1 < error < 0.9
    assert covered > 0.9
