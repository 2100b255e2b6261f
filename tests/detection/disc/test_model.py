"""The disc model: derivatives by finite differences, levels and unevenness by least squares of their own."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.detection.disc.fitting import (
    BACKGROUND,
    CENTER,
    FLUX,
    NONLINEAR,
    PRIOR,
    SENSOR,
    SHAPE,
    SOURCES,
    STRETCH,
    disc_counts,
    plain_window,
    problem_of,
    window_of,
)
from tests.detection.rendering import FloatArray

from sunarc.detection.disc.model import (
    PSF,
    VALUE,
    WING_PSF,
    WINGS,
    DiscProblem,
    DiscState,
    Evaluation,
    evaluate,
    inverse,
    normal_equations,
    render_disc,
    solve_levels,
    unevenness,
    without,
)

AROUND = np.array([0.4, -0.3, 0.002, 15.0])


def state_of(*, colours: int = 1, wings: float = 0.0) -> DiscState:
    nonlinear = NONLINEAR.copy()
    nonlinear[WINGS] = wings
    return DiscState(
        nonlinear, FLUX * np.linspace(1.0, 0.6, colours), BACKGROUND * np.linspace(1.0, 2.0, colours), AROUND
    )


def vector_of(problem: DiscProblem, state: DiscState) -> FloatArray:
    return np.concatenate([state.nonlinear[problem.prior.free], state.flux, state.background, state.around])


def with_vector(problem: DiscProblem, state: DiscState, vector: FloatArray) -> DiscState:
    free, colours = problem.prior.free, problem.window.colours
    nonlinear = state.nonlinear.copy()
    nonlinear[free] = vector[: len(free)]
    rest = vector[len(free) :]
    return DiscState(nonlinear, rest[:colours], rest[colours : 2 * colours], rest[2 * colours :])


def bayer_window() -> FloatArray:
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return np.asarray(rows % 2 + columns % 2)


@pytest.mark.parametrize(
    ("colours", "binning", "wings"), [(1, 1, False), (1, 1, True), (3, 1, True), (1, 2, True), (3, 2, False)]
)
def test_the_jacobian_is_that_of_finite_differences(*, colours: int, binning: int, wings: bool) -> None:
    colour = bayer_window().astype(np.intp) if colours == 3 else np.zeros(SHAPE, np.intp)
    window = window_of(np.zeros(SHAPE), colour=colour, colours=colours)
    prior = PRIOR._replace(free_wings=wings)
    problem = problem_of(window, prior=prior, sensor=replace(SENSOR, binning=binning, full_scale=65535))
    state = state_of(colours=colours, wings=0.03 if wings else 0.0)
    jacobian, vector = evaluate(problem, state).jacobian, vector_of(problem, state)
    for index in range(vector.size):
        step = 1e-4 * max(abs(vector[index]), 1.0)
        by = np.where(np.arange(vector.size) == index, step, 0.0)
        up, down = (evaluate(problem, with_vector(problem, state, vector + s * by)).residual for s in (1.0, -1.0))
        slope = -(up - down) / (2.0 * step)
        if index < len(prior.free):  # the smear's profile and the glare's shape count as fixed within a step
            fixed = problem, state, vector, by, step
            slope -= surroundings_slope(*fixed)
        assert jacobian[:, index] == pytest.approx(slope, abs=2e-4 * max(np.abs(slope).max(), 1e-6)), index


def surroundings_slope(
    problem: DiscProblem, state: DiscState, vector: FloatArray, by: FloatArray, step: float
) -> FloatArray:
    """Return what smear and glare contribute to a derivative by a nonlinear parameter."""
    none = state._replace(around=np.zeros(4))

    def model(sign: float) -> FloatArray:
        moved = with_vector(problem, state, vector + sign * by)
        return evaluate(problem, none._replace(nonlinear=moved.nonlinear)).residual - evaluate(problem, moved).residual

    return np.asarray((model(1.0) - model(-1.0)) / (2.0 * step))


def test_the_disc_with_wings_is_the_mean_of_two_discs() -> None:
    problem = problem_of(plain_window(), prior=PRIOR._replace(free_wings=True))
    image = evaluate(problem, state_of(wings=0.1)).planes[VALUE]
    wide = render_disc(
        SHAPE,
        *CENTER,
        WING_PSF * math.exp(NONLINEAR[PSF]),
        STRETCH,
        SOURCES.wings,
    )
    assert image == pytest.approx(0.9 * disc_counts() + 0.1 * wide[VALUE])


def test_binned_pixels_are_means_of_the_sensors_own() -> None:
    binned = evaluate(problem_of(plain_window(), sensor=replace(SENSOR, binning=3)), state_of())
    assert binned.residual == pytest.approx(evaluate(problem_of(plain_window()), state_of()).residual, abs=0.05)


def test_the_cost_is_chi2_with_the_logarithm_of_the_variance_and_the_prior() -> None:
    problem, state = problem_of(plain_window(), prior=PRIOR._replace(free_wings=True)), state_of(wings=0.1)
    state.nonlinear[PSF] += 0.15
    found = evaluate(problem, state)
    misfit = float(np.sum(found.residual**2 * found.weight - np.log(found.weight)))
    assert found.cost == pytest.approx(misfit + (0.15 / 0.3) ** 2 + (0.1 / 0.05) ** 2)


def test_the_normal_equations_are_gradient_and_curvature_of_the_cost() -> None:
    problem, state = problem_of(plain_window(), prior=PRIOR._replace(free_wings=True)), state_of(wings=0.1)
    state.nonlinear[PSF] += 0.15
    found = evaluate(problem, state)
    matrix, gradient = normal_equations(problem, state, found)
    plain = found.jacobian.T @ (found.jacobian * found.weight[:, None])
    pull = found.jacobian.T @ (found.weight * found.residual)
    assert np.diag(matrix - plain)[:4] == pytest.approx([0.0, 0.0, 0.3**-2, 0.05**-2], abs=1e-4)
    assert (gradient - pull)[:4] == pytest.approx([0.0, 0.0, -0.15 / 0.3**2, -0.1 / 0.05**2], abs=1e-6)
    assert matrix[4:] == pytest.approx(plain[4:])


def test_a_fixed_shape_and_no_wings_leave_three_free_parameters() -> None:
    assert PRIOR._replace(free_stretch=False).free == [0, 1, 2]
    assert PRIOR.free == [0, 1, 2, 4, 5, 6]
    assert PRIOR._replace(free_wings=True).free == [0, 1, 2, 3, 4, 5, 6]


def test_levels_of_a_noiseless_disc_are_found_in_one_step() -> None:
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    disc = disc_counts()
    counts = FLUX * disc + BACKGROUND + 0.4 * (columns - 11.0) - 0.3 * (rows - 10.0) + 0.002 * disc.sum(axis=0)
    state, found = solve_levels(problem_of(window_of(counts)), NONLINEAR)
    assert state.flux == pytest.approx([FLUX], rel=1e-6)
    assert state.background == pytest.approx([BACKGROUND], rel=1e-4)
    assert state.around == pytest.approx([0.4, -0.3, 0.002, 0.0], abs=1e-2)
    assert np.abs(found.residual).max() < 1e-3


def test_each_colour_has_its_own_flux_and_background() -> None:
    colour = bayer_window().astype(np.intp)
    counts = np.array([1.0, 0.5, 0.25])[colour] * FLUX * disc_counts() + np.array([10.0, 20.0, 30.0])[colour]
    state, _ = solve_levels(problem_of(window_of(counts, colour=colour, colours=3)), NONLINEAR)
    assert state.flux == pytest.approx(FLUX * np.array([1.0, 0.5, 0.25]), rel=1e-5)
    assert state.background == pytest.approx([10.0, 20.0, 30.0], rel=1e-3)


def test_pixels_that_are_not_linear_do_not_count_for_the_levels() -> None:
    counts = FLUX * disc_counts() + BACKGROUND
    linear = counts < 1500.0
    window = window_of(np.minimum(counts, 1500.0), linear=linear)
    state, _ = solve_levels(problem_of(window), NONLINEAR)
    assert state.flux == pytest.approx([FLUX], rel=1e-4)


def test_a_hole_has_no_negative_flux() -> None:
    state, _ = solve_levels(problem_of(window_of(1000.0 - 5000.0 * disc_counts())), NONLINEAR)
    assert state.flux == pytest.approx([1e-3])


def test_a_problem_has_the_usable_pixels_only() -> None:
    usable = np.zeros(SHAPE, np.bool_)
    usable[4, 7] = usable[20, 22] = True
    problem = problem_of(window_of(np.arange(483.0).reshape(SHAPE), usable=usable))
    assert problem.pixels.counts.tolist() == [99.0, 482.0]
    assert problem.pixels.offset.tolist() == [[-4.0, -6.0], [11.0, 10.0]]
    rest = without(problem, np.array([True, False]))
    assert (rest.pixels.place.tolist(), rest.pixels.counts.tolist()) == ([482], [482.0])
    assert rest.pixels.offset.tolist() == [[11.0, 10.0]]


def test_the_inverse_is_that_of_numpy_and_finite_where_the_data_are_silent() -> None:
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(30, 4)) * np.array([1.0, 1e3, 1e-3, 1e6])
    matrix = rows.T @ rows
    assert inverse(matrix) / np.linalg.inv(matrix) == pytest.approx(np.ones((4, 4)), rel=1e-3)
    silent = inverse(np.diag([4.0, 0.0]))
    assert silent[0, 0] == pytest.approx(0.25)
    assert np.isfinite(silent).all()
    assert silent[1, 1] > 1e6


def test_an_even_disc_has_no_unevenness_and_a_tilted_one_that_of_least_squares() -> None:
    window = plain_window()
    problem = problem_of(window)
    state, found = solve_levels(problem, NONLINEAR)
    assert unevenness(problem, state, found) < 1e-6
    u, _ = SOURCES.core.positions.T
    tilted = render_disc(
        SHAPE, *CENTER, 0.7, STRETCH, SOURCES.core._replace(weights=SOURCES.core.weights * (1.0 + 0.3 * u))
    )
    problem = problem_of(window._replace(counts=FLUX * tilted[VALUE] + BACKGROUND))
    state, found = solve_levels(problem, NONLINEAR)
    assert unevenness(problem, state, found) == pytest.approx(uneven_by_least_squares(state, found, problem), rel=1e-3)


def uneven_by_least_squares(state: DiscState, found: Evaluation, problem: DiscProblem) -> float:
    """Return by how much four more columns decrease chi², from that of the first columns' own minimum."""
    extra = state.flux[0] * found.planes[4:8].reshape(4, -1)[:, problem.pixels.place].T
    root = np.sqrt(found.weight)
    more = np.column_stack([found.jacobian[:, :6], extra, found.jacobian[:, 6:]])
    prior = np.zeros((1, more.shape[1]))
    prior[0, 2] = 1.0 / problem.prior.log_psf_sigma
    rows = np.concatenate([more * root[:, None], prior])
    right = np.append(found.residual * root, 0.0)
    solution = np.linalg.lstsq(rows, right, rcond=None)[0]
    return float(right @ right - np.sum((right - rows @ solution) ** 2))
