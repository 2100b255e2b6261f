from __future__ import annotations

import math

import numpy as np
import pytest

from sunarc.calibration.model.options import Method
from sunarc.calibration.solve.priors import precisions
from sunarc.lab.simulation.truth import true_camera
from sunarc.lab.studies.trials import Trial, run_trials, synthetic_arc
from sunarc.lab.studies.uncertainty import cramer_rao_bound, make_prior
from sunarc.optics.camera import POSE
from sunarc.optics.forward import project_with_jacobian

TRUTH = true_camera(0)


def test_the_synthetic_arc_has_as_many_points_as_the_paper_s() -> None:
    assert len(synthetic_arc()) == 1673


def test_the_paper_s_bound_on_the_arc_is_that_of_17_free_parameters() -> None:
    """A linear fit of m parameters to n points of noise σ per axis errs by σ √(m / n) on them: rms over the points."""
    arc = synthetic_arc()
    bound = cramer_rao_bound(TRUTH, arc.directions, method="paper", sigma_px=1.0)
    assert bound[0] == pytest.approx(math.sqrt(17.0 / 1673.0), rel=1e-6)


def test_the_paper_s_constraints_hold_skew_aspect_and_c1() -> None:
    basis, precision = make_prior(TRUTH, method="paper")
    assert basis.shape == (23, 17)
    assert not np.any(precision)
    assert np.allclose(basis[0], basis[1], atol=1e-12)
    assert np.allclose(basis[2], 0.0, atol=1e-12)
    assert np.allclose(basis[8:11], 0.0)


def test_the_service_s_priors_hold_the_lens_and_not_the_pose() -> None:
    basis, precision = make_prior(TRUTH, method="robust")
    assert basis.shape == (23, 20)
    assert np.array_equal(basis[POSE, 17:], np.eye(3))
    assert not np.any(basis[8:11])
    assert np.array_equal(precision, [*precisions(7.0, 1.2), 0.0, 0.0, 0.0])


def test_the_priors_make_the_bound_smaller_and_less_than_proportional() -> None:
    directions = synthetic_arc().directions
    paper, robust = (cramer_rao_bound(TRUTH, directions, method=m, sigma_px=5.0) for m in ("paper", "robust"))
    assert np.all(robust < paper)
    fine = cramer_rao_bound(TRUTH, directions, method="robust", sigma_px=0.5)
    assert np.all(robust < 10.0 * fine)
    assert not np.any(cramer_rao_bound(TRUTH, directions, method="robust", sigma_px=0.0))


def test_the_bound_s_covariance_is_that_of_the_normal_equations() -> None:
    """The same by the textbook's inverse, where it is well enough conditioned: with the priors."""
    arc, sigma = synthetic_arc(), 0.5
    basis, precision = make_prior(TRUTH, method="robust")
    rows = project_with_jacobian(TRUTH, arc.directions)[1].reshape(-1, 23) @ basis
    covariance = basis @ np.linalg.inv(rows.T @ rows / sigma**2 + np.diag(precision)) @ basis.T
    bound = cramer_rao_bound(TRUTH, arc.directions, method="robust", sigma_px=sigma)
    assert bound[2:] == pytest.approx(np.sqrt(np.diag(covariance))[[0, 1, 3, 4]], rel=1e-3)


@pytest.mark.parametrize(("method", "tolerance"), [("paper", 0.25), ("robust", 0.3)])
def test_fits_err_by_as_much_on_the_arc_as_the_bound_allows(method: Method, tolerance: float) -> None:
    """Four fits' mean of χ₁₇/√17 scatters by 9 %; a fit with priors has a truth of its own, not the priors' mean."""
    trials = [Trial(method=method, sigma_px=0.5, seed=(4, number)) for number in range(4)]
    bound = cramer_rao_bound(TRUTH, synthetic_arc().directions, method=method, sigma_px=0.5)
    assert np.mean(run_trials(trials)[:, 0]) == pytest.approx(bound[0], rel=tolerance)
