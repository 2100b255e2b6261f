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

from sunarc.array_types import BoolArray, FloatArray
from sunarc.detection.disc.window import Window
from sunarc.detection.values import Sensor
from sunarc.jit import njit

Indices = NDArray[np.intp]
Likelihood = tuple[float, FloatArray, FloatArray, FloatArray]

_STEPPED = 0.1  # counts² of noise below which it does not blur the steps of rounding


class UsedPixels(NamedTuple):
    """Of the pixels used flat position (n,), counts, colour, and offset (n, 2) from the background's pivot."""

    place: Indices
    counts: FloatArray
    colour: Indices
    offset: FloatArray


class Readout(NamedTuple):
    """How light becomes counts.

    noise : of the readout, counts. gain : electrons per count. binning, clip : each pixel is the mean of binning² of
    the sensor's, which are clipped at so many counts. by_counts : take the variance that the counts tell, not the
    model.
    """

    noise: float
    gain: float
    binning: int
    clip: float
    by_counts: bool


class Levels(NamedTuple):
    """flux, background : one per colour. around : the background's slope in x and y, smear of the columns, glare."""

    flux: FloatArray
    background: FloatArray
    around: FloatArray


@njit(nogil=True)
def likelihood_of(  # noqa: PLR0917 - compiled functions take positions
    planes: FloatArray,
    moved: tuple[Indices, FloatArray],
    glare: tuple[float, float, float, float, float],
    pixels: UsedPixels,
    levels: Levels,
    readout: Readout,
) -> Likelihood:
    """Compare a disc's model with the pixels.

    Parameters
    ----------
    planes : (k, binning rows, binning columns) the disc of unit flux, first its value, on the sensor's pixels.
    moved : the planes that are derivatives by the free nonlinear parameters, and what each is multiplied by.
    glare : u and v are (a dx - b dy, c dy - b dx) and dx, dy are what a pixel is off (x, y): a, b, c, x, y.
    pixels, levels, readout : the pixels used, the linear parameters, and the sensor.

    Returns
    -------
    Twice the negative log likelihood, residual (n,), weight (n,) and Jacobian (n, p), its columns the free nonlinear
    parameters, flux and background of each colour, slope in x and y, smear and glare.
    """
    pixel, counts, colour, offset = pixels
    flux, background, around = levels
    binning, clip, by_plane, scale = readout.binning, readout.clip, moved[0], moved[1]
    a, b, c, x, y = glare
    columns, share = planes.shape[2] // binning, 1.0 / binning**2
    nonlinear, colours = by_plane.size, flux.size
    smear = np.zeros(columns)
    for j in range(planes.shape[1]):
        for i in range(columns * binning):
            smear[i // binning] += planes[0, j, i] * share
    first = nonlinear + 2 * colours
    jacobian = np.zeros((pixel.size, first + 4))
    residual, weight, misfit = np.empty(pixel.size), np.empty(pixel.size), 0.0
    for i in range(pixel.size):
        channel, (j, k) = colour[i], divmod(pixel[i], columns)
        dx, dy = offset[i, 0] - x, offset[i, 1] - y
        u, v = a * dx - b * dy, c * dy - b * dx
        jacobian[i, first], jacobian[i, first + 1] = offset[i, 0], offset[i, 1]
        jacobian[i, first + 2], jacobian[i, first + 3] = smear[k], 1.0 / (1.0 + u * u + v * v)
        beside, model, unclipped = background[channel], 0.0, 0.0
        for m in range(4):
            beside += around[m] * jacobian[i, first + m]
        for row in range(j * binning, (j + 1) * binning):
            for column in range(k * binning, (k + 1) * binning):
                value = flux[channel] * planes[0, row, column] + beside
                if value >= clip:  # more light changes nothing
                    model += clip * share
                    continue
                model, unclipped = model + value * share, unclipped + share
                for m in range(nonlinear):
                    jacobian[i, m] += share * flux[channel] * scale[m] * planes[by_plane[m], row, column]
                jacobian[i, nonlinear + channel] += share * planes[0, row, column]
        jacobian[i, nonlinear + colours + channel] = unclipped
        for m in range(4):
            jacobian[i, first + m] *= unclipped
        variance = readout.noise**2 + max(counts[i] if readout.by_counts else model, 0.0) / readout.gain
        variance = 0.25 if variance < _STEPPED else variance + 1.0 / 12.0
        residual[i], weight[i] = counts[i] - model, 1.0 / variance
        misfit += residual[i] * residual[i] / variance + math.log(variance)
    return misfit, residual, weight, jacobian


def normal_of(jacobian: FloatArray, weight: FloatArray, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the normal matrix (p, p) and the gradient (p,) of weighted least squares."""
    root = np.sqrt(weight)
    rows = jacobian * root[:, None]
    return rows.T @ rows, rows.T @ (root * residual)


def information_of(
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
_REACH = 5.0  # point-spread widths beyond which a source is dark


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
    return _sources(math.ceil(_DENSITIES * radius_px / psf_px) / _DENSITIES, limb_darkening)


@lru_cache(maxsize=64)
def _sources(radius_in_psf: float, limb_darkening: float) -> Sources:
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


@njit(nogil=True)
def _spread(first: int, last: int, center: float, psf: float, out: FloatArray) -> None:
    """Fill out (3, …) for pixels first … last: the share of a source, and its derivatives by center and psf."""
    root = math.sqrt(0.5)
    norm = 1.0 / math.sqrt(2.0 * math.pi)
    z = (first - 0.5 - center) / psf
    below, density = math.erf(z * root), norm * math.exp(-0.5 * z * z)
    for i in range(first, last + 1):
        z_next = (i + 0.5 - center) / psf
        above, density_next = math.erf(z_next * root), norm * math.exp(-0.5 * z_next * z_next)
        out[0, i] = 0.5 * (above - below)
        out[1, i] = (density - density_next) / psf
        out[2, i] = (z * density - z_next * density_next) / psf
        z, below, density = z_next, above, density_next


@njit(nogil=True)
def render_disc(  # noqa: PLR0917 - numba compiles no keyword-only arguments
    shape: tuple[int, int], x: float, y: float, psf: float, stretch: FloatArray, sources: Sources
) -> FloatArray:
    """Return the image of a disc of unit flux and its derivatives.

    Parameters
    ----------
    shape : rows and columns of the window.
    x, y : the disc's centre in the window, px.
    psf : standard deviation of the point spread, px.
    stretch : (2, 2) px, takes the unit disc to the sun's image; the derivatives take it as symmetric.
    sources : on the unit disc.

    Returns
    -------
    (11, rows, columns): the planes named VALUE … BY_S22; SLOPE_… and BEND_… are the image of a disc whose brightness
    is multiplied by u, v, u² - v² and uv, the coordinates on the unit disc.
    """
    rows, columns = shape
    positions, weights = sources.positions, sources.weights
    out = np.zeros((11, rows, columns))
    across, down = np.zeros((3, columns)), np.zeros((3, rows))
    # The half pixel keeps a pixel whose near edge is within reach though its centre is not.
    reach = _REACH * psf + 0.5
    for k in range(weights.size):
        u, v, weight = positions[k, 0], positions[k, 1], weights[k]
        uu, uv = u * u - v * v, u * v
        px = x + stretch[0, 0] * u + stretch[0, 1] * v
        py = y + stretch[1, 0] * u + stretch[1, 1] * v
        i0, i1 = max(0, math.ceil(px - reach)), min(columns - 1, math.floor(px + reach))
        j0, j1 = max(0, math.ceil(py - reach)), min(rows - 1, math.floor(py + reach))
        if i1 < i0 or j1 < j0:
            continue
        _spread(i0, i1, px, psf, across)
        _spread(j0, j1, py, psf, down)
        for j in range(j0, j1 + 1):
            d0, d1, d2 = weight * down[0, j], weight * down[1, j], weight * down[2, j]
            for i in range(i0, i1 + 1):
                value, by_x, by_y = d0 * across[0, i], d0 * across[1, i], d1 * across[0, i]
                out[0, j, i] += value
                out[1, j, i] += by_x
                out[2, j, i] += by_y
                out[3, j, i] += d0 * across[2, i] + d2 * across[0, i]
                out[4, j, i] += u * value
                out[5, j, i] += v * value
                out[6, j, i] += uu * value
                out[7, j, i] += uv * value
                out[8, j, i] += u * by_x
                out[9, j, i] += v * by_x + u * by_y
                out[10, j, i] += v * by_y
    return out


PSF, WINGS, STRETCH = 2, 3, slice(4, 7)
"""Where ln psf, the wings' share and the stretch (s11, s12, s22) stand among the nonlinear parameters x, y, …"""


_GLARE_CORE = 2.0  # solar radii within which scattered light is flat

_BY_WINGS = 11  # the plane after the template's own
_MOVED = (BY_X, BY_Y, BY_PSF, _BY_WINGS, BY_S11, BY_S12, BY_S22)
_BY_LENGTH = [BY_X, BY_Y, BY_PSF, BY_S11, BY_S12, BY_S22]
_UNEVEN = (SLOPE_U, SLOPE_V, BEND_UU, BEND_UV)


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
    """What is fitted; `origin` is where the background's slope is pivoted, px in the window."""

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
    """Return the problem without some of its pixels."""
    place, counts, colour, offset = problem.pixels
    return problem._replace(pixels=UsedPixels(place[~bad], counts[~bad], colour[~bad], offset[~bad]))


def with_levels(problem: DiscProblem, nonlinear: FloatArray) -> tuple[DiscState, Evaluation]:
    """Return the state whose linear parameters fit best at the given nonlinear ones, and the model there."""
    colours = problem.window.colours
    dark = DiscState(nonlinear, np.zeros(colours), np.zeros(colours), np.zeros(4))
    planes = _planes(problem, dark)
    # The model is not known yet, so that the variance comes from the counts themselves.
    misfit = _likelihood(problem, dark, planes, moved=(), by_counts=True)
    linear = problem.window.linear.ravel()[problem.pixels.place]
    matrix, gradient = normal_of(misfit[3], misfit[2] * linear, misfit[1])
    levels = inverse(matrix) @ gradient
    # A dark hole would give a negative flux, which is no disc.
    flux = np.maximum(levels[:colours], 1e-3)
    best = DiscState(nonlinear, flux, levels[colours : 2 * colours], levels[2 * colours :])
    return best, _evaluated(problem, best, planes)


def inverse(matrix: FloatArray) -> FloatArray:
    """Return the inverse of a normal matrix; what the data do not tell becomes a large finite variance."""
    scale = np.sqrt(np.maximum(matrix.diagonal(), 1e-12))
    both = scale[:, None] * scale
    scaled = matrix / both
    # A ridge on the scaled diagonal: parameters of no information stay invertible, the others do not notice.
    scaled.ravel()[:: scale.size + 1] += 1e-11
    return np.asarray(np.linalg.inv(scaled) / both)


def evaluate(problem: DiscProblem, state: DiscState) -> Evaluation:
    """Return residuals, weights, derivatives and twice the negative log likelihood at a state."""
    return _evaluated(problem, state, _planes(problem, state))


def _planes(problem: DiscProblem, state: DiscState) -> FloatArray:
    """Return the disc's planes, and where the wings are free the derivative by their share."""
    psf, sources = math.exp(state.nonlinear[PSF]), problem.sources
    core = _rendered(problem, state, sources.core, psf=psf)
    if not problem.prior.free_wings:
        return core
    wings = _rendered(problem, state, sources.wings, psf=WING_PSF * psf)
    wings[BY_PSF] *= WING_PSF  # by the core's point spread, of which the wings' is a multiple
    more = wings - core
    return np.concatenate([core + state.nonlinear[WINGS] * more, more[:1]])


def _rendered(problem: DiscProblem, state: DiscState, sources: Sources, *, psf: float) -> FloatArray:
    """Return the disc's planes on the sensor's own pixels; derivatives are by the image's, which are `binning` wide."""
    n, (rows, columns) = problem.sensor.binning, problem.window.counts.shape
    x, y = (n * state.nonlinear[:2] + 0.5 * (n - 1)).tolist()
    planes: FloatArray = render_disc((n * rows, n * columns), x, y, n * psf, n * state.stretch, sources)
    if n > 1:
        planes *= n**2  # of a disc whose flux is the sum over the image's pixels
        planes[_BY_LENGTH] *= n
    return planes


def _evaluated(problem: DiscProblem, state: DiscState, planes: FloatArray) -> Evaluation:
    moved = tuple(_MOVED[k] for k in problem.prior.free)
    misfit, residual, weight, jacobian = _likelihood(problem, state, planes, moved=moved)
    pull = _pulls(problem.prior, state)
    return Evaluation(misfit + pull[0] ** 2 + pull[1] ** 2, residual, weight, jacobian, planes)


def _likelihood(
    problem: DiscProblem, state: DiscState, planes: FloatArray, *, moved: tuple[int, ...], by_counts: bool = False
) -> Likelihood:
    psf, (x, y) = math.exp(state.nonlinear[PSF]), (state.nonlinear[:2] - problem.origin).tolist()
    a, b, d = state.nonlinear[STRETCH].tolist()
    # (d, b, a) / det is the inverse of the symmetric stretch: pixels to solar radii, over the glare's core.
    core = _GLARE_CORE * max(abs(a * d - b * b), 1e-9)
    gain = problem.sensor.gain_e_per_count
    answer: Likelihood = likelihood_of(
        planes,
        (np.array(moved, dtype=np.intp), np.array([psf if plane == BY_PSF else 1.0 for plane in moved])),
        (d / core, b / core, a / core, x, y),
        problem.pixels,
        Levels(state.flux, state.background, state.around),
        Readout(
            float(problem.sensor.read_noise_e / gain),
            float(gain),
            problem.sensor.binning,
            _clip(problem.sensor),
            by_counts,
        ),
    )
    return answer


def _clip(sensor: Sensor) -> float:
    """Return the counts above black at which the sensor's pixels are clipped; inf where those above are left out."""
    return float(sensor.full_scale - sensor.black_level) if sensor.binning > 1 else math.inf


def unevenness(problem: DiscProblem, state: DiscState, evaluation: Evaluation) -> float:
    """Return the decrease of chi² by a disc of linear and quadratic brightness."""
    moved = tuple(_MOVED[k] for k in problem.prior.free) + _UNEVEN
    wider = evaluation._replace(jacobian=_likelihood(problem, state, evaluation.planes, moved=moved)[3])
    matrix, gradient = normal_equations(problem, state, wider)
    return float(gradient @ inverse(matrix) @ gradient)


def normal_equations(problem: DiscProblem, state: DiscState, evaluation: Evaluation) -> tuple[FloatArray, FloatArray]:
    """Return the normal matrix and the gradient, with the prior of the point spread."""
    matrix: FloatArray
    gradient: FloatArray
    matrix, gradient = normal_of(evaluation.jacobian, evaluation.weight, evaluation.residual)
    pulls, sigmas = _pulls(problem.prior, state), (problem.prior.log_psf_sigma, problem.prior.wings_sigma)
    for k in (PSF, WINGS)[: 1 + problem.prior.free_wings]:
        matrix[k, k] += sigmas[k - PSF] ** -2
        gradient[k] += pulls[k - PSF] / sigmas[k - PSF]
    return matrix, gradient


def _pulls(prior: Prior, state: DiscState) -> tuple[float, float]:
    """Return the prior's residuals of ln psf and the wings' share, in its sigmas."""
    log_psf, share = state.nonlinear[PSF : WINGS + 1].tolist()
    return (prior.log_psf - log_psf) / prior.log_psf_sigma, -share / prior.wings_sigma
