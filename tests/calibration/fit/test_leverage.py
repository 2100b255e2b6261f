"""The share of a star's noise that a fit takes up, against the hat matrix of the whole linear problem."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tests.fixtures.calibration import observed, small_camera, small_problem, spread_directions

from sunarc.calibration.fit.marginal_likelihood import PriorScales, marginal_fit, scale_grid
from sunarc.calibration.fit.normal_equations import linear_system
from sunarc.calibration.fit.robust_fit import compute_leverage
from sunarc.calibration.solve.problem import Bins, Block

COUNT, NIGHT = 60, 40
SCALES = PriorScales(amplitude_px=0.3, length_px=120.0, radial_px=2.0, decentering_px=0.7)
SIGMA_PX = 0.05


def test_leverage_is_that_of_the_hat_matrix_and_zero_by_day() -> None:
    camera, rng = small_camera(), np.random.default_rng(8)
    columns = rng.normal(0.0, 0.1, (COUNT, 2, 2)) * (np.arange(COUNT) < NIGHT)[:, None, None]
    seen = replace(observed(camera, spread_directions(COUNT), sigma_px=SIGMA_PX), systematic_px=columns)
    problem = replace(small_problem(camera), blocks=(Block("night_pose", slice(0, 2)),))
    grid = scale_grid(width=640, height=480, floor_px=0.002, radial_px=2.0, decentering_px=0.7)
    bins = Bins(member=np.arange(COUNT), count=COUNT)
    at = problem.unknowns([camera])
    information = np.full(COUNT, SIGMA_PX**-2)
    system = linear_system(problem, seen, bins, at, information=information, basis=grid.basis)
    normal = system.normal()
    found = compute_leverage(
        system, normal, marginal_fit(normal, grid.basis, SCALES), SCALES, which=np.arange(COUNT) < NIGHT
    )
    np.testing.assert_array_equal(found[NIGHT:], 0.0)

    waves = grid.basis.variances(length_px=SCALES.length_px)
    prior = np.r_[normal.prior_precision(SCALES.radial_px, SCALES.decentering_px), np.tile(1.0 / waves, 2)]
    prior[-2 * waves.size :] /= SCALES.amplitude_px**2
    design = np.zeros((COUNT, 2, prior.size))
    design[..., : at.size] = system.rows
    for axis in (0, 1):
        first = at.size + axis * waves.size
        design[:, axis, first : first + waves.size] = system.basis_values
    flat = design.reshape(-1, prior.size) / SIGMA_PX
    root = np.sqrt(prior)
    scaled = flat / root
    hat = np.einsum("ip,pq,iq->i", scaled, np.linalg.inv(scaled.T @ scaled + np.eye(root.size)), scaled)
    expected = hat.reshape(COUNT, 2).mean(axis=1)
    assert 0.3 < expected[:NIGHT].mean() < 0.95
    np.testing.assert_allclose(found[:NIGHT], np.minimum(expected[:NIGHT], 0.8), rtol=0.05, atol=0.01)
