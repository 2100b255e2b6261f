"""A belief about a camera after it was held to sightings: Gaussian conditioning, some of them left out as false."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky

from sunarc.calibration.pose.error_model import Predicted, Stated, joint_covariance, with_parameters, with_waves

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_LEFT_OUT_PX2 = 1e6
"""Variance of a sighting that is left out: it stays in the equations, and says nothing."""
_FALSE_SHARE = 0.2
_HALO_PX = 15.0
_SWEEPS = 8


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sightings:
    """Sightings held to a prediction.

    Attributes
    ----------
    residual : (n, 2) seen minus predicted, px.
    variance : (n,) of each axis, px².
    false_density : (n,) logarithm of how likely a false sighting is to be just there, px⁻².
    """

    residual: FloatArray
    variance: FloatArray
    false_density: FloatArray

    def select(self, which: BoolArray) -> Sightings:
        """Return those that a mask picks."""
        return Sightings(
            residual=self.residual[which], variance=self.variance[which], false_density=self.false_density[which]
        )


def false_density(distance_px: FloatArray, *, area_px2: float) -> FloatArray:
    """Return the logarithm of how likely a false sighting is to be where it is: half of them near, half anywhere.

    Parameters
    ----------
    distance_px : (n, 2) from where the sun was expected before anything was known of a change.
    area_px2 : of the image.
    """
    square = np.sum(np.nan_to_num(distance_px, nan=1e4) ** 2, axis=-1) / _HALO_PX**2
    near = np.exp(-0.5 * square) / (2.0 * math.pi * _HALO_PX**2)
    return np.asarray(np.log(0.5 * near + 0.5 / area_px2))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Held:
    """What sightings say under a belief.

    Attributes
    ----------
    believed : (n,) which of them it takes for true.
    log_evidence : of all of them.
    gap : (n, 2) residual of each but for what all others let one expect, px.
    gap_covariance : (n, 2, 2) of that, px².
    """

    believed: BoolArray
    log_evidence: float
    gap: FloatArray
    gap_covariance: FloatArray

    @property
    def surprise(self) -> FloatArray:
        """Return (n,): squared gap in its own sigmas; 2 on average for true sightings."""
        return np.asarray(np.einsum("ni,nij,nj->n", self.gap, np.linalg.inv(self.gap_covariance), self.gap))


def held_to(covariance: FloatArray, seen: Sightings, believed: BoolArray) -> Held:
    """Return what sightings say, and which of them are to be believed.

    Parameters
    ----------
    covariance : (2n, 2n) of the prediction's errors at the sightings, px².
    seen : the sightings, their residuals about the belief's mean.
    believed : (n,) which to believe at first; in turn each is judged by what the others let one expect.
    """
    for _ in range(_SWEEPS):
        gap, spread = _gaps(covariance, seen, believed)
        true = _log_density(gap, spread) + math.log(1.0 - _FALSE_SHARE)
        following = true > seen.false_density + math.log(_FALSE_SHARE)
        if np.array_equal(following, believed) or not np.any(following):
            break
        believed = following
    return Held(
        believed=believed, log_evidence=log_evidence(covariance, seen, believed), gap=gap, gap_covariance=spread
    )


def log_evidence(covariance: FloatArray, seen: Sightings, inliers: BoolArray) -> float:
    """Return the log likelihood of all sightings, the inliers jointly normal and the others false; see `held_to`."""
    false = seen.false_density[~inliers] + math.log(_FALSE_SHARE)
    return (
        log_normal(covariance, seen, inliers) + int(inliers.sum()) * math.log(1.0 - _FALSE_SHARE) + float(false.sum())
    )


def _gaps(covariance: FloatArray, seen: Sightings, believed: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return what is left of each sighting after the believed others, (n, 2), and its covariance, (n, 2, 2)."""
    n = believed.size
    variance = np.where(believed, seen.variance, _LEFT_OUT_PX2)
    inverse = np.linalg.inv(covariance + np.diag(np.repeat(variance, 2)))
    own = np.linalg.inv(inverse.reshape(n, 2, n, 2)[np.arange(n), :, np.arange(n)])
    gap = np.einsum("nij,nj->ni", own, (inverse @ seen.residual.ravel()).reshape(n, 2))
    spread = own + (seen.variance - variance)[:, None, None] * np.eye(2)
    spread[~believed] += 1e-3 * seen.variance[~believed, None, None] * np.eye(2)
    return gap, 0.5 * (spread + np.swapaxes(spread, -1, -2))


def _log_density(gap: FloatArray, spread: FloatArray) -> FloatArray:
    determinant = np.maximum(np.linalg.det(spread), 1e-20)
    square = np.einsum("ni,nij,nj->n", gap, np.linalg.inv(spread), gap)
    return np.asarray(-0.5 * square - 0.5 * np.log(determinant) - math.log(2.0 * math.pi))


def log_normal(covariance: FloatArray, seen: Sightings, believed: BoolArray) -> float:
    """Return how likely the believed sightings are together, logarithm; 0 where there are none."""
    if not np.any(believed):
        return 0.0
    both = np.repeat(believed, 2)
    total = covariance[np.ix_(both, both)] + np.diag(np.repeat(seen.variance[believed], 2))
    factor = cholesky(total, lower=True)
    residual = seen.residual[believed].ravel()
    square = float(residual @ cho_solve((factor, True), residual))
    return -0.5 * square - float(np.sum(np.log(np.diag(factor)))) - 0.5 * residual.size * math.log(2.0 * math.pi)


def conditioned(belief: Stated, at: Predicted, seen: Sightings) -> Stated:
    """Return the belief after sightings, all of them believed; their residuals are about an unchanged camera.

    Without any sighting it is the belief of before.
    """
    if seen.variance.size == 0:
        return belief
    total = joint_covariance(belief, at) + np.diag(np.repeat(seen.variance, 2))
    factor = (cholesky(total, lower=True), True)
    shared = with_parameters(belief, at)
    gain = cho_solve(factor, shared.T).T
    left = seen.residual.ravel() - at.rows.reshape(seen.residual.size, -1) @ belief.mean
    covariance = belief.covariance - gain @ shared.T
    return replace(
        belief,
        mean=belief.mean + gain @ left,
        covariance=0.5 * (covariance + covariance.T),
        cross=np.stack([belief.cross[axis] - gain @ with_waves(belief, at, axis) for axis in (0, 1)]),
    )
