"""The odds of parts of the lens model: against evidences of nested models computed one by one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.calibration import observed, small_camera, small_problem, sun_arc

from sunarc.calibration.fit.marginal_likelihood import MarginalFit, NormalEquations, PriorScales
from sunarc.calibration.fit.normal_equations import linear_system
from sunarc.calibration.fit.robust_fit import log_bayes_factor, part_log_odds
from sunarc.calibration.solve.problem import Bins
from sunarc.optics.displacement import WaveBasis, wave_basis

FloatArray = NDArray[np.float64]
SCALES = PriorScales(1e-4, 120.0, 2.0, 0.7)
BASIS = wave_basis(width=640, height=480, shortest_px=120.0, longest_px=160.0)


def _linear_case(seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return a design (40, 5), values (40,) with unit noise, and prior precisions (5,)."""
    rng = np.random.default_rng(seed)
    design, precision = rng.standard_normal((40, 5)), np.array([1.0, 0.5, 4.0, 0.1, 2.0])
    truth = np.array([0.3, 0.0, 0.0, 1.5, -0.4])
    return design, design @ truth + rng.standard_normal(40), precision


def _log_evidence(design: FloatArray, values: FloatArray, precision: FloatArray) -> float:
    """Return the log density of values ~ N(0, 1 + X P⁻¹ X')."""
    covariance = np.eye(values.size) + (design / precision) @ design.T
    return float(-0.5 * (np.linalg.slogdet(covariance)[1] + values @ np.linalg.solve(covariance, values)))


@pytest.mark.parametrize("part", [[1], [1, 2], [3], [0, 3, 4], [0, 1, 2, 3, 4]])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_ratio_of_densities_is_the_ratio_of_evidences(part: list[int], seed: int) -> None:
    design, values, precision = _linear_case(seed)
    covariance = np.asarray(np.linalg.inv(design.T @ design + np.diag(precision)), dtype=np.float64)
    mean = covariance @ design.T @ values
    fit = MarginalFit(
        unknowns=mean, gain=0.0, coefficients=np.zeros((2, 1)), covariance=covariance, cross=np.zeros((2, 5, 1))
    )
    others = np.setdiff1d(np.arange(5), part)
    expected = _log_evidence(design, values, precision) - _log_evidence(design[:, others], values, precision[others])
    assert log_bayes_factor(fit, precision, np.array(part)) == pytest.approx(expected, abs=1e-9)


def _equations(decentering: tuple[float, float], *, k3: float = 0.0, sigma_px: float = 0.05) -> NormalEquations:
    """Return the equations of a small camera about itself, of 240 sightings over the sky."""
    radial = (0.0, k3, *(0.0,) * 6)
    camera = replace(small_camera(), decentering=(*decentering, 0.0, 0.0), skew_px=0.0, radial=radial)
    camera = replace(camera, focal_length_px=(220.0, 220.0))
    problem = small_problem(replace(camera, decentering=(0.0,) * 4, radial=(0.0,) * 8))
    at = problem.unknowns([camera])
    seen = observed(camera, sun_arc(240), sigma_px=sigma_px)
    bins = Bins(member=np.arange(240) // 4, count=60)
    system = linear_system(problem, seen, bins, at, information=np.full(240, sigma_px**-2), basis=BASIS)
    return system.normal()


def _odds(normal: NormalEquations, basis: WaveBasis = BASIS) -> dict[str, float]:
    return part_log_odds(normal, basis, SCALES)


def test_a_decentered_lens_has_odds_for_its_decentering_and_another_one_against() -> None:
    assert _odds(_equations((4e-3, -3e-3)))["decentering"] > 20.0
    assert -15.0 < _odds(_equations((0.0, 0.0)))["decentering"] < 0.0


def test_a_lens_that_is_as_its_projection_needs_no_radial_terms() -> None:
    plain, bent = _odds(_equations((0.0, 0.0))), _odds(_equations((0.0, 0.0), k3=-0.05))
    assert plain["radial_terms"] <= 1
    assert plain["radial"] < 3.0
    assert 1 <= bent["radial_terms"] <= 8
    assert bent["radial"] > 20.0


def test_more_noise_leaves_the_odds_of_a_part_nearer_to_even() -> None:
    precise, noisy = (_odds(_equations((4e-3, -3e-3), sigma_px=sigma)) for sigma in (0.05, 0.5))
    assert abs(noisy["decentering"]) < abs(precise["decentering"])
