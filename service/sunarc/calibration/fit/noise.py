"""How much information a run of sightings carries when neighbours err alike."""

from __future__ import annotations

import numpy as np

from sunarc.array_types import BoolArray, FloatArray, IntArray

_LARGEST = 0.995
_GAP = 1.6
_ENOUGH = 30


def neighbours(unix_s: FloatArray, run: IntArray) -> BoolArray:
    """Return (n - 1,): whether sightings i and i + 1 follow each other at the usual cadence within one run."""
    if unix_s.size < 2:
        return np.zeros(max(unix_s.size - 1, 0), dtype=bool)
    step = np.diff(unix_s)
    same = np.diff(run) == 0
    usual = float(np.median(step[same])) if np.any(same) else 0.0
    return np.asarray(same & (step <= _GAP * usual))


def lag_one(residual: FloatArray, weight: FloatArray, follows: BoolArray) -> tuple[float, float]:
    """Return the correlation of neighbouring residuals and its standard error.

    Parameters
    ----------
    residual : (n, 2) px, in the order of time.
    weight : (n,) 0 where a sighting does not count.
    follows : (n - 1,) see `neighbours`.
    """
    pair = follows & (weight[:-1] > 0.0) & (weight[1:] > 0.0)
    count = 2 * int(pair.sum())
    if count < _ENOUGH:
        return 0.0, 1.0
    first, second = residual[:-1][pair], residual[1:][pair]
    # the mean power of both members, so that the estimate lies within -1 and 1
    power = 0.5 * (np.sum(first**2) + np.sum(second**2))
    rho = float(np.sum(first * second) / power) if power > 0.0 else 0.0
    return rho, float(np.sqrt(max(1.0 - rho**2, 1e-6) / count))


def inflation(residual: FloatArray, weight: FloatArray, follows: BoolArray, run: IntArray) -> FloatArray:
    """Return (n,): by how much each run's variance grows because neighbours err alike, (1 + ρ) / (1 - ρ) >= 1.

    A run's own lag-1 correlation is drawn towards that of all runs by how well it is known.
    """
    overall, error = lag_one(residual, weight, follows)
    # below two standard errors it is as likely to be 0, and must not inflate every variance
    overall = overall if overall > 2.0 * error else 0.0
    result = np.ones(residual.shape[0])
    for one in np.unique(run):
        in_run = run == one
        first = np.flatnonzero(in_run)
        span = slice(first[0], first[-1] + 1)
        rho, run_error = lag_one(residual[span], weight[span], follows[first[0] : first[-1]])
        # 0.05: by how much days differ in their correlation; a short run is drawn to the common one
        share = 0.05**2 / (0.05**2 + run_error**2)
        rho = min(max(overall + share * (rho - overall), 0.0), _LARGEST)
        rho = rho if rho > 2.0 * run_error or overall > 0.0 else 0.0
        result[in_run] = (1.0 + rho) / (1.0 - rho)
    return result
