"""The simulated night shows the stars where they are, as bright as they are, and what else shines."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from sunarc.common.array_types import FloatArray
from sunarc.common.errors import InputError
from sunarc.detection.stars.detect import detect_stars
from sunarc.lab.simulation.night import star_directions_by_series
from sunarc.lab.simulation.options import SceneOptions, SensorModel, SimulatedNight
from sunarc.lab.simulation.scene import Scene
from sunarc.lab.simulation.truth import SGP, true_camera
from sunarc.optics.forward import project
from sunarc.sky.directions import direction_from_angles
from sunarc.sky.night import body_position, night_sky, star_directions, star_table
from sunarc.sky.site import Site, relative_air_mass
from sunarc.sky.sun import sun_angles

NIGHT_US = int(datetime(2013, 5, 13, 7, 0, tzinfo=UTC).timestamp()) * 1_000_000
MOON_UP_US = int(datetime(2013, 5, 18, 3, 30, tzinfo=UTC).timestamp()) * 1_000_000  # the first quarter, in the west
FIVE_S = 5e6
ONLY_STARS: dict[str, Any] = {
    "airglow": 30.0, "city": 30.0, "moon": False, "warm_spots": 0, "satellites": 0.0, "aircraft": 0.0, "twinkle": 0.0,
}  # fmt: skip
CLEAN = SensorModel(black_level=0.0, smear_us_per_row=0.0, hot_pixels=0, full_well_e=1e6)


def night_scene(*, sensor: SensorModel | None = None, weather: str = "clear", **options: Any) -> Scene:  # noqa: ANN401
    sky: Any = {"weather": (weather,), "night": SimulatedNight(**options)}
    return Scene(true_camera(), SGP, options=SceneOptions(**sky), sensor=sensor)


def rendered(scene: Scene, start_us: int = NIGHT_US, **options: Any) -> NDArray[np.float64]:  # noqa: ANN401
    asked: dict[str, Any] = {"exposure_us": FIVE_S, "full_scale": 65_535, "noise": False, **options}
    return scene.render(start_us, **asked).astype(np.float64)


def icrs(right: FloatArray, up: FloatArray) -> FloatArray:
    return np.stack([np.cos(up) * np.cos(right), np.cos(up) * np.sin(right), np.sin(up)], axis=-1)


@pytest.mark.parametrize("latitude", [36.6, -33.0, 70.0])
@pytest.mark.parametrize("unix_s", [6.3e8, 1.368e9, 1.79e9, 2.2e9])
def test_the_simulator_s_own_series_put_the_stars_where_the_service_s_ephemeris_does(
    latitude: float, unix_s: float
) -> None:
    table, site = star_table(), Site(latitude=latitude, longitude=-97.5, altitude=300.0)
    still = replace(table, motion=np.zeros_like(table.motion))
    expected = star_directions(still, unix_s, site)
    found = star_directions_by_series(icrs(table.right_ascension, table.declination), unix_s, site)
    apart = np.degrees(np.linalg.norm(found - expected, axis=-1)) * 3600.0
    assert apart[expected[:, 2] > 0.05].max() < 1.5
    assert np.median(apart) > 1e-4  # another algorithm, not the same one


def test_a_star_s_centre_of_light_is_where_the_lens_puts_it_and_its_light_is_its_magnitude_s() -> None:
    camera = true_camera()
    scene = night_scene(sensor=CLEAN, faintest=2.2, **ONLY_STARS)
    image = rendered(scene)
    sky = night_sky(NIGHT_US * 1e-6 + 2.5, SGP, faintest=2.2)
    high = (sky.directions[:, 2] > 0.3) & np.char.startswith(sky.names, "star")
    seen = 0
    for direction, magnitude in zip(sky.directions[high], sky.magnitude[high], strict=True):
        x, y = project(camera, direction)
        column, row = round(float(x)), round(float(y))
        part = image[row - 10 : row + 11, column - 10 : column + 11]
        rows, columns = np.indices(part.shape)
        total = part.sum()
        centre = np.array([np.sum(columns * part), np.sum(rows * part)]) / total + np.array([column - 10, row - 10])
        np.testing.assert_allclose(centre, [x, y], atol=0.03)
        air_mass = float(relative_air_mass(np.degrees(np.arccos(direction[2]))))
        electrons = 25_000.0 * 5.0 * 10.0 ** (-0.4 * (magnitude + 0.2 * air_mass))
        assert total * CLEAN.full_well_e / 65_535 == pytest.approx(electrons, rel=0.05)
        seen += 1
    assert seen > 10


def test_a_star_is_drawn_out_along_the_sky_s_turning_in_a_long_exposure() -> None:
    scene = night_scene(sensor=CLEAN, faintest=1.0, star_e_per_s=2500.0, **ONLY_STARS)
    short, long = rendered(scene, exposure_us=10e6), rendered(scene, NIGHT_US - 115_000_000, exposure_us=240e6)
    wide = [np.count_nonzero(image > 0.1 * image.max()) for image in (short, long)]  # the sky turns by up to 10 px
    assert wide[1] > 2 * wide[0] > 0


def test_stars_turn_and_warm_spots_stand_still() -> None:
    scene = night_scene(satellites=0.0, aircraft=0.0, moon=False)
    first, second = (
        detect_stars(scene.render(start, exposure_us=FIVE_S), full_scale=4095)
        for start in (NIGHT_US, NIGHT_US + 1_200_000_000)
    )
    apart = np.linalg.norm(first.pixels[:, None] - second.pixels[None], axis=-1).min(axis=1)
    standing = int(np.sum(apart < 0.5))
    assert 20 < standing < 150
    assert standing < 0.2 * len(first)


def test_the_moon_s_lit_side_is_the_sun_s_side_and_its_glow_lights_the_sky() -> None:
    unix_s = MOON_UP_US * 1e-6
    moon, angles = body_position("moon", unix_s, SGP), sun_angles(unix_s, SGP)
    sun = direction_from_angles(zenith_deg=angles.zenith, azimuth_deg=angles.azimuth)
    assert moon.direction[2] > 0.3
    assert 0.3 < moon.illuminated_fraction < 0.7
    direction = np.array(moon.direction)
    scene = night_scene(sensor=CLEAN, faintest=0.0, **{**ONLY_STARS, "moon": True})
    x, y = project(scene.camera, direction)
    column, row = round(float(x)), round(float(y))
    part = rendered(scene, MOON_UP_US, exposure_us=50.0, region=(column - 9, row - 9, 19, 19))
    rows, columns = np.indices(part.shape)
    lit = part > 0.1 * part.max()
    centre = np.array([np.sum((columns * part)[lit]), np.sum((rows * part)[lit])]) / part[lit].sum()
    aside = centre + np.array([column - 9 - float(x), row - 9 - float(y)])
    towards = project(scene.camera, direction + 0.01 * (sun - (sun @ direction) * direction)) - [x, y]
    assert 0.3 < np.linalg.norm(aside) < 2.5
    assert aside @ towards > 0.9 * np.linalg.norm(aside) * np.linalg.norm(towards)
    dark = night_scene(sensor=CLEAN, faintest=0.0, **ONLY_STARS)
    far = (800, 800, 100, 100)
    assert np.median(rendered(scene, MOON_UP_US, region=far)) > 1.5 * np.median(rendered(dark, MOON_UP_US, region=far))


def test_the_town_lights_its_side_of_the_horizon() -> None:
    scene = night_scene(sensor=CLEAN, moon=False, faintest=0.0, warm_spots=0, city_azimuth_deg=90.0)
    light = {}
    for name, azimuth in (("town", 90.0), ("other", 270.0)):
        x, y = np.rint(project(scene.camera, direction_from_angles(zenith_deg=80.0, azimuth_deg=azimuth))).astype(int)
        light[name] = np.median(rendered(scene, region=(int(x) - 20, int(y) - 20, 40, 40)))
    assert light["town"] > 2.0 * light["other"] > 0.0


def test_clouds_hide_the_stars() -> None:
    options: dict[str, Any] = {"satellites": 0.0, "aircraft": 0.0, "warm_spots": 0, "moon": False}
    clear, overcast = (
        len(detect_stars(night_scene(weather=weather, **options).render(NIGHT_US, exposure_us=FIVE_S), full_scale=4095))
        for weather in ("clear", "overcast")
    )
    assert clear > 800
    assert overcast < 60


def test_a_satellite_leaves_a_trail_that_another_image_has_not() -> None:
    options = {**ONLY_STARS, "faintest": 0.0, "satellites": 20.0}
    scene = night_scene(sensor=CLEAN, **options)
    with_trails, later = rendered(scene), rendered(scene, NIGHT_US + 10_000_000)
    without = rendered(night_scene(sensor=CLEAN, **{**options, "satellites": 0.0}))
    trails = with_trails - without > 10.0
    assert trails.sum() > 500
    assert np.mean((later > 10.0)[trails]) < 0.5


def test_the_same_moment_is_the_same_image_and_the_day_has_no_night_in_it() -> None:
    region = (600, 600, 300, 300)
    night, again = (night_scene().render(NIGHT_US, exposure_us=FIVE_S, region=region) for _ in range(2))
    np.testing.assert_array_equal(night, again)
    full = night_scene().render(NIGHT_US, exposure_us=FIVE_S, noise=False)
    part = night_scene().render(NIGHT_US, exposure_us=FIVE_S, noise=False, region=region)
    np.testing.assert_array_equal(full[600:900, 600:900], part)
    noon = NIGHT_US + 11 * 3_600_000_000
    plain = Scene(true_camera(), SGP).render(noon, exposure_us=3000.0, region=region)
    np.testing.assert_array_equal(night_scene().render(noon, exposure_us=3000.0, region=region), plain)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("star_e_per_s", 0.0),
        ("faintest", 7.6),
        ("twinkle", 1.1),
        ("airglow", 9.9),
        ("warm_spots", -1),
        ("satellites", 51.0),
    ],
)
def test_what_is_no_night_is_refused(name: str, value: float) -> None:
    options: dict[str, Any] = {name: value}
    with pytest.raises(InputError, match=name):
        SimulatedNight(**options)
