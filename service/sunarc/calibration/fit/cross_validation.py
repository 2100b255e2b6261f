"""Agreement of parts of the sightings with the rest: days or thirds left out, the night against the day."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np

from sunarc.calibration.answers.covariance import project_with_covariance, seen_sky
from sunarc.calibration.fit.marginal_likelihood import MarginalFit, field_at, inverses, marginal_fit, prior_precision
from sunarc.calibration.fit.posterior import prediction_variance, shown_sky
from sunarc.calibration.fit.robust_fit import FitState, compute_leverage
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Kind, Sightings
from sunarc.common.array_types import BoolArray, FloatArray, even_parts
from sunarc.common.findings import Finding
from sunarc.common.robust_statistics import robust_sigma
from sunarc.optics.forward import project
from sunarc.optics.pose import right_jacobian

_FOLDS = 5
_THIRDS = 3
_CHANCE = 1e-4
"""Of the chi-square of all errors together."""
_HALVINGS = 52
"""Bits of a double: halvings of an interval that end at its rounding."""
_FURTHEST = 5.0
"""A single error, in stated sigmas, that is no chance."""
_TURNED = 25.0
"""Chi-square of the three turns of one part's camera that is no chance."""
_OPEN = 2.0
"""Variance of a predicted number, in that of the part's noise, beyond which the other parts leave much of it open."""
_CONTRADICTED = 0.9
"""Ratio of errors to those of chance from which a part that is missed by no more than is stated is widened for."""
_RADIUS_95 = 2.4477
"""Of a round Gaussian in the plane, 1-sigmas."""
_SWAYS_DEG = 0.05
"""Turn of a part's camera up to which it is allowed for by the uncertainty."""
_TURN_95 = 7.815
"""Chi-square of three numbers that 95 % stay below."""
_AS_STATED = 4.0
"""A few errors say little of their size: as if so many more were as stated."""
_MATTERS = 0.1
"""Variance of a coefficient of the field, in that of the noise, below which the field does not matter there."""
_ROUNDING = 1e-10
_POSE_PRECISION = 1e-2
"""1 / 10² rad², about the fit's own pose: where one sighting of the other parts shows a pose, the turn about it is open
all the same, and with less precision rounding takes the digits of all else."""


class _PartLeftOut(NamedTuple):
    """The fit without a part of the sightings: one linear step from the fit of all, with its scales and weights.

    out (n,), bins (b,): masks of what it is without. step (d,), covariance (d, d): of the unknowns and of what of the
    field's coefficients, in units of their prior's 1-sigma, the sightings tell. rows (b', 2, d), px: of the bins.
    """

    out: BoolArray
    bins: BoolArray
    step: FloatArray
    covariance: FloatArray
    rows: FloatArray


def without_parts(fit: FitState, usable: Sightings) -> list[_PartLeftOut]:
    """Return the fits that leave out each part of the sightings; a part with the only sightings of a pose is skipped.

    Parts are thirds of a day, or of several days whole ones, in five groups at most.
    """
    part = even_parts(usable.day, most=_FOLDS)
    if not np.any(part):  # of one day
        part = np.concatenate([even_parts(np.arange(n), most=_THIRDS) for n in np.bincount(usable.epoch)])
    system, scales, size = fit.system, fit.scales, fit.system.at.size
    part_of_bin = np.zeros(system.rows.shape[0], dtype=np.int64)
    part_of_bin[fit.member] = part  # bins are of one day; one of two thirds goes to the later one
    axes = system.basis_products.axes(system.basis, scales.length_px)
    matters = scales.amplitude_px**2 * axes.information > _MATTERS
    waves = scales.amplitude_px * (system.basis_values @ axes.transform[:, matters])
    rows = np.concatenate([system.rows, np.einsum("bw,ac->bacw", waves, np.eye(2)).reshape(len(waves), 2, -1)], axis=-1)
    prior = prior_precision(size, scales.radial_px, scales.decentering_px, n_unit=system.n_unit)
    precision = np.concatenate([prior, np.ones(rows.shape[-1] - size)])
    at = np.concatenate([system.at, np.zeros(rows.shape[-1] - size)])
    poses = slice(fit.problem.pose_slice(0).start, fit.problem.pose_slice(fit.problem.n_epochs - 1).stop)
    precision[poses], at[poses] = _POSE_PRECISION, 0.0  # about the fit's

    def sums(bins: BoolArray) -> tuple[FloatArray, FloatArray]:
        weighed = (rows[bins] * system.observed.information[bins, None, None]).reshape(-1, at.size)
        return weighed.T @ rows[bins].reshape(-1, at.size), weighed.T @ system.residual[bins].ravel()

    parts = [(part == one, part_of_bin == one) for one in range(int(part.max(initial=-1)) + 1)]
    of_parts = [sums(bins) for _, bins in parts]
    found = []
    for number, (out, bins) in enumerate(parts):
        if not np.setdiff1d(usable.epoch[out], usable.epoch[~out]).size:
            # added up, for a sum of all less the part's has no digits of a pose that few others show
            own, pull = (sum(column) for column in zip(*of_parts[:number], *of_parts[number + 1 :], strict=True))
            covariance = inverses(own + np.diag(precision))
            step = covariance @ (pull - precision * at)
            found.append(_PartLeftOut(out, bins, step, covariance, rows[bins]))
    return found


class HeldOut(NamedTuple):
    """Root mean square error on days left out in turn, px: as found, and as expected."""

    rmse_px: float
    expected_px: float


def held_out(fit: FitState, usable: Sightings, parts: Sequence[_PartLeftOut]) -> HeldOut | None:
    """Return the cross-validation over whole days, see `without_parts`; None with fewer than two that say something."""
    if np.unique(usable.day).size < 2:
        return None
    found, expected, count, size = 0.0, 0.0, 0, fit.system.at.size
    for without in parts:
        rows, covariance, step = without.rows, without.covariance, without.step
        variance = np.einsum("nap,pq,naq->n", rows, covariance, rows, optimize=True)
        if fit.field_mean is None:  # the prediction is the camera's, and the whole field is unknown
            variance = np.einsum("nap,pq,naq->n", rows, covariance[:, :size], rows[..., :size], optimize=True)
            variance += np.einsum("nap,pq,naq->n", rows[..., :size], covariance[:size, size:], rows[..., size:])
            variance += 2.0 * fit.scales.amplitude_px**2
            rows, step = rows[..., :size], step[:size]
        counted = np.flatnonzero(without.out & (fit.noise.weight > 0.0))
        bin_of = np.searchsorted(np.flatnonzero(without.bins), fit.member[counted])
        # the other days leave it open by more than the image: a minute of the next morning says nothing of a day
        is_known = variance[bin_of] < max(fit.problem.template.width, fit.problem.template.height) ** 2
        counted, bin_of = counted[is_known], bin_of[is_known]
        found += float(np.sum((fit.residual[counted] - (rows @ step)[bin_of]) ** 2))
        # two axes
        noise = 2.0 * (fit.noise.scale * usable.sigma_px)[counted] ** 2
        # of a camera that is far off, the part's share of the normal equations may not be separable from the whole
        expected += float(np.sum(np.maximum(variance, 0.0)[bin_of] + noise))
        count += counted.size
    return HeldOut(math.sqrt(found / count), math.sqrt(expected / count)) if count else None


class Doubts(NamedTuple):
    """Result of comparing parts of the sightings with the fits that leave them out.

    n, rmse_px, stated_px : sightings of the part that was predicted worst, by what root mean square distance they were
        missed, and by what the fit without them states.
    excess : errors over what chance allows, of the parts that are missed by more than is stated or turned; 0 where none
        is.
    widening : by how much larger than stated the errors are where the other parts leave much open, or where a part that
        is missed by less than is stated has errors beyond chance, 1 or more.
    turned, turn_deg : chi-square of the turn by which the camera of one part would differ from that of the others, and
        its size: of the part that is turned most surely.
    """

    n: int
    rmse_px: float
    stated_px: float
    excess: float
    widening: float
    turned: float
    turn_deg: float


class _PartPrediction(NamedTuple):
    """Prediction of a part of the sightings by the others: see `Doubts`.

    errors : (k,) independent ones, by what is stated; open: (k,) whether the other parts leave much of a number open.
    """

    n: int
    rmse_px: float
    stated_px: float
    errors: FloatArray
    open: BoolArray
    turned: float
    turn_deg: float

    @property
    def contradicts(self) -> bool:
        """Return whether the part deviates by more than is stated, or is turned by more than mounts sway."""
        return self.rmse_px > self.stated_px or (self.turned > _TURNED and self.turn_deg > _SWAYS_DEG)


def doubts(fit: FitState, usable: Sightings, without: Sequence[_PartLeftOut]) -> Doubts:
    """Return how well fits without a part of the sightings predict that part, see `without_parts`.

    All that a part shows of lens, pose and field are few numbers; where the stated errors hold, their errors are
    independent and of unit variance.
    """
    # the sun's track is judged: whether stars agree with it is a question of its own (`night_check`)
    judged = (usable.kind == Kind.SUN) & (fit.noise.weight > 0.0)
    met = (_predict_part(one, fit, usable, judged) for one in without if np.any(one.out & judged))
    parts = [part for part in met if part.errors.size]
    if not parts:
        return Doubts(0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0)
    beyond = [part for part in parts if part.contradicts]
    worst = max(beyond or parts, key=lambda part: float(np.max(np.abs(part.errors))))
    turned = max(beyond or parts, key=lambda part: part.turned)
    widening = _error_ratio_where_undetermined(parts)
    within = [part for part in parts if not part.contradicts]
    if _largest_error_ratio(within) > _CONTRADICTED:
        square = np.concatenate([part.errors for part in within]) ** 2
        of_turn = max(part.turned for part in within) / _TURN_95
        widening = max(widening, math.sqrt(max(float(np.max(square)) / _RADIUS_95**2, float(np.mean(square)), of_turn)))
    return Doubts(
        worst.n, worst.rmse_px, worst.stated_px, _largest_error_ratio(beyond), widening, turned.turned, turned.turn_deg
    )


def _largest_error_ratio(parts: Sequence[_PartPrediction]) -> float:
    """Return the ratio of errors to those of chance, of all parts, the largest one and a turn; 0 without a part."""
    if not parts:
        return 0.0
    square = np.concatenate([part.errors for part in parts]) ** 2
    together = float(np.sum(square)) / chi_square_limit(square.size, _CHANCE)
    turned = max(part.turned for part in parts)
    return math.sqrt(max(float(np.max(square)) / _FURTHEST**2, together, turned / _TURNED))


def _error_ratio_where_undetermined(parts: Sequence[_PartPrediction]) -> float:
    """Return the ratio of errors to stated ones where the other parts determine little, 1 or more."""
    square, opened = np.concatenate([part.errors for part in parts]) ** 2, np.concatenate([part.open for part in parts])
    larger = (float(np.sum(square[opened])) + _AS_STATED) / (np.count_nonzero(opened) + _AS_STATED)
    return math.sqrt(max(larger, 1.0))


@cache
def chi_square_limit(n: int, chance: float) -> float:
    """Return the value that the sum of n squares of standard normals exceeds with a probability.

    It is `scipy.special.chdtri`, to 12 digits, whose library takes longer to load than a fit of one day takes.
    """
    odd = n % 2

    def exceeded(half: float) -> float:
        """Return the probability of a sum above twice `half` (Abramowitz and Stegun 26.4.4 and 26.4.5)."""
        powers = (0.5 * odd + step for step in range(n // 2))
        terms = sum(math.exp(power * math.log(half) - half - math.lgamma(power + 1.0)) for power in powers)
        return terms + (math.erfc(math.sqrt(half)) if odd else 0.0)

    low, high = 0.0, 1.0
    while exceeded(high) > chance:
        low, high = high, 2.0 * high
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if exceeded(middle) > chance else (low, middle)
    return low + high


def _predict_part(without: _PartLeftOut, fit: FitState, usable: Sightings, judged: BoolArray) -> _PartPrediction:
    """Return the prediction of the judged (n,) sightings of a part by the fit without it."""
    sun = np.bincount(fit.member[judged], minlength=without.bins.size)[without.bins] > 0
    rows, information = without.rows[sun], fit.system.observed.information[without.bins][sun]
    off = fit.system.residual[without.bins][sun] - rows @ without.step
    variance = np.maximum(np.einsum("nap,pq,naq->n", rows, without.covariance, rows, optimize=True), 0.0)
    flat = (rows * np.sqrt(information)[:, None, None]).reshape(-1, rows.shape[-1])
    # with B B' the part's information, B' times the unknowns is what it says, with noise of unit variance
    own = flat.T @ flat
    scale = np.sqrt(np.maximum(np.diag(own), np.finfo(np.float64).tiny))
    values, vectors = np.linalg.eigh(own / np.outer(scale, scale))
    known = values > _ROUNDING * values[-1]
    roots, vectors = np.sqrt(values[known]), vectors[:, known]
    factor = scale[:, None] * vectors * roots
    said = vectors.T @ (flat.T @ (off * np.sqrt(information)[:, None]).ravel() / scale) / roots
    joint = factor.T @ without.covariance @ factor + np.eye(said.size)
    stated, axes = np.linalg.eigh(joint)
    poses = np.unique(usable.epoch[without.out & judged]).tolist()
    turned, turn_deg = max(_measure_turn(factor, joint, said, fit, pose) for pose in poses)
    return _PartPrediction(
        n=int(np.count_nonzero(without.out & judged)),
        rmse_px=math.sqrt(float(np.sum(off**2)) / len(off)),
        stated_px=math.sqrt(float(np.mean(variance + 2.0 / information))),
        errors=(axes.T @ said) / np.sqrt(np.maximum(stated, 1.0)),  # below the noise's own is rounding
        open=stated > _OPEN,
        turned=turned,
        turn_deg=turn_deg,
    )


def _measure_turn(
    factor: FloatArray, joint: FloatArray, said: FloatArray, fit: FitState, pose: int
) -> tuple[float, float]:
    """Return the certainty of a rotation of a pose by errors (k,) of covariance (k, k), and the rotation, degrees."""
    columns = factor[fit.problem.pose_slice(pose)]
    weighed = np.linalg.solve(joint, np.column_stack([columns.T, said]))
    pull = columns @ weighed[:, -1]
    vector = np.linalg.lstsq(columns @ weighed[:, :-1], pull)[0]  # one sighting does not determine all three angles
    angle = right_jacobian(fit.problem.camera(fit.unknowns, pose).rotation_cam_enu) @ vector
    return float(pull @ vector), math.degrees(float(np.linalg.norm(angle)))


# Whether the sightings of the night contradict those of the day: a fit of both would then be worse than the day's.

_PRIOR_SIGMAS = 4.5
"""Length of three systematic errors in units of their priors, beyond which they are no such errors: 1 in 7,000."""
_SKY_SIGMAS = 3.0
"""Change over the sky (root mean square) in units of the day's stated error."""
_MOST_REJECTED = 0.3
"""Share of the night's sightings without any weight; clouds and twinkling make a few per cent."""
_OF_EITHER = {"sun_scatter", "sky"}
"""Contradictions that the sun's sightings may cause; a turn, an offset and rejected stars are the night's."""
_AS_STATED_SUNS = 1.0
"""Scatter of the suns about the night's camera over their stated one, up to which they do not contradict it."""
_SUN_SCATTER = 1.15
"""Scatter of the sun's track about the fit of both over that about its own fit."""


def contradiction(fit: FitState, usable: Sightings) -> Finding | None:
    """Return the finding of night sightings that contradict the day's; None without a contradiction."""
    night = usable.night
    if "night_pose" not in fit.problem.names:
        return None
    turn, offset = (fit.unknowns[fit.problem.block_slice(name)] for name in ("night_pose", "night_offset"))
    # the fit of the day's sightings alone: one linear step from the fit of both, with the same scales
    of_day = np.bincount(fit.member[night], minlength=fit.system.rows.shape[0]) == 0
    alone = marginal_fit(fit.system.sum_bins(of_day), fit.grid.basis, fit.scales)
    measured = (
        ("pose_difference", float(np.linalg.norm(turn)), _PRIOR_SIGMAS),
        ("star_offset", float(np.linalg.norm(offset)), _PRIOR_SIGMAS),
        ("rejected", float(np.mean(fit.noise.weight[night] == 0.0)), _MOST_REJECTED),
        ("sun_scatter", *_compare_sun_scatter(fit, alone, usable, of_day)),
        ("sky", _difference_over_sky(fit, alone), _SKY_SIGMAS),
    )
    for cause, value, limit in measured:
        if not value <= limit:
            return Finding(
                "night_contradicts_day", {"n": int(night.sum()), "cause": cause, "value": value, "limit": limit}
            )
    return None


def select_one_kind(usable: Sightings, finding: Finding, *, night: bool) -> Sightings:
    """Return the sightings of the night or of the day, with the finding that says why the others were left out."""
    kind = usable.select(usable.night == night)
    filtering = kind.filtering._replace(dropped=(*kind.filtering.dropped, finding))
    sigma_px = kind.sigma_px / np.median(kind.sigma_px)
    return replace(kind, sigma_px=sigma_px, information=sigma_px**-2.0, filtering=filtering)


def day_contradicts_night(found: Finding, day: Calibration, night: Calibration, suns: Sightings) -> Finding | None:
    """Return the finding that the day's sightings are at fault where they contradict the night's; else None.

    Asked where the two differ by no turn or offset that nights have. The day's are at fault where the night's camera is
    within what they, and a fit of them, state, and the day's camera is not within what a fit of the night's states.

    Parameters
    ----------
    found : by which they contradict each other, see `contradiction`.
    day, night : the fits of either alone.
    suns : sightings of the day, with their directions and the 1-sigma that was stated of each, px.
    """
    if found.data["cause"] not in _OF_EITHER or not night.verdict.accepted or not len(suns):
        return None
    off = np.linalg.norm(suns.pixels - project(night.camera, suns.directions), axis=-1) / suns.sigma_px
    scatter = robust_sigma(off, floor=0.0) if np.all(np.isfinite(off)) else math.inf
    of_day, of_night = _distance_in_sigmas(day, night), _distance_in_sigmas(night, day)
    if not (scatter <= _AS_STATED_SUNS and of_day <= _SKY_SIGMAS < of_night):
        return None
    return Finding("day_contradicts_night", {"n": len(suns), "night_sigmas": of_day, "day_sigmas": of_night})


def _distance_in_sigmas(one: Calibration, other: Calibration) -> float:
    """Return the distance of another camera from a calibration over the sky, in units of the stated error."""
    sky = seen_sky(one.camera)
    pixels, covariance = project_with_covariance(one, sky)
    variance = np.trace(covariance, axis1=-2, axis2=-1)
    square = np.sum((pixels - project(other.camera, sky)) ** 2, axis=-1)
    both = np.isfinite(square) & np.isfinite(variance)
    return math.sqrt(float(np.sum(square[both])) / max(float(np.sum(variance[both])), 1e-12))


def _compare_sun_scatter(
    fit: FitState, alone: MarginalFit, usable: Sightings, of_day: BoolArray
) -> tuple[float, float]:
    """Return the scatter of the track about the fit of both over that about the day's own, and the largest by chance.

    Each is over its degrees of freedom: few suns are followed by a fit of their own alone. The fit of both is one of
    those that the day's might have been, and what that gains by chance has the distribution F.
    """
    system, track = fit.system, ~usable.alone
    if not np.any(track):
        return 0.0, _SUN_SCATTER
    normal = system.normal()
    together = marginal_fit(normal, fit.grid.basis, fit.scales)
    step = system.rows @ (alone.unknowns - system.at)
    both = field_at(normal, fit.grid.basis, fit.scales)
    smooth = [system.basis_values @ coefficients.T for coefficients in (both, alone.coefficients)]
    residuals = [fit.residual - smooth[0][fit.member], fit.residual - (step + smooth[1])[fit.member]]
    scatter = [
        robust_sigma(np.linalg.norm(residual[track], axis=-1) / usable.sigma_px[track], floor=1e-9)
        for residual in residuals
    ]
    sums = ((normal, together), (system.sum_bins(of_day), alone))
    followed = [2.0 * float(np.sum(compute_leverage(system, *one, fit.scales, which=of_day))) for one in sums]
    count = 2.0 * np.count_nonzero(track)
    free_both, free_alone = (max(count - one, 1.0) for one in followed)
    more = max(free_both - free_alone, 1.0)
    from scipy.special import fdtri  # noqa: PLC0415 - the sun's fits alone load without it

    by_chance = (1.0 + more / free_alone * float(fdtri(more, free_alone, 1.0 - _CHANCE))) * free_alone / free_both
    value = scatter[0] / scatter[1] * math.sqrt(free_alone / free_both)
    return value, max(_SUN_SCATTER, math.sqrt(by_chance))


def _difference_over_sky(fit: FitState, alone: MarginalFit) -> float:
    """Return the distance of the two fits over the sky, in units of the day's stated error."""
    _, pixels, rows = shown_sky(fit.problem, fit.unknowns)
    change = rows @ (alone.unknowns - fit.system.at)
    basis = fit.grid.basis
    stated = prediction_variance(alone, fit.scales, basis, rows=rows, basis_values=basis.values(pixels))
    return float(np.sqrt(np.sum(change**2) / np.sum(np.maximum(stated, 1e-12))))
