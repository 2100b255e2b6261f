"""Cross-validation: RMSE of days left out, and the RMSE expected from the stated uncertainty."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.fit.field_posterior import seen_field
from sunarc.calibration.fit.marginal_likelihood import MarginalFit, NormalEquations, marginal_fit
from sunarc.calibration.fit.robust_fit import RobustFit
from sunarc.calibration.model.residual_field import Field
from sunarc.calibration.model.sightings import FilteredSightings

_FOLDS = 5


class HeldOut(NamedTuple):
    """Root mean square distance on days left out in turn, px: as found, and as the fits without them expect it."""

    rmse_px: float
    expected_px: float


def held_out(fit: RobustFit, usable: FilteredSightings) -> HeldOut | None:
    """Return the cross-validation over whole days; None with fewer than two days a pose.

    Each fold is solved by one linear step from the whole fit, with the same scales and weights.
    """
    days = np.unique(usable.day)
    if days.size < 2:
        return None
    fold_of_day = np.arange(days.size) * min(_FOLDS, days.size) // days.size
    fold = fold_of_day[np.searchsorted(days, usable.day)]
    system = fit.system
    found, expected, count = 0.0, 0.0, 0
    for one_fold in np.unique(fold):
        in_fold = fold == one_fold
        if np.setdiff1d(usable.epoch[in_fold], usable.epoch[~in_fold]).size:
            continue  # a pose that no other day has cannot be predicted
        inside = np.bincount(system.member[in_fold], minlength=system.rows.shape[0]) == 0
        normal = system.normal_of(inside)
        without = marginal_fit(normal, fit.grid.basis, fit.scales)
        counted = in_fold & (fit.weight > 0.0)
        bin_of = system.member[counted]
        predicted = system.rows @ (without.unknowns - system.at)
        if fit.field_mean is not None:
            predicted = predicted + system.basis_values @ without.coefficients.T
        prediction_error = fit.residual[counted] - predicted[bin_of]
        found += float(np.sum(prediction_error**2))
        # two axes
        noise = 2.0 * (fit.noise_px * usable.sigma_px)[counted] ** 2
        expected += float(np.sum(_variance(fit, without, normal)[bin_of] + noise))
        count += int(counted.sum())
    return HeldOut(math.sqrt(found / count), math.sqrt(expected / count)) if count else None


def _variance(fit: RobustFit, without: MarginalFit, normal: NormalEquations) -> FloatArray:
    """Return (bins,): trace of the covariance of the prediction by a fit without some days, px²."""
    rows = fit.system.rows
    field = Field(
        amplitude_px=fit.scales.amplitude_px, length_px=fit.scales.length_px, basis=fit.grid.basis, cross=without.cross
    )
    if fit.field_mean is not None:
        field = seen_field(field, normal, without.covariance)
    by_parameters = np.einsum("nap,pq,naq->n", rows, without.covariance, rows, optimize=True)
    by_field = np.trace(field.covariance(rows, fit.system.basis_values), axis1=-2, axis2=-1)
    return np.asarray(np.maximum(by_parameters + by_field, 0.0))
