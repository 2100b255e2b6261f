"""The most probable camera: Levenberg-Marquardt on a robust cost with Gaussian priors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sunarc import _kernels
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.solve.problem import FitProblem
from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.common.robust_statistics import tukey_weights


class Solution(NamedTuple):
    """Minimum of a fit: the unknowns (p,), half the weighted squares (or the loss), and half the prior's."""

    unknowns: FloatArray
    cost: float


def most_probable(
    problem: FitProblem,
    observed: Sightings,
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
    precision : prior precisions (size,) of the unknowns; the prior's mean is 0.
    sigma : px, scale of the redescending loss; None takes plain squares.
    free : which unknowns may move; all by default.
    iterations : most steps.
    tolerance : relative gain of the cost below which it has converged.
    """
    moving = np.arange(problem.size) if free is None else np.flatnonzero(free)
    lens, seen = problem.prior, np.ascontiguousarray
    found = _kernels.most_probable(
        *problem.kernel_numbers(),
        seen(lens.mean),
        seen(lens.basis),
        seen(observed.directions),
        seen(observed.pixels),
        seen(observed.information),
        seen(observed.epoch),
        seen(precision),
        0.0 if sigma is None else sigma,
        iterations,
        tolerance,
        seen(start),
        moving,
    )
    return Solution(*found)


def information(residual: FloatArray, observed: Sightings, sigma: float | None) -> FloatArray:
    """Return (n,): the weight of each sighting at its present residual, px⁻²."""
    if sigma is None:
        return observed.information
    distance = np.hypot(residual[:, 0], residual[:, 1]) * np.sqrt(observed.information)
    return np.asarray(observed.information * tukey_weights(distance, sigma=sigma) / sigma**2)
