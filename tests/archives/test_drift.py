"""An epoch whose clock drifts is refused with its rate; of a camera that leans a time's pose and the rate are stated.

The sightings are made by a formula of the projection that is written here, and by nothing of the simulator.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import jsonschema_rs
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.fixtures.finding_codes import codes

from sunarc.archives.fit import CameraSightings, Final, final_analysis, first_analysis
from sunarc.archives.leaning import leaning_fit, seen_directions
from sunarc.archives.states import ArchiveCamera
from sunarc.calibration.acceptance import apart_sigmas
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.changes.epoch_changes import drift_finding, drift_within, estimate_daily_noise, spread_deg
from sunarc.common.array_types import FloatArray
from sunarc.common.utc import utc_time
from sunarc.formats.calibration_document import from_document, to_document
from sunarc.optics.forward import project
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles

SITE = Site(latitude=47.1, longitude=8.4, altitude=500.0)
SIZE = (640, 600)
FOCAL = 168.0
START = 17_361 * 86_400.0
DAYS = 12
OPTIONS = CalibrationOptions(mirrored="yes", projection="equidistant")
EAST, NORTH, UP = np.eye(3)


class Drift(NamedTuple):
    """A turn a day about an axis, degrees, or at once in the middle; by how much the clock gains on a day, s."""

    axis: FloatArray = UP
    deg: float = 0.0
    clock_s: float = 0.0
    at_once: bool = False
    until: float = np.inf


HIDDEN = Drift(NORTH, deg=0.012)


def archive(seed: int, drift: Drift, *, per_day: int = 14, sigma_px: float = 0.4) -> Sightings:
    """Return sightings of a level camera that drifts from noon to noon."""
    rng = np.random.default_rng(seed)
    noon = START + 43_200.0 - SITE.longitude * 240.0 + 86_400.0 * np.arange(DAYS)
    times = np.sort((noon[:, None] + rng.uniform(-24_000.0, 24_000.0, (DAYS, per_day))).ravel())
    times = times[sun_angles(times, SITE).apparent_zenith < 84.0]
    angles, days = sun_angles(times, SITE), (times - noon[0]) / 86_400.0
    days = np.where(days > 0.5 * DAYS, 1.0, 0.0) if drift.at_once else np.minimum(days, drift.until)
    zenith, azimuth = np.radians(angles.apparent_zenith), np.radians(angles.azimuth)
    sun = np.stack([np.sin(zenith) * np.sin(azimuth), np.sin(zenith) * np.cos(azimuth), np.cos(zenith)], axis=-1)
    east, north, up = Rotation.from_rotvec(np.radians(-drift.deg * days)[:, None] * drift.axis).apply(sun).T
    radius = FOCAL * np.arctan2(np.hypot(east, north), up) / np.hypot(east, north)
    pixels = np.stack([322.0 + radius * east, 297.0 - radius * north], axis=-1)
    return Sightings.of(
        unix_s=times + drift.clock_s * days,
        pixels=pixels + rng.normal(0.0, sigma_px, pixels.shape),
        sigma_px=np.full(times.size, sigma_px),
    )


def analysed(points: Sightings) -> Final:
    given = CameraSightings(points, ArchiveCamera(SITE, SIZE, OPTIONS))
    return final_analysis(given._replace(states=first_analysis(given).states))


def calibrated(final: Final, points: Sightings) -> Calibration:
    """Return the calibration of the one epoch."""
    assert [(one.first, one.last) for one in final.epochs] == [(0, len(points) - 1)]
    return final.fitted[final.states[final.epochs[0].state].pose].calibration


def test_an_epoch_whose_clock_drifts_is_refused_with_its_rate() -> None:
    points = archive(0, Drift(clock_s=-25.0))
    verdict = calibrated(analysed(points), points).verdict
    assert not verdict.accepted
    assert verdict.findings[0].code == "clock_drifts_on"
    assert float(verdict.findings[0].data["s_per_day"]) == pytest.approx(-25.0, rel=0.3)


def test_a_camera_that_leans_has_the_pose_of_a_time_and_its_rate() -> None:
    drift = Drift(NORTH, deg=0.05)
    points = archive(0, drift)
    found = calibrated(analysed(points), points)
    turning = found.evidence.turning
    assert found.verdict.accepted
    assert "mount_leans" in codes(found.verdict.findings)
    assert turning is not None
    assert np.all(np.abs(np.array(turning.deg_per_day) - 0.05 * NORTH) < 3.0 * np.array(turning.sigma_deg_per_day))
    assert max(turning.sigma_deg_per_day) < 0.01
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(200, 3))
    directions[:, 2] = np.abs(directions[:, 2]) + 0.2
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    noon = START + 43_200.0 - SITE.longitude * 240.0
    for unix_s in (points.unix_s[0], turning.at_unix_s, points.unix_s[-1]):
        days = (unix_s - noon) / 86_400.0
        east, north, up = Rotation.from_rotvec(np.radians(-0.05 * days) * NORTH).apply(directions).T
        radius = FOCAL * np.arctan2(np.hypot(east, north), up) / np.hypot(east, north)
        true = np.stack([322.0 + radius * east, 297.0 - radius * north], axis=-1)
        off = project(found.camera, seen_directions(found, directions, np.full(200, unix_s))) - true
        off_deg = np.degrees(np.linalg.norm(off, axis=1) / FOCAL)
        assert float(np.sqrt(np.mean(off_deg**2))) < 2.0 * found.sky_rms_deg
    day = utc_time(START)
    written = to_document(
        found,
        id="one",
        camera="roof",
        state="candidate",
        created_at=day,
        valid_from=day,
        valid_until=None,
        pose_epoch="001",
        software_version="0.1.0",
    )
    assert from_document(json.loads(json.dumps(written))).evidence.turning == turning
    json_schema = json.loads((Path(__file__).parents[2] / "docs" / "calibration.schema.json").read_text())
    jsonschema_rs.validator_for(json_schema).validate(written)


def test_the_clock_of_summer_time_is_found_while_the_camera_leans() -> None:
    drift = Drift(NORTH, deg=0.1)
    points = archive(0, drift)
    late = points.unix_s > START + 7.0 * 86_400.0
    final = analysed(replace(points, unix_s=points.unix_s + np.where(late, 3600.0, 0.0)))
    assert [(one.cause, one.first) for one in final.epochs] == [("start", 0), ("clock", int(np.argmax(late)))]
    assert [final.states[one.state].clock_offset_s for one in final.epochs] == [0.0, 3600.0]
    for epoch in final.epochs:
        found = final.fitted[final.states[epoch.state].pose].calibration
        assert found.verdict.accepted
        assert found.evidence.turning is not None
        off = np.array(found.evidence.turning.deg_per_day) - 0.1 * NORTH
        assert np.all(np.abs(off) < 3.0 * np.array(found.evidence.turning.sigma_deg_per_day))


@pytest.mark.parametrize("drift", [Drift(NORTH, deg=0.3, until=0.4 * DAYS), Drift(NORTH, deg=0.3, at_once=True)])
def test_a_turn_that_is_not_steady_is_refused(drift: Drift) -> None:
    points = archive(0, drift)
    final = analysed(points)
    fits = [final.fitted[final.states[one.state].pose].calibration for one in final.epochs]
    assert not any(one.verdict.accepted and one.evidence.turning is not None for one in fits)


def test_a_turn_of_few_days_is_no_lean() -> None:
    points = archive(0, Drift(NORTH, deg=0.05))
    fit = calibrate(points, site=SITE, image_size=SIZE, options=OPTIONS)
    noise, camera = estimate_daily_noise(points, SITE), ArchiveCamera(SITE, SIZE, OPTIONS)
    some = points.select(points.unix_s < START + 4.0 * 86_400.0)
    drift = drift_within(some, fit.camera, SITE, noise[: len(some)])
    assert drift is not None
    assert leaning_fit(some, camera, noise[: len(some)], drift, fit.camera) is None


@pytest.mark.parametrize("seed", [0, 3])
def test_one_that_stands_still_does_not_drift(seed: int) -> None:
    points = archive(seed, Drift(), per_day=10 + 10 * seed)
    fit = calibrate(points, site=SITE, image_size=SIZE, options=OPTIONS)
    found = drift_within(points, fit.camera, SITE, estimate_daily_noise(points, SITE))
    assert found is not None
    assert drift_finding(found) is None
    assert found.gain < 0.0
    assert max(spread_deg(found)) < fit.sky_rms_deg


def test_a_drift_that_the_noise_hides_is_in_the_uncertainty() -> None:
    hidden, still = (next(iter(analysed(archive(2, one)).fitted.values())).calibration for one in (HIDDEN, Drift()))
    assert hidden.verdict.accepted
    assert still.verdict.accepted
    assert hidden.evidence.pose_spread_deg is not None
    assert still.evidence.pose_spread_deg is not None
    # the root mean square between two times is that of the whole turn over the square root of six
    whole = HIDDEN.deg * (DAYS - 1) / np.sqrt(6.0)
    assert 0.3 < hidden.evidence.pose_spread_deg[1] / whole < 1.5
    assert max(still.evidence.pose_spread_deg) < 0.6 * max(hidden.evidence.pose_spread_deg)
    # nor do its parts ask for more
    assert still.evidence.held_out.get("widening", 1.0) < 1.5


def test_a_step_is_no_drift() -> None:
    final = analysed(archive(3, Drift(NORTH, deg=0.5, at_once=True)))
    assert [one.cause for one in final.epochs] == ["start", "moved"]
    assert not {one.code for fit in final.fitted.values() for one in fit.calibration.verdict.findings} & {
        "mount_drifts",
        "clock_drifts_on",
    }


def test_too_few_sightings_say_nothing_of_a_drift() -> None:
    points = archive(0, Drift())
    fit = calibrate(points, site=SITE, image_size=SIZE, options=OPTIONS)
    some = points.select(slice(0, 12))
    assert drift_within(some, fit.camera, SITE, estimate_daily_noise(some, SITE)) is None


def test_days_that_a_camera_does_not_see_are_of_no_drift_of_it() -> None:
    points = archive(0, Drift())
    fit = calibrate(points, site=SITE, image_size=SIZE, options=OPTIONS)
    narrow, noise = replace(fit.camera, max_angle=np.radians(55.0)), estimate_daily_noise(points, SITE)
    low = sun_angles(points.unix_s, SITE).apparent_zenith > 60.0
    order = np.argsort(low, kind="stable")
    sorted_points = points.select(order)
    change = int(np.count_nonzero(~low))
    assert drift_within(sorted_points, narrow, SITE, noise[order], changes=[(change, "moved")]) is None


def test_cameras_are_apart_by_their_stated_errors() -> None:
    fit = calibrate(archive(0, Drift()), site=SITE, image_size=SIZE, options=OPTIONS)
    assert apart_sigmas(fit, fit) == 0.0
    turned = replace(
        fit, camera=replace(fit.camera, principal_point_px=(fit.camera.principal_point_px[0] + 20.0, 297.0))
    )
    assert apart_sigmas(fit, turned) > 5.0
