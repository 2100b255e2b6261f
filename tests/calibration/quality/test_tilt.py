"""A tilt that may be none: mistakes of zone, longitude and latitude are named with odds, a real tilt is used."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import dblquad
from tests.fixtures.calibration import ideal_camera

from sunarc.calibration.quality import tilt as module
from sunarc.calibration.quality.tilt import clock_behind_turn, tilt_question
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import PoseAngles, rotation_from_pose_angles, rotation_matrix, rotation_vector
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions

SITE = Site(latitude=36.6, longitude=-97.5)


def mounted(tilt_deg: float, lean_deg: float) -> Camera:
    """Return a camera tilted towards an azimuth."""
    return replace(ideal_camera(), rotation_cam_enu=rotation_from_pose_angles(PoseAngles(20.0, tilt_deg, lean_deg)))


def fitted(true: Camera, at: Site, stated: Site, *, hours: float = 0.0) -> Camera:
    """Return the camera that fits the sun of one site and clock as seen by another: Wahba's problem."""
    noon = 1_368_403_200.0 + 43_200.0 - 240.0 * at.longitude
    times = noon + np.arange(-14_400.0, 14_400.0, 600.0)
    up = sun_directions(times, at)
    seen, thought = up @ rotation_matrix(true.rotation_cam_enu).T, sun_directions(times + 3600.0 * hours, stated)
    u, _, v = np.linalg.svd(seen.T @ thought)
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    found = replace(true, rotation_cam_enu=rotation_vector(turn))
    # the mistake leaves next to no residual: no fit can see it
    assert np.max(np.linalg.norm(project(found, thought) - project(true, up), axis=-1)) < 2.0
    return found


@pytest.mark.parametrize("lean", [0.0, 90.0, 200.0])
def test_a_level_camera_is_not_questioned(lean: float) -> None:
    assert tilt_question(mounted(4.9, lean), SITE) is None


@pytest.mark.parametrize("hours", [1.0, -2.0, 5.0, -7.0])
def test_a_wrong_zone_is_named_with_the_hours(hours: float) -> None:
    found = fitted(mounted(1.5, 70.0), SITE, SITE, hours=hours)
    question = tilt_question(found, SITE)
    assert question is not None
    assert question.code == "camera_tilted_by_clock"
    assert question.data["hours"] == hours
    # the longitude at which the camera would be level, too: 15 degrees an hour
    turned = (float(question.data["longitude"]) - SITE.longitude + 15.0 * hours + 180.0) % 360.0 - 180.0
    assert abs(turned) < 0.1
    assert 1.0 < float(question.data["odds"]) < 1e4


def test_the_wrong_sign_of_the_latitude_is_named() -> None:
    south = replace(SITE, latitude=-SITE.latitude)
    question = tilt_question(fitted(mounted(1.5, 70.0), SITE, south), south)
    assert question is not None
    assert question.code == "camera_tilted_by_latitude"
    assert question.data["latitude"] == pytest.approx(SITE.latitude, abs=1.5)
    assert float(question.data["odds"]) > 5.0


def test_the_wrong_sign_of_the_longitude_is_named() -> None:
    site = replace(SITE, longitude=23.7)
    west = replace(SITE, longitude=-23.7)
    question = tilt_question(fitted(mounted(1.5, 70.0), site, west), west)
    assert question is not None
    assert question.code == "camera_tilted_by_longitude"
    assert question.data["longitude"] == pytest.approx(23.7, abs=3.0)
    assert float(question.data["hours"]) == pytest.approx(-2.0 * 23.7 / 15.04, abs=0.25)
    assert float(question.data["odds"]) > 1.0


@pytest.mark.parametrize(("tilt", "lean"), [(10.0, 140.0), (12.0, 180.0), (30.0, 0.0), (40.0, 60.0), (65.0, 10.0)])
@pytest.mark.parametrize("latitude", [-41.0, 2.0, 36.6, 60.0, 79.0])
def test_a_camera_that_is_tilted_is_asked_about_and_used(tilt: float, lean: float, latitude: float) -> None:
    question = tilt_question(mounted(tilt, lean), replace(SITE, latitude=latitude))
    assert question is not None
    assert question.data["tilt_deg"] == pytest.approx(tilt, abs=1e-6)
    assert 0.0 <= float(question.data["odds"]) < 1.0


def test_false_questions_are_rare_among_cameras_tilted_by_any_angle() -> None:
    """Of 400 cameras tilted by 5 to 70 degrees towards anywhere, few are held back for a mistake that nobody made."""
    rng = np.random.default_rng(1)
    doubted = 0
    for _ in range(400):
        site = replace(SITE, latitude=rng.uniform(-60.0, 60.0), longitude=rng.uniform(-180.0, 180.0))
        question = tilt_question(mounted(rng.uniform(5.0, 70.0), rng.uniform(0.0, 360.0)), site)
        assert question is None or question.data["odds"] is not None
        doubted += question is not None and float(question.data["odds"]) > 1.0
    assert doubted < 0.12 * 400


def test_the_mounts_density_is_one_over_the_sphere() -> None:
    def density(_: float, zenith: float) -> float:
        return float(module.mount_density(np.array([math.sin(zenith), 0.0, math.cos(zenith)]))) * math.sin(zenith)

    total, _ = dblquad(density, 0.0, math.pi, 0.0, 2.0 * math.pi, epsabs=1e-6)
    assert total == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("hours", [1.0, -1.0, 2.0])
def test_an_hour_of_the_clock_and_a_small_turn_are_no_turn_about_the_pole(hours: float) -> None:
    rng = np.random.default_rng(5)
    level = mounted(1.5, 70.0)
    after = fitted(level, SITE, SITE, hours=hours)
    for turn_deg in (0.0, 0.3, 1.0):
        found = clock_behind_turn(_turned(level, turn_deg, rng), after, SITE)
        assert found.hours == hours
        assert found.odds > 1.0


def test_a_turn_about_any_axis_is_no_hour_of_the_clock() -> None:
    rng = np.random.default_rng(6)
    level = mounted(1.5, 70.0)
    odds = np.array(
        [clock_behind_turn(level, _turned(level, rng.uniform(0.1, 40.0), rng), SITE).odds for _ in range(1000)]
    )
    assert np.mean(odds > 1.0) < 0.005
    assert np.mean(odds > 0.1) < 0.03


def _turned(camera: Camera, turn_deg: float, rng: np.random.Generator) -> Camera:
    """Return a camera turned about an axis of chance."""
    axis = rng.normal(size=3)
    turn = rotation_matrix(math.radians(turn_deg) * axis / np.linalg.norm(axis))
    return replace(camera, rotation_cam_enu=rotation_vector(turn @ rotation_matrix(camera.rotation_cam_enu)))
