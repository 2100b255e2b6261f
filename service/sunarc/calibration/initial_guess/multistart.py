"""Several starts of the robust fit, compared on all sightings by one robust cost.

A redescending loss has many local minima: which one a fit ends in depends on the first residuals. So several starts are
each brought to rest, and the lowest cost decides. All costs are taken at one scale, that of the candidate which the
better half of the sightings fits best: with a scale of its own, a camera that follows a third of the arc closely and
misses the rest would be rated above one that fits everything.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.initial_guess.ransac import ransac_start
from sunarc.calibration.least_squares.priors import DECENTERING, N_LENS, RADIAL, Whitened
from sunarc.calibration.least_squares.problem import Observations, Problem
from sunarc.calibration.least_squares.solve import most_probable
from sunarc.calibration.robust_loss import UNSEEN_PX, robust_sigma, surely_well_behaved, tukey_loss

SMALLEST_SIGMA_PX = 1e-4
"""px; exact (simulated) sightings must not make a scale of 0."""

_FEW = 600
"""Sightings, at least, that the starts are brought to rest on, of more: they only lead into a valley."""
_FEWER = 300
"""Sightings, at least, of more, that plain least squares begins with."""
_THINNED = (1, 2, 3)
"""Every first, second and third of them: subsets in which an episode of outliers weighs differently."""
_FOCAL_STEPS = (-0.5, 0.5)
"""Further focal lengths, in prior sigmas: 15 % shorter and longer where no image circle is known."""
_SETTLING = 3
_SAME_SIGMAS = 0.01
"""Starts that image no sighting further apart, in sigmas of the inliers, are one. With 0.3 such went lost as differ in
the decentering alone: a part of a day's arc hardly shows it, and the sky beside the arc does."""
_NEAR = 1e-3
"""Share of the cost that a step of plain least squares must gain: its answers are where robust fits begin."""
_SETTLED = 1e-5
"""The same of a robust fit: with 1e-4 it stops in the slow valley of the decentering's coefficients."""
_CENTRAL_SHARE = 0.5
_LOOSENED = 1e-4
"""Prior precisions of plain least squares: the paper's method has no prior."""
_FIXED = 1e8
"""Prior precision of what a stage leaves out: 1e-4 of the prior's sigma."""


def best_start(problem: Problem, observed: Observations, start: FloatArray, *, precision: FloatArray) -> FloatArray:
    """Return the unknowns of the lowest robust cost that the starts lead to.

    Parameters
    ----------
    problem : the camera sought.
    observed : all sightings, in the order of time within each epoch.
    start : (p,) unknowns from the coarse search.
    precision : (p,) prior precisions of the unknowns.
    """
    few = observed.select(slice(None, None, max(len(observed) // _FEW, 1)))
    starts = [ransac_start(problem, observed, start, precision=precision), *_plain_starts(problem, few, start)]
    for _ in range(_SETTLING):
        # those that have come to one place go on as one
        distinct = _distinct(problem, few, starts)
        starts = [_settled(problem, few, at, precision=precision, tolerance=_SETTLED) for at in distinct]
    return lowest(problem, observed, _distinct(problem, few, starts), precision=precision)


def least_squares(
    problem: Problem, observed: Observations, start: FloatArray, *, tolerance: float = 1e-6
) -> FloatArray:
    """Return the unknowns (p,) of least squares over all sightings, none weighted down, hardly any prior."""
    return _loose_fit(problem, observed, start, loosened(problem), tolerance)


def staged_least_squares(
    problem: Problem, observed: Observations, start: FloatArray, *, tolerance: float = 1e-6
) -> FloatArray:
    """Return the unknowns (p,) of `least_squares` in the paper's three stages (section 4.2), from an ideal lens.

    First without distortion, then with the radial polynomial, then with decentering too: all at once, a distorted lens
    beside a wrong tilt is a local minimum on a tilted camera's short arc.
    """
    unknowns = undistorted(start)
    precision = loosened(problem)
    precision[RADIAL] = precision[DECENTERING] = _FIXED
    for freed in (RADIAL, DECENTERING):
        unknowns = _loose_fit(problem, observed, unknowns, precision, tolerance)
        precision[freed] = _LOOSENED
    return least_squares(problem, observed, unknowns, tolerance=tolerance)


def _loose_fit(
    problem: Problem, observed: Observations, start: FloatArray, precision: FloatArray, tolerance: float
) -> FloatArray:
    return most_probable(problem, observed, start, precision=precision, iterations=25, tolerance=tolerance).unknowns


def loosened(problem: Problem) -> FloatArray:
    """Return precisions (p,) that hardly hold anything but skew and aspect, which the paper's penalties hold, too."""
    precision = np.full(problem.size, 1e-9)
    precision[:N_LENS] = _LOOSENED
    precision[[Whitened.ASPECT, Whitened.SKEW]] = 1.0
    return precision


def undistorted(unknowns: FloatArray) -> FloatArray:
    """Return the unknowns of the same camera with an ideal lens."""
    plain = unknowns.copy()
    plain[RADIAL] = plain[DECENTERING] = 0.0
    return plain


def _settled(
    problem: Problem, observed: Observations, start: FloatArray, *, precision: FloatArray, tolerance: float = 1e-6
) -> FloatArray:
    """Return the robust fit from one start at the scale that it leaves over."""
    sigma = _widest_scatter(problem, start, observed)
    return most_probable(
        problem, observed, start, precision=precision, sigma=sigma, iterations=20, tolerance=tolerance
    ).unknowns


def lowest(
    problem: Problem, observed: Observations, candidates: Sequence[FloatArray], *, precision: FloatArray
) -> FloatArray:
    """Return the candidate of the lowest robust cost, prior included, at one scale for all."""
    distances = [distance_sigmas(problem, observed, at) for at in candidates]
    share = surely_well_behaved(len(observed), problem.size, _CENTRAL_SHARE)
    sigma = min(robust_sigma(d, share=share, floor=SMALLEST_SIGMA_PX) for d in distances)
    costs = [
        float(np.sum(tukey_loss(distance, sigma=sigma))) + 0.5 * float(np.sum(precision * at**2))
        for distance, at in zip(distances, candidates, strict=True)
    ]
    return candidates[int(np.argmin(costs))]


def distance_sigmas(problem: Problem, observed: Observations, unknowns: FloatArray) -> FloatArray:
    """Return (n,): distances between seen and modelled pixels, px, divided by the sightings' relative sigma.

    A sighting further off the axis than the camera will answer is missed (`UNSEEN_PX`): a camera that is tilted away
    from part of the sun's track must not win by meeting it where it does not answer.
    """
    residual = problem.residuals(unknowns, observed)
    distance = np.hypot(residual[:, 0], residual[:, 1]) * np.sqrt(observed.information)
    return np.where(problem.beyond(unknowns, observed), UNSEEN_PX, distance)


def _plain_starts(problem: Problem, few: Observations, start: FloatArray) -> list[FloatArray]:
    """Return least-squares answers from an ideal lens: thinned, from other focal lengths, and in stages."""
    plain = undistorted(start)
    few = few.select(slice(None, None, max(len(few) // _FEWER, 1)))
    found = [least_squares(problem, few.select(slice(None, None, step)), plain, tolerance=_NEAR) for step in _THINNED]
    for step in _FOCAL_STEPS:
        other = plain.copy()
        other[Whitened.FOCAL_LENGTH] += step
        found.append(least_squares(problem, few, other, tolerance=_NEAR))
    return [*found, staged_least_squares(problem, few, start, tolerance=_NEAR)]


def _distinct(problem: Problem, observed: Observations, starts: list[FloatArray]) -> list[FloatArray]:
    """Return the starts without those that image all sightings where an earlier one does: they end in one valley."""
    root = np.sqrt(observed.information)[:, None]
    residuals = [problem.residuals(at, observed) * root for at in starts]
    sigma = min(robust_sigma(np.hypot(one[:, 0], one[:, 1]), floor=SMALLEST_SIGMA_PX) for one in residuals)
    found: list[int] = []
    for k, residual in enumerate(residuals):
        if all(np.max(np.abs(residual - residuals[other])) > _SAME_SIGMAS * sigma for other in found):
            found.append(k)
    return [starts[k] for k in found]


def _widest_scatter(problem: Problem, at: FloatArray, observed: Observations) -> float:
    """Return the scale of the pose that fits worst so far: by one that fits already, it would be left out whole."""
    distance = np.linalg.norm(problem.residuals(at, observed), axis=-1) * np.sqrt(observed.information)
    share = surely_well_behaved(len(observed), problem.size)
    epochs = np.unique(observed.epoch)
    return max(
        robust_sigma(distance[observed.epoch == epoch], share=share, floor=SMALLEST_SIGMA_PX) for epoch in epochs
    )
