"""A camera by one night's stars: found with either hand, refused where it is not sure; detections are drawn."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import nights
import numpy as np
import population as pop
import pytest
from scipy.spatial import cKDTree
from tests.fixtures.stored_answers import require_stored, said

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.model.options import ImageCircle
from sunarc.detection.values import Stars
from sunarc.optics.camera import Camera, Param
from sunarc.optics.forward import project, project_with_jacobian
from sunarc.optics.pose import PoseAngles, rotation_from_pose_angles
from sunarc.sky.night import NightSky
from sunarc.stars.blind_start import BlindOptions, BlindStart, NightDetections, blind_start, refined

POSE = PoseAngles(phi_xz_deg=112.0, theta_zz_deg=3.0, psi_z_deg=77.0)
CAMERA = Camera(
    width=1000,
    height=900,
    projection="equisolid",
    focal_length_px=(310.0, 310.0),
    principal_point_px=(506.0, 443.0),
    rotation_cam_enu=rotation_from_pose_angles(POSE),
    max_angle=math.radians(92.0),
)
NIGHT = nights.Night(sigma_px=0.15, faint=120, hot_pixels=60)


def images_of(
    camera: Camera, night: nights.Night, *, hours: tuple[float, ...] = (0.0, 1.0, 2.0), late_s: float = 0.0
) -> list[NightDetections]:
    """Return what a camera sees in a night, beside the sky of a clock that is late."""
    rng, found = np.random.default_rng(4), []
    for hour in hours:
        when = nights.MIDNIGHT + 3600.0 * hour
        stars, _ = nights.detections(rng, camera, nights.sky_of(when), night)
        inside = np.all((stars.pixels > 0.0) & (stars.pixels < [camera.width - 1.0, camera.height - 1.0]), axis=-1)
        found.append(NightDetections(unix_s=when, stars=stars.select(inside), sky=nights.sky_of(when + late_s)))
    return found


CIRCLE = BlindOptions(circle=ImageCircle(x=506.0, y=443.0, radius=310.0 * math.sqrt(2.0)))


def started(images: list[NightDetections], options: BlindOptions | None = CIRCLE) -> BlindStart:
    return blind_start(images, pop.SGP, image_size=(CAMERA.width, CAMERA.height), options=options)


def error_px(found: BlindStart, camera: Camera) -> float:
    assert found.camera is not None
    sky = hemisphere(300)
    sky = sky[sky[:, 2] > 0.2]
    return float(np.nanmedian(np.linalg.norm(project(found.camera, sky) - project(camera, sky), axis=-1)))


def require_as_stored(name: str, found: BlindStart) -> None:
    """Require the stored findings, camera, and counts of matched stars."""
    answer = said(found.findings)
    counts = [int(x) for one in found.findings for x in one.data.values() if isinstance(x, int)]
    camera = [] if found.camera is None else [*found.camera.focal_length_px, *found.camera.principal_point_px]
    stated = {
        "codes": [*answer["codes"], *counts, *(one.star.size for one in found.matches), *map(len, found.stars)],
        "numbers": [*answer["numbers"], *camera],
    }
    require_stored(Path(__file__).parent / "stored_answers.json", name, stated, relative=0.01)


@pytest.mark.parametrize("mirrored", [False, True])
def test_lens_pose_and_hand_are_found_and_the_stars_named(mirrored: bool) -> None:  # noqa: FBT001 - a parameter
    camera = replace(CAMERA, mirrored=mirrored)
    found = started(images_of(camera, NIGHT), None)
    assert found.accepted
    assert found.camera is not None
    assert found.camera.mirrored == mirrored
    assert 0.0 < error_px(found, camera) < 0.5
    assert sum(matches.star.size for matches in found.matches) > 1200
    (data,) = (finding.data for finding in found.findings if finding.code == "blind_found")
    assert data["images"] == 3
    assert data["rival"] == 0
    assert data["tilt_deg"] == pytest.approx(3.0, abs=0.1)
    # the pole's height is the latitude: 0.25 degrees a minute about it
    assert data["north_deg_per_minute"] == pytest.approx(0.25 * math.sin(math.radians(36.604)), rel=1e-3)
    require_as_stored(f"mirrored_{mirrored}", found)


def test_half_a_sky_is_enough() -> None:
    night = replace(NIGHT, cloud_share=0.4, satellites=5)
    found = started(images_of(CAMERA, night))
    assert found.accepted
    assert 0.0 < error_px(found, CAMERA) < 0.5
    require_as_stored("half_a_sky", found)


LEVEL = replace(CAMERA, rotation_cam_enu=rotation_from_pose_angles(POSE._replace(theta_zz_deg=0.5)))


def test_a_clock_in_another_zone_is_refused() -> None:
    zone = started(images_of(LEVEL, NIGHT, hours=(0.0, 1.0), late_s=3600.0))
    assert not zone.accepted
    assert [finding.code for finding in zone.findings] == ["camera_tilted_by_clock"]
    assert abs(float(zone.findings[0].data["hours"])) == 1.0
    require_as_stored("other_zone", zone)


def test_a_clock_that_is_hours_off_is_refused() -> None:
    hours = started(images_of(LEVEL, NIGHT, hours=(0.0, 1.0), late_s=5.0 * 3600.0))
    assert not hours.accepted
    assert {finding.code for finding in hours.findings} & {"blind_tilted", "blind_no_stars"}
    require_as_stored("hours_off", hours)


def test_a_clock_that_is_minutes_off_turns_the_camera_about_the_pole() -> None:
    found = started(images_of(LEVEL, NIGHT, hours=(0.0, 1.0), late_s=240.0))
    assert found.accepted
    assert found.camera is not None
    up = np.array([[0.0, 0.0, 1.0]])
    apart = np.linalg.norm(project(found.camera, up) - project(LEVEL, up))
    assert apart == pytest.approx(310.0 * math.radians(1.0) * math.cos(math.radians(36.604)), rel=0.1)
    require_as_stored("minutes_off", found)


def test_what_does_not_turn_gives_no_camera() -> None:
    overcast = started(images_of(CAMERA, replace(NIGHT, lost=1.0), hours=(0.0, 1.0)))
    assert [finding.code for finding in overcast.findings] == ["blind_no_turning"]
    frozen = images_of(CAMERA, NIGHT, hours=(0.0,))[0]
    sky = nights.sky_of(nights.MIDNIGHT + 3600.0)
    same = started([frozen, replace(frozen, unix_s=frozen.unix_s + 3600.0, sky=sky)])
    assert not same.accepted
    require_as_stored("overcast", overcast)
    short = started(images_of(CAMERA, NIGHT, hours=(0.0, 0.25)))
    assert [finding.code for finding in short.findings] == ["blind_few_images"]
    assert short.findings[0].data["turn_deg"] == pytest.approx(3.75, abs=0.02)
    assert [finding.code for finding in started([]).findings] == ["blind_few_images"]
    nothing = np.zeros(0)
    columns = dict.fromkeys(Stars.__dataclass_fields__, nothing)
    none = Stars(**{**columns, "pixels": np.zeros((0, 2)), "saturated": np.zeros(0, dtype=bool)})
    empty = [NightDetections(unix_s=3600.0 * hour, stars=none, sky=_no_sky()) for hour in range(3)]
    assert [finding.code for finding in started(empty).findings] == ["blind_few_images"]
    assert [finding.code for finding in started(empty[:1]).findings] == ["stars_few"]


def _no_sky() -> NightSky:
    return NightSky(names=np.zeros(0, dtype=np.str_), directions=np.zeros((0, 3)), magnitude=np.zeros(0))


FITTED = [
    Param.FOCAL_LENGTH_X_PX, Param.PRINCIPAL_POINT_X_PX, Param.PRINCIPAL_POINT_Y_PX,
    Param.ROTATION_X, Param.ROTATION_Y, Param.ROTATION_Z, Param.K2, Param.K3, Param.K4, Param.K5,
]  # fmt: skip


def with_fitted(camera: Camera, values: np.ndarray) -> Camera:
    vector = camera.to_vector()
    vector[FITTED] = values
    vector[Param.FOCAL_LENGTH_Y_PX] = vector[Param.FOCAL_LENGTH_X_PX]
    return camera.replace_parameters(vector)


def refined_by_definition(
    camera: Camera, images: Sequence[NightDetections], rounds: Sequence[tuple[float, float]]
) -> tuple[Camera, float]:
    """Return what three robust Gauss-Newton steps a round come to, the derivatives by differences."""
    focal, start, size = camera.focal_length_px[0], camera.to_vector()[FITTED], (camera.width, camera.height)
    sigma = np.array([0.1 * focal, 0.08 * focal, 0.08 * focal, 0.3, 0.3, 0.3, 0.05, 0.05, 0.05, 0.05])
    scatter = math.nan
    for reach, faintest in rounds:
        radius = max(reach * focal, 2.0)
        for _ in range(3):
            directions, seen = [], []
            for image in images:
                sky = image.sky.directions[image.sky.magnitude <= faintest]
                there = project_with_jacobian(camera, sky)[0]
                up = np.all((there > -0.5) & (there < np.array(size) - 0.5), axis=-1)
                sky, there = sky[up], there[up]
                some = image.stars.pixels[: round(1.5 * len(sky)) + 10]
                apart, row = (np.asarray(column) for column in cKDTree(some).query(there))
                mutual = (apart < radius) & (np.asarray(cKDTree(there).query(some)[1])[row] == np.arange(len(there)))
                directions.append(sky[mutual])
                seen.append(some[row[mutual]])
            towards, pixels = np.concatenate(directions), np.concatenate(seen)
            now = camera.to_vector()[FITTED]
            residual = pixels - project_with_jacobian(camera, towards)[0]
            steps = np.where(np.arange(10) < 3, 1e-3, 1e-6)
            slopes = [
                (project_with_jacobian(with_fitted(camera, now + d), towards)[0]
                 - project_with_jacobian(with_fitted(camera, now - d), towards)[0]) / (2.0 * step)
                for step, d in zip(steps, np.diag(steps), strict=True)
            ]  # fmt: skip
            scatter = max(1.4826 * float(np.median(np.abs(residual))), 0.1)
            ratio = np.linalg.norm(residual, axis=-1) / max(6.0 * scatter, 0.1 * radius)
            weight = np.maximum(np.maximum(1.0 - ratio**2, 0.0) ** 2, 1e-9) / scatter**2
            rows = np.stack(slopes, axis=-1)
            normal = np.einsum("nij,n,nik->jk", rows, weight, rows) + np.diag(sigma**-2)
            pull = np.einsum("nij,n,ni->j", rows, weight, residual) + (start - now) / sigma**2
            camera = with_fitted(camera, now + np.linalg.solve(normal, pull))
    return camera, scatter


@pytest.mark.parametrize("rounds", [((0.05, 3.0),), ((0.08, 2.5), (0.001, 4.0)), None])
def test_a_rough_camera_is_refined_by_weighted_steps_towards_the_catalogue(
    rounds: tuple[tuple[float, float], ...] | None,
) -> None:
    images = images_of(CAMERA, NIGHT, hours=(0.0, 2.0))
    vector = CAMERA.to_vector()
    vector[FITTED] += [6.0, -5.0, 4.0, 0.01, -0.01, 0.02, 0.01, 0.0, 0.0, 0.0]
    rough = with_fitted(CAMERA, vector[FITTED])
    usual = (
        (0.1, 2.0), (0.08, 2.5), (0.06, 3.0), (0.045, 3.0), (0.03, 3.5), (0.02, 3.5),
        (0.012, 4.0), (0.008, 4.5), (0.006, 4.5),
    )  # fmt: skip
    found = refined(rough, images) if rounds is None else refined(rough, images, rounds)
    assert found is not None
    expected, scatter = refined_by_definition(rough, images, rounds or usual)
    sky = hemisphere(50)
    np.testing.assert_allclose(project(found.camera, sky), project(expected, sky), atol=1e-3)
    assert found.scatter_px == pytest.approx(scatter, rel=1e-4)


def test_twelve_stars_near_detections_are_enough_to_refine() -> None:
    (image,) = images_of(CAMERA, replace(NIGHT, faint=0, hot_pixels=0), hours=(0.0,))
    brightest = image.sky.select(np.argsort(image.sky.magnitude)[:60])
    there = project(CAMERA, brightest.directions)
    order = np.flatnonzero(np.all((there > 20.0) & (there < [980.0, 880.0]), axis=-1))[:12]
    for count in (11, 12):
        some = brightest.select(order[:count])
        one = np.ones(count)
        stars = Stars(
            pixels=there[order[:count]], sigma_px=0.1 * one, flux=one, snr=50.0 * one, peak_fraction=0.5 * one,
            width_px=one, ellipticity=0.0 * one, saturated=one < 0.0,
        )  # fmt: skip
        seen = NightDetections(unix_s=image.unix_s, stars=stars, sky=some)
        assert (refined(CAMERA, [seen], ((0.05, 6.0),)) is not None) == (count == 12)
