"""The compiled residuals and rows beside the same in numpy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.calibration import observed, small_camera, small_problem, spread_directions

from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.solve.priors import LENS, N_LENS
from sunarc.calibration.solve.problem import Block, FitProblem
from sunarc.common.robust_statistics import UNSEEN_PX
from sunarc.optics.camera import PARAMETER_NAMES, POSE
from sunarc.optics.forward import project_with_rows_fast
from sunarc.optics.projections import PROJECTIONS, Projection

FloatArray = NDArray[np.float64]

EPOCHS, CAUSES = 2, 2


def _case(projection: Projection, *, mirrored: bool) -> tuple[FitProblem, Sightings, FloatArray]:
    """Return a problem of two poses and shared errors, sightings of both by turns, and unknowns off the answer."""
    camera = small_camera(projection, mirrored=mirrored)
    problem = replace(small_problem(camera, n_epochs=EPOCHS), blocks=(Block("shared", slice(0, CAUSES)),))
    widest = 60.0 if projection in {"perspective", "orthographic"} else 88.0
    seen = observed(camera, spread_directions(80, seed=3, widest_deg=widest), sigma_px=0.2)
    shared = np.random.default_rng(4).normal(0.0, 0.2, (80, 2, CAUSES))
    seen = replace(seen, systematic_px=shared, epoch=np.arange(80) % EPOCHS)
    unknowns = problem.unknowns([camera, replace(camera, rotation_cam_enu=(0.05, -0.02, 0.3))])
    return problem, seen, unknowns + 0.03 * np.sin(np.arange(unknowns.size))


def _reference(problem: FitProblem, seen: Sightings, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return residuals (n, 2) and rows (n, 2, size) as numpy makes them."""
    residual, rows = np.empty((len(seen), 2)), np.zeros((len(seen), 2, problem.size))
    for epoch in range(EPOCHS):
        mine = seen.epoch == epoch
        camera = problem.camera(unknowns, epoch)
        pixels, by_parameters = project_with_rows_fast(camera, seen.directions[mine])
        part = np.zeros((int(mine.sum()), 2, problem.size))
        part[..., :N_LENS] = by_parameters[..., LENS] @ problem.prior.basis
        part[..., problem.pose_slice(epoch)] = by_parameters[..., POSE]
        part[..., -CAUSES:] = seen.systematic_px[mine] * np.isfinite(pixels[:, :1, None])
        rows[mine] = part
        difference = seen.pixels[mine] - pixels - seen.systematic_px[mine] @ unknowns[-CAUSES:]
        residual[mine] = np.where(np.isfinite(difference), difference, UNSEEN_PX)
    return residual, rows


@pytest.mark.parametrize("projection", PROJECTIONS)
@pytest.mark.parametrize("mirrored", [False, True])
def test_they_are_those_of_numpy(projection: Projection, *, mirrored: bool) -> None:
    problem, seen, unknowns = _case(projection, mirrored=mirrored)
    expected, expected_rows = _reference(problem, seen, unknowns)
    residual, rows = problem.linearised(unknowns, seen)
    np.testing.assert_allclose(residual, expected, atol=1e-9)
    np.testing.assert_allclose(rows, expected_rows, rtol=1e-9, atol=1e-9 * np.max(np.abs(expected_rows)))
    np.testing.assert_allclose(problem.residuals(unknowns, seen), expected, atol=1e-9)
    assert np.max(np.abs(rows[..., -CAUSES:])) > 0.1
    assert len(PARAMETER_NAMES) > N_LENS


def test_where_the_lens_shows_nothing_the_rows_are_0() -> None:
    problem, seen, unknowns = _case("equidistant", mirrored=False)
    narrow = replace(problem, template=replace(problem.template, max_angle=0.7))
    residual, rows = narrow.linearised(unknowns, seen)
    unseen = residual[:, 0] == UNSEEN_PX
    assert 5 < unseen.sum() < 75
    assert np.all(rows[unseen] == 0.0)
    assert np.all(np.any(rows[~unseen] != 0.0, axis=(1, 2)))
