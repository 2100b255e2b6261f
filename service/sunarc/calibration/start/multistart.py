"""Several starts of the robust fit, among them by RANSAC, compared on all sightings by one robust cost.

A redescending loss has many local minima: which one a fit ends in depends on the first residuals. So several starts
converge each by itself, and the lowest cost decides. All costs are taken at one scale, that of the candidate which the
better half of the sightings fits best: with a scale of its own, a camera that follows a third of the arc closely and
misses the rest would be rated above one that fits everything.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.solve.levenberg_marquardt import most_probable
from sunarc.calibration.solve.priors import DECENTERING, HIGHER, N_LENS, RADIAL, Whitened
from sunarc.calibration.solve.problem import FitProblem
from sunarc.common.array_types import FloatArray
from sunarc.common.robust_statistics import UNSEEN_PX, robust_sigma, surely_well_behaved, tukey_loss

SMALLEST_SIGMA_PX = 1e-4
"""px; exact (simulated) sightings must not make a scale of 0."""

_FEW = 600
"""Sightings, at least, on which the starts converge, of more: they only lead to a local minimum."""
_FEWER = 300
"""Sightings, at least, of more, that plain least squares begins with."""
_SETTLING = 3
_SAME_SIGMAS = 0.01
"""Starts that image no sighting further apart, in sigmas of the inliers, are one. With 0.3 such went lost as differ in
the decentering alone: a part of a day's arc hardly shows it, and the sky at its sides does."""
_NEAR = 1e-3
"""Share of the cost that a step of plain least squares must gain: its answers are where robust fits begin."""
_SETTLED = 1e-5
"""The same of a robust fit: with 1e-4 it stops in the narrow flat minimum along the decentering's coefficients."""
_CENTRAL_SHARE = 0.5
_LOOSENED = 1e-4
"""Prior precisions of plain least squares: the paper's method has no prior."""


def best_start(problem: FitProblem, observed: Sightings, start: FloatArray, *, precision: FloatArray) -> FloatArray:
    """Return the unknowns of the lowest robust cost that the starts lead to.

    Parameters
    ----------
    problem : the camera sought.
    observed : all sightings, in the order of time within each epoch.
    start : (p,) unknowns from the coarse search.
    precision : (p,) prior precisions of the unknowns.
    """
    few = observed.select(slice(None, None, max(len(observed) // _FEW, 1)))
    fewer = few.select(slice(None, None, max(len(few) // _FEWER, 1)))
    of_ideal_lens = least_squares(problem, fewer, undistorted(start), tolerance=_NEAR)
    starts = [*_ransac_starts(problem, observed, start, precision), of_ideal_lens]
    for _ in range(_SETTLING):
        # those that have come to one place go on as one
        distinct = distinct_starts(problem, few, starts)
        starts = [settled(problem, few, at, precision=precision, tolerance=_SETTLED) for at in distinct]
    return lowest(problem, observed, distinct_starts(problem, few, starts), precision=precision)


def least_squares(
    problem: FitProblem, observed: Sightings, start: FloatArray, *, tolerance: float = 1e-6
) -> FloatArray:
    """Return the unknowns (p,) of least squares over all sightings, none weighted down, hardly any prior."""
    return most_probable(
        problem, observed, start, precision=loosened(problem), iterations=25, tolerance=tolerance
    ).unknowns


def loosened(problem: FitProblem) -> FloatArray:
    """Return precisions (p,) of a prior that constrains skew and aspect, and hardly anything else."""
    precision = np.full(problem.size, 1e-9)
    precision[:N_LENS] = _LOOSENED
    precision[[Whitened.ASPECT, Whitened.SKEW]] = 1.0
    return precision


def undistorted(unknowns: FloatArray) -> FloatArray:
    """Return the unknowns of the same camera with an ideal lens."""
    plain = unknowns.copy()
    plain[RADIAL] = plain[DECENTERING] = 0.0
    return plain


def settled(
    problem: FitProblem, observed: Sightings, start: FloatArray, *, precision: FloatArray, tolerance: float = 1e-6
) -> FloatArray:
    """Return the robust fit from one start, at the scale of its own residuals."""
    residual, epoch = problem.residuals(start, observed), observed.epoch
    distance = np.sqrt(residual[:, 0] ** 2 + residual[:, 1] ** 2) * np.sqrt(observed.information)
    share = surely_well_behaved(len(observed), problem.size)
    # that of the pose that fits worst so far: by one that fits already, it would be left out whole
    sigma = max(
        robust_sigma(distance[epoch == e], share=share, floor=SMALLEST_SIGMA_PX)
        for e in range(problem.n_epochs)
        if np.any(epoch == e)
    )
    return most_probable(
        problem, observed, start, precision=precision, sigma=sigma, iterations=20, tolerance=tolerance
    ).unknowns


def lowest(
    problem: FitProblem, observed: Sightings, candidates: Sequence[FloatArray], *, precision: FloatArray
) -> FloatArray:
    """Return the candidate with the lowest robust cost, prior included, at a common scale."""
    distances = [distance_sigmas(problem, observed, at) for at in candidates]
    share = surely_well_behaved(len(observed), problem.size, _CENTRAL_SHARE)
    sigma = min(robust_sigma(d, share=share, floor=SMALLEST_SIGMA_PX) for d in distances)
    costs = [
        float(np.sum(tukey_loss(distance, sigma=sigma))) + 0.5 * float(np.sum(precision * at**2))
        for distance, at in zip(distances, candidates, strict=True)
    ]
    return candidates[int(np.argmin(costs))]


def distance_sigmas(problem: FitProblem, observed: Sightings, unknowns: FloatArray) -> FloatArray:
    """Return (n,): distances between seen and modelled pixels, px, divided by the sightings' relative sigma.

    A sighting further off the axis than the camera will answer is missed (`UNSEEN_PX`): a camera that is tilted away
    from part of the sun's track must not win by meeting it where it does not answer.
    """
    residual = problem.residuals(unknowns, observed)
    distance = np.hypot(residual[:, 0], residual[:, 1]) * np.sqrt(observed.information)
    return np.where(problem.beyond(unknowns, observed), UNSEEN_PX, distance)


def distinct_starts(problem: FitProblem, observed: Sightings, starts: list[FloatArray]) -> list[FloatArray]:
    """Return the starts without those that image all sightings where an earlier one does: both have one minimum."""
    root = np.sqrt(observed.information)[:, None]
    residuals = [problem.residuals(at, observed) * root for at in starts]
    sigma = min(robust_sigma(np.hypot(one[:, 0], one[:, 1]), floor=SMALLEST_SIGMA_PX) for one in residuals)
    found: list[int] = []
    for k, residual in enumerate(residuals):
        if all(np.max(np.abs(residual - residuals[other])) > _SAME_SIGMAS * sigma for other in found):
            found.append(k)
    return [starts[k] for k in found]


# A start that half of the sightings may lie about: fits of few, well-spread ones, judged by how many agree closely.
#
# Reference: M. Fischler and R. Bolles, "Random sample consensus", Communications of the ACM 24 (1981). The trials are
# linear: the first camera is near enough for its derivatives to serve.

_TRIALS = 240
_SAMPLE = 7
_MAX_SIGHTINGS = 420
_FEW_STEP = 4
"""Every fourth sighting of the thinned ones shows which trials are good."""
_GOOD = 24
"""So many of these are judged by all of them."""
_TAKEN = 3
_JUDGED = 40
"""Trials that give the scale of a close agreement."""
_SEED = 20160830
_TRUST_PX = 0.7
_RIDGE = 1e-12
"""Share of the diagonal that is added to it: a camera far from the sightings has derivatives of any size, and rounding
makes a matrix singular."""


@np.errstate(over="ignore", invalid="ignore")  # far from the sightings residuals have any size
def _ransac_starts(
    problem: FitProblem, observed: Sightings, start: FloatArray, precision: FloatArray
) -> list[FloatArray]:
    """Return the start, within some tens of px of the truth, and the unknowns near it that most sightings agree on."""
    thin = observed.thinned(_MAX_SIGHTINGS)
    residual, rows = problem.linearised(start, thin)
    steps = sampled_steps(residual, rows, start, precision)
    share, root = surely_well_behaved(len(thin), problem.size), np.sqrt(thin.information)
    close = min(robust_sigma(d, share=share) for d in _distances_after_steps(residual, rows, steps[:_JUDGED], root))
    weight = root / max(close, 0.02)
    # most trials are poor, and a part of the sightings shows it
    few = slice(None, None, _FEW_STEP)
    good = np.argsort(_cauchy_losses(_distances_after_steps(residual[few], rows[few], steps, weight[few])))[:_GOOD]
    agreed = _cauchy_losses(_distances_after_steps(residual, rows, steps[good], weight))
    return [start, *(start + steps[good[k]] for k in np.argsort(agreed)[:_TAKEN])]


def _distances_after_steps(residual: FloatArray, rows: FloatArray, steps: FloatArray, weight: FloatArray) -> FloatArray:
    """Return (k, n): distances after steps (k, p), each by its weight (n,)."""
    after = residual.ravel() - steps @ rows.reshape(-1, steps.shape[-1]).T
    return np.asarray(np.sqrt(after[:, ::2] ** 2 + after[:, 1::2] ** 2) * weight)


def _cauchy_losses(distances: FloatArray) -> FloatArray:
    """Return (k,): Cauchy's loss of distances (k, n), in which gross errors hardly count."""
    return np.asarray(np.sum(np.log1p(distances**2), axis=1))


def sampled_steps(residual: FloatArray, rows: FloatArray, start: FloatArray, precision: FloatArray) -> FloatArray:
    """Return the steps (trials, p) that samples of sightings ask for, one out of each stretch of time."""
    rng = np.random.default_rng(_SEED)
    # one sighting of each stretch of the arc: random ones would often be neighbours
    edges = np.linspace(0, residual.shape[0], _SAMPLE + 1).astype(int)
    picks = np.stack([rng.integers(a, max(b, a + 1), _TRIALS) for a, b in itertools.pairwise(edges)], axis=-1)
    columns = rows[picks].reshape(_TRIALS, 2 * _SAMPLE, -1) / _TRUST_PX
    normal = columns.swapaxes(1, 2) @ columns + np.diag(precision)
    gradient = (residual[picks].reshape(_TRIALS, 1, -1) / _TRUST_PX @ columns)[:, 0] - precision * start
    return _solve_normal_equations(normal, gradient)


def _solve_normal_equations(normal: FloatArray, gradient: FloatArray) -> FloatArray:
    """Return the steps (..., p) of normal equations (..., p, p), (..., p); zeros where they cannot be solved."""
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(normal, axis1=-2, axis2=-1), 1e-300))
    scaled = normal * scale[..., :, None] * scale[..., None, :] + _RIDGE * np.eye(scale.shape[-1])
    step = scale * np.linalg.solve(scaled, (scale * gradient)[..., None])[..., 0]
    return np.where(np.isfinite(step), step, 0.0)


# The local minima of the decentering: (p1, p2) × (1, p3, p4) is a product, and one sign of it hides the other.
#
# From p = 0 a fit cannot feel p3 and p4, and ends in the nearest minimum, which is often not the lowest.
# So the higher coefficients are held at several places in turn, the rest is solved, and the best two are let go.

_STARTS = tuple(itertools.product((-1.5, 1.5), (-2.0, 0.0, 2.0)))
_LET_GO = 2


def solve_from_starts(
    problem: FitProblem, observed: Sightings, start: FloatArray, *, precision: FloatArray
) -> FloatArray:
    """Return the unknowns of the lowest local minimum that was found.

    Parameters
    ----------
    problem : the camera sought.
    observed : sightings with their information, outliers gone.
    start : unknowns near the truth but for the decentering.
    precision : prior precisions of the unknowns.
    """
    free = np.ones(problem.size, dtype=bool)
    free[HIGHER] = False
    tried = [most_probable(problem, observed, start, precision=precision, iterations=15)]
    for decentering in _STARTS:
        at = start.copy()
        at[DECENTERING] = 0.0
        at[HIGHER] = decentering
        tried.append(most_probable(problem, observed, at, precision=precision, free=free, iterations=4, tolerance=1e-4))
    promising = sorted(tried[1:], key=lambda one: one.cost)[:_LET_GO]
    freed = [most_probable(problem, observed, one.unknowns, precision=precision, iterations=15) for one in promising]
    return min([tried[0], *freed], key=lambda one: one.cost).unknowns
