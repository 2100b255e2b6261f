"""The most probable camera: Levenberg-Marquardt on a robust cost with Gaussian priors."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from sunarc.array_types import BoolArray, FloatArray
from sunarc.calibration.least_squares.problem import Observations, Problem
from sunarc.calibration.robust_loss import tukey_loss, tukey_weights

_FIRST_DAMPING = 1e-3
_LARGEST_DAMPING = 1e8


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """Where a fit came to rest.

    Attributes
    ----------
    unknowns : see `Problem`.
    residual : (n, 2) observed minus predicted, px.
    cost : half the weighted squares, or the robust loss, and half the prior's.
    """

    unknowns: FloatArray
    residual: FloatArray
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
    problem : the camera sought.
    observed : sightings; with `sigma` given, their information is relative to it.
    start : first unknowns.
    precision : prior precisions of the unknowns, (size,), about 0 for the lens.
    sigma : px, scale of the redescending loss; None takes plain squares.
    free : which unknowns may move; all by default.
    iterations : most steps.
    tolerance : relative gain of the cost below which it rests.
    """
    moving = np.ones(problem.size, dtype=bool) if free is None else free
    at = start.copy()
    residual, rows = problem.linearised(at, observed)
    cost = _cost(residual, observed, at, precision, sigma)
    damping = _FIRST_DAMPING
    for _ in range(iterations):
        weight = information(residual, observed, sigma)
        flat = rows[..., moving]
        # Gauss-Newton: second derivatives of the projection are left out, they vanish with the residuals
        normal = np.einsum("nai,n,naj->ij", flat, weight, flat, optimize=True) + np.diag(precision[moving])
        gradient = np.einsum("nai,n,na->i", flat, weight, residual, optimize=True) - precision[moving] * at[moving]
        next_, gain = None, 0.0
        while damping < _LARGEST_DAMPING:
            trial = at.copy()
            trial[moving] += damped_step(normal, gradient, damping)
            trial_residual = problem.residuals(trial, observed)
            gain = cost - _cost(trial_residual, observed, trial, precision, sigma)
            # equal costs are taken: at the minimum rounding decides, and a refusal would only raise the damping
            if gain >= 0.0:
                next_ = trial
                break
            damping *= 10.0
        if next_ is None:
            break
        # a good step trusts the linear model more; the floor keeps it from underflowing
        damping = max(damping * 0.1, 1e-12)
        at, cost = next_, cost - gain
        residual, rows = problem.linearised(at, observed)
        if gain <= tolerance * max(cost, 1e-12):
            break
    return Solution(unknowns=at, residual=residual, cost=cost)


def damped_step(normal: FloatArray, gradient: FloatArray, damping: float) -> FloatArray:
    """Return the Levenberg-Marquardt step, scaled by the diagonal; zeros where the equations cannot be solved."""
    # focal lengths in px stand beside coefficients of 1e-3: scaled, the damping means the same to all
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal * scale[:, None] * scale
    scaled[np.diag_indices_from(scaled)] += damping + 1e-14
    try:
        step = scale * cho_solve(cho_factor(scaled), scale * gradient)
    except (np.linalg.LinAlgError, ValueError):
        return np.zeros_like(gradient)
    return np.asarray(step)


def information(residual: FloatArray, observed: Observations, sigma: float | None) -> FloatArray:
    """Return (n,): how much each sighting counts where it lies now, px⁻²."""
    if sigma is None:
        return observed.information
    distance = np.hypot(residual[:, 0], residual[:, 1]) * np.sqrt(observed.information)
    return np.asarray(observed.information * tukey_weights(distance, sigma=sigma) / sigma**2)


def _cost(
    residual: FloatArray, observed: Observations, unknowns: FloatArray, precision: FloatArray, sigma: float | None
) -> float:
    prior = 0.5 * float(np.sum(precision * unknowns**2))
    square = np.sum(residual**2, axis=-1) * observed.information
    if sigma is None:
        return 0.5 * float(np.sum(square)) + prior
    loss = float(np.sum(tukey_loss(np.sqrt(square), sigma=sigma))) + prior
    # a step to where the projection overflows must lose every comparison
    return loss if math.isfinite(loss) else math.inf
