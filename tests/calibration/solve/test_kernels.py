"""The compiled Levenberg-Marquardt loop against its numpy form, derivatives and linear algebra."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.calibration.solve.solve_reference import most_probable_reference
from tests.fixtures.calibration import (
    loose_precision,
    numerical_derivative,
    observed,
    small_camera,
    small_problem,
    spread_directions,
)

from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.solve.levenberg_marquardt import most_probable
from sunarc.calibration.solve.problem import FitProblem
from sunarc.common.robust_statistics import UNSEEN_PX
from sunarc.optics.projections import PROJECTIONS, Projection

FloatArray = NDArray[np.float64]


def _case(
    projection: Projection = "equidistant", *, mirrored: bool = False, epochs: int = 1
) -> tuple[FitProblem, Sightings, FloatArray]:
    """Return a problem of so many poses, sightings with a gross error, and unknowns off the answer."""
    camera = small_camera(projection, mirrored=mirrored)
    problem = small_problem(camera, n_epochs=epochs)
    turned = [replace(camera, rotation_cam_enu=tuple(np.add(camera.rotation_cam_enu, 0.05 * e))) for e in range(epochs)]
    widest = 50.0 if projection in {"perspective", "orthographic"} else 80.0
    seen = [
        observed(one, spread_directions(50, seed=7 + e, widest_deg=widest), sigma_px=0.2, seed=e)
        for e, one in enumerate(turned)
    ]
    pixels = np.concatenate([one.pixels for one in seen])
    pixels[3] += 40.0
    together = Sightings(
        directions=np.concatenate([one.directions for one in seen]),
        pixels=pixels,
        information=np.linspace(0.5, 2.0, pixels.shape[0]),
        epoch=np.repeat(np.arange(epochs), 50),
    )
    start = problem.unknowns(turned)
    return problem, together, start + 0.02 * np.sin(np.arange(start.size))


@pytest.mark.parametrize("projection", PROJECTIONS)
@pytest.mark.parametrize(("mirrored", "epochs"), [(False, 1), (True, 2)])
@pytest.mark.parametrize("sigma", [None, 0.3])
def test_it_comes_to_where_the_numpy_form_does(
    projection: Projection, epochs: int, sigma: float | None, *, mirrored: bool
) -> None:
    problem, seen, start = _case(projection, mirrored=mirrored, epochs=epochs)
    precision = loose_precision(problem)
    goal = {"precision": precision, "sigma": sigma, "iterations": 200, "tolerance": 1e-13}
    found = most_probable(problem, seen, start, **goal)  # type: ignore[arg-type]
    expected = most_probable_reference(problem, seen, start, **goal)  # type: ignore[arg-type]
    assert found.cost == pytest.approx(expected.cost, rel=1e-9)
    moved = problem.residuals(found.unknowns, seen) - problem.residuals(expected.unknowns, seen)
    assert np.max(np.abs(moved)) < 1e-5  # px: what rounding of the cost leaves open
    assert np.max(np.abs(problem.residuals(start, seen) - problem.residuals(found.unknowns, seen))) > 0.05


def test_what_is_held_stays() -> None:
    problem, seen, start = _case()
    free = np.arange(problem.size) % 3 > 0
    precision = loose_precision(problem)
    found = most_probable(problem, seen, start, precision=precision, free=free)
    np.testing.assert_array_equal(found.unknowns[~free], start[~free])
    expected = most_probable_reference(problem, seen, start, precision=precision, free=free)
    np.testing.assert_allclose(found.unknowns, expected.unknowns, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("sigma", [None, 5.0])
@pytest.mark.parametrize("epochs", [1, 3])
def test_the_cost_and_the_first_step_are_those_of_the_numpy_form(sigma: float | None, epochs: int) -> None:
    problem, seen, start = _case(epochs=epochs)
    precision = loose_precision(problem)
    for iterations in (0, 1, 2):
        found, expected = (
            solve(problem, seen, start, precision=precision, sigma=sigma, iterations=iterations, tolerance=0.0)
            for solve in (most_probable, most_probable_reference)
        )
        # beyond the start the rounding of the sums counts: about 1e-5 of a scaled step
        assert found.cost == pytest.approx(expected.cost, rel=1e-6 if iterations else 1e-12)
        sizes = np.maximum(1.0, np.abs(expected.unknowns - start))
        np.testing.assert_allclose((found.unknowns - expected.unknowns) / sizes, 0.0, atol=1e-4)


@pytest.mark.parametrize("sigma", [None, 5.0])
def test_where_it_ends_no_unknown_lowers_the_cost(sigma: float | None) -> None:
    problem, seen, start = _case(epochs=2)
    goal = {"precision": loose_precision(problem), "sigma": sigma, "tolerance": 1e-14}

    def cost(unknowns: FloatArray) -> FloatArray:
        return np.array([most_probable(problem, seen, unknowns, iterations=0, **goal).cost])  # type: ignore[arg-type]

    found = most_probable(problem, seen, start, iterations=200, **goal)  # type: ignore[arg-type]
    slopes, before = (numerical_derivative(cost, at)[0] for at in (found.unknowns, start))
    assert np.max(np.abs(slopes)) < 1e-5 * np.max(np.abs(before))


def test_a_sighting_where_the_lens_sees_nothing_costs_its_bound_and_pulls_nowhere() -> None:
    problem, seen, at = _case()
    narrow = replace(problem, template=replace(problem.template, max_angle=math.radians(40.0)))
    unseen = np.any(narrow.residuals(at, seen) == UNSEEN_PX, axis=-1)
    assert 5 < np.count_nonzero(unseen) < 45
    none = np.zeros(problem.size)
    cost = most_probable(narrow, seen, at, precision=none, iterations=0).cost
    rest = most_probable(problem, seen.select(~unseen), at, precision=none, iterations=0).cost
    assert cost == pytest.approx(rest + UNSEEN_PX**2 * float(np.sum(seen.information[unseen])))
    held = {"precision": np.full(problem.size, 1e9), "iterations": 1}  # a step so small that none comes into sight
    step, alone = (
        most_probable(one, of, at, **held).unknowns - at  # type: ignore[arg-type]
        for one, of in ((narrow, seen), (problem, seen.select(~unseen)))
    )
    np.testing.assert_allclose(step, alone, rtol=1e-9, atol=1e-15)


def test_equations_that_cannot_be_solved_end_where_they_began() -> None:
    problem, seen, start = _case()
    found = most_probable(
        problem, replace(seen, information=np.full(50, math.nan)), start, precision=loose_precision(problem)
    )
    np.testing.assert_array_equal(found.unknowns, start)
    assert found.cost == math.inf
