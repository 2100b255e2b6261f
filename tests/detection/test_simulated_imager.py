"""The detector against the simulated imager's own frames: a bare sun far above full scale, smear, glare, hot pixels."""

from __future__ import annotations

import math
from datetime import UTC, datetime

import numpy as np
import pytest

from sunarc.detection.disc.detect import detect_sun
from sunarc.detection.values import Expectation, Sensor
from sunarc.lab.simulation.scene import Scene
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.forward import local_stretch
from sunarc.sky.sun import sun_angles

FULL_SCALE = 4095
SENSOR = Sensor(full_scale=FULL_SCALE, gain_e_per_count=20_000.0 / FULL_SCALE, black_level=32.0)
DAYTIME = [datetime(2013, 5, 13, hour, minute, tzinfo=UTC) for hour in range(13, 24, 2) for minute in (7, 37)]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene(true_camera(), SGP)


def expectation(scene: Scene, unix_s: float) -> Expectation:
    x, y = scene.sun_pixel(unix_s)
    (a, b), (c, d) = local_stretch(scene.camera, scene.sun_direction(unix_s)).tolist()
    zenith = math.radians(float(sun_angles(unix_s, scene.site).apparent_zenith))
    return Expectation(
        x_px=x + 0.7, y_px=y - 0.4, uncertainty_px=2.0, stretch_px_per_rad=((a, b), (c, d)), apparent_zenith=zenith
    )


@pytest.mark.parametrize("exposure_us", [1.0, 5.0, 20.0, 80.0])
@pytest.mark.parametrize("way", ["with a prediction", "by global search"])
def test_a_bare_sun_is_found_all_day(scene: Scene, exposure_us: float, way: str) -> None:
    off, refused = [], []
    for moment in DAYTIME:
        unix_s = moment.timestamp() + exposure_us * 0.5e-6
        image = scene.render(round(moment.timestamp() * 1e6), exposure_us=exposure_us, full_scale=FULL_SCALE)
        told = expectation(scene, unix_s) if way == "with a prediction" else None
        found = detect_sun(image, sensor=SENSOR, expectation=told, exposure_us=exposure_us)
        if found.accepted and found.x_px is not None and found.y_px is not None:
            off.append(np.array([found.x_px, found.y_px]) - scene.sun_pixel(unix_s))
        else:
            refused.append(f"{moment:%H:%M} {found.verdict}: {found.reason}")
    assert not refused, "\n".join(refused)
    assert np.sqrt(np.mean(np.square(off))) < 0.01
