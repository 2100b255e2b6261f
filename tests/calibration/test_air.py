"""Sightings through air that is not the assumed one: the camera and what is stated of it (docs/studies/air.py)."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.fixtures.clear_day import SGP, SIZE, TRUTH, rms, times_of

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance, sun_with_covariance
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.optics.forward import project
from sunarc.sky.directions import direction_from_angles
from sunarc.sky.refraction import MEASURED_AIR_SD, raised, refraction_rad
from sunarc.sky.sun import sun_directions

if TYPE_CHECKING:
    from numpy.typing import NDArray

_CHI_SQUARE_95 = 5.991
_DAYS = (0.0, 1.0, 20.0, 29.0)


def _fitted(temperature: float, *, measured: bool = False) -> Calibration:
    times = times_of(_DAYS, cadence_s=300.0)
    pixels = project(TRUTH, sun_directions(times, replace(SGP, temperature=temperature)))
    noise = np.random.default_rng(5).normal(0.0, 0.03, pixels.shape)
    air = np.full(times.size, temperature if measured else np.nan)
    return calibrate(
        Sightings.of(unix_s=times, pixels=pixels + noise, temperature=air, clock_error_s=0.01),
        site=SGP,
        image_size=SIZE,
    )


def _judged(fit: Calibration) -> tuple[float, float, NDArray[np.bool_]]:
    sky = hemisphere(500)
    found, covariance = project_with_covariance(fit, sky)
    error = found - project(TRUTH, sky)
    square = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0])
    return rms(error), float(np.sqrt(np.mean(np.trace(covariance, axis1=1, axis2=2)))), square < _CHI_SQUARE_95


@pytest.fixture(scope="module")
def in_assumed_air() -> Calibration:
    return _fitted(12.0)


@pytest.mark.parametrize("temperature", [35.0, -5.0])
def test_other_air_is_found_and_the_stated_95_percent_hold(temperature: float, in_assumed_air: Calibration) -> None:
    error, stated, held = _judged(_fitted(temperature))
    assert error < 0.055
    assert error < stated < 1.6 * _judged(in_assumed_air)[1]
    assert np.mean(held) >= 0.90


def test_a_measured_temperature_makes_surer(in_assumed_air: Calibration) -> None:
    _, stated, held = _judged(_fitted(35.0, measured=True))
    assert stated < 0.9 * _judged(in_assumed_air)[1]
    assert np.mean(held) >= 0.90


def test_with_the_assumed_air_the_camera_is_as_good(in_assumed_air: Calibration) -> None:
    error, stated, held = _judged(in_assumed_air)
    assert error < 0.02
    assert error < stated < 0.08
    assert np.mean(held) >= 0.90


@pytest.mark.parametrize("elevation", [0.5, 3.0, 30.0])
def test_the_suns_pixel_states_what_other_air_does_to_it(elevation: float, calibrated: Calibration) -> None:
    """10 K and 1.5 % of pressure are the 1-sigma of air that is assumed: the sun moves by about that much."""
    angles = {"zenith_deg": 90.0 - elevation, "azimuth_deg": 110.0}
    direction = direction_from_angles(**angles)
    other = replace(SGP, temperature=SGP.temperature - 10.0, pressure=1.015 * SGP.pressure_pa)
    moved = raised(direction, refraction_rad(direction, other) - refraction_rad(direction, SGP))
    moved_px = float(np.linalg.norm(project(calibrated.camera, moved) - project(calibrated.camera, direction)))
    _, camera_alone = project_with_covariance(calibrated, direction)
    stated = {
        measured: math.sqrt(
            np.trace(sun_with_covariance(calibrated, direction, site=SGP, measured=measured)[1] - camera_alone)
        )
        for measured in (False, True)
    }
    assert 0.7 * moved_px < stated[False] < 1.3 * moved_px
    assert stated[True] / stated[False] == pytest.approx(MEASURED_AIR_SD / math.hypot(0.04, 0.015), rel=1e-3)
