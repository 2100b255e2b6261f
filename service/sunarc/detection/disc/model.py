"""The disc model at a state, and its derivatives.

Every pixel's variance follows from the model itself (read noise, photons, rounding), so that the fit is that of a
Gaussian likelihood. Each colour of a Bayer mosaic has its own disc brightness and background: no demosaicking.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sunarc import _kernels
from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.detection.disc.window import Window
from sunarc.detection.values import Sensor

Indices = NDArray[np.intp]
Likelihood = tuple[float, FloatArray, FloatArray, FloatArray]


class UsedPixels(NamedTuple):
    """Of the pixels used flat position (n,), counts, colour, and offset (n, 2) from the background's pivot."""

    place: Indices
    counts: FloatArray
    colour: Indices
    offset: FloatArray


def normal_matrix(jacobian: FloatArray, weight: FloatArray, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the normal matrix (p, p) and the gradient (p,) of weighted least squares."""
    root = np.sqrt(weight)
    rows = jacobian * root[:, None]
    return rows.T @ rows, rows.T @ (root * residual)


def pixel_information(
    jacobian: FloatArray, weight: FloatArray, residual: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return each pixel's information on the first two parameters, and its chi² over one minus its leverage, (n,)."""
    moved = jacobian @ covariance
    leverage = np.einsum("ik,ik->i", moved, jacobian) * weight
    information = np.sum(moved[:, :2] ** 2, axis=1) * weight
    return information, weight * residual**2 / np.maximum(1.0 - leverage, 0.05)


VALUE, BY_X, BY_Y, BY_PSF, SLOPE_U, SLOPE_V, BEND_UU, BEND_UV, BY_S11, BY_S12, BY_S22 = range(11)
"""Planes of `render_disc`."""

_MOST_RINGS = 24
_DENSITIES = 8.0  # steps per unit of radius over point spread in which sources are made and kept


class Sources(NamedTuple):
    """Point sources on the unit disc: positions (k, 2), weights (k,) that sum to 1, mean over central brightness."""

    positions: FloatArray
    weights: FloatArray
    mean_level: float


class SunSources(NamedTuple):
    """The same disc seen through the core of the point spread and through its wings."""

    core: Sources
    wings: Sources


WING_PSF = 3.0
"""The wings' point spread over the core's."""


def sun_sources(*, radius_px: float, psf_px: float, limb_darkening: float) -> SunSources:
    """Return the sources of a disc of this radius for a core of this point spread and its wings."""
    core, wings = (
        disc_sources(radius_px=radius_px, psf_px=psf, limb_darkening=limb_darkening)
        for psf in (psf_px, WING_PSF * psf_px)
    )
    return SunSources(core, wings)


def disc_sources(*, radius_px: float, psf_px: float, limb_darkening: float) -> Sources:
    """Return sources dense enough that a disc of this radius shows no grain through this point spread."""
    return _make_sources(math.ceil(_DENSITIES * radius_px / psf_px) / _DENSITIES, limb_darkening)


@lru_cache(maxsize=64)
def _make_sources(radius_in_psf: float, limb_darkening: float) -> Sources:
    # Rings 0.7 of the point spread apart: a coarser disc would show them, a finer one costs time a source.
    rings = min(max(4, math.ceil(1.4 * radius_in_psf)), _MOST_RINGS)
    nodes, node_weights = np.polynomial.legendre.leggauss(rings)
    radii = 0.5 * (nodes + 1.0)
    ring_weights = node_weights * radii * (1.0 - limb_darkening * (1.0 - np.sqrt(1.0 - radii**2)))
    counts = np.maximum(6, np.ceil(2.0 * math.pi * radii * radius_in_psf / 1.1)).astype(int)
    ring = np.repeat(np.arange(rings), counts)
    within = np.arange(ring.size) - np.repeat(np.cumsum(counts) - counts, counts)
    # Every other ring is turned by half a step, so that sources of neighbouring rings do not line up.
    angle = 2.0 * math.pi * (within + 0.5 * (ring % 2)) / counts[ring]
    positions = np.ascontiguousarray(radii[ring, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
    weights = ring_weights[ring] / counts[ring]
    weights /= weights.sum()
    # The cache gives the same arrays to every caller and thread.
    positions.flags.writeable = weights.flags.writeable = False
    return Sources(positions, weights, 1.0 - limb_darkening / 3.0)


def render_disc(  # noqa: PLR0917 - where and how large, in the order of the formula
    shape: tuple[int, int], x: float, y: float, psf: float, stretch: FloatArray, sources: Sources
) -> FloatArray:
    """Return the image of a disc of unit flux and its derivatives, (11, rows, columns): VALUE … BY_S22.

    SLOPE_… and BEND_… are the image of a disc whose brightness is multiplied by u, v, u² - v² and uv, the coordinates
    on the unit disc.

    Parameters
    ----------
    shape : rows and columns of the window.
    x, y : the disc's centre in the window, px.
    psf : standard deviation of the point spread, px.
    stretch : (2, 2) px, takes the unit disc to the sun's image; the derivatives take it as symmetric.
    sources : on the unit disc.
    """
    return _kernels.render_disc(*shape, x, y, psf, stretch, sources.positions, sources.weights)


PSF, WINGS, STRETCH = 2, 3, slice(4, 7)
"""Where ln psf, the wings' share and the stretch (s11, s12, s22) stand among the nonlinear parameters x, y, …"""


_GLARE_CORE = 2.0  # solar radii within which scattered light is flat

_BY_WINGS = 11  # the plane after the template's own
_MOVED = (BY_X, BY_Y, BY_PSF, _BY_WINGS, BY_S11, BY_S12, BY_S22)
_BY_LENGTH = [BY_X, BY_Y, BY_PSF, BY_S11, BY_S12, BY_S22]
_UNEVEN = (SLOPE_U, SLOPE_V, BEND_UU, BEND_UV)


class Prior(NamedTuple):
    """Prior of the disc: ln psf and its 1-sigma, that of the wings' share; whether wings and stretch are free."""

    log_psf: float
    log_psf_sigma: float
    wings_sigma: float
    free_stretch: bool
    free_wings: bool = False

    @property
    def free(self) -> list[int]:
        """The nonlinear parameters that the fit may move."""
        return [0, 1, PSF] + [WINGS] * self.free_wings + [4, 5, 6] * self.free_stretch


class DiscState(NamedTuple):
    """Parameters: nonlinear (7,), and the linear ones."""

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


class DiscProblem(NamedTuple):
    """Inputs of the disc's fit; `origin` is where the background's slope is pivoted, px in the window."""

    window: Window
    pixels: UsedPixels
    origin: FloatArray
    sensor: Sensor
    sources: SunSources
    prior: Prior


def make_problem(
    window: Window, *, origin: FloatArray, sensor: Sensor, sources: SunSources, prior: Prior
) -> DiscProblem:
    """Gather the usable pixels; `origin` is where the background's slope is pivoted, px in the window."""
    index = np.flatnonzero(window.usable)
    rows, columns = np.divmod(index, window.counts.shape[1])
    offset = np.stack([columns - origin[0], rows - origin[1]], axis=-1)
    counts, colour = window.counts.ravel()[index], window.colour.ravel()[index]
    return DiscProblem(window, UsedPixels(index, counts, colour, offset), origin, sensor, sources, prior)


def without(problem: DiscProblem, bad: BoolArray) -> DiscProblem:
    """Return the problem without the pixels of a mask."""
    place, counts, colour, offset = problem.pixels
    return problem._replace(pixels=UsedPixels(place[~bad], counts[~bad], colour[~bad], offset[~bad]))


def solve_levels(problem: DiscProblem, nonlinear: FloatArray) -> tuple[DiscState, Evaluation]:
    """Return the state whose linear parameters fit best at the given nonlinear ones, and the model there."""
    colours = problem.window.colours
    dark = DiscState(nonlinear, np.zeros(colours), np.zeros(colours), np.zeros(4))
    planes = _render_planes(problem, dark)
    # The model is not known yet, so that the variance comes from the counts themselves.
    misfit = _compute_likelihood(problem, dark, planes, moved=(), by_counts=True)
    linear = problem.window.linear.ravel()[problem.pixels.place]
    matrix, gradient = normal_matrix(misfit[3], misfit[2] * linear, misfit[1])
    levels = inverse(matrix) @ gradient
    # A dark hole would give a negative flux, which is no disc.
    flux = np.maximum(levels[:colours], 1e-3)
    best = DiscState(nonlinear, flux, levels[colours : 2 * colours], levels[2 * colours :])
    return best, _evaluate_planes(problem, best, planes)


def inverse(matrix: FloatArray) -> FloatArray:
    """Return the inverse of a normal matrix; an undetermined direction gets a large finite variance."""
    scale = np.sqrt(np.maximum(matrix.diagonal(), 1e-12))
    both = scale[:, None] * scale
    scaled = matrix / both
    # A ridge on the scaled diagonal: parameters of no information stay invertible, the others do not notice.
    scaled.ravel()[:: scale.size + 1] += 1e-11
    return np.asarray(np.linalg.inv(scaled) / both)


def evaluate(problem: DiscProblem, state: DiscState) -> Evaluation:
    """Return residuals, weights, derivatives and twice the negative log likelihood at a state."""
    return _evaluate_planes(problem, state, _render_planes(problem, state))


def _render_planes(problem: DiscProblem, state: DiscState) -> FloatArray:
    """Return the disc's planes, and where the wings are free the derivative by their share."""
    psf, sources = math.exp(state.nonlinear[PSF]), problem.sources
    core = _render_on_sensor(problem, state, sources.core, psf=psf)
    if not problem.prior.free_wings:
        return core
    wings = _render_on_sensor(problem, state, sources.wings, psf=WING_PSF * psf)
    wings[BY_PSF] *= WING_PSF  # by the core's point spread, of which the wings' is a multiple
    more = wings - core
    return np.concatenate([core + state.nonlinear[WINGS] * more, more[:1]])


def _render_on_sensor(problem: DiscProblem, state: DiscState, sources: Sources, *, psf: float) -> FloatArray:
    """Return the disc's planes on the sensor's own pixels; derivatives are by the image's, which are `binning` wide."""
    n, (rows, columns) = problem.sensor.binning, problem.window.counts.shape
    x, y = (n * state.nonlinear[:2] + 0.5 * (n - 1)).tolist()
    planes = render_disc((n * rows, n * columns), x, y, n * psf, n * state.stretch, sources)
    if n > 1:
        planes *= n**2  # of a disc whose flux is the sum over the image's pixels
        planes[_BY_LENGTH] *= n
    return planes


def _evaluate_planes(problem: DiscProblem, state: DiscState, planes: FloatArray) -> Evaluation:
    moved = tuple(_MOVED[k] for k in problem.prior.free)
    misfit, residual, weight, jacobian = _compute_likelihood(problem, state, planes, moved=moved)
    pull = _prior_residuals(problem.prior, state)
    return Evaluation(misfit + pull[0] ** 2 + pull[1] ** 2, residual, weight, jacobian, planes)


def _compute_likelihood(
    problem: DiscProblem, state: DiscState, planes: FloatArray, *, moved: tuple[int, ...], by_counts: bool = False
) -> Likelihood:
    psf, (x, y) = math.exp(state.nonlinear[PSF]), (state.nonlinear[:2] - problem.origin).tolist()
    a, b, d = state.nonlinear[STRETCH].tolist()
    # (d, b, a) / det is the inverse of the symmetric stretch: pixels to solar radii, over the glare's core.
    core = _GLARE_CORE * max(abs(a * d - b * b), 1e-9)
    gain = problem.sensor.gain_e_per_count
    return _kernels.likelihood_of(
        planes,
        np.array(moved, dtype=np.intp),
        np.array([psf if plane == BY_PSF else 1.0 for plane in moved]),
        np.array([d / core, b / core, a / core, x, y]),
        *problem.pixels,
        state.flux,
        state.background,
        state.around,
        problem.sensor.read_noise_e / gain,
        gain,
        problem.sensor.binning,
        _clipping_counts(problem.sensor),
        by_counts,
    )


def _clipping_counts(sensor: Sensor) -> float:
    """Return the counts above black at which the sensor's pixels are clipped; inf where those above are left out."""
    return float(sensor.full_scale - sensor.black_level) if sensor.binning > 1 else math.inf


def unevenness(problem: DiscProblem, state: DiscState, evaluation: Evaluation) -> float:
    """Return the decrease of chi² by a disc of linear and quadratic brightness."""
    moved = tuple(_MOVED[k] for k in problem.prior.free) + _UNEVEN
    wider = evaluation._replace(jacobian=_compute_likelihood(problem, state, evaluation.planes, moved=moved)[3])
    matrix, gradient = normal_equations(problem, state, wider)
    return float(gradient @ inverse(matrix) @ gradient)


def normal_equations(problem: DiscProblem, state: DiscState, evaluation: Evaluation) -> tuple[FloatArray, FloatArray]:
    """Return the normal matrix and the gradient, with the prior of the point spread."""
    matrix: FloatArray
    gradient: FloatArray
    matrix, gradient = normal_matrix(evaluation.jacobian, evaluation.weight, evaluation.residual)
    pulls, sigmas = _prior_residuals(problem.prior, state), (problem.prior.log_psf_sigma, problem.prior.wings_sigma)
    for k in (PSF, WINGS)[: 1 + problem.prior.free_wings]:
        matrix[k, k] += sigmas[k - PSF] ** -2
        gradient[k] += pulls[k - PSF] / sigmas[k - PSF]
    return matrix, gradient


def _prior_residuals(prior: Prior, state: DiscState) -> tuple[float, float]:
    """Return the prior's residuals of ln psf and the wings' share, in its sigmas."""
    log_psf, share = state.nonlinear[PSF : WINGS + 1].tolist()
    return (prior.log_psf - log_psf) / prior.log_psf_sigma, -share / prior.wings_sigma
