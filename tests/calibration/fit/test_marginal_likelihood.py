"""The marginalised fit against dense Gaussian algebra, the oracle."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import multivariate_normal

from sunarc.calibration.fit.marginal_likelihood import (
    NormalEquations,
    Scales,
    log_evidences,
    marginal_fit,
    normal_sums,
    prior_precision,
)
from sunarc.calibration.model.residual_field import WaveBasis, wave_basis

FloatArray = NDArray[np.float64]

SCALES = Scales(0.4, 300.0, 2.0, 0.7)


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
        self.waves = basis.values(self.pixels)

    def normal(self) -> NormalEquations:
        return normal_sums(self.rows, self.waves, self.residual, self.information, at=self.at)


def _kernel(a: FloatArray, b: FloatArray, scales: Scales) -> FloatArray:
    square = np.sum((a[:, None] - b[None]) ** 2, axis=-1)
    return np.asarray(scales.amplitude_px**2 * np.exp(-0.5 * square / scales.length_px**2))


def test_waves_make_the_squared_exponential_kernel(basis: WaveBasis) -> None:
    pixels = np.random.default_rng(1).uniform([0.0, 0.0], [1000.0, 800.0], (60, 2))
    for length in (250.0, 320.0, 400.0):
        scales = Scales(1.0, length, 1.0, 1.0)
        waves = basis.values(pixels)
        made = (waves * basis.variances(length_px=length)) @ waves.T
        np.testing.assert_allclose(made, _kernel(pixels, pixels, scales), atol=0.06)


def test_evidence_differs_between_scales_as_the_dense_gaussian_does(basis: WaveBasis) -> None:
    case = _Case(basis)
    amplitudes, lengths = np.array([0.01, 0.4]), np.array([300.0])
    lens = np.array([[2.0, 0.7], [4.0, 1.4]])
    found = log_evidences(case.normal(), basis, amplitudes=amplitudes, lengths=lengths, lens_scales=lens)
    dense = np.array([[_dense(case, basis, Scales(a, 300.0, r, d)) for r, d in lens] for a in amplitudes])
    np.testing.assert_allclose(found[:, 0] - found[0, 0, 0], dense - dense[0, 0], atol=1e-6)


def _dense(case: _Case, basis: WaveBasis, scales: Scales) -> float:
    """Return the log density of the residuals under prior, field and noise together."""
    variance = 1.0 / prior_precision(case.at.size, scales.radial_px, scales.decentering_px)
    flat = case.rows.reshape(-1, case.at.size)
    field = (case.waves * scales.amplitude_px**2 * basis.variances(length_px=scales.length_px)) @ case.waves.T
    covariance = (flat * variance) @ flat.T + np.kron(field, np.eye(2)) + np.diag(np.repeat(1 / case.information, 2))
    mean = -flat @ case.at  # the prior is about 0, the residuals were taken at `at`
    return float(multivariate_normal(mean, covariance).logpdf(case.residual.ravel()))


def test_marginal_fit_is_generalised_least_squares(basis: WaveBasis) -> None:
    case = _Case(basis)
    found = marginal_fit(case.normal(), basis, SCALES)
    precision = prior_precision(case.at.size, SCALES.radial_px, SCALES.decentering_px)
    prior_waves = SCALES.amplitude_px**2 * basis.variances(length_px=SCALES.length_px)
    field = (case.waves * prior_waves) @ case.waves.T
    weight = np.linalg.inv(np.kron(field, np.eye(2)) + np.diag(np.repeat(1.0 / case.information, 2)))
    flat = case.rows.reshape(-1, case.at.size)
    normal = flat.T @ weight @ flat + np.diag(precision)
    step = np.linalg.solve(normal, flat.T @ weight @ case.residual.ravel() - precision * case.at)
    np.testing.assert_allclose(found.unknowns, case.at + step, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(normal), rtol=1e-5, atol=1e-9)
    # Cov(θ, c) = -C J' W Φ Λ, for each component of the field
    x_rows = np.kron(case.waves * prior_waves, [[1.0], [0.0]])
    cross = -np.linalg.inv(normal) @ flat.T @ weight @ x_rows
    np.testing.assert_allclose(found.cross[0], cross, rtol=1e-5, atol=1e-7)
