"""What p3 and p4 leave open beside p1 and p2: all of these integrated out, beside a Gaussian about the fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.calibration import observed, small_camera, small_problem, sun_arc

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.fit.marginal_likelihood import PriorScales, marginal_fit, scale_grid
from sunarc.calibration.fit.normal_equations import LinearSystem, linear_system
from sunarc.calibration.fit.posterior import decentering_covariance
from sunarc.calibration.solve.priors import DECENTERING, HIGHER
from sunarc.calibration.solve.problem import Bins, FitProblem

FloatArray = NDArray[np.float64]
SCALES = PriorScales(0.01, 120.0, 2.0, 0.7)
WHOLE = scale_grid(width=640, height=480, floor_px=0.01, radial_px=2.0, decentering_px=0.7)
GRID = replace(WHOLE, lens_scales=np.array([SCALES[2:]]), log_prior=np.zeros_like(WHOLE.log_prior[..., :1]))


@pytest.fixture(scope="module")
def problem() -> FitProblem:
    return small_problem(small_camera())


@pytest.fixture(scope="module")
def system(problem: FitProblem) -> LinearSystem:
    return _system(problem, decentering=(1.5e-4, -1.9e-4, 0.0, 0.0), information=400.0)


def _system(
    problem: FitProblem,
    *,
    decentering: tuple[float, float, float, float],
    information: float,
    widest_deg: float = 40.0,
    seed: int = 5,
) -> LinearSystem:
    at = problem.unknowns([replace(small_camera(), decentering=decentering)])
    arc = sun_arc(60, widest_deg=widest_deg)
    seen = observed(problem.camera(at), arc, sigma_px=information**-0.5, seed=seed)
    bins = Bins(member=np.arange(60) // 4, count=15)
    return linear_system(problem, seen, bins, at, information=np.full(60, information), basis=GRID.basis)


def test_products_only_add_to_the_covariance(system: LinearSystem, problem: FitProblem) -> None:
    found = decentering_covariance(problem, system, SCALES, GRID)
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
    size = np.max(np.abs(decentering_covariance(problem, system, SCALES, GRID)))
    assert np.max(np.abs(decentering_covariance(known, moved, SCALES, GRID))) < 1e-7 * size


def test_with_it_the_stated_error_is_that_of_draws(problem: FitProblem) -> None:
    """p1 to p4 are drawn from their prior, and weighed by how well the best lens and pose with them meets the sun.

    Of a fit whose p1 and p2 are near 0: what p3 and p4 do is hardly in its derivatives.
    """
    four = np.r_[DECENTERING, HIGHER]
    system = _system(problem, decentering=(0.0, 0.0, 0.0, 0.0), information=25.0, widest_deg=75.0, seed=3)
    for _ in range(8):
        system = system.moved(problem, marginal_fit(system.normal(), system.basis, SCALES).unknowns)
    others, sky = np.setdiff1d(np.arange(system.at.size), four), observed(small_camera(), hemisphere(80))
    rows = system.rows[..., others].reshape(-1, others.size)
    precision = system.normal().prior_precision(SCALES.radial_px, SCALES.decentering_px)
    information, prior = np.repeat(system.observed.information, 2), precision[others]
    covariance = np.linalg.inv(rows.T @ (rows * information[:, None]) + np.diag(prior))
    before, every = problem.linearised(system.at, sky)
    by_others = every[..., others].reshape(-1, others.size)
    costs, shifts = [], []
    for drawn in np.random.default_rng(5).standard_normal((3000, 4)) / np.sqrt(precision[four]):
        at = system.at.copy()
        at[four] = drawn
        residual = problem.residuals(at, system.observed).ravel()
        step = covariance @ (rows.T @ (information * residual) - prior * at[others])
        costs.append(information @ (residual - rows @ step) ** 2 + prior @ (at[others] + step) ** 2)
        shifts.append((before - problem.residuals(at, sky)).ravel() + by_others @ step)
    weight = np.exp(-0.5 * (np.array(costs) - np.min(costs)))
    assert weight.sum() ** 2 / np.sum(weight**2) > 200.0
    expected = weight @ np.sum(np.square(shifts), axis=1) / weight.sum() + np.sum((by_others @ covariance) * by_others)
    alone = marginal_fit(system.normal(), system.basis, SCALES).covariance
    by_all = every.reshape(-1, system.at.size)
    square = [np.sum((by_all @ one) * by_all) for one in (alone, decentering_covariance(problem, system, SCALES, GRID))]
    assert square[0] < 0.9 * expected
    assert sum(square) == pytest.approx(expected, rel=0.1)
