"""The ends of a day are where the lens is known least; they must be believed, not thrown out."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.sightings import Sightings
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.forward import project
from sunarc.sky.sun import sun_angles, sun_directions


@pytest.mark.parametrize("lens_seed", [0, 1, 2, 3])
def test_precise_sightings_of_a_low_sun_are_no_outliers(lens_seed: int) -> None:
    truth = true_camera(lens_seed)
    times = datetime(2013, 5, 13, 6, tzinfo=UTC).timestamp() + np.arange(0.0, 86_400.0, 120.0)
    times = times[sun_angles(times, SGP).apparent_zenith < 89.6]
    directions = sun_directions(times, SGP)
    pixels = project(truth, directions)
    noise = np.random.default_rng(lens_seed).normal(0.0, 0.003, pixels.shape)
    found = calibrate(Sightings.of(unix_s=times, pixels=pixels + noise), site=SGP, image_size=(1748, 1748))
    assert found.evidence.n_rejected <= 0.02 * times.size
    error = project(found.camera, directions) - pixels
    assert np.sqrt(np.mean(np.sum(error**2, axis=-1))) <= 0.01
