"""What sightings tell of the field: against the joint posterior of parameters and coefficients, by its definition."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.calibration import observed, small_camera, small_problem, spread_directions, sun_arc

from sunarc.calibration.fit.marginal_likelihood import PriorScales, field_at, marginal_fit
from sunarc.calibration.fit.normal_equations import LinearSystem, linear_system
from sunarc.calibration.fit.posterior import prediction_variance, seen_field
from sunarc.calibration.model.residual_field import Field
from sunarc.calibration.solve.problem import Bins, FitProblem
from sunarc.optics.displacement import wave_basis

FloatArray = NDArray[np.float64]

SCALES = PriorScales(0.3, 120.0, 2.0, 0.7)
COUNT = 60


@pytest.fixture(scope="module")
def problem() -> FitProblem:
    return small_problem(small_camera())


@pytest.fixture(scope="module")
def system(problem: FitProblem) -> LinearSystem:
    basis = wave_basis(width=640, height=480, shortest_px=120.0, longest_px=120.0)
    seen = observed(small_camera(), sun_arc(COUNT, widest_deg=60.0), sigma_px=0.05)
    bins = Bins(member=np.arange(COUNT), count=COUNT)
    at = problem.unknowns([small_camera()])
    return linear_system(problem, seen, bins, at, information=np.full(COUNT, 400.0), basis=basis)


class Joint:
    """The posterior of parameters and coefficients together: inverse of the sum of all information."""

    def __init__(self, system: LinearSystem) -> None:
        normal, m = system.normal(), len(system.basis.orders)
        self.size = normal.at.size
        values = system.basis_values
        self.rows = [
            np.concatenate([row, phi, np.zeros(m)] if a == 0 else [row, np.zeros(m), phi])
            for both, phi in zip(system.rows, values, strict=True)
            for a, row in enumerate(both)
        ]
        design = np.array(self.rows)
        weight = np.repeat(system.observed.information, 2)
        variances = SCALES.amplitude_px**2 * system.basis.variances(length_px=SCALES.length_px)
        prior = np.concatenate(
            [normal.prior_precision(SCALES.radial_px, SCALES.decentering_px), np.tile(1 / variances, 2)]
        )
        # in units of the prior's sigmas: else the inverse loses its digits
        scale = 1.0 / np.sqrt(prior)
        scaled = design * scale
        precision = scaled.T @ (scaled * weight[:, None]) + np.eye(scale.size)
        self.covariance = np.linalg.inv(precision) * np.outer(scale, scale)
        pull = design.T @ (weight * system.residual.ravel())
        pull[: self.size] -= prior[: self.size] * normal.at
        self.mean = self.covariance @ pull


@pytest.fixture(scope="module")
def joint(system: LinearSystem) -> Joint:
    return Joint(system)


@pytest.fixture(scope="module")
def field(system: LinearSystem) -> Field:
    fit = marginal_fit(system.normal(), system.basis, SCALES)
    unseen = Field(amplitude_px=SCALES.amplitude_px, length_px=SCALES.length_px, basis=system.basis, cross=fit.cross)
    return seen_field(unseen, system.normal(), fit.covariance)


def test_the_mean_beside_the_best_parameters_is_the_joint_mean(system: LinearSystem, joint: Joint) -> None:
    fit = marginal_fit(system.normal(), system.basis, SCALES)
    values = system.basis_values
    expected = joint.mean[joint.size :].reshape(2, -1)
    np.testing.assert_allclose(fit.coefficients @ values.T, expected @ values.T, atol=1e-6)
    np.testing.assert_allclose(fit.unknowns - system.at, joint.mean[: joint.size], atol=1e-6)


def test_the_mean_where_the_parameters_are_is_that_of_the_residuals_alone(system: LinearSystem) -> None:
    """Given the parameters, x and y are two regressions of the residuals on the waves."""
    variances = SCALES.amplitude_px**2 * system.basis.variances(length_px=SCALES.length_px)
    values, weight = system.basis_values, system.observed.information
    kernel = values * variances @ values.T
    gain = variances[:, None] * values.T @ np.linalg.inv(kernel + np.diag(1.0 / weight))
    expected = (gain @ system.residual).T
    found = field_at(system.normal(), system.basis, SCALES)
    np.testing.assert_allclose(found @ values.T, expected @ values.T, atol=1e-7)
    assert np.max(np.abs(found @ values.T)) > 0.01


def test_the_covariance_of_a_prediction_is_that_of_the_joint_posterior(
    system: LinearSystem, problem: FitProblem, joint: Joint, field: Field
) -> None:
    """On the arc and all over the sky; what is known has a floor."""
    fit = marginal_fit(system.normal(), system.basis, SCALES)
    for directions in (sun_arc(20, widest_deg=55.0), spread_directions(40, seed=8)):
        seen = observed(small_camera(), directions, sigma_px=0.0)
        residual, rows = problem.linearised(system.at, seen)
        values = system.basis.values(seen.pixels - residual)
        stated = rows @ fit.covariance @ np.swapaxes(rows, 1, 2) + field.covariance(rows, values)
        design = np.zeros((len(directions), 2, joint.mean.size))
        design[..., : joint.size] = rows
        m = values.shape[1]
        design[:, 0, joint.size : joint.size + m] = values
        design[:, 1, joint.size + m :] = values
        expected = design @ joint.covariance @ np.swapaxes(design, 1, 2)
        # the waves are short of the field's variance, more so near the edge of their box; what is stated is not
        np.testing.assert_allclose(stated, expected, atol=0.03 * SCALES.amplitude_px**2)
        root = np.sqrt(0.5 * np.trace(expected, axis1=1, axis2=2))
        found = np.sqrt(0.5 * np.trace(stated, axis1=1, axis2=2))
        assert np.all(found > 0.97 * root)
        assert np.median(found / root) < 1.1


def test_the_variance_of_a_prediction_is_the_trace_of_its_covariance(
    system: LinearSystem, problem: FitProblem, field: Field
) -> None:
    """With the field's mean in the prediction, and without it, where the whole field is an error."""
    fit = marginal_fit(system.normal(), system.basis, SCALES)
    unseen = Field(amplitude_px=SCALES.amplitude_px, length_px=SCALES.length_px, basis=system.basis, cross=fit.cross)
    seen = observed(small_camera(), spread_directions(40, seed=8), sigma_px=0.0)
    residual, rows = problem.linearised(system.at, seen)
    values = system.basis.values(seen.pixels - residual)
    for normal, of in ((system.normal(), field), (None, unseen)):
        covariance = rows @ fit.covariance @ np.swapaxes(rows, 1, 2) + of.covariance(rows, values)
        expected = covariance[:, 0, 0] + covariance[:, 1, 1]
        found = prediction_variance(fit, SCALES, system.basis, rows=rows, basis_values=values, normal=normal)
        np.testing.assert_allclose(found, expected, rtol=1e-9)
        assert np.all(found > 0.0)


def test_far_from_all_sightings_the_field_is_unknown(field: Field) -> None:
    values = field.basis.values(np.array([[20.0, 460.0], [620.0, 20.0]]))
    rows = np.zeros((2, 2, field.cross.shape[1]))
    own = np.trace(field.covariance(rows, values), axis1=1, axis2=2) / 2.0
    # coupling is what the parameters leave open, of which the rows here take nothing back
    assert np.all(own > 0.9 * SCALES.amplitude_px**2)


def test_without_sightings_nothing_is_known(system: LinearSystem) -> None:
    cross = np.zeros((2, 3, len(system.basis.orders)))
    field = Field(amplitude_px=0.3, length_px=120.0, basis=system.basis, cross=cross)
    assert field.known.shape == (0, len(system.basis.orders))
    assert field.coupling.shape == (2, 0, len(system.basis.orders))
    stated = field.covariance(np.zeros((1, 2, 3)), field.basis.values(np.array([[300.0, 200.0]])))
    np.testing.assert_allclose(stated[0], 0.09 * np.eye(2), rtol=2e-3)
