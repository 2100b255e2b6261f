"""The linear trials of `ransac_start` and their refinement as compiled loops, without the interpreter's lock."""

from __future__ import annotations

import numpy as np

from sunarc.array_types import FloatArray, IntArray
from sunarc.calibration.least_squares.kernels import damped_step_of
from sunarc.calibration.robust_loss import robust_scale
from sunarc.jit import njit

RIDGE = 1e-12
"""Share of the diagonal that is added to it: a camera far from the sightings has derivatives of any size, and rounding
makes a matrix singular."""


@njit(nogil=True)
def trial_steps(  # noqa: PLR0917 - compiled functions take positions
    residual: FloatArray, rows: FloatArray, picks: IntArray, start: FloatArray, precision: FloatArray, trust_px: float
) -> FloatArray:
    """Return the steps (t, p) that samples of sightings lead to, each by linear least squares with the prior.

    Parameters
    ----------
    residual, rows : (n, 2), (n, 2, p) about the start (p,), of prior precisions (p,).
    picks : (t, s) the sightings of each sample.
    trust_px : 1-sigma of a sighting, px.
    """
    p, weight = start.size, 1.0 / trust_px**2
    steps, moving = np.empty((picks.shape[0], p)), np.arange(p)
    normal, gradient, work = np.empty((p, p)), np.empty(p), np.empty((p, p))
    for t in range(picks.shape[0]):
        _write_prior(start, precision, normal, gradient)
        for n in picks[t]:
            for c in range(2):
                _add_row(rows[n, c], residual[n, c], weight, normal, gradient)
        damped_step_of(normal, gradient, moving, RIDGE, work, steps[t])
    return steps


@njit(nogil=True)
def _write_prior(start: FloatArray, precision: FloatArray, normal: FloatArray, gradient: FloatArray) -> None:
    normal[:] = 0.0
    for i in range(start.size):
        normal[i, i] = precision[i]
        gradient[i] = -precision[i] * start[i]


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _add_row(row: FloatArray, residual: float, weight: float, normal: FloatArray, gradient: FloatArray) -> None:
    """Add one line of the equations to the lower half of the sums."""
    for i in range(row.size):
        share, line = weight * row[i], normal[i]
        gradient[i] += share * residual
        for j in range(i + 1):
            line[j] += share * row[j]


@njit(nogil=True)
def tightened(  # noqa: PLR0917 - compiled functions take positions
    step: FloatArray,
    residual: FloatArray,
    columns: FloatArray,
    start: FloatArray,
    precision: FloatArray,
    cuts: FloatArray,
    share: float,
    floor: float,
) -> FloatArray:
    """Return a step (p,) refined on all sightings, those far off counting less and less.

    Parameters
    ----------
    residual : (2, n) px, x and y. columns : (p, 2 n) their derivatives, likewise.
    cuts : (rounds,) distances, in the scale found, at which a sighting counts a quarter.
    share : of the sightings that is surely well-behaved.
    floor : px, smallest scale.
    """
    p, n = start.size, residual.shape[1]
    found, moving, root = step.copy(), np.arange(p), np.empty(n)
    normal, gradient, work = np.empty((p, p)), np.empty(p), np.empty((p, p))
    weighted, right = np.empty_like(columns), np.empty(2 * n)
    for cut in cuts:
        after = residual.copy().reshape(2 * n)
        after -= np.dot(found, columns)
        distance = np.sqrt(after[:n] ** 2 + after[n:] ** 2)
        sigma = robust_scale(distance, share, floor)
        root[:] = 1.0 / ((1.0 + (distance / (sigma * cut)) ** 2) * sigma)
        for i in range(p):
            weighted[i, :n] = columns[i, :n] * root
            weighted[i, n:] = columns[i, n:] * root
        right[:n], right[n:] = residual[0] * root, residual[1] * root
        np.dot(weighted, weighted.T, normal)
        np.dot(weighted, right, gradient)
        for i in range(p):
            normal[i, i] += precision[i]
            gradient[i] -= precision[i] * start[i]
        damped_step_of(normal, gradient, moving, RIDGE, work, found)
    return found
