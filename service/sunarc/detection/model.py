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
from sunarc.detection.template import Sources
from sunarc.detection.values import FloatArray, Sensor
from sunarc.detection.window import Window

NONLINEAR = 6
"""x, y, ln psf, and the symmetric stretch s11, s12, s22."""


class Prior(NamedTuple):
    """What is known before: ln psf and its 1-sigma, and whether the disc's stretch is to be found."""

    log_psf: float
    log_psf_sigma: float
    free_stretch: bool


class State(NamedTuple):
    """Parameters: nonlinear (6,), one flux and one background per colour, a slope in x and y."""

    nonlinear: FloatArray
    flux: FloatArray
    background: FloatArray
    slope: FloatArray

    @property
    def stretch(self) -> FloatArray:
        """The symmetric (2, 2) matrix that takes the unit disc to the sun's image, px."""
        s11, s12, s22 = self.nonlinear[3:]
        return np.array([[s11, s12], [s12, s22]])


class Evaluation(NamedTuple):
    """The model at a state, over the used pixels: residual (n,), weight (n,), Jacobian (n, p), planes (9, n)."""

    cost: float
    residual: FloatArray
    weight: FloatArray
    jacobian: FloatArray
    planes: FloatArray


class Problem(NamedTuple):
    """What is fitted: the used pixels' flat position, counts, colour and offset (n, 2) from the start, all (n,)."""

    window: Window
    pixel: NDArray[np.intp]
    counts: FloatArray
    colour: NDArray[np.intp]
    offset: FloatArray
    sensor: Sensor
    sources: Sources
    prior: Prior


def make_problem(
    window: Window, *, usable: NDArray[np.bool_], origin: FloatArray, sensor: Sensor, sources: Sources, prior: Prior
) -> Problem:
    """Gather the usable pixels; `origin` is where the background's slope is pivoted, px in the window."""
    index = np.flatnonzero(usable)
    rows, columns = np.divmod(index, window.counts.shape[1])
    offset = np.stack([columns - origin[0], rows - origin[1]], axis=-1)
    counts, colour = window.counts.ravel()[index], window.colour.ravel()[index]
    return Problem(window, index, counts, colour, offset, sensor, sources, prior)


def without(problem: Problem, bad: NDArray[np.bool_]) -> Problem:
    """Return the problem without some of its pixels."""
    good = ~bad
    return problem._replace(
        pixel=problem.pixel[good], counts=problem.counts[good], colour=problem.colour[good], offset=problem.offset[good]
    )


def _planes(problem: Problem, nonlinear: FloatArray, stretch: FloatArray) -> FloatArray:
    x, y, log_psf = (float(value) for value in nonlinear[:3])
    images = template.render_disc(
        problem.window.counts.shape,
        x,
        y,
        math.exp(log_psf),
        stretch,
        problem.sources.positions,
        problem.sources.weights,
    )
    return np.asarray(images.reshape(9, -1)[:, problem.pixel])


def with_levels(problem: Problem, nonlinear: FloatArray) -> tuple[State, Evaluation]:
    """Return the state whose linear parameters fit best at the given nonlinear ones, and the model there."""
    colours = problem.window.colours
    state = State(nonlinear, np.zeros(colours), np.zeros(colours), np.zeros(2))
    planes = _planes(problem, nonlinear, state.stretch)
    design = _linear_columns(problem, planes)
    root = np.sqrt(1.0 / _variance(problem.sensor, problem.counts))
    solution = np.linalg.lstsq(design * root[:, None], problem.counts * root, rcond=1e-10)[0]
    flux, background, slope = np.split(solution, [colours, 2 * colours])
    best = State(nonlinear, np.maximum(flux, 1e-3), background, slope)
    return best, _evaluated(problem, best, planes)


def _linear_columns(problem: Problem, planes: FloatArray) -> FloatArray:
    own = problem.colour[:, None] == np.arange(problem.window.colours)
    return np.concatenate([own * planes[template.VALUE][:, None], own, problem.offset], axis=1)


def _variance(sensor: Sensor, level: FloatArray) -> FloatArray:
    gain = sensor.gain_e_per_count
    return (sensor.read_noise_e / gain) ** 2 + np.maximum(level, 0.0) / gain + 1.0 / 12.0


def evaluate(problem: Problem, state: State) -> Evaluation:
    """Return residuals, weights, derivatives and twice the negative log likelihood at a state."""
    return _evaluated(problem, state, _planes(problem, state.nonlinear, state.stretch))


def _evaluated(problem: Problem, state: State, planes: FloatArray) -> Evaluation:
    flux = state.flux[problem.colour]
    model = flux * planes[template.VALUE] + state.background[problem.colour] + problem.offset @ state.slope
    residual, variance = problem.counts - model, _variance(problem.sensor, model)
    moved = flux[:, None] * planes[[template.BY_X, template.BY_Y, template.BY_PSF]].T
    moved[:, 2] *= math.exp(state.nonlinear[2])
    parts = [moved, _linear_columns(problem, planes)]
    if problem.prior.free_stretch:
        parts.insert(1, flux[:, None] * planes[template.BY_S11 :].T)
    pull = (state.nonlinear[2] - problem.prior.log_psf) / problem.prior.log_psf_sigma
    cost = float(np.sum(residual**2 / variance + np.log(variance)) + pull**2)
    return Evaluation(cost, residual, 1.0 / variance, np.concatenate(parts, axis=1), planes)


def normal_equations(problem: Problem, state: State, evaluation: Evaluation) -> tuple[FloatArray, FloatArray]:
    """Return the normal matrix and the gradient, with the prior of the point spread."""
    weighted = evaluation.jacobian * evaluation.weight[:, None]
    matrix, gradient = evaluation.jacobian.T @ weighted, weighted.T @ evaluation.residual
    precision = problem.prior.log_psf_sigma**-2
    matrix[2, 2] += precision
    gradient[2] += precision * (problem.prior.log_psf - state.nonlinear[2])
    return matrix, gradient
