"""A mast before the sun, and what is not one."""

from __future__ import annotations

from datetime import UTC, datetime
from functools import lru_cache

import pytest

from sunarc.detection.disc.detect import detect_sun
from sunarc.detection.values import Detection, Expectation, Sensor
from sunarc.lab.simulation.options import Obstruction, SceneOptions
from sunarc.lab.simulation.scene import Scene
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.forward import local_stretch
from sunarc.sky.sun import sun_angles

NOON = datetime(2013, 5, 13, 20, 0, tzinfo=UTC)
SENSOR = Sensor(full_scale=4095, gain_e_per_count=20_000.0 / 4095, black_level=32.0)


@lru_cache
def scene_of(options: SceneOptions) -> Scene:
    return Scene(true_camera(), SGP, options=options)


def looked(options: SceneOptions, *, exposure_us: float, clear: float | None = 20.0) -> Detection:
    scene = scene_of(options)
    unix_s = NOON.timestamp()
    x, y = scene.sun_pixel(unix_s)
    (a, b), (c, d) = local_stretch(scene.camera, scene.sun_direction(unix_s)).tolist()
    expectation = Expectation(
        x_px=float(x), y_px=float(y), stretch_px_per_rad=((a, b), (c, d)), clear_peak_fraction=clear
    )
    image = scene.render(round(unix_s * 1e6), exposure_us=exposure_us, full_scale=4095)
    return detect_sun(image, sensor=SENSOR, expectation=expectation)


def before_the_sun(*, width_deg: float) -> SceneOptions:
    azimuth = float(sun_angles(NOON.timestamp(), SGP).azimuth)
    return SceneOptions(obstructions=(Obstruction(azimuth_deg=azimuth, width_deg=width_deg, height_deg=85.0),))


@pytest.mark.parametrize("exposure_us", [80.0, 1000.0])
def test_a_building_before_the_sun_is_told_from_a_cloud(exposure_us: float) -> None:
    found = looked(before_the_sun(width_deg=60.0), exposure_us=exposure_us)
    assert (found.verdict, found.accepted) == ("obstructed", False), found.reason


def test_a_sky_too_dark_to_be_seen_tells_nothing() -> None:
    assert looked(before_the_sun(width_deg=60.0), exposure_us=1.0).verdict == "hidden"


def test_without_a_clear_suns_level_nothing_is_called_obstructed() -> None:
    assert looked(before_the_sun(width_deg=60.0), exposure_us=1000.0, clear=None).verdict == "hidden"


@pytest.mark.parametrize("exposure_us", [80.0, 1000.0])
def test_a_sun_behind_clouds_is_not_called_obstructed(exposure_us: float) -> None:
    assert looked(SceneOptions(weather=("overcast",)), exposure_us=exposure_us).verdict in {"hidden", "partly_covered"}


def test_night_is_hidden_not_obstructed() -> None:
    options = SceneOptions(sun_rate=1e-9)
    assert looked(options, exposure_us=1000.0).verdict == "hidden"
