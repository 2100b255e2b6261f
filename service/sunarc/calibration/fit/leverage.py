"""How much of the noise of each star the fit has taken up: beside a field the residuals of 150 stars are too small."""

from __future__ import annotations

import numpy as np

from sunarc.array_types import BoolArray, FloatArray
from sunarc.calibration.fit.field_posterior import prediction_variance
from sunarc.calibration.fit.marginal_likelihood import MarginalFit, NormalEquations, Scales
from sunarc.calibration.fit.normal_equations import LinearSystem

_LARGEST = 0.8
"""Of a star that stands alone; beyond it the residual says nothing of the noise."""


def leverage_of(
    system: LinearSystem, normal: NormalEquations, fit: MarginalFit, scales: Scales, *, which: BoolArray
) -> FloatArray:
    """Return (n,): the share of its noise's variance that the fit has taken up, of the sightings of some bins; else 0.

    The variance of a residual is that of the noise less that of the prediction, with the sighting among its data.

    Parameters
    ----------
    system, normal : the bins' equations, with systematic errors, and their sums.
    fit : the fit under the scales.
    which : (b,) bins.
    """
    variance = prediction_variance(
        fit, scales, system.basis, rows=system.rows[which], basis_values=system.basis_values[which], normal=normal
    )
    leverage = np.zeros(which.size)
    # the trace is of two axes
    leverage[which] = np.clip(0.5 * variance * system.observed.information[which], 0.0, _LARGEST)
    return np.asarray(leverage[system.member])
