"""The most probable camera: Levenberg-Marquardt on a robust cost with Gaussian priors, as one compiled loop.

tests/calibration/least_squares/solve_reference.py is the same in numpy, and the tests compare the two. It runs without
the interpreter's lock (`nogil`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sunarc.array_types import BoolArray, FloatArray, IntArray
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.robust_loss import tukey_weights
from sunarc.calibration.solve.priors import LENS, N_LENS
from sunarc.calibration.solve.problem import FitProblem
from sunarc.calibration.solve.row_kernels import add_products, block_size, reach_of, weigh
from sunarc.compiled_math import cholesky_solve
from sunarc.jit import njit
from sunarc.optics.camera import Param
from sunarc.optics.forward import kernel_optics
from sunarc.optics.kernels import N_NATIVE, RESIDUAL, WORK, Optics, write_block, write_rotation

FIRST_DAMPING = 1e-3
LARGEST_DAMPING = 1e8
SMALLEST_DAMPING = 1e-12
"""A floor that keeps the damping of good steps from underflowing."""
DAMPING_GROWS, DAMPING_FALLS = 4.0, 0.03
"""By what it grows after a step that loses, and falls after one that gains all that was predicted: chosen so that a
day's fit takes the fewest steps; 10 and 0.1 take a quarter more."""
RIDGE = 1e-14
"""Share of the diagonal that is always added: below the rounding of the sums."""
_SIZE = len(Param)
_LENS = np.ascontiguousarray(LENS)
_SUMS = N_NATIVE + 2
"""Columns whose products are added: derivatives, residual and, for an even number, one that is not looked at."""


class KernelLens(NamedTuple):
    """How unknowns become a lens: mean (17,) and basis (17, 17) of the prior, and the kernels' numbers of a camera."""

    mean: FloatArray
    basis: FloatArray
    optics: Optics


class Seen(NamedTuple):
    """Sightings: directions (n, 3), pixels (n, 2), information (n,), epoch (n,), all contiguous."""

    directions: FloatArray
    pixels: FloatArray
    information: FloatArray
    epoch: IntArray


class Goal(NamedTuple):
    """What is minimised: prior precisions (p,), the loss's sigma in px (0: plain squares), and when to stop."""

    precision: FloatArray
    sigma: float
    iterations: int
    tolerance: float


@njit(nogil=True)
def minimised(
    lens: KernelLens, seen: Seen, goal: Goal, start: FloatArray, moving: IntArray
) -> tuple[FloatArray, float]:
    """Return the unknowns (p,) and the cost where the steps converge; see `most_probable`.

    `moving` (f,) are the places of the unknowns that may change.
    """
    p, f = start.size, moving.size
    at, trial = start.copy(), start.copy()
    normal, next_normal = np.empty((p, p)), np.empty((p, p))
    gradient, next_gradient = np.empty(p), np.empty(p)
    work, step = np.empty((f, f)), np.empty(f)
    cost = equations(lens, seen, goal, at, normal, gradient)
    damping = FIRST_DAMPING
    for _ in range(goal.iterations):
        moved, gain, used = False, 0.0, damping
        while damping < LARGEST_DAMPING:
            damped_step_of(normal, gradient, moving, damping, work, step)
            trial[:] = at
            for i in range(f):
                trial[moving[i]] += step[i]
            gain = cost - equations(lens, seen, goal, trial, next_normal, next_gradient)
            # equal costs are taken: at the minimum rounding decides, and a refusal would only raise the damping
            if gain >= 0.0:
                moved = True
                break
            damping *= DAMPING_GROWS
        if not moved:
            break
        if damping == used:  # one that has just been raised was needed
            damping *= trust_factor(gain, predicted_gain(normal, gradient, moving, damping, step))
            damping = max(damping, SMALLEST_DAMPING)
        at[:] = trial
        normal, next_normal = next_normal, normal
        gradient, next_gradient = next_gradient, gradient
        cost -= gain
        if gain <= goal.tolerance * max(cost, 1e-12):
            break
    return at, cost


@njit(nogil=True)
def predicted_gain(
    normal: FloatArray, gradient: FloatArray, moving: IntArray, damping: float, step: FloatArray
) -> float:
    """Return what a damped step (f,) takes from the cost where the residuals are linear."""
    total = 0.0
    for i in range(moving.size):
        k = moving[i]
        total += step[i] * (gradient[k] + damping * normal[k, k] * step[i])
    return 0.5 * total


@njit(nogil=True)
def trust_factor(gain: float, predicted: float) -> float:
    """Return what the damping is multiplied by after a step: the better the prediction, the more it is trusted.

    Reference: H. B. Nielsen, "Damping parameter in Marquardt's method", IMM-REP-1999-05 (1999).
    """
    if predicted <= 0.0:
        return 1.0
    return float(max(DAMPING_FALLS, min(1.0 - (2.0 * gain / predicted - 1.0) ** 3, 2.0)))


@njit(nogil=True)
def equations(  # noqa: PLR0917 - compiled functions take positions
    lens: KernelLens, seen: Seen, goal: Goal, at: FloatArray, normal: FloatArray, gradient: FloatArray
) -> float:
    """Write the normal equations (p, p) and the pull (p,) about some unknowns; return the cost, prior included."""
    epochs = (at.size - N_LENS) // 3
    vector = np.zeros(_SIZE)
    for i in range(N_LENS):
        value = lens.mean[i]
        for j in range(N_LENS):
            value += lens.basis[i, j] * at[j]
        vector[_LENS[i]] = value
    rotation, jacobian = np.empty((epochs, 3, 3)), np.empty((epochs, 3, 3))
    for e in range(epochs):
        write_rotation(at[N_LENS + 3 * e : N_LENS + 3 * e + 3], rotation[e], jacobian[e])
    products = np.zeros((epochs, _SUMS, _SUMS))
    cost = _data_sums(lens, seen, goal.sigma, vector, rotation, jacobian, products)
    _in_unknowns(lens.basis, products, normal, gradient)
    for i in range(at.size):
        cost += 0.5 * goal.precision[i] * at[i] * at[i]
        normal[i, i] += goal.precision[i]
        gradient[i] -= goal.precision[i] * at[i]
    # a step to where the projection overflows must lose every comparison
    return cost if math.isfinite(cost) else math.inf


@njit(nogil=True)
def _data_sums(  # noqa: PLR0917 - compiled functions take positions
    lens: KernelLens,
    seen: Seen,
    sigma: float,
    vector: FloatArray,
    rotation: FloatArray,
    jacobian: FloatArray,
    products: FloatArray,
) -> float:
    """Add, for each epoch, the products of the derivatives by lens and pose and of the residuals, and return the loss.

    `products` (epochs, 22, 22): lower halves, in the order of a block's columns.
    """
    work = np.empty(WORK)
    begin, cost = 0, 0.0
    while begin < seen.epoch.size:
        e, size = seen.epoch[begin], block_size(seen.epoch, begin)
        write_block(vector, lens.optics, rotation[e], jacobian[e], seen.directions[begin : begin + size], work)
        cost += weigh(work, seen.pixels, seen.information, begin, size, sigma)
        add_products(work, products[e])
        begin += size
    return cost


@njit(nogil=True)
def _in_unknowns(basis: FloatArray, products: FloatArray, normal: FloatArray, gradient: FloatArray) -> None:
    """Write the sums by the whitened unknowns of the lens and the poses of all epochs; lower triangles come in."""
    normal[:] = 0.0
    gradient[:] = 0.0
    half, reach = np.empty((N_NATIVE, N_LENS)), reach_of(basis)
    for e in range(products.shape[0]):
        native, pull = products[e], products[e, RESIDUAL]
        _fill_upper(native)
        _add_lens(basis, reach, native, half, normal, gradient)
        pose = N_LENS + 3 * e
        for a in range(3):
            gradient[pose + a] = pull[N_LENS + a]
            for j in range(N_LENS):
                normal[pose + a, j] = half[N_LENS + a, j]
            for b in range(a + 1):
                normal[pose + a, pose + b] = native[N_LENS + a, N_LENS + b]
    _fill_upper(normal)


@njit(nogil=True)
def _add_lens(  # noqa: PLR0917 - compiled functions take positions
    basis: FloatArray,
    reach: IntArray,
    native: FloatArray,
    half: FloatArray,
    normal: FloatArray,
    gradient: FloatArray,
) -> None:
    """Write one epoch's sums (20, 20) times the basis to `half` (20, 17), and add those of the lens."""
    half[:] = 0.0
    for i in range(N_NATIVE):
        for k in range(N_LENS):
            for j in range(reach[k, 0], reach[k, 1]):
                half[i, j] += native[i, k] * basis[k, j]
    for k in range(N_LENS):
        for i in range(reach[k, 0], reach[k, 1]):
            share = basis[k, i]
            gradient[i] += share * native[RESIDUAL, k]
            for j in range(i + 1):
                normal[i, j] += share * half[k, j]


@njit(nogil=True)
def _fill_upper(matrix: FloatArray) -> None:
    """Copy the lower half of a matrix to the upper one."""
    for i in range(matrix.shape[0]):
        for j in range(i):
            matrix[j, i] = matrix[i, j]


@njit(nogil=True)
def damped_step_of(  # noqa: PLR0917 - compiled functions take positions
    normal: FloatArray, gradient: FloatArray, moving: IntArray, damping: float, work: FloatArray, step: FloatArray
) -> None:
    """Write the Levenberg-Marquardt step (f,), scaled by the diagonal; zeros where the equations cannot be solved."""
    f = moving.size
    # focal lengths in px stand beside coefficients of 1e-3: scaled, the damping means the same to all
    scale = np.empty(f)
    for i in range(f):
        scale[i] = 1.0 / math.sqrt(max(normal[moving[i], moving[i]], 1e-300))
    for i in range(f):
        step[i] = scale[i] * gradient[moving[i]]
        for j in range(i + 1):
            work[i, j] = normal[moving[i], moving[j]] * scale[i] * scale[j]
        work[i, i] += damping + RIDGE
    if not cholesky_solve(work, step):
        step[:] = 0.0
        return
    for i in range(f):
        step[i] *= scale[i]


# The most probable camera: Levenberg-Marquardt on a robust cost with Gaussian priors.


class Solution(NamedTuple):
    """Where a fit converged: the unknowns (p,), and half the weighted squares (or the loss) and half the prior's."""

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
    precision : prior precisions of the unknowns, (size,), about 0 for the lens.
    sigma : px, scale of the redescending loss; None takes plain squares.
    free : which unknowns may move; all by default.
    iterations : most steps.
    tolerance : relative gain of the cost below which it has converged.
    """
    moving = np.arange(problem.size) if free is None else np.flatnonzero(free)
    goal = Goal(precision, 0.0 if sigma is None else sigma, iterations, tolerance)
    unknowns, cost = minimised(as_lens(problem), as_seen(observed), goal, np.asarray(start, dtype=np.float64), moving)
    return Solution(unknowns, cost)


def information(residual: FloatArray, observed: Sightings, sigma: float | None) -> FloatArray:
    """Return (n,): how much each sighting counts where it lies now, px⁻²."""
    if sigma is None:
        return observed.information
    distance = np.hypot(residual[:, 0], residual[:, 1]) * np.sqrt(observed.information)
    return np.asarray(observed.information * tukey_weights(distance, sigma=sigma) / sigma**2)


def as_lens(problem: FitProblem) -> KernelLens:
    """Return a problem's lens as the compiled loop takes it."""
    mean, basis = np.ascontiguousarray(problem.prior.mean), np.ascontiguousarray(problem.prior.basis)
    return KernelLens(mean, basis, kernel_optics(problem.template))


def as_seen(observed: Sightings) -> Seen:
    """Return sightings as the compiled loop takes them."""
    return Seen(
        directions=np.ascontiguousarray(observed.directions, dtype=np.float64),
        pixels=np.ascontiguousarray(observed.pixels, dtype=np.float64),
        information=np.ascontiguousarray(observed.information, dtype=np.float64),
        epoch=np.ascontiguousarray(observed.epoch),
    )
