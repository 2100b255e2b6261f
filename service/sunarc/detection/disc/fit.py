"""The least-squares fit of the sun's disc, saturated pixels left out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.common.robust_statistics import mad_sigma
from sunarc.detection.disc import model
from sunarc.detection.disc.window import Window
from sunarc.detection.values import LightFit, Sensor

Solved = tuple[FloatArray, FloatArray]

_LEAST_SHIFT = 0.3
"""Shift of the centre, over its sigma, below which a band is of no matter."""
_RIDGE = 0.02
"""Share by which the bands' own information is enlarged: a band of nearly all rows is the disc and background again."""
_LEAST_REST = 0.1
"""Share of the position's information that must lie outside of a band to tell how well the model fits otherwise."""
_BAND, _OVER_COLUMNS = 35.0, 3.0
"""Decrease of chi², over that of the other pixels, that a band's two parameters gain, and by how much more the best
band of rows gains than the best of columns."""
_LARGE_BAND, _LARGE_OVER_COLUMNS = 200.0, 1.5
"""The same for much that is foreign, which the columns notice too."""


def is_foreign(rows: float, columns: float) -> bool:
    """Return whether bands of rows explain so much more than bands of columns that only foreign rows can be the cause.

    Parameters
    ----------
    rows, columns : of `band_gain`.
    """
    return rows > max(_BAND, _OVER_COLUMNS * columns) or rows > max(_LARGE_BAND, _LARGE_OVER_COLUMNS * columns)


def band_gain(
    problem: model.DiscProblem, state: model.DiscState, evaluation: model.Evaluation, solved: Solved, *, sigma_px: float
) -> tuple[float, float]:
    """Return how much the best band of rows, and the best band of columns, lowers the fit's chi².

    Parameters
    ----------
    problem, state, evaluation : of the fit.
    solved : (p, p) covariance of its parameters, and (p,) gradient: a fit that creeps on is not quite at its end.
    sigma_px : of its centre.

    Returns
    -------
    Decrease of chi² by a background and a brightness of the disc of the band's own, over the mean chi² of the pixels
    outside of it; the largest of all bands that would shift the centre noticeably.
    """
    height, width = problem.window.counts.shape
    row, column = np.divmod(problem.pixels.place, width)
    disc = evaluation.planes[0].reshape(height, problem.sensor.binning, width, problem.sensor.binning).mean(axis=(1, 3))
    light = disc.ravel()[problem.pixels.place] * state.flux[problem.pixels.colour]
    own = np.stack([np.ones(light.size), light / max(float(light.max()), 1e-9)], axis=-1)
    least_px = _LEAST_SHIFT * sigma_px
    return (
        _find_best_band(row, height, own, evaluation, solved, least_px=least_px),
        _find_best_band(column, width, own, evaluation, solved, least_px=least_px),
    )


def _find_best_band(
    line: NDArray[np.intp],
    lines: int,
    own: FloatArray,
    evaluation: model.Evaluation,
    solved: Solved,
    *,
    least_px: float,
) -> float:
    """Return the largest decrease of chi² of all bands of lines: a score test, its sums taken line by line."""
    jacobian, weight, residual = evaluation.jacobian, evaluation.weight, evaluation.residual
    covariance, gradient = solved
    p = jacobian.shape[1]
    beside = np.concatenate([jacobian, own, residual[:, None]], axis=1)
    first, last = np.triu_indices(lines + 1, 1)
    products = (own * weight[:, None])[:, :, None] * beside[:, None, :]
    sums = _sum_bands(products.reshape(line.size, -1), line, lines, first, last).reshape(-1, 2, p + 3)
    pull = sums[:, :, :p] @ covariance  # of the band's parameters on the disc's
    matrix = sums[:, :, p : p + 2] - pull @ np.swapaxes(sums[:, :, :p], 1, 2)
    own_information = np.einsum("mii->mi", sums[:, :, p : p + 2])
    matrix += np.eye(2) * (_RIDGE * own_information + 1e-12)[:, :, None]
    score = sums[:, :, p + 2] - pull @ gradient
    fitted = np.linalg.solve(matrix, score[:, :, None])[:, :, 0]
    gained = np.einsum("mi,mi->m", score, fitted)
    shift_px = np.linalg.norm(np.einsum("mik,mi->mk", pull[:, :, :2], fitted), axis=1)
    total = float(weight @ residual**2)
    misfit = np.maximum(
        (total - gained) / max(line.size - p - 2, 1), _chi2_outside_bands(line, lines, evaluation, covariance)
    )
    noticeable = shift_px > least_px
    return float(np.max(gained[noticeable] / np.maximum(misfit[noticeable], 1.0), initial=0.0))


def _chi2_outside_bands(
    line: NDArray[np.intp], lines: int, evaluation: model.Evaluation, covariance: FloatArray
) -> FloatArray:
    """Return the mean chi² of the pixels outside of each band, each counting as much as it tells of the position."""
    information, chi2 = model.pixel_information(evaluation.jacobian, evaluation.weight, evaluation.residual, covariance)
    first, last = np.triu_indices(lines + 1, 1)
    values = np.stack([information, information * chi2], axis=-1)
    total = values.sum(axis=0)
    rest = total - _sum_bands(values, line, lines, first, last)
    enough = rest[:, 0] > _LEAST_REST * total[0]
    return np.asarray(
        np.where(enough, rest[:, 1] / np.maximum(rest[:, 0], 1e-300), total[1] / max(float(total[0]), 1e-300))
    )


def _sum_bands(
    values: FloatArray, line: NDArray[np.intp], lines: int, first: NDArray[np.intp], last: NDArray[np.intp]
) -> FloatArray:
    """Return the sums of (n, k) values over the lines from each `first` to before each `last`."""
    by_line = np.zeros((lines + 1, values.shape[1]))
    np.add.at(by_line, line + 1, values)
    until = np.cumsum(by_line, axis=0)
    return np.asarray(until[last] - until[first])


_STEPS = 15
_STEPS_BINNED = 40
_CONVERGED_PX = 2e-4
_CONVERGED_COST = 0.2  # change of the cost; a saturated disc's level and size may creep on, its centre stands
_OUTLIER = 6.0
_MOST_OUTLIERS = 3
_CLEANINGS = 3
_MULTISTART_CHI2 = 1.12  # reduced chi² above which other starts are tried
_WINGS_CHI2 = 1.3  # reduced chi² above which the point spread gets wings


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DiscFit(LightFit):
    """The fitted disc; positions in the image, levels in counts above black.

    Its sigma is scaled by the reduced chi² of the pixels that tell the position, its residual is what noise does not
    explain, over the level (at most full scale).

    Attributes
    ----------
    stretch : (2, 2) px, from the unit disc.
    level : the brightest colour's level of the disc's centre. background : that colour's level around it.
    uneven : decrease of chi² by a disc of linear and quadratic brightness, over the reduced chi².
    bands : decrease of chi² by a band of rows and by one of columns (`band_gain`).
    used_px, converged : pixels that took part; whether the steps became small.
    """

    stretch: FloatArray
    level: float
    background: float
    uneven: float
    bands: tuple[float, float]
    used_px: int
    converged: bool


def fit_disc(
    window: Window,
    *,
    start: tuple[float, float],
    shapes: Sequence[tuple[float, FloatArray]],
    sources: model.SunSources,
    sensor: Sensor,
    prior: model.Prior,
) -> DiscFit | None:
    """Fit the disc in a window.

    Parameters
    ----------
    window : the pixels.
    start : first guess of the centre in the image, px.
    shapes : first guesses to choose from: the point spread, px, and the (2, 2) symmetric matrix, px, that takes the
        unit disc to the sun's image.
    sources : the unit disc.
    sensor, prior : noise, and what is known of the disc.

    Returns
    -------
    The fit, or None where too few pixels can be used.
    """
    position = np.array([start[0] - window.first[0], start[1] - window.first[1]])
    starts = [np.array([*position, math.log(psf), 0.0, s[0, 0], s[0, 1], s[1, 1]]) for psf, s in shapes]
    problem = model.make_problem(window, origin=position, sensor=sensor, sources=sources, prior=prior)
    if problem.pixels.place.size < 30 + 4 * window.colours:
        return None
    state, evaluation, converged = _fit_from_best_start(problem, starts)
    for _ in range(_CLEANINGS):
        bad = _find_outliers(evaluation)
        if not bad.any():
            break
        problem = model.without(problem, bad)
        state, evaluation, converged = _minimise(problem, state, model.evaluate(problem, state))
    if _compute_reduced_chi2(evaluation) > _WINGS_CHI2:
        problem = problem._replace(prior=prior._replace(free_wings=True))
        state, evaluation, converged = _minimise(problem, state, model.evaluate(problem, state))
    return _make_disc_fit(problem, state, evaluation, converged=converged)


def _fit_from_best_start(
    problem: model.DiscProblem, starts: list[FloatArray]
) -> tuple[model.DiscState, model.Evaluation, bool]:
    """Fit from the first start, and from the best of the others where its chi² is high.

    A saturated disc hides its shape: where that is free a poor start may fit well, and the best is taken at once.
    """
    if problem.window.saturated_px and problem.sensor.binning > 1:  # clipped means: many local minima
        return min(
            (_minimise(problem, *model.solve_levels(problem, start)) for start in starts), key=lambda one: one[1].cost
        )
    if problem.window.saturated_px and problem.prior.free_stretch:
        return _minimise(problem, *_best_start(problem, starts))
    end = _minimise(problem, *model.solve_levels(problem, starts[0]))
    if len(starts) == 1 or _compute_reduced_chi2(end[1]) < _MULTISTART_CHI2:
        return end
    return min(end, _minimise(problem, *_best_start(problem, starts[1:])), key=lambda one: one[1].cost)


def _best_start(problem: model.DiscProblem, starts: list[FloatArray]) -> tuple[model.DiscState, model.Evaluation]:
    return min((model.solve_levels(problem, nonlinear) for nonlinear in starts), key=lambda start: start[1].cost)


def _compute_reduced_chi2(evaluation: model.Evaluation) -> float:
    """Return the reduced chi²."""
    count, parameters = int(evaluation.jacobian.shape[0]), int(evaluation.jacobian.shape[1])
    return float(evaluation.weight @ evaluation.residual**2) / max(count - parameters, 1)


def _apply_step(problem: model.DiscProblem, state: model.DiscState, step: FloatArray) -> model.DiscState:
    nonlinear, colours = state.nonlinear.copy(), problem.window.colours
    free, middle = problem.prior.free, problem.prior.log_psf
    count = len(free)
    nonlinear[free] += np.minimum(np.maximum(step[:count], -2.0), 2.0)
    # Beyond a factor of 4.5 the sources are too coarse or too many for this point spread.
    nonlinear[model.PSF] = min(max(nonlinear[model.PSF], middle - 1.5), middle + 1.5)
    nonlinear[model.WINGS] = min(max(nonlinear[model.WINGS], 0.0), 0.3)
    flux, background = step[count : count + colours], step[count + colours : count + 2 * colours]
    around = step[count + 2 * colours :]
    return model.DiscState(nonlinear, state.flux + flux, state.background + background, state.around + around)


def _minimise(
    problem: model.DiscProblem, state: model.DiscState, evaluation: model.Evaluation
) -> tuple[model.DiscState, model.Evaluation, bool]:
    """Minimise by Levenberg and Marquardt's method."""
    # Almost a Gauss-Newton step: the start is within a pixel, and each rejected step raises the damping 100-fold.
    damping = 1e-6
    binned = problem.sensor.binning > 1  # clipped means tell the disc's size, which moves their centre
    settled = math.inf if problem.window.saturated_px and not binned else _CONVERGED_COST
    for _ in range(_STEPS if not binned else _STEPS_BINNED):
        matrix, gradient = model.normal_equations(problem, state, evaluation)
        diagonal = matrix.ravel()[:: gradient.size + 1]
        diagonal += np.maximum(diagonal, 1e-12) * damping + 1e-12
        step = np.asarray(np.linalg.solve(matrix, gradient), dtype=np.float64)
        next_state = _apply_step(problem, state, step)
        tried = model.evaluate(problem, next_state)
        moved, gained = float(np.max(np.abs(step[:2]))), evaluation.cost - tried.cost
        still = moved < _CONVERGED_PX and abs(gained) < settled
        small = still or (moved < 10.0 * _CONVERGED_PX and abs(gained) < 0.01)
        # A step that raises the cost by less than 1e-3 is taken: the weights follow the model, which moves the cost.
        if gained > -1e-3:
            state, evaluation, damping = next_state, tried, damping * 0.1
        else:
            damping = max(damping, 1e-5) * 100.0
        if small:  # also after a step that cost a little: the weights follow the model, and their gradient is left out
            return state, evaluation, True
        if damping > 1e8:
            break
    return state, evaluation, False


def _find_outliers(evaluation: model.Evaluation) -> BoolArray:
    """Return the few pixels that no disc explains (hot or dead ones); empty where they are many."""
    deviation = np.abs(evaluation.residual) * np.sqrt(evaluation.weight)
    if float(deviation.max()) <= _OUTLIER:
        return np.zeros(deviation.size, np.bool_)
    typical = mad_sigma(deviation)
    # Only what is half as bad as the worst: a hot pixel drags the fit, and its neighbours look bad with it.
    bad = deviation > max(_OUTLIER * max(1.0, typical), 0.5 * float(deviation.max()))
    return bad if np.count_nonzero(bad) <= _MOST_OUTLIERS else np.zeros_like(bad)


def _make_disc_fit(
    problem: model.DiscProblem, state: model.DiscState, evaluation: model.Evaluation, *, converged: bool
) -> DiscFit:
    matrix, gradient = model.normal_equations(problem, state, evaluation)
    covariance = model.inverse(matrix)
    count = evaluation.residual.size
    chi2 = _compute_reduced_chi2(evaluation)
    first_flux = matrix.shape[0] - state.around.size - 2 * problem.window.colours
    levels = state.flux / max(abs(float(np.linalg.det(state.stretch))), 1e-9)
    best = int(np.argmax(levels))
    flux_sigma = math.sqrt(max(float(model.inverse(matrix[first_flux:, first_flux:])[best, best]), 1e-30))
    level = float(levels[best]) / (math.pi * problem.sources.core.mean_level)
    # Mean square beyond the expected variance: negative by chance where the model is right.
    excess = float(np.mean(evaluation.residual**2 - 1.0 / evaluation.weight))
    top = max(min(level, problem.sensor.full_scale - problem.sensor.black_level), 1e-9)
    sigma_px = math.sqrt(
        max(0.5 * float(np.trace(covariance[:2, :2])) * _compute_local_chi2(evaluation, covariance), 0.0)
    )
    return DiscFit(
        x_px=float(state.nonlinear[0]) + problem.window.first[0],
        y_px=float(state.nonlinear[1]) + problem.window.first[1],
        sigma_px=sigma_px,
        width_px=math.exp(float(state.nonlinear[model.PSF])),
        stretch=state.stretch,
        level=level,
        background=float(state.background[best]),
        snr=float(state.flux[best]) / flux_sigma,
        chi2=chi2,
        residual=math.sqrt(max(excess, 0.0)) / top,
        uneven=model.unevenness(problem, state, evaluation) / max(chi2, 1.0),
        bands=band_gain(problem, state, evaluation, (covariance, gradient), sigma_px=sigma_px),
        used_px=count,
        converged=converged,
    )


def _compute_local_chi2(evaluation: model.Evaluation, covariance: FloatArray) -> float:
    """Return the reduced chi² of the pixels that tell the position, each counting as much as it tells.

    It rests on few pixels, so it is widened as Student's distribution is: the mean square of error / sigma stays 1.
    """
    information, chi2 = model.pixel_information(evaluation.jacobian, evaluation.weight, evaluation.residual, covariance)
    total, squares, misfit = (max(float(information @ by), 1e-300) for by in (np.ones(chi2.size), information, chi2))
    freedom = max(total**2 / squares, 4.0)
    return float(misfit / total * freedom / (freedom - 2.0))
