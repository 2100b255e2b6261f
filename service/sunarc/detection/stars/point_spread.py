"""Fits of elliptical Gaussians to stars, many at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sunarc.array_types import BoolArray, FloatArray

_ROUNDS = 12
"""Levenberg-Marquardt steps; a star converges in four to eight."""
_CONVERGED_PX = 1e-4
_PLACE = 4
"""The first parameters: x, y, height, background; the shape follows."""


class Stamps(NamedTuple):
    """Pixels around stars.

    x, y : (n, m) of each pixel, px. value : (n, m) counts above the background. variance : (n, m) of the background,
    counts²; infinite where a pixel takes no part (clipped, outside, another star's).
    """

    x: FloatArray
    y: FloatArray
    value: FloatArray
    variance: FloatArray


class Fitted(NamedTuple):
    """Results of a fit.

    parameters : (n, 7) x, y, height, background, and the inverse covariance of the point spread: xx, xy, yy.
    position_variance : (n,) of the centre per axis, px². height_variance : (n,) counts². Infinite where the pixels do
        not determine them.
    chi2 : (n,) reduced.
    """

    parameters: FloatArray
    position_variance: FloatArray
    height_variance: FloatArray
    chi2: FloatArray


def fit_point_spreads(stamps: Stamps, start: FloatArray, *, gain_e: float | None, shape: bool) -> Fitted:
    """Fit a Gaussian and a constant to each stamp, by weighted least squares.

    Parameters
    ----------
    stamps : the pixels.
    start : (n, 7) parameters to begin at.
    gain_e : electrons per count, for the shot noise of the star itself; None where unknown, and where counts are not
        proportional to light.
    shape : fit the shape too; otherwise it stays as it is in `start`.
    """
    free = start.shape[1] if shape else _PLACE
    now = start.copy()
    damping = np.full(now.shape[0], 1e-3)
    for _ in range(_ROUNDS):
        weight = _weights(stamps, now, gain_e)
        cost, normal, gradient = _equations(stamps, now, weight, free)
        step = _solved(normal + damping[:, None, None] * _diagonal(normal), gradient)
        tried = now.copy()
        tried[:, :free] += step
        with np.errstate(over="ignore", invalid="ignore"):  # a step may lead anywhere, and is then not taken
            better = (_cost(stamps, tried, weight) < cost) & _is_shape(tried)
        now[better] = tried[better]
        damping = np.where(better, 0.2 * damping, 8.0 * damping)
        if np.all(np.abs(step[:, :2]) < _CONVERGED_PX):
            break
    weight = _weights(stamps, now, gain_e)
    cost, normal, _ = _equations(stamps, now, weight, free)
    variance = np.asarray(np.linalg.pinv(normal, hermitian=True), dtype=np.float64)
    return Fitted(
        parameters=now,
        position_variance=0.5 * (_positive(variance[:, 0, 0]) + _positive(variance[:, 1, 1])),
        height_variance=_positive(variance[:, 2, 2]),
        chi2=cost / np.maximum(np.sum(weight > 0.0, axis=-1) - free, 1),
    )


def _positive(variance: FloatArray) -> FloatArray:
    """Return variances, infinite where the pseudo-inverse of a singular matrix has 0 or a rounded negative number."""
    return np.where(variance > 0.0, variance, np.inf)


def inverse_shape(shape: FloatArray) -> FloatArray:
    """Return the inverses of symmetric 2x2 matrices given as (..., 3) xx, xy, yy."""
    xx, xy, yy = np.moveaxis(shape, -1, 0)
    return np.asarray(np.stack([yy, -xy, xx], axis=-1) / (xx * yy - xy**2)[..., None])


def axes_of(shape: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the minor and the major 1-sigma axis, (...) px, of covariances (..., 3) px²."""
    xx, xy, yy = np.moveaxis(shape, -1, 0)
    half, apart = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    return np.sqrt(np.maximum(half - apart, 0.0)), np.sqrt(np.maximum(half + apart, 0.0))


def _weights(stamps: Stamps, at: FloatArray, gain_e: float | None) -> FloatArray:
    """Return 1 over the variance of each pixel, (n, m), with the shot noise of the star where the gain is known."""
    if gain_e is None:
        return np.asarray(1.0 / stamps.variance)
    light = _model(stamps, at, 0)[0] - at[:, 3:4]
    return np.asarray(1.0 / (stamps.variance + np.maximum(light, 0.0) / gain_e))


def _cost(stamps: Stamps, at: FloatArray, weight: FloatArray) -> FloatArray:
    """Return chi² (n,)."""
    residual = stamps.value - _model(stamps, at, 0)[0]
    return np.asarray(np.sum(residual**2 * weight, axis=-1))


def width_of(shape: FloatArray) -> FloatArray:
    """Return the geometric mean of the 1-sigma axes, (...) px, of covariances (..., 3) px²."""
    minor, major = axes_of(shape)
    width: FloatArray = np.sqrt(minor * major)
    return width


def _equations(
    stamps: Stamps, at: FloatArray, weight: FloatArray, free: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return chi² (n,), the normal matrices (n, k, k) and gradients (n, k) of the first `free` parameters."""
    model, slopes = _model(stamps, at, free)
    residual = stamps.value - model
    weighted = np.swapaxes(slopes * weight[..., None], 1, 2)
    cost = np.sum(residual**2 * weight, axis=-1)
    return cost, weighted @ slopes, (weighted @ residual[..., None])[..., 0]


def _model(stamps: Stamps, at: FloatArray, free: int) -> tuple[FloatArray, FloatArray]:
    """Return the model (n, m) and its derivatives (n, m, free)."""
    x, y, height, level, xx, xy, yy = (column[:, None] for column in at.T)
    dx, dy = stamps.x - x, stamps.y - y
    bell = np.exp(-0.5 * np.clip(xx * dx**2 + 2.0 * xy * dx * dy + yy * dy**2, 0.0, 60.0))
    light = height * bell
    if free == 0:
        return light + level, np.empty((0, 0, 0))
    slopes = [light * (xx * dx + xy * dy), light * (xy * dx + yy * dy), bell, np.ones_like(bell)]
    if free > _PLACE:
        slopes += [-0.5 * light * dx**2, -light * dx * dy, -0.5 * light * dy**2]
    return light + level, np.stack(slopes, axis=-1)


def _diagonal(matrices: FloatArray) -> FloatArray:
    """Return the diagonals of matrices (n, k, k) as matrices; nowhere 0."""
    size = matrices.shape[-1]
    return np.asarray((np.einsum("nii->ni", matrices) + 1e-12)[..., None] * np.eye(size))


def _solved(matrices: FloatArray, right: FloatArray) -> FloatArray:
    # in units of the diagonal, since heights and positions differ by powers of ten
    scale = 1.0 / np.sqrt(np.einsum("nii->ni", matrices))
    unit = matrices * scale[:, :, None] * scale[:, None, :] + 1e-9 * np.eye(matrices.shape[-1])
    return np.asarray(np.linalg.solve(unit, (right * scale)[..., None])[..., 0] * scale)


def _is_shape(parameters: FloatArray) -> BoolArray:
    """Return (n,): whether the inverse covariance is positive."""
    xx, xy, yy = parameters[:, 4:].T
    return np.asarray((xx > 0.0) & (yy > 0.0) & (xx * yy > xy**2))
