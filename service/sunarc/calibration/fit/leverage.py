"""How much of the noise of each star the fit has taken up: beside a field the residuals of 150 stars are too small."""

from __future__ import annotations

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.fit.field_posterior import prediction_variance
from sunarc.calibration.fit.marginal_likelihood import MarginalFit, NormalEquations, Scales
from sunarc.calibration.fit.normal_equations import LinearSystem

_LARGEST = 0.8
"""Of a star that stands alone; beyond it the residual says nothing of the noise."""


def night_leverage(system: LinearSystem, normal: NormalEquations, fit: MarginalFit, scales: Scales) -> FloatArray:
    """Return (n,): the share of its noise's variance that the fit has taken up, of each sighting of a night; else 0.

    The variance of a residual is that of the noise less that of the prediction, with the sighting among its data.

    Parameters
    ----------
    system, normal : the bins' equations, with systematic errors, and their sums.
    fit : the fit under the scales.
    """
    night = np.any(system.observed.systematic_px != 0.0, axis=(1, 2))
    variance = prediction_variance(
        fit, scales, system.basis, rows=system.rows[night], basis_values=system.basis_values[night], normal=normal
    )
    leverage = np.zeros(night.size)
    # the trace is of two axes
    leverage[night] = np.clip(0.5 * variance * system.observed.information[night], 0.0, _LARGEST)
    return np.asarray(leverage[system.member])
