"""Cross-validation: RMSE of days left out, and the RMSE expected from the stated uncertainty."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sunarc.calibration.fit.field_posterior import prediction_variance
from sunarc.calibration.fit.marginal_likelihood import marginal_fit, summed
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
    fold_of_bin = np.zeros(system.rows.shape[0], dtype=np.int64)
    fold_of_bin[system.member] = fold  # bins are of one day
    sums = [system.normal_of(fold_of_bin == one) for one in range(int(fold_of_day[-1]) + 1)]
    found, expected, count = 0.0, 0.0, 0
    for one_fold in range(len(sums)):
        in_fold = fold == one_fold
        if np.setdiff1d(usable.epoch[in_fold], usable.epoch[~in_fold]).size:
            continue  # a pose that no other day has cannot be predicted
        normal = summed([part for number, part in enumerate(sums) if number != one_fold])
        without = marginal_fit(normal, fit.grid.basis, fit.scales)
        counted = in_fold & (fit.weight > 0.0)
        bins = np.flatnonzero(fold_of_bin == one_fold)
        rows, basis_values, bin_of = system.rows[bins], system.basis_values[bins], system.member[counted]
        bin_of = np.searchsorted(bins, bin_of)
        predicted = rows @ (without.unknowns - system.at)
        if fit.field_mean is not None:
            predicted = predicted + basis_values @ without.coefficients.T
        prediction_error = fit.residual[counted] - predicted[bin_of]
        found += float(np.sum(prediction_error**2))
        # two axes
        noise = 2.0 * (fit.noise_px * usable.sigma_px)[counted] ** 2
        variance = prediction_variance(
            without,
            fit.scales,
            fit.grid.basis,
            rows=rows,
            basis_values=basis_values,
            normal=None if fit.field_mean is None else normal,
        )
        expected += float(np.sum(variance[bin_of] + noise))
        count += int(counted.sum())
    return HeldOut(math.sqrt(found / count), math.sqrt(expected / count)) if count else None
