"""A camera by the bright stars of one image: found under any lens and hand, refused where chance would do as well."""

from __future__ import annotations

import math
from dataclasses import replace

import nights
import numpy as np
import population as pop
import pytest
from scipy.spatial import cKDTree
from scipy.special import gammaln
from scipy.stats import binom

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.detection.stars.matching import match_stars
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import PoseAngles, rotation_from_pose_angles, rotation_matrix, rotation_vector
from sunarc.stars.blind_start import BlindOptions, BlindStart, NightDetections, blind_start
from sunarc.stars.star_pattern import Bright, bright_stars, log10_chance, patterns
from sunarc.stars.views import StarView, match_views, seen_magnitude, stars_in_image

POSE = PoseAngles(phi_xz_deg=-60.0, theta_zz_deg=4.0, psi_z_deg=200.0)
CAMERA = Camera(
    width=900,
    height=700,
    projection="equidistant",
    focal_length_px=(215.0, 215.0),
    principal_point_px=(462.0, 341.0),
    rotation_cam_enu=rotation_from_pose_angles(POSE),
    max_angle=math.radians(92.0),
)
NIGHT = nights.Night(sigma_px=0.15, faint=100)


def image_of(camera: Camera, night: nights.Night, *, late_s: float = 0.0) -> NightDetections:
    """Return what a camera sees at midnight, beside the sky of a clock that is late."""
    stars, _ = nights.detections(np.random.default_rng(8), camera, nights.sky_of(nights.MIDNIGHT), night)
    inside = np.all((stars.pixels > 0.0) & (stars.pixels < [camera.width - 1.0, camera.height - 1.0]), axis=-1)
    sky = nights.sky_of(nights.MIDNIGHT + late_s)
    return NightDetections(unix_s=nights.MIDNIGHT + late_s, stars=stars.select(inside), sky=sky)


def found_in(image: NightDetections) -> BlindStart:
    return blind_start([image], pop.SGP, image_size=(CAMERA.width, CAMERA.height))


def error_px(found: BlindStart, camera: Camera) -> float:
    assert found.camera is not None
    sky = hemisphere(300)
    sky = sky[sky[:, 2] > 0.3]
    return float(np.nanmedian(np.linalg.norm(project(found.camera, sky) - project(camera, sky), axis=-1)))


TILTED = replace(CAMERA, rotation_cam_enu=rotation_from_pose_angles(POSE._replace(theta_zz_deg=14.0)))
LONG = replace(CAMERA, projection="stereographic", focal_length_px=(300.0, 300.0))
SHORT = replace(CAMERA, projection="orthographic", focal_length_px=(240.0, 240.0), max_angle=math.radians(85.0))


@pytest.mark.parametrize(
    ("camera", "night"),
    [
        (CAMERA, NIGHT),
        (replace(CAMERA, mirrored=True), replace(NIGHT, lost=0.2)),
        (TILTED, NIGHT),
        (LONG, replace(NIGHT, satellites=4)),
        (SHORT, NIGHT),
        (CAMERA, replace(NIGHT, hot_pixels=200)),
        (CAMERA, replace(NIGHT, cloud_share=0.4)),
    ],
    ids=["usual", "mirrored, haze", "tilted", "long", "orthographic", "hot pixels", "clouds"],
)
def test_one_image_gives_the_camera(camera: Camera, night: nights.Night) -> None:
    found = found_in(image_of(camera, night))
    codes = {finding.code: finding.data for finding in found.findings}
    assert found.accepted, codes
    assert found.camera is not None
    assert found.camera.mirrored == camera.mirrored
    assert 0.0 < error_px(found, camera) < 0.6
    assert float(codes["blind_by_pattern"]["log10_chance"]) < -10.0
    assert codes["blind_found"]["images"] == 1
    assert found.matches[0].star.size > 40


def view_of(image: NightDetections, camera: Camera, sigma_px: float) -> StarView:
    pixels = project(camera, image.sky.directions)
    predicted = stars_in_image(camera, image.sky, pixels, np.full(len(image.sky), sigma_px))
    return StarView(unix_s=image.unix_s, sky=image.sky, stars=image.stars, predicted=predicted, camera=camera)


def among_lights(image: NightDetections, count: int) -> NightDetections:
    """Return an image with bright lights that are no stars, as aurora and roofs have: brighter than most stars."""
    rng = np.random.default_rng(9)
    places = rng.uniform([0.0, 0.0], [CAMERA.width - 1.0, CAMERA.height - 1.0], (count, 2))
    rows = rng.integers(0, len(image.stars) // 3, count)
    both = np.concatenate([np.arange(len(image.stars)), rows])
    stars = image.stars.select(both)
    stars = replace(stars, pixels=np.concatenate([image.stars.pixels, places]))
    return replace(image, stars=stars.select(np.argsort(-stars.flux, kind="stable")))


def test_a_camera_that_one_image_gave_names_its_stars_again() -> None:
    image = among_lights(image_of(CAMERA, NIGHT), 500)
    found = found_in(image)
    assert found.accepted, [one.code for one in found.findings]
    assert found.camera is not None
    for camera, sigma_px in ((found.camera, 0.7), (CAMERA, 0.3)):
        view = view_of(image, camera, sigma_px)
        assert not match_stars(image.stars, view.predicted).accepted  # the lights are no stars
        (again,) = match_views([view])
        assert again.matches.accepted
        names = set(again.names(view))
        assert len(names) > 0.8 * found.matches[0].star.size


def test_wrong_cameras_name_no_stars_among_lights() -> None:
    image = among_lights(image_of(CAMERA, NIGHT), 500)
    rng = np.random.default_rng(10)
    for k in range(12):
        turn = rotation_matrix(np.radians(rng.uniform(6.0, 20.0)) * axis_of(rng))
        pose = rotation_vector(rotation_matrix(CAMERA.rotation_cam_enu) @ turn)
        wrong = replace(CAMERA, rotation_cam_enu=pose, mirrored=k % 4 == 0)
        for sigma_px in (0.3, 4.0):
            (matched,) = match_views([view_of(image, wrong, sigma_px)])
            assert not matched.matches.accepted


def axis_of(rng: np.random.Generator) -> np.ndarray:
    axis = rng.normal(size=3)
    return np.asarray(axis / np.linalg.norm(axis))


def test_lights_that_are_no_stars_give_none() -> None:
    for seed in range(4):
        dark = replace(NIGHT, lost=1.0, faint=150, hot_pixels=150, hot_seed=seed, satellites=3)
        found = found_in(image_of(CAMERA, dark))
        assert not found.accepted
        assert found.findings[0].code == "blind_no_pattern"
        assert float(found.findings[0].data["log10_chance"]) > -3.0


@pytest.mark.parametrize("hours", [-5.0, -1.0, 1.0, 9.0])
def test_an_hour_of_the_clock_is_refused(hours: float) -> None:
    level = replace(CAMERA, rotation_cam_enu=rotation_from_pose_angles(POSE._replace(theta_zz_deg=0.5)))
    found = found_in(image_of(level, NIGHT, late_s=3600.0 * hours))
    assert not found.accepted
    assert found.findings[0].code in {"camera_tilted_by_clock", "blind_no_pattern", "blind_tilted"}


@pytest.mark.parametrize(("level_within_deg", "accepted"), [(6.0, False), (20.0, True)])
def test_how_level_a_camera_stands_is_held_to_where_it_is_stated(*, level_within_deg: float, accepted: bool) -> None:
    options = BlindOptions(level_within_deg=level_within_deg)
    found = blind_start([image_of(TILTED, NIGHT)], pop.SGP, image_size=(CAMERA.width, CAMERA.height), options=options)
    assert found.accepted is accepted
    assert accepted or found.findings[0].code in {"blind_tilted", "blind_no_pattern"}


def test_the_chance_is_of_the_right_camera_and_of_no_other() -> None:
    image = image_of(CAMERA, NIGHT)
    magnitude = seen_magnitude(image.sky)
    for camera, least, most in (
        (CAMERA, -math.inf, -100.0),
        (TILTED, -1.0, 0.0),
        (replace(CAMERA, mirrored=True), -1.0, 0.0),
    ):
        assert least <= log10_chance(camera, image.sky.directions, magnitude, image.stars.pixels) <= most


def test_without_stars_or_detections_there_is_no_hypothesis() -> None:
    stars = bright_stars(image_of(CAMERA, NIGHT).sky.directions, seen_magnitude(image_of(CAMERA, NIGHT).sky))
    assert stars.shape[0] == 80
    for some, away in ((stars[:2], np.zeros((50, 2))), (stars, np.zeros((2, 2)))):
        assert patterns(Bright(stars=some, away=away), radius_px=(200.0, 400.0), max_tilt=0.3, most=9) == []


def chance_by_definition(camera: Camera, stars: np.ndarray, magnitude: np.ndarray, detections: np.ndarray) -> float:
    """Return the logarithm of ways to take five stars of five detections times scipy's binomial tail, best of six."""
    axis, best = project(camera, rotation_matrix(camera.rotation_cam_enu)[2:])[0], 0.0
    for faintest in (3.0, 4.0):
        some = project(camera, stars[magnitude <= faintest])
        n = len(some)
        if min(n, len(detections)) < 12:
            continue
        looked_at = detections[: 2 * n + 20]
        near, turned = cKDTree(looked_at), []
        for angle in np.radians(np.arange(25.0, 326.0, 25.0)):
            x, y = (some - axis).T
            turned.append(
                axis + np.stack([x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)], -1)
            )
        apart = np.asarray(near.query(np.concatenate(turned))[0])
        ways = (gammaln(n + 1) - gammaln(n - 4) - gammaln(6)) / math.log(10.0)
        tests = ways + 5.0 * math.log10(len(looked_at)) + math.log10(12.0)
        for share in (0.02, 0.008, 0.004):
            radius = share * camera.focal_length_px[0]
            distance, row = (np.asarray(column) for column in near.query(some))
            met = len(set(row[distance < radius].tolist()))
            chance = (np.count_nonzero(apart < radius) + 1.0) / (apart.size + 1.0)
            if met > 5:
                best = min(best, tests + float(binom.logsf(met - 6, n - 5, chance)) / math.log(10.0))
    return best


@pytest.mark.parametrize("lost", [0.5, 0.8])
def test_the_chance_is_ways_times_the_binomial_tail(lost: float) -> None:
    rng = np.random.default_rng(2)
    image = image_of(CAMERA, NIGHT)
    up = np.all(np.abs(project(CAMERA, image.sky.directions) - [450.0, 350.0]) < [449.0, 349.0], axis=-1)
    stars, magnitude = image.sky.directions[up], seen_magnitude(image.sky)[up]
    for count in (12, 40, len(image.stars)):
        detections = image.stars.pixels[rng.random(len(image.stars)) > lost][:count]
        for off_px in (0.0, 1.0, 3.0):
            camera = replace(CAMERA, principal_point_px=(462.0 + off_px, 341.0))
            found = log10_chance(camera, stars, magnitude, detections)
            assert found == pytest.approx(
                chance_by_definition(camera, stars, magnitude, detections), rel=1e-6, abs=1e-6
            )


def test_bright_stars_are_the_80_brightest_above_12_degrees() -> None:
    rng = np.random.default_rng(3)
    height, magnitude = np.radians(rng.uniform(0.0, 30.0, 200)), rng.uniform(0.0, 5.0, 200)
    directions = np.stack([np.cos(height), np.zeros(200), np.sin(height)], axis=-1)
    high = [k for k in np.argsort(magnitude) if height[k] > math.radians(12.0)][:80]
    np.testing.assert_array_equal(bright_stars(directions, magnitude), directions[high])
