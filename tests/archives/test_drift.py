"""An epoch whose mount or clock drifts is refused, with what drifts and by how much; one that stands still is not.

The sightings are made by a formula of the projection that is written here, and by nothing of the simulator.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sunarc.archives.fit import CameraSightings, Final, final_analysis, first_analysis
from sunarc.archives.states import ArchiveCamera
from sunarc.calibration.acceptance import apart_sigmas
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.sightings import Sightings
from sunarc.changes.epoch_changes import drift_finding, drift_within, estimate_daily_noise, spread_deg
from sunarc.common.array_types import FloatArray
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


HIDDEN = Drift(NORTH, deg=0.012)


def archive(seed: int, drift: Drift, *, per_day: int = 14, sigma_px: float = 0.4) -> Sightings:
    """Return sightings of a level camera that drifts from noon to noon."""
    rng = np.random.default_rng(seed)
    noon = START + 43_200.0 - SITE.longitude * 240.0 + 86_400.0 * np.arange(DAYS)
    times = np.sort((noon[:, None] + rng.uniform(-24_000.0, 24_000.0, (DAYS, per_day))).ravel())
    times = times[sun_angles(times, SITE).apparent_zenith < 84.0]
    angles, days = sun_angles(times, SITE), (times - noon[0]) / 86_400.0
    days = np.where(days > 0.5 * DAYS, 1.0, 0.0) if drift.at_once else days
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


@pytest.mark.parametrize(
    ("code", "key", "true", "drift"),
    [
        ("mount_drifts", "turn_deg", 0.05 * (DAYS - 1), Drift(NORTH, deg=0.05)),
        ("clock_drifts_on", "s_per_day", -25.0, Drift(clock_s=-25.0)),
    ],
)
def test_an_epoch_that_drifts_is_refused_with_what_drifts(code: str, key: str, true: float, drift: Drift) -> None:
    points = archive(0, drift)
    final = analysed(points)
    assert [(one.first, one.last) for one in final.epochs] == [(0, len(points) - 1)]
    verdict = final.fitted[final.states[final.epochs[0].state].pose].calibration.verdict
    assert not verdict.accepted
    assert verdict.findings[0].code == code
    assert float(verdict.findings[0].data[key]) == pytest.approx(true, rel=0.3)


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
