"""Departure of a posterior from its prior, and the limit from which sightings contradict the prior.

The whole lens is tested, and each of its parts by itself: with a dozen quantities determined, one of them five sigmas
off does not show in the sum of their squares.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from sunarc.common.array_types import FloatArray, IntArray

_FALSE_ALARMS = 0.001
"""Share of right priors that each test refuses; the five of a lens together 0.5 % at most (Bonferroni)."""


class Departure(NamedTuple):
    """RMS departure in the prior's sigmas over the determined quantities, its limit, and the part of the lens."""

    rms: float
    limit: float
    part: str = "lens"

    @property
    def contradicts(self) -> bool:
        """Return whether a right prior leads to this once in a thousand cases at most."""
        return self.rms > self.limit


def largest_departure(
    change: FloatArray, prior: FloatArray, posterior: FloatArray, *, parts: Mapping[str, IntArray]
) -> Departure:
    """Return the departure that is the largest in its own limit, of all coordinates or of those of one part.

    Parameters
    ----------
    change : (p,) posterior minus prior mean.
    prior, posterior : (p, p) covariances.
    parts : places of the coordinates of each part.
    """
    every = {"lens": np.arange(change.size), **parts}
    return max(
        (_departure_in(change, prior, posterior, places)._replace(part=name) for name, places in every.items()),
        key=lambda one: one.rms / one.limit,
    )


def _departure_in(change: FloatArray, prior: FloatArray, posterior: FloatArray, places: IntArray) -> Departure:
    """Return the departure of some coordinates, whatever the others are."""
    block = np.ix_(places, places)
    root = np.linalg.cholesky(prior[block])
    remaining = np.linalg.solve(root, np.linalg.solve(root, posterior[block]).T)
    return compute_departure(np.linalg.solve(root, change[places]), remaining)


def compute_departure(change: FloatArray, remaining: FloatArray) -> Departure:
    """Return the departure of a posterior; less than one determined quantity counts as one.

    Parameters
    ----------
    change : (p,) posterior minus prior mean, in coordinates in which the prior's covariance is 1.
    remaining : (p, p) the posterior's covariance in these.
    """
    # under a right prior the change has the covariance that the sightings took away
    determined = np.clip(np.linalg.eigvalsh(np.eye(change.size) - remaining), 0.0, 1.0)
    # of less than one, a change within the prior would be refused for what a linear model leaves out
    total = max(float(determined.sum()), 1.0)
    return Departure(math.sqrt(float(change @ change) / total), math.sqrt(_largest_square(determined) / total))


def _largest_square(weights: FloatArray) -> float:
    """Return the bound that a sum of squares of normals with these variances exceeds rarely (Satterthwaite)."""
    first, second = float(weights.sum()), float(weights @ weights)
    if second < 1e-12:
        return math.inf
    from scipy.special import chdtri  # noqa: PLC0415 - a fit without a type of lens loads without it

    return max(second / first * float(chdtri(first**2 / second, _FALSE_ALARMS)), float(chdtri(1.0, _FALSE_ALARMS)))
