"""A start that half of the sightings may lie about: fits of few, well-spread ones, judged by how many agree closely.

Reference: M. Fischler and R. Bolles, "Random sample consensus", Communications of the ACM 24 (1981). The trials are
linear: the first camera is near enough for its derivatives to serve.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.initial_guess.ransac_kernels import tightened, trial_steps
from sunarc.calibration.least_squares.problem import Observations, Problem
from sunarc.calibration.robust_loss import robust_sigma, surely_well_behaved
from sunarc.jit import njit

_TRIALS = 240
_SAMPLE = 7
_MAX_SIGHTINGS = 420
_ROUNDS = 12
_FEW_STEP = 4
"""Every fourth sighting of the thinned ones shows which trials are good."""
_GOOD = 24
"""So many of these are judged by all of them."""
_SEED = 20160830
_TRUST_PX = 0.7
_LARGEST_SQUARE = 1e60
"""Bound of squared sigmas, so that products of four stay finite: far from the sightings residuals have any size."""
_CUTS = np.repeat([3.0, 1.5], [4, _ROUNDS - 4])
"""Distances, in the scale found, at which a sighting counts a quarter in each round: fewer and fewer count."""
_FLOOR_PX = 1e-3


def ransac_start(problem: Problem, observed: Observations, start: FloatArray, *, precision: FloatArray) -> FloatArray:
    """Return the unknowns that most sightings agree on closely, or the start where nothing is better.

    Parameters
    ----------
    problem : the camera sought.
    observed : sightings, in the order of time within each epoch.
    start : unknowns within some tens of px of the truth.
    precision : prior precisions of the unknowns.
    """
    thin = observed.select(np.unique(np.linspace(0, len(observed) - 1, _MAX_SIGHTINGS).astype(int)))
    residual, rows = problem.linearised(start, thin)
    steps = _trials(residual, rows, start, precision)
    steps = np.concatenate([np.zeros((1, start.size)), steps])
    share = surely_well_behaved(len(thin), problem.size)
    close = max(
        min(robust_sigma(d, share=share) for d in _distances(residual, rows, steps[:40], thin.information)), 0.02
    )
    weight = thin.information / close**2
    # most trials are poor, and a part of the sightings shows it
    few = slice(None, None, _FEW_STEP)
    good = np.argsort(_disagreements(_after(residual[few], rows[few], steps), weight[few].copy()))[:_GOOD]
    steps = steps[np.sort(good)]
    agreed = _disagreements(_after(residual, rows, steps), weight)
    best = [_tightened(steps[k], residual, rows, start, precision, share) for k in np.argsort(agreed)[:3]]
    return min([start, *(start + step for step in best)], key=lambda at: _disagreement(problem, thin, at, close))


def _after(residual: FloatArray, rows: FloatArray, steps: FloatArray) -> FloatArray:
    """Return (k, 2 n): the residuals after steps (k, p), x and y by turns."""
    return np.asarray(residual.ravel() - steps @ rows.reshape(-1, steps.shape[-1]).T)


def _distances(residual: FloatArray, rows: FloatArray, steps: FloatArray, information: FloatArray) -> FloatArray:
    """Return (k, n): distances after steps (k, p), in relative sigmas."""
    after = _after(residual, rows, steps)
    return np.asarray(np.hypot(after[:, ::2], after[:, 1::2]) * np.sqrt(information))


def _trials(residual: FloatArray, rows: FloatArray, start: FloatArray, precision: FloatArray) -> FloatArray:
    """Return the steps (trials, p) that samples of sightings ask for, one out of each stretch of time."""
    rng = np.random.default_rng(_SEED)
    # one sighting of each stretch of the arc: random ones would often be neighbours
    edges = np.linspace(0, residual.shape[0], _SAMPLE + 1).astype(int)
    picks = np.stack([rng.integers(a, max(b, a + 1), _TRIALS) for a, b in itertools.pairwise(edges)], axis=-1)
    return np.asarray(trial_steps(residual, rows, picks, start, precision, _TRUST_PX))


def _tightened(  # noqa: PLR0917 - the kernel takes positions
    step: FloatArray, residual: FloatArray, rows: FloatArray, start: FloatArray, precision: FloatArray, share: float
) -> FloatArray:
    """Return the step refined on all sightings, those far off counting less and less."""
    columns = np.ascontiguousarray(np.moveaxis(rows, -1, 0).swapaxes(1, 2)).reshape(rows.shape[-1], -1)
    return np.asarray(
        tightened(step, np.ascontiguousarray(residual.T), columns, start, precision, _CUTS, share, _FLOOR_PX)
    )


@njit(nogil=True)
def _disagreements(after: FloatArray, information: FloatArray) -> FloatArray:
    """Return (k,): Cauchy's loss of residuals (k, 2 n), in which it hardly counts how far off one is.

    The logarithms of four sightings are taken together, as that of their product.
    """
    result = np.zeros(after.shape[0])
    for k in range(after.shape[0]):
        product = 1.0
        for n in range(information.size):
            dx, dy = after[k, 2 * n], after[k, 2 * n + 1]
            product *= 1.0 + min((dx * dx + dy * dy) * information[n], _LARGEST_SQUARE)
            if n % 4 == 3:
                result[k] += math.log(product)
                product = 1.0
        result[k] += math.log(product)
    return result


def _disagreement(problem: Problem, observed: Observations, at: FloatArray, close: float) -> float:
    distance = np.linalg.norm(problem.residuals(at, observed), axis=-1) * np.sqrt(observed.information)
    return float(np.sum(np.log1p((distance / close) ** 2)))
