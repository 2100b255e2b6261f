"""The disc model at a state, and its derivatives.

Every pixel's variance follows from the model itself (read noise, photons, rounding), so that the fit is that of a
Gaussian likelihood. Each colour of a Bayer mosaic has its own disc brightness and background: no demosaicking.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sunarc.array_types import BoolArray, FloatArray
from sunarc.detection.disc import kernels, template
from sunarc.detection.disc.template import Sources, SunSources
from sunarc.detection.disc.window import Window
from sunarc.detection.values import Sensor

PSF, WINGS, STRETCH = 2, 3, slice(4, 7)
"""Where ln psf, the wings' share and the stretch (s11, s12, s22) stand among the nonlinear parameters x, y, …"""


_GLARE_CORE = 2.0  # solar radii within which scattered light is flat

_BY_WINGS = 11  # the plane after the template's own
_MOVED = (template.BY_X, template.BY_Y, template.BY_PSF, _BY_WINGS, template.BY_S11, template.BY_S12, template.BY_S22)
_BY_LENGTH = [template.BY_X, template.BY_Y, template.BY_PSF, template.BY_S11, template.BY_S12, template.BY_S22]
_UNEVEN = (template.SLOPE_U, template.SLOPE_V, template.BEND_UU, template.BEND_UV)


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
    """The model at a state, over the used pixels: residual (n,), weight (n,), Jacobian (n, p), the disc's planes.

    cost : twice the negative log likelihood, with the prior. The Jacobian's columns are the free nonlinear parameters,
    flux and background of each colour, slope in x and y, smear and glare.
    """

    cost: float
    residual: FloatArray
    weight: FloatArray
    jacobian: FloatArray
    planes: FloatArray


class Problem(NamedTuple):
    """What is fitted: of the used pixels flat position, counts, colour, and offset (n, 2) from the origin."""

    window: Window
    pixel: NDArray[np.intp]
    counts: FloatArray
    colour: NDArray[np.intp]
    offset: FloatArray
    origin: FloatArray
    sensor: Sensor
    sources: SunSources
    prior: Prior


def make_problem(window: Window, *, origin: FloatArray, sensor: Sensor, sources: SunSources, prior: Prior) -> Problem:
    """Gather the usable pixels; `origin` is where the background's slope is pivoted, px in the window."""
    index = np.flatnonzero(window.usable)
    rows, columns = np.divmod(index, window.counts.shape[1])
    offset = np.stack([columns - origin[0], rows - origin[1]], axis=-1)
    counts, colour = window.counts.ravel()[index], window.colour.ravel()[index]
    return Problem(window, index, counts, colour, offset, origin, sensor, sources, prior)


def without(problem: Problem, bad: BoolArray) -> Problem:
    """Return the problem without some of its pixels."""
    good = ~bad
    return problem._replace(
        pixel=problem.pixel[good],
        counts=problem.counts[good],
        colour=problem.colour[good],
        offset=problem.offset[good],
    )


def with_levels(problem: Problem, nonlinear: FloatArray) -> tuple[State, Evaluation]:
    """Return the state whose linear parameters fit best at the given nonlinear ones, and the model there."""
    colours = problem.window.colours
    dark = State(nonlinear, np.zeros(colours), np.zeros(colours), np.zeros(4))
    planes = _planes(problem, dark)
    # The model is not known yet, so that the variance comes from the counts themselves.
    misfit = _compared(problem, dark, planes, moved=(), by_counts=True)
    linear = problem.window.linear.ravel()[problem.pixel]
    matrix, gradient = kernels.normal_of(misfit[3], misfit[2] * linear, misfit[1])
    levels = inverse(matrix) @ gradient
    # A dark hole would give a negative flux, which is no disc.
    flux = np.maximum(levels[:colours], 1e-3)
    best = State(nonlinear, flux, levels[colours : 2 * colours], levels[2 * colours :])
    return best, _evaluated(problem, best, planes)


def inverse(matrix: FloatArray) -> FloatArray:
    """Return the inverse of a normal matrix; what the data do not tell becomes a large finite variance."""
    scale = np.sqrt(np.maximum(matrix.diagonal(), 1e-12))
    both = scale[:, None] * scale
    scaled = matrix / both
    # A ridge on the scaled diagonal: parameters of no information stay invertible, the others do not notice.
    scaled.ravel()[:: scale.size + 1] += 1e-11
    return np.asarray(np.linalg.inv(scaled) / both)


def evaluate(problem: Problem, state: State) -> Evaluation:
    """Return residuals, weights, derivatives and twice the negative log likelihood at a state."""
    return _evaluated(problem, state, _planes(problem, state))


def _planes(problem: Problem, state: State) -> FloatArray:
    """Return the disc's planes, and where the wings are free the derivative by their share."""
    psf, sources = math.exp(state.nonlinear[PSF]), problem.sources
    core = _rendered(problem, state, sources.core, psf=psf)
    if not problem.prior.free_wings:
        return core
    wings = _rendered(problem, state, sources.wings, psf=template.WING_PSF * psf)
    wings[template.BY_PSF] *= template.WING_PSF  # by the core's point spread, of which the wings' is a multiple
    more = wings - core
    return np.concatenate([core + state.nonlinear[WINGS] * more, more[:1]])


def _rendered(problem: Problem, state: State, sources: Sources, *, psf: float) -> FloatArray:
    """Return the disc's planes on the sensor's own pixels; derivatives are by the image's, which are `binning` wide."""
    n, (rows, columns) = problem.sensor.binning, problem.window.counts.shape
    x, y = (n * state.nonlinear[:2] + 0.5 * (n - 1)).tolist()
    planes: FloatArray = template.render_disc(
        (n * rows, n * columns), x, y, n * psf, n * state.stretch, sources.positions, sources.weights
    )
    if n > 1:
        planes *= n**2  # of a disc whose flux is the sum over the image's pixels
        planes[_BY_LENGTH] *= n
    return planes


def _evaluated(problem: Problem, state: State, planes: FloatArray) -> Evaluation:
    moved = tuple(_MOVED[k] for k in problem.prior.free)
    misfit, residual, weight, jacobian = _compared(problem, state, planes, moved=moved)
    pull = _pulls(problem.prior, state)
    return Evaluation(misfit + pull[0] ** 2 + pull[1] ** 2, residual, weight, jacobian, planes)


def _compared(
    problem: Problem, state: State, planes: FloatArray, *, moved: tuple[int, ...], by_counts: bool = False
) -> kernels.Compared:
    psf, (x, y) = math.exp(state.nonlinear[PSF]), (state.nonlinear[:2] - problem.origin).tolist()
    a, b, d = state.nonlinear[STRETCH].tolist()
    # (d, b, a) / det is the inverse of the symmetric stretch: pixels to solar radii, over the glare's core.
    core = _GLARE_CORE * max(abs(a * d - b * b), 1e-9)
    gain = problem.sensor.gain_e_per_count
    answer: kernels.Compared = kernels.compared(
        planes,
        np.array(moved, dtype=np.intp),
        np.array([psf if plane == template.BY_PSF else 1.0 for plane in moved]),
        (d / core, b / core, a / core, x, y),
        (problem.pixel, problem.counts, problem.colour, problem.offset),
        state.flux,
        state.background,
        state.around,
        (float(problem.sensor.read_noise_e / gain), float(gain)),
        by_counts,
        problem.sensor.binning,
        _clip(problem.sensor),
    )
    return answer


def _clip(sensor: Sensor) -> float:
    """Return the counts above black at which the sensor's pixels are clipped; inf where those above are left out."""
    return float(sensor.full_scale - sensor.black_level) if sensor.binning > 1 else math.inf


def unevenness(problem: Problem, state: State, evaluation: Evaluation) -> float:
    """Return the decrease of chi² by a disc of linear and quadratic brightness."""
    moved = tuple(_MOVED[k] for k in problem.prior.free) + _UNEVEN
    wider = evaluation._replace(jacobian=_compared(problem, state, evaluation.planes, moved=moved)[3])
    matrix, gradient = normal_equations(problem, state, wider)
    return float(gradient @ inverse(matrix) @ gradient)


def normal_equations(problem: Problem, state: State, evaluation: Evaluation) -> tuple[FloatArray, FloatArray]:
    """Return the normal matrix and the gradient, with the prior of the point spread."""
    matrix: FloatArray
    gradient: FloatArray
    matrix, gradient = kernels.normal_of(evaluation.jacobian, evaluation.weight, evaluation.residual)
    pulls, sigmas = _pulls(problem.prior, state), (problem.prior.log_psf_sigma, problem.prior.wings_sigma)
    for k in (PSF, WINGS)[: 1 + problem.prior.free_wings]:
        matrix[k, k] += sigmas[k - PSF] ** -2
        gradient[k] += pulls[k - PSF] / sigmas[k - PSF]
    return matrix, gradient


def _pulls(prior: Prior, state: State) -> tuple[float, float]:
    """Return the prior's residuals of ln psf and the wings' share, in its sigmas."""
    log_psf, share = state.nonlinear[PSF : WINGS + 1].tolist()
    return (prior.log_psf - log_psf) / prior.log_psf_sigma, -share / prior.wings_sigma
