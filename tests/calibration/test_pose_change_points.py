"""Sightings of a camera that was moved meanwhile: when, by how much, and a pose for either side."""

from __future__ import annotations

import csv
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from real_like_tracks import real_like_track
from scipy.spatial.transform import Rotation
from tests.fixtures.finding_codes import codes

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.pose_change import pose_before
from sunarc.calibration.model.sightings import Sightings
from sunarc.changes.record import calibrate_moved
from sunarc.common.array_types import stacked
from sunarc.formats.calibration_document import from_document, to_document
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix, rotation_vector
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions

if TYPE_CHECKING:
    from tests.fixtures.clear_day import Simulated, Simulator

SIZE = (1748, 1748)
REAL = Path(__file__).parents[3] / "shared" / "real" / "fe4_2016-08-30.csv"


def turned(camera: Camera, degrees: float) -> Camera:
    turn = Rotation.from_rotvec(np.radians(degrees) * np.array([0.8, 0.5, -0.33])).as_matrix()
    return replace(camera, rotation_cam_enu=rotation_vector(turn @ rotation_matrix(camera.rotation_cam_enu)))


def moved_after(share: float, first: Simulated, second: Simulated) -> Sightings:
    """Take the first camera's sightings up to a share of them, then the second's."""
    later = np.arange(len(first.points)) >= share * len(first.points)
    return replace(first.points, pixels=np.where(later[:, None], second.points.pixels, first.points.pixels))


@pytest.mark.parametrize("degrees", [0.1, 2.0])
def test_a_move_within_a_day_is_dated_to_the_sighting_and_both_sides_get_their_pose(
    simulator: Simulator, degrees: float
) -> None:
    before = simulator()
    after = simulator(turned(before.camera, degrees), seed=2)
    points = moved_after(0.6, before, after)
    calibration, parted = calibrate_moved(points, site=before.site, image_size=SIZE)
    assert calibration.verdict.accepted, calibration.verdict.reasons
    (move,) = calibration.evidence.moves
    row = int(np.ceil(0.6 * len(points)))
    assert move.bracket == (points.unix_s[row - 1], points.unix_s[row])
    assert np.array_equal(parted.epoch, np.arange(len(points)) >= row)
    assert after.sky_error_px(calibration.camera) < 0.3
    ended = pose_before(calibration.camera.rotation_cam_enu, move.rotation_deg)
    assert before.sky_error_px(replace(calibration.camera, rotation_cam_enu=ended)) < 0.3
    assert "pose_changed" in codes(calibration.verdict.findings)


@pytest.mark.parametrize("days", [(0.0, 1.0), (0.0, 6.0)])
def test_a_move_at_night_is_found_between_the_days(simulator: Simulator, days: tuple[float, ...]) -> None:
    first = simulator(days=days, cadence_s=300.0)
    second = simulator(turned(first.camera, 0.5), days=days, cadence_s=300.0, seed=2)
    night = (int(np.argmax(np.diff(first.points.unix_s))) + 1) / len(first.points)
    (move,) = calibrate_moved(moved_after(night, first, second), site=first.site, image_size=SIZE)[0].evidence.moves
    assert 6.0 < (move.bracket[1] - move.bracket[0]) / 3600.0 - 24.0 * (days[1] - 1.0) < 14.0
    assert move.turn_deg == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize("step_s", [18.0])
def test_a_clock_that_steps_between_two_days_is_named_and_refused(simulator: Simulator, step_s: float) -> None:
    seen = simulator(days=(0.0, 1.0, 15.0, 29.0), cadence_s=300.0)
    late = seen.points.unix_s > seen.points.unix_s[0] + 10.0 * 86_400.0
    points = replace(seen.points, unix_s=seen.points.unix_s + step_s * late)
    found, _ = calibrate_moved(points, site=seen.site, image_size=SIZE)
    assert not found.verdict.accepted
    (named,) = (one.data for one in found.verdict.findings if one.code == "clock_changed")
    assert float(named["step_s"]) == pytest.approx(step_s, abs=3.0)
    assert "pose_changed" not in codes(found.verdict.findings)
    assert [move.cause for move in found.evidence.moves] == ["clock"]


@pytest.mark.parametrize("moved", [True, False])
def test_stars_of_the_night_after_a_move_are_of_the_pose_after_it(simulator: Simulator, *, moved: bool) -> None:
    first = simulator(cadence_s=300.0)
    second = simulator(turned(first.camera, 1.0 * moved), cadence_s=300.0, seed=2)
    sun, towards = moved_after(0.4, first, second), hemisphere(60)[:45]
    stars = Sightings.of(
        unix_s=sun.unix_s[-1] + 21_600.0 + np.zeros(len(towards)),
        pixels=project(second.camera, towards) + np.random.default_rng(3).normal(0.0, 0.2, (len(towards), 2)),
        directions=towards,
        sigma_px=0.2,
        body=np.full(len(towards), "star:HIP1"),
    )
    points = stacked([replace(sun, sigma_px=np.full(len(sun), 0.2)), stars])
    calibration, parted = calibrate_moved(points, site=first.site, image_size=SIZE)
    assert calibration.verdict.accepted, calibration.verdict.reasons
    assert len(calibration.evidence.moves) == moved
    assert np.all(parted.epoch[len(sun) :] == moved)
    assert second.sky_error_px(calibration.camera) < 0.3


def test_cloud_and_a_camera_that_stood_still_are_no_move(simulator: Simulator) -> None:
    seen = simulator(days=(0.0, 2.0), cadence_s=300.0)
    rng = np.random.default_rng(7)
    covered = (np.arange(len(seen.points)) % 60) < 12
    pixels = seen.points.pixels + covered[:, None] * (
        np.array([3.0, -2.0]) + rng.standard_t(2.0, (len(seen.points), 2))
    )
    assert calibrate_moved(seen.points, site=seen.site, image_size=SIZE)[0].evidence.moves == ()
    points = replace(seen.points, pixels=pixels)
    assert calibrate_moved(points, site=seen.site, image_size=SIZE)[0].evidence.moves == ()


def test_cloud_that_draws_a_real_like_track_aside_is_no_move() -> None:
    # two episodes and whole pixels: by the robust cost alone, two poses are better by far
    track = real_like_track(71)
    solved, points = calibrate_moved(track.points, site=track.site, image_size=track.image_size, options=track.options)
    assert solved.evidence.moves == ()
    assert not np.any(points.epoch)


def test_a_step_is_likelier_than_cloud_only_where_the_pose_stays(simulator: Simulator) -> None:
    before = simulator(cadence_s=300.0, sigma_px=0.3)
    after = simulator(turned(before.camera, 0.4), cadence_s=300.0, sigma_px=0.3, seed=2)
    points = moved_after(0.5, before, after)
    share = np.clip((np.arange(len(points)) / len(points) - 0.5) / 0.1, 0.0, 1.0)
    aside = before.points.pixels + (4.0 * np.sin(np.pi * share))[:, None] * np.array([0.8, -0.6])
    (move,) = calibrate_moved(points, site=before.site, image_size=SIZE)[0].evidence.moves
    assert move.turn_deg == pytest.approx(0.4, abs=0.1)
    clouded = replace(before.points, pixels=aside)
    assert calibrate_moved(clouded, site=before.site, image_size=SIZE)[0].evidence.moves == ()


def test_a_jump_in_an_arc_too_short_for_any_fit_is_refused_like_the_arc(simulator: Simulator) -> None:
    first = simulator(cadence_s=30.0)
    second = simulator(turned(first.camera, 2.0), cadence_s=30.0, seed=2)
    points = moved_after(0.5, first, second).select(slice(len(first.points) // 2 - 36, len(first.points) // 2 + 36))
    calibration, _ = calibrate_moved(points, site=first.site, image_size=SIZE)
    assert not calibration.verdict.accepted
    assert calibration.evidence.moves == ()
    assert calibration.verdict.findings[0].code == "arc_too_short"


def test_a_document_tells_the_moves(simulator: Simulator) -> None:
    first = simulator(cadence_s=300.0)
    second = simulator(turned(first.camera, 1.0), cadence_s=300.0, seed=2)
    calibration, _ = calibrate_moved(moved_after(0.5, first, second), site=first.site, image_size=SIZE)
    now = datetime.fromisoformat("2026-01-01T00:00:00+00:00")
    document = to_document(
        calibration,
        id="a",
        camera="roof",
        state="candidate",
        created_at=now,
        valid_from=now,
        valid_until=None,
        pose_epoch="",
        software_version="0",
    )
    assert calibration.evidence.moves
    for read, made in zip(from_document(document).evidence.moves, calibration.evidence.moves, strict=True):
        assert (read.time, read.bracket, read.cause) == (made.time, made.bracket, made.cause)
        np.testing.assert_allclose(read.rotation_deg, made.rotation_deg, atol=1e-9)
    # the fit with the move is held against parts of its sightings, too, and the document says so
    assert calibration.evidence.held_out["n"] > 0
    assert from_document(document).evidence.held_out == calibration.evidence.held_out


@pytest.mark.real
@pytest.mark.skipif(not REAL.exists(), reason="the real sun tracks are not beside the repository")
def test_the_half_of_a_real_track_that_is_turned_gets_its_own_pose() -> None:
    with REAL.open() as file:
        rows = list(csv.DictReader(file))
    times = np.array([datetime.fromisoformat(row["time_utc"]).timestamp() for row in rows])
    points = Sightings.of(unix_s=times, pixels=np.array([[float(row["x_px"]), float(row["y_px"])] for row in rows]))
    site = Site(latitude=54.495866, longitude=11.237683, altitude=9.0)
    options = CalibrationOptions(projection="equidistant")
    still = calibrate(points, site=site, image_size=(1920, 1920), options=options)
    track = sun_directions(times, site)
    apart = project(turned(still.camera, 1.0), track) - project(still.camera, track)
    later = np.arange(times.size) >= 240
    points = replace(points, pixels=points.pixels + later[:, None] * apart)
    (move,) = calibrate_moved(points, site=site, image_size=(1920, 1920), options=options)[0].evidence.moves
    assert move.bracket == (times[239], times[240])
    assert move.turn_deg == pytest.approx(1.0, abs=0.2)
