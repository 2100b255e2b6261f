"""What the detector is to be tried on: a covered disc, blooming, a mosaic of colours, the moon."""

from __future__ import annotations

from datetime import UTC, datetime
from functools import lru_cache

import numpy as np
import pytest

from sunarc.detection.disc.detect import detect_sun
from sunarc.detection.values import Expectation, Sensor
from sunarc.lab.simulation.options import SceneOptions, SensorModel
from sunarc.lab.simulation.scene import Scene
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.forward import local_stretch, project
from sunarc.sky.directions import direction_from_angles

NOON = datetime(2013, 5, 13, 20, 0, tzinfo=UTC).timestamp()


def window(scene: Scene, *, exposure_us: float, **how: object) -> tuple[np.ndarray, np.ndarray]:
    """Return 160×160 px around the sun, and where in them it is."""
    x, y = scene.sun_pixel(NOON)
    first = (round(x) - 80) // 2 * 2, (round(y) - 80) // 2 * 2
    image = scene.render(round(NOON * 1e6), exposure_us=exposure_us, region=(*first, 160, 160), **how)  # type: ignore[arg-type]
    return image, np.array([x, y]) - first


def looked(scene: Scene, **sensor: object) -> tuple[bool, str, float]:
    """Return whether the sun is accepted in a frame of 20 µs, as what, and how far off it is."""
    image, sun = window(scene, exposure_us=20.0, bayer=sensor.get("bayer"))
    (a, b), (c, d) = local_stretch(scene.camera, scene.sun_direction(NOON)).tolist()
    told = Expectation(x_px=float(sun[0]), y_px=float(sun[1]), stretch_px_per_rad=((a, b), (c, d)))
    known = Sensor(full_scale=4095, gain_e_per_count=20_000 / 4095, black_level=32.0, **sensor)  # type: ignore[arg-type]
    found = detect_sun(image, sensor=known, expectation=told)
    off = np.inf if found.x_px is None or found.y_px is None else np.hypot(*(np.array([found.x_px, found.y_px]) - sun))
    return found.accepted, found.verdict, float(off)


@lru_cache
def scene_of(options: SceneOptions | None = None, **sensor: float) -> Scene:
    return Scene(true_camera(), SGP, options=options, sensor=SensorModel(**sensor))  # type: ignore[arg-type]


@pytest.mark.parametrize("cover", [0.2, 0.5])
def test_a_covered_disc_is_darker_and_not_believed(cover: float) -> None:
    clear, covered = SceneOptions(nd_transmission=0.015), SceneOptions(nd_transmission=0.015, sun_cover=cover)
    assert looked(scene_of(clear))[0]
    assert looked(scene_of(covered))[1] in {"partly_covered", "hidden"}
    bright, dark = (window(scene_of(one), exposure_us=20.0, noise=False)[0].astype(float) for one in (clear, covered))
    shift = np.hypot(*(centroid(dark) - centroid(bright)))
    assert cover < shift < 4.0 * cover  # px of a disc 5.6 px wide


def centroid(image: np.ndarray) -> np.ndarray:
    light = np.clip(image - np.median(image) - 20.0, 0.0, None)
    moments = [float(np.sum(light.sum(axis=k) * np.arange(160))) for k in (0, 1)]
    return np.array(moments) / float(light.sum())


def test_blooming_runs_along_the_sun_s_columns() -> None:
    plain, sun = window(scene_of(), exposure_us=200.0, noise=False)
    bloomed, _ = window(scene_of(blooming=0.2), exposure_us=200.0, noise=False)
    column, row = np.rint(sun).astype(int)
    length = [int(np.count_nonzero(image[:, column] >= 4095)) for image in (plain, bloomed)]
    assert length[1] > 2 * length[0]
    assert np.array_equal(plain[row, :40], bloomed[row, :40])


def test_the_mosaic_is_the_sensor_s_and_the_sun_is_found_in_it() -> None:
    options = SceneOptions(nd_transmission=0.015)
    image, _ = window(scene_of(options), exposure_us=2e4, noise=False, bayer="RGGB")
    sky = [float(np.median(image[j::2, i::2][:10])) - 32.0 for j in (0, 1) for i in (0, 1)]
    assert sky[0] / sky[1] == pytest.approx(0.6, abs=0.05)
    assert sky[3] / sky[1] == pytest.approx(0.7, abs=0.05)
    accepted, _, off = looked(scene_of(options), bayer="RGGB")
    assert accepted
    assert off < 0.03


def test_the_moon_shines_where_it_is_put() -> None:
    scene = Scene(true_camera(), SGP, options=SceneOptions(moon_at=(40.0, 120.0)), sensor=SensorModel(hot_pixels=0))
    bare = Scene(true_camera(), SGP, sensor=SensorModel(hot_pixels=0))
    night = round((NOON + 12 * 3600.0) * 1e6)
    with_moon, without = (one.render(night, exposure_us=5e4, noise=False).astype(int) for one in (scene, bare))
    row, column = np.unravel_index(int(np.argmax(with_moon - without)), with_moon.shape)
    expected = project(scene.camera, direction_from_angles(zenith_deg=40.0, azimuth_deg=120.0))
    assert np.hypot(column - expected[0], row - expected[1]) < 3.0
    full_scales = 5e4 * 3.0 * 2.5e-6 * np.exp(-0.2 * 1.3)  # of an air mass of 1.3
    assert (with_moon - without).max() / (4095 - 32) == pytest.approx(full_scales, rel=0.05)
