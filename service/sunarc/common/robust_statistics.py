"""Scales, weights and losses that a few gross errors do not change.

How much a sighting counts is Tukey's biweight of how far it lies off, about a scale found in the data.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from sunarc.common.array_types import BoolArray, FloatArray

MAD_TO_SIGMA = 1.4826
"""1-sigma of a normal distribution over its median absolute deviation, 1 / Φ⁻¹(3/4)."""


def fast_median(values: FloatArray) -> float:
    """Return the median of a flat array, without numpy's cost a call."""
    half = values.size // 2
    if values.size % 2:
        return float(np.partition(values, half)[half])
    parted = np.partition(values, (half - 1, half))
    return 0.5 * float(parted[half - 1] + parted[half])


def mad_sigma(residuals: FloatArray) -> float:
    """Return the 1-sigma of residuals about 0, (...), by their median absolute value."""
    return MAD_TO_SIGMA * fast_median(np.abs(residuals).ravel())


_NEIGHBOURS = 4


def off_neighbours(values: FloatArray) -> FloatArray:
    """Return how far each of a sequence of points (n, 2) lies from the median of it and its four neighbours a side."""
    padded = np.pad(values, ((_NEIGHBOURS, _NEIGHBOURS), (0, 0)), mode="reflect")
    middle = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * _NEIGHBOURS + 1, axis=0), axis=-1)
    return np.asarray(np.linalg.norm(values - middle, axis=-1))


def cauchy_weights(distance: FloatArray, *, scale: float | FloatArray) -> FloatArray:
    """Return the weights 1 / (1 + (d / scale)²) of least squares for Cauchy's loss."""
    return np.asarray(1.0 / (1.0 + (distance / scale) ** 2))


def biweights(ratio: ArrayLike) -> FloatArray:
    """Return Tukey's biweights (1 - r²)² of distances in units of the cut, 0 beyond it."""
    return np.asarray(np.maximum(1.0 - np.square(ratio), 0.0) ** 2)


UNSEEN_PX = 1e4
"""Residual of a direction that the camera cannot see, px: beyond any cut."""
CUT = 5.0
"""Distance in sigmas beyond which a sighting counts nothing."""

WELL_BEHAVED = 0.3
"""Share of the sightings that surely are."""
_PER_UNKNOWN = 0.9
"""Sightings, of two numbers each, for each unknown."""
_MOST_WELL_BEHAVED = 0.9
_ROUNDS = 60
_KEEP = 2.5
_TAIL = math.exp(-0.5 * _KEEP**2)
_CORRECTION = 1.0 - 0.5 * _KEEP**2 * _TAIL / (1.0 - _TAIL)
"""Share of a round Gaussian's mean square that lies within the cut: without it every round would shrink the scale."""


def is_shown(residuals: FloatArray) -> BoolArray:
    """Return (n,): which residuals (n, 2) are of directions within the camera's field."""
    return np.asarray(np.any(residuals != UNSEEN_PX, axis=-1))


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


def surely_well_behaved(n: int, unknowns: int, share: float = WELL_BEHAVED) -> float:
    """Return the share of n sightings from which a robust scale is estimated after fitting some unknowns.

    A camera of 20 unknowns passes through 10 of 20 sightings, and with the scale of these, 0, all others would count
    nothing: nearly twice as many numbers as there are unknowns have to be met.
    """
    return max(share, min(_PER_UNKNOWN * unknowns / max(n, 1), _MOST_WELL_BEHAVED))


def counted_roots(distance: FloatArray, information: FloatArray, *, floor: float) -> FloatArray:
    """Return (n,): roots of information about the scale of 2-D distances in sigmas; 0 from `CUT` of these on."""
    sigma = robust_sigma(distance, floor=floor)
    return np.asarray(np.sqrt(information) * (distance < CUT * sigma) / sigma)


def robust_sigma(distance: FloatArray, *, share: float = WELL_BEHAVED, floor: float = 1e-9) -> float:
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
    ordered = np.sort(distance)
    # the distance of a round Gaussian is Rayleigh: its quantile q lies at sqrt(-2 ln(1 - q)) sigma
    nearest = _quantile_of_sorted(ordered, share)
    # the well-behaved ones stay within the cut: it would else close in on those of few that a fit passes through
    floor = max(floor, nearest / _KEEP)
    sigma = max(nearest / math.sqrt(-2.0 * math.log1p(-share)), floor)
    with np.errstate(over="ignore"):
        squares = np.cumsum(ordered * ordered)
    for _ in range(_ROUNDS):
        count = int(ordered.searchsorted(_KEEP * sigma))
        if count == 0:
            break
        before = sigma
        sigma = max(math.sqrt(0.5 * float(squares[count - 1]) / count / _CORRECTION), floor)
        if abs(sigma - before) < 1e-4 * before:
            break
    return sigma


def _quantile_of_sorted(ordered: FloatArray, share: float) -> float:
    """Return `numpy.quantile` of values (n,) in order, linear between neighbours, without its cost a call."""
    place = share * (ordered.size - 1)
    below = min(int(place), max(ordered.size - 2, 0))
    lower, upper = float(ordered[below]), float(ordered[min(below + 1, ordered.size - 1)])
    return lower + (place - below) * (upper - lower)


_GRID = np.linspace(0.0, CUT, 2001)
_DENSITY = _GRID * np.exp(-0.5 * _GRID**2) * (_GRID[1] - _GRID[0])
_INLIER_WEIGHT = tukey_weights(_GRID, sigma=1.0)
_EXPECTED_CURVATURE = float(np.sum(_DENSITY * (_INLIER_WEIGHT - 2.0 * (_GRID / CUT) ** 2 * (1.0 - (_GRID / CUT) ** 2))))
_EXPECTED_SQUARE = float(np.sum(_DENSITY * 0.5 * (_GRID * _INLIER_WEIGHT) ** 2))
INFORMATION_PER_WEIGHT = _EXPECTED_CURVATURE**2 / _EXPECTED_SQUARE / float(np.sum(_DENSITY * _INLIER_WEIGHT))
"""Information (in 1/σ²) that a unit of weight carries for round Gaussian sightings: E[ψ']² / E[ψ²] / E[w]."""
