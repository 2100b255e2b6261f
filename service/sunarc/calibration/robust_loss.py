"""How much a sighting counts, by how far it lies off: Tukey's biweight about a scale found in the data."""

from __future__ import annotations

import math

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.robust_statistics import biweights

UNSEEN_PX = 1e4
"""Residual of a direction that the camera cannot see, px: beyond any cut."""
CUT = 5.0
"""Distance in sigmas beyond which a sighting counts nothing."""

_ROUNDS = 60
_KEEP = 2.5


def finite(residual: FloatArray) -> FloatArray:
    """Return residuals, px; `UNSEEN_PX` where the camera cannot see the direction."""
    return np.where(np.isfinite(residual), residual, UNSEEN_PX)


def tukey_weights(distance: FloatArray, *, sigma: float) -> FloatArray:
    """Return weights from 1 (at 0) to 0 (from `CUT` sigmas on) for 2-D distances."""
    return biweights(distance / (CUT * sigma))


def tukey_loss(distance: FloatArray, *, sigma: float) -> FloatArray:
    """Return the loss whose weights `tukey_weights` are: d²/2σ² near 0, constant from `CUT` sigmas on."""
    ratio = np.minimum(distance / (CUT * sigma), 1.0)
    return np.asarray(CUT**2 / 6.0 * (1.0 - (1.0 - ratio**2) ** 3))


def robust_sigma(distance: FloatArray, *, share: float = 0.3, floor: float = 1e-9) -> float:
    """Return the 1-sigma per axis of the well-behaved sightings among others.

    Starts at the quantile `share` of the 2-D distances and then takes, again and again, those within 2.5 sigma,
    corrected for what a round Gaussian has beyond.

    Parameters
    ----------
    distance : (n,) 2-D distances.
    share : share of the sightings that is surely well-behaved.
    floor : smallest answer.
    """
    if distance.size == 0:
        return floor
    # the distance of a round Gaussian is Rayleigh: its quantile q lies at sqrt(-2 ln(1 - q)) sigma
    sigma = max(float(np.quantile(distance, share)) / math.sqrt(-2.0 * math.log1p(-share)), floor)
    # share of a round Gaussian beyond the cut; without the correction every round would shrink the scale
    tail = math.exp(-0.5 * _KEEP**2)
    correction = 1.0 - 0.5 * _KEEP**2 * tail / (1.0 - tail)
    for _ in range(_ROUNDS):
        inside = distance[distance < _KEEP * sigma]
        if inside.size == 0:
            break
        next_ = max(math.sqrt(0.5 * float(np.mean(inside**2)) / correction), floor)
        if abs(next_ - sigma) < 1e-4 * sigma:
            return next_
        sigma = next_
    return sigma


_GRID = np.linspace(0.0, CUT, 2001)
_DENSITY = _GRID * np.exp(-0.5 * _GRID**2) * (_GRID[1] - _GRID[0])
_INLIER_WEIGHT = tukey_weights(_GRID, sigma=1.0)
_EXPECTED_CURVATURE = float(np.sum(_DENSITY * (_INLIER_WEIGHT - 2.0 * (_GRID / CUT) ** 2 * (1.0 - (_GRID / CUT) ** 2))))
_EXPECTED_SQUARE = float(np.sum(_DENSITY * 0.5 * (_GRID * _INLIER_WEIGHT) ** 2))
INFORMATION_PER_WEIGHT = _EXPECTED_CURVATURE**2 / _EXPECTED_SQUARE / float(np.sum(_DENSITY * _INLIER_WEIGHT))
"""Information (in 1/σ²) that a unit of weight carries for round Gaussian sightings: E[ψ']² / E[ψ²] / E[w]."""
