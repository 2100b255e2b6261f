"""Integration over p3 and p4: the excess over the Gaussian is positive, and nothing where they are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.calibration import observed, random_covariance, small_camera, small_problem, sun_arc

from sunarc.calibration.fit import posterior as module
from sunarc.calibration.fit.marginal_likelihood import Scales, marginal_fit, penalty
from sunarc.calibration.fit.normal_equations import (
    LinearSystem,
    converged_in_axes,
    linear_system,
    most_probable_with_field,
)
from sunarc.calibration.fit.posterior import BilinearSums, PosteriorCovariance, mixed_over_decentering
from sunarc.calibration.model.residual_field import Field, wave_basis
from sunarc.calibration.solve.problem import Bins, FitProblem

FloatArray = NDArray[np.float64]

SCALES = Scales(0.01, 120.0, 2.0, 0.7)
HIGHER = [15, 16]


@pytest.fixture(scope="module")
def problem() -> FitProblem:
    return small_problem(small_camera())


@pytest.fixture(scope="module")
def at(problem: FitProblem) -> FloatArray:
    return problem.unknowns([replace(small_camera(), decentering=(1.5e-3, -1.9e-3, 0.0, 0.0))])


@pytest.fixture(scope="module")
def system(problem: FitProblem, at: FloatArray) -> LinearSystem:
    basis = wave_basis(width=640, height=480, shortest_px=120.0, longest_px=160.0)
    seen = observed(problem.camera(at), sun_arc(60, widest_deg=40.0), sigma_px=0.05)
    bins = Bins(member=np.arange(60) // 4, count=15)
    return linear_system(problem, seen, bins, at, information=np.full(60, 400.0), basis=basis)


@pytest.fixture(scope="module")
def fitted(problem: FitProblem) -> LinearSystem:
    """Return the equations about the fit of a lens of 0.1 px of decentering, over which all else is linear."""
    start = problem.unknowns([replace(small_camera(), decentering=(1.5e-4, -1.9e-4, 0.0, 0.0))])
    basis = wave_basis(width=640, height=480, shortest_px=120.0, longest_px=160.0)
    seen = observed(problem.camera(start), sun_arc(60), sigma_px=0.05)
    bins = Bins(member=np.arange(60) // 4, count=15)
    whole = linear_system(problem, seen, bins, start, information=np.full(60, 400.0), basis=basis)
    return whole.moved(problem, most_probable_with_field(problem, whole, SCALES).unknowns)


def _posterior(system: LinearSystem) -> PosteriorCovariance:
    fit = marginal_fit(system.normal(), system.basis, SCALES)
    field = Field(amplitude_px=0.01, length_px=120.0, basis=system.basis, cross=fit.cross)
    return PosteriorCovariance(fit.covariance, field)


def test_known_coefficients_leave_the_covariance_as_it_is(
    system: LinearSystem, problem: FitProblem, at: FloatArray
) -> None:
    posterior = _posterior(system)
    known = posterior.covariance.copy()
    known[HIGHER] = known[:, HIGHER] = 0.0
    known[HIGHER, HIGHER] = 0.149**2  # in units of the prior's 1-sigma
    given = posterior._replace(covariance=known)
    assert mixed_over_decentering(given, problem, system, at, SCALES) is given


def test_unknown_coefficients_only_add_to_the_covariance(
    system: LinearSystem, problem: FitProblem, at: FloatArray
) -> None:
    posterior = _posterior(system)
    assert np.sqrt(np.max(np.diag(posterior.covariance)[HIGHER])) > 0.15
    mixed = mixed_over_decentering(posterior, problem, system, at, SCALES)
    excess = mixed.covariance - posterior.covariance
    scale = np.sqrt(np.diag(posterior.covariance))
    assert np.min(np.linalg.eigvalsh(excess / np.outer(scale, scale))) > -1e-6
    assert mixed.field is posterior.field


def test_the_places_hold_nearly_all_of_the_prior() -> None:
    places = module.NODES
    assert places.shape == (25, 2)
    mass = np.exp(-0.5 * np.sum(places**2, axis=-1)) * np.exp(module.CELL)
    assert 0.96 < mass.sum() < 1.0


def _held_at(problem: FitProblem, place: FloatArray) -> FitProblem:
    """Return the problem with p3 and p4 known: in its prior's mean, and no longer in its basis."""
    basis = problem.prior.basis.copy()
    mean = problem.prior.mean + basis[:, HIGHER] @ place
    basis[:, HIGHER] = 0.0
    return replace(problem, prior=replace(problem.prior, mean=mean, basis=basis))


@pytest.mark.parametrize("place", [(0.0, 0.0), (1.0, -2.0), (-2.0, 2.0)])
def test_a_conditional_fit_is_that_of_the_lens_with_p3_and_p4_known(
    fitted: LinearSystem, problem: FitProblem, place: tuple[float, float]
) -> None:
    """Against Gauss-Newton on the whole lens, whose prior has p3 and p4 at the place."""
    at = fitted.at
    in_axes, transform = fitted.in_field_axes(SCALES)
    held = np.array(place)
    start = at.copy()
    start[HIGHER] = 0.0
    expected = converged_in_axes(_held_at(problem, held), in_axes, SCALES, start)
    sums = BilinearSums.about(problem, fitted, at, SCALES)
    found, free = sums.conditional(held[None]), sums.free()
    np.testing.assert_allclose(found.shift[0, HIGHER], held - at[HIGHER])
    assert np.all(found.covariance[0, HIGHER] == 0.0)
    others = np.setdiff1d(np.arange(at.size), HIGHER)
    inner = np.ix_(others, others)
    sigma = np.sqrt(np.diag(expected.fit.covariance))[others]
    assert np.max(np.abs(at + found.shift[0] - expected.fit.unknowns)[others] / sigma) < 0.1
    np.testing.assert_allclose(
        found.covariance[0][inner] / np.outer(sigma, sigma),
        expected.fit.covariance[inner] / np.outer(sigma, sigma),
        atol=0.05,
    )
    about = converged_in_axes(problem, in_axes, SCALES, at, steps=0)
    gain = float(found.log_evidence[0] - free.log_evidence[0])
    assert gain == pytest.approx(expected.log_evidence - about.log_evidence, abs=0.02)
    coefficients = found.coefficients[0]
    wanted = expected.fit.with_coefficients_on(transform)
    np.testing.assert_allclose(
        coefficients, wanted.coefficients, atol=0.04 * float(np.max(np.abs(wanted.coefficients)))
    )


def test_the_free_fit_is_the_marginal_fit(fitted: LinearSystem, problem: FitProblem) -> None:
    at = fitted.at
    found = BilinearSums.about(problem, fitted, at, SCALES).free()
    expected = marginal_fit(fitted.normal(), fitted.basis, SCALES)
    sigma = np.sqrt(np.diag(expected.covariance))
    assert np.max(np.abs(at + found.shift[0] - expected.unknowns) / sigma) < 1e-6
    assert np.max(np.abs(found.covariance[0] - expected.covariance) / np.outer(sigma, sigma)) < 1e-6


def test_the_fits_of_the_whole_lens_are_the_linear_ones_where_it_is_linear(
    fitted: LinearSystem, problem: FitProblem
) -> None:
    sums = BilinearSums.about(problem, fitted, fitted.at, SCALES)
    linear, whole = sums.conditional(module.NODES), module.of_whole_lens(problem, fitted, fitted.at, SCALES)
    share, expected = (module.shares(sums.free(), one) for one in (linear, whole))
    np.testing.assert_allclose(share, expected, atol=0.01)
    for name in ("shift", "covariance", "coefficients", "cross"):
        found, wanted = (np.tensordot(of, getattr(one, name), 1) for of, one in ((share, linear), (expected, whole)))
        np.testing.assert_allclose(found, wanted, atol=0.1 * float(np.max(np.abs(wanted))))
    assert np.all(whole.covariance[:, HIGHER] == 0.0)
    assert np.all(whole.cross[:, :, HIGHER] == 0.0)


def test_a_linear_fit_is_doubted_where_the_whole_lens_is_less_probable(
    fitted: LinearSystem, system: LinearSystem, problem: FitProblem, at: FloatArray
) -> None:
    """A lens of 0.1 px of decentering is linear about its fit; one of 1 px, from a start that is off, is not."""
    sums = BilinearSums.about(problem, fitted, fitted.at, SCALES)
    nodes = sums.conditional(module.NODES)
    none = sums.free()
    assert sums.true_penalty(problem, fitted, np.zeros(fitted.at.size)) == pytest.approx(
        penalty(fitted.normal(), fitted.basis, SCALES) - float(np.sum(fitted.at[HIGHER] ** 2)), rel=1e-9
    )
    assert module.is_linear(sums, problem, fitted, nodes, module.shares(none, nodes))
    sums = BilinearSums.about(problem, system, at, SCALES)
    nodes = sums.conditional(module.NODES)
    assert not module.is_linear(sums, problem, system, nodes, np.ones(25))


def test_a_fit_far_beyond_the_places_is_mixed_by_fits_of_the_whole_lens(
    fitted: LinearSystem, problem: FitProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    far = fitted.at.copy()
    far[15] = 3.1
    system = fitted.moved(problem, far)
    sums = BilinearSums.about(problem, system, far, SCALES)
    assert not module.is_linear(sums, problem, system, sums.conditional(module.NODES), np.zeros(25))
    mixed = mixed_over_decentering(_posterior(system), problem, system, far, SCALES)
    monkeypatch.setattr(module, "is_linear", lambda *_: False)
    again = mixed_over_decentering(_posterior(system), problem, system, far, SCALES)
    np.testing.assert_array_equal(mixed.covariance, again.covariance)


def test_the_mean_of_the_conditional_evidences_is_about_the_free_one(
    system: LinearSystem, problem: FitProblem, at: FloatArray
) -> None:
    """Where the sightings hardly depend on p3 and p4, integrating them out on the grid changes nothing."""
    small = at.copy()
    small[13:15] = 0.0  # without p1 and p2, p3 and p4 have no effect
    sums = BilinearSums.about(problem, system.moved(problem, small), small, SCALES)
    places = sums.conditional(module.NODES).log_evidence - 0.5 * np.sum(module.NODES**2, axis=1) + module.CELL
    assert float(np.logaddexp.reduce(places)) == pytest.approx(float(sums.free().log_evidence[0]), abs=2.0)


def test_the_positive_part_keeps_what_adds_and_drops_what_takes() -> None:
    reference = random_covariance(4, seed=1)
    root = np.linalg.cholesky(reference)
    turn = np.linalg.qr(np.random.default_rng(2).standard_normal((4, 4)))[0]
    shape = root @ turn
    excess = (shape * np.array([3.0, 0.5, -0.4, -2.0])) @ shape.T
    expected = (shape * np.array([3.0, 0.5, 0.0, 0.0])) @ shape.T
    part, projection = module.positive_part(excess, reference)
    np.testing.assert_allclose(part, expected, atol=1e-8)
    np.testing.assert_allclose(projection @ excess, expected, atol=1e-8)
    np.testing.assert_allclose(projection @ projection, projection, atol=1e-8)
