"""The disc model at a state, and its derivatives.

Every pixel's variance follows from the model itself (read noise, photons, rounding), so that the fit is that of a
Gaussian likelihood. Each colour of a Bayer mosaic has its own disc brightness and background: no demosaicking.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sunarc.detection import template
from sunarc.detection.template import Sources, SunSources
from sunarc.detection.values import FloatArray, Sensor
from sunarc.detection.window import Window

PSF, WINGS, STRETCH = 2, 3, slice(4, 7)
"""Where ln psf, the wings' share and the stretch (s11, s12, s22) stand among the nonlinear parameters x, y, …"""


_STEPPED = 0.1  # counts²
_GLARE_CORE = 2.0  # solar radii within which scattered light is flat

_BY_WINGS, _SMEAR, _GLARE = 11, 12, 13  # planes after the template's own
_MOVED = [template.BY_X, template.BY_Y, template.BY_PSF, _BY_WINGS, template.BY_S11, template.BY_S12, template.BY_S22]


class Prior(NamedTuple):
    """What is known before: ln psf and its 1-sigma, that of the wings' share; whether wings and stretch are free."""

    log_psf: float
    log_psf_sigma: float
    wings_sigma: float
    free_stretch: bool
    free_wings: bool = False

    @property
    def free(self) -> list[int]:
        """The nonlinear parameters that the fit may move."""
        return [0, 1, PSF] + [WINGS] * self.free_wings + [4, 5, 6] * self.free_stretch


class State(NamedTuple):
    """Parameters: nonlinear (7,), one flux and one background per colour, and what is around.

    around : the background's slope in x and y, the smear of the sun's columns, and the glare.
    """

    nonlinear: FloatArray
    flux: FloatArray
    background: FloatArray
    around: FloatArray

    @property
    def stretch(self) -> FloatArray:
        """The symmetric (2, 2) matrix that takes the unit disc to the sun's image, px."""
        s11, s12, s22 = self.nonlinear[STRETCH]
        return np.array([[s11, s12], [s12, s22]])


class Evaluation(NamedTuple):
    """The model at a state, over the used pixels: residual (n,), weight (n,), Jacobian (n, p), planes (14, n)."""

    cost: float
    residual: FloatArray
    weight: FloatArray
    jacobian: FloatArray
    planes: FloatArray


class Problem(NamedTuple):
    """What is fitted: of the used pixels flat position, counts, colour, column, and offset (n, 2) from the origin."""

    window: Window
    pixel: NDArray[np.intp]
    counts: FloatArray
    colour: NDArray[np.intp]
    column: NDArray[np.intp]
    offset: FloatArray
    origin: FloatArray
    sensor: Sensor
    sources: SunSources
    prior: Prior


def make_problem(
    window: Window, *, usable: NDArray[np.bool_], origin: FloatArray, sensor: Sensor, sources: SunSources, prior: Prior
) -> Problem:
    """Gather the usable pixels; `origin` is where the background's slope is pivoted, px in the window."""
    index = np.flatnonzero(usable)
    rows, columns = np.divmod(index, window.counts.shape[1])
    offset = np.stack([columns - origin[0], rows - origin[1]], axis=-1)
    counts, colour = window.counts.ravel()[index], window.colour.ravel()[index]
    return Problem(window, index, counts, colour, columns, offset, origin, sensor, sources, prior)


def without(problem: Problem, bad: NDArray[np.bool_]) -> Problem:
    """Return the problem without some of its pixels."""
    good = ~bad
    return problem._replace(
        pixel=problem.pixel[good],
        counts=problem.counts[good],
        colour=problem.colour[good],
        column=problem.column[good],
        offset=problem.offset[good],
    )


def _planes(problem: Problem, nonlinear: FloatArray, stretch: FloatArray) -> FloatArray:
    """Return the disc's planes, the derivative by the wings' share, smear and glare: (14, n)."""
    share, psf = float(nonlinear[WINGS]), math.exp(float(nonlinear[PSF]))
    image = _rendered(problem, nonlinear, stretch, psf=psf, sources=problem.sources.core)
    core = image.reshape(len(image), -1)[:, problem.pixel]
    around = [image[template.VALUE].sum(axis=0)[problem.column], _glare(problem, nonlinear, stretch)]
    if not problem.prior.free_wings:
        return np.concatenate([core, np.zeros_like(core[:1]), around])
    wide = _rendered(problem, nonlinear, stretch, psf=template.WING_PSF * psf, sources=problem.sources.wings)
    wings = wide.reshape(len(wide), -1)[:, problem.pixel]
    return np.concatenate([core + share * (wings - core), wings[:1] - core[:1], around])


def _rendered(
    problem: Problem, nonlinear: FloatArray, stretch: FloatArray, *, psf: float, sources: Sources
) -> FloatArray:
    x, y, shape = float(nonlinear[0]), float(nonlinear[1]), problem.window.counts.shape
    return np.asarray(template.render_disc(shape, x, y, psf, stretch, sources.positions, sources.weights))


def _glare(problem: Problem, nonlinear: FloatArray, stretch: FloatArray) -> FloatArray:
    """Return light scattered around the sun, falling with the square of the angle outside two solar radii: (n,)."""
    dx, dy = (problem.offset + (problem.origin - nonlinear[:2])).T
    a, b, d = float(stretch[0, 0]), float(stretch[0, 1]), float(stretch[1, 1])
    scale = max(abs(a * d - b * b), 1e-9) * _GLARE_CORE
    u, v = (d * dx - b * dy) / scale, (a * dy - b * dx) / scale
    return np.asarray(1.0 / (1.0 + u * u + v * v))


def with_levels(problem: Problem, nonlinear: FloatArray) -> tuple[State, Evaluation]:
    """Return the state whose linear parameters fit best at the given nonlinear ones, and the model there."""
    colours = problem.window.colours
    state = State(nonlinear, np.zeros(colours), np.zeros(colours), np.zeros(4))
    planes = _planes(problem, nonlinear, state.stretch)
    design = _linear_columns(problem, planes)
    root = np.sqrt(1.0 / _variance(problem.sensor, problem.counts))
    solution = np.linalg.lstsq(design * root[:, None], problem.counts * root, rcond=1e-10)[0]
    flux, background, around = np.split(solution, [colours, 2 * colours])
    best = State(nonlinear, np.maximum(flux, 1e-3), background, around)
    return best, _evaluated(problem, best, planes)


def _linear_columns(problem: Problem, planes: FloatArray) -> FloatArray:
    own = problem.colour[:, None] == np.arange(problem.window.colours)
    around = [problem.offset, planes[[_SMEAR, _GLARE]].T]
    return np.concatenate([own * planes[template.VALUE][:, None], own, *around], axis=1)


def _variance(sensor: Sensor, level: FloatArray) -> FloatArray:
    """Return the variance in counts²; where noise is too small to blur the steps, rounding errs by up to 1/4."""
    gain = sensor.gain_e_per_count
    noise = (sensor.read_noise_e / gain) ** 2 + np.maximum(level, 0.0) / gain
    return np.asarray(np.where(noise < _STEPPED, 0.25, noise + 1.0 / 12.0))


def evaluate(problem: Problem, state: State) -> Evaluation:
    """Return residuals, weights, derivatives and twice the negative log likelihood at a state."""
    return _evaluated(problem, state, _planes(problem, state.nonlinear, state.stretch))


def _evaluated(problem: Problem, state: State, planes: FloatArray) -> Evaluation:
    flux = state.flux[problem.colour]
    model = (
        flux * planes[template.VALUE]
        + state.background[problem.colour]
        + problem.offset @ state.around[:2]
        + state.around[2:] @ planes[[_SMEAR, _GLARE]]
    )
    residual, variance = problem.counts - model, _variance(problem.sensor, model)
    moved = flux[:, None] * planes[_MOVED].T
    moved[:, PSF] *= math.exp(state.nonlinear[PSF])
    jacobian = np.concatenate([moved[:, problem.prior.free], _linear_columns(problem, planes)], axis=1)
    pull = _pull(problem.prior, state)
    cost = float(np.sum(residual**2 / variance + np.log(variance))) + float(pull @ pull)
    return Evaluation(cost, residual, 1.0 / variance, jacobian, planes)


def normal_equations(problem: Problem, state: State, evaluation: Evaluation) -> tuple[FloatArray, FloatArray]:
    """Return the normal matrix and the gradient, with the prior of the point spread."""
    weighted = evaluation.jacobian * evaluation.weight[:, None]
    matrix, gradient = evaluation.jacobian.T @ weighted, weighted.T @ evaluation.residual
    own = slice(PSF, PSF + 1 + problem.prior.free_wings)
    pull, precision = _pull(problem.prior, state), _precision(problem.prior)
    count = own.stop - own.start
    matrix[own, own] += np.diag(precision[:count] ** 2)
    gradient[own] += (precision * pull)[:count]
    return matrix, gradient


def _pull(prior: Prior, state: State) -> FloatArray:
    """Return what the prior says of ln psf and the wings' share, in its sigmas."""
    return (np.array([prior.log_psf, 0.0]) - state.nonlinear[[PSF, WINGS]]) * _precision(prior)


def _precision(prior: Prior) -> FloatArray:
    return np.array([1.0 / prior.log_psf_sigma, 1.0 / prior.wings_sigma])
