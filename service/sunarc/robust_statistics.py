"""Scales and weights that a few gross errors do not move."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sunarc.array_types import FloatArray

MAD_TO_SIGMA = 1.4826
"""1-sigma of a normal distribution over its median absolute deviation, 1 / Φ⁻¹(3/4)."""


def median_of(values: FloatArray) -> float:
    """Return the median of a flat array, without numpy's cost a call."""
    half = values.size // 2
    if values.size % 2:
        return float(np.partition(values, half)[half])
    parted = np.partition(values, (half - 1, half))
    return 0.5 * float(parted[half - 1] + parted[half])


def mad_sigma(residuals: FloatArray) -> float:
    """Return the 1-sigma of residuals about 0, (...), by their median absolute value."""
    return MAD_TO_SIGMA * median_of(np.abs(residuals).ravel())


def cauchy_weights(distance: FloatArray, *, scale: float | FloatArray) -> FloatArray:
    """Return the weights 1 / (1 + (d / scale)²) of least squares for Cauchy's loss."""
    return np.asarray(1.0 / (1.0 + (distance / scale) ** 2))


def biweights(ratio: ArrayLike) -> FloatArray:
    """Return Tukey's biweights (1 - r²)² of distances in units of the cut, 0 beyond it."""
    return np.asarray(np.maximum(1.0 - np.square(ratio), 0.0) ** 2)
