"""The least-squares fit of the sun's disc, saturated pixels left out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sunarc.array_types import BoolArray, FloatArray
from sunarc.detection.disc import kernels
from sunarc.detection.disc.model import (
    PSF,
    WINGS,
    Evaluation,
    Prior,
    Problem,
    State,
    evaluate,
    inverse,
    make_problem,
    normal_equations,
    unevenness,
    with_levels,
    without,
)
from sunarc.detection.disc.row_bands import band_evidence
from sunarc.detection.disc.template import SunSources
from sunarc.detection.disc.window import Window
from sunarc.detection.values import Sensor
from sunarc.robust_statistics import mad_sigma

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
class DiscFit:
    """The fitted disc; positions in the image, levels in counts above black.

    Attributes
    ----------
    x_px, y_px, sigma_px : centre and its 1-sigma per axis, scaled by the reduced chi².
    psf_px : point spread. stretch : (2, 2) px, from the unit disc.
    level : the brightest colour's level of the disc's centre. background : that colour's level around it.
    snr : flux over its standard deviation, the shape given. chi2 : reduced chi².
    residual : rms of what noise does not explain, over the level (at most full scale).
    uneven : decrease of chi² by a disc of linear and quadratic brightness, over the reduced chi².
    bands : decrease of chi² by a band of rows and by one of columns (`row_bands`).
    used_px, converged : pixels that took part; whether the steps became small.
    """

    x_px: float
    y_px: float
    sigma_px: float
    psf_px: float
    stretch: FloatArray
    level: float
    background: float
    snr: float
    chi2: float
    residual: float
    uneven: float
    bands: tuple[float, float]
    used_px: int
    converged: bool


def fit_disc(
    window: Window,
    *,
    start: tuple[float, float],
    shapes: Sequence[tuple[float, FloatArray]],
    sources: SunSources,
    sensor: Sensor,
    prior: Prior,
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
    problem = make_problem(window, origin=position, sensor=sensor, sources=sources, prior=prior)
    if problem.counts.size < 30 + 4 * window.colours:
        return None
    state, evaluation, converged = _from_best(problem, starts)
    for _ in range(_CLEANINGS):
        bad = _outliers(evaluation)
        if not bad.any():
            break
        problem = without(problem, bad)
        state, evaluation, converged = _solve(problem, state, evaluate(problem, state))
    if _chi2(evaluation) > _WINGS_CHI2:
        problem = problem._replace(prior=prior._replace(free_wings=True))
        state, evaluation, converged = _solve(problem, state, evaluate(problem, state))
    return _summary(problem, state, evaluation, converged=converged)


def _from_best(problem: Problem, starts: list[FloatArray]) -> tuple[State, Evaluation, bool]:
    """Fit from the first start, and from the best of the others where its chi² is high.

    A saturated disc hides its shape: where that is free a poor start may fit well, and the best is taken at once.
    """
    if problem.window.saturated_px and problem.sensor.binning > 1:  # clipped means: many valleys
        return min((_solve(problem, *with_levels(problem, start)) for start in starts), key=lambda one: one[1].cost)
    if problem.window.saturated_px and problem.prior.free_stretch:
        return _solve(problem, *_best_start(problem, starts))
    end = _solve(problem, *with_levels(problem, starts[0]))
    if len(starts) == 1 or _chi2(end[1]) < _MULTISTART_CHI2:
        return end
    return min(end, _solve(problem, *_best_start(problem, starts[1:])), key=lambda one: one[1].cost)


def _best_start(problem: Problem, starts: list[FloatArray]) -> tuple[State, Evaluation]:
    return min((with_levels(problem, nonlinear) for nonlinear in starts), key=lambda start: start[1].cost)


def _chi2(evaluation: Evaluation) -> float:
    """Return the reduced chi²."""
    count, parameters = int(evaluation.jacobian.shape[0]), int(evaluation.jacobian.shape[1])
    return float(evaluation.weight @ evaluation.residual**2) / max(count - parameters, 1)


def _stepped(problem: Problem, state: State, step: FloatArray) -> State:
    nonlinear, colours = state.nonlinear.copy(), problem.window.colours
    free, middle = problem.prior.free, problem.prior.log_psf
    count = len(free)
    nonlinear[free] += np.minimum(np.maximum(step[:count], -2.0), 2.0)
    # Beyond a factor of 4.5 the sources are too coarse or too many for this point spread.
    nonlinear[PSF] = min(max(nonlinear[PSF], middle - 1.5), middle + 1.5)
    nonlinear[WINGS] = min(max(nonlinear[WINGS], 0.0), 0.3)
    flux, background = step[count : count + colours], step[count + colours : count + 2 * colours]
    around = step[count + 2 * colours :]
    return State(nonlinear, state.flux + flux, state.background + background, state.around + around)


def _solve(problem: Problem, state: State, evaluation: Evaluation) -> tuple[State, Evaluation, bool]:
    """Minimise by Levenberg and Marquardt's method."""
    # Almost a Gauss-Newton step: the start is within a pixel, and each rejected step raises the damping 100-fold.
    damping = 1e-6
    binned = problem.sensor.binning > 1  # clipped means tell the disc's size, which moves their centre
    settled = math.inf if problem.window.saturated_px and not binned else _CONVERGED_COST
    for _ in range(_STEPS if not binned else _STEPS_BINNED):
        matrix, gradient = normal_equations(problem, state, evaluation)
        diagonal = matrix.ravel()[:: gradient.size + 1]
        diagonal += np.maximum(diagonal, 1e-12) * damping + 1e-12
        step = np.asarray(np.linalg.solve(matrix, gradient), dtype=np.float64)
        next_state = _stepped(problem, state, step)
        tried = evaluate(problem, next_state)
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


def _outliers(evaluation: Evaluation) -> BoolArray:
    """Return the few pixels that no disc explains (hot or dead ones); none where they are many."""
    deviation = np.abs(evaluation.residual) * np.sqrt(evaluation.weight)
    if float(deviation.max()) <= _OUTLIER:
        return np.zeros(deviation.size, np.bool_)
    typical = mad_sigma(deviation)
    # Only what is half as bad as the worst: a hot pixel drags the fit, and its neighbours look bad with it.
    bad = deviation > max(_OUTLIER * max(1.0, typical), 0.5 * float(deviation.max()))
    return bad if np.count_nonzero(bad) <= _MOST_OUTLIERS else np.zeros_like(bad)


def _summary(problem: Problem, state: State, evaluation: Evaluation, *, converged: bool) -> DiscFit:
    matrix, gradient = normal_equations(problem, state, evaluation)
    covariance = inverse(matrix)
    count = evaluation.residual.size
    chi2 = _chi2(evaluation)
    first_flux = matrix.shape[0] - state.around.size - 2 * problem.window.colours
    levels = state.flux / max(abs(float(np.linalg.det(state.stretch))), 1e-9)
    best = int(np.argmax(levels))
    flux_sigma = math.sqrt(max(float(inverse(matrix[first_flux:, first_flux:])[best, best]), 1e-30))
    level = float(levels[best]) / (math.pi * problem.sources.core.mean_level)
    # Mean square beyond the expected variance: negative by chance where the model is right.
    excess = float(np.mean(evaluation.residual**2 - 1.0 / evaluation.weight))
    top = max(min(level, problem.sensor.full_scale - problem.sensor.black_level), 1e-9)
    sigma_px = math.sqrt(max(0.5 * float(np.trace(covariance[:2, :2])) * _local_chi2(evaluation, covariance), 0.0))
    return DiscFit(
        x_px=float(state.nonlinear[0]) + problem.window.first[0],
        y_px=float(state.nonlinear[1]) + problem.window.first[1],
        sigma_px=sigma_px,
        psf_px=math.exp(float(state.nonlinear[PSF])),
        stretch=state.stretch,
        level=level,
        background=float(state.background[best]),
        snr=float(state.flux[best]) / flux_sigma,
        chi2=chi2,
        residual=math.sqrt(max(excess, 0.0)) / top,
        uneven=unevenness(problem, state, evaluation) / max(chi2, 1.0),
        bands=band_evidence(problem, state, evaluation, (covariance, gradient), sigma_px=sigma_px),
        used_px=count,
        converged=converged,
    )


def _local_chi2(evaluation: Evaluation, covariance: FloatArray) -> float:
    """Return the reduced chi² of the pixels that tell the position, each counting as much as it tells.

    It rests on few pixels, so it is widened as Student's distribution is: the mean square of error / sigma stays 1.
    """
    sums = kernels.information_sums(evaluation.jacobian, evaluation.weight, evaluation.residual, covariance)
    total, squares, misfit = np.maximum(sums, 1e-300).tolist()
    freedom = max(total**2 / squares, 4.0)
    return float(misfit / total * freedom / (freedom - 2.0))
