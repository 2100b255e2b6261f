"""The marginalised fit against dense Gaussian algebra, the oracle."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import multivariate_normal
from tests.fixtures.calibration import log_evidences, penalty, random_covariance

from sunarc import _kernels
from sunarc.calibration.fit.marginal_likelihood import (
    BasisProducts,
    FieldSums,
    NormalEquations,
    PriorScales,
    inverses,
    marginal_fit,
    normal_sums,
    prior_precision,
)
from sunarc.optics.displacement import WaveBasis, wave_basis

FloatArray = NDArray[np.float64]

SCALES = PriorScales(0.4, 300.0, 2.0, 0.7)


@pytest.fixture(scope="module")
def basis() -> WaveBasis:
    return wave_basis(width=1000, height=800, shortest_px=250.0, longest_px=400.0)


class _Case:
    def __init__(self, basis: WaveBasis) -> None:
        rng = np.random.default_rng(7)
        n, p = 30, 17
        self.pixels = rng.uniform(0.0, 800.0, (n, 2))
        self.rows = rng.standard_normal((n, 2, p))
        self.residual = rng.standard_normal((n, 2))
        self.information = rng.uniform(0.5, 4.0, n)
        self.at = 0.1 * rng.standard_normal(p)
        self.basis_values = basis.values(self.pixels)

    def normal(self) -> NormalEquations:
        return normal_sums(self.rows, self.basis_values, self.residual, self.information, at=self.at)


def _kernel(a: FloatArray, b: FloatArray, scales: PriorScales) -> FloatArray:
    square = np.sum((a[:, None] - b[None]) ** 2, axis=-1)
    return np.asarray(scales.amplitude_px**2 * np.exp(-0.5 * square / scales.length_px**2))


def test_waves_make_the_squared_exponential_kernel(basis: WaveBasis) -> None:
    pixels = np.random.default_rng(1).uniform([0.0, 0.0], [1000.0, 800.0], (60, 2))
    for length in (250.0, 320.0, 400.0):
        scales = PriorScales(1.0, length, 1.0, 1.0)
        waves = basis.values(pixels)
        made = (waves * basis.variances(length_px=length)) @ waves.T
        np.testing.assert_allclose(made, _kernel(pixels, pixels, scales), atol=0.06)


def test_evidence_differs_between_scales_as_the_dense_gaussian_does(basis: WaveBasis) -> None:
    case = _Case(basis)
    amplitudes, lengths = np.array([0.01, 0.4]), np.array([300.0])
    lens = np.array([[2.0, 0.7], [4.0, 1.4]])
    found = log_evidences(case.normal(), basis, amplitudes=amplitudes, lengths=lengths, lens_scales=lens)
    dense = np.array([[_dense(case, basis, PriorScales(a, 300.0, r, d)) for r, d in lens] for a in amplitudes])
    np.testing.assert_allclose(found[:, 0] - found[0, 0, 0], dense - dense[0, 0], atol=1e-6)


def _dense(case: _Case, basis: WaveBasis, scales: PriorScales) -> float:
    """Return the log density of the residuals under prior, field and noise together."""
    variance = 1.0 / prior_precision(case.at.size, scales.radial_px, scales.decentering_px)
    flat = case.rows.reshape(-1, case.at.size)
    field = (
        case.basis_values * scales.amplitude_px**2 * basis.variances(length_px=scales.length_px)
    ) @ case.basis_values.T
    covariance = (flat * variance) @ flat.T + np.kron(field, np.eye(2)) + np.diag(np.repeat(1 / case.information, 2))
    mean = -flat @ case.at  # the prior is about 0, the residuals were taken at `at`
    return float(multivariate_normal(mean, covariance).logpdf(case.residual.ravel()))


def test_marginal_fit_is_generalised_least_squares(basis: WaveBasis) -> None:
    case = _Case(basis)
    found = marginal_fit(case.normal(), basis, SCALES)
    precision = prior_precision(case.at.size, SCALES.radial_px, SCALES.decentering_px)
    prior_waves = SCALES.amplitude_px**2 * basis.variances(length_px=SCALES.length_px)
    field = (case.basis_values * prior_waves) @ case.basis_values.T
    weight = np.linalg.inv(np.kron(field, np.eye(2)) + np.diag(np.repeat(1.0 / case.information, 2)))
    flat = case.rows.reshape(-1, case.at.size)
    normal = flat.T @ weight @ flat + np.diag(precision)
    step = np.linalg.solve(normal, flat.T @ weight @ case.residual.ravel() - precision * case.at)
    np.testing.assert_allclose(found.unknowns, case.at + step, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(normal), rtol=1e-5, atol=1e-9)
    # Cov(θ, c) = -C J' W Φ Λ, for each component of the field
    x_rows = np.kron(case.basis_values * prior_waves, [[1.0], [0.0]])
    cross = -np.linalg.inv(normal) @ flat.T @ weight @ x_rows
    np.testing.assert_allclose(found.cross[0], cross, rtol=1e-5, atol=1e-7)


def test_sums_over_sightings_by_hand() -> None:
    rows = np.array([[[1.0, 2.0], [0.0, 1.0]], [[3.0, 0.0], [1.0, 1.0]]])
    waves = np.array([[1.0], [2.0]])
    found = normal_sums(rows, waves, np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([1.0, 4.0]), at=np.zeros(2))
    np.testing.assert_allclose(found.jj, [[1.0 + 4.0 * 10.0, 2.0 + 4.0], [6.0, 5.0 + 4.0]])
    np.testing.assert_allclose(found.jf[:, :, 0], [[1.0 + 24.0, 2.0], [8.0, 1.0 + 8.0]])
    np.testing.assert_allclose(found.ff.matrix, [[17.0]])
    np.testing.assert_allclose(found.jr, [1.0 + 4.0 * 13.0, 4.0 + 16.0])
    np.testing.assert_allclose(found.fr, [[25.0], [34.0]])
    assert found.rr == pytest.approx(5.0 + 4.0 * 25.0)


def test_given_wave_products_are_taken_as_they_are(basis: WaveBasis) -> None:
    case = _Case(basis)
    given = BasisProducts(matrix=np.eye(case.basis_values.shape[1]))
    found = normal_sums(case.rows, case.basis_values, case.residual, case.information, at=case.at, ff=given)
    assert found.ff is given


def test_prior_precisions_are_those_of_lens_pose_and_air() -> None:
    found = prior_precision(17 + 6 + 2, 2.0, 0.5, n_unit=2)
    np.testing.assert_allclose(found[5:13], 0.25)
    np.testing.assert_allclose(found[13:15], 4.0)
    np.testing.assert_allclose(found[17:23], 1e-8)
    np.testing.assert_allclose(found[23:], 1.0)
    assert found.size == 25


def _log_posterior(case: _Case, basis: WaveBasis, scales: PriorScales, change: FloatArray, waves: FloatArray) -> float:
    """Return -2 log of what the linear model says of a change of the unknowns and field coefficients (2, m)."""
    misfit = case.residual - case.rows @ change - (case.basis_values @ waves.T)
    prior = prior_precision(case.at.size, scales.radial_px, scales.decentering_px)
    variance = scales.amplitude_px**2 * basis.variances(length_px=scales.length_px)
    likelihood = float(np.sum(case.information[:, None] * misfit**2))
    return likelihood + float(np.sum(prior * (case.at + change) ** 2)) + float(np.sum(waves**2 / variance))


def test_the_penalty_is_the_log_posterior_with_the_field_at_its_best(basis: WaveBasis) -> None:
    case = _Case(basis)
    nothing = np.zeros(case.at.size)
    weight = case.information[:, None] * case.basis_values
    variance = SCALES.amplitude_px**2 * basis.variances(length_px=SCALES.length_px)
    best = np.linalg.solve(case.basis_values.T @ weight + np.diag(1.0 / variance), weight.T @ case.residual).T
    expected = _log_posterior(case, basis, SCALES, nothing, np.asarray(best, dtype=np.float64))
    assert penalty(case.normal(), basis, SCALES) == pytest.approx(expected, rel=1e-9)


def test_the_fit_and_its_field_are_the_joint_mode_and_the_gain_is_what_the_step_takes(basis: WaveBasis) -> None:
    case = _Case(basis)
    found = marginal_fit(case.normal(), basis, SCALES)
    step = found.unknowns - case.at
    lowest = _log_posterior(case, basis, SCALES, step, found.coefficients)
    rng = np.random.default_rng(1)
    for _ in range(20):
        other = 1e-3 * rng.standard_normal(step.size)
        bent = np.asarray(found.coefficients + 1e-3 * rng.standard_normal(found.coefficients.shape), dtype=np.float64)
        assert _log_posterior(case, basis, SCALES, step + other, bent) > lowest
    moved = normal_sums(
        case.rows, case.basis_values, case.residual - case.rows @ step, case.information, at=found.unknowns
    )
    gain = penalty(case.normal(), basis, SCALES) - penalty(moved, basis, SCALES)
    assert found.gain == pytest.approx(gain, rel=1e-6)


def test_each_choice_of_a_grid_is_the_fit_under_its_scales(basis: WaveBasis) -> None:
    normal = _Case(basis).normal()
    amplitudes, lengths, lens = np.array([0.1, 0.4, 3.0]), np.array([260.0, 300.0]), np.array([[2.0, 0.7], [1.0, 0.3]])
    equations = FieldSums.of(normal, basis, amplitudes, lengths).equations(np.arange(6), lens)
    for (j, i, k), _ in np.ndenumerate(np.empty((2, 3, 2))):
        step, reduced = equations.fits(np.array([3 * j + i]), np.array([k]))
        known, at_rest, back = (one[3 * j + i] for one in equations.part_from_others())
        fit = marginal_fit(normal, basis, PriorScales(float(amplitudes[i]), float(lengths[j]), *map(float, lens[k])))
        np.testing.assert_allclose(known + back @ reduced[0] @ back.T, fit.covariance, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(normal.at + at_rest + back @ step[0], fit.unknowns, rtol=1e-9, atol=1e-12)


def test_terms_are_those_of_dense_matrices_in_any_units() -> None:
    rng, pairs = np.random.default_rng(3), np.array([[1.0, 2.0], [1.0, 5.0], [-1e9, 1.0], [2.0, -1e9], [4.0, 7.0]])
    units = 10.0 ** rng.uniform(-3.0, 3.0, 21)
    units[5:15] = 1.0  # which are whitened
    matrices = np.stack([random_covariance(21, seed=s) * np.outer(units, units) for s in (1, 2)])
    vectors, at = rng.standard_normal((2, 21)) * units, rng.standard_normal(21) / units
    precision = rng.uniform(0.1, 2.0, 21) * units**2
    order = np.r_[np.delete(np.arange(21), np.r_[5:15]), 5:15]
    found = _kernels.evidence_terms(matrices, vectors, at, precision, order, pairs)
    for (n, k), value in np.ndenumerate(found):
        precision[5:13], precision[13:15] = pairs[k]
        whole, pull = matrices[n] + np.diag(precision), vectors[n] - precision * at
        expected = pull @ np.linalg.solve(whole, pull) - np.linalg.slogdet(whole)[1] if k not in {2, 3} else math.nan
        assert value == pytest.approx(expected, rel=1e-9, nan_ok=True)


@pytest.mark.parametrize("size", [1, 2, 9, 23])
def test_inverses_of_matrices_in_any_units(size: int) -> None:
    units = np.geomspace(1.0, 1e6, size)
    matrices = np.stack([random_covariance(size, seed=seed) * np.outer(units, units) for seed in (3, 4)])
    found = inverses(matrices)
    np.testing.assert_allclose(found @ matrices * (units[:, None] / units), np.tile(np.eye(size), (2, 1, 1)), atol=1e-9)
    np.testing.assert_array_equal(found, np.swapaxes(found, -1, -2))
    negative = np.array([[1.0, 3.0], [3.0, 1.0]])
    np.testing.assert_allclose(inverses(negative) @ negative, np.eye(2), atol=1e-9)


def test_the_unknowns_scatter_as_the_covariance_says(basis: WaveBasis) -> None:
    """Drawn from the model: parameters, field and noise; the mean squared Mahalanobis distance is the count."""
    case = _Case(basis)
    rng = np.random.default_rng(12)
    precision = prior_precision(case.at.size, SCALES.radial_px, SCALES.decentering_px)
    variance = SCALES.amplitude_px**2 * basis.variances(length_px=SCALES.length_px)
    squares, inside = [], []
    for _ in range(80):
        truth = rng.standard_normal(case.at.size) / np.sqrt(precision)
        coefficients = rng.standard_normal((2, variance.size)) * np.sqrt(variance)
        noise = rng.standard_normal(case.residual.shape) / np.sqrt(case.information)[:, None]
        residual = case.rows @ truth + case.basis_values @ coefficients.T + noise[:, :]
        normal = normal_sums(case.rows, case.basis_values, residual, case.information, at=np.zeros(case.at.size))
        fit = marginal_fit(normal, basis, SCALES)
        off = fit.unknowns - truth
        squares.append(off @ np.linalg.solve(fit.covariance, off))
        inside.append(np.abs(off) < 1.96 * np.sqrt(np.diag(fit.covariance)))
    # chi-square of 17 degrees of freedom: standard deviation of the mean of 80 is 0.65
    assert 15.0 < np.mean(squares) < 19.0
    assert 0.92 < np.mean(inside) < 0.98


class _TwoUnknowns:
    """Sightings that depend on two unknowns alone, and a field of one wave."""

    def __init__(self, basis: WaveBasis) -> None:
        rng = np.random.default_rng(21)
        self.basis = replace(basis, orders=np.array([[1, 1]]))
        self.pixels = rng.uniform(100.0, 700.0, (6, 2))
        self.rows = np.zeros((6, 2, 17))
        self.rows[..., [6, 14]] = rng.standard_normal((6, 2, 2))  # one radial unknown, and p2
        self.residual = rng.standard_normal((6, 2))
        self.information = rng.uniform(0.5, 2.0, 6)
        self.basis_values = self.basis.values(self.pixels)

    def normal(self) -> NormalEquations:
        return normal_sums(self.rows, self.basis_values, self.residual, self.information, at=np.zeros(17))

    def evidence(self, scales: PriorScales) -> float:
        """Return the density of the residuals, integrated over the two unknowns on a grid."""
        field = (
            self.basis_values * scales.amplitude_px**2 * self.basis.variances(length_px=scales.length_px)
        ) @ self.basis_values.T
        covariance = np.kron(field, np.eye(2)) + np.diag(np.repeat(1.0 / self.information, 2))
        density = multivariate_normal(np.zeros(12), covariance)
        flat = self.rows[..., [6, 14]].reshape(12, 2)
        sigma = scales.radial_px, scales.decentering_px

        axes = [np.linspace(-6.0, 6.0, 121) * min(s, 1.5) for s in sigma]  # exact to rounding for a smooth density
        first, second = np.meshgrid(*axes, indexing="ij")
        prior = np.exp(-0.5 * ((first / sigma[0]) ** 2 + (second / sigma[1]) ** 2)) / (
            2.0 * np.pi * sigma[0] * sigma[1]
        )
        values = density.pdf(self.residual.ravel() - np.stack([first, second], axis=-1) @ flat.T) * prior
        return float(np.trapezoid(np.trapezoid(values, axes[1], axis=1), axes[0]))


@pytest.mark.parametrize("other", [PriorScales(0.01, 300.0, 2.0, 0.7), PriorScales(3.0, 250.0, 0.4, 0.7)])
def test_evidence_is_the_integral_over_the_unknowns(basis: WaveBasis, other: PriorScales) -> None:
    case = _TwoUnknowns(basis)
    found = [
        log_evidences(
            case.normal(),
            case.basis,
            amplitudes=np.array([scales.amplitude_px]),
            lengths=np.array([scales.length_px]),
            lens_scales=np.array([[scales.radial_px, scales.decentering_px]]),
        )[0, 0, 0]
        for scales in (SCALES, other)
    ]
    expected = np.log([case.evidence(SCALES), case.evidence(other)])
    assert found[1] - found[0] == pytest.approx(expected[1] - expected[0], abs=1e-4)


def test_a_field_without_amplitude_leaves_weighted_least_squares(basis: WaveBasis) -> None:
    case = _Case(basis)
    found = marginal_fit(case.normal(), basis, SCALES._replace(amplitude_px=0.0))
    flat = case.rows.reshape(-1, 17) * np.sqrt(np.repeat(case.information, 2))[:, None]
    precision = prior_precision(17, SCALES.radial_px, SCALES.decentering_px)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(flat.T @ flat + np.diag(precision)), rtol=1e-6)
    np.testing.assert_allclose(found.coefficients, 0.0)
    np.testing.assert_allclose(found.cross, 0.0)


def test_the_largest_evidence_is_where_the_data_were_drawn(basis: WaveBasis) -> None:
    rng = np.random.default_rng(31)
    pixels = rng.uniform(0.0, 800.0, (150, 2))
    waves = basis.values(pixels)
    coefficients = rng.standard_normal((2, waves.shape[1])) * 0.5 * np.sqrt(basis.variances(length_px=300.0))
    residual = waves @ coefficients.T + 0.1 * rng.standard_normal((150, 2))
    normal = normal_sums(np.zeros((150, 2, 17)), waves, residual, np.full(150, 100.0), at=np.zeros(17))

    def negative(log_amplitude: FloatArray) -> float:
        found = log_evidences(
            normal,
            basis,
            amplitudes=np.exp(log_amplitude),
            lengths=np.array([300.0]),
            lens_scales=np.array([[2.0, 0.7]]),
        )
        return -float(found[0, 0, 0])

    best = float(np.exp(minimize(negative, np.zeros(1), method="Nelder-Mead").x[0]))
    assert 0.3 < best < 0.8
