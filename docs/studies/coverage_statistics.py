"""What the studies of coverage share: squared distances in stated 1-sigma, and intervals over lenses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

CHI_SQUARE_95 = 5.991
"""The 95 % quantile of chi-square with two degrees of freedom."""
_DRAWS = 2000


def squared_sigmas(error: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return e' S⁻¹ e, (n,), of errors (n, 2), px, with the covariances (n, 2, 2) stated for them, px²."""
    return np.asarray(np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0]))


def bootstrap_interval(values: FloatArray) -> tuple[float, float]:
    """Return the 95 % interval of the mean of values (lenses,), by drawing lenses again."""
    picks = np.random.default_rng(1).integers(0, values.size, (_DRAWS, values.size))
    low, high = np.quantile(values[picks].mean(axis=1), [0.025, 0.975])
    return float(low), float(high)
