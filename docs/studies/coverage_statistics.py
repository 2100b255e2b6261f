"""What the studies of coverage share: squared distances in stated 1-sigma, and intervals over lenses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sunarc.calibration.model.result import Calibration

FloatArray = NDArray[np.float64]

CHI_SQUARE_95 = 5.991
"""The 95 % quantile of chi-square with two degrees of freedom."""
STATED = (0.5, 0.68, 0.95, 0.99)
"""Shares for which ellipses are compared."""
_DRAWS = 2000
_PLACES = 400


def squared_sigmas(error: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return e' S⁻¹ e, (n,), of errors (n, 2), px, with the covariances (n, 2, 2) stated for them, px²."""
    return np.asarray(np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0]))


def within_stated(fit: Calibration, pixels: FloatArray, error: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return (n, 4): 1 where errors (n, 2) of pixels (n, 2), px, lie in what a fit states for 50, 68, 95 and 99 %."""
    square = squared_sigmas(error, covariance)
    factors = np.ones((4, square.size))
    if fit.mixture is not None:
        factors = np.array([fit.mixture.sigma_factors(pixels, share) for share in STATED])
    limits = -2.0 * np.log1p(-np.array(STATED)) * factors.T**2
    return np.asarray(square[:, None] < limits, dtype=float)


def bootstrap_interval(values: FloatArray) -> tuple[float, float]:
    """Return the 95 % interval of the mean of values (lenses,), by drawing lenses again."""
    picks = np.random.default_rng(1).integers(0, values.size, (_DRAWS, values.size))
    low, high = np.quantile(values[picks].mean(axis=1), [0.025, 0.975])
    return float(low), float(high)


def every_so_many(track: FloatArray) -> FloatArray:
    """Return some 400 places (k, 3) of a track (n, 3), evenly in time."""
    return track[:: max(track.shape[0] // _PLACES, 1)]


def degrees_from_track(directions: FloatArray, track: FloatArray) -> FloatArray:
    """Return (n,): angles, degrees, of directions (n, 3) to the nearest place of a track (m, 3)."""
    return np.asarray(np.degrees(np.arccos(np.clip(np.max(directions @ track.T, axis=1), -1.0, 1.0))))
