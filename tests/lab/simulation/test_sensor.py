"""The sensor's and the sky's loops against the same sums in numpy."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from sunarc import _kernels
from sunarc.common.errors import InputError
from sunarc.lab.simulation.options import Bump, Obstruction, SceneOptions, SensorModel
from sunarc.lab.simulation.scene import Scene, add_stamp, behind_mosaic, bumped_camera, run_over
from sunarc.lab.simulation.scene_parts import (
    CLEAR_SKY,
    Stamp,
    cloud_layer,
    disc_points,
    is_blocked,
    is_covered,
    pixel_field,
)
from sunarc.lab.simulation.truth import SGP
from sunarc.optics.camera import Camera
from sunarc.optics.pose import rotation_matrix
from sunarc.sky.directions import direction_from_angles
from sunarc.sky.site import relative_air_mass
from sunarc.sky.sun import SOLAR_RADIUS

NOON_US = round(datetime(2013, 5, 13, 18, 30, tzinfo=UTC).timestamp() * 1e6)
SMALL = Camera(
    width=64, height=60, projection="equisolid", focal_length_px=(22.0, 22.0), principal_point_px=(31.5, 29.5),
    rotation_cam_enu=(0.0, 0.0, 0.0), max_angle=math.radians(95.0),
)  # fmt: skip


def small_scene(sensor: SensorModel | None = None, **options: Any) -> Scene:  # noqa: ANN401 - the scene's options
    return Scene(SMALL, SGP, options=SceneOptions(**options), sensor=sensor or SensorModel(hot_pixels=0))


def columns(*values: float) -> NDArray[np.float32]:
    return np.array(values, dtype=np.float32)[:, None]


def test_a_well_that_holds_all_lets_nothing_run() -> None:
    light = columns(0.5, 1.0, 0.2)
    run_over(light, 1.0, 1.0)
    assert light.ravel() == pytest.approx([0.5, 1.0, 0.2])


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_an_excess_runs_half_up_and_half_down_until_it_is_taken(share: float) -> None:
    light = columns(0.0, 0.9, 3.0, 0.9, 0.0)
    run_over(light, 1.0, share)
    each_way = 0.5 * share * 2.0  # first 0.1 into the neighbour, the rest into the next
    first = min(each_way, 0.1)
    assert light.ravel() == pytest.approx([each_way - first, 0.9 + first, 3.0, 0.9 + first, each_way - first])


def test_what_runs_off_the_end_of_a_column_is_lost() -> None:
    light = columns(3.0, 0.0)
    run_over(light, 1.0, 1.0)
    assert light.ravel() == pytest.approx([3.0, 1.0])


def test_columns_do_not_mix() -> None:
    light = np.zeros((3, 3), np.float32)
    light[1, 1] = 5.0
    run_over(light, 1.0, 1.0)
    assert light[:, [0, 2]].sum() == 0.0


@pytest.mark.parametrize("first", [(0, 0), (1, 0), (0, 1), (3, 5)])
@pytest.mark.parametrize("bayer", ["RGGB", "GBRG"])
def test_each_pixel_is_dimmed_by_its_colour(first: tuple[int, int], bayer: Any) -> None:  # noqa: ANN401 - a Bayer
    light = np.ones((6, 7), np.float32)
    behind_mosaic(light, bayer, first=first)
    shares = {"R": 0.6, "G": 1.0, "B": 0.7}
    for (row, column), value in np.ndenumerate(light):
        letter = bayer[2 * ((row + first[1]) % 2) + (column + first[0]) % 2]
        assert value == pytest.approx(shares[letter])


def counted(
    light: NDArray[np.float32], *, noise: float, read_square: float, full: float = 4095.0
) -> NDArray[np.uint16]:
    factors = np.array([100.0, 23_000.0, read_square, 0.2, 32.0, full], np.float32)
    smear = np.zeros(light.shape[1], np.float32)
    starts = np.zeros(light.shape[0], np.int64)
    return _kernels.count_light(light, smear, np.full(light.size, noise, np.float32), starts, factors)


@pytest.mark.parametrize("noise", [-1.0, 0.0, 2.0])
def test_counts_are_electrons_with_shot_and_read_noise_above_black(noise: float) -> None:
    light = np.array([[0.0, 10.0, 100.0]], np.float32)
    electrons = 100.0 * light + noise * np.sqrt(100.0 * light + 144.0)
    assert counted(light, noise=noise, read_square=144.0) == pytest.approx(np.floor(32.5 + 0.2 * electrons), abs=1)


def test_without_noise_counts_are_rounded_light() -> None:
    light = np.array([[0.0, 0.024, 0.026, 1.0]], np.float32)
    assert counted(light, noise=3.0, read_square=-1.0).tolist() == [[32, 32, 33, 52]]


@pytest.mark.parametrize(("light", "count"), [(1e6, 4095), (230.0, 4095), (202.0, 4072)])
def test_counts_end_at_full_scale_and_wells_at_their_capacity(light: float, count: int) -> None:
    assert counted(np.array([[light]], np.float32), noise=0.0, read_square=0.0)[0, 0] == count


def test_counts_are_not_negative() -> None:
    assert counted(np.zeros((1, 1), np.float32), noise=-1e4, read_square=144.0)[0, 0] == 0


def test_a_clear_sky_lets_all_through() -> None:
    assert cloud_layer("clear", seed=1, unix_s=0.0) is CLEAR_SKY
    assert _kernels.cloud_transmittance(*CLEAR_SKY, np.array([[0.6, 0.0, 0.8]], np.float32)) == 1.0


def test_below_the_horizon_there_are_no_clouds() -> None:
    layer = cloud_layer("overcast", seed=1, unix_s=0.0)
    assert _kernels.cloud_transmittance(*layer, np.array([[0.8, 0.0, -0.6]], np.float32)) == 1.0


def test_between_the_texels_the_layer_is_bilinear() -> None:
    layer = np.random.default_rng(0).uniform(0.0, 1.0, (4, 4)).astype(np.float32)
    direction = np.array([[0.00625, 0.01125, 0.88]], np.float32)  # 200 / (0.88 + 0.12): 200 texels a unit
    found = _kernels.cloud_transmittance(layer, 8.0, 8.0, direction)
    x, y = 1.25, 2.25  # texels, without the offset of two periods
    expected = sum(
        layer[(int(y) + j) % 4, (int(x) + i) % 4] * (0.75 if i == 0 else 0.25) * (0.75 if j == 0 else 0.25)
        for i in (0, 1)
        for j in (0, 1)
    )
    assert found == pytest.approx(expected, abs=1e-3)


def test_the_sky_is_the_formula_of_its_levels() -> None:
    sun = direction_from_angles(zenith_deg=35.0, azimuth_deg=120.0)
    field = pixel_field(SMALL, field_deg=90.0, obstructions=())
    levels = np.array([2.0, 5.0, 0.5, 0.01, 1e-4, 0.3], np.float32)
    out = _kernels.sky_light(field, sun.astype(np.float32), levels, *CLEAR_SKY)
    ray, sees = field[..., :3].astype(np.float64), field[..., 3].astype(np.float64)
    chord = np.sum((ray - sun) ** 2, axis=-1)
    clear = 2.0 * (1.0 + 1.5 * (1.0 - ray[..., 2]) ** 3) * (0.8 + 0.4 * (1.0 - 0.5 * chord) ** 2)
    expected = np.where(sees > 0.0, sees * clear, -sees * 0.5) + np.abs(sees) * 0.01 / (chord + 1e-4)
    assert out == pytest.approx(np.where(sees == 0.0, 0.0, expected), rel=2e-3, abs=1e-5)


def test_a_pixel_sees_sky_ground_or_nothing() -> None:
    field = pixel_field(SMALL, field_deg=95.0, obstructions=())
    assert field[29, 31, 3] == 1.0
    assert field[0, 0, 3] == 0.0
    assert (field[..., 3] < 0.0).any()  # beyond 90 degrees
    assert np.linalg.norm(field[29, 31, :3]) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("zenith_deg", "azimuth_deg", "blocked"),
    [
        (79.0, 10.0, False),
        (81.0, 10.0, True),
        (81.0, 16.0, False),
        (81.0, 4.0, False),
        (91.0, 200.0, True),
        (81.0, 370.0, True),
    ],
)
def test_an_obstruction_is_a_rectangle_on_the_horizon(zenith_deg: float, azimuth_deg: float, *, blocked: bool) -> None:
    mast = Obstruction(azimuth_deg=10.0, width_deg=10.0, height_deg=10.0)
    direction = direction_from_angles(zenith_deg=zenith_deg, azimuth_deg=azimuth_deg)
    assert bool(is_blocked(direction, (mast,))) == blocked


def test_an_obstruction_across_north_has_both_its_sides() -> None:
    mast = Obstruction(azimuth_deg=359.0, width_deg=10.0, height_deg=10.0)
    directions = direction_from_angles(zenith_deg=[85.0] * 4, azimuth_deg=[353.0, 355.0, 3.0, 5.0])
    assert is_blocked(directions, (mast,)).tolist() == [False, True, True, False]


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 1.0])
def test_an_edge_hides_its_share_of_the_diameter_from_the_left(share: float) -> None:
    sun = direction_from_angles(zenith_deg=50.0, azimuth_deg=90.0)  # in the east: right of it is south
    points = disc_points(SMALL, sun, limb_darkening=0.0)
    assert points is not None
    hidden = is_covered(points.direction_enu, sun, share=share)
    along = -(points.direction_enu - sun)[:, 1] / SOLAR_RADIUS
    assert (hidden == ((along < -1.0 + 2.0 * share) & (share > 0.0))).all()


def test_a_stamp_is_added_where_it_overlaps() -> None:
    image, stamp = np.zeros((4, 5), np.float32), Stamp(-1, 2, np.arange(1.0, 7.0).reshape(2, 3))
    add_stamp(image, stamp, (0, 0))
    assert image[2:, :2].tolist() == [[2.0, 3.0], [5.0, 6.0]]
    assert image.sum() == 16.0
    add_stamp(image, stamp, (100, 0))
    assert image.sum() == 16.0


def test_the_discs_light_is_the_rate_behind_the_air_and_the_filter() -> None:
    scene = small_scene(
        SensorModel(hot_pixels=0, smear_us_per_row=0.0), nd_transmission=0.01, glare_strength=0.0, sky_strength=0.0
    )
    light, smear = scene._compute_light(NOON_US * 1e-6, (0, 0, 64, 60), 100.0)
    sun = scene.sun_direction(NOON_US * 1e-6)
    zenith_deg = 90.0 - math.degrees(math.asin(sun[2]))
    rate = 3.0 * 0.01 * math.exp(-0.2 * float(relative_air_mass(zenith_deg)))
    points = disc_points(SMALL, sun, limb_darkening=0.6)
    assert points is not None
    assert float(light.sum()) == pytest.approx(rate * float(points.weight_px.sum()), rel=1e-4)
    assert not smear.any()


def test_every_row_of_a_column_gets_the_smear() -> None:
    scene = small_scene(SensorModel(hot_pixels=0, smear_us_per_row=0.01), glare_strength=0.0, sky_strength=0.0)
    light, smear = scene._compute_light(NOON_US * 1e-6, (0, 0, 64, 60), 100.0)
    assert smear == pytest.approx(light.sum(axis=0) * 0.01 * 20_000.0, rel=1e-3, abs=1e-3)


@pytest.mark.parametrize("exposure_us", [1.0, 40.0])
def test_noise_of_an_even_sky_is_that_of_photons_and_reading(exposure_us: float) -> None:
    scene = small_scene(sky_strength=4e-3, glare_strength=0.0)
    noisy, plain = (
        scene.render(NOON_US, exposure_us=exposure_us, full_scale=65535, noise=noise).astype(np.float64)
        for noise in (True, False)
    )
    black, per_electron = 32.0 / 4095.0 * 65535, (1.0 - 32.0 / 4095.0) * 65535 / 20_000.0
    sky = (plain > black + 3.0) & (plain < 0.9 * 65535)
    sigma = np.sqrt((plain - black) * per_electron + (12.0 * per_electron) ** 2)
    assert float(np.std((noisy - plain)[sky] / sigma[sky])) == pytest.approx(1.0, abs=0.06)
    assert abs(float(np.mean((noisy - plain)[sky] / sigma[sky]))) < 0.08


def test_gain_doubles_the_light_and_not_the_black_level() -> None:
    scene = small_scene(sky_strength=1e-4, glare_strength=0.0, nd_transmission=0.1)
    one, two = (
        scene.render(NOON_US, exposure_us=500.0, gain_db=gain, full_scale=65535, noise=False).astype(np.float64)
        for gain in (0.0, 20.0 * math.log10(2.0))
    )
    unsaturated = (two < 60_000) & (one > 600)
    assert unsaturated.any()
    assert (two - 512.125)[unsaturated] == pytest.approx(2.0 * (one - 512.125)[unsaturated], abs=2.0)


def test_the_same_exposure_is_the_same_counts_and_another_is_not() -> None:
    scene = small_scene()
    one, same, later = (scene.render(start, exposure_us=100.0) for start in (NOON_US, NOON_US, NOON_US + 1))
    assert (one == same).all()
    assert (one != later).any()


def test_a_region_is_cut_out_of_the_whole_without_noise() -> None:
    scene = small_scene()
    whole = scene.render(NOON_US, exposure_us=100.0, noise=False)
    part = scene.render(NOON_US, exposure_us=100.0, noise=False, region=(10, 20, 30, 25))
    assert (part == whole[20:45, 10:40]).all()


@pytest.mark.parametrize("turn", [(0.0, 0.0, 10.0), (2.0, 0.0, 0.0)])
def test_a_bump_turns_the_camera_about_the_axes_of_the_earth(turn: tuple[float, float, float]) -> None:
    after = bumped_camera(SMALL, Bump(at=datetime(2013, 5, 13, tzinfo=UTC), turn_deg=turn))
    turned = rotation_matrix(tuple(math.radians(angle) for angle in turn))
    assert rotation_matrix(after.rotation_cam_enu) @ turned == pytest.approx(rotation_matrix(SMALL.rotation_cam_enu))


@pytest.mark.parametrize(
    "options",
    [
        {"weather": ()},
        {"sun_rate": 0.0},
        {"nd_transmission": 1.1},
        {"limb_darkening": -0.1},
        {"psf_sigma_px": 0.0},
        {"sun_cover": 1.1},
        {"moon_at": (181.0, 0.0)},
        {"field_deg": 5.0},
    ],
)
def test_what_is_no_scene_is_refused(options: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        SceneOptions(**options)


@pytest.mark.parametrize("sensor", [{"full_well_e": 0.0}, {"black_level": 0.5}, {"hot_pixels": -1}, {"blooming": 1.5}])
def test_what_is_no_sensor_is_refused(sensor: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        SensorModel(**sensor)
