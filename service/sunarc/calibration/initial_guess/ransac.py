"""A start that half of the sightings may lie about: fits of few, well-spread ones, judged by how many agree closely.

Reference: M. Fischler and R. Bolles, "Random sample consensus", Communications of the ACM 24 (1981). The trials are
linear: the first camera is near enough for its derivatives to serve.
"""

from __future__ import annotations

import itertools

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.least_squares.problem import Observations, Problem
from sunarc.calibration.robust_loss import robust_sigma

_TRIALS = 240
_SAMPLE = 7
_MAX_SIGHTINGS = 420
_ROUNDS = 12
_SEED = 20160830
_TRUST_PX = 0.7
_RIDGE = 1e-12
"""Share of the diagonal that is added to it."""


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
    residual_after = residual - np.einsum("nap,kp->kna", rows, steps, optimize=True)
    distance = np.linalg.norm(residual_after, axis=-1) * np.sqrt(thin.information)
    close = max(min(robust_sigma(d) for d in distance[:40]), 0.02)
    # Cauchy's loss counts those close by, and hardly how far the others are off
    agreed = np.sum(np.log1p((distance / close) ** 2), axis=1)
    best = [_tightened(steps[k], residual, rows, start, precision) for k in np.argsort(agreed)[:3]]
    return min([start, *(start + step for step in best)], key=lambda at: _disagreement(problem, thin, at, close))


def _trials(residual: FloatArray, rows: FloatArray, start: FloatArray, precision: FloatArray) -> FloatArray:
    """Return the steps (trials, p) that samples of sightings ask for, one out of each stretch of time."""
    rng = np.random.default_rng(_SEED)
    # one sighting of each stretch of the arc: random ones would often be neighbours
    edges = np.linspace(0, residual.shape[0], _SAMPLE + 1).astype(int)
    picks = np.stack([rng.integers(a, max(b, a + 1), _TRIALS) for a, b in itertools.pairwise(edges)], axis=-1)
    j = rows[picks].reshape(_TRIALS, 2 * _SAMPLE, -1) / _TRUST_PX
    r = residual[picks].reshape(_TRIALS, 2 * _SAMPLE) / _TRUST_PX
    normal = np.swapaxes(j, -1, -2) @ j + np.diag(precision)
    right = np.einsum("kip,ki->kp", j, r) - precision * start
    return _solved(normal, right)


def _tightened(
    step: FloatArray, residual: FloatArray, rows: FloatArray, start: FloatArray, precision: FloatArray
) -> FloatArray:
    """Return the step refined on all sightings, those far off counting less and less."""
    flat = rows.reshape(-1, rows.shape[-1])
    for number in range(_ROUNDS):
        distance = np.linalg.norm(residual - rows @ step, axis=-1)
        sigma = robust_sigma(distance, floor=1e-3)
        weight = 1.0 / (1.0 + (distance / (sigma * (3.0 if number < 4 else 1.5))) ** 2) ** 2 / sigma**2
        doubled = np.repeat(weight, 2)
        normal = (flat * doubled[:, None]).T @ flat + np.diag(precision)
        step = _solved(normal, flat.T @ (doubled * residual.ravel()) - precision * start)
    return step


def _solved(normal: FloatArray, right: FloatArray) -> FloatArray:
    """Return the solutions (..., p) of normal equations (..., p, p), also of those that do not determine all of them.

    A camera far from the sightings has derivatives of any size: without the ridge rounding makes a matrix singular.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(normal, axis1=-2, axis2=-1), 1e-300))
    scaled = normal * scale[..., :, None] * scale[..., None, :] + _RIDGE * np.eye(right.shape[-1])
    return np.asarray(scale * np.linalg.solve(scaled, (scale * right)[..., None])[..., 0])


def _disagreement(problem: Problem, observed: Observations, at: FloatArray, close: float) -> float:
    distance = np.linalg.norm(problem.residuals(at, observed), axis=-1) * np.sqrt(observed.information)
    return float(np.sum(np.log1p((distance / close) ** 2)))
