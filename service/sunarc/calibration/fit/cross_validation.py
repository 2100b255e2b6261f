"""Whether parts of the sightings agree with the rest: days left out, thinned sets, the night against the day."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from sunarc.array_types import BoolArray, FloatArray, IntArray
from sunarc.calibration.fit.marginal_likelihood import MarginalFit, field_at, marginal_fit, summed
from sunarc.calibration.fit.posterior import PosteriorCovariance, joint_covariance, prediction_variance, sky_rows
from sunarc.calibration.fit.robust_fit import RobustFit, stated_posterior
from sunarc.calibration.fit.robust_rounds import robust_camera
from sunarc.calibration.model.residual_field import WaveBasis
from sunarc.calibration.model.sightings import Kind, Sightings
from sunarc.calibration.noise import NoiseGroups
from sunarc.calibration.robust_loss import robust_sigma
from sunarc.calibration.solve.problem import FitProblem
from sunarc.findings import Finding

_FOLDS = 5


_THIRDS = 3
_FURTHEST = 7.0
"""Distance of a bin of sightings from its prediction, in stated sigmas, that is no chance."""
_CHANCE = 1e-4
_NOISE_KNOWN = 1.1
"""By how much the noise of the parts may be larger than that of all, as a variance."""
_FEWEST_THINNED = 40
"""Sightings of a thinned set, at least: the scales of a smaller one are a matter of chance."""
_OTHER_SIGMA = 4.0
"""Ratio of the sigmas of a thinned set and of all from which on it is no chance. The three limits are chosen by
docs/studies/held_out.py: beyond them lie 3 in 100 of the fits that are right."""


class HeldOut(NamedTuple):
    """Root mean square distance on days left out in turn, px: as found, and as the fits without them expect it."""

    rmse_px: float
    expected_px: float


def held_out(fit: RobustFit, usable: Sightings) -> HeldOut | None:
    """Return the cross-validation over whole days; None with fewer than two days a pose.

    Each fold is solved by one linear step from the whole fit, with the same scales and weights.
    """
    fold = _folds_of_days(usable)
    if fold is None:
        return None
    system = fit.system
    fold_of_bin = np.zeros(system.rows.shape[0], dtype=np.int64)
    fold_of_bin[system.member] = fold  # bins are of one day
    sums = [system.normal_of(fold_of_bin == one) for one in range(int(fold.max()) + 1)]
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


def _folds_of_days(usable: Sightings) -> IntArray | None:
    """Return (n,): the part of each sighting where whole days are left out, five parts at most; None with one day."""
    days = np.unique(usable.day)
    if days.size < 2:
        return None
    return np.asarray((np.arange(days.size) * min(_FOLDS, days.size) // days.size)[np.searchsorted(days, usable.day)])


class Doubts(NamedTuple):
    """What parts of the sightings say of the fit of all.

    n, rmse_px, stated_px : sightings of the part that was predicted worst, by what root mean square distance they were
        missed, and by what the fit without them states.
    excess : errors of all parts over what chance allows.
    widening : by how much a thinned set's sigma over the sky is larger than this fit's, 1 or more.
    """

    n: int
    rmse_px: float
    stated_px: float
    excess: float
    widening: float


class _Part(NamedTuple):
    """How a part was predicted: see `Doubts`; bins, chi-square of all errors together, the furthest bin in sigmas."""

    n: int
    rmse_px: float
    stated_px: float
    bins: int
    together: float
    furthest: float


class _Partial(NamedTuple):
    """A fit of some of the sightings: its unknowns and the field's mean (2, m) or None, and how far it may be off."""

    problem: FitProblem
    unknowns: FloatArray
    mean: FloatArray | None
    posterior: PosteriorCovariance

    def sky_px(self, basis: WaveBasis) -> float:
        """Return the stated error over the sky, root mean square distance, px; NaN where the image shows none."""
        rows, values = sky_rows(self.problem, self.unknowns, basis)
        if rows.shape[0] == 0:
            return math.nan
        by_unknowns = np.einsum("nap,pq,naq->n", rows, self.posterior.covariance, rows, optimize=True)
        by_field = np.trace(self.posterior.field.covariance(rows, values), axis1=1, axis2=2)
        return math.sqrt(float(np.mean(np.maximum(by_unknowns + by_field, 0.0))))


def doubts(fit: RobustFit, usable: Sightings) -> Doubts:
    """Return how well fits without a part of the sightings predict it, and what a thinned set states.

    Parts are thirds of a day, or of several days whole ones, in five groups at most. Each is fitted anew without, from
    the fit of all: other scales, another noise. The errors of the predictions are looked at together, by the whole
    covariance of each part, and one by one.
    """
    groups = NoiseGroups.of(usable)
    # the sun's track is judged: whether stars agree with it is a question of its own (`night_check`)
    judged = (usable.kind == Kind.SUN) & (fit.weight > 0.0)
    parts = [
        _met(_refitted(fit, usable, ~out), fit, groups, out & judged)
        for out in _left_out(usable)
        # a pose that no other day has cannot be predicted
        if not np.setdiff1d(usable.epoch[out], usable.epoch[~out]).size and np.any(out & judged)
    ]
    widening = _widening(fit, usable)
    if not parts:
        return Doubts(0, 0.0, 0.0, 0.0, widening)
    worst = max(parts, key=lambda part: part.furthest)
    allowed = _NOISE_KNOWN * float(chdtri(2 * sum(part.bins for part in parts), _CHANCE))
    excess = max(worst.furthest / _FURTHEST, math.sqrt(sum(part.together for part in parts) / allowed))
    return Doubts(worst.n, worst.rmse_px, worst.stated_px, excess, widening)


def _left_out(usable: Sightings) -> list[BoolArray]:
    """Return masks (n,) of what is left out in turn: of several days, days; of one, thirds of each pose's sightings."""
    fold = _folds_of_days(usable)
    if fold is None:
        fold = np.concatenate([np.arange(n) * _THIRDS // max(n, 1) for n in np.bincount(usable.epoch)])
    return [fold == one for one in range(int(fold.max(initial=-1)) + 1)]


def _refitted(fit: RobustFit, usable: Sightings, kept: BoolArray) -> _Partial:
    """Return the fit of the sightings that a mask picks, from the fit of all."""
    groups, observed = NoiseGroups.of(usable.select(kept)), fit.observed.select(kept)
    problem = fit.problem
    start = fit.unknowns[: problem.size - problem.n_unit]
    found = robust_camera(problem, observed, start, groups=groups, grid=fit.grid, near_minimum=True)
    unknowns = found.unknowns
    system = found.system(observed, groups.bins)
    mean = found.field_mean(system.normal())
    posterior = stated_posterior(problem, system, unknowns, grid=found.grid, scales=found.state.scales, mean=mean)
    return _Partial(problem, unknowns, mean, posterior)


def _met(partial: _Partial, fit: RobustFit, groups: NoiseGroups, out: BoolArray) -> _Part:
    """Return how a fit predicts the sightings that a mask picks, in bins with the noise that the fit of all has."""
    problem, unknowns, mean, posterior = partial
    observed, bins = fit.observed.select(out), groups.bins.select(out)
    seen, off = bins.gathered(observed, problem.residuals(unknowns, observed), fit.information[out])
    off, seen = off[seen.information > 0.0], seen.select(seen.information > 0.0)
    minus, rows = problem.linearised(unknowns, seen)
    values = fit.grid.basis.values(seen.pixels - minus)
    if mean is not None:
        off = off - values @ mean.T
    n = len(seen)
    stated = joint_covariance(posterior.covariance, posterior.field, rows, values)
    stated += np.diag(np.repeat(1.0 / seen.information, 2))
    each = np.einsum("iaib->iab", stated.reshape(n, 2, n, 2))
    return _Part(
        n=int(np.count_nonzero(fit.weight[out] > 0.0)),
        rmse_px=math.sqrt(float(np.sum(off**2)) / n),
        stated_px=math.sqrt(float(np.trace(stated)) / n),
        bins=n,
        together=float(off.ravel() @ np.linalg.solve(stated, off.ravel())),
        furthest=math.sqrt(float(np.max(np.sum(off * np.linalg.solve(each, off[..., None])[..., 0], axis=-1)))),
    )


def _widening(fit: RobustFit, usable: Sightings) -> float:
    """Return the sigma over the sky of every second sighting, brought to the count of all, over that of all; or 1."""
    kept = np.arange(len(usable)) % 2 == 0
    if np.count_nonzero(fit.weight[kept]) < _FEWEST_THINNED:
        return 1.0
    # by the noise that the fit of all states: of every second sighting neighbours correlate by the square
    square = ((fit.inflation - 1.0) / (fit.inflation + 1.0))[kept] ** 2
    count = float(np.sum(fit.weight[kept] * (1.0 - square) / (1.0 + square)))
    whole = _Partial(fit.problem, fit.unknowns, fit.field_mean, fit.posterior).sky_px(fit.grid.basis)
    ratio = _refitted(fit, usable, kept).sky_px(fit.grid.basis) / whole
    ratio *= math.sqrt(count / float(np.sum(fit.weight / fit.inflation)))
    return ratio if ratio > _OTHER_SIGMA else 1.0


# Whether the sightings of the night contradict those of the day: a fit of both would then be worse than the day's.

_PRIOR_SIGMAS = 4.5
"""Length of three systematic errors in units of their priors, beyond which they are no such errors: 1 in 7,000."""
_SKY_SIGMAS = 3.0
"""Change over the sky (root mean square) in units of what the day's sightings state of themselves."""
_MOST_REJECTED = 0.3
"""Share of the night's sightings without any weight; clouds and twinkling make a few per cent."""
_SUN_SCATTER = 1.15
"""Scatter of the sun's track beside the fit of both over that beside its own fit."""


def contradiction(fit: RobustFit, usable: Sightings) -> Finding | None:
    """Return what of the night contradicts the day, with value and limit; None where nothing does."""
    night = usable.night
    if not fit.problem.has("night_pose"):
        return None
    turn, offset = (fit.unknowns[fit.problem.block_slice(name)] for name in ("night_pose", "night_offset"))
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


def without_night(usable: Sightings, finding: Finding) -> Sightings:
    """Return the sightings of the day, with the finding that says why the others were left out."""
    day = usable.select(~usable.night)
    filtering = day.filtering._replace(dropped=(*day.filtering.dropped, finding))
    return replace(day, sigma_px=day.sigma_px / np.median(day.sigma_px), filtering=filtering)


def _of_the_day(fit: RobustFit, night: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> MarginalFit:
    """Return the fit of the day's sightings alone: one linear step from the fit of both, with the same scales."""
    system = fit.system
    of_night = np.bincount(system.member[night], minlength=system.rows.shape[0]) > 0
    return marginal_fit(system.normal_of(~of_night), fit.grid.basis, fit.scales)


def _sun_scatter(fit: RobustFit, alone: MarginalFit, usable: Sightings) -> float:
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
