"""Least squares as the reference that a robust fit must reach: its priors and its field may not cost it the data.

The most probable camera meets the sightings a little worse than the best one does: priors and correlated noise hold it
back where the sightings say next to nothing, and that is what keeps the error over the sky small. The little is bounded
here. A fit that meets the sightings clearly worse than plain least squares (the paper's method without its penalties)
is brought towards the robust fit with loose priors, by as little as is needed.

Clearly worse is more than chance: the parameters that the priors hold are free in least squares, and follow the noise.
What they gain by that grows with the noise's correlation, since neighbours that err alike are followed alike.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.fit.noise import inflation
from sunarc.calibration.fit.noise_by_sort import Course
from sunarc.calibration.initial_guess.multistart import (
    distance_sigmas,
    least_squares,
    loosened,
    staged_least_squares,
    undistorted,
)
from sunarc.calibration.least_squares.problem import Observations, Problem
from sunarc.calibration.least_squares.solve import most_probable
from sunarc.calibration.robust_loss import CUT, tukey_loss, tukey_weights

_SCALES = (0.7, 1.0, 1.4)
"""The cost is compared at these multiples of the noise: a fit must not win by the choice of its scale."""
_COST_RATIO = 1.012
"""Largest robust cost over that of least squares, of many sightings; what priors cost, why not less: decision 0023."""
_CHANCE = 11.0
"""Log likelihood that least squares gains by following the noise: half the chi-square of seven, the directions that the
priors hold on one day's arc, is beyond that once in 500. Of 40 lenses it was 3.6 in the mean."""
_MEDIAN_RATIO = 1.02
"""Largest ratio of the median residuals: 1.05 to the paper's answer, which its penalties shift a little."""
LENS_MISFIT_PX = 1.0
"""px per axis; lenses are not as modelled by tenths of px, the paper's own by 0.5 to 1.2. A field that takes more from
the camera has taken over what its parameters explain."""
FIELD_EXCESS = 2.0
"""Root mean square along the sun's way over the amplitude of a field. With a kernel k there are 2 / mean(k²)
independent parts there, both components counted: four of a field of 0.36 of the image, nine of one of 0.16, on a day as
on several. 99 % of the chi-squares of four are below 3.3 times their mean, that is 1.8 times the amplitude, and that is
itself estimated."""
_MEDIAN_OF_SIGMA = math.sqrt(2.0 * math.log(2.0))
"""Median distance of a round Gaussian over its 1-sigma per axis."""
_GAIN = 1e-4
"""Share of the cost that a step of least squares must gain: far less than what `_COST_RATIO` leaves."""
_FINEST = 0.9
_HALVINGS = 7
"""Bisections of the way: to 1 %."""


class Level(NamedTuple):
    """How well sightings must be met.

    scales, costs (3,): scales of the loss, px, and the largest robust cost at each. median: the largest one, px.
    """

    scales: FloatArray
    costs: FloatArray
    median: float

    def reached_by(self, distance: FloatArray) -> bool:
        """Return whether distances (n,) between seen and modelled pixels, px, are as small."""
        return bool(np.all(_costs(distance, self.scales) <= self.costs) and np.median(distance) <= self.median)


def allowed_level(
    distance: FloatArray,
    *,
    sigma: float,
    field_px: float,
    weight: float = 1.0,
    cost_ratio: float = _COST_RATIO,
    median_ratio: float = math.inf,
) -> Level:
    """Return the level that a fit must reach beside another one that met the sightings at some distances.

    Parameters
    ----------
    distance : (n,) of the other one, px.
    sigma : px, the noise.
    field_px : 1-sigma of what no lens explains, as the data speak for it: the camera may miss them by `FIELD_EXCESS`
        times as much, `LENS_MISFIT_PX` of it counted at most.
    weight : what a px counts in the distances, see `finest_weight`.
    cost_ratio, median_ratio : by how much cost and median may be larger without a field.
    """
    missed = weight * FIELD_EXCESS * min(field_px, LENS_MISFIT_PX)
    scales = math.hypot(sigma, missed) * np.array(_SCALES)
    counted = float(np.sum(distance < CUT * scales[1]))
    costs = cost_ratio * _costs(distance, scales) + counted * (missed / scales) ** 2
    return Level(scales, costs, math.hypot(median_ratio * float(np.median(distance)), _MEDIAN_OF_SIGMA * missed))


def finest_weight(observed: Observations) -> float:
    """Return what a px counts in the weighted distances of the finest sightings: a field moves them as others.

    Beside 5,000 stars of 0.2 px a sun of 0.03 px counts six times, and so does what a field moves it by.
    """
    return float(np.quantile(np.sqrt(observed.information), _FINEST))


def at_least_least_squares(
    problem: Problem,
    observed: Observations,
    course: Course,
    unknowns: FloatArray,
    *,
    sigma: float,
    field_px: float = 0.0,
    in_its_valley: bool = False,
) -> FloatArray:
    """Return the unknowns, or the nearest ones on the way to the loose robust fit that reach least squares.

    Parameters
    ----------
    problem : the camera sought.
    observed : all sightings.
    course : of the sightings: plain least squares looks at the means of its bins.
    unknowns : (p,) the most probable ones.
    sigma : px, scale of the robust loss.
    field_px : 1-sigma of what no lens explains, px, see `allowed_level`.
    in_its_valley : whether least squares from the unknowns alone is enough.
    """
    means = course.bins.observations(observed, problem, unknowns, information=observed.information)
    plain = [least_squares(problem, means, unknowns, tolerance=_GAIN)]
    if not in_its_valley:
        plain += [
            least_squares(problem, means, undistorted(unknowns), tolerance=_GAIN),
            staged_least_squares(problem, means, unknowns, tolerance=_GAIN),
        ]
    met = [distance_sigmas(problem, observed, at) for at in plain]
    best = int(np.argmin([_costs(distance, np.array([sigma]))[0] for distance in met]))
    residuals = problem.residuals(plain[best], observed)
    chance = _share_by_chance(residuals, tukey_weights(met[best], sigma=sigma), course)
    level = allowed_level(
        met[best],
        sigma=sigma,
        field_px=field_px,
        weight=finest_weight(observed),
        cost_ratio=max(_COST_RATIO, 1.0 + chance),
        median_ratio=_MEDIAN_RATIO + max(chance - (_COST_RATIO - 1.0), 0.0),
    )
    if level.reached_by(distance_sigmas(problem, observed, unknowns)):
        return unknowns
    precision = loosened(problem)
    # the loose robust fit may end in another valley: each start is tried until one reaches the level
    for begin in (unknowns, *plain):
        end = most_probable(problem, observed, begin, precision=precision, sigma=sigma, iterations=30).unknowns
        if level.reached_by(distance_sigmas(problem, observed, end)):
            return _nearest(problem, observed, unknowns, end, level)
    return _nearest(problem, observed, unknowns, plain[best], level)


def _share_by_chance(residuals: FloatArray, weight: FloatArray, course: Course) -> float:
    """Return the share of its cost by which least squares is lower through following the noise, at most.

    Parameters
    ----------
    residuals : (n, 2) px, that it leaves over: those of a fit that misses the sightings would excuse that fit.
    weight : (n,) of the sightings.
    course : of the sightings.
    """
    counted = weight > 0.0
    inflated = np.where(course.alone, 1.0, inflation(residuals, weight, course.follows, course.run))[counted]
    # the cost of each sighting is 1 in the mean: two axes of half a square
    return _CHANCE * float(np.mean(inflated)) / inflated.size if inflated.size else 0.0


def _nearest(problem: Problem, observed: Observations, start: FloatArray, end: FloatArray, level: Level) -> FloatArray:
    """Return the unknowns nearest to the start, on the line to the end, that reach the wanted level."""
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if level.reached_by(distance_sigmas(problem, observed, start + middle * (end - start))):
            high = middle
        else:
            low = middle
    return np.asarray(start + high * (end - start))


def _costs(distance: FloatArray, scales: FloatArray) -> FloatArray:
    """Return the robust costs (s,) of distances (n,) at scales (s,), px."""
    return np.array([float(np.sum(tukey_loss(distance, sigma=float(scale)))) for scale in scales])
