"""How far a posterior went from its prior: the test whether sightings contradict what was stated before them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from sunarc.array_types import FloatArray

_FALSE_ALARMS = 0.001
"""Share of right priors that the test refuses."""


class Departure(NamedTuple):
    """RMS departure in the prior's sigmas over what the sightings determine, and the largest that is none."""

    rms: float
    limit: float

    @property
    def contradicts(self) -> bool:
        """Whether a right prior leads to this once in a thousand cases at most."""
        return self.rms > self.limit


def departure_of(change: FloatArray, remaining: FloatArray) -> Departure:
    """Return the departure of a posterior.

    Parameters
    ----------
    change : (p,) posterior minus prior mean, in coordinates in which the prior's covariance is 1.
    remaining : (p, p) the posterior's covariance in these.
    """
    # under a right prior the change has the covariance that the sightings took away
    determined = np.clip(np.linalg.eigvalsh(np.eye(change.size) - remaining), 0.0, 1.0)
    total = max(float(determined.sum()), 1e-9)
    return Departure(math.sqrt(float(change @ change) / total), math.sqrt(_largest_square(determined) / total))


def _largest_square(weights: FloatArray) -> float:
    """Return what a sum of squares of normals with these variances exceeds rarely (Satterthwaite)."""
    first, second = float(weights.sum()), float(weights @ weights)
    if second < 1e-12:
        return math.inf
    return second / first * float(chdtri(first**2 / second, _FALSE_ALARMS))
