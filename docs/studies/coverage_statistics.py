"""What the studies of coverage share: squared distances in stated 1-sigma, and intervals over lenses."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sunarc.calibration.answers.covariance import hemisphere, project_with_covariance
from sunarc.calibration.model.result import Calibration

FloatArray = NDArray[np.float64]

CHI_SQUARE_95 = 5.991
"""The 95 % quantile of chi-square with two degrees of freedom."""
STATED = (0.5, 0.68, 0.95, 0.99)
"""Shares for which ellipses are compared."""
SKY = hemisphere(600)
_DRAWS = 2000
_PLACES = 400


class TrueSky(NamedTuple):
    """Where the true camera sees `SKY`, px, which of it lands in its image, and the degrees from the sun's track."""

    pixels: FloatArray
    seen: NDArray[np.bool_]
    away: FloatArray


def squared_sigmas(error: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return e' S⁻¹ e, (n,), of errors (n, 2), px, with the covariances (n, 2, 2) stated for them, px²."""
    return np.asarray(np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0]))


def within_stated(
    fit: Calibration,
    pixels: FloatArray,
    error: FloatArray,
    covariance: FloatArray,
    shares: tuple[float, ...] = STATED,
) -> FloatArray:
    """Return (n, m): 1 where errors (n, 2) of pixels (n, 2), px, lie in what a fit states for some shares (m,)."""
    square = squared_sigmas(error, covariance)
    factors = np.ones((len(shares), square.size))
    mixture = getattr(fit, "mixture", None)  # versions before 0.4 have none: `coverage_pairs.py`
    if mixture is not None:
        factors = np.array([mixture.sigma_factors(pixels, share) for share in shares])
    limits = -2.0 * np.log1p(-np.array(shares)) * factors.T**2
    return np.asarray(square[:, None] < limits, dtype=float)


def judged(fit: Calibration, true: TrueSky) -> FloatArray:
    """Return (16,): the RMS error over the sky, px, the verdict, and the shares within what is stated.

    For 50, 68, 95 and 99 % over the sky; for 50 and 95 % near the track, far from it, and in three zones of the zenith.
    """
    found, covariance = project_with_covariance(fit, SKY)
    shown = true.seen & np.all(np.isfinite(found), axis=-1)
    error = (found - true.pixels)[shown]
    covered = within_stated(fit, found[shown], error, covariance[shown])
    away, zenith = true.away[shown], np.degrees(np.arccos(SKY[shown, 2]))
    zones = away < 20.0, away > 40.0, zenith < 30.0, (zenith >= 30.0) & (zenith < 60.0), zenith >= 60.0
    shares = [covered[where][:, [0, 2]].mean(axis=0) if np.any(where) else np.full(2, math.nan) for where in zones]
    rms = math.sqrt(float(np.mean(np.sum(error**2, axis=-1))))
    return np.concatenate([[rms, fit.verdict.accepted], covered.mean(axis=0), *shares])


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
