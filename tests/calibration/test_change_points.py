"""Moves within a record: each number by its definition written out, and the search with fits that are known."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.fixtures.calibration import SGP, filtered_sightings, small_camera, stated_calibration, sun_arc
from tests.fixtures.stored_answers import require_stored

from sunarc.calibration.answers.error_model import rotated
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.changes import record as module
from sunarc.changes import step_evidence
from sunarc.changes.record import calibrate_moved
from sunarc.changes.step_evidence import log_bayes_factor
from sunarc.common.array_types import FloatArray, IntArray
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.sky.sun import sun_directions

NOON = 1_368_403_200.0 + 43_200.0 + 97.484856 * 240.0
"""13 May 2013, local mean solar noon at SGP."""


def usable(unix_s: FloatArray, *, day: IntArray | None = None) -> Sightings:
    directions = sun_arc(unix_s.size)
    return filtered_sightings(unix_s, project(small_camera(), directions), directions, day=day)


def uneven(rng: np.random.Generator, count: int, *, step_s: float = 120.0) -> FloatArray:
    return np.cumsum(step_s * rng.uniform(0.5, 1.5, count))


def lines_by_hand(residual: FloatArray, time: FloatArray) -> list[tuple[float, float]]:
    """Return miss and scatter of the lines of 12 sightings before and 12 after each gap."""
    found = []
    for k in range(len(time) - 23):
        sides = [np.arange(k, k + 12), np.arange(k + 12, k + 24)]
        slopes = [
            np.median([(residual[s[i + 6]] - residual[s[i]]) / (time[s[i + 6]] - time[s[i]]) for i in range(6)], axis=0)
            for s in sides
        ]
        shared, gap = (slopes[0] + slopes[1]) / 2.0, (time[k + 11] + time[k + 12]) / 2.0
        levels = [np.array([residual[i] - shared * (time[i] - gap) for i in s]) for s in sides]
        ends = [np.median(level, axis=0) for level in levels]
        scatter = [
            float(np.median([math.dist(one, end) for one in level])) / 1.1774
            for level, end in zip(levels, ends, strict=True)
        ]
        found.append((math.dist(*ends), min(scatter)))
    return found


def test_lines_before_and_after_a_gap_are_medians_of_slopes_and_levels() -> None:
    rng = np.random.default_rng(1)
    residual, time = rng.standard_t(3.0, (50, 2)), uneven(rng, 50)
    miss, scatter = module.line_misses(residual, time)
    np.testing.assert_allclose(np.stack([miss, scatter], axis=-1), lines_by_hand(residual, time), rtol=1e-9)


def jumps_by_hand(residual: FloatArray, some: Sightings) -> list[int]:
    """Return the rows of up to three jumps of more than 4 sigmas, the clearest first, each 12 rows from the others."""
    time = some.unix_s
    lines = lines_by_hand(residual, time)
    least = max(float(np.median([miss for miss, _ in lines])) / 1.1774, 1e-3)
    scores = {}
    for k, (miss, scatter) in enumerate(lines):
        rows = slice(k, k + 24)
        one_run = len(set(zip(some.day[rows].tolist(), some.epoch[rows].tolist(), strict=True))) == 1
        if one_run and time[k + 23] - time[k] <= 7200.0:
            scores[k] = miss / max(0.8 * scatter, least)
    found: list[int] = []
    while len(found) < 3 and max(scores.values(), default=0.0) > 4.0:
        best = max(scores, key=lambda k: scores[k])
        found.append(best + 12)
        scores = {k: score for k, score in scores.items() if abs(k - best) > 12}
    return found


def test_jumps_are_where_lines_miss_one_another_by_four_sigmas() -> None:
    rng, counts = np.random.default_rng(3), []
    for k in range(10):
        n = 130
        time = uneven(rng, n, step_s=rng.uniform(100.0, 400.0))
        residual = rng.normal(0.0, 0.05, (n, 2)) + 0.1 * np.sin(time / 9000.0)[:, None]
        for row in (18 + k, 45, 80, 110):
            residual[row:] += rng.normal(0.0, 0.3, 2)
        some = replace(usable(time), day=(np.arange(n) > 60 + k).astype(np.int64), epoch=(np.arange(n) > 124) * 1)
        found = module.jumps_within_days(residual, some)
        assert [row for row, _ in found] == jumps_by_hand(residual, some)
        counts.append(len(found))
    assert {0, 1, 2} <= set(counts)


@pytest.mark.parametrize(("jump_px", "found"), [(0.0035, []), (0.0048, [20])])
def test_a_jump_of_four_thousandths_of_a_pixel_is_the_smallest(jump_px: float, found: list[int]) -> None:
    residual = 1e-9 * np.random.default_rng(2).standard_normal((120, 2))
    residual[20:, 0] += jump_px
    assert [row for row, _ in module.jumps_within_days(residual, usable(60.0 * np.arange(120.0)))][:1] == found


def nights(*differences: float) -> tuple[FloatArray, Sightings]:
    """Return residuals that differ so from a day to the next, and 30 sightings of each."""
    count = len(differences) + 1
    day = np.repeat(np.arange(count), 30)
    time = 86_400.0 * day + 600.0 * np.tile(np.arange(30.0), count)
    level = np.cumsum([0.0, *differences])[day]
    return np.stack([0.6 * level, 0.8 * level], axis=-1), usable(time, day=day)


@pytest.mark.parametrize(
    ("differences", "rows"),
    [
        ((1.0, 1.0, 1.9, 1.0), []),
        ((1.0, 1.0, 2.1, 1.0), [90]),
        ((1.0, 1.0, 1.5), []),
        ((1.0, 1.1), [60]),  # of two nights none is usual
        ((1.2, 1.1), [30]),
        ((0.0009,), []),
        ((0.0011,), [30]),
    ],
)
def test_a_night_stands_out_by_twice_the_usual(differences: tuple[float, ...], rows: list[int]) -> None:
    residual, some = nights(*differences)
    assert module.night_changes(residual, some) == [(r, 0.05) for r in rows]
    # a night between two poses is known already
    known = replace(some, epoch=(np.arange(len(some)) >= 30).astype(np.int64))
    assert all(row != 30 for row, _ in module.night_changes(residual, known))


def same_hours_by_hand(residual: FloatArray, some: Sightings, early: IntArray, late: IntArray) -> float:
    begin = some.unix_s[early[0]]
    hours = {int(row): float(some.unix_s[row] - begin) % 86_400.0 for row in (*early, *late)}
    differences = []
    for row in late.tolist():
        nearest = min(early.tolist(), key=lambda other: abs(hours[other] - hours[row]))
        if abs(hours[nearest] - hours[row]) < 600.0:
            differences.append(residual[row] - residual[nearest])
    if len(late) < 20 or len(differences) < 20:
        return math.nan
    parts = np.array_split(np.array(differences), len(differences) // 10)
    return math.sqrt(np.mean([np.sum(np.median(part, axis=0) ** 2) for part in parts]))


def test_the_same_hours_are_compared_by_medians_of_tens() -> None:
    rng, known = np.random.default_rng(5), []
    for _ in range(40):
        counts = rng.integers(15, 60, 2)
        some = [np.sort(rng.uniform(0.0, 36_000.0, n)) for n in counts]
        time = np.r_[some[0], some[1] + 86_400.0 + rng.uniform(-4000.0, 4000.0)]
        early, late = np.arange(counts[0]), counts[0] + np.arange(counts[1])
        residual = rng.standard_normal((time.size, 2))
        found = module.same_hours_difference(residual, usable(time), early, late)
        expected = same_hours_by_hand(residual, usable(time), early, late)
        assert found == pytest.approx(expected, rel=1e-9, nan_ok=True)
        known.append(math.isfinite(expected))
    assert 10 < sum(known) < 38


def test_rows_of_groups_have_the_variance_of_medians_and_of_gross_errors() -> None:
    rng = np.random.default_rng(8)
    member = np.repeat(np.arange(30), rng.integers(1, 6, 30))
    n = member.size
    some = replace(usable(uneven(rng, n)), sigma_px=rng.uniform(0.5, 2.0, n))
    residual = rng.normal(0.0, 0.2, (n, 2))
    residual[member == 9] += [6.0, -3.0]
    picked, row = np.arange(n), int(np.flatnonzero(member == 14)[0])
    rows = step_evidence.step_rows(picked, member, row, some, residual)
    groups = [np.flatnonzero(member == k) for k in range(30)]
    medians = np.array([np.median(residual[g], axis=0) for g in groups])
    middle = [int(g[0]) + len(g) // 2 for g in groups]
    relative, time = some.sigma_px[middle], some.unix_s[middle]
    padded = np.concatenate([medians[4:0:-1], medians, medians[-2:-6:-1]])
    beside = np.array([np.median(padded[k : k + 9], axis=0) for k in range(30)])
    gross = np.linalg.norm(medians - beside, axis=-1) / (rows.sigma_px * relative)
    spread = np.array([1.2533 if len(g) > 2 else 1.0 for g in groups])
    expected = relative**2 * spread**2 * np.maximum(gross / 3.5, 1.0) ** 4
    np.testing.assert_allclose(rows.variance, expected, rtol=1e-9)
    assert np.count_nonzero(gross > 3.5) >= 1
    np.testing.assert_array_equal(rows.after, np.arange(30) >= 14)
    step = float(np.median(np.diff(time)))
    apart, angle = (
        np.abs(time[:, None] - time),
        np.array([[math.dist(a, b) for b in rows.directions] for a in rows.directions]),
    )
    for kernel, steps in zip(rows.autoregressive, (1.5, 5.0, 15.0), strict=True):
        np.testing.assert_allclose(kernel, np.exp(-apart / (steps * step)), rtol=1e-9)
    for kernel, degrees in zip(rows.misfit, (9.0, 20.0), strict=True):
        np.testing.assert_allclose(kernel, np.exp(-0.5 * (angle / math.radians(degrees)) ** 2), rtol=1e-9)


def test_cloud_is_looked_for_at_every_half_of_a_length_and_about_the_step() -> None:
    time = np.cumsum(np.r_[0.0, np.random.default_rng(2).uniform(100.0, 500.0, 49)])
    some = usable(time)
    rows = step_evidence.step_rows(np.arange(50), np.arange(50), 22, some, np.zeros((50, 2)))
    expected = []
    for long in (900.0, 2400.0, 4500.0):
        begins = [time[0], time[-1] - long, time[22] - long - 1.0, time[22], time[22] - long / 2.0]
        k = 0
        while time[0] + k * long / 2.0 < time[-1]:
            begins.append(time[0] + k * long / 2.0)
            k += 1
        expected += [(begin, begin + long) for begin in begins]
    np.testing.assert_allclose(sorted(step_evidence.cloud_windows(rows)), sorted(expected))


def step_case(
    turn_deg: FloatArray, *, drift_px: float = 0.0, days: tuple[int, ...] = (0,), per_day: int = 44
) -> dict[str, Any]:
    """Return what a Bayes factor takes: a step at the middle of the first day, and cloud beside it."""
    rng, camera = np.random.default_rng(4), small_camera()
    after = rotated(camera, np.radians(turn_deg))
    directions = np.tile(sun_arc(per_day), (len(days), 1))
    day = np.repeat(np.array(days), per_day)
    time = 86_400.0 * day + 600.0 * np.tile(np.arange(float(per_day)), len(days))
    row = per_day // 2
    late = (np.arange(time.size) >= row)[:, None]
    pixels = np.where(late, project(after, directions), project(camera, directions)) + rng.normal(
        0.0, 0.1, (time.size, 2)
    )
    within = np.arange(time.size)
    pixels[(within > 26) & (within < 32)] += drift_px * np.array([0.8, -0.6])
    one = pixels - project(rotated(camera, 0.5 * np.radians(turn_deg)), directions)
    two = pixels - np.where(late, project(after, directions), project(camera, directions))
    turn_rad = max(math.radians(float(np.linalg.norm(turn_deg))), 3e-4)
    given = filtered_sightings(time, pixels, directions, day=day)
    return {"row": row, "usable": given, "one": (camera, one), "two": (after, two), "turn_rad": turn_rad}


_CASES = {
    "still": step_case(np.zeros(3)),
    "step": step_case(np.array([0.05, -0.03, 0.1])),
    "step_and_cloud": step_case(np.array([0.04, 0.0, -0.05]), drift_px=1.5),
    "cloud": step_case(np.array([1e-3, 0.0, 0.0]), drift_px=2.5),
}


@pytest.mark.parametrize("name", _CASES)
def test_a_bayes_factor_is_the_stored_one(name: str) -> None:
    found = log_bayes_factor(**_CASES[name])
    stored = Path(__file__).parent / "stored_answers.json"
    require_stored(stored, f"bayes_factor_{name}", {"numbers": [found]}, relative=1e-3)


def test_three_days_on_either_side_of_a_step_count() -> None:
    """What is further away, of another pose, or unseen by either camera changes nothing."""
    case = step_case(np.array([0.05, -0.03, 0.1]), days=(0, 1, 2, 3, 4), per_day=14)
    near = {**case, "usable": case["usable"].select(slice(0, 4 * 14))}
    near |= {name: (case[name][0], case[name][1][: 4 * 14]) for name in ("one", "two")}
    nearer = {**case, "usable": case["usable"].select(slice(0, 3 * 14))}
    nearer |= {name: (case[name][0], case[name][1][: 3 * 14]) for name in ("one", "two")}
    factor = log_bayes_factor(**case)
    assert factor == pytest.approx(log_bayes_factor(**near), rel=1e-9)
    assert factor != pytest.approx(log_bayes_factor(**nearer), rel=1e-6)


def known_fits(cameras: list[Camera], begins: list[int], unix_s: FloatArray) -> Callable[..., Calibration]:
    """Return a stand-in for `calibrate`, by which an epoch's pose is that of most of its sightings."""
    of_row = np.searchsorted(begins, np.arange(unix_s.size), side="right") - 1

    def fitted(points: Sightings, **_: object) -> Calibration:
        epochs = np.unique(points.epoch)
        took = [int(np.bincount(of_row[points.epoch == one]).argmax()) for one in epochs]
        stated = stated_calibration(cameras[took[-1]])
        return replace(stated, poses=tuple(cameras[k].rotation_cam_enu for k in took))

    return fitted


def moved_at(
    begins: list[int], turn_deg: float, monkeypatch: pytest.MonkeyPatch, *, n: int = 120
) -> list[tuple[int, float]]:
    """Return the rows before which moves were found, and the turns, degrees."""
    times: FloatArray = NOON + 180.0 * (np.arange(n, dtype=np.float64) - n / 2)
    cameras = [small_camera()]
    for k in range(len(begins)):
        turn = math.radians(turn_deg) * np.array([0.6, 0.8, 0.0] if k % 2 else [0.0, 0.6, 0.8])
        cameras.append(rotated(cameras[-1], turn))
    sun = sun_directions(times, SGP)
    of_row = np.searchsorted([0, *begins], np.arange(n), side="right") - 1
    pixels = np.array([project(cameras[k], one) for k, one in zip(of_row, sun, strict=True)])
    pixels += np.random.default_rng(6).normal(0.0, 0.05, pixels.shape)
    monkeypatch.setattr(module, "calibrate", known_fits(cameras, [0, *begins], times))
    points = Sightings.of(unix_s=times, pixels=pixels)
    found = calibrate_moved(points, site=SGP, image_size=(640, 480))
    moves = found.calibration.evidence.moves
    assert [one.bracket[1] - one.bracket[0] for one in moves] == pytest.approx([180.0] * len(moves))
    assert all(before.time < after.bracket[0] for before, after in pairwise(moves))
    codes = [one.code for one in found.calibration.verdict.findings]
    assert codes.count("pose_changed") == len(moves)
    return [(int(np.searchsorted(times, one.time)), one.turn_deg) for one in moves]


def test_moves_are_found_at_their_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    found = moved_at([40, 80], 0.5, monkeypatch)
    assert [row for row, _ in found] == [40, 80]
    assert [turn for _, turn in found] == pytest.approx([0.5, 0.5], rel=1e-6)


@pytest.mark.parametrize(("row", "found"), [(24, False), (28, True), (98, False)])
def test_a_move_within_75_minutes_of_an_end_is_none(row: int, found: bool, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: FBT001
    assert bool(moved_at([row], 0.5, monkeypatch)) == found
