"""What a calibration answers, and what the judges of sightings say, compared with stored_answers.json.

Numbers agree to 1 % (those of fits differ by a third of that between processors), codes and counts exactly.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import NamedTuple

import nights
import numpy as np
import population as pop
import pytest
from numpy.typing import NDArray
from tests.fixtures.calibration import small_camera, stated_calibration, sun_arc
from tests.fixtures.clear_day import NOON_13_MAY_2013, SGP, SIZE, TRUTH, Simulated, simulate
from tests.fixtures.stored_answers import require_stored, said

from sunarc.calibration.acceptance import apart_sigmas, chi_square, disagreement, distance_px, pose_spread_deg
from sunarc.calibration.answers.covariance import (
    hemisphere,
    pose_error,
    sky_sigma_deg,
    sun_with_covariance,
    unproject_with_sigma,
)
from sunarc.calibration.answers.direction_table import back_projection_map, lookup
from sunarc.calibration.answers.error_model import draw_ensemble, rotated
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.pose_change import PoseChange
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings, filter_sightings, static_positions, static_sightings
from sunarc.calibration.noise import autocorrelation_inflation, growth_rate, lag_one, neighbours
from sunarc.calibration.quality.day_quality import decide_day, measure_day
from sunarc.calibration.quality.first_motion import site_contradiction
from sunarc.calibration.quality.fit_checks import JudgedFit
from sunarc.calibration.quality.tilt import tilt_question
from sunarc.calibration.quality.widening import add_pose_spread
from sunarc.calibration.selection import SelectionOptions, pick_surest_in_epochs, select_sightings
from sunarc.calibration.stated_prior import PriorTolerances, calibrate_with_prior
from sunarc.calibration.verdict import UNCERTAIN, UNEXPLAINED, accept, before_fit, findings, fit_verdict, provisional
from sunarc.changes.daily_rotations import (
    DailyRotations,
    as_shown,
    daily_pose_offset,
    daily_rotations,
    find_change,
    step_gains,
)
from sunarc.changes.online import change_details, update_window
from sunarc.changes.record import jumps_within_days, line_misses, night_changes
from sunarc.changes.values import Sighting, SightingWindow, WatchOptions
from sunarc.optics.backward import fit_backward
from sunarc.optics.forward import project
from sunarc.optics.pose import PoseAngles, rotation_from_pose_angles
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions
from sunarc.stars.blind_start import NightDetections, add_star_clock_error, blind_start

FloatArray = NDArray[np.float64]
Numbers = Mapping[str, Sequence[object]]

_STORED = Path(__file__).parent / "stored_answers.json"
_RELATIVE = 0.01
_SKY = hemisphere(12)
_DAY_S = 86_400.0


class Given(NamedTuple):
    """What the session has fitted already."""

    day: Simulated
    fit: Calibration


def _sigmas(covariance: FloatArray) -> list[float]:
    sigmas: list[float] = np.sqrt(np.diag(covariance)).tolist()
    return sigmas


def _of(found: Calibration) -> list[float]:
    sigma = np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
    return [found.sky_rms_deg, found.sky_max_deg, found.field.amplitude_px, found.metrics.rmse_px, *sigma.tolist()]


def _answers(given: Given) -> Numbers:
    pixels = np.array([[870.0, 880.0], [300.0, 900.0], [1200.0, 400.0], [40.0, 900.0]])
    _, sigma, inside = unproject_with_sigma(given.fit, pixels)
    some = sun_directions(given.day.points.unix_s[::120], SGP)
    place, covariance = sun_with_covariance(given.fit, some, site=SGP, measured=False)
    table = lookup(given.fit)
    tabled = table.project(_SKY)
    map_ = back_projection_map(table)
    maps = [np.nanmean(np.asarray(getattr(map_, one.name), dtype=float)[::97, ::89]) for one in fields(map_)]
    return {
        "codes": inside.tolist(),
        "numbers": [
            *sigma.tolist(),
            *np.nanmean(place, axis=0).tolist(),
            *_sigmas(np.nanmean(covariance, axis=0)),
            *sky_sigma_deg(given.fit),
            *np.nanmean(np.abs(tabled), axis=0).tolist(),
            *np.nanmean(np.abs(table.back_project(pixels)), axis=0).tolist(),
            *_sigmas(1e6 * np.nanmean(table.direction_covariance(_SKY), axis=0)),
            *maps,
        ],
    }


def _ensemble(given: Given) -> Numbers:
    drawn = draw_ensemble(given.fit, draws=2, seed=1, calibration_id="a")
    return {"numbers": [x for k in drawn for x in drawn.displacement(k, project(given.fit.camera, _SKY)).ravel()]}


def _later(given: Given, *, turn_deg: float = 0.05, wider: float = 1.3) -> Calibration:
    turned = rotated(given.fit.camera, np.radians([turn_deg, 0.0, turn_deg]))
    return replace(
        given.fit,
        camera=turned,
        covariance=wider * given.fit.covariance,
        sky_rms_deg=given.fit.sky_rms_deg * math.sqrt(wider),
        evidence=replace(given.fit.evidence, days=("2013-05-14",)),
    )


def _compared(given: Given) -> Numbers:
    later = _later(given)
    points = given.day.points.select(slice(None, None, 20))
    spread = pose_spread_deg(np.array([[0.02, 0.03, -0.05], [-0.03, 0.01, 0.06], [0.0, -0.05, 0.02]]), np.full(3, 0.01))
    return {
        "codes": [one.code for one in accept(later, given.fit).findings],
        "numbers": [
            distance_px(given.fit, later),
            *disagreement(given.fit, later),
            apart_sigmas(given.fit, later),
            chi_square(later, points, 0.5),
            *spread,
            add_pose_spread(given.fit, spread).sky_rms_deg,
            add_star_clock_error(given.fit, 2.0, limit_deg=0.5).sky_rms_deg,
            *_sigmas(1e6 * pose_error(given.fit.camera, SGP, clock_error_s=1.5, site_error_m=300.0)),
        ],
    }


def _cloudy_day(given: Given) -> Numbers:
    rng = np.random.default_rng(3)
    points = given.day.points.select(rng.random(len(given.day.points)) > 0.6)
    pixels = points.pixels + np.where(rng.random((len(points), 1)) < 0.1, [6.0, -4.0], 0.0)
    looked = given.day.points.unix_s[::2]
    measure = measure_day(replace(points, pixels=pixels), site=SGP, cadence_s=120.0, observed_unix_s=looked)
    decided = said(decide_day(measure).findings)
    values = [getattr(measure, one.name) for one in fields(measure)]
    numbers = [float(x) for x in values if isinstance(x, int | float)]
    return {"codes": decided["codes"], "numbers": [*numbers, *decided["numbers"]]}


def _checks(given: Given) -> Numbers:
    morning = given.day.points.select(slice(0, 60))
    usable = filter_sightings(morning, site=SGP)
    unsure = replace(given.fit, covariance=900.0 * given.fit.covariance)
    unsure = replace(unsure, sky_rms_deg=30.0 * given.fit.sky_rms_deg, sky_max_deg=30.0 * given.fit.sky_max_deg)
    verdict, strict = fit_verdict(unsure, usable, CalibrationOptions()), CalibrationOptions(max_sky_deg=0.01)
    kept = provisional(replace(unsure, verdict=verdict), limit_deg=0.1)
    return said(
        [
            *before_fit(usable, CalibrationOptions()),
            *verdict.findings,
            *findings(UNCERTAIN[2:], JudgedFit(calibration=unsure, usable=usable, options=strict)),
            *kept.verdict.findings,
        ]
    )


def _unexplained(given: Given) -> Numbers:
    points = given.day.points
    bent = replace(points, pixels=points.pixels + np.where(np.arange(len(points))[:, None] > 200, [0.5, 0.2], 0.0))
    usable = filter_sightings(bent, site=SGP)
    bent_fit = replace(given.fit, left_out=np.arange(201, len(points)))
    return said([*findings(UNEXPLAINED, JudgedFit(calibration=bent_fit, usable=usable))])


def _tilts(_: Given) -> Numbers:
    found = []
    for tilt, azimuth in ((12.0, 90.0), (20.0, 180.0), (33.0, 40.0)):
        pose = rotation_from_pose_angles(PoseAngles(phi_xz_deg=azimuth, theta_zz_deg=tilt, psi_z_deg=10.0))
        found.append(tilt_question(replace(TRUTH, rotation_cam_enu=pose), SGP))
    times: FloatArray = 1_368_455_400.0 + 30.0 * np.arange(10, dtype=np.float64)
    pixels = project(replace(TRUTH, max_angle=2.0), sun_directions(times, SGP))
    east = Site(latitude=SGP.latitude, longitude=-SGP.longitude)
    south = Site(latitude=-SGP.latitude, longitude=SGP.longitude)
    found += [site_contradiction(times, pixels, site=site, image_size=SIZE, mirrored="no") for site in (east, south)]
    return said(found)


def _days_of(seed: int) -> DailyRotations:
    rng, day = np.random.default_rng(seed), np.arange(40.0)
    sigma = np.array([0.004, 0.006, 0.01])
    turn = np.outer(np.sin(day / 20.0), [0.01, -0.01, 0.02]) + np.outer(day >= 23.0, [0.03, -0.02, 0.05])
    covariance = np.broadcast_to(np.diag(sigma**2), (40, 3, 3)).copy()
    return DailyRotations(day=day, rotation_deg=turn + rng.normal(0.0, sigma, (40, 3)), covariance_deg2=covariance)


def _steps(_: Given) -> Numbers:
    days = _days_of(4)
    change = find_change(days)
    assert change is not None
    found = change[0]
    shown = as_shown(days, found.likeliest)
    assert shown is not None
    rng = np.random.default_rng(2)
    sun = np.repeat(sun_arc(30), 3, axis=0)
    off = sun + rng.normal(0.0, 2e-4, sun.shape)
    off /= np.linalg.norm(off, axis=-1, keepdims=True)
    daily = daily_rotations(np.tile(np.arange(3.0), 30), observed=off, expected=sun)
    return {
        "codes": [found.time, *found.bracket, shown.time],
        "numbers": [
            found.gain,
            *found.rotation_deg,
            *_sigmas(found.covariance_deg2),
            shown.gain,
            *_sigmas(shown.covariance_deg2),
            *step_gains(days)[[5, 15, 23, 33]],
            *daily.rotation_deg.ravel(),
            *np.sqrt(np.diagonal(daily.covariance_deg2, axis1=1, axis2=2)).ravel(),
        ],
    }


def _offset(given: Given) -> Numbers:
    turned = rotated(given.fit.camera, np.radians([0.02, -0.01, 0.03]))
    sun = sun_directions(given.day.points.unix_s, SGP)
    noise = np.random.default_rng(2).normal(0.0, 0.02, (sun.shape[0], 2))
    points = replace(given.day.points, pixels=project(turned, sun) + noise).select(slice(None, None, 4))
    found = daily_pose_offset(points, calibration=given.fit, site=SGP)
    assert found is not None
    return {"codes": [], "numbers": [*found.rotation_deg[0], *np.sqrt(np.diag(found.covariance_deg2[0]))]}


def _jumps(_: Given) -> Numbers:
    rng = np.random.default_rng(5)
    times = (NOON_13_MAY_2013 + _DAY_S * np.arange(3.0)[:, None] + 300.0 * np.arange(-40.0, 40.0)).ravel()
    pixels = project(TRUTH, sun_directions(times, SGP))
    usable = filter_sightings(Sightings.of(unix_s=times, pixels=pixels), site=SGP)
    residual = rng.normal(0.0, 0.05, pixels.shape) + 0.1 * np.sin(times / 9000.0)[:, None]
    residual[130:160] += [0.6, -0.4]
    residual[160:] += [1.0, 0.8]
    misses = line_misses(residual, times)
    rows = [row for row, _ in (*jumps_within_days(residual, usable), *night_changes(residual, usable))]
    return {"codes": [int(row) for row in rows], "numbers": [x for each in misses for x in each[[10, 60, 118, 200]]]}


def _noise(_: Given) -> Numbers:
    rng = np.random.default_rng(6)
    times = NOON_13_MAY_2013 + 60.0 * np.arange(600.0)
    white = rng.normal(0.0, 1.0, (601, 2))
    residual = (white[1:] + 0.8 * white[:-1]) * np.linspace(0.5, 2.0, 600)[:, None]
    counted, run = np.linalg.norm(residual, axis=-1) < 4.0, np.repeat(np.arange(3), 200)
    follows = neighbours(times, run)
    inflated = autocorrelation_inflation(residual, counted, follows, run)
    zenith = np.linspace(0.1, 1.4, 600)
    rate = growth_rate(np.linalg.norm(residual, axis=-1), zenith, 0.3)
    return {"numbers": [*lag_one(residual, counted, follows), *inflated[::200], rate]}


def _change(given: Given) -> Numbers:
    camera = replace(given.fit.camera, max_angle=2.5)
    after = rotated(camera, np.radians([0.0, 0.1, 0.15]))
    times = NOON_13_MAY_2013 + _DAY_S + 60.0 * np.arange(-14.0, 14.0)
    sun = sun_directions(times, SGP)
    pixels = np.where(np.arange(28)[:, None] < 14, project(camera, sun), project(after, sun))
    pixels = pixels + np.random.default_rng(7).normal(0.0, 0.02, pixels.shape)
    watch, change = SightingWindow(), None
    for unix_s, pixel, direction in zip(times.tolist(), pixels.tolist(), sun.tolist(), strict=True):
        one = Sighting(unix_s=unix_s, pixel=tuple(pixel), direction=tuple(direction), sigma_px=0.02)
        watch, change = update_window(watch, one, calibration=given.fit, site=SGP, options=WatchOptions())
        if change is not None:
            return _changed(change)
    raise AssertionError("no change")


def _changed(change: PoseChange) -> Numbers:
    times = [change.time, *change.bracket]
    said = change_details(change)
    since = [(each - NOON_13_MAY_2013 - _DAY_S) / 60.0 for each in times]
    return {
        "codes": [*(said[key] for key in ("kind", "unit", "agreeing", "of", "perhaps")), *np.round(since).tolist()],
        "numbers": [said["size"], said["size_sigma"], change.gain],
    }


def _with_prior(given: Given) -> Numbers:
    some = given.day.points.select(slice(150, 190, 2))
    some = replace(some, sigma_px=np.full(len(some), 0.05))
    found = calibrate_with_prior(
        some, prior=TRUTH, tolerances=PriorTolerances(lens_px=2.0, pose_deg=1.0), site=SGP, options=CalibrationOptions()
    )
    return {"codes": said(found.verdict.findings)["codes"], "numbers": _of(found)}


def _two_days(_: Given) -> Numbers:
    points = simulate(days=(0.0, 40.0), cadence_s=600.0, sigma_px=0.2, seed=8).points
    pixels = points.pixels + 0.3 * np.stack(
        [np.sin(points.pixels[:, 1] / 150.0), np.cos(points.pixels[:, 0] / 200.0)], -1
    )
    options = CalibrationOptions(projection="equisolid")
    found = calibrate(replace(points, pixels=pixels), site=SGP, image_size=SIZE, options=options)
    metrics = [found.metrics.held_out_rmse_px or 0.0, found.metrics.held_out_expected_px or 0.0]
    evidence = [found.evidence.sigma_px, found.evidence.inflation, found.evidence.radial_px]
    return {"codes": said(found.verdict.findings)["codes"], "numbers": [*_of(found), *metrics, *evidence]}


def _selected(_: Given) -> Numbers:
    times = np.concatenate([NOON_13_MAY_2013 + _DAY_S * day + np.arange(-2e4, 2e4, 60.0) for day in range(0, 90, 3)])
    rng = np.random.default_rng(9)
    points = Sightings.of(
        unix_s=times, pixels=rng.uniform(0.0, 1748.0, (times.size, 2)), sigma_px=rng.uniform(0.02, 0.5, times.size)
    )
    chosen = select_sightings(points, site=SGP, options=SelectionOptions(patch_deg=4.0, most=1500))
    stars = pick_surest_in_epochs(points.pixels[:900], points.sigma_px[:900], np.repeat([0, 1, 2], 300), SIZE)
    still = np.concatenate([points.pixels[:300], np.full((60, 2), 500.0) + rng.normal(0.0, 0.05, (60, 2))])
    seen = sun_directions(times[:360], SGP)
    static = static_sightings(still, seen, np.zeros(360, dtype=np.int64))
    places = static_positions(still[static])
    return {
        "codes": [*chosen.counts().values(), int(chosen.index.sum()), int(stars.sum()), int(static.sum()), len(places)],
        "numbers": [float(np.mean(points.sigma_px[chosen.index]))],
    }


def _backward(_: Given) -> Numbers:
    model = fit_backward(small_camera())
    return {"numbers": [*model.radial[:4], *model.decentering[:2], model.max_error_px]}


def _blind(_: Given) -> Numbers:
    camera = replace(
        TRUTH, width=900, height=700, projection="equidistant", focal_length_px=(215.0, 215.0),
        principal_point_px=(462.0, 341.0), radial=(0.0,) * 8, max_angle=math.radians(92.0),
    )  # fmt: skip
    sky = nights.sky_of(nights.MIDNIGHT)
    stars = nights.detections(np.random.default_rng(8), camera, sky, nights.Night(sigma_px=0.15, faint=100))[0]
    inside = np.all((stars.pixels > 0.0) & (stars.pixels < [899.0, 699.0]), axis=-1)
    image = NightDetections(unix_s=nights.MIDNIGHT, stars=stars.select(inside), sky=sky)
    found = blind_start([image], pop.SGP, image_size=(900, 700))
    assert found.camera is not None
    place = [*found.camera.focal_length_px, *found.camera.principal_point_px]
    return {"codes": said(found.findings)["codes"], "numbers": place}


def _unsure_camera(_: Given) -> Numbers:
    stated = stated_calibration(small_camera(), amplitude_px=0.3)
    values, sigma, inside = unproject_with_sigma(stated, np.array([[320.0, 240.0], [100.0, 300.0]]))
    return {"codes": inside.tolist(), "numbers": [*values.ravel(), *sigma, *sky_sigma_deg(stated)]}


_ANSWERS: dict[str, Callable[[Given], Numbers]] = {
    "answers": _answers,
    "ensemble": _ensemble,
    "compared": _compared,
    "cloudy_day": _cloudy_day,
    "checks": _checks,
    "unexplained": _unexplained,
    "tilts": _tilts,
    "steps": _steps,
    "offset": _offset,
    "jumps": _jumps,
    "noise": _noise,
    "change": _change,
    "with_prior": _with_prior,
    "two_days": _two_days,
    "selected": _selected,
    "backward": _backward,
    "blind": _blind,
    "unsure_camera": _unsure_camera,
}


@pytest.fixture(scope="module")
def given(clear_day: Simulated, calibrated: Calibration) -> Given:
    return Given(clear_day, calibrated)


@pytest.mark.parametrize("name", _ANSWERS)
def test_an_answer_is_the_stored_one(given: Given, name: str) -> None:
    require_stored(_STORED, name, _ANSWERS[name](given), relative=_RELATIVE)
