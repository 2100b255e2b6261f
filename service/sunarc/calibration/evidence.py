"""Likelihood of observations under an explanation: the one comparison by which a change is decided.

What is observed (the residuals of sightings, a day's rotations) is normal about what an explanation predicts, its free
numbers integrated out; single observations may be false. Four searches compare explanations by it: the monitor of each
sighting, the search within a record, the states of an archive, the neighbours of a camera. They differ in what they
observe, in the alternatives, and in how often they ask, hence in the evidence that they require.
References: R. Kass and A. Raftery, "Bayes factors", J. Am. Stat. Assoc. 90 (1995); C. Rasmussen and C. Williams,
"Gaussian processes for machine learning" (2006), chapters 4 and 5.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from sunarc.common.array_types import BoolArray, FloatArray, IntArray
from sunarc.common.robust_statistics import finite

_LARGEST_COST = 8.0
"""Cost of a sighting that no state explains: 4 sigma. False ones are alike in all states."""
_EXCLUDED_PX2 = 1e6
"""Variance of a sighting that is left out: it stays in the equations, without information."""
_FALSE_SHARE = 0.2
_HALO_PX = 15.0
_SWEEPS = 8

T = TypeVar("T")


class Limits(NamedTuple):
    """Limits and priors of one search for a change of a camera.

    They differ by how often a search asks, and by what it observes.
    """

    gain: float
    """Powers of e by which a change must explain the observations better than none."""
    turn_deg: float
    """1-sigma of a turn about each axis before the observations."""
    least_deg: float
    """Turn that is no change: mounts wander and lean by less."""
    rarer: Mapping[str, float]
    """Powers of e by which a cause is rarer than the others of the search; negative of one that a fact supports."""
    lens: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """1-sigma of a change of the lens: shares of the focal length and of the image's size, and radial coefficients."""


RARER = 6.0
"""Powers of e by which a rarer explanation must be better than a turn of the camera to be named."""
ONLINE = Limits(20.0, 0.02, 0.01, {"bump": 0.0, "clock": 5.0}, (0.05, 0.03, 0.02))
"""Asked after every sighting: Kass and Raftery (1995) call 5 very strong, a camera is changed about once a year, and
each search asks at many places. The 1-sigma of a turn is that of the turn itself, and this at least. A clock whose host
reports no step is rarer than a turn by 5."""
RECORD = Limits(15.0, math.degrees(0.1), 0.05, {})
"""Asked at one of hundreds of sightings of a day (-11.5 with once a year), 20 times as probable as none (3); none of
1,000 cameras that stood still reaches it (docs/studies.md). The 1-sigma is that of the pose without a turn; that of a
turn is the turn itself. The least turn is one over a night."""
_STATED = {"site": -RARER, "longitude": -RARER}
_STEPS = {"moved": 2.0, "north": 3.0, "clock": 3.0, "clock_or_north": 3.0}
DAYS = Limits(13.0, 0.1, 0.0, {"slow_turn": 0.0, **_STEPS, **_STATED})
"""Asked of the rotations of some 60 days, of a long record and of neighbours: less than one false step in a camera-year
(docs/studies.md). The 1-sigma is a blow, a camera put straight, 24 s of a clock. Rarities by
docs/studies/cross_checks.py and pose_changes.py."""
EPOCHS = Limits(20.0, 1.0, 0.05, {"moved": 0.0, "clock": 5.0, "lens": RARER}, (0.03, 0.01, 0.02))
"""Asked at one of some thousands of sightings of an archive (-8): three of them have to support it, and three false
ones in a row that fit another state are rare. The least turn is a drift that the uncertainty allows for: every mount
leans within a decade."""


class Weighed(NamedTuple, Generic[T]):
    """Explanation, its log likelihood, and how much rarer it is than others."""

    explanation: T
    log_evidence: float
    rarer: float = 0.0


def most_probable(weighed: Iterable[Weighed[T]]) -> Weighed[T]:
    """Return the explanation with the largest evidence minus rarity; the first of equal ones."""
    return max(weighed, key=lambda one: one.log_evidence - one.rarer)


def factored(covariance: FloatArray) -> FloatArray:
    """Return the lower Cholesky factor; LinAlgError also where a direction has no pixel and its covariance is NaN."""
    if not np.all(np.isfinite(covariance)):
        raise np.linalg.LinAlgError("an observation is where nothing is predicted")
    return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)


def whitened(covariance: FloatArray, stacked: FloatArray) -> tuple[FloatArray, float]:
    """Return columns (n, m) whitened by a covariance (n, n), and half its log determinant."""
    from scipy.linalg import solve_triangular  # noqa: PLC0415 - a fit of one pose loads without it

    factor = factored(covariance)
    white = solve_triangular(factor, stacked, lower=True, check_finite=False)
    return np.asarray(white), float(np.sum(np.log(np.diag(factor))))


def linear_evidence(information: FloatArray, pull: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the log evidence (...) of linear unknowns, but for a constant, and their most probable values (..., k).

    With unknowns of unit prior variance it is that against their being 0.

    Parameters
    ----------
    information : (..., k, k) of the observations and of the unknowns' prior together.
    pull : (..., k) products of the columns with the residuals, and the prior's part.
    """
    mean = np.asarray(np.linalg.solve(information, pull[..., None])[..., 0])
    log_determinant = np.linalg.slogdet(information).logabsdet
    return np.asarray(0.5 * (np.sum(pull * mean, axis=-1) - log_determinant)), mean


def products_by_part(rows: FloatArray, part: IntArray) -> FloatArray:
    """Return (d, k, k): the products of rows (n, 2, k) over the sightings of each part, numbered (n,) from 0 on."""
    order = np.argsort(part, kind="stable")
    begin = np.searchsorted(part[order], np.arange(int(part.max(initial=-1)) + 2))
    flat = [rows[order[first:last]].reshape(-1, rows.shape[-1]) for first, last in itertools.pairwise(begin)]
    return np.array([one.T @ one for one in flat]).reshape(-1, *rows.shape[-1:] * 2)


class Explained(NamedTuple):
    """Evidence of an explanation, and the estimate of its free numbers of unit prior variance."""

    log_evidence: float
    """Log density of the observations, the free numbers integrated out."""
    mean: FloatArray
    """(p,) most probable free numbers."""
    covariance: FloatArray
    """(p, p) covariance of these."""


def explained(values: FloatArray, covariance: FloatArray, columns: FloatArray | None = None) -> Explained:
    """Return the evidence of an explanation, and the estimate of its free numbers.

    Parameters
    ----------
    values : (n, a) observed minus predicted: `a` axes that err independently and alike.
    covariance : (n, n) of each axis; (n,) where the observations err independently.
    columns : (n, a, p) by how much each free number, of unit prior variance, moves the prediction; None without any.
    """
    n, axes = values.shape
    count = 0 if columns is None else columns.shape[-1]
    stacked = values if columns is None else np.concatenate([values, columns.reshape(n, axes * count)], axis=1)
    if covariance.ndim == 1:
        white, half_log = stacked / np.sqrt(covariance)[:, None], 0.5 * float(np.sum(np.log(covariance)))
    else:
        white, half_log = whitened(covariance, stacked)
    left, rows = white[:, :axes], white[:, axes:].reshape(n, axes, count)
    # Woodbury's identity: the free numbers' covariance is added to that of the values
    information = np.eye(count) + np.einsum("nai,naj->ij", rows, rows, optimize=True)
    gain, mean = linear_evidence(information, np.einsum("nai,na->i", rows, left))
    without = -0.5 * (float(np.sum(left**2)) + n * axes * math.log(2.0 * math.pi)) - axes * half_log
    return Explained(without + float(gain), mean, np.linalg.inv(information))


def log_marginal(values: FloatArray, covariance: FloatArray, columns: FloatArray | None = None) -> float:
    """Return the log density of observations, the free numbers integrated out, see `explained`."""
    return explained(values, covariance, columns).log_evidence


def step_evidences(values: FloatArray, common: FloatArray, step: FloatArray) -> FloatArray:
    """Return (n,): log evidence of a change before each observation, up to the constant of all (`explained`).

    Parameters
    ----------
    values : (n, a) observed minus predicted, whitened.
    common : (n, a, p) columns of all observations.
    step : (n, a, q) columns of those from the change on.
    """
    both = np.concatenate([common, step], axis=-1)
    size, total = common.shape[-1], both.shape[-1]
    # sums over the observations from each on
    products = np.cumsum(np.einsum("nap,naq->npq", both, both)[::-1], axis=0)[::-1].copy()
    pulls = np.cumsum(np.einsum("nap,na->np", both, values)[::-1], axis=0)[::-1].copy()
    products[:, :size, :size], pulls[:, :size] = products[0, :size, :size].copy(), pulls[0, :size].copy()
    return linear_evidence(np.eye(total) + products, pulls)[0]


def matern_3_2(lag: FloatArray, scale: float) -> FloatArray:
    """Return the correlation of a process that is differentiable once (Rasmussen and Williams, eq. 4.17)."""
    scaled = math.sqrt(3.0) * np.abs(lag) / scale
    return np.asarray((1.0 + scaled) * np.exp(-scaled))


def matern_5_2(lag: FloatArray, scale: float) -> FloatArray:
    """Return the correlation of a process that is differentiable twice (Rasmussen and Williams, eq. 4.17)."""
    scaled = math.sqrt(5.0) * np.abs(lag) / scale
    return np.asarray((1.0 + scaled + scaled**2 / 3.0) * np.exp(-scaled))


# A sequence of states, each of which says where the sightings are; single ones may be false.


def bounded_cost(distance_px: FloatArray, sigma_px: float) -> FloatArray:
    """Return (n,): minus the log likelihood of sightings so far from a state's, that of a false one at most."""
    return np.minimum(0.5 * np.square(distance_px / sigma_px), _LARGEST_COST)


def likeliest_path(costs: FloatArray, *, change_cost: float) -> IntArray:
    """Return the sequence of states with the least cost (Viterbi 1967).

    Parameters
    ----------
    costs : (n, k) of each of k states at each of n observations.
    change_cost : of a change from one state to any other.

    Returns
    -------
    (n,) numbers of states; of equal ones that with the least number.
    """
    n, k = costs.shape
    before = np.zeros((n, k), dtype=np.int64)
    total = costs[0].copy() if n else np.zeros(k)
    for row in range(1, n):
        best = int(np.argmin(total))
        stays = total <= total[best] + change_cost
        before[row] = np.where(stays, np.arange(k), best)
        total = np.where(stays, total, total[best] + change_cost) + costs[row]
    path = np.zeros(n, dtype=np.int64)
    if n:
        path[-1] = int(np.argmin(total))
    for row in range(n - 1, 0, -1):
        path[row - 1] = before[row, path[row]]
    return path


# Sightings, some of which are false: the others are jointly normal.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PixelResiduals:
    """Residuals of sightings about a prediction.

    Attributes
    ----------
    residual : (n, 2) seen minus predicted, px.
    variance : (n,) of each axis, px².
    false_density : (n,) logarithm of how likely a false sighting is to be just there, px⁻².
    """

    residual: FloatArray
    variance: FloatArray
    false_density: FloatArray


def false_density(distance_px: FloatArray, *, area_px2: float) -> FloatArray:
    """Return the log density of a false sighting: half of them near the prediction, half anywhere in the image.

    Parameters
    ----------
    distance_px : (n, 2) from where the sun was expected before anything was known of a change.
    area_px2 : of the image.
    """
    square = np.sum(finite(distance_px) ** 2, axis=-1) / _HALO_PX**2
    near = np.exp(-0.5 * square) / (2.0 * math.pi * _HALO_PX**2)
    return np.asarray(np.log(0.5 * near + 0.5 / area_px2))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MixtureFit:
    """Fit of an inlier mixture to sightings.

    Attributes
    ----------
    inlier : (n,) which of them are inliers.
    log_evidence : of all of them.
    loo_residual : (n, 2) residual of each about its prediction from all other inliers (leave one out), px.
    loo_covariance : (n, 2, 2) of that, px².
    """

    inlier: BoolArray
    log_evidence: float
    loo_residual: FloatArray
    loo_covariance: FloatArray

    @property
    def surprise(self) -> FloatArray:
        """Return (n,): squared leave-one-out residual in its own sigmas; 2 on average for true sightings."""
        return squared_sigmas(self.loo_residual, self.loo_covariance)


def fit_inlier_mixture(covariance: FloatArray, sightings: PixelResiduals, inlier: BoolArray) -> MixtureFit:
    """Return the inliers among sightings, and the log evidence of all.

    Parameters
    ----------
    covariance : (2n, 2n) of the prediction's errors at the sightings, px².
    sightings : the sightings, their residuals about the error model's mean.
    inlier : (n,) initial inliers; then each is classified by the prediction from the others, until nothing changes.
    """
    for _ in range(_SWEEPS):
        loo_residual, spread = _leave_one_out_residuals(covariance, sightings, inlier)
        true = _log_density(loo_residual, spread) + math.log(1.0 - _FALSE_SHARE)
        next_ = true > sightings.false_density + math.log(_FALSE_SHARE)
        if np.array_equal(next_, inlier) or not np.any(next_):
            break
        inlier = next_
    return MixtureFit(
        inlier=inlier,
        log_evidence=log_evidence(covariance, sightings, inlier),
        loo_residual=loo_residual,
        loo_covariance=spread,
    )


def log_evidence(covariance: FloatArray, sightings: PixelResiduals, inliers: BoolArray) -> float:
    """Return the log likelihood of all sightings: inliers jointly normal, the others false (`fit_inlier_mixture`)."""
    false = sightings.false_density[~inliers] + math.log(_FALSE_SHARE)
    return (
        log_normal(covariance, sightings, inliers)
        + int(inliers.sum()) * math.log(1.0 - _FALSE_SHARE)
        + float(false.sum())
    )


def _leave_one_out_residuals(
    covariance: FloatArray, sightings: PixelResiduals, inlier: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Return leave-one-out residuals (n, 2) by the other inliers, and their covariances (n, 2, 2)."""
    n = inlier.size
    variance = np.where(inlier, sightings.variance, _EXCLUDED_PX2)
    inverse = np.linalg.inv(covariance + np.diag(np.repeat(variance, 2)))
    # the inverse's diagonal blocks give every leave-one-out residual at the price of one inversion
    loo_covariance = np.linalg.inv(inverse.reshape(n, 2, n, 2)[np.arange(n), :, np.arange(n)])
    loo_residual = np.einsum("nij,nj->ni", loo_covariance, (inverse @ sightings.residual.ravel()).reshape(n, 2))
    spread = loo_covariance + (sightings.variance - variance)[:, None, None] * np.eye(2)
    spread[~inlier] += 1e-3 * sightings.variance[~inlier, None, None] * np.eye(2)
    return loo_residual, 0.5 * (spread + np.swapaxes(spread, -1, -2))


def _log_density(loo_residual: FloatArray, spread: FloatArray) -> FloatArray:
    with np.errstate(invalid="ignore"):  # NaN where nothing is predicted
        determinant = np.maximum(np.linalg.det(spread), 1e-20)
    square = squared_sigmas(loo_residual, spread)
    return np.asarray(-0.5 * square - 0.5 * np.log(determinant) - math.log(2.0 * math.pi))


def squared_sigmas(residual: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return (n,): squared Mahalanobis distances of residuals (n, 2) of covariances (n, 2, 2)."""
    return np.asarray(np.einsum("ni,nij,nj->n", residual, np.linalg.inv(covariance), residual))


def log_normal(covariance: FloatArray, sightings: PixelResiduals, inlier: BoolArray) -> float:
    """Return the joint log density of the inliers; 0 without inliers."""
    if not np.any(inlier):
        return 0.0
    both = np.repeat(inlier, 2)
    total = covariance[np.ix_(both, both)] + np.diag(np.repeat(sightings.variance[inlier], 2))
    return log_marginal(sightings.residual[inlier].reshape(-1, 1), total)
