"""Neighbouring sightings taken together: the solve sees their mean residual, at their mean direction."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from sunarc.array_types import BoolArray, FloatArray, IntArray
from sunarc.calibration.least_squares.problem import Observations, Problem
from sunarc.calibration.model.sightings import FilteredSightings
from sunarc.calibration.robust_loss import UNSEEN_PX

_MOST = 16
_SECONDS = 360.0
"""A bin spans at most 6 minutes, in which the sun moves 1.5 degrees."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bins:
    """Which sightings go together.

    Attributes
    ----------
    member : (n,) the bin of each sighting; bins are runs in time.
    count : the number of bins.
    """

    member: IntArray
    count: int

    def select(self, which: BoolArray) -> Bins:
        """Return the bins of the sightings that a mask picks, numbered anew."""
        fresh, member = np.unique(self.member[which], return_inverse=True)
        return Bins(member=member, count=fresh.size)

    def gathered(
        self, observed: Observations, residual: FloatArray, information: FloatArray
    ) -> tuple[Observations, FloatArray]:
        """Return one observation a bin (its pixels: those of the heaviest share) and the mean residuals (bins, 2)."""
        total = self._sums(information)
        safe = np.where(total > 0.0, total, 1.0)
        share = information / safe[self.member]
        # the mean of directions within a bin is shorter than 1 by 1e-4 at most; it is made a unit vector below
        direction = np.stack([self._sums(share * observed.directions[:, i]) for i in range(3)], axis=-1)
        norm = np.linalg.norm(direction, axis=-1, keepdims=True)
        pixels = np.stack([self._sums(share * observed.pixels[:, i]) for i in range(2)], axis=-1)
        mean = np.stack([self._sums(share * residual[:, i]) for i in range(2)], axis=-1)
        refraction = np.stack([self._sums(share * column) for column in observed.refraction_sd.T], axis=-1)
        first = np.searchsorted(self.member, np.arange(self.count))
        # a bin of outliers alone still needs a direction: its weight of 0 keeps it out of the sums
        empty = total <= 0.0
        direction[empty], norm[empty], pixels[empty] = (
            observed.directions[first[empty]],
            1.0,
            observed.pixels[first[empty]],
        )
        gathered = Observations(
            directions=direction / norm,
            pixels=pixels,
            information=total,
            epoch=observed.epoch[first],
            refraction_sd=refraction,
            systematic_px=self._mean_of(observed.systematic_px, share),
        )
        return gathered, mean

    def observations(
        self, observed: Observations, problem: Problem, unknowns: FloatArray, *, information: FloatArray
    ) -> Observations:
        """Return one observation a bin, its pixel such that its residual is the bin's mean one at some unknowns.

        A sighting where the lens sees nothing takes no part.
        """
        residuals = problem.residuals(unknowns, observed)
        shown = np.any(residuals != UNSEEN_PX, axis=-1)
        gathered, residual = self.gathered(observed, residuals, information * shown)
        return replace(gathered, pixels=gathered.pixels + residual - problem.residuals(unknowns, gathered))

    def _mean_of(self, columns: FloatArray, share: FloatArray) -> FloatArray:
        """Return the means (bins, ...) of columns (n, ...), each sighting by its share (n,) of its bin."""
        means = np.empty((self.count, math.prod(columns.shape[1:])))
        for number, column in enumerate(columns.reshape(columns.shape[0], means.shape[1]).T):
            means[:, number] = self._sums(share * column)
        return means.reshape(self.count, *columns.shape[1:])

    def _sums(self, values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(self.member, weights=values, minlength=self.count))


def _begin(first: BoolArray) -> IntArray:
    """Return (n,): the row that begins the part which each belongs to; a mask (n,) marks those that begin one."""
    return np.asarray(np.maximum.accumulate(np.where(first, np.arange(first.size), 0)))


def time_bins(usable: FilteredSightings) -> Bins:
    """Return bins of consecutive sightings of one day and epoch, at most 16 sightings and 6 minutes each.

    One that is alone has a bin of its own.
    """
    n = len(usable)
    if n == 0:
        return Bins(member=np.zeros(0, dtype=np.int64), count=0)
    run = np.r_[True, (np.diff(usable.day) != 0) | (np.diff(usable.epoch) != 0) | np.diff(usable.alone)]
    slot = np.floor((usable.unix_s - usable.unix_s[_begin(run)]) / _SECONDS).astype(np.int64)
    part = run | usable.alone | np.r_[True, np.diff(slot) != 0]
    fresh = part | ((np.arange(n) - _begin(part)) % _MOST == 0)
    member = np.cumsum(fresh) - 1
    return Bins(member=member, count=int(member[-1]) + 1)
