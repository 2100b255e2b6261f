"""Cross-validation: RMSE of days left out, and the RMSE expected from the stated uncertainty."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.fit.marginal_likelihood import MarginalFit, marginal_fit
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
    for left_out in np.unique(fold):
        mine = fold == left_out
        if np.setdiff1d(usable.epoch[mine], usable.epoch[~mine]).size:
            continue  # a pose that no other day has cannot be predicted
        inside = np.bincount(system.member[mine], minlength=system.rows.shape[0]) == 0
        without = marginal_fit(system.normal_of(inside), fit.grid.basis, fit.scales)
        counted = mine & (fit.weight > 0.0)
        place = system.member[counted]
        left_out_residual = fit.residual[counted] - (system.rows @ (without.unknowns - system.at))[place]
        found += float(np.sum(left_out_residual**2))
        # two axes
        noise = 2.0 * (fit.sigma_px * usable.sigma_px[counted]) ** 2
        expected += float(np.sum(_variance(fit, without)[place] + noise))
        count += int(counted.sum())
    return HeldOut(math.sqrt(found / count), math.sqrt(expected / count)) if count else None


def _variance(fit: RobustFit, without: MarginalFit) -> FloatArray:
    """Return (bins,): trace of the covariance of the prediction by a fit without some days, px²."""
    rows, waves = fit.system.rows, fit.system.waves
    own = np.einsum("nap,pq,naq->n", rows, without.covariance, rows, optimize=True)
    mixed = np.einsum("nap,apm,nm->n", rows, without.cross, waves, optimize=True)
    return np.asarray(np.maximum(own + 2.0 * mixed + 2.0 * fit.scales.amplitude_px**2, 0.0))
