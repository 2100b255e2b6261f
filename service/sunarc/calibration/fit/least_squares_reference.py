"""Least squares as the reference that a robust fit must reach: its priors and its field may not cost it the data.

The most probable camera meets the sightings a little worse than the best one does: priors and correlated noise hold it
back where the sightings say next to nothing, and that is what keeps the error over the sky small. The little is bounded
here. A fit that meets the sightings clearly worse than plain least squares (the paper's method without its penalties)
is brought towards the robust fit with loose priors, by as little as is needed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.initial_guess.multistart import (
    distance_sigmas,
    least_squares,
    loosened,
    staged_least_squares,
    undistorted,
)
from sunarc.calibration.least_squares.problem import Observations, Problem
from sunarc.calibration.least_squares.solve import most_probable
from sunarc.calibration.least_squares.time_bins import Bins
from sunarc.calibration.robust_loss import tukey_loss

_SCALES = (0.7, 1.0, 1.4)
"""The cost is compared at these multiples of the noise: a fit must not win by the choice of its scale."""
_COST_RATIO = 1.012
"""Largest robust cost over that of least squares; what priors cost, and why not less: decision 0023."""
_MEDIAN_RATIO = 1.02
"""Largest ratio of the median residuals: 1.05 to the paper's answer, which its penalties shift a little."""
_HALVINGS = 7
"""Bisections of the way: to 1 %."""


class _Level(NamedTuple):
    """Robust costs (3,) at the scales, and the median residual in px."""

    costs: FloatArray
    median: float

    def reaches(self, other: _Level) -> bool:
        """Return whether this is as good as another one."""
        return bool(np.all(self.costs <= other.costs) and self.median <= other.median)


def at_least_least_squares(
    problem: Problem, observed: Observations, bins: Bins, unknowns: FloatArray, *, sigma: float
) -> FloatArray:
    """Return the unknowns, or the nearest ones on the way to the loose robust fit that reach least squares.

    Parameters
    ----------
    problem : the camera sought.
    observed : all sightings.
    bins : those that are neighbours: plain least squares looks at their means.
    unknowns : (p,) the most probable ones.
    sigma : px, scale of the robust loss.
    """
    means = bins.observations(observed, problem, unknowns, information=observed.information)
    plain = [least_squares(problem, means, begin) for begin in (unknowns, undistorted(unknowns))]
    plain.append(staged_least_squares(problem, means, unknowns))
    levels = [_level(problem, observed, at, sigma) for at in plain]
    best = int(np.argmin([level.costs[1] for level in levels]))
    target = _Level(_COST_RATIO * levels[best].costs, _MEDIAN_RATIO * levels[best].median)
    if _level(problem, observed, unknowns, sigma).reaches(target):
        return unknowns
    precision = loosened(problem)
    # the loose robust fit may end in another valley: each start is tried until one reaches the level
    for begin in (unknowns, *plain):
        end = most_probable(problem, observed, begin, precision=precision, sigma=sigma, iterations=30).unknowns
        if _level(problem, observed, end, sigma).reaches(target):
            return _nearest(problem, observed, unknowns, end, target=target, sigma=sigma)
    return _nearest(problem, observed, unknowns, plain[best], target=target, sigma=sigma)


def _nearest(
    problem: Problem, observed: Observations, start: FloatArray, end: FloatArray, *, target: _Level, sigma: float
) -> FloatArray:
    """Return the unknowns nearest to the start, on the line to the end, that reach the wanted level."""
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if _level(problem, observed, start + middle * (end - start), sigma).reaches(target):
            high = middle
        else:
            low = middle
    return np.asarray(start + high * (end - start))


def _level(problem: Problem, observed: Observations, unknowns: FloatArray, sigma: float) -> _Level:
    distance = distance_sigmas(problem, observed, unknowns)
    costs = np.array([float(np.sum(tukey_loss(distance, sigma=scale * sigma))) for scale in _SCALES])
    return _Level(costs, float(np.median(distance)))
