"""The bins' linear equations: derivatives, residuals and the solve, against their definitions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize
from tests.fixtures.calibration import (
    numerical_derivative,
    observed,
    penalty,
    small_camera,
    small_problem,
    sun_arc,
)

from sunarc.calibration.fit.effects import add_effects
from sunarc.calibration.fit.marginal_likelihood import PriorScales, marginal_fit
from sunarc.calibration.fit.normal_equations import (
    LinearSystem,
    linear_system,
    most_probable_with_field,
    system_about,
)
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.solve.priors import LENS, precisions
from sunarc.calibration.solve.problem import Bins, FitProblem
from sunarc.optics.displacement import WaveBasis, wave_basis

FloatArray = NDArray[np.float64]

SCALES = PriorScales(0.2, 120.0, 2.0, 0.7)
BINS = Bins(member=np.arange(60) // 4, count=15)


@pytest.fixture(scope="module")
def basis() -> WaveBasis:
    return wave_basis(width=640, height=480, shortest_px=100.0, longest_px=160.0)


@pytest.fixture(scope="module")
def problem() -> FitProblem:
    return small_problem(small_camera())


@pytest.fixture(scope="module")
def seen() -> Sightings:
    return observed(small_camera(), sun_arc(60), sigma_px=0.2)


@pytest.fixture(scope="module")
def at(problem: FitProblem) -> FloatArray:
    unknowns = problem.unknowns([small_camera()])
    unknowns[17:20] += 0.002
    return unknowns


@pytest.fixture
def system(problem: FitProblem, seen: Sightings, at: FloatArray, basis: WaveBasis) -> LinearSystem:
    return linear_system(problem, seen, BINS, at, information=np.full(60, 25.0), basis=basis)


def test_a_bin_has_the_mean_residual_of_its_sightings(
    system: LinearSystem, problem: FitProblem, seen: Sightings, at: FloatArray
) -> None:
    expected = problem.residuals(at, seen).reshape(15, 4, 2).mean(axis=1)
    np.testing.assert_allclose(system.residual, expected, atol=1e-12)
    np.testing.assert_allclose(problem.residuals(at, system.observed), expected, atol=1e-9)
    np.testing.assert_allclose(system.observed.information, 100.0)


def test_the_rows_are_the_derivatives_at_the_bin_s_direction(
    system: LinearSystem, problem: FitProblem, at: FloatArray
) -> None:
    expected = numerical_derivative(lambda x: -problem.residuals(x, system.observed), at, step=1e-5)
    np.testing.assert_allclose(system.rows, expected, rtol=1e-5, atol=2e-5)


def test_the_waves_are_taken_where_the_model_sees_the_sun(system: LinearSystem, basis: WaveBasis) -> None:
    modelled = system.observed.pixels - system.residual
    np.testing.assert_allclose(system.basis_values, basis.values(modelled), atol=1e-9)
    expected = system.basis_values.T @ (system.basis_values * 100.0)
    np.testing.assert_allclose(system.basis_products.matrix, expected, rtol=1e-12)


def test_the_system_about_other_unknowns_has_their_residuals(
    system: LinearSystem, problem: FitProblem, at: FloatArray
) -> None:
    other = at.copy()
    other[18] += 0.01
    moved = system.moved(problem, other)
    np.testing.assert_allclose(moved.residual, problem.residuals(other, system.observed), atol=1e-9)
    np.testing.assert_allclose(moved.at, other)
    # the linear prediction of the residuals holds to second order
    np.testing.assert_allclose(moved.residual, system.residual - system.rows @ (other - at), atol=0.03)
    np.testing.assert_allclose(moved.basis_values, system.basis_values)


def test_the_sums_of_all_bins_are_those_of_parts_together(system: LinearSystem) -> None:
    which = np.arange(15) % 3 == 0
    whole, one, other = system.normal(), system.sum_bins(which), system.sum_bins(~which)
    np.testing.assert_allclose(one.ff.matrix + other.ff.matrix, whole.ff.matrix, rtol=1e-9)
    for name in ("jj", "jf", "jr", "fr", "rr"):
        np.testing.assert_allclose(
            getattr(one, name) + getattr(other, name), getattr(whole, name), rtol=1e-9, atol=1e-9
        )


def test_the_solve_lowers_the_penalty_to_a_stationary_point(system: LinearSystem, problem: FitProblem) -> None:
    rest = most_probable_with_field(problem, system, SCALES)
    found, waves = rest.unknowns, rest.fit.coefficients
    rested = system.moved(problem, found)
    now = penalty(rested.normal(), system.basis, SCALES)
    assert penalty(system.normal(), system.basis, SCALES) - now == pytest.approx(rest.gain)
    assert rest.gain > 0.0
    assert marginal_fit(rested.normal(), system.basis, SCALES).gain < 1e-3
    expected = marginal_fit(rested.normal(), system.basis, SCALES).coefficients
    np.testing.assert_allclose(waves, expected, atol=1e-6 * np.max(np.abs(expected)))

    def of_pose(change: FloatArray) -> float:
        other = found.copy()
        other[17:20] += 1e-4 * change
        return penalty(system.moved(problem, other).normal(), system.basis, SCALES)

    lowest = minimize(of_pose, np.zeros(3), method="Nelder-Mead", options={"maxiter": 80})
    assert lowest.fun > now - 2e-3


@pytest.mark.parametrize("amplitude_px", [1e-3, 0.2, 5.0])
@pytest.mark.parametrize("off", [0.0, 0.02, 0.3])
def test_where_a_solve_ends_its_fit_is_the_linear_one(
    system: LinearSystem, problem: FitProblem, at: FloatArray, amplitude_px: float, off: float
) -> None:
    begin = at.copy()
    begin[17:20] += [off, 0.0, -off]
    system, scales = system.moved(problem, begin), SCALES._replace(amplitude_px=amplitude_px)
    found = most_probable_with_field(problem, system, scales)
    there = system.moved(problem, found.unknowns).normal()
    lost = penalty(system.normal(), system.basis, scales) - penalty(there, system.basis, scales)
    assert found.gain == pytest.approx(lost, rel=1e-7, abs=1e-9)
    fit = marginal_fit(there, system.basis, scales)
    assert fit.gain < 1e-2  # of twice the log posterior; the solve stops at a thousandth of the cost
    sigma = np.sqrt(np.diag(fit.covariance))
    assert np.max(np.abs(found.fit.covariance - fit.covariance) / np.outer(sigma, sigma)) < 1e-6
    assert np.max(np.abs(found.fit.unknowns - fit.unknowns) / sigma) < 1e-6
    np.testing.assert_allclose(found.fit.coefficients, fit.coefficients, atol=1e-5 * np.max(np.abs(fit.coefficients)))
    np.testing.assert_allclose(found.fit.cross, fit.cross, atol=1e-5 * np.max(np.abs(fit.cross)))


def test_a_solve_from_its_own_answer_stays(system: LinearSystem, problem: FitProblem) -> None:
    found = most_probable_with_field(problem, system, SCALES).unknowns
    again = most_probable_with_field(problem, system.moved(problem, found), SCALES)
    np.testing.assert_array_equal(again.unknowns, found)
    assert again.gain == 0.0


@pytest.mark.parametrize("off", [0.02, 0.3])
def test_a_start_far_off_is_brought_back(system: LinearSystem, problem: FitProblem, at: FloatArray, off: float) -> None:
    begin = at.copy()
    begin[17:20] += [off, 0.0, -off]
    found = most_probable_with_field(problem, system.moved(problem, begin), SCALES).unknowns
    near = most_probable_with_field(problem, system, SCALES).unknowns
    costs = [penalty(system.moved(problem, one).normal(), system.basis, SCALES) for one in (found, near, begin)]
    assert costs[0] < 0.01 * costs[2]
    if off < 0.1:
        assert costs[0] == pytest.approx(costs[1], abs=0.05)


def test_unknown_air_is_among_the_equations(problem: FitProblem, seen: Sightings, basis: WaveBasis) -> None:
    at = problem.unknowns([small_camera()])
    with_air, observed = add_effects(problem, at, replace(seen, refraction_sd=np.full((60, 1), 1e-3)))
    with_air, _ = with_air.only({"air"})
    unknowns = with_air.unknowns([small_camera()])
    system = linear_system(with_air, observed, BINS, unknowns, information=np.ones(60), basis=basis)
    assert system.n_unit == 1
    assert system.normal().prior_precision(1.0, 1.0)[-1] == 1.0
    assert system.rows.shape == (15, 2, 21)
    # a rise by 1 mrad moves the image by about the focal length over 1000
    assert 0.1 < np.max(np.linalg.norm(system.rows[..., -1], axis=-1)) < 0.3


def test_coverage_of_the_stated_95_percent_of_a_small_fit(problem: FitProblem, basis: WaveBasis) -> None:
    """Lenses drawn from the prior, 40 noisy arcs: the pose's stated error is neither too small nor too large."""
    camera, directions = small_camera(), sun_arc(60)
    scales = PriorScales(1e-4, 120.0, 2.0, 0.7)
    narrow = problem.prior.basis / np.sqrt(precisions(2.0, 0.7))
    rng = np.random.default_rng(2)
    inside = []
    for _ in range(40):
        z = np.where(np.arange(17) < 13, 0.1, 0.0) * rng.standard_normal(17)
        vector = camera.to_vector()
        vector[LENS] += narrow @ z
        drawn = camera.replace_parameters(vector)
        prior = replace(problem.prior, mean=camera.to_vector()[LENS], basis=0.1 * narrow)
        here = replace(problem, prior=prior)
        begin = here.unknowns([camera])
        seen = observed(drawn, directions, sigma_px=0.2, seed=int(rng.integers(1 << 30)))
        system = linear_system(here, seen, BINS, begin, information=np.full(60, 25.0), basis=basis)
        found = most_probable_with_field(here, system, scales._replace(radial_px=1.0, decentering_px=1e-3)).unknowns
        fit = marginal_fit(
            system.moved(here, found).normal(), basis, scales._replace(radial_px=1.0, decentering_px=1e-3)
        )
        off = (found - begin)[17:20]
        inside.append(np.abs(off) < 1.96 * np.sqrt(np.diag(fit.covariance)[17:20]))
    assert 0.88 < np.mean(inside) < 0.995


@pytest.mark.parametrize(("turned", "shared"), [(1e-5, True), (1e-3, False)])
def test_equations_nearby_share_the_field_s_products_and_others_do_not(
    system: LinearSystem, problem: FitProblem, at: FloatArray, *, turned: float, shared: bool
) -> None:
    other = at.copy()
    other[17] += turned
    bins = Bins(member=np.arange(len(system.observed)), count=len(system.observed))
    found = system_about(problem, system.observed, bins, system, other)
    assert (found.basis_products is system.basis_products) == shared
    expected = linear_system(
        problem, system.observed, bins, other, information=system.observed.information, basis=system.basis
    )
    np.testing.assert_allclose(found.residual, expected.residual, atol=1e-9)
    np.testing.assert_allclose(found.rows, expected.rows, rtol=1e-9, atol=1e-7)
    np.testing.assert_allclose(found.basis_values, expected.basis_values, atol=1e-3 * np.max(expected.basis_values))


@pytest.mark.parametrize("amplitude_px", [1e-6, 1e-5, 0.2, 1e4])
def test_axes_of_which_sightings_tell_nothing_are_left_out(system: LinearSystem, amplitude_px: float) -> None:
    scales = SCALES._replace(amplitude_px=amplitude_px)
    own, transform = system.in_field_axes(scales)
    axes = system.basis_products.axes(system.basis, scales.length_px)
    told = amplitude_px**2 * axes.information > 1e-14
    np.testing.assert_array_equal(transform, axes.transform[:, told])
    np.testing.assert_allclose(own.basis_values, system.basis_values @ axes.transform[:, told])
    np.testing.assert_allclose(np.diag(own.basis_products.matrix), axes.information[told])
