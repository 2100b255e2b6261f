"""Errors that many sightings share: displacements against cameras that are turned, and where none are."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.calibration import observed, small_camera, small_problem, spread_directions
from tests.fixtures.clear_day import SGP, SIZE, TRUTH, rms, times_of

from sunarc.calibration.answers.ageing import SEASONS, season_columns
from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.fit.effects import (
    CLOCK_DRIFT_S_PER_H,
    CLOCK_OFFSET_S,
    DECENTRED_PX,
    OFFSET_PX,
    POSE_DIFFERENCE_DEG,
    SWAY_DEG,
    add_effects,
)
from sunarc.calibration.model.options import USUAL_OPTIONS
from sunarc.calibration.model.result import Calibration, probability, proves
from sunarc.calibration.model.sightings import Kind, Sightings, body_kinds
from sunarc.calibration.solve.priors import WIDE_ASPECT
from sunarc.common.array_types import stacked
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix, rotation_vector
from sunarc.sky.refraction import raised
from sunarc.sky.site import EARTH_RATE, Site, pole_enu
from sunarc.sky.sun import sun_directions

FloatArray = NDArray[np.float64]

CAMERA = small_camera()
COUNT = 12
KIND = np.repeat([Kind.SUN, Kind.STAR, Kind.MOON], [4, 6, 2])


def displaced(block: str, kind: NDArray[np.int64] = KIND) -> FloatArray:
    """Return the displacements (n, 2, s) of sightings of some kinds by one block."""
    seen = replace(observed(CAMERA, spread_directions(COUNT)), kind=kind, night=kind != Kind.SUN)
    problem = small_problem(CAMERA)
    found, shared = add_effects(problem, problem.unknowns([CAMERA]), seen)
    columns = {one.name: one.columns for one in found.blocks}
    return shared.systematic_px[..., columns.get(block, slice(0, 0))]


def test_bodies_have_kinds() -> None:
    names = np.array(["sun", "moon", "venus", "saturn", "star:HIP32349", "stated"])
    assert body_kinds(names).tolist() == [Kind.SUN, Kind.MOON, Kind.STAR, Kind.STAR, Kind.STAR, Kind.SUN]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_turns_are_those_of_a_camera_that_is_turned_about_east_north_and_up(axis: int) -> None:
    turn = np.radians(POSE_DIFFERENCE_DEG) * np.eye(3)[axis]
    # a camera turned by R(d) has the rotation from world to camera R_cam R(d)'
    turned = rotation_vector(rotation_matrix(CAMERA.rotation_cam_enu) @ rotation_matrix(tuple(turn)).T)
    directions = spread_directions(COUNT)
    expected = project(replace(CAMERA, rotation_cam_enu=turned), directions) - project(CAMERA, directions)
    found = displaced("night_pose")[..., axis]
    assert np.abs(expected).max() > 0.01
    np.testing.assert_allclose(found[4:], expected[4:], rtol=2e-3, atol=1e-5)
    np.testing.assert_allclose(found[:4], 0.0)


def test_stars_alone_are_displaced_outwards() -> None:
    found = displaced("night_offset")
    outwards = project(CAMERA, spread_directions(COUNT)) - np.array(CAMERA.principal_point_px)
    along = outwards / np.linalg.norm(outwards, axis=-1, keepdims=True)
    np.testing.assert_allclose(found[:4], 0.0)
    np.testing.assert_allclose(found[10:], 0.0)
    size = np.einsum("nak,na->nk", found[4:10], along[4:10])
    np.testing.assert_allclose(size[..., None] * along[4:10, None], np.moveaxis(found[4:10], 1, -1), atol=1e-12)
    radius = size[:, 0] / OFFSET_PX
    assert np.all((radius > 0.0) & (radius < 1.0))
    np.testing.assert_allclose(size[:, 1:3], OFFSET_PX * radius[:, None] ** [2, 3], rtol=1e-9)
    np.testing.assert_allclose(size[:, 3:], DECENTRED_PX * radius[:, None] ** 2 * along[4:10], rtol=1e-9)


@pytest.mark.parametrize("kind", [Kind.STAR, Kind.SUN])
def test_a_night_without_a_day_and_a_day_without_a_night_have_none(kind: Kind) -> None:
    for block in ("night_offset", "night_pose"):
        assert displaced(block, np.full(COUNT, kind)).shape == (COUNT, 2, 0)


SITE = Site(latitude=-33.0, longitude=20.0)
YEAR = 365.2422 * 86_400.0
DAY, SECONDS = 86_400.0, np.linspace(-4.0, 4.0, COUNT) * 3600.0


def of_days(clock_error_s: float) -> tuple[Sightings, dict[str, FloatArray]]:
    """Return sightings of two days, at the same places, and the displacements by their blocks."""
    towards = np.tile(spread_directions(COUNT), (2, 1))
    seen = replace(
        observed(CAMERA, towards),
        unix_s=np.concatenate([SECONDS, SECONDS + DAY]),
        day=np.repeat([3, 4], COUNT),
        clock_error_s=np.full(2 * COUNT, clock_error_s),
        refraction_sd=np.full((2 * COUNT, 1), 2e-4),
        motion=np.cross(towards, EARTH_RATE * pole_enu(SITE)),
    )
    problem = small_problem(CAMERA)
    found, shared = add_effects(problem, problem.unknowns([CAMERA]), seen)
    return seen, {one.name: shared.systematic_px[..., one.columns] for one in found.blocks}


def moved_by(change: Callable[[FloatArray], tuple[Camera, FloatArray]], towards: FloatArray) -> FloatArray:
    """Return by how much a changed camera sees changed directions elsewhere, (n, 2) px."""
    camera, directions = change(towards)
    return project(camera, directions) - project(CAMERA, towards)


def in_thicker_air(towards: FloatArray) -> tuple[Camera, FloatArray]:
    return CAMERA, raised(towards, np.full(len(towards), 2e-4))


def by_a_late_clock(towards: FloatArray) -> tuple[Camera, FloatArray]:
    turn = rotation_matrix(tuple(-EARTH_RATE * CLOCK_OFFSET_S * pole_enu(SITE)))
    return CAMERA, towards @ turn.T


def by_wide_pixels(towards: FloatArray) -> tuple[Camera, FloatArray]:
    fx, fy = CAMERA.focal_length_px
    stretch = 0.5 * WIDE_ASPECT * 0.5 * (fx + fy)
    return replace(CAMERA, focal_length_px=(fx + stretch, fy - stretch)), towards


@pytest.mark.parametrize(
    ("block", "column", "change"),
    [("air", 0, in_thicker_air), ("clock", 0, by_a_late_clock), ("pixels", 0, by_wide_pixels)],
)
def test_displacements_are_those_of_the_changed_world(
    block: str, column: int, change: Callable[[FloatArray], tuple[Camera, FloatArray]]
) -> None:
    seen, found = of_days(math.nan)
    expected = moved_by(change, seen.directions)
    assert np.max(np.abs(expected)) > 0.005
    tolerance = 0.01 * float(np.max(np.abs(expected)))  # they are linear
    np.testing.assert_allclose(found[block][:COUNT, :, column], expected[:COUNT], atol=tolerance)


def test_a_clock_of_which_nothing_is_stated_is_off_and_drifts_on_every_day_alike() -> None:
    _, found = of_days(math.nan)
    offset, drift = np.moveaxis(found["clock"], -1, 0)
    np.testing.assert_allclose(offset[:COUNT], offset[COUNT:], atol=1e-12)
    hours = np.tile(SECONDS, 2) / 3600.0
    np.testing.assert_allclose(drift, offset * (CLOCK_DRIFT_S_PER_H / CLOCK_OFFSET_S * hours)[:, None], atol=1e-12)


def test_a_stated_clock_drifts_within_its_bound() -> None:
    _, unknown = of_days(math.nan)
    _, stated = of_days(0.6)
    # 0.6 s within six hours
    np.testing.assert_allclose(stated["clock"], unknown["clock"][..., 1:] * 0.1 / CLOCK_DRIFT_S_PER_H, atol=1e-12)
    assert "clock" not in of_days(0.0)[1]


def test_what_the_clocks_of_days_have_in_common_is_no_difference_of_theirs() -> None:
    _, found = of_days(math.nan)
    np.testing.assert_allclose(np.sum(found["daily_clock"][..., :2], axis=-1), 0.0, atol=1e-12)
    np.testing.assert_allclose(found["daily_clock"][:COUNT, :, 0], 0.5 * found["clock"][:COUNT, :, 0], atol=1e-12)
    np.testing.assert_allclose(found["daily_clock"][:COUNT, :, 2], 0.5 * found["clock"][:COUNT, :, 1], atol=1e-12)


def grown(camera: Camera, share: float) -> Camera:
    """Return a camera whose focal length is larger by a share of itself."""
    x, y = camera.focal_length_px
    return replace(camera, focal_length_px=((1.0 + share) * x, (1.0 + share) * y))


def test_a_season_is_a_focal_length_that_was_another_before_the_last_sighting() -> None:
    towards = np.tile(spread_directions(COUNT), (6, 1))
    times = np.concatenate([SECONDS + 0.1 * part * YEAR for part in range(6)])
    seen = replace(observed(CAMERA, towards), unix_s=times, day=np.repeat(36 * np.arange(6), COUNT))
    problem = small_problem(CAMERA)
    found, shared = add_effects(problem, problem.unknowns([CAMERA]), seen)
    columns = {one.name: shared.systematic_px[..., one.columns] for one in found.blocks}
    changes = season_columns(times)
    np.testing.assert_allclose(changes[-1], 0.0, atol=1e-15)
    assert np.max(np.abs(changes[0])) == pytest.approx(2.0, rel=0.01)  # from summer to winter
    longer = grown(CAMERA, 0.001)
    by_share = (project(longer, towards) - project(CAMERA, towards)) / 0.001
    for name, share in SEASONS.items():
        expected = share * by_share[..., None] * changes[:, None]
        acts = np.max(np.abs(expected), axis=(0, 1)) > 1e-4
        np.testing.assert_allclose(columns[name], expected[..., acts], rtol=5e-3, atol=1e-6)


def test_a_week_has_no_season() -> None:
    assert not np.any(season_columns(np.linspace(0.0, 7.0 * DAY, 50)))
    assert not np.any(season_columns(np.array([np.nan, np.nan])))
    assert season_columns(np.zeros(0)).shape[0] == 0


def of_swaying_days(turns_deg: FloatArray) -> dict[str, FloatArray]:
    """Return the displacements by their blocks of sightings by a camera that is turned about north on each day."""
    towards, days = np.tile(spread_directions(COUNT), (len(turns_deg), 1)), np.repeat(np.arange(len(turns_deg)), COUNT)
    turned_by = np.radians(turns_deg)[days, None] * np.cross([0.0, 1.0, 0.0], towards)
    seen = replace(observed(CAMERA, towards), day=days, unix_s=np.tile(SECONDS, len(turns_deg)) + DAY * days)
    scatter = np.random.default_rng(5).normal(0.0, 0.02, seen.pixels.shape)
    seen = replace(seen, pixels=project(CAMERA, towards - turned_by) + scatter)
    problem = small_problem(CAMERA)
    found, shared = add_effects(problem, problem.unknowns([CAMERA]), seen)
    return {one.name: shared.systematic_px[..., one.columns] for one in found.blocks}


@pytest.mark.parametrize("turns_deg", [(0.3, -0.2, 0.1), (0.3, -0.2, 0.1, -0.3, 0.2, 0.0)])
def test_sways_are_turns_of_each_day_about_east_north_and_up(turns_deg: tuple[float, ...]) -> None:
    found = of_swaying_days(np.array(turns_deg))["sways"]
    assert found.shape == (len(turns_deg) * COUNT, 2, 3 * len(turns_deg))
    of_day = found.reshape(len(turns_deg), COUNT, 2, len(turns_deg), 3)
    for axis, unit in enumerate(np.eye(3)):
        turn = np.radians(SWAY_DEG) * np.cross(unit, spread_directions(COUNT))
        expected = project(CAMERA, spread_directions(COUNT) - turn) - project(CAMERA, spread_directions(COUNT))
        for day in range(len(turns_deg)):
            np.testing.assert_allclose(of_day[day, :, :, day, axis], expected, rtol=2e-2, atol=1e-4)
            assert not np.any(np.delete(of_day[day, :, :, :, axis], day, axis=2))


@pytest.mark.parametrize(
    "turns_deg", [(0.0,), (0.3, -0.3), (0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.4, 0.4), (0.4, 0.0, 0.0, 0.0)]
)
def test_one_day_two_days_days_alike_and_one_move_are_no_sways(turns_deg: tuple[float, ...]) -> None:
    assert "sways" not in of_swaying_days(np.array(turns_deg))


def test_detections_are_biased_along_the_radius_by_the_same_everywhere() -> None:
    seen, found = of_days(math.nan)
    outwards = seen.pixels - np.array(CAMERA.principal_point_px)
    along = outwards / np.linalg.norm(outwards, axis=-1, keepdims=True)
    np.testing.assert_allclose(found["outwards"][..., 0], USUAL_OPTIONS.outwards_px * along, atol=1e-9)


@pytest.mark.parametrize(("step_px", "expected_px"), [(1.0, 0.5), (4.0, 2.0), (0.25, 0.125), (0.01, 0.0), (0.0, 0.0)])
def test_suns_on_a_grid_are_all_displaced_by_half_a_step_each_way(step_px: float, expected_px: float) -> None:
    """The pixels of stars on no grid are neither displaced nor do they hide that of the sun's."""
    count = 40
    seen = observed(CAMERA, spread_directions(count))
    sun = np.arange(count) < 30
    pixels = np.where(sun[:, None], np.floor(seen.pixels / step_px) * step_px if step_px else seen.pixels, seen.pixels)
    seen = replace(seen, pixels=pixels, kind=np.where(sun, Kind.SUN, Kind.STAR))
    problem = small_problem(CAMERA)
    found, shared = add_effects(problem, problem.unknowns([CAMERA]), seen)
    columns = {one.name: one.columns for one in found.blocks}
    on_grid = shared.systematic_px[..., columns.get("grid", slice(0, 0))]
    if expected_px == 0.0:
        assert on_grid.size == 0
    else:
        np.testing.assert_allclose(on_grid[sun], np.broadcast_to(expected_px * np.eye(2), (30, 2, 2)), rtol=1e-6)
        assert not np.any(on_grid[~sun])


@pytest.mark.parametrize(("name", "least"), [("air", 3.0), ("pixels", 10.0), ("outwards", 10.0), ("sways", 40.0)])
def test_proof_takes_log_odds(name: str, least: float) -> None:
    assert proves(name, least + 0.1)
    assert not proves(name, least - 0.1)


@pytest.mark.parametrize("against", [100.0, 5.0])
def test_log_odds_and_those_before_the_sightings_make_the_probability(against: float) -> None:
    for odds, expected in ((-math.inf, 0.0), (0.0, 1 / (1 + against)), (math.log(against), 0.5), (900.0, 1.0)):
        assert probability(odds, odds_against=against) == pytest.approx(expected, abs=1e-12)


# Whole fits of what is not as assumed.


def fitted(
    camera: Camera, days: tuple[float, ...], *, drift_s_per_h: float | FloatArray = 0.0, clock_error_s: float
) -> Calibration:
    """Return the fit of clear days of a camera whose clock drifts about noon of each."""
    times = times_of(days, cadence_s=300.0)
    day, second = np.divmod(times + SGP.longitude * 240.0, DAY)
    drift = np.resize(drift_s_per_h, len(days))[np.unique(day, return_inverse=True)[1]]
    pixels = project(camera, sun_directions(times - drift * (second - 0.5 * DAY) / 3600.0, SGP))
    pixels += np.random.default_rng(7).normal(0.0, 0.05, pixels.shape)
    points = Sightings.of(unix_s=times, pixels=pixels, clock_error_s=clock_error_s)
    return calibrate(points, site=SGP, image_size=SIZE)


def error_px(found: Calibration, camera: Camera) -> tuple[float, float]:
    """Return the root mean squares over the sky of the true and of the stated error, px."""
    predicted, covariance = project_with_covariance(found, hemisphere(400))
    off = rms(predicted - project(camera, hemisphere(400)))
    return off, float(np.sqrt(np.mean(np.trace(covariance, axis1=1, axis2=2))))


def codes(found: Calibration) -> set[str]:
    return {finding.code for finding in found.verdict.findings}


FOUR_DAYS = (0.0, 1.0, 20.0, 29.0)
STRETCHED = replace(TRUTH, focal_length_px=(1.015 * TRUTH.focal_length_px[0], 0.985 * TRUTH.focal_length_px[1]))


def test_pixels_that_are_not_square_are_proven_and_taken_out() -> None:
    found = fitted(STRETCHED, FOUR_DAYS, clock_error_s=0.01)
    assert "pixels_not_square" in codes(found)
    error, stated = error_px(found, STRETCHED)
    assert 0.001 < error < 1.6 * stated < 0.3


def test_one_day_of_pixels_that_are_not_square_states_what_it_does_not_know() -> None:
    found = fitted(STRETCHED, (0.0,), clock_error_s=0.01)
    error, stated = error_px(found, STRETCHED)
    assert 0.05 < error < 1.6 * stated < 6.0


def test_a_drift_that_no_sighting_shows_is_within_what_is_stated() -> None:
    drifting = fitted(TRUTH, FOUR_DAYS, drift_s_per_h=0.4, clock_error_s=math.nan)
    assert "clock_drifts" not in codes(drifting)
    error, stated = error_px(drifting, TRUTH)
    assert 0.03 < error < 1.6 * stated < 0.4


def test_a_clock_that_differs_from_day_to_day_is_proven() -> None:
    found = fitted(TRUTH, FOUR_DAYS, drift_s_per_h=np.array([0.0, 1.0, -1.0, 0.5]), clock_error_s=0.0)
    assert "clock_drifts" in codes(found)
    error, stated = error_px(found, TRUTH)
    assert 0.001 < error < 1.6 * stated < 0.6


def test_where_nothing_is_wrong_nothing_is_proven() -> None:
    found = fitted(TRUTH, FOUR_DAYS, clock_error_s=0.01)
    assert not codes(found) & {
        "pixels_not_square",
        "clock_drifts",
        "detections_biased",
        "mount_sways",
        "mount_turns",
        "picture_changed",
    }
    assert found.evidence.pose_spread_deg is None
    error, stated = error_px(found, TRUTH)
    assert 0.001 < error < 1.6 * stated < 0.3


@pytest.mark.parametrize("share", [0.0, 3e-4, 1e-3, 2e-3])
def test_a_focal_length_that_follows_the_season_is_taken_out_and_the_camera_is_that_of_now(share: float) -> None:
    days = tuple(np.arange(0.0, 365.0, 21.0).tolist())
    times = times_of(days, cadence_s=900.0)
    change = share * np.cos(2.0 * np.pi * (times - times[0]) / YEAR + 0.4)
    at_once = project(TRUTH, sun_directions(times, SGP))
    longer = grown(TRUTH, 0.001)
    pixels = at_once + change[:, None] * (project(longer, sun_directions(times, SGP)) - at_once) / 0.001
    pixels += np.random.default_rng(9).normal(0.0, 0.1, pixels.shape)
    found = calibrate(Sightings.of(unix_s=times, pixels=pixels), site=SGP, image_size=SIZE)
    assert found.verdict.accepted, found.verdict.reasons
    assert ("focal_length_changes" in codes(found)) == (share > 0.0)
    assert found.evidence.log_odds.get("season_share", 0.0) == pytest.approx(np.ptp(change), rel=0.3)
    error, stated = error_px(found, grown(TRUTH, float(change[-1])))
    assert 0.001 < error < 1.6 * stated < 0.5


def by_days(turns_deg: FloatArray, *, sigma_px: float = 0.05, alike: float = 0.0) -> Calibration:
    """Return the fit of days on each of which the mount stands turned; neighbours err alike by a share."""
    rng, fitted_days = np.random.default_rng(8), []
    for day, turn in enumerate(np.radians(turns_deg)):
        times = times_of((float(day),), cadence_s=300.0)
        rotation = rotation_vector(rotation_matrix(TRUTH.rotation_cam_enu) @ rotation_matrix(tuple(turn)).T)
        noise = rng.normal(0.0, sigma_px, (times.size, 2))
        for row in range(1, times.size):
            noise[row] = alike * noise[row - 1] + math.sqrt(1.0 - alike**2) * noise[row]
        pixels = project(replace(TRUTH, rotation_cam_enu=rotation), sun_directions(times, SGP)) + noise
        fitted_days.append(Sightings.of(unix_s=times, pixels=pixels, clock_error_s=0.01))
    return calibrate(stacked(fitted_days), site=SGP, image_size=SIZE)


@pytest.mark.parametrize(("scale", "shift_px"), [(1.002, 0.0), (1.0, 1.0), (0.997, 3.0)])
def test_a_picture_that_is_scaled_or_cropped_between_days_is_named_and_the_camera_is_that_of_now(
    scale: float, shift_px: float
) -> None:
    times = times_of(FOUR_DAYS, cadence_s=300.0)
    pixels = project(TRUTH, sun_directions(times, SGP))
    late = times > np.mean([times[0], times[-1]])
    centre = np.array(TRUTH.principal_point_px)
    pixels[~late] += (scale - 1.0) * (pixels[~late] - centre) + shift_px * np.array([0.8, -0.6])
    pixels += np.random.default_rng(11).normal(0.0, 0.05, pixels.shape)
    found = calibrate(Sightings.of(unix_s=times, pixels=pixels, clock_error_s=0.01), site=SGP, image_size=SIZE)
    assert found.verdict.accepted, found.verdict.reasons
    named = next(finding.data for finding in found.verdict.findings if finding.code == "picture_changed")
    assert named["scale"] == pytest.approx(scale, abs=2e-4)
    assert named["shift_px"] == pytest.approx(shift_px, abs=0.2)
    assert named["since"] == "2013-06-02"
    error, stated = error_px(found, TRUTH)
    assert 0.001 < error < 1.6 * stated < 0.4


def test_a_camera_that_is_turned_between_days_has_the_same_picture() -> None:
    times = times_of(FOUR_DAYS, cadence_s=300.0)
    towards = sun_directions(times, SGP)
    early = times < np.mean([times[0], times[-1]])
    turned = towards - np.radians(0.1) * early[:, None] * np.cross([0.48, 0.6, 0.64], towards)
    pixels = project(TRUTH, turned) + np.random.default_rng(13).normal(0.0, 0.05, (len(times), 2))
    found = calibrate(Sightings.of(unix_s=times, pixels=pixels, clock_error_s=0.01), site=SGP, image_size=SIZE)
    assert "picture_changed" not in codes(found)


@pytest.mark.parametrize(
    ("days", "deg_per_h", "sway_deg"), [(FOUR_DAYS, 0.03, 0.0), (FOUR_DAYS, 0.0, 0.3), (FOUR_DAYS[:1], 0.05, 0.0)]
)
def test_a_mount_that_turns_with_the_sun_is_named_and_its_noon_within_what_is_stated(
    days: tuple[float, ...], deg_per_h: float, sway_deg: float
) -> None:
    times = times_of(days, cadence_s=300.0)
    hours = np.mod(times + SGP.longitude * 240.0, DAY) / 3600.0 - 12.0
    angle = np.radians(deg_per_h * hours + sway_deg * np.sin(hours * np.pi / 12.0))
    towards = sun_directions(times, SGP)
    axis = np.array([0.48, 0.6, 0.64])
    pixels = project(TRUTH, towards - angle[:, None] * np.cross(axis, towards))
    pixels += np.random.default_rng(12).normal(0.0, 0.05, pixels.shape)
    found = calibrate(Sightings.of(unix_s=times, pixels=pixels, clock_error_s=0.01), site=SGP, image_size=SIZE)
    assert found.verdict.accepted, found.verdict.reasons
    assert codes(found) & {"mount_turns", "mount_may_turn"}
    if "mount_turns" in codes(found) and len(days) > 1:
        assert found.evidence.pose_spread_deg is not None
        assert np.linalg.norm(found.evidence.pose_spread_deg) == pytest.approx(np.degrees(np.std(angle)), rel=0.6)
    error, stated = error_px(found, TRUTH)
    assert 0.001 < error < 1.6 * stated < 5.0


SWAYS_DEG = 0.05 * np.random.default_rng(4).normal(size=(5, 3))
SETTLES_DEG = np.exp(-np.arange(5.0) / 2.0)[:, None] * np.array([0.15, -0.1, 0.08])


@pytest.mark.parametrize("turns_deg", [SWAYS_DEG, SETTLES_DEG])
def test_a_mount_that_sways_or_settles_is_proven_and_its_next_pose_within_what_is_stated(turns_deg: FloatArray) -> None:
    found = by_days(turns_deg, alike=0.9)
    assert found.verdict.accepted, found.verdict.reasons
    assert found.evidence.log_odds["sways"] > 40.0
    spread = found.evidence.pose_spread_deg
    assert spread is not None
    named = next(finding for finding in found.verdict.findings if finding.code == "mount_sways")
    assert [named.data[f"{axis}_deg"] for axis in ("east", "north", "up")] == list(spread)
    np.testing.assert_allclose(spread, np.maximum(np.std(turns_deg, axis=0), 0.02), rtol=0.6)
    last = rotation_matrix(TRUTH.rotation_cam_enu) @ rotation_matrix(tuple(np.radians(turns_deg[-1]))).T
    error, stated = error_px(found, replace(TRUTH, rotation_cam_enu=rotation_vector(last)))
    assert error < 1.6 * stated < 3.0


def test_noise_that_is_alike_for_hours_is_not_called_sways() -> None:
    assert "mount_sways" not in codes(by_days(np.zeros((4, 3)), sigma_px=0.1, alike=0.95))
