"""Where residuals jump: lines through either side of a gap, nights, and the row of a step, by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.calibration import filtered_sightings, small_camera, stated_calibration, sun_arc

from sunarc.calibration.answers.error_model import rotated
from sunarc.calibration.model.pose_change import PoseChange
from sunarc.calibration.model.sightings import Sightings
from sunarc.changes import record as module
from sunarc.changes.daily_rotations import DailyRotations
from sunarc.changes.record import best_row
from sunarc.optics.forward import project

FloatArray = NDArray[np.float64]


def _usable(unix_s: FloatArray, *, day: NDArray[np.int64] | None = None) -> Sightings:
    directions = sun_arc(unix_s.size)
    return filtered_sightings(unix_s, project(small_camera(), directions), directions, day=day)


def _noise(n: int, *, sigma: float = 0.05, seed: int = 1) -> FloatArray:
    return np.random.default_rng(seed).normal(0.0, sigma, (n, 2))


def test_lines_of_one_slope_miss_one_another_by_the_jump() -> None:
    time = 60.0 * np.arange(24.0)
    residual = np.outer(time, [0.002, -0.001])
    residual[12:] += [0.3, 0.4]
    miss, scatter = module.line_misses(residual, time)
    assert miss.shape == scatter.shape == (1,)
    assert miss[0] == pytest.approx(0.5)
    assert scatter[0] == pytest.approx(0.0, abs=1e-9)


def test_the_scatter_about_the_lines_is_that_of_the_noise() -> None:
    time = 60.0 * np.arange(400.0)
    miss, scatter = module.line_misses(_noise(400, sigma=0.2), time)
    assert np.median(scatter) == pytest.approx(0.2, rel=0.3)
    # 1-sigma per axis of a jump where there is none, in that of a sighting
    assert np.median(miss) / 1.1774 / 0.2 == pytest.approx(0.8, rel=0.4)


def test_a_jump_within_a_day_is_suggested_where_it_is() -> None:
    residual = _noise(200)
    residual[90:] += [0.4, -0.3]
    found = module.jumps_within_days(residual, _usable(60.0 * np.arange(200.0)))
    assert 1 <= len(found) <= 3
    assert abs(found[0][0] - 90) <= 2
    assert found[0][1] == 0.0


def test_noise_and_smooth_errors_suggest_no_jump() -> None:
    usable = _usable(60.0 * np.arange(200.0))
    wave = 0.5 * np.sin(np.arange(200.0) / 30.0)[:, None] * np.array([1.0, -1.0])
    assert module.jumps_within_days(_noise(200), usable) == []
    assert module.jumps_within_days(_noise(200) + wave, usable) == []
    assert module.jumps_within_days(_noise(20), _usable(60.0 * np.arange(20.0))) == []


def test_a_jump_over_a_gap_of_hours_is_none() -> None:
    times = 60.0 * np.arange(200.0)
    times[100:] += 4.0 * 3600.0
    residual = _noise(200)
    residual[100:] += 1.0
    found = module.jumps_within_days(residual, _usable(times))
    assert all(abs(row - 100) > 6 for row, _ in found)


def _days(count: int, *, per_day: int = 60) -> tuple[FloatArray, NDArray[np.int64]]:
    day = np.repeat(np.arange(count), per_day)
    times = 86_400.0 * day + 600.0 * np.tile(np.arange(per_day), count)
    return times.astype(np.float64), day


def test_a_move_at_night_stands_out_from_the_other_nights() -> None:
    times, day = _days(5)
    residual = _noise(times.size)
    residual[day >= 3] += [0.5, 0.5]
    found = module.night_changes(residual, _usable(times, day=day))
    assert found == [(180, 0.05)]


def test_nights_that_are_alike_suggest_nothing() -> None:
    times, day = _days(5)
    assert module.night_changes(_noise(times.size), _usable(times, day=day)) == []
    assert module.night_changes(_noise(60), _usable(times[:60], day=day[:60])) == []


def test_the_same_hours_of_two_days_differ_by_the_move() -> None:
    times, day = _days(2)
    residual = _noise(120, sigma=1e-6)
    residual[day == 1] += [0.3, 0.4]
    rows = [np.flatnonzero(day == d) for d in (0, 1)]
    assert module.same_hours_difference(residual, _usable(times, day=day), *rows) == pytest.approx(0.5, rel=1e-3)
    few = [rows[0], rows[1][:15]]
    assert math.isnan(module.same_hours_difference(residual, _usable(times, day=day), *few))


@pytest.mark.parametrize("row", [25, 40, 55])
def test_the_row_of_a_step_is_found_by_the_cameras_of_either_side(row: int) -> None:
    camera = small_camera()
    after = rotated(camera, np.radians([0.5, 0.3, 0.0]))
    usable = _usable(60.0 * np.arange(80.0))
    late = np.arange(80)[:, None] >= row
    pixels = np.where(late, project(after, usable.directions), project(camera, usable.directions)) + _noise(80)
    moved = replace(usable, pixels=pixels)
    assert best_row(slice(0, 80), moved, [camera, after]) == row
    assert best_row(slice(20, 60), moved, [camera, after]) == row


def test_what_two_poses_take_from_the_squares_is_in_variances() -> None:
    usable = _usable(60.0 * np.arange(100.0))
    after = _noise(100, sigma=0.1)
    before = after.copy()
    before[50:] += 0.1
    solved = stated_calibration(small_camera())
    gain = module.robust_gain(before, after, usable, solved)
    # 50 sightings off by one sigma in each axis: about 100, less by the loss's bend
    assert 50.0 < gain < 130.0
    inflated = replace(solved, evidence=replace(solved.evidence, inflation=4.0))
    assert module.robust_gain(before, after, usable, inflated) == pytest.approx(gain / 4.0)
    assert module.robust_gain(after, after, usable, solved) == 0.0


def _daily(turn_deg: FloatArray) -> DailyRotations:
    n = len(turn_deg)
    covariance = np.broadcast_to(1e-5 * np.eye(3), (n, 3, 3))
    return DailyRotations(day=np.arange(100.0, 100.0 + n), rotation_deg=turn_deg, covariance_deg2=covariance)


def test_places_are_about_the_clearest_step_and_none_without() -> None:
    rng = np.random.default_rng(1)
    turns = rng.normal(0.0, 0.003, (30, 3))
    turns[12:, 2] += 0.4
    assert module.step_spans(_daily(turns)) == [(100 + 12 - 3, 100 + 12 + 2)]
    assert module.step_spans(_daily(rng.normal(0.0, 0.003, (30, 3)))) == []
    assert module.step_spans(_daily(np.zeros((0, 3)))) == []


def test_steps_that_overlap_one_another_count_once() -> None:
    steps = [
        PoseChange(time=after, bracket=(before, after), rotation_deg=np.array([0.0, 0.3, 0.0]), cause="moved")
        for before, after in ((10.0, 20.0), (15.0, 25.0), (20.0, 30.0))
    ]
    assert module.distinct_steps(steps) == [steps[0], steps[2]]
    assert module.distinct_steps([]) == []


@pytest.mark.parametrize(("row", "expected"), [(1, (100, 103)), (29, (126, 129))])
def test_places_near_an_end_of_the_record_begin_or_end_with_it(row: int, expected: tuple[int, int]) -> None:
    turns = np.random.default_rng(2).normal(0.0, 0.003, (30, 3))
    turns[row:, 2] += 0.4
    assert module.step_spans(_daily(turns))[0] == expected


@pytest.mark.parametrize("late_s", [0.0, 200.0, 400.0])
def test_the_same_hours_are_those_of_the_nearest_sighting_of_the_day_before(late_s: float) -> None:
    times, day = _days(2)
    times[day == 1] += late_s
    rows = [np.flatnonzero(day == d) for d in (0, 1)]
    own = np.random.default_rng(4).uniform(-5.0, 5.0, (60, 2))
    residual = np.concatenate([own, np.zeros((60, 2))])
    nearest = np.argmin(np.abs((times[rows[1]] - 86_400.0)[:, None] - times[rows[0]]), axis=1)
    residual[rows[1]] = own[nearest] + [0.3, 0.4]
    assert module.same_hours_difference(residual, _usable(times, day=day), *rows) == pytest.approx(0.5, rel=1e-6)
