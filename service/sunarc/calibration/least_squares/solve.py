"""The most probable camera: Levenberg-Marquardt on a robust cost with Gaussian priors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sunarc.array_types import BoolArray, FloatArray
from sunarc.calibration.least_squares.kernels import Goal, Lens, Seen, minimised
from sunarc.calibration.least_squares.problem import Observations, Problem
from sunarc.calibration.robust_loss import tukey_weights
from sunarc.optics.forward import kernel_lens


class Solution(NamedTuple):
    """Where a fit came to rest: the unknowns (p,), and half the weighted squares (or the loss) and half the prior's."""

    unknowns: FloatArray
    cost: float


def most_probable(
    problem: Problem,
    observed: Observations,
    start: FloatArray,
    *,
    precision: FloatArray,
    sigma: float | None = None,
    free: BoolArray | None = None,
    iterations: int = 30,
    tolerance: float = 1e-6,
) -> Solution:
    """Return the unknowns that minimise loss plus prior, from a start.

    Parameters
    ----------
    problem : the camera sought, its air as it is assumed.
    observed : sightings; with `sigma` given, their information is relative to it.
    start : first unknowns.
    precision : prior precisions of the unknowns, (size,), about 0 for the lens.
    sigma : px, scale of the redescending loss; None takes plain squares.
    free : which unknowns may move; all by default.
    iterations : most steps.
    tolerance : relative gain of the cost below which it rests.
    """
    moving = np.arange(problem.size) if free is None else np.flatnonzero(free)
    goal = Goal(precision, 0.0 if sigma is None else sigma, iterations, tolerance)
    unknowns, cost = minimised(as_lens(problem), as_seen(observed), goal, np.asarray(start, dtype=np.float64), moving)
    return Solution(unknowns, cost)


def information(residual: FloatArray, observed: Observations, sigma: float | None) -> FloatArray:
    """Return (n,): how much each sighting counts where it lies now, px⁻²."""
    if sigma is None:
        return observed.information
    distance = np.hypot(residual[:, 0], residual[:, 1]) * np.sqrt(observed.information)
    return np.asarray(observed.information * tukey_weights(distance, sigma=sigma) / sigma**2)


def as_lens(problem: Problem) -> Lens:
    """Return a problem's lens as the compiled loop takes it."""
    mean, basis = np.ascontiguousarray(problem.prior.mean), np.ascontiguousarray(problem.prior.basis)
    _, code, mirror, max_angle = kernel_lens(problem.template)
    return Lens(mean, basis, code, mirror, max_angle)


def as_seen(observed: Observations) -> Seen:
    """Return sightings as the compiled loop takes them."""
    return Seen(
        directions=np.ascontiguousarray(observed.directions, dtype=np.float64),
        pixels=np.ascontiguousarray(observed.pixels, dtype=np.float64),
        information=np.ascontiguousarray(observed.information, dtype=np.float64),
        epoch=np.ascontiguousarray(observed.epoch),
    )
