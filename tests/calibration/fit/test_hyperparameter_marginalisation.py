"""The covariance over all plausible scales, against the mixture and against draws from it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.fixtures.calibration import observed, small_camera, small_problem, sun_arc

from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.fit import posterior as module
from sunarc.calibration.fit.marginal_likelihood import (
    HyperparameterGrid,
    NormalEquations,
    PriorScales,
    field_sums,
    log_weights,
    marginal_fit,
    normalised,
    scale_grid,
)
from sunarc.calibration.fit.normal_equations import LinearSystem, linear_system
from sunarc.calibration.fit.posterior import PosteriorCovariance, stated_posterior
from sunarc.calibration.solve.priors import STRETCH, free_pixel_aspect
from sunarc.calibration.solve.problem import Bins, FitProblem
from sunarc.optics.camera import Camera
from sunarc.optics.displacement import WaveBasis
from sunarc.optics.forward import project

FloatArray = NDArray[np.float64]
SCALES = PriorScales(0.01, 120.0, 2.0, 0.7)


def _sky_rows(problem: FitProblem, at: FloatArray, basis: WaveBasis) -> tuple[FloatArray, FloatArray]:
    """Return derivatives (n, 2, p) and basis values (n, m) of sky that the last epoch's camera shows."""
    _, pixels, rows = module.shown_sky(problem, at)
    return rows, basis.values(pixels)


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
def posterior(system: LinearSystem, grid: HyperparameterGrid, problem: FitProblem) -> PosteriorCovariance:
    return _posterior(system, grid, problem)


def _posterior(
    system: LinearSystem, grid: HyperparameterGrid, problem: FitProblem, unknowns: FloatArray | None = None
) -> PosteriorCovariance:
    about = system.at if unknowns is None else unknowns
    return stated_posterior(problem, system, about, grid=grid, mean=None)


def _factor(found: PosteriorCovariance, grid: HyperparameterGrid) -> float:
    """Return by what the mean over fields of one amplitude was enlarged."""
    return found.field.amplitude_px / float(grid.amplitudes[0])


def _one_amplitude(grid: HyperparameterGrid) -> HyperparameterGrid:
    return replace(grid, amplitudes=grid.amplitudes[5:6], log_prior=grid.log_prior[5:6])


def _mixture(normal: NormalEquations, grid: HyperparameterGrid, at: FloatArray) -> FloatArray:
    """Return the second moments about `at` of the whole mixture over the grid."""
    weight = normalised(log_weights(normal, grid))
    total = np.zeros((at.size, at.size))
    for (i, j, k), share in np.ndenumerate(weight):
        scales = PriorScales(float(grid.amplitudes[i]), float(grid.lengths[j]), *map(float, grid.lens_scales[k]))
        fit = marginal_fit(normal, grid.basis, scales)
        shift = fit.unknowns - at
        total += share * (fit.covariance + np.outer(shift, shift))
    return total


def test_with_one_amplitude_it_is_the_mixture_s_covariance(
    system: LinearSystem, grid: HyperparameterGrid, problem: FitProblem, at: FloatArray
) -> None:
    one = _one_amplitude(grid)
    found = _posterior(system, one, problem)
    expected = _mixture(system.normal(), one, at)
    factor = _factor(found, one)
    assert factor == pytest.approx(1.0, abs=0.1)
    # 1.5 % of the probability is left out
    scale = np.sqrt(np.diag(expected))
    scaled = found.covariance / np.outer(scale, scale) / factor**2
    np.testing.assert_allclose(scaled, expected / np.outer(scale, scale), atol=0.06)
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
    scales = PriorScales(float(grid.amplitudes[5]), float(grid.lengths[1]), *map(float, grid.lens_scales[1]))
    fit = marginal_fit(system.normal(), grid.basis, scales)
    found = _posterior(system, single, problem, fit.unknowns)
    factor = _factor(found, single)
    assert factor == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(found.covariance / factor**2, fit.covariance, rtol=1e-6, atol=1e-12)
    assert found.mixture is not None
    np.testing.assert_allclose(found.mixture.scales, 1.0, atol=1e-6)
    assert found.field.length_px == pytest.approx(scales.length_px)


@pytest.mark.parametrize("share", [0.0, 0.2, 0.9])
def test_pixels_that_may_not_be_square_have_their_share(
    system: LinearSystem, grid: HyperparameterGrid, problem: FitProblem, at: FloatArray, share: float
) -> None:
    one = _one_amplitude(grid)
    found = stated_posterior(problem, system, at, grid=one, mean=None, stretched=share)
    # the same sightings by a problem that has the wide prior, whose unknowns are larger units
    wide, units = free_pixel_aspect(problem.prior), np.ones(at.size)
    units[STRETCH] = wide.basis[STRETCH, STRETCH] / problem.prior.basis[STRETCH, STRETCH]
    of_wide = _mixture(replace(system, rows=system.rows * units, at=at / units).normal(), one, at / units)
    expected = (1.0 - share) * _mixture(system.normal(), one, at) + share * of_wide * np.outer(units, units)
    scale = np.sqrt(np.diag(expected))
    scaled = found.covariance / np.outer(scale, scale) / _factor(found, one) ** 2
    np.testing.assert_allclose(scaled, expected / np.outer(scale, scale), atol=0.08)
    assert units[STRETCH].min() > 50.0


def test_a_fit_that_is_off_is_charged_with_its_distance(
    system: LinearSystem, grid: HyperparameterGrid, problem: FitProblem, at: FloatArray
) -> None:
    one = _one_amplitude(grid)
    off = np.zeros(at.size)
    off[17] = 0.5
    near, far = (_posterior(system, one, problem, unknowns) for unknowns in (at, at + off))
    near_variance, far_variance = (found.covariance[17, 17] / _factor(found, one) ** 2 for found in (near, far))
    assert far_variance - near_variance == pytest.approx(0.25, rel=0.1)


def test_the_covariance_is_positive_and_of_every_unknown(posterior: PosteriorCovariance, at: FloatArray) -> None:
    assert posterior.covariance.shape == (at.size, at.size)
    np.testing.assert_allclose(posterior.covariance, posterior.covariance.T, atol=1e-12)
    scale = np.sqrt(np.diag(posterior.covariance))
    assert np.min(np.linalg.eigvalsh(posterior.covariance / np.outer(scale, scale))) > 0.0
    assert posterior.field.cross.shape[:2] == (2, at.size)


def test_the_stated_95_percent_hold_95_percent_of_the_mixture(
    system: LinearSystem, grid: HyperparameterGrid, problem: FitProblem, posterior: PosteriorCovariance
) -> None:
    """Against draws from every choice, at places over the sky; and 50, 68 and 99 % by the mixture's own factors."""
    choices = module.plausible(field_sums(system.normal(), grid), grid, system.at)
    rows, values = _sky_rows(problem, system.at, grid.basis)
    moments = module.at_probes(choices, rows, values)
    stated = rows @ posterior.covariance @ rows.swapaxes(1, 2) + posterior.field.covariance(rows, values)
    rng, mixture = np.random.default_rng(3), posterior.mixture
    assert mixture is not None
    square = np.empty((len(rows), 4000))
    for n, inverse in enumerate(np.linalg.inv(stated)):
        xx, xy, yy = moments[rng.choice(choices.share.size, 4000, p=choices.share), :, n].T
        x, y = rng.standard_normal((2, 4000))
        drawn = np.stack([np.sqrt(xx) * x, (xy * x + np.sqrt(np.maximum(xx * yy - xy**2, 0.0)) * y) / np.sqrt(xx)])
        square[n] = np.sum(drawn * (inverse @ drawn), axis=0)
    assert np.mean(square < -2.0 * math.log(0.05)) == pytest.approx(0.95, abs=0.008)
    for share in (0.5, 0.68, 0.95, 0.99):
        factors = mixture.sigma_factors(mixture.pixels_px, share)
        inside = square < -2.0 * math.log(1.0 - share) * factors[:, None] ** 2
        assert inside.mean() == pytest.approx(share, abs=0.015)


def test_moments_and_mean_are_those_of_each_choice_s_covariance(
    system: LinearSystem, grid: HyperparameterGrid, at: FloatArray
) -> None:
    choices, rng = module.plausible(field_sums(system.normal(), grid), grid, at), np.random.default_rng(8)
    left, right = rng.standard_normal((2, len(choices.fields), 2, at.size, 5))
    beside, shift = rng.standard_normal((len(choices.fields), 3, 5)), rng.standard_normal((2, choices.field.size, 5))
    found = choices.moments(left, right, beside, shift)
    known, back = choices.known[choices.field], choices.back[choices.field]
    covariances = known + back @ choices.covariance @ back.swapaxes(1, 2)
    for k, n in np.ndindex(len(covariances), 5):
        field = choices.field[k]
        product = left[field, ..., n] @ covariances[k] @ right[field, ..., n].T
        product = 0.5 * (product + product.T) + np.outer(shift[:, k, n], shift[:, k, n])
        expected = product[[0, 0, 1], [0, 1, 1]] + beside[field, :, n]
        np.testing.assert_allclose(found[k, :, n], expected, rtol=1e-9, atol=1e-9 * np.max(np.abs(product)))
    mean = np.tensordot(choices.share, covariances, 1) + (choices.shift.T * choices.share) @ choices.shift
    np.testing.assert_allclose(choices.mean_covariances()[0], mean, rtol=1e-9, atol=1e-12)


def test_without_a_place_that_is_shown_there_is_no_mixture(
    system: LinearSystem, grid: HyperparameterGrid, problem: FitProblem
) -> None:
    nowhere = replace(problem, template=replace(problem.template, width=1, height=1))
    assert _posterior(system, grid, nowhere).mixture is None


def test_the_plausible_choices_hold_nearly_all_probability(
    system: LinearSystem, grid: HyperparameterGrid, at: FloatArray
) -> None:
    weight = normalised(log_weights(system.normal(), grid))
    choices = module.plausible(field_sums(system.normal(), grid), grid, at)
    kept = len(choices.shift)
    assert kept < weight.size
    largest = np.sort(weight.ravel())[::-1]
    assert largest[:kept].sum() > 0.95


def test_probes_are_the_sky_that_the_image_shows(problem: FitProblem, at: FloatArray, grid: HyperparameterGrid) -> None:
    rows, waves = _sky_rows(problem, at, grid.basis)
    assert 20 < rows.shape[0] < 60
    assert rows.shape[1:] == (2, at.size)
    assert waves.shape == (rows.shape[0], len(grid.basis.orders))
    narrow = replace(problem, template=replace(problem.template, width=100, height=100))
    assert _sky_rows(narrow, at, grid.basis)[0].shape[0] < rows.shape[0]


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
    rows, basis_values = _sky_rows(problem, problem.unknowns([camera]), grid.basis)
    assert rows.shape == (np.count_nonzero(inside), 2, problem.size)
    np.testing.assert_allclose(basis_values, grid.basis.values(pixels[inside]), atol=1e-9)


def _within(camera: Camera, pixels: FloatArray, *, axis: int) -> NDArray[np.bool_]:
    size = [camera.width, camera.height][axis]
    return np.asarray((pixels[:, axis] > -0.5) & (pixels[:, axis] < size - 0.5))
