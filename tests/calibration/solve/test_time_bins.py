"""Bins of neighbouring sightings: which belong together, and their weighted means."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.calibration import observed, small_camera, small_problem, sun_arc

from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.solve.problem import Bins, FitProblem, time_bins
from sunarc.calibration.start.multistart import least_squares
from sunarc.common.robust_statistics import UNSEEN_PX

FloatArray = NDArray[np.float64]

SIGMA = 0.1


@pytest.fixture(scope="module")
def problem() -> FitProblem:
    return small_problem(small_camera())


def _usable(unix_s: FloatArray, *, day: object = 0, epoch: object = 0) -> Sightings:
    n = unix_s.size
    return Sightings(
        index=np.arange(n),
        unix_s=unix_s,
        pixels=np.zeros((n, 2)),
        directions=np.tile([0.0, 0.0, 1.0], (n, 1)),
        sigma_px=np.ones(n),
        epoch=np.broadcast_to(np.asarray(epoch, dtype=np.int64), (n,)),
        day=np.broadcast_to(np.asarray(day, dtype=np.int64), (n,)),
        refraction_sd=np.zeros((n, 1)),
    )


def test_no_sightings_have_no_bins() -> None:
    bins = time_bins(_usable(np.zeros(0)))
    assert (bins.count, bins.member.size) == (0, 0)


def test_one_sighting_is_one_bin() -> None:
    bins = time_bins(_usable(np.array([5.0])))
    assert (bins.count, bins.member.tolist()) == (1, [0])


def test_a_bin_has_at_most_sixteen_sightings() -> None:
    bins = time_bins(_usable(np.arange(40.0)))
    assert np.bincount(bins.member).tolist() == [16, 16, 8]


def test_a_bin_spans_at_most_six_minutes() -> None:
    bins = time_bins(_usable(60.0 * np.arange(15.0)))
    assert np.bincount(bins.member).tolist() == [6, 6, 3]
    assert time_bins(_usable(359.0 * np.arange(2.0))).count == 1
    assert time_bins(_usable(360.0 * np.arange(2.0))).count == 2


def test_a_slot_of_many_sightings_is_parted_and_one_of_few_is_whole() -> None:
    every_half_minute = time_bins(_usable(30.0 * np.arange(40.0)))
    assert np.bincount(every_half_minute.member).tolist() == [12, 12, 12, 4]
    every_ten_seconds = time_bins(_usable(10.0 * np.arange(80.0)))
    assert np.bincount(every_ten_seconds.member).tolist() == [16, 16, 4, 16, 16, 4, 8]


def test_days_and_epochs_are_never_taken_together() -> None:
    times = np.arange(6.0)
    assert time_bins(_usable(times, day=[0, 0, 1, 1, 1, 2])).member.tolist() == [0, 0, 1, 1, 1, 2]
    assert time_bins(_usable(times, epoch=[0, 0, 0, 1, 1, 1])).member.tolist() == [0, 0, 0, 1, 1, 1]


def test_the_slots_of_a_day_begin_with_its_first_sighting() -> None:
    times = np.array([100.0, 200.0, 86_400.0 + 50.0, 86_400.0 + 300.0])
    assert time_bins(_usable(times, day=[0, 0, 1, 1])).member.tolist() == [0, 0, 1, 1]


@pytest.fixture
def seen() -> Sightings:
    directions = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, 1.0, 0.0]])
    return Sightings(
        directions=directions,
        pixels=np.array([[0.0, 0.0], [4.0, 8.0], [7.0, 7.0]]),
        information=np.ones(3),
        epoch=np.array([0, 0, 1]),
        systematic_px=np.array([[[0.1, 0.0]] * 2, [[0.5, 0.4]] * 2, [[0.2, 0.2]] * 2]),
    )


BINS = Bins(member=np.array([0, 0, 1]), count=2)


def test_means_are_weighted_by_information(seen: Sightings) -> None:
    residual = np.array([[1.0, 0.0], [5.0, -4.0], [2.0, 3.0]])
    gathered, mean = BINS.gathered(seen, residual, np.array([0.3, 0.1, 0.2]))
    np.testing.assert_allclose(mean, [[2.0, -1.0], [2.0, 3.0]])
    np.testing.assert_allclose(gathered.pixels, [[1.0, 2.0], [7.0, 7.0]])
    np.testing.assert_allclose(gathered.information, [0.4, 0.2])
    np.testing.assert_allclose(gathered.systematic_px, [[[0.2, 0.1]] * 2, [[0.2, 0.2]] * 2])
    direction = np.array([0.15, 0.0, 0.95])
    np.testing.assert_allclose(gathered.directions[0], direction / np.linalg.norm(direction))
    assert gathered.epoch.tolist() == [0, 1]


def test_a_bin_without_information_keeps_its_first_sighting_and_says_nothing(seen: Sightings) -> None:
    gathered, mean = BINS.gathered(seen, np.ones((3, 2)), np.array([0.0, 0.0, 2.0]))
    assert gathered.information.tolist() == [0.0, 2.0]
    np.testing.assert_allclose(gathered.directions[0], seen.directions[0])
    np.testing.assert_allclose(gathered.pixels[0], seen.pixels[0])
    assert np.all(np.isfinite(mean))


def test_the_mean_of_a_bin_has_the_variance_of_its_information() -> None:
    rng = np.random.default_rng(4)
    information = np.array([1.0, 4.0, 0.25, 2.0])
    bins = Bins(member=np.zeros(4, dtype=np.int64), count=1)
    directions = np.tile([0.0, 0.0, 1.0], (4, 1))
    means = []
    for _ in range(2000):
        noise = rng.standard_normal((4, 2)) / np.sqrt(information)[:, None]
        data = Sightings(
            directions=directions, pixels=noise, information=information, epoch=np.zeros(4, dtype=np.int64)
        )
        gathered, mean = bins.gathered(data, noise, information)
        means.append(mean[0])
    assert 0.9 < np.var(means) * gathered.information[0] < 1.1


def test_a_run_s_first_bin_holds_sixteen_whatever_came_before() -> None:
    times = np.r_[np.arange(5.0), 86_400.0 + np.arange(40.0)]
    bins = time_bins(_usable(times, day=np.repeat([0, 1], [5, 40])))
    assert np.bincount(bins.member).tolist() == [5, 16, 16, 8]


def test_least_squares_of_the_bins_means_is_that_of_all(problem: FitProblem) -> None:
    at = problem.unknowns([small_camera()])
    dense = observed(small_camera(), sun_arc(600), sigma_px=SIGMA)
    bins = Bins(member=np.arange(600) // 8, count=75)
    means = bins.observations(dense, problem, at, information=dense.information)
    all_of_them, of_means = least_squares(problem, dense, at), least_squares(problem, means, at)
    moved = problem.residuals(of_means, dense) - problem.residuals(all_of_them, dense)
    assert np.max(np.abs(moved)) < 0.006
    assert np.max(np.abs(problem.residuals(at, dense) - problem.residuals(all_of_them, dense))) > 0.02
    ratio = np.sum(problem.residuals(of_means, dense) ** 2) / np.sum(problem.residuals(all_of_them, dense) ** 2)
    assert ratio - 1.0 < 2e-4


def test_a_sighting_where_the_lens_sees_nothing_takes_no_part_in_its_bin(problem: FitProblem) -> None:
    at, seen = problem.unknowns([small_camera()]), observed(small_camera(), sun_arc(150), sigma_px=SIGMA)
    narrow = replace(problem, template=replace(problem.template, max_angle=math.radians(60.0)))
    unseen = np.any(narrow.residuals(at, seen) == UNSEEN_PX, axis=-1)
    assert 5 < np.count_nonzero(unseen) < 100
    bins = Bins(member=np.arange(150) // 10, count=15)
    means = bins.observations(seen, narrow, at, information=seen.information)
    seen_again = bins.observations(seen, problem, at, information=np.where(unseen, 0.0, seen.information))
    np.testing.assert_allclose(means.information, seen_again.information)
    counted = means.information > 0.0
    off = narrow.residuals(at, means)[counted] - problem.residuals(at, seen_again)[counted]
    shown = np.all(narrow.residuals(at, means)[counted] != UNSEEN_PX, axis=-1)
    np.testing.assert_allclose(off[shown], 0.0, atol=1e-9)
