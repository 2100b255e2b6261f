"""The compiled Levenberg-Marquardt loop against its numpy form, derivatives and linear algebra."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.calibration.least_squares.solve_reference import damped_step, most_probable_reference
from tests.fixtures.calibration import (
    loose_precision,
    numerical_derivative,
    observed,
    random_covariance,
    small_camera,
    small_problem,
    spread_directions,
)

from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.robust_loss import UNSEEN_PX
from sunarc.calibration.solve.levenberg_marquardt import (
    Goal,
    as_lens,
    as_seen,
    damped_step_of,
    equations,
    most_probable,
)
from sunarc.calibration.solve.problem import FitProblem
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
    assert np.max(np.abs(moved)) < 3e-6  # px: what rounding of the cost leaves open
    assert np.max(np.abs(problem.residuals(start, seen) - problem.residuals(found.unknowns, seen))) > 0.05


def test_what_is_held_stays() -> None:
    problem, seen, start = _case()
    free = np.arange(problem.size) % 3 > 0
    precision = loose_precision(problem)
    found = most_probable(problem, seen, start, precision=precision, free=free)
    np.testing.assert_array_equal(found.unknowns[~free], start[~free])
    expected = most_probable_reference(problem, seen, start, precision=precision, free=free)
    np.testing.assert_allclose(found.unknowns, expected.unknowns, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("sigma", [0.0, 5.0])
def test_the_pull_is_minus_the_derivative_of_the_cost(sigma: float) -> None:
    problem, seen, at = _case(epochs=2)
    goal = Goal(loose_precision(problem), sigma, 1, 0.0)
    lens, sightings = as_lens(problem), as_seen(seen)
    normal, gradient = np.empty((problem.size, problem.size)), np.empty(problem.size)

    def cost(unknowns: FloatArray) -> FloatArray:
        other, work = np.empty_like(normal), np.empty_like(gradient)
        return np.array([equations(lens, sightings, goal, unknowns, other, work)])

    equations(lens, sightings, goal, at, normal, gradient)
    slopes = numerical_derivative(cost, at)[0]
    np.testing.assert_allclose(-gradient, slopes, rtol=1e-5, atol=1e-5 * np.max(np.abs(slopes)))
    np.testing.assert_array_equal(normal, normal.T)
    _, rows = problem.linearised(at, seen)
    if sigma == 0.0:
        expected = np.einsum("nai,n,naj->ij", rows, seen.information, rows) + np.diag(goal.precision)
        np.testing.assert_allclose(normal, expected, rtol=1e-9, atol=1e-9 * np.max(expected))


def test_a_sighting_where_the_lens_sees_nothing_costs_its_bound_and_pulls_nowhere() -> None:
    problem, seen, at = _case()
    narrow = replace(problem, template=replace(problem.template, max_angle=math.radians(40.0)))
    unseen = np.any(narrow.residuals(at, seen) == UNSEEN_PX, axis=-1)
    assert 5 < np.count_nonzero(unseen) < 45
    goal = Goal(np.zeros(problem.size), 0.0, 1, 0.0)
    normal, gradient = np.empty((problem.size, problem.size)), np.empty(problem.size)
    cost = equations(as_lens(narrow), as_seen(seen), goal, at, normal, gradient)
    alone, pull = np.empty_like(normal), np.empty_like(gradient)
    rest = equations(as_lens(problem), as_seen(seen.select(~unseen)), goal, at, alone, pull)
    assert cost == pytest.approx(rest + UNSEEN_PX**2 * float(np.sum(seen.information[unseen])))
    np.testing.assert_allclose(normal, alone, rtol=1e-9)
    np.testing.assert_allclose(gradient, pull, rtol=1e-9)


@pytest.mark.parametrize("damping", [0.0, 0.01, 1e6])
def test_a_step_is_that_of_the_numpy_form(damping: float) -> None:
    normal, gradient = random_covariance(6, seed=4) * 1e3, np.random.default_rng(4).standard_normal(6)
    moving = np.array([0, 2, 5])
    step = np.empty(3)
    damped_step_of(normal, gradient, moving, damping, np.empty((3, 3)), step)
    np.testing.assert_allclose(step, damped_step(normal[np.ix_(moving, moving)], gradient[moving], damping), rtol=1e-9)


@pytest.mark.parametrize("normal", [np.diag([1.0, np.nan]), np.array([[1.0, 3.0], [3.0, 1.0]])])
def test_equations_that_cannot_be_solved_give_no_step(normal: FloatArray) -> None:
    step = np.ones(2)
    damped_step_of(normal, np.ones(2), np.arange(2), 1e-3, np.empty((2, 2)), step)
    np.testing.assert_array_equal(step, 0.0)
