"""Bayes factor of a step of the pose: its likelihood against dense Gaussians, and residuals whose answer is known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import gamma, kv
from scipy.stats import multivariate_normal
from tests.fixtures.calibration import filtered_sightings, small_camera, sun_arc

from sunarc.calibration.answers.error_model import rotated
from sunarc.calibration.model.sightings import Sightings
from sunarc.changes import step_evidence as module
from sunarc.changes.step_evidence import Amplitudes, Episode, log_bayes_factor
from sunarc.optics.forward import project

FloatArray = NDArray[np.float64]

N, ROW = 60, 30


def _usable(pixels: FloatArray, directions: FloatArray) -> Sightings:
    times = 1.4e9 + 600.0 * np.arange(pixels.shape[0], dtype=np.float64)
    return filtered_sightings(times, pixels, directions)


def _factor(turn: FloatArray, *, drift: FloatArray | None = None, seed: int = 1) -> float:
    """Return the Bayes factor of a step at the middle, the residuals about the true cameras."""
    camera, directions = small_camera(), sun_arc(N)
    after = rotated(camera, turn)
    late = np.arange(N)[:, None] >= ROW
    pixels = np.where(late, project(after, directions), project(camera, directions))
    pixels = pixels + np.random.default_rng(seed).normal(0.0, 0.1, (N, 2)) + (0.0 if drift is None else drift)
    one = pixels - project(rotated(camera, 0.5 * turn), directions)
    two = pixels - np.where(late, project(after, directions), project(camera, directions))
    size = max(float(np.linalg.norm(turn)), math.radians(0.02))
    return log_bayes_factor(ROW, _usable(pixels, directions), one=(camera, one), two=(after, two), turn_rad=size)


def test_a_step_is_far_likelier_than_none() -> None:
    assert _factor(np.radians([1.0, -0.5, 0.0])) > 20.0


def test_stillness_is_likelier_than_a_step() -> None:
    assert -20.0 < _factor(np.zeros(3)) < 5.0


def test_a_side_without_sightings_has_no_evidence() -> None:
    camera, directions = small_camera(), sun_arc(N)
    residual = np.zeros((N, 2))
    hidden = residual.copy()
    hidden[ROW:] = 1e4  # beyond what either camera sees
    usable = _usable(project(camera, directions), directions)
    assert log_bayes_factor(ROW, usable, one=(camera, hidden), two=(camera, residual), turn_rad=0.1) == -math.inf
    assert log_bayes_factor(0, usable, one=(camera, residual), two=(camera, residual), turn_rad=0.1) == -math.inf


@pytest.fixture(scope="module")
def rows() -> module.StepRows:
    directions = sun_arc(N)
    usable = _usable(project(small_camera(), directions), directions)
    residual = np.random.default_rng(2).normal(0.0, 0.1, (N, 2))
    member = np.arange(N)
    return module.step_rows(np.arange(N), member, ROW, usable, residual)


def test_the_rows_have_the_scale_and_the_side_of_their_sightings(rows: module.StepRows) -> None:
    assert rows.sigma_px == pytest.approx(0.1, rel=0.2)
    assert rows.after.tolist() == [False] * ROW + [True] * (N - ROW)
    np.testing.assert_allclose(rows.separation_s[0, :3], [0.0, 600.0, 1200.0])
    # correlation times of 1.5, 5 and 15 usual steps
    np.testing.assert_allclose([one[0, 1] for one in rows.autoregressive], np.exp([-1 / 1.5, -1 / 5, -1 / 15]))
    assert np.median(rows.variance) == pytest.approx(1.0)


def test_the_covariance_is_the_sum_of_white_autoregressive_misfit_and_episode(rows: module.StepRows) -> None:
    amplitudes = Amplitudes(white=0.5, autoregressive=0.8, autoregressive_time=1, misfit=2.0, misfit_angle=0)
    begin = float(rows.unix_s[10])
    episode = Episode(begin, begin + 2400.0, amplitude_px=0.7, time_s=300.0)
    found = module.noise_covariance(rows, amplitudes, (episode,)) - module.noise_covariance(rows, amplitudes, ())
    inside = slice(10, 15)
    scaled = math.sqrt(3.0) * 600.0 * np.arange(1.0, 5.0) / 300.0
    # Rasmussen and Williams (2006), eq. 4.14 with nu = 3/2
    matern = 2.0 ** (1.0 - 1.5) / gamma(1.5) * scaled**1.5 * kv(1.5, scaled)
    np.testing.assert_allclose(found[10, 11:15], 0.49 * matern, rtol=1e-9)
    np.testing.assert_allclose(np.diag(found)[inside], 0.49)
    outside = found.copy()
    outside[inside, inside] = 0.0
    np.testing.assert_allclose(outside, 0.0, atol=1e-15)
    plain = module.noise_covariance(rows, amplitudes, ()) / rows.sigma_px**2
    np.testing.assert_allclose(np.diag(plain), 0.25 * rows.variance + 0.64 + 4.0)
    angle = np.linalg.norm(rows.directions[3] - rows.directions[9])
    expected = 0.64 * math.exp(-6.0 / 5.0) + 4.0 * math.exp(-0.5 * (angle / math.radians(9.0)) ** 2)
    assert plain[3, 9] == pytest.approx(expected)


def test_the_log_likelihood_is_the_dense_gaussian_s(rows: module.StepRows) -> None:
    rng = np.random.default_rng(3)
    derivatives = rng.standard_normal((N, 2, 4))
    residual = rng.standard_normal((N, 2)) * 0.2
    model = module.StepModel(rows=rows, residual=residual, derivatives=derivatives)
    amplitudes = Amplitudes(white=1.0, autoregressive=0.5, autoregressive_time=0)
    flat = derivatives.reshape(2 * N, 4)
    covariance = np.kron(module.noise_covariance(rows, amplitudes, ()), np.eye(2)) + flat @ flat.T
    expected = multivariate_normal(np.zeros(2 * N), covariance).logpdf(residual.ravel())
    assert model.log_likelihood(amplitudes, ()) == pytest.approx(float(expected), rel=1e-9)


def test_a_covariance_that_is_none_is_impossible(rows: module.StepRows) -> None:
    model = module.StepModel(rows=rows, residual=np.zeros((N, 2)), derivatives=np.zeros((N, 2, 1)))
    assert model.log_likelihood(Amplitudes(white=0.0), ()) == -math.inf


def test_amplitudes_are_those_of_the_largest_likelihood_on_the_grid(rows: module.StepRows) -> None:
    residual = 1.5 * rows.sigma_px * np.random.default_rng(5).standard_normal((N, 2))
    model = module.StepModel(rows=rows, residual=residual, derivatives=np.zeros((N, 2, 1)))
    best, value = module.fitted_amplitudes(model, Amplitudes(), ())
    assert value == pytest.approx(model.log_likelihood(best, ()))
    assert value >= model.log_likelihood(Amplitudes(), ())
    noise = math.hypot(best.white, best.autoregressive, best.misfit)
    assert 1.2 < noise < 2.2


def test_groups_of_a_long_record_do_not_cross_a_day_or_the_step() -> None:
    n = 1000
    usable = _usable(np.zeros((n, 2)), np.tile([0.0, 0.0, 1.0], (n, 1)))
    day = np.repeat([0, 1], 500)
    usable = replace(usable, day=day)
    member = module.group_members(np.arange(n), 301, usable)
    counts = np.bincount(member)
    assert counts.max() == 4  # 1000 sightings in at most 280 rows
    assert np.all(np.diff(member) >= 0)
    assert member[300] != member[301]
    assert member[499] != member[500]
    medians = module.group_medians(np.arange(2.0 * n).reshape(n, 2), member)
    assert medians.shape == (counts.size, 2)
    np.testing.assert_allclose(medians[0], np.median(np.arange(8.0).reshape(4, 2), axis=0))


def test_the_windows_of_cloud_lie_at_the_ends_and_about_the_step(rows: module.StepRows) -> None:
    windows = module.cloud_windows(rows)
    lengths = {round(end - begin) for begin, end in windows}
    assert lengths == {900, 2400, 4500}
    at = float(rows.unix_s[ROW])
    for long in (900.0, 2400.0, 4500.0):
        assert (float(rows.unix_s[0]), float(rows.unix_s[0]) + long) in windows
        assert (at, at + long) in windows
        assert (at - 0.5 * long, at + 0.5 * long) in windows
    assert max(end - begin for begin, end in windows) == 4500.0


@pytest.mark.parametrize(("first", "count"), [(8, 5), (20, 4), (3, 7)])
def test_the_ends_of_an_episode_draw_in_to_what_cloud_drew_aside(rows: module.StepRows, first: int, count: int) -> None:
    residual = 0.1 * np.random.default_rng(6).standard_normal((N, 2))
    inside = slice(first, first + count)
    residual[inside] += [2.0, -1.0]
    model = module.StepModel(rows=rows, residual=residual, derivatives=np.zeros((N, 2, 1)))
    for early, late in ((-1, 0), (0, 1), (-1, 1)):  # sightings too many before and after
        begin, end = (float(rows.unix_s[i]) for i in (first + early, first + count - 1 + late))
        begun = (Episode(begin - 50.0, end + 50.0, amplitude_px=2.0, time_s=1200.0),)
        (found,) = module.refined_episodes(model, Amplitudes(), begun)
        covered = np.flatnonzero((rows.unix_s >= found.begin_s) & (rows.unix_s <= found.end_s))
        assert covered.tolist() == list(range(first, first + count))
        assert model.log_likelihood(Amplitudes(), (found,)) > model.log_likelihood(Amplitudes(), begun) + 5.0


def test_a_window_of_each_length_ends_just_before_the_step(rows: module.StepRows) -> None:
    at = float(rows.unix_s[ROW])
    ends = {
        long: [end for begin, end in module.cloud_windows(rows) if end - begin == long]
        for long in (900.0, 2400.0, 4500.0)
    }
    for found in ends.values():
        assert any(at - 2.0 < end < at for end in found)


def test_cloud_is_looked_for_all_along_a_record_of_less_than_two_days(rows: module.StepRows) -> None:
    begin = rows.unix_s[0]
    short, long = (module.cloud_windows(replace(rows, unix_s=begin + by * (rows.unix_s - begin))) for by in (1.0, 8.0))
    lengths = {round(end - begin) for begin, end in long}
    assert len(long) == 5 * len(lengths)  # at the ends, and beside and across the step
    assert {round(end - begin) for begin, end in short} == lengths
    assert len(short) > 2 * len(long)
