"""Cross-validation: RMSE of days left out, and the RMSE expected from the stated uncertainty."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sunarc.calibration.fit.field_posterior import prediction_variance
from sunarc.calibration.fit.marginal_likelihood import marginal_fit
from sunarc.calibration.fit.robust_fit import RobustFit
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
        variance = prediction_variance(
            without,
            fit.scales,
            fit.grid.basis,
            rows=system.rows,
            basis_values=system.basis_values,
            normal=None if fit.field_mean is None else normal,
        )
        expected += float(np.sum(variance[bin_of] + noise))
        count += int(counted.sum())
    return HeldOut(math.sqrt(found / count), math.sqrt(expected / count)) if count else None
