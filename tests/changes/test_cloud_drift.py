"""Evidence of detections that drift: the kernel, the average over its numbers, and what it competes with."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import gamma, kv, logsumexp
from tests.fixtures.calibration import small_camera, stated_calibration, sun_arc

from sunarc.calibration.evidence import fit_inlier_mixture, log_evidence
from sunarc.changes import online as module
from sunarc.changes.online import Drift, ResidualModel, drift_evidence, make_residual_model, update_window
from sunarc.changes.values import Sighting, SightingWindow, WatchOptions
from sunarc.lab.simulation.truth import SGP
from sunarc.optics.forward import project

FloatArray = NDArray[np.float64]

N, FIRST = 20, 12


def _window(drift: FloatArray, *, trusted: int = FIRST) -> ResidualModel:
    calibration = stated_calibration(small_camera(), sigma_px=0.05)
    directions = sun_arc(N, widest_deg=20.0)
    noise = np.random.default_rng(4).normal(0.0, 0.05, (N, 2))
    watch = SightingWindow(
        unix_s=60.0 * np.arange(N, dtype=np.float64),
        pixels=project(calibration.camera, directions) + noise + drift,
        directions=directions,
        sigma_px=np.full(N, 0.05),
        trusted=np.arange(N) < trusted,
        surprise=np.zeros((N, 2)),
    )
    return make_residual_model(watch, calibration, WatchOptions())


def test_a_drift_is_a_twice_differentiable_matern_process_from_its_begin_on() -> None:
    window = _window(np.zeros((N, 2)))
    added = module.drift_covariance(window, Drift(8, 2.0, 700.0)) - window.covariance
    np.testing.assert_array_equal(added[:16], 0.0)
    blocks = added.reshape(N, 2, N, 2)
    np.testing.assert_array_equal(blocks[:, 0, :, 1], 0.0)
    np.testing.assert_allclose(blocks[8:, 0, 8:, 0], blocks[8:, 1, 8:, 1])
    lag = math.sqrt(5.0) * 60.0 * np.arange(1.0, 12.0) / 700.0
    # Rasmussen and Williams (2006), eq. 4.14 with nu = 5/2
    expected = 4.0 * 2.0 ** (1.0 - 2.5) / gamma(2.5) * lag**2.5 * kv(2.5, lag)
    np.testing.assert_allclose(blocks[8, 0, 9:, 0], expected, rtol=1e-9)
    np.testing.assert_allclose(blocks[8, 0, 8, 0], 4.0, rtol=1e-9)


def test_a_ramp_adds_the_variance_of_a_line_from_the_sighting_before_its_first() -> None:
    window = _window(np.zeros((N, 2)))
    plain = module.drift_covariance(window, Drift(8, 0.5, 2400.0))
    added = (module.drift_covariance(window, Drift(8, 0.5, 2400.0, 0.01)) - plain).reshape(N, 2, N, 2)
    # of a line s t with the 1-sigma slope 0.01 px/s: cov(s t, s u) = 0.01^2 t u, t and u in s since sighting 7
    seconds = np.where(np.arange(N) < 8, 0.0, 60.0 * (np.arange(N) - 7.0))
    for axis in (0, 1):
        np.testing.assert_allclose(added[:, axis, :, axis], 1e-4 * np.outer(seconds, seconds), atol=1e-12)
    np.testing.assert_array_equal(added[:, 0, :, 1], 0.0)


def test_the_evidence_is_the_mean_over_begins_amplitudes_times_and_ramps() -> None:
    window = _window(np.zeros((N, 2)), trusted=N)
    smooth = itertools.product((0, 6, 10, 12), (0.1, 0.5, 2.0, 8.0), (200.0, 700.0, 2400.0), (0.0,))
    ramps = itertools.product((0, 6, 10, 12), (0.5,), (2400.0,), (0.0005, 0.002, 0.008))
    each = []
    for drift in itertools.starmap(Drift, [*smooth, *ramps]):
        covariance = module.drift_covariance(window, drift)
        each.append((log_evidence(covariance, window.sightings, np.ones(N, dtype=bool)), covariance))
    mean = float(logsumexp([one for one, _ in each])) - math.log(len(each))
    best, covariance = max(each, key=lambda pair: pair[0])
    among_false = fit_inlier_mixture(covariance, window.sightings, np.ones(N, dtype=bool)).log_evidence
    assert len(each) == 60
    assert drift_evidence(window, 12) == pytest.approx(mean + max(among_false - best, 0.0), rel=1e-9)


def _kinds(drift: FloatArray, *, widest_deg: float, cadence_s: float, seed: int = 4) -> list[str]:
    """Return the kinds of change that are named while detections (n, 2) drift."""
    calibration = stated_calibration(small_camera(), sigma_px=0.02)
    directions = sun_arc(drift.shape[0], widest_deg=widest_deg)
    noise = np.random.default_rng(seed).normal(0.0, 0.02, drift.shape)
    watch = SightingWindow()
    kinds: list[str] = []
    for row, (pixel, direction) in enumerate(
        zip(project(calibration.camera, directions) + noise + drift, directions, strict=True)
    ):
        one = Sighting(unix_s=cadence_s * row, pixel=tuple(pixel), direction=tuple(direction), sigma_px=0.02)
        watch, change = update_window(watch, one, calibration=calibration, site=SGP, options=WatchOptions())
        kinds += [] if change is None else [change.cause]
    return kinds


def _toward(direction_deg: float) -> FloatArray:
    return np.array([math.cos(math.radians(direction_deg)), math.sin(math.radians(direction_deg))])


@pytest.mark.parametrize(("widest_deg", "direction_deg"), [(15.0, 240.0), (30.0, 300.0)])
def test_a_straight_drift_is_no_change_of_the_lens(widest_deg: float, direction_deg: float) -> None:
    # 0.6 px from one sighting to the next: a lens with five free numbers follows it too
    drift = 0.6 * np.clip(np.arange(56.0) - 41.0, 0.0, None)[:, None] * _toward(direction_deg)
    assert _kinds(drift, widest_deg=widest_deg, cadence_s=120.0) == []


@pytest.mark.parametrize(("direction_deg", "seed"), [(0.0, 4), (200.0, 5)])
def test_a_jump_that_then_declines_is_not_taken_for_a_turn_at_its_fourth_sighting(
    direction_deg: float, seed: int
) -> None:
    # a cloud's edge jumps by 2 px and declines by 0.05 px a minute: four sightings hardly show that it does
    after = np.arange(56.0) - 36.0
    size = np.where(after < 0.0, 0.0, 2.0 - 0.05 * after)
    assert _kinds(size[:, None] * _toward(direction_deg), widest_deg=30.0, cadence_s=60.0, seed=seed) == []


def test_a_jump_that_stays_is_a_turn() -> None:
    size = np.where(np.arange(56.0) < 36.0, 0.0, 2.0)
    assert _kinds(size[:, None] * _toward(0.0), widest_deg=30.0, cadence_s=60.0)[:1] == ["bump"]


def test_a_drift_explains_a_drift_better_than_no_drift_does() -> None:
    drift = np.clip(np.arange(N) - FIRST, 0, None)[:, None] * np.array([0.3, 0.2])
    window = _window(drift)
    nothing = fit_inlier_mixture(window.covariance, window.sightings, window.watch.trusted).log_evidence
    assert drift_evidence(window, FIRST) > nothing + 10.0


def test_an_episode_may_begin_after_the_change_that_it_competes_with() -> None:
    # a jump by 1 px at sighting 8 that declines; the change counts the eight before it as false
    drift = np.where(np.arange(N) < 8, 0.0, 1.0 - 0.04 * (np.arange(N) - 8.0))[:, None] * np.array([0.8, -0.6])
    window = _window(drift, trusted=8)
    assert drift_evidence(window, 0) == pytest.approx(drift_evidence(window, 8), abs=3.0)


def test_a_drift_explains_stillness_worse_than_no_drift_does() -> None:
    window = _window(np.zeros((N, 2)), trusted=N)
    nothing = fit_inlier_mixture(window.covariance, window.sightings, window.watch.trusted).log_evidence
    assert nothing - 10.0 < drift_evidence(window, FIRST) < nothing


def test_a_false_sighting_among_the_drift_is_counted_as_false() -> None:
    drift = np.clip(np.arange(N) - FIRST, 0, None)[:, None] * np.array([0.3, 0.2])
    wild = drift.copy()
    wild[16] += 150.0
    # as part of a drift of 8 px it would cost 0.5 (212 / 8)^2 = 351
    assert -60.0 < drift_evidence(_window(wild), FIRST) < drift_evidence(_window(drift), FIRST)


@pytest.mark.parametrize(
    ("rows", "begins"),
    [
        ([], set()),
        ([3], {3}),
        ([3, 4, 5], {3}),
        ([1, 2, 9, 10, 11], {9}),
        ([1, 2, 3, 9], {1, 9}),
        ([1, 3, 5], {1}),
        ([2, 5], {2, 5}),
    ],
)
def test_runs_begin_where_more_than_one_row_is_missing(rows: list[int], begins: set[int]) -> None:
    assert module.find_run_starts(np.array(rows, dtype=np.intp)) == begins


def test_sightings_before_the_episode_count_where_they_were_trusted() -> None:
    window = _window(np.zeros((N, 2)))
    window = replace(window, watch=replace(window.watch, trusted=np.arange(N) % 2 == 0))
    found = module.inliers_from(window, 10)
    assert found[:10].tolist() == [True, False] * 5
    assert np.all(found[10:])
