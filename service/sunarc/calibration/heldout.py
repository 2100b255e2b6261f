"""How well a fit foretells days that it did not see."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sunarc.calibration.evidence import marginal_fit
from sunarc.calibration.points import Usable
from sunarc.calibration.robust import RobustFit

FloatArray = NDArray[np.float64]

_FOLDS = 5


def held_out_rmse(fit: RobustFit, usable: Usable) -> float | None:
    """Return the root mean square distance on days left out in turn, px; None with fewer than two days a pose.

    Each fold is solved by one linear step from the whole fit, with the same scales and weights.
    """
    days = np.unique(usable.day)
    if days.size < 2:
        return None
    fold_of_day = np.arange(days.size) * min(_FOLDS, days.size) // days.size
    fold = fold_of_day[np.searchsorted(days, usable.day)]
    system = fit.system
    total, count = 0.0, 0
    for left_out in np.unique(fold):
        mine = fold == left_out
        if np.setdiff1d(usable.epoch[mine], usable.epoch[~mine]).size:
            continue  # a pose that no other day shows cannot be foretold
        inside = np.bincount(system.member[mine], minlength=system.rows.shape[0]) == 0
        change = marginal_fit(system.normal_of(inside), fit.grid.basis, fit.scales).unknowns - system.at
        counted = mine & (fit.weight > 0.0)
        foretold = fit.residual[counted] - (system.rows @ change)[system.member[counted]]
        total += float(np.sum(foretold**2))
        count += int(counted.sum())
    return float(np.sqrt(total / count)) if count else None
