"""Frames whose pixels the camera joined: the mean over clipped pixels lies below full scale."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from sunarc.common.errors import InputError
from sunarc.detection.disc.detect import detect_sun
from sunarc.detection.disc.window import saturated_pixels
from sunarc.detection.values import Detection, Sensor
from sunarc.lab.simulation.options import SceneOptions, SensorModel
from sunarc.lab.simulation.scene import Scene
from sunarc.lab.simulation.truth import SGP, true_camera

FULL_SCALE = 4095
SENSOR = Sensor(
    full_scale=FULL_SCALE, gain_e_per_count=4 * 20_000.0 / FULL_SCALE, read_noise_e=24.0, black_level=32.0, binning=2
)
MORNING = datetime(2013, 5, 13, 13, tzinfo=UTC).timestamp()


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene(true_camera(), SGP, options=SceneOptions(weather=("clear",)), sensor=SensorModel())


def look(scene: Scene, *, hour: float, exposure_us: float, sensor: Sensor) -> tuple[Detection, float]:
    """Return what is found in a frame binned by two, and what it is off, px of that frame."""
    start_us = round((MORNING + 3600.0 * hour) * 1e6)
    full = scene.render(start_us, exposure_us=exposure_us, full_scale=FULL_SCALE)
    height, width = (n // 2 for n in full.shape)
    image = full[: 2 * height, : 2 * width].reshape(height, 2, width, 2).mean(axis=(1, 3)).astype(np.uint16)
    found = detect_sun(image, sensor=sensor, exposure_us=exposure_us)
    true = (scene.sun_pixel(start_us * 1e-6) - 0.5) / 2.0
    return found, float(np.hypot((found.x_px or 0.0) - true[0], (found.y_px or 0.0) - true[1]))


def test_the_sun_is_found_in_binned_frames_as_well_as_in_others(scene: Scene) -> None:
    looks = [look(scene, hour=0.5 * k, exposure_us=1.0, sensor=SENSOR) for k in range(20)]
    assert sum(found.accepted for found, _ in looks) >= 19
    errors = np.array([error for found, error in looks if found.accepted])
    assert np.sqrt(np.mean(errors**2)) <= 0.005
    assert max(found.peak_fraction or 0.0 for found, _ in looks) > 1.5  # saturated: the path that was wrong


def test_the_sun_is_lost_where_the_binning_is_not_known(scene: Scene) -> None:
    unaware = replace(SENSOR, binning=1)
    looks = [look(scene, hour=0.5 * k, exposure_us=1.0, sensor=unaware) for k in range(20)]
    assert sum(found.accepted for found, _ in looks) <= 10


def test_means_that_may_hold_a_clipped_pixel_are_told_from_those_that_cannot() -> None:
    part = np.full((7, 7), 100, dtype=np.uint16)
    part[3, 3], part[3, 4], part[3, 5] = 3000, 1200, 900  # a clipped core, its edge, and too little for a clipped pixel
    part[0, 0] = 1500  # bright, but beside nothing that is clipped
    saturated = saturated_pixels(part, sensor=SENSOR, saturation_fraction=0.98)
    assert np.argwhere(saturated).tolist() == [[3, 3], [3, 4]]
    part[3, 3] = 2000
    assert not saturated_pixels(part, sensor=SENSOR, saturation_fraction=0.98).any()
    assert saturated_pixels(part, sensor=replace(SENSOR, binning=1), saturation_fraction=0.45).sum() == 1


def test_a_binning_below_one_is_refused() -> None:
    with pytest.raises(InputError, match="binning 0"):
        replace(SENSOR, binning=0)
