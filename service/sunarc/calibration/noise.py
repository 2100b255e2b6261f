"""The noise of sightings: scales by group and height, correlation of neighbours, growth at a low sun."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sunarc.calibration.model.sightings import Kind, Sightings
from sunarc.calibration.solve.priors import N_LENS
from sunarc.calibration.solve.problem import Bins, time_bins
from sunarc.calibration.start.multistart import SMALLEST_SIGMA_PX
from sunarc.common.array_types import BoolArray, FloatArray, IntArray
from sunarc.common.robust_statistics import (
    INFORMATION_PER_WEIGHT,
    fast_median,
    robust_sigma,
    surely_well_behaved,
    tukey_weights,
)

# How much information sightings carry when neighbours err alike, and when they err by more at a low sun.

_LARGEST = 0.995
_GAP = 1.6
_ENOUGH_PAIRS = 30
_SPREAD_OF_LOG = math.pi / math.sqrt(6.0)
"""Standard deviation of the logarithm of an exponential number, as the square of a two-dimensional distance is one."""
_STEEPEST = math.log(10.0) / (0.5 * math.pi)
"""Of the logarithm of the noise, per radian: ten times as large at the horizon as at the zenith, or a tenth."""
_LEAST_DISTANCE = 1e-3
"""Of the usual one: the logarithm of a distance of 0 says nothing of the noise."""


def neighbours(unix_s: FloatArray, run: IntArray) -> BoolArray:
    """Return (n - 1,): whether sightings i and i + 1 follow each other at the usual cadence within a run."""
    if unix_s.size < 2:
        return np.zeros(max(unix_s.size - 1, 0), dtype=bool)
    step = np.diff(unix_s)
    same = np.diff(run) == 0
    usual = float(np.median(step[same])) if np.any(same) else 0.0
    return np.asarray(same & (step <= _GAP * usual))


def lag_one(residual: FloatArray, counted: BoolArray, follows: BoolArray) -> tuple[float, float]:
    """Return the correlation of neighbouring residuals and its standard error.

    Parameters
    ----------
    residual : (n, 2) px, in the order of time.
    counted : (n,) whether a sighting counts.
    follows : (n - 1,) see `neighbours`.
    """
    rho, error = _correlation_of_pairs(
        *(np.array([np.sum(one)]) for one in _neighbour_pairs(residual, counted, follows))
    )
    return float(rho[0]), float(error[0])


def _neighbour_pairs(
    residual: FloatArray, counted: BoolArray, follows: BoolArray
) -> tuple[BoolArray, FloatArray, FloatArray]:
    """Return (n - 1,): which sightings make a pair with the next one, its product and its mean power; 0 for the rest.

    The mean power of both members, so that a correlation lies within -1 and 1.
    """
    pair = follows & counted[:-1] & counted[1:]
    x, y = np.ascontiguousarray(residual.T)
    square = x * x + y * y
    return pair, pair * (x[:-1] * x[1:] + y[:-1] * y[1:]), pair * (0.5 * (square[:-1] + square[1:]))


def _correlation_of_pairs(pairs: FloatArray, product: FloatArray, power: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (k,): correlations and their standard errors from sums over pairs of two axes; 0 and 1 of too few."""
    count = np.maximum(2 * pairs, 1)
    rho = product / np.where(power > 0.0, power, 1.0)
    enough = 2 * pairs >= _ENOUGH_PAIRS
    error = np.sqrt(np.maximum(1.0 - rho**2, 1e-6) / count)
    return np.where(enough, rho, 0.0), np.where(enough, error, 1.0)


def autocorrelation_inflation(
    residual: FloatArray, counted: BoolArray, follows: BoolArray, run: IntArray
) -> FloatArray:
    """Return (n,): by how much each run's variance grows because neighbours err alike, (1 + ρ) / (1 - ρ) >= 1.

    A run's own lag-1 correlation is drawn towards that of all runs by how well it is known. The sightings of a run lie
    together.
    """
    if run.size == 0:
        return np.ones(0)
    overall, error = lag_one(residual, counted, follows)
    # below two standard errors it is as likely to be 0, and must not inflate every variance
    overall = overall if overall > 2.0 * error else 0.0
    same = np.diff(run) == 0
    begin = np.flatnonzero(np.r_[True, ~same])
    sums = (np.add.reduceat(np.r_[one, 0.0], begin) for one in _neighbour_pairs(residual, counted, follows & same))
    rho, run_error = _correlation_of_pairs(*sums)
    # 0.05: by how much days differ in their correlation; a short run is drawn to the common one
    share = 0.05**2 / (0.05**2 + run_error**2)
    rho = np.clip(overall + share * (rho - overall), 0.0, _LARGEST)
    rho = np.where((rho > 2.0 * run_error) | (overall > 0.0), rho, 0.0)
    return np.repeat((1.0 + rho) / (1.0 - rho), np.diff(np.r_[begin, run.size]))


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
    if distance.size < _ENOUGH_PAIRS or power == 0.0:
        return 0.0
    least = max(_LEAST_DISTANCE * fast_median(distance), float(np.finfo(np.float64).tiny))
    slope = 2.0 * float(offset @ np.log(np.maximum(distance, least))) / power
    error = _SPREAD_OF_LOG * math.sqrt((1.0 + rho**2) / max(1.0 - rho**2, 1e-6) / power)
    # beyond three standard errors chance alone is one in 400: even noise is to keep even weights
    return min(max(0.5 * slope, -_STEEPEST), _STEEPEST) if abs(slope) > 3.0 * error else 0.0


_SUN_TRACK = 2 * Kind.SUN
"""The group of the sun's track, see `NoiseGroups`."""
_ENOUGH = 20
"""Sightings of one group, at least, for a scale of their own."""


class NoiseGroups(NamedTuple):
    """Bins; runs of one day and pose (n,); which follow the one before (n - 1,); which have no neighbours (n,).

    group (n,): the sightings of one group share a scale of the noise: the track, stated directions, stars, the moon.
    """

    bins: Bins
    run: IntArray
    follows: BoolArray
    alone: BoolArray
    group: IntArray
    unknowns: int = 0

    @classmethod
    def of(cls, usable: Sightings) -> NoiseGroups:
        """Return the groups, runs and neighbours of sightings."""
        run = 2 * (usable.day * (1 + int(usable.epoch.max(initial=0))) + usable.epoch) + usable.alone
        each_apart = np.where(usable.alone, -1 - np.arange(len(usable)), run)
        group = 2 * usable.kind + usable.alone
        return cls(
            time_bins(usable),
            run,
            neighbours(usable.unix_s, each_apart),
            usable.alone,
            group,
            N_LENS + 3 * (1 + int(usable.epoch.max(initial=0))),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Noise:
    """The noise of each sighting, (n,): its scale for a relative sigma of 1, px; how much it counts, 0 to 1.

    inflation (n,): by how much its variance grew because neighbours err alike. information (n,): px⁻², of each axis.
    sigma_px: the scale of the track, which comes first, in the middle of its heights; without a track, of all.
    """

    scale: FloatArray
    weight: FloatArray
    inflation: FloatArray
    information: FloatArray
    sigma_px: float


def measured_noise(
    residuals: FloatArray, observed: Sightings, groups: NoiseGroups, *, leverage: FloatArray | None = None
) -> Noise:
    """Return the noise by the residuals of a fit.

    Parameters
    ----------
    residuals : (n, 2) px, of the sightings.
    observed : the sightings.
    groups : of the sightings.
    leverage : (n,) of each sighting on the fit, see `compute_leverage`; None where each has little.
    """
    if leverage is not None:
        residuals = residuals / np.sqrt(1.0 - leverage)[:, None]
    distance = np.hypot(residuals[:, 0], residuals[:, 1]) * np.sqrt(observed.information)
    scale = at_mean = _estimate_scales(distance, groups)
    weight = tukey_weights(distance / scale, sigma=1.0)
    larger = _noise_ratio_by_height(distance, residuals, weight, observed, groups)
    if larger is not None:
        at_mean = _estimate_scales(distance / larger, groups)
        scale = larger * at_mean
        weight = tukey_weights(distance / scale, sigma=1.0)
    inflated = autocorrelation_inflation(residuals, weight > 0.0, groups.follows, groups.run)
    inflated = np.where(groups.alone, 1.0, inflated)
    information = observed.information * weight * INFORMATION_PER_WEIGHT / (scale**2 * inflated)
    return Noise(scale=scale, weight=weight, inflation=inflated, information=information, sigma_px=float(at_mean[0]))


def _estimate_scales(distance: FloatArray, groups: NoiseGroups) -> FloatArray:
    """Return (n,): the scale of each sighting's noise, by those of its group."""
    share = surely_well_behaved(distance.size, groups.unknowns)
    scale = np.full(distance.size, robust_sigma(distance, share=share, floor=SMALLEST_SIGMA_PX))
    if np.all(groups.group == groups.group[:1]):
        return scale
    for one in np.unique(groups.group):
        # sigmas stated with directions, by the sun's detector and by that of stars may be wrong by different factors
        alike = groups.group == one
        if np.count_nonzero(alike) >= _ENOUGH:
            scale[alike] = robust_sigma(distance[alike], floor=SMALLEST_SIGMA_PX)
    return scale


def _noise_ratio_by_height(
    distance: FloatArray, residuals: FloatArray, weight: FloatArray, observed: Sightings, groups: NoiseGroups
) -> FloatArray | None:
    """Return (n,): how the noise of the sun's track differs with its height, 1 for all else; None: it does not."""
    sun = groups.group == _SUN_TRACK
    zenith = np.arccos(np.clip(observed.directions[:, 2], -1.0, 1.0))
    counted = sun & (weight > 0.0)
    rho, _ = lag_one(residuals, weight > 0.0, groups.follows)
    rate = growth_rate(distance[counted], zenith[counted], rho)
    return np.where(sun, np.exp(rate * (zenith - np.mean(zenith[counted]))), 1.0) if rate else None
