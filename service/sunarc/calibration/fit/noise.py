"""How much information sightings carry when neighbours err alike, and when they err by more at a low sun."""

from __future__ import annotations

import math

import numpy as np

from sunarc.array_types import BoolArray, FloatArray, IntArray

_LARGEST = 0.995
_GAP = 1.6
_ENOUGH = 30
_SPREAD_OF_LOG = math.pi / math.sqrt(6.0)
"""Standard deviation of the logarithm of an exponential number, as the square of a two-dimensional distance is one."""
_STEEPEST = math.log(10.0) / (0.5 * math.pi)
"""Of the logarithm of the noise, per radian: ten times as large at the horizon as at the zenith, or a tenth."""
_LEAST_DISTANCE = 1e-3
"""Of the usual one: the logarithm of a distance of 0 says nothing of the noise."""


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


def growth_rate(distance: FloatArray, zenith: FloatArray, rho: float) -> float:
    """Return by how much the logarithm of the noise grows per radian of zenith angle; 0 where that is not proven.

    From the least squares' line of log d², whose scatter is known.

    Parameters
    ----------
    distance : (n,) 2-D distances of sightings without the outliers, in units of their relative sigma.
    zenith : (n,) rad.
    rho : lag-1 correlation of the residuals; their squares have rho².
    """
    offset = zenith - np.mean(zenith) if zenith.size else zenith
    power = float(offset @ offset)
    if distance.size < _ENOUGH or power == 0.0:
        return 0.0
    least = max(_LEAST_DISTANCE * float(np.median(distance)), float(np.finfo(np.float64).tiny))
    slope = 2.0 * float(offset @ np.log(np.maximum(distance, least))) / power
    error = _SPREAD_OF_LOG * math.sqrt((1.0 + rho**2) / max(1.0 - rho**2, 1e-6) / power)
    # beyond three standard errors chance alone is one in 400: even noise is to keep even weights
    return min(max(0.5 * slope, -_STEEPEST), _STEEPEST) if abs(slope) > 3.0 * error else 0.0
