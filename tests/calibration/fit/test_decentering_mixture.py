"""Integration over p3 and p4: the excess over the Gaussian is positive, and nothing where they are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.calibration import observed, random_covariance, small_camera, small_problem, sun_arc

from sunarc.calibration.fit import decentering_mixture as module
from sunarc.calibration.fit.decentering_mixture import mixed_over_decentering
from sunarc.calibration.fit.hyperparameter_marginalisation import PosteriorCovariance
from sunarc.calibration.fit.marginal_likelihood import Scales, marginal_fit
from sunarc.calibration.fit.normal_equations import LinearSystem, converged_in_axes, linear_system
from sunarc.calibration.least_squares.problem import Problem
from sunarc.calibration.least_squares.time_bins import Bins
from sunarc.calibration.model.residual_field import Field, wave_basis

FloatArray = NDArray[np.float64]

SCALES = Scales(0.01, 120.0, 2.0, 0.7)
HIGHER = [15, 16]
NO_FIELD = np.zeros((2, 1))


@pytest.fixture(scope="module")
def problem() -> Problem:
    return small_problem(small_camera())


@pytest.fixture(scope="module")
def at(problem: Problem) -> FloatArray:
    return problem.unknowns([replace(small_camera(), decentering=(1.5e-3, -1.9e-3, 0.0, 0.0))])


@pytest.fixture(scope="module")
def system(problem: Problem, at: FloatArray) -> LinearSystem:
    basis = wave_basis(width=640, height=480, shortest_px=120.0, longest_px=160.0)
    seen = observed(problem.camera(at), sun_arc(60, widest_deg=40.0), sigma_px=0.05)
    bins = Bins(member=np.arange(60) // 4, count=15)
    return linear_system(problem, seen, bins, at, information=np.full(60, 400.0), basis=basis)


def _posterior(system: LinearSystem) -> PosteriorCovariance:
    fit = marginal_fit(system.normal(), system.basis, SCALES)
    field = Field(amplitude_px=0.01, length_px=120.0, basis=system.basis, cross=fit.cross)
    return PosteriorCovariance(fit.covariance, field)


def test_known_coefficients_leave_the_covariance_as_it_is(
    system: LinearSystem, problem: Problem, at: FloatArray
) -> None:
    posterior = _posterior(system)
    known = posterior.covariance.copy()
    known[HIGHER] = known[:, HIGHER] = 0.0
    known[HIGHER, HIGHER] = 0.149**2  # in units of the prior's 1-sigma
    given = posterior._replace(covariance=known)
    assert mixed_over_decentering(given, problem, system, at, SCALES) is given


def test_unknown_coefficients_only_add_to_the_covariance(
    system: LinearSystem, problem: Problem, at: FloatArray
) -> None:
    posterior = _posterior(system)
    assert np.sqrt(np.max(np.diag(posterior.covariance)[HIGHER])) > 0.15
    mixed = mixed_over_decentering(posterior, problem, system, at, SCALES)
    excess = mixed.covariance - posterior.covariance
    scale = np.sqrt(np.diag(posterior.covariance))
    assert np.min(np.linalg.eigvalsh(excess / np.outer(scale, scale))) > -1e-6
    assert mixed.field is posterior.field


def test_the_places_hold_nearly_all_of_the_prior() -> None:
    places = np.array(module._NODES)
    assert places.shape == (25, 2)
    mass = np.exp(-0.5 * np.sum(places**2, axis=-1)) * np.exp(module._CELL)
    assert 0.96 < mass.sum() < 1.0


def test_a_conditional_fit_has_p3_and_p4_where_they_are_held(
    system: LinearSystem, problem: Problem, at: FloatArray
) -> None:
    found = module._conditional(problem, system.in_field_axes(SCALES), at, (1.0, -2.0), SCALES, NO_FIELD)
    expected = np.outer([1.0 - at[15], -2.0 - at[16]], [1.0 - at[15], -2.0 - at[16]])
    np.testing.assert_allclose(found.moments[np.ix_(HIGHER, HIGHER)], expected, atol=1e-12)


def test_the_mean_of_the_conditional_evidences_is_about_the_free_one(
    system: LinearSystem, problem: Problem, at: FloatArray
) -> None:
    """Where the sightings hardly depend on p3 and p4, integrating them out on the grid changes nothing."""
    small = at.copy()
    small[13:15] = 0.0  # without p1 and p2, p3 and p4 have no effect
    in_axes = system.moved(problem, small).in_field_axes(SCALES)
    places = [
        module._conditional(problem, in_axes, small, place, SCALES, NO_FIELD).log_evidence for place in module._NODES
    ]
    total = float(np.logaddexp.reduce(places))
    free = converged_in_axes(problem, in_axes[0], SCALES, small, steps=0)
    assert total == pytest.approx(free.log_evidence, abs=2.0)


def test_the_positive_part_keeps_what_adds_and_drops_what_takes() -> None:
    reference = random_covariance(4, seed=1)
    root = np.linalg.cholesky(reference)
    turn = np.linalg.qr(np.random.default_rng(2).standard_normal((4, 4)))[0]
    shape = root @ turn
    excess = (shape * np.array([3.0, 0.5, -0.4, -2.0])) @ shape.T
    expected = (shape * np.array([3.0, 0.5, 0.0, 0.0])) @ shape.T
    part, projection = module._positive_part(excess, reference)
    np.testing.assert_allclose(part, expected, atol=1e-8)
    np.testing.assert_allclose(projection @ excess, expected, atol=1e-8)
    np.testing.assert_allclose(projection @ projection, projection, atol=1e-8)
