"""Whether the sightings of the night contradict those of the day: a fit of both would then be worse than the day's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sunarc.calibration.fit.field_posterior import prediction_variance
from sunarc.calibration.fit.hyperparameter_marginalisation import sky_rows
from sunarc.calibration.fit.marginal_likelihood import MarginalFit, field_at, marginal_fit
from sunarc.calibration.fit.robust_fit import RobustFit
from sunarc.calibration.fit.systematic_errors import N_OFFSET
from sunarc.calibration.model.sightings import FilteredSightings
from sunarc.calibration.robust_loss import robust_sigma
from sunarc.findings import Finding

_PRIOR_SIGMAS = 4.5
"""Length of three systematic errors in units of their priors, beyond which they are no such errors: 1 in 7,000."""
_SKY_SIGMAS = 3.0
"""Change over the sky (root mean square) in units of what the day's sightings state of themselves."""
_MOST_REJECTED = 0.3
"""Share of the night's sightings without any weight; clouds and twinkling make a few per cent."""
_SUN_SCATTER = 1.15
"""Scatter of the sun's track beside the fit of both over that beside its own fit."""


def contradiction(fit: RobustFit, usable: FilteredSightings) -> Finding | None:
    """Return what of the night contradicts the day, with value and limit; None where nothing does."""
    night = usable.night
    if fit.problem.n_systematic == 0:
        return None
    turn, offset = np.split(fit.unknowns[fit.problem.systematic_slice], [N_OFFSET])[::-1]
    alone = _of_the_day(fit, night)
    measured = (
        ("pose_difference", float(np.linalg.norm(turn)), _PRIOR_SIGMAS),
        ("star_offset", float(np.linalg.norm(offset)), _PRIOR_SIGMAS),
        ("rejected", float(np.mean(fit.weight[night] == 0.0)), _MOST_REJECTED),
        ("sun_scatter", _sun_scatter(fit, alone, usable), _SUN_SCATTER),
        ("sky", _change_over_the_sky(fit, alone), _SKY_SIGMAS),
    )

    for cause, value, limit in measured:
        if not value <= limit:
            return Finding(
                "night_contradicts_day", {"n": int(night.sum()), "cause": cause, "value": value, "limit": limit}
            )
    return None


def without_night(usable: FilteredSightings, finding: Finding) -> FilteredSightings:
    """Return the sightings of the day, with the finding that says why the others were left out."""
    day = usable.select(~usable.night)
    return replace(day, sigma_px=day.sigma_px / np.median(day.sigma_px), dropped=(*day.dropped, finding))


def _of_the_day(fit: RobustFit, night: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> MarginalFit:
    """Return the fit of the day's sightings alone: one linear step from the fit of both, with the same scales."""
    system = fit.system
    of_night = np.bincount(system.member[night], minlength=system.rows.shape[0]) > 0
    return marginal_fit(system.normal_of(~of_night), fit.grid.basis, fit.scales)


def _sun_scatter(fit: RobustFit, alone: MarginalFit, usable: FilteredSightings) -> float:
    """Return the scatter of the track beside the fit of both over that beside the day's own."""
    system, track = fit.system, ~usable.alone
    if not np.any(track):
        return 0.0
    step = system.rows @ (alone.unknowns - system.at)
    both = field_at(system.normal(), fit.grid.basis, fit.scales)
    smooth = [system.basis_values @ coefficients.T for coefficients in (both, alone.coefficients)]
    residuals = [fit.residual - smooth[0][system.member], fit.residual - (step + smooth[1])[system.member]]
    scatter = [
        robust_sigma(np.linalg.norm(residual[track], axis=-1) / usable.sigma_px[track], floor=1e-9)
        for residual in residuals
    ]
    return scatter[0] / scatter[1]


def _change_over_the_sky(fit: RobustFit, alone: MarginalFit) -> float:
    """Return how far the two fits are apart over the sky, in units of what the day's states."""
    rows, basis_values = sky_rows(fit.problem, fit.unknowns, fit.grid.basis)
    change = rows @ (alone.unknowns - fit.system.at)
    stated = prediction_variance(alone, fit.scales, fit.grid.basis, rows=rows, basis_values=basis_values)
    return float(np.sqrt(np.sum(change**2) / np.sum(np.maximum(stated, 1e-12))))
