"""Levenberg-Marquardt on a robust cost with Gaussian priors, in numpy: what the compiled loop is compared with."""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.solve.levenberg_marquardt import Solution, information
from sunarc.calibration.solve.problem import FitProblem
from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.common.robust_statistics import tukey_loss

FIRST_DAMPING, LARGEST_DAMPING, SMALLEST_DAMPING = 1e-3, 1e8, 1e-12
DAMPING_GROWS, DAMPING_FALLS, RIDGE = 4.0, 0.03, 1e-14


def most_probable_reference(
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
    """Return what `most_probable` does."""
    moving = np.ones(problem.size, dtype=bool) if free is None else free
    at = start.copy()
    residual, rows = problem.linearised(at, observed)
    cost = _cost(residual, observed, at, precision, sigma)
    damping = FIRST_DAMPING
    for _ in range(iterations):
        weight = information(residual, observed, sigma)
        flat = rows[..., moving]
        # Gauss-Newton: second derivatives of the projection are left out, they vanish with the residuals
        normal = np.einsum("nai,n,naj->ij", flat, weight, flat, optimize=True) + np.diag(precision[moving])
        gradient = np.einsum("nai,n,na->i", flat, weight, residual, optimize=True) - precision[moving] * at[moving]
        next_, gain, predicted, used = None, 0.0, 0.0, damping
        while damping < LARGEST_DAMPING:
            trial = at.copy()
            step = damped_step(normal, gradient, damping)
            trial[moving] += step
            predicted = float(gradient @ step - 0.5 * step @ normal @ step)
            trial_residual = problem.residuals(trial, observed)
            gain = cost - _cost(trial_residual, observed, trial, precision, sigma)
            # equal costs are taken: at the minimum rounding decides, and a refusal would only raise the damping
            if gain >= 0.0:
                next_ = trial
                break
            damping *= DAMPING_GROWS
        if next_ is None:
            break
        # a good step trusts the linear model more; the floor keeps it from underflowing
        if damping == used and predicted > 0.0:
            damping *= max(DAMPING_FALLS, min(1.0 - (2.0 * gain / predicted - 1.0) ** 3, 2.0))
            damping = max(damping, SMALLEST_DAMPING)
        at, cost = next_, cost - gain
        residual, rows = problem.linearised(at, observed)
        if gain <= tolerance * max(cost, 1e-12):
            break
    return Solution(at, cost)


def damped_step(normal: FloatArray, gradient: FloatArray, damping: float) -> FloatArray:
    """Return the Levenberg-Marquardt step, scaled by the diagonal; zeros where the equations cannot be solved."""
    # focal lengths in px stand beside coefficients of 1e-3: scaled, the damping means the same to all
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal * scale[:, None] * scale
    scaled[np.diag_indices_from(scaled)] += damping + RIDGE
    try:
        step = scale * cho_solve(cho_factor(scaled), scale * gradient)
    except (np.linalg.LinAlgError, ValueError):
        return np.zeros_like(gradient)
    return np.asarray(step)


def _cost(
    residual: FloatArray, observed: Sightings, unknowns: FloatArray, precision: FloatArray, sigma: float | None
) -> float:
    prior = 0.5 * float(np.sum(precision * unknowns**2))
    square = np.sum(residual**2, axis=-1) * observed.information
    if sigma is None:
        return 0.5 * float(np.sum(square)) + prior
    loss = float(np.sum(tukey_loss(np.sqrt(square), sigma=sigma))) + prior
    # a step to where the projection overflows must lose every comparison
    return loss if math.isfinite(loss) else math.inf
