"""The covariance over all plausible scales, against the mixture and against draws from it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.calibration import observed, random_covariance, small_camera, small_problem, sun_arc

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.fit import posterior as module
from sunarc.calibration.fit.marginal_likelihood import (
    HyperparameterGrid,
    NormalEquations,
    Scales,
    log_weights,
    marginal_fit,
    normalised,
    scale_grid,
)
from sunarc.calibration.fit.normal_equations import LinearSystem, linear_system
from sunarc.calibration.fit.posterior import PosteriorCovariance, marginalised_covariance
from sunarc.calibration.solve.problem import Bins, FitProblem
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project

FloatArray = NDArray[np.float64]


@pytest.fixture(scope="module")
def grid() -> HyperparameterGrid:
    whole = scale_grid(width=640, height=480, floor_px=0.01, radial_px=2.0, decentering_px=0.7)
    few = np.array([6, 11, 16])  # three of the lens's scales
    return replace(whole, lens_scales=whole.lens_scales[few], log_prior=whole.log_prior[..., few])


@pytest.fixture(scope="module")
def problem() -> FitProblem:
    return small_problem(small_camera())


@pytest.fixture(scope="module")
def at(problem: FitProblem) -> FloatArray:
    return problem.unknowns([small_camera()])


@pytest.fixture(scope="module")
def system(problem: FitProblem, at: FloatArray, grid: HyperparameterGrid) -> LinearSystem:
    seen = observed(small_camera(), sun_arc(60), sigma_px=0.2)
    bins = Bins(member=np.arange(60) // 4, count=15)
    return linear_system(problem, seen, bins, at, information=np.full(60, 25.0), basis=grid.basis)


@pytest.fixture(scope="module")
def posterior(
    system: LinearSystem, grid: HyperparameterGrid, problem: FitProblem, at: FloatArray
) -> PosteriorCovariance:
    return marginalised_covariance(system.normal(), grid, problem, at)


def _one_amplitude(grid: HyperparameterGrid) -> HyperparameterGrid:
    return replace(grid, amplitudes=grid.amplitudes[5:6], log_prior=grid.log_prior[5:6])


def _mixture(normal: NormalEquations, grid: HyperparameterGrid, at: FloatArray) -> FloatArray:
    """Return the second moments about `at` of the whole mixture over the grid."""
    weight = normalised(log_weights(normal, grid))
    total = np.zeros((at.size, at.size))
    for (i, j, k), share in np.ndenumerate(weight):
        scales = Scales(float(grid.amplitudes[i]), float(grid.lengths[j]), *map(float, grid.lens_scales[k]))
        fit = marginal_fit(normal, grid.basis, scales)
        shift = fit.unknowns - at
        total += share * (fit.covariance + np.outer(shift, shift))
    return total


def test_with_one_amplitude_it_is_the_mixture_s_covariance(
    system: LinearSystem, grid: HyperparameterGrid, problem: FitProblem, at: FloatArray
) -> None:
    one = _one_amplitude(grid)
    found = marginalised_covariance(system.normal(), one, problem, at)
    expected = _mixture(system.normal(), one, at)
    # 1.5 % of the probability is left out
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found.covariance / np.outer(scale, scale), expected / np.outer(scale, scale), atol=0.06)
    assert found.field.amplitude_px == pytest.approx(float(grid.amplitudes[5]))
    assert grid.lengths[0] <= found.field.length_px <= grid.lengths[-1]


def test_with_one_choice_it_is_that_fit_s_own(
    system: LinearSystem, grid: HyperparameterGrid, problem: FitProblem
) -> None:
    single = replace(
        grid,
        amplitudes=grid.amplitudes[5:6],
        lengths=grid.lengths[1:2],
        lens_scales=grid.lens_scales[1:2],
        log_prior=grid.log_prior[5:6, 1:2, 1:2],
    )
    scales = Scales(float(grid.amplitudes[5]), float(grid.lengths[1]), *map(float, grid.lens_scales[1]))
    fit = marginal_fit(system.normal(), grid.basis, scales)
    found = marginalised_covariance(system.normal(), single, problem, fit.unknowns)
    np.testing.assert_allclose(found.covariance, fit.covariance, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(found.field.cross, fit.cross, rtol=1e-9, atol=1e-13)
    assert found.field.length_px == pytest.approx(scales.length_px)


def test_a_fit_that_is_off_is_charged_with_its_distance(
    system: LinearSystem, grid: HyperparameterGrid, problem: FitProblem, at: FloatArray
) -> None:
    one = _one_amplitude(grid)
    off = np.zeros(at.size)
    off[17] = 0.5
    near = marginalised_covariance(system.normal(), one, problem, at).covariance
    far = marginalised_covariance(system.normal(), one, problem, at + off).covariance
    assert far[17, 17] - near[17, 17] == pytest.approx(0.25, rel=0.1)


def test_the_covariance_is_positive_and_of_every_unknown(posterior: PosteriorCovariance, at: FloatArray) -> None:
    assert posterior.covariance.shape == (at.size, at.size)
    np.testing.assert_allclose(posterior.covariance, posterior.covariance.T, atol=1e-12)
    scale = np.sqrt(np.diag(posterior.covariance))
    assert np.min(np.linalg.eigvalsh(posterior.covariance / np.outer(scale, scale))) > 0.0
    assert posterior.field.cross.shape[:2] == (2, at.size)


def test_the_share_within_an_ellipse_is_that_of_draws() -> None:
    moments = np.stack([random_covariance(2, seed=s) for s in range(3)])[:, None]
    stated = random_covariance(2, seed=9)[None]
    rng = np.random.default_rng(4)
    found = module.coverage(_triples(moments), _triples(stated))
    for k in range(3):
        draws = rng.multivariate_normal(np.zeros(2), moments[k, 0], 40_000)
        inside = np.einsum("ni,ij,nj->n", draws, np.linalg.inv(stated[0]), draws) < -2.0 * math.log(0.05)
        assert found[k] == pytest.approx(inside.mean(), abs=0.006)


def _triples(matrices: FloatArray) -> FloatArray:
    """Return xx, xy, yy (..., 3, n) of symmetric matrices (..., n, 2, 2)."""
    return np.stack([matrices[..., 0, 0], matrices[..., 0, 1], matrices[..., 1, 1]], axis=-2)


def test_a_gaussian_holds_its_own_95_percent() -> None:
    one = _triples(random_covariance(2, seed=3)[None])
    assert module.coverage(one[None], one)[0] == pytest.approx(0.95, abs=1e-9)
    assert module.coverage(4.0 * one[None], one)[0] == pytest.approx(1.0 - 0.05**0.25, abs=1e-9)


def test_the_coverage_is_that_of_numpy_for_all_shapes_and_sizes() -> None:
    rng = np.random.default_rng(5)
    moments = np.stack([[random_covariance(2, seed=9 * k + n) for n in range(7)] for k in range(6)])
    moments = moments * np.geomspace(1e-9, 1e9, 6)[:, None, None, None]
    moments[0] = 0.0
    stated = np.stack([random_covariance(2, seed=100 + n) for n in range(7)]) * rng.uniform(0.5, 2.0, (7, 1, 1))
    values = np.linalg.eigvals(np.linalg.solve(stated, moments)).real
    half, gap = values.mean(axis=-1), 0.5 * np.abs(values[..., 0] - values[..., 1])
    square = half[..., None] + gap[..., None] * module.COS_DOUBLED
    outside = np.exp(-0.5 * module.ELLIPSE / np.maximum(square, 1e-12)).mean(axis=(1, 2))
    np.testing.assert_allclose(module.coverage(_triples(moments), _triples(stated)), 1.0 - outside, atol=1e-9)


def test_the_stated_95_percent_hold_95_percent_of_the_mixture(
    system: LinearSystem, grid: HyperparameterGrid, problem: FitProblem, at: FloatArray
) -> None:
    choices = module.plausible(system.normal(), grid, at)
    moments = module.at_probes(choices, grid.basis, problem, at)
    tilt = module.honest_tilt(choices, moments)
    assert -3.0 < tilt < 1.5
    stated = np.tensordot(choices.tilted(tilt), moments, 1)
    held = float(choices.share @ module.coverage(moments, stated))
    assert held == pytest.approx(0.95, abs=0.005)


def test_moments_and_mean_are_those_of_each_choice_s_covariance(
    system: LinearSystem, grid: HyperparameterGrid, at: FloatArray
) -> None:
    field = module.plausible(system.normal(), grid, at).fields[0]
    rng, count = np.random.default_rng(8), len(field.covariance)
    left, right = rng.standard_normal((2, 2, at.size, 5))
    found, weight = field.moments(left, right), rng.uniform(0.1, 1.0, count)
    covariances = field.known + field.back @ field.covariance @ field.back.T
    for k, n in np.ndindex(count, 5):
        product = left[..., n] @ covariances[k] @ right[..., n].T
        expected = 0.5 * (product + product.T)[[0, 0, 1], [0, 1, 1]]
        np.testing.assert_allclose(found[k, :, n], expected, rtol=1e-9, atol=1e-9 * np.max(np.abs(product)))
    np.testing.assert_allclose(field.mean_covariance(weight), np.tensordot(weight, covariances, 1), rtol=1e-9)


def test_a_tilt_is_a_power_of_the_amplitude(system: LinearSystem, grid: HyperparameterGrid, at: FloatArray) -> None:
    choices = module.plausible(system.normal(), grid, at)
    np.testing.assert_allclose(choices.tilted(0.0), choices.share)
    expected = choices.share * choices.amplitude**1.5
    np.testing.assert_allclose(choices.tilted(1.5), expected / expected.sum())
    assert choices.share.sum() == pytest.approx(1.0)


def test_without_a_probe_there_is_no_tilt(system: LinearSystem, grid: HyperparameterGrid, at: FloatArray) -> None:
    choices = module.plausible(system.normal(), grid, at)
    assert module.honest_tilt(choices, np.zeros((len(choices.shift), 3, 0))) == 0.0


def test_the_plausible_choices_hold_nearly_all_probability(
    system: LinearSystem, grid: HyperparameterGrid, at: FloatArray
) -> None:
    weight = normalised(log_weights(system.normal(), grid))
    choices = module.plausible(system.normal(), grid, at)
    kept = len(choices.shift)
    assert kept < weight.size
    largest = np.sort(weight.ravel())[::-1]
    assert largest[:kept].sum() > 0.95


def test_probes_are_the_sky_that_the_image_shows(problem: FitProblem, at: FloatArray, grid: HyperparameterGrid) -> None:
    rows, waves = module.sky_rows(problem, at, grid.basis)
    assert 20 < rows.shape[0] < 60
    assert rows.shape[1:] == (2, at.size)
    assert waves.shape == (rows.shape[0], len(grid.basis.orders))
    narrow = replace(problem, template=replace(problem.template, width=100, height=100))
    assert module.sky_rows(narrow, at, grid.basis)[0].shape[0] < rows.shape[0]


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("last", [False, True])
@pytest.mark.parametrize("off_px", [-0.3, 0.3])
def test_probes_are_the_directions_within_the_image_to_its_edges(
    grid: HyperparameterGrid, axis: int, *, last: bool, off_px: float
) -> None:
    """The centre is moved until one direction lands just within or without the edge of the outermost pixels."""
    camera, sky = small_camera(), hemisphere(module.PROBES)
    pixels = project(camera, sky)
    edge = [camera.width, camera.height][axis] - 0.5 if last else -0.5
    nearest = int(np.nanargmin(np.abs(pixels[:, axis] - edge) + 1e3 * ~_within(camera, pixels, axis=1 - axis)))
    center = list(camera.principal_point_px)
    center[axis] += edge + off_px - float(pixels[nearest, axis])
    camera = replace(camera, principal_point_px=(center[0], center[1]))
    pixels = project(camera, sky)
    inside = _within(camera, pixels, axis=0) & _within(camera, pixels, axis=1)
    assert inside[nearest] == ((off_px < 0.0) == last)
    problem = small_problem(camera)
    rows, basis_values = module.sky_rows(problem, problem.unknowns([camera]), grid.basis)
    assert rows.shape == (np.count_nonzero(inside), 2, problem.size)
    np.testing.assert_allclose(basis_values, grid.basis.values(pixels[inside]), atol=1e-9)


def _within(camera: Camera, pixels: FloatArray, *, axis: int) -> NDArray[np.bool_]:
    size = [camera.width, camera.height][axis]
    return np.asarray((pixels[:, axis] > -0.5) & (pixels[:, axis] < size - 0.5))


@pytest.mark.parametrize("shift", [-2.9, -0.3, 0.0, 1.4])
def test_the_root_of_a_rising_function(shift: float) -> None:
    count = 0

    def rising(at: float) -> float:
        nonlocal count
        count += 1
        return math.tanh(3.0 * (at - shift)) + 0.01 * (at - shift)

    assert module.root_of_rising(rising, -3.0, 1.5, close=1e-6) == pytest.approx(shift, abs=1e-6)
    assert count <= 16


def test_where_a_rising_function_has_no_root_it_is_the_nearer_end() -> None:
    assert module.root_of_rising(lambda at: at + 9.0, -3.0, 1.5, close=1e-6) == -3.0
    assert module.root_of_rising(lambda at: at - 9.0, -3.0, 1.5, close=1e-6) == 1.5
