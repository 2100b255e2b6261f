"""Question to clock and site of a tilted camera, by its definition on the unit sphere, over random cameras."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.fixtures.calibration import ideal_camera

from sunarc.calibration.quality.tilt import Place, distance_deg, level_place, mount_density, tilt_question
from sunarc.common.array_types import FloatArray
from sunarc.optics.camera import Camera
from sunarc.sky.site import Site


def zenith_of(latitude: float, longitude: float) -> FloatArray:
    """Return the zenith of a place in axes fixed to the earth."""
    a, b = math.radians(latitude), math.radians(longitude)
    return np.array([math.cos(a) * math.cos(b), math.cos(a) * math.sin(b), math.sin(a)])


def axes_of(site: Site) -> FloatArray:
    """Return east, north and up of a place as rows."""
    up, pole = zenith_of(site.latitude, site.longitude), np.array([0.0, 0.0, 1.0])
    east = np.cross(pole, up) / np.linalg.norm(np.cross(pole, up))
    return np.stack([east, np.cross(up, east), up])


def looking(axis: FloatArray) -> Camera:
    """Return a camera whose optical axis is in a direction."""
    across = np.cross(axis, [0.0, 0.0, 1.0])
    turn = across / np.linalg.norm(across) * math.acos(axis[2])
    return replace(ideal_camera(), rotation_cam_enu=tuple(turn.tolist()))


def apart_deg(one: FloatArray, other: FloatArray) -> float:
    return math.degrees(math.atan2(float(np.linalg.norm(np.cross(one, other))), float(one @ other)))


def mounted(axis: FloatArray) -> FloatArray:
    """Return by how much mounts hold their axes in directions (..., 3), per steradian."""
    tilt = np.degrees(np.arccos(np.clip(axis[..., 2], -1.0, 1.0)))
    by_hand = np.exp(-0.5 * (tilt / 2.0) ** 2) / (2.0 * math.pi * math.radians(2.0) ** 2)
    cap = 2.0 * math.pi * (1.0 - math.cos(math.radians(75.0)))
    return 0.95 * by_hand + 0.05 * np.where(tilt <= 75.0, 1.0, 0.01) / cap


def densities(level: FloatArray, site: Site) -> dict[str, float]:
    """Return the largest density per steradian of each kind of mistake."""
    latitude, longitude = site.latitude, site.longitude

    def of_place(share: float, at: FloatArray) -> float:
        off = apart_deg(level, at)
        wide = 2.0 * math.pi * math.radians(2.0) ** 2
        return share * math.exp(-0.5 * (off / 2.0) ** 2) / wide if off <= 5.0 else 0.0

    def of_line(per_rad: float, at: FloatArray) -> float:
        off = apart_deg(level, at)
        wide = math.sqrt(2.0 * math.pi) * math.radians(2.0)
        return per_rad * math.exp(-0.5 * (off / 2.0) ** 2) / wide if off <= 5.0 else 0.0

    there = math.degrees(math.atan2(level[1], level[0]))
    turn = abs((there - longitude + 180.0) % 360.0 - 180.0)
    whole = {h: 1.0 / abs(h) for h in range(-14, 15) if h}
    zones = [
        of_place(0.02 * w / sum(whole.values()), zenith_of(latitude, longitude - 15.0 * h)) for h, w in whole.items()
    ]
    along, up = zenith_of(latitude, there), zenith_of(math.degrees(math.asin(level[2])), longitude)
    clock = 0.02 * math.exp(-turn / 7.5) / 15.0 * 180.0 / math.pi
    exchanged = of_place(0.005, zenith_of(longitude, latitude)) if abs(longitude) <= 90.0 else 0.0
    return {
        "camera_tilted": max(0.001 / (4.0 * math.pi), of_place(0.005, zenith_of(-latitude, -longitude))),
        "camera_tilted_by_exchange": exchanged,
        "camera_tilted_by_clock": max(*zones, of_line(clock, along)),
        "camera_tilted_by_longitude": max(
            of_place(0.005, zenith_of(latitude, -longitude)), of_line(0.001 / (2.0 * math.pi), along)
        ),
        "camera_tilted_by_latitude": max(
            of_place(0.005, zenith_of(-latitude, longitude)), of_line(0.001 / math.pi, up)
        ),
    }


def test_the_likeliest_mistake_and_its_odds_are_those_of_the_shares_of_mounts_and_sites() -> None:
    rng, seen = np.random.default_rng(7), set()
    for k in range(300):
        latitude, longitude = float(rng.uniform(-65.0, 65.0)), float(rng.uniform(-170.0, 170.0))
        true = zenith_of(*[
            (longitude, latitude), (-latitude, longitude), (latitude, -longitude), (-latitude, -longitude),
            (latitude, longitude - 15.0 * rng.integers(1, 5)), (latitude, longitude + rng.uniform(6.0, 12.0)),
            (latitude + 8.0, longitude), (float(rng.uniform(-80.0, 80.0)), float(rng.uniform(-170.0, 170.0))),
        ][k % 8])  # fmt: skip
        site = Site(latitude=latitude, longitude=longitude)
        level = Rotation.from_rotvec(np.radians(rng.normal(0.0, 1.2, 3))).apply(true)
        axis = axes_of(site) @ level
        if axis[2] < math.cos(math.radians(80.0)):
            continue
        tilt, question = math.degrees(math.acos(axis[2])), tilt_question(looking(axis), site)
        if tilt <= 5.0:
            assert question is None
            continue
        expected = densities(level, site)
        code = max(expected, key=lambda name: expected[name])
        assert question is not None
        assert question.code == code
        assert question.data["tilt_deg"] == pytest.approx(tilt, abs=1e-6)
        none = 1.0 - 0.005 - 3.0 * 0.005 - 0.02 - 0.02 - 3.0 * 0.001
        assert question.data["odds"] == pytest.approx(expected[code] / (none * float(mounted(axis))), rel=1e-6)
        place = zenith_of(float(question.data["latitude"]), float(question.data["longitude"]))
        assert question.data["level_deg"] == pytest.approx(apart_deg(place, level), abs=1e-6)
        assert 0.0 <= float(question.data["level_within_deg"]) - tilt < 5.0
        seen.add(code)
    assert seen == set(expected)


def test_a_camera_is_level_where_its_axis_is_the_zenith() -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        site = Site(latitude=rng.uniform(-89.0, 89.0), longitude=rng.uniform(-180.0, 180.0))
        axis = rng.normal(0.0, 1.0, 3)
        axis /= np.linalg.norm(axis)
        place = level_place(looking(axis), site)
        np.testing.assert_allclose(axes_of(site) @ zenith_of(*place), axis, atol=1e-9)
        here = zenith_of(site.latitude, site.longitude)
        apart = distance_deg(place, Place(site.latitude, site.longitude))
        assert apart == pytest.approx(apart_deg(zenith_of(*place), here), abs=1e-9)


def test_the_shares_of_mounts_are_those_of_levelled_and_of_tilted_ones() -> None:
    tilts = np.radians([0.0, 1.0, 3.0, 9.0, 40.0, 74.9, 75.1, 120.0])
    axes = np.stack([np.sin(tilts), np.zeros(tilts.size), np.cos(tilts)], axis=-1)
    np.testing.assert_allclose(mount_density(axes), mounted(axes), rtol=1e-9)
    # what states nothing: a limit within which levelled mounts lie, and one beyond the steepest
    for limit in (2.0, 5.0, 90.0):
        np.testing.assert_array_equal(mount_density(axes, limit_deg=limit), mount_density(axes))


@pytest.mark.parametrize("limit", [10.0, 20.0, 60.0])
def test_a_mount_that_is_stated_to_be_tilted_is_held_at_any_tilt_alike(limit: float) -> None:
    tilts = np.radians([0.0, 3.0, 9.9, 0.99 * limit, 1.01 * limit, 120.0])
    axes = np.stack([np.sin(tilts), np.zeros(tilts.size), np.cos(tilts)], axis=-1)
    cap = 2.0 * math.pi * (1.0 - math.cos(math.radians(limit)))
    expected = np.array([1.0, 1.0, 1.0, 1.0, 0.01, 0.01]) / cap
    np.testing.assert_allclose(mount_density(axes, limit_deg=limit), expected, rtol=1e-9)


@pytest.mark.parametrize(("true", "sigma"), [(-37.0, 0.0), (48.0, 2.0)])
def test_a_latitude_that_is_named_has_the_sigma_of_a_mount_and_a_sign_none(true: float, sigma: float) -> None:
    site = Site(latitude=37.0, longitude=11.0)
    question = tilt_question(looking(axes_of(site) @ zenith_of(true, 11.0)), site)
    assert question is not None
    assert question.code == "camera_tilted_by_latitude"
    assert question.data["latitude_sigma_deg"] == sigma
