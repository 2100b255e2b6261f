"""What p3 and p4 leave open beside p1 and p2: their products as further unknowns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.calibration import observed, small_camera, small_problem, sun_arc

from sunarc.calibration.fit.marginal_likelihood import Scales, marginal_fit
from sunarc.calibration.fit.normal_equations import LinearSystem, linear_system
from sunarc.calibration.fit.posterior import of_products
from sunarc.calibration.model.residual_field import wave_basis
from sunarc.calibration.solve.priors import DECENTERING, HIGHER
from sunarc.calibration.solve.problem import Bins, FitProblem

FloatArray = NDArray[np.float64]
SCALES = Scales(0.01, 120.0, 2.0, 0.7)


@pytest.fixture(scope="module")
def problem() -> FitProblem:
    return small_problem(small_camera())


@pytest.fixture(scope="module")
def system(problem: FitProblem) -> LinearSystem:
    at = problem.unknowns([replace(small_camera(), decentering=(1.5e-4, -1.9e-4, 0.0, 0.0))])
    basis = wave_basis(width=640, height=480, shortest_px=120.0, longest_px=160.0)
    seen = observed(problem.camera(at), sun_arc(60, widest_deg=40.0), sigma_px=0.05)
    bins = Bins(member=np.arange(60) // 4, count=15)
    return linear_system(problem, seen, bins, at, information=np.full(60, 400.0), basis=basis)


def test_products_only_add_to_the_covariance(system: LinearSystem, problem: FitProblem) -> None:
    found = of_products(problem, system, SCALES)
    np.testing.assert_allclose(found, found.T, atol=1e-15)
    scale = np.sqrt(np.diag(marginal_fit(system.normal(), system.basis, SCALES).covariance))
    values = np.linalg.eigvalsh(found / np.outer(scale, scale))
    assert np.min(values) > -1e-9
    assert np.max(values) > 1e-3


def test_p3_and_p4_that_are_known_add_nothing(problem: FitProblem, system: LinearSystem) -> None:
    basis = problem.prior.basis.copy()
    basis[:, HIGHER] *= 1e-6
    known = replace(problem, prior=replace(problem.prior, basis=basis))
    moved = system.moved(known, system.at)
    size = np.max(np.abs(of_products(problem, system, SCALES)))
    assert np.max(np.abs(of_products(known, moved, SCALES))) < 1e-9 * size


def test_it_is_the_share_of_second_order_in_draws(problem: FitProblem, system: LinearSystem) -> None:
    """Errors of p1 to p4 are drawn, and what a linear fit makes of the displacements by their products."""
    fit = marginal_fit(system.normal(), system.basis, SCALES)
    four = np.r_[DECENTERING, HIGHER]
    root = np.linalg.cholesky(fit.covariance[np.ix_(four, four)])
    rng = np.random.default_rng(5)
    errors = rng.standard_normal((400, 4)) @ root.T
    second = np.array([problem.residuals(system.at + _at(system, four, e), system.observed) for e in errors])
    linear = system.residual - np.einsum("bap,kp->kba", system.rows[..., four], errors)
    weighed = (second - linear) * system.observed.information[:, None]
    pulls = np.einsum("kba,bap->kp", weighed, system.rows)
    shifts = pulls @ fit.covariance
    found = np.sqrt(np.diag(of_products(problem, system, SCALES)))
    ratio = found[:5] / np.sqrt(np.mean(shifts[:, :5] ** 2, axis=0))
    assert np.all((ratio > 0.5) & (ratio < 1.5))


def _at(system: LinearSystem, places: NDArray[np.int64], change: FloatArray) -> FloatArray:
    result = np.zeros(system.at.size)
    result[places] = change
    return result
