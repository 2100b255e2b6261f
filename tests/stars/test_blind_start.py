"""A camera by one night's stars: found with either hand, refused where it is not sure; detections are drawn."""

from __future__ import annotations

import math
from dataclasses import replace

import nights
import numpy as np
import population as pop
import pytest

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.model.options import ImageCircle
from sunarc.detection.values import Stars
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import PoseAngles, rotation_from_pose_angles
from sunarc.sky.night import NightSky
from sunarc.stars.blind_start import BlindOptions, BlindStart, NightDetections, blind_start

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


def test_half_a_sky_is_enough() -> None:
    night = replace(NIGHT, cloud_share=0.4, satellites=5)
    found = started(images_of(CAMERA, night))
    assert found.accepted
    assert 0.0 < error_px(found, CAMERA) < 0.5


LEVEL = replace(CAMERA, rotation_cam_enu=rotation_from_pose_angles(POSE._replace(theta_zz_deg=0.5)))


def test_a_clock_in_another_zone_is_refused() -> None:
    zone = started(images_of(LEVEL, NIGHT, hours=(0.0, 1.0), late_s=3600.0))
    assert not zone.accepted
    assert [finding.code for finding in zone.findings] == ["camera_tilted_by_clock"]
    assert abs(float(zone.findings[0].data["hours"])) == 1.0


def test_a_clock_that_is_hours_off_is_refused() -> None:
    hours = started(images_of(LEVEL, NIGHT, hours=(0.0, 1.0), late_s=5.0 * 3600.0))
    assert not hours.accepted
    assert {finding.code for finding in hours.findings} & {"blind_tilted", "blind_no_stars"}


def test_a_clock_that_is_minutes_off_turns_the_camera_about_the_pole() -> None:
    found = started(images_of(LEVEL, NIGHT, hours=(0.0, 1.0), late_s=240.0))
    assert found.accepted
    assert found.camera is not None
    up = np.array([[0.0, 0.0, 1.0]])
    apart = np.linalg.norm(project(found.camera, up) - project(LEVEL, up))
    assert apart == pytest.approx(310.0 * math.radians(1.0) * math.cos(math.radians(36.604)), rel=0.1)


def test_what_does_not_turn_gives_no_camera() -> None:
    overcast = started(images_of(CAMERA, replace(NIGHT, lost=1.0), hours=(0.0, 1.0)))
    assert [finding.code for finding in overcast.findings] == ["blind_no_turning"]
    frozen = images_of(CAMERA, NIGHT, hours=(0.0,))[0]
    sky = nights.sky_of(nights.MIDNIGHT + 3600.0)
    same = started([frozen, replace(frozen, unix_s=frozen.unix_s + 3600.0, sky=sky)])
    assert not same.accepted
    short = started(images_of(CAMERA, NIGHT, hours=(0.0, 0.25)))
    assert [finding.code for finding in short.findings] == ["blind_few_images"]
    assert short.findings[0].data["turn_deg"] == pytest.approx(3.75, abs=0.02)
    assert [finding.code for finding in started([]).findings] == ["blind_few_images"]
    nothing = np.zeros(0)
    columns = dict.fromkeys(Stars.__dataclass_fields__, nothing)
    none = Stars(**{**columns, "pixels": np.zeros((0, 2)), "saturated": np.zeros(0, dtype=bool)})
    empty = [NightDetections(unix_s=3600.0 * hour, stars=none, sky=_no_sky()) for hour in range(3)]
    assert [finding.code for finding in started(empty).findings] == ["blind_few_images"]


def _no_sky() -> NightSky:
    return NightSky(names=np.zeros(0, dtype=np.str_), directions=np.zeros((0, 3)), magnitude=np.zeros(0))
