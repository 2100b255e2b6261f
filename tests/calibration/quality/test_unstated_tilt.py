"""Acceptance of a tilted first camera: by a stated limit, by refraction and horizon, or by an earlier acceptance."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.fixtures.calibration import ideal_camera
from tests.fixtures.finding_codes import codes

from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.optics.forward import project
from sunarc.optics.pose import PoseAngles, rotation_from_pose_angles
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles, sun_directions

ATHENS = Site(latitude=37.98, longitude=23.73)
NOON_UNIX_S = 1_710_928_800.0
"""20 March 2024, 10:00 UTC."""
ASKED = ["camera_tilted_by_exchange", "tilt_in_doubt"]


def fitted(
    true: Site,
    stated: Site,
    *,
    tilt_deg: float = 1.5,
    lowest_deg: float = 8.0,
    sigma_px: float = 0.1,
    cadence_s: float = 240.0,
    options: CalibrationOptions | None = None,
    tilt_known: bool = False,
) -> Calibration:
    """Return the fit at a stated site of what a camera saw at the true one, the sun above an elevation."""
    rng = np.random.default_rng(1)
    times = NOON_UNIX_S + np.arange(-43_200.0, 43_200.0, cadence_s)
    times = times[sun_angles(times, true).apparent_zenith < 90.0 - lowest_deg]
    pose = rotation_from_pose_angles(PoseAngles(25.0, tilt_deg, 200.0))
    camera = replace(ideal_camera(), rotation_cam_enu=pose)
    pixels = project(camera, sun_directions(times, true)) + rng.normal(0.0, sigma_px, (times.size, 2))
    size = (camera.width, camera.height)
    used = CalibrationOptions() if options is None else options
    points = Sightings.of(unix_s=times, pixels=pixels)
    return calibrate(points, site=stated, image_size=size, options=used, tilt_known=tilt_known)


def exchanged(site: Site) -> Site:
    return replace(site, latitude=site.longitude, longitude=site.latitude)


def test_exchanged_coordinates_are_refused_with_the_true_ones_to_type() -> None:
    verdict = fitted(ATHENS, exchanged(ATHENS)).verdict
    assert not verdict.accepted
    assert not verdict.marginal
    question, doubt = verdict.findings[:2]
    assert [question.code, doubt.code] == ASKED
    assert (question.data["latitude"], question.data["longitude"]) == (ATHENS.latitude, ATHENS.longitude)
    assert float(question.data["level_deg"]) == pytest.approx(1.5, abs=0.2)


@pytest.mark.parametrize("how", ["stated", "accepted before"])
def test_what_lifts_the_refusal_does_not_lift_the_question(how: str) -> None:
    options = CalibrationOptions(level_within_deg=20.0 if how == "stated" else None)
    verdict = fitted(ATHENS, exchanged(ATHENS), options=options, tilt_known=how == "accepted before").verdict
    assert verdict.accepted
    assert verdict.findings[0].code == ASKED[0]


def test_a_tilt_above_its_stated_limit_is_refused_with_the_mistake_named_first() -> None:
    verdict = fitted(ATHENS, exchanged(ATHENS), options=CalibrationOptions(level_within_deg=5.0)).verdict
    assert not verdict.accepted
    question, beyond = verdict.findings[:2]
    assert [question.code, beyond.code] == ["camera_tilted_by_exchange", "tilt_too_large"]
    assert (question.data["latitude"], question.data["longitude"]) == (ATHENS.latitude, ATHENS.longitude)
    assert beyond.data["level_within_deg"] == 20.0


def test_refraction_shows_a_real_tilt_where_a_sharp_camera_sees_the_sun_down_to_the_horizon() -> None:
    found = fitted(ATHENS, ATHENS, tilt_deg=12.0, lowest_deg=0.5, sigma_px=0.02)
    assert found.verdict.accepted, found.verdict.reasons
    assert found.verdict.findings[0].code == "camera_tilted_shown"
    assert found.evidence.log_odds["tilt"] > 2.0 * math.log(10.0)


@pytest.mark.parametrize("sigma_px", [0.02, 0.3])
def test_refraction_never_shows_the_tilt_of_a_wrong_site(sigma_px: float) -> None:
    found = fitted(ATHENS, exchanged(ATHENS), lowest_deg=0.5, sigma_px=sigma_px)
    assert not found.verdict.accepted
    assert found.evidence.log_odds.get("tilt", 0.0) < 0.0


def test_a_real_tilt_is_asked_about_where_nothing_shows_it() -> None:
    found = fitted(ATHENS, ATHENS, tilt_deg=12.0, lowest_deg=15.0, sigma_px=0.3)
    assert "tilt_in_doubt" in codes(found.verdict.findings)
    (doubt,) = (one for one in found.verdict.findings if one.code == "tilt_in_doubt")
    assert doubt.data["level_within_deg"] == 15.0


def test_suns_that_the_camera_sees_below_the_horizon_refuse_a_site() -> None:
    """A longitude that is wrong by 5 degrees, its camera tilted by 4: eleven suns are below the horizon there."""
    found = fitted(ATHENS, replace(ATHENS, longitude=ATHENS.longitude + 5.0), lowest_deg=0.0, cadence_s=90.0)
    assert found.pose.theta_zz_deg < 5.6
    assert not found.verdict.accepted
    assert {"camera_sees_sun_below_horizon", "sightings_below_horizon"} & set(codes(found.verdict.findings))


def test_every_first_fit_says_what_a_wrong_site_would_do() -> None:
    found = fitted(ATHENS, ATHENS)
    assert found.verdict.accepted
    assert "site_assumed" in codes(found.verdict.findings)
    assert "site_assumed" not in codes(fitted(ATHENS, ATHENS, tilt_known=True).verdict.findings)
