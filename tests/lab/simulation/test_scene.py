"""The simulated sky shows what it is said to show, where it is said to be."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from numpy.typing import NDArray

from sunarc.lab.simulation.options import Obstruction, SceneOptions, SensorModel
from sunarc.lab.simulation.scene import Scene
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.sky.directions import direction_from_angles
from sunarc.sky.site import Site
from sunarc.sky.sun import SOLAR_RADIUS

FloatArray = NDArray[np.float64]

NOON_US = int(datetime(2013, 5, 13, 18, 30, tzinfo=UTC).timestamp()) * 1_000_000
DARK_LENS = SceneOptions(nd_transmission=0.01, glare_strength=0.0, sky_strength=0.0)


def small(camera: Camera | None = None) -> Camera:
    """Return a camera of a quarter of the size, for speed."""
    full = camera or true_camera()
    x, y = full.principal_point_px
    fx, fy = full.focal_length_px
    return replace(
        full, width=437, height=437, focal_length_px=(fx / 4, fy / 4), principal_point_px=(x / 4 - 0.4, y / 4 - 0.4)
    )


def around(pixel: FloatArray, half: int) -> tuple[int, int, int, int]:
    x, y = (int(v) for v in np.rint(pixel))
    return x - half, y - half, 2 * half + 1, 2 * half + 1


def centroid(counts: FloatArray, origin: tuple[int, ...]) -> FloatArray:
    rows, columns = np.indices(counts.shape)
    total = float(counts.sum())
    return np.array([np.sum(columns * counts) / total + origin[0], np.sum(rows * counts) / total + origin[1]])


@pytest.mark.parametrize("lens_seed", [0, 3])
def test_the_disc_s_centroid_is_where_the_camera_model_puts_the_sun(lens_seed: int) -> None:
    sensor = SensorModel(black_level=0.0, smear_us_per_row=0.0)
    scene = Scene(true_camera(lens_seed), SGP, options=DARK_LENS, sensor=sensor)
    for minutes in range(-380, 390, 70):
        start_us = NOON_US + minutes * 60_000_000
        expected = scene.sun_pixel((start_us + 10) * 1e-6)
        region = around(expected, 14)
        counts = scene.render(start_us, exposure_us=20.0, full_scale=65_535, region=region, noise=False)
        assert 500 < counts.max() < 65_535
        found = centroid(counts.astype(np.float64), region)
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=0.002)


def test_the_sun_stands_where_it_is_in_the_middle_of_the_exposure(scene: Scene) -> None:
    camera = true_camera()
    long_us = 8_000_000_000  # an absurd exposure, in which the sun moves by 33 degrees
    options = SceneOptions(nd_transmission=1e-6, glare_strength=0.0, sky_strength=0.0)
    dim = Scene(camera, SGP, options=options, sensor=SensorModel(black_level=0.0, hot_pixels=0))
    middle = dim.sun_pixel((NOON_US + long_us / 2) * 1e-6)
    region = around(middle, 12)
    counts = dim.render(NOON_US, exposure_us=long_us, region=region, noise=False)
    assert counts.max() == 4095
    np.testing.assert_allclose(centroid(counts.astype(np.float64), region), middle, atol=0.05)
    assert scene.sun_pixel(NOON_US * 1e-6) == pytest.approx(project(camera, dim.sun_direction(NOON_US * 1e-6)))


def test_a_bare_camera_sees_the_disc_far_above_full_scale_and_a_filter_brings_it_within(scene: Scene) -> None:
    bare_at_30_us = scene._compute_disc_rate(0.9) * 30.0
    assert 10.0 < bare_at_30_us < 100.0
    filtered = Scene(true_camera(), SGP, options=SceneOptions(nd_transmission=0.01))
    counts = filtered.render(NOON_US, exposure_us=20.0, noise=False)
    assert 0.3 * 4095 < counts.max() < 0.9 * 4095


def saturated_radius_deg(scene: Scene, exposure_us: float) -> float:
    counts = scene.render(NOON_US, exposure_us=exposure_us, noise=False)
    sun = scene.sun_pixel(NOON_US * 1e-6)
    rows, columns = np.nonzero(counts == 4095)
    near = np.hypot(columns - sun[0], rows - sun[1]) < 200.0
    return float(np.degrees(np.sqrt(np.count_nonzero(near) / np.pi) / 570.0))


def test_ordinary_exposures_saturate_far_and_wide(scene: Scene) -> None:
    radii = [saturated_radius_deg(scene, exposure_us) for exposure_us in (30.0, 3000.0, 48_000.0)]
    assert np.degrees(SOLAR_RADIUS) < radii[0] < 0.8
    assert 1.0 < radii[1] < 3.0
    assert 5.0 < radii[2] < 12.0


def test_the_smear_column_is_as_bright_in_a_short_exposure_as_in_a_long_one(scene: Scene) -> None:
    sun = scene.sun_pixel(NOON_US * 1e-6)
    column = round(float(sun[0]))
    excess = []
    for exposure_us in (10.0, 3000.0):
        rows = scene.render(NOON_US, exposure_us=exposure_us, noise=False, region=(column - 20, 1500, 41, 100))
        excess.append(rows[:, 19:22].mean() - 0.5 * (rows[:, :8].mean() + rows[:, -8:].mean()))
    assert 40.0 < excess[0] < 200.0
    assert excess[1] == pytest.approx(excess[0], rel=0.05)


def test_the_aureole_falls_with_the_square_of_the_distance() -> None:
    scene = Scene(true_camera(), SGP, options=SceneOptions(sky_strength=0.0), sensor=SensorModel(black_level=0.0))
    sun = np.rint(scene.sun_pixel(NOON_US * 1e-6)).astype(int)
    counts = scene.render(NOON_US, exposure_us=3000.0, noise=False).astype(np.float64)
    near, far = counts[sun[1], sun[0] + 60], counts[sun[1], sun[0] + 120]
    assert near / far == pytest.approx(4.0, rel=0.1)


def test_outside_the_image_circle_there_is_only_the_black_level(scene: Scene) -> None:
    counts = scene.render(NOON_US, exposure_us=48_000.0, noise=False)
    assert counts[0, 0] == counts[-1, -1] == 32
    assert np.all(counts[:40, :200] == 32)


def test_the_ground_is_darker_than_the_sky_and_begins_at_the_horizon(scene: Scene) -> None:
    counts = scene.render(NOON_US, exposure_us=12_000.0, noise=False)
    directions = direction_from_angles(zenith_deg=[88.5, 91.5], azimuth_deg=[140.0, 140.0])
    (above_x, above_y), (below_x, below_y) = np.rint(project(scene.camera, directions)).astype(int)
    assert 32 < counts[below_y, below_x] < 0.5 * counts[above_y, above_x]


def test_noise_is_that_of_photons_and_of_reading() -> None:
    sensor = SensorModel(full_well_e=20_000.0, read_noise_e=12.0, hot_pixels=0)
    scene = Scene(small(), SGP, sensor=sensor)
    region = (150, 300, 100, 60)
    clean = scene.render(NOON_US, exposure_us=20_000.0, region=region, noise=False).astype(np.float64)
    per_count = 20_000.0 / (4095 - 32)
    noisy = [scene.render(NOON_US + i, exposure_us=20_000.0, region=region).astype(np.float64) for i in range(60)]
    variance = np.mean([(image - clean) ** 2 for image in noisy])
    expected = np.mean((clean - 32) / per_count + (12.0 / per_count) ** 2) + 1.0 / 12.0
    assert variance == pytest.approx(expected, rel=0.02)
    assert abs(np.mean([image - clean for image in noisy])) < 0.1


def test_the_same_moment_gives_the_same_counts_and_another_seed_gives_others() -> None:
    options = SceneOptions(weather=("broken",))
    first, again = (Scene(small(), SGP, options=options).render(NOON_US, exposure_us=12_000.0) for _ in range(2))
    other = Scene(small(), SGP, options=replace(options, seed=1)).render(NOON_US, exposure_us=12_000.0)
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_a_region_is_a_part_of_the_frame(scene: Scene) -> None:
    whole = scene.render(NOON_US, exposure_us=3000.0, noise=False)
    part = scene.render(NOON_US, exposure_us=3000.0, noise=False, region=(810, 640, 130, 90))
    assert np.array_equal(part, whole[640:730, 810:940])


def test_eight_bits_show_the_same_as_twelve(scene: Scene) -> None:
    region = (600, 600, 100, 100)
    eight = scene.render(NOON_US, exposure_us=12_000.0, full_scale=255, noise=False, region=region)
    twelve = scene.render(NOON_US, exposure_us=12_000.0, full_scale=4095, noise=False, region=region)
    assert eight.dtype == np.uint8
    np.testing.assert_allclose(eight / 255.0, twelve / 4095.0, atol=0.6 / 255.0)


def test_gain_multiplies_what_is_above_the_black_level(scene: Scene) -> None:
    region = (500, 900, 50, 50)
    low, high = (
        scene.render(NOON_US, exposure_us=3000.0, gain_db=gain, noise=False, region=region).astype(float) - 32.0
        for gain in (0.0, 6.0206)
    )
    np.testing.assert_allclose(high, 2.0 * low, atol=1.6)


def test_hot_pixels_stay_where_they_are() -> None:
    scene = Scene(small(), SGP, sensor=SensorModel(hot_pixels=25, read_noise_e=0.0))
    midnight_us = NOON_US + 12 * 3_600_000_000
    first, second = (scene.render(midnight_us + step, exposure_us=10.0) > 150 for step in (0, 60_000_000))
    assert 20 <= np.count_nonzero(first) <= 25
    assert np.array_equal(first, second)


def test_at_night_there_is_no_sun_and_at_the_horizon_only_a_part_of_it(scene: Scene) -> None:
    assert scene.sun_transmittance(NOON_US * 1e-6 + 12 * 3600.0) == 0.0
    angles = [scene.sun_transmittance(NOON_US * 1e-6 + 6.85 * 3600.0 + 10.0 * i) for i in range(60)]
    assert angles[0] == 1.0
    assert angles[-1] == 0.0
    assert any(0.2 < share < 0.8 for share in angles)


def test_a_mast_hides_the_sun_and_is_dark(scene: Scene) -> None:
    mast = Obstruction(azimuth_deg=180.0, width_deg=20.0, height_deg=80.0)
    hidden = Scene(small(), SGP, options=SceneOptions(obstructions=(mast,)))
    counts = hidden.render(NOON_US, exposure_us=3000.0, noise=False)
    x, y = np.rint(hidden.sun_pixel(NOON_US * 1e-6)).astype(int)
    assert scene.sun_transmittance(NOON_US * 1e-6) == 1.0
    assert hidden.sun_transmittance(NOON_US * 1e-6) == 0.0
    assert counts[y, x] < 200


def test_a_ghost_stands_opposite_the_sun_through_the_principal_point() -> None:
    options = replace(DARK_LENS, ghost_strength=0.1)
    scene = Scene(true_camera(), SGP, options=options, sensor=SensorModel(black_level=0.0, smear_us_per_row=0.0))
    opposite = 2.0 * np.array(scene.camera.principal_point_px) - scene.sun_pixel((NOON_US + 10) * 1e-6)
    region = around(opposite, 14)
    counts = scene.render(NOON_US, exposure_us=20.0, region=region, noise=False)
    np.testing.assert_allclose(centroid(counts.astype(float), region), opposite, atol=0.02)


def test_a_sun_that_the_lens_does_not_reach_is_not_rendered() -> None:
    narrow = replace(true_camera(), width=300, height=300, principal_point_px=(150.0, 150.0), max_angle=0.2)
    evening_us = NOON_US + 5 * 3_600_000_000
    scene = Scene(narrow, SGP, options=SceneOptions(field_deg=11.0), sensor=SensorModel(hot_pixels=0))
    assert np.isnan(scene.sun_pixel(evening_us * 1e-6)).all()
    assert scene.render(evening_us, exposure_us=10.0, noise=False).max() < 100


@pytest.mark.parametrize(
    ("site", "day"),
    [
        (Site(latitude=-12.0, longitude=-77.0, altitude=150.0), datetime(2024, 2, 20, 17, 10, tzinfo=UTC)),
        (Site(latitude=-41.0, longitude=175.0), datetime(2024, 1, 5, 0, 30, tzinfo=UTC)),
        (Site(latitude=79.0, longitude=12.0), datetime(2024, 5, 20, 23, 0, tzinfo=UTC)),
    ],
)
def test_the_sun_shines_at_other_places_too(site: Site, day: datetime) -> None:
    scene = Scene(small(), site, options=DARK_LENS, sensor=SensorModel(black_level=0.0, smear_us_per_row=0.0))
    start_us = round(day.timestamp()) * 1_000_000
    expected = scene.sun_pixel(start_us * 1e-6)
    region = around(expected, 8)
    counts = scene.render(start_us, exposure_us=20.0, full_scale=65_535, region=region, noise=False)
    np.testing.assert_allclose(centroid(counts.astype(float), region), expected, atol=0.005)
