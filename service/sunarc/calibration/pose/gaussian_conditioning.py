"""Gaussian conditioning of a camera's error model on sightings, some of which are outliers."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve, cholesky

from sunarc.array_types import BoolArray, FloatArray, Rows, picked
from sunarc.calibration.pose.error_model import (
    CameraErrorModel,
    Predicted,
    joint_covariance,
    with_coefficients,
    with_parameters,
)
from sunarc.calibration.robust_loss import finite

_EXCLUDED_PX2 = 1e6
"""Variance of a sighting that is left out: it stays in the equations, without information."""
_FALSE_SHARE = 0.2
_HALO_PX = 15.0
_SWEEPS = 8


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sightings:
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

    def select(self, which: Rows) -> Sightings:
        """Return those that a slice, an index or a mask picks."""
        return picked(self, which)


def false_density(distance_px: FloatArray, *, area_px2: float) -> FloatArray:
    """Return the logarithm of how likely a false sighting is to be where it is: half of them near, half anywhere.

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
        return np.asarray(
            np.einsum("ni,nij,nj->n", self.loo_residual, np.linalg.inv(self.loo_covariance), self.loo_residual)
        )


def fit_inlier_mixture(covariance: FloatArray, sightings: Sightings, inlier: BoolArray) -> MixtureFit:
    """Return the inliers among sightings, and the log evidence of all.

    Parameters
    ----------
    covariance : (2n, 2n) of the prediction's errors at the sightings, px².
    sightings : the sightings, their residuals about the error model's mean.
    inlier : (n,) initial inliers; then each is classified by the prediction from the others, until nothing changes.
    """
    for _ in range(_SWEEPS):
        loo_residual, spread = _leave_one_out(covariance, sightings, inlier)
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


def log_evidence(covariance: FloatArray, sightings: Sightings, inliers: BoolArray) -> float:
    """Return the log likelihood of all sightings: inliers jointly normal, the others false (`fit_inlier_mixture`)."""
    false = sightings.false_density[~inliers] + math.log(_FALSE_SHARE)
    return (
        log_normal(covariance, sightings, inliers)
        + int(inliers.sum()) * math.log(1.0 - _FALSE_SHARE)
        + float(false.sum())
    )


def _leave_one_out(covariance: FloatArray, sightings: Sightings, inlier: BoolArray) -> tuple[FloatArray, FloatArray]:
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
    determinant = np.maximum(np.linalg.det(spread), 1e-20)
    square = np.einsum("ni,nij,nj->n", loo_residual, np.linalg.inv(spread), loo_residual)
    return np.asarray(-0.5 * square - 0.5 * np.log(determinant) - math.log(2.0 * math.pi))


def log_normal(covariance: FloatArray, sightings: Sightings, inlier: BoolArray) -> float:
    """Return the log density of the inliers together; 0 where there are none."""
    if not np.any(inlier):
        return 0.0
    both = np.repeat(inlier, 2)
    total = covariance[np.ix_(both, both)] + np.diag(np.repeat(sightings.variance[inlier], 2))
    factor = _factored(total)
    residual = sightings.residual[inlier].ravel()
    square = float(residual @ cho_solve((factor, True), residual))
    return -0.5 * square - float(np.sum(np.log(np.diag(factor)))) - 0.5 * residual.size * math.log(2.0 * math.pi)


def _factored(covariance: FloatArray) -> FloatArray:
    """Return the lower Cholesky factor; LinAlgError also where a direction has no pixel and its covariance is NaN."""
    if not np.all(np.isfinite(covariance)):
        raise np.linalg.LinAlgError("a sighting is where the camera has no pixel")
    return np.asarray(cholesky(covariance, lower=True))


def conditioned(error_model: CameraErrorModel, at: Predicted, sightings: Sightings) -> CameraErrorModel:
    """Return the error model conditioned on sightings that are all inliers, their residuals about an unchanged camera.

    Without any sighting it is unchanged.
    """
    if sightings.variance.size == 0:
        return error_model
    total = joint_covariance(error_model, at) + np.diag(np.repeat(sightings.variance, 2))
    factor = (_factored(total), True)
    shared = with_parameters(error_model, at)
    # the Kalman gain, all sightings at once
    gain = cho_solve(factor, shared.T).T
    residual = sightings.residual.ravel() - at.rows.reshape(sightings.residual.size, -1) @ error_model.mean
    covariance = error_model.covariance - gain @ shared.T
    field = error_model.field
    cross = np.stack([field.cross[axis] - gain @ with_coefficients(error_model, at, axis) for axis in (0, 1)])
    return replace(
        error_model,
        mean=error_model.mean + gain @ residual,
        covariance=0.5 * (covariance + covariance.T),
        field=replace(field, cross=cross),
    )
