"""The noise of sightings by sort and height: scales, weights and correlations of the sun's track, stars and moon."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sunarc.array_types import BoolArray, FloatArray, IntArray
from sunarc.calibration.fit.noise import growth_rate, inflation, lag_one, neighbours
from sunarc.calibration.initial_guess.multistart import SMALLEST_SIGMA_PX
from sunarc.calibration.least_squares.priors import N_LENS
from sunarc.calibration.least_squares.problem import Observations
from sunarc.calibration.least_squares.time_bins import Bins, time_bins
from sunarc.calibration.model.kinds import Kind
from sunarc.calibration.model.sightings import FilteredSightings
from sunarc.calibration.robust_loss import INFORMATION_PER_WEIGHT, robust_sigma, surely_well_behaved, tukey_weights

_SUN_TRACK = 2 * Kind.SUN
"""The sort of the sun's track, see `Course`."""
_ENOUGH = 20
"""Sightings of one sort, at least, for a scale of their own."""


class Course(NamedTuple):
    """Bins; runs of one day and pose (n,); which follow the one before (n - 1,); which have no neighbours (n,).

    sort (n,): the sightings of one sort share a scale of the noise: the track, stated directions, stars, the moon.
    """

    bins: Bins
    run: IntArray
    follows: BoolArray
    alone: BoolArray
    sort: IntArray
    unknowns: int = 0

    @classmethod
    def of(cls, usable: FilteredSightings) -> Course:
        """Return the course of sightings."""
        run = 2 * (usable.day * (1 + int(usable.epoch.max(initial=0))) + usable.epoch) + usable.alone
        each_apart = np.where(usable.alone, -1 - np.arange(len(usable)), run)
        sort = 2 * usable.kind + usable.alone
        return cls(
            time_bins(usable),
            run,
            neighbours(usable.unix_s, each_apart),
            usable.alone,
            sort,
            N_LENS + 3 * (1 + int(usable.epoch.max(initial=0))),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Noise:
    """The noise of each sighting, (n,): its scale for a relative sigma of 1, px; its weight; see `RobustFit`.

    sigma_px: the scale of the track, which comes first, in the middle of its heights; without a track, of all.
    """

    scale: FloatArray
    weight: FloatArray
    inflation: FloatArray
    sigma_px: float

    def information(self, observed: Observations) -> FloatArray:
        """Return (n,) px⁻²."""
        variance = self.scale**2 * self.inflation
        return np.asarray(observed.information * self.weight * INFORMATION_PER_WEIGHT / variance)


def measured_noise(
    residuals: FloatArray, observed: Observations, course: Course, *, leverage: FloatArray | None = None
) -> Noise:
    """Return the noise as it shows in what a fit leaves over.

    Parameters
    ----------
    residuals : (n, 2) px, of the sightings.
    observed : the sightings.
    course : of the sightings.
    leverage : (n,) of each sighting on the fit, see `leverage_of`; None where each has little.
    """
    if leverage is not None:
        residuals = residuals / np.sqrt(1.0 - leverage)[:, None]
    distance = np.hypot(residuals[:, 0], residuals[:, 1]) * np.sqrt(observed.information)
    scale = at_mean = _scale(distance, course)
    weight = tukey_weights(distance / scale, sigma=1.0)
    larger = _by_height(distance, residuals, weight, observed, course)
    if larger is not None:
        at_mean = _scale(distance / larger, course)
        scale = larger * at_mean
        weight = tukey_weights(distance / scale, sigma=1.0)
    inflated = inflation(residuals, weight, course.follows, course.run)
    inflated = np.where(course.alone, 1.0, inflated)
    return Noise(scale=scale, weight=weight, inflation=inflated, sigma_px=float(at_mean[0]))


def _scale(distance: FloatArray, course: Course) -> FloatArray:
    """Return (n,): the scale of each sighting's noise, by those of its sort."""
    share = surely_well_behaved(distance.size, course.unknowns)
    scale = np.full(distance.size, robust_sigma(distance, share=share, floor=SMALLEST_SIGMA_PX))
    if np.all(course.sort == course.sort[:1]):
        return scale
    for one in np.unique(course.sort):
        # sigmas stated with directions, by the sun's detector and by that of stars may be wrong by different factors
        alike = course.sort == one
        if np.count_nonzero(alike) >= _ENOUGH:
            scale[alike] = robust_sigma(distance[alike], floor=SMALLEST_SIGMA_PX)
    return scale


def _by_height(
    distance: FloatArray, residuals: FloatArray, weight: FloatArray, observed: Observations, course: Course
) -> FloatArray | None:
    """Return (n,): how the noise of the sun's track differs with its height, 1 for all else; None: it does not."""
    sun = course.sort == _SUN_TRACK
    zenith = np.arccos(np.clip(observed.directions[:, 2], -1.0, 1.0))
    counted = sun & (weight > 0.0)
    rho, _ = lag_one(residuals, weight, course.follows)
    rate = growth_rate(distance[counted], zenith[counted], rho)
    return np.where(sun, np.exp(rate * (zenith - np.mean(zenith[counted]))), 1.0) if rate else None
