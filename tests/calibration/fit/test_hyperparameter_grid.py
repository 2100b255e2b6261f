"""The grid of scales: its priors as densities, and the probabilities of its places."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import logsumexp
from tests.fixtures.calibration import log_evidences

from sunarc.calibration.fit.marginal_likelihood import (
    HyperparameterGrid,
    NormalEquations,
    PriorScales,
    field_log_odds,
    likely_scales,
    log_evidence,
    log_weights,
    normal_sums,
    normalised,
    scale_grid,
)

FloatArray = NDArray[np.float64]


@pytest.fixture(scope="module")
def grid() -> HyperparameterGrid:
    return scale_grid(width=1000, height=800, floor_px=0.002, radial_px=2.0, decentering_px=0.7)


def _normal(grid: HyperparameterGrid, *, amplitude_px: float = 0.0, seed: int = 1) -> NormalEquations:
    """Return the sums of sightings of a field of some amplitude, and noise of 0.05 px; the lens is known."""
    rng = np.random.default_rng(seed)
    pixels = rng.uniform(0.0, 800.0, (120, 2))
    waves = grid.basis.values(pixels)
    sigma = amplitude_px * np.sqrt(grid.basis.variances(length_px=float(grid.lengths[1])))
    field = waves @ (rng.standard_normal((2, sigma.size)) * sigma).T
    residual = field + 0.05 * rng.standard_normal((120, 2))
    return normal_sums(np.zeros((120, 2, 17)), waves, residual, np.full(120, 400.0), at=np.zeros(17))


def _likely(normal: NormalEquations, grid: HyperparameterGrid) -> PriorScales:
    return likely_scales(normalised(log_weights(normal, grid)), grid)


def test_the_grid_reaches_from_the_floor_to_eight_pixels(grid: HyperparameterGrid) -> None:
    assert grid.amplitudes[0] == pytest.approx(0.002)
    assert grid.amplitudes[-1] == pytest.approx(8.0)
    ratio = grid.amplitudes[1:] / grid.amplitudes[:-1]
    np.testing.assert_allclose(ratio, (8.0 / 0.002) ** (1.0 / 15.0))
    np.testing.assert_allclose(grid.lengths, [128.0, 192.0, 288.0])  # shares of the shorter side
    assert grid.log_prior.shape == (16, 3, 60)
    assert grid.lens_scales.shape == (60, 2)


def test_a_floor_of_nothing_is_a_tenth_of_a_micrometre() -> None:
    assert scale_grid(width=100, height=100, floor_px=0.0, radial_px=1.0, decentering_px=1.0).amplitudes[0] == 1e-4


def test_the_lens_scales_are_the_usual_ones_times_factors(grid: HyperparameterGrid) -> None:
    radial, decentering = np.unique(grid.lens_scales[:, 0]), np.unique(grid.lens_scales[:, 1])
    np.testing.assert_allclose(radial, 2.0 * np.array([0.1, 0.15, 0.22, 0.33, 0.5, 0.75, 1.2, 2.0, 4.0, 8.0]))
    np.testing.assert_allclose(decentering, 0.7 * np.array([0.25, 0.5, 1.0, 2.0, 4.0, 8.0]))


def test_the_most_plausible_lens_before_the_sightings_is_the_usual_one(grid: HyperparameterGrid) -> None:
    of_lens = logsumexp(grid.log_prior, axis=(0, 1))
    radial, decentering = grid.lens_scales[int(np.argmax(of_lens))]
    assert 1.4 <= radial <= 4.0
    assert 0.35 <= decentering <= 1.4
    # the prior of the logarithm is Gaussian: its weight over the cell, twice the scale against the scale
    cell = np.log(np.gradient(np.log(np.unique(grid.lens_scales[:, 0]))))
    table = of_lens.reshape(10, 6)[:, 2] - cell
    at_a_half, at_two, at_four = table[4], table[7], table[8]
    assert at_a_half == pytest.approx(at_two)
    assert at_two - at_four == pytest.approx(1.5 * (math.log(2.0) / math.log(2.6)) ** 2)


def test_no_field_has_the_odds_of_three_to_two(grid: HyperparameterGrid) -> None:
    of_amplitude = logsumexp(grid.log_prior[:, 0], axis=1)
    share = np.exp(of_amplitude - logsumexp(of_amplitude))
    # 1.5 times all fields together, and the floor's own
    assert share[0] == pytest.approx(0.6, abs=0.01)


def test_the_field_s_prior_is_log_normal_about_three_tenths_and_bounded(grid: HyperparameterGrid) -> None:
    of_amplitude = logsumexp(grid.log_prior[1:, 0], axis=1)
    amplitude = grid.amplitudes[1:]
    expected = -0.5 * (np.log(amplitude / 0.3) / math.log(3.0)) ** 2 - 0.5 * (amplitude / 1.5) ** 2
    np.testing.assert_allclose(of_amplitude - of_amplitude[0], expected - expected[0], atol=1e-9)
    assert of_amplitude[-1] < np.max(of_amplitude) - 14.0


def test_weights_are_prior_times_evidence(grid: HyperparameterGrid) -> None:
    normal = _normal(grid)
    evidence = log_evidences(
        normal, grid.basis, amplitudes=grid.amplitudes, lengths=grid.lengths, lens_scales=grid.lens_scales
    )
    weight = normalised(log_weights(normal, grid))
    assert weight.sum() == pytest.approx(1.0)
    total = grid.log_prior + evidence
    np.testing.assert_allclose(weight, np.exp(total - logsumexp(total)), rtol=1e-9)
    assert log_evidence(log_weights(normal, grid)) == pytest.approx(float(logsumexp(total)))


def test_the_likely_scales_are_means_under_the_weights(grid: HyperparameterGrid) -> None:
    normal = _normal(grid, amplitude_px=0.4)
    weight = normalised(log_weights(normal, grid))
    found = likely_scales(weight, grid)
    assert found.amplitude_px == pytest.approx(float(np.sum(weight, axis=(1, 2)) @ grid.amplitudes))
    of_lens = weight.sum(axis=(0, 1))
    assert found.radial_px == pytest.approx(math.exp(float(of_lens @ np.log(grid.lens_scales[:, 0]))))
    assert found.decentering_px == pytest.approx(math.exp(float(of_lens @ np.log(grid.lens_scales[:, 1]))))
    assert grid.lengths[0] <= found.length_px <= grid.lengths[-1]
    power = weight.sum(axis=2) * grid.amplitudes[:, None]
    mean = float(np.sum(power * np.log(grid.lengths)) / power.sum())
    assert found.length_px == pytest.approx(math.exp(mean))


@pytest.mark.parametrize(("truth", "low", "high"), [(0.0, 0.0, 0.02), (0.4, 0.2, 0.8)])
def test_the_amplitude_of_the_data_is_found(grid: HyperparameterGrid, truth: float, low: float, high: float) -> None:
    found = [_likely(_normal(grid, amplitude_px=truth, seed=seed), grid).amplitude_px for seed in range(4)]
    assert low <= np.mean(found) <= high


def test_evidence_without_a_large_field_is_lower_where_there_is_one(grid: HyperparameterGrid) -> None:
    normal = _normal(grid, amplitude_px=0.5)
    floor = replace(grid, amplitudes=grid.amplitudes[:1], log_prior=grid.log_prior[:1])
    assert log_evidence(log_weights(normal, floor)) < log_evidence(log_weights(normal, grid)) - 50.0
    flat = replace(grid, log_prior=np.zeros_like(grid.log_prior))
    assert normalised(log_weights(normal, flat)).sum() == pytest.approx(1.0)


@pytest.mark.parametrize(("truth", "low", "high"), [(0.0, -20.0, 0.0), (0.4, 20.0, 1e6)])
def test_a_field_is_proven_where_there_is_one(grid: HyperparameterGrid, truth: float, low: float, high: float) -> None:
    found = [field_log_odds(log_weights(_normal(grid, amplitude_px=truth, seed=s), grid)) for s in range(4)]
    assert low < min(found) <= max(found) < high


def test_the_odds_are_those_of_the_weights(grid: HyperparameterGrid) -> None:
    log_weight = log_weights(_normal(grid, amplitude_px=0.02), grid)
    weight = normalised(log_weight)
    assert field_log_odds(log_weight) == pytest.approx(math.log(weight[1:].sum() / weight[0].sum()))
    assert field_log_odds(log_weight[:1]) == -math.inf
