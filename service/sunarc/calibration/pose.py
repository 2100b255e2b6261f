"""A known lens in a new pose, from as few as three sightings, some of which may be false.

The calibration's lens, field and pose are the prior; the camera may since have turned by any
angle, whose scale is sought in the sightings too. What they cannot tell (after a few minutes the turn about the sun's
own direction) thus stays as uncertain as turns of that size are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from sunarc.calibration.answers.error_model import (
    CameraErrorModel,
    Predicted,
    build_error_model,
    coefficient_covariance,
    joint_covariance,
    moved,
    parameter_covariance,
    predicted,
    rotated,
)
from sunarc.calibration.evidence import (
    MixtureFit,
    PixelResiduals,
    factored,
    false_density,
    fit_inlier_mixture,
    log_normal,
    squared_sigmas,
)
from sunarc.calibration.fit.assemble import FitOutcome, Job, calibration_from_fit, refused
from sunarc.calibration.model.options import USUAL_OPTIONS, CalibrationOptions, Mirrored
from sunarc.calibration.model.residual_field import Field
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings, filter_sightings
from sunarc.calibration.solve.problem import Bins
from sunarc.calibration.start.initial_guess import ransac_rotation
from sunarc.common.array_types import BoolArray, FloatArray, picked
from sunarc.common.findings import Finding
from sunarc.common.robust_statistics import finite, robust_sigma
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project_fast
from sunarc.optics.pose import pose_angles, right_jacobian
from sunarc.sky.site import Site

# Sightings as a posing takes them: their noise, and neighbours taken together so that there are not too many.

MOST = 80
"""Sightings, or means of neighbours, that are used together."""
_UNKNOWN_SIGMA_PX = 0.5
_SMALLEST_SIGMA_PX = 0.005
_LARGEST_INFLATION = 25.0


def noise_px(start: Calibration, sigma_px: FloatArray) -> FloatArray:
    """Return (n,): 1-sigma per axis of sightings, never below that of the calibration's own."""
    fit_sigma_px = start.evidence.sigma_px
    usual = fit_sigma_px if math.isfinite(fit_sigma_px) and fit_sigma_px > 0.0 else _UNKNOWN_SIGMA_PX
    estimated_sigma_px = np.where(np.isfinite(sigma_px) & (sigma_px > 0.0), sigma_px, usual)
    return np.maximum(estimated_sigma_px, max(usual, _SMALLEST_SIGMA_PX))


def assign_noise(usable: Sightings, points: Sightings, start: Calibration) -> Sightings:
    """Return the usable sightings, their sigma in px: as stated with them, see `noise_px`."""
    return replace(usable, sigma_px=noise_px(start, points.sigma_px[usable.index]))


def variance_inflation(start: Calibration) -> float:
    """Return by how much a sighting's variance grows because its neighbours err alike."""
    found = start.evidence.inflation
    return min(max(found, 1.0), _LARGEST_INFLATION) if math.isfinite(found) else 1.0


def gathered(camera: Camera, sightings: Sightings, inlier: BoolArray, *, inflation: float) -> Sightings:
    """Return the inliers, with neighbours averaged so that they are not too many."""
    true = sightings.select(np.flatnonzero(inlier))
    # rounded up, so that no more than MOST groups remain
    each = -(-len(true) // MOST)
    member = np.arange(len(true)) // max(each, 1)
    bins = Bins(member=member, count=int(member[-1]) + 1 if member.size else 0)
    residual = finite(true.pixels - project_fast(camera, true.directions))
    one, mean = bins.gathered(true, residual, 1.0 / true.variance)
    pixels = project_fast(camera, one.directions) + mean
    return replace(one, pixels=pixels, sigma_px=np.sqrt(inflation / one.information))


def conditioned(error_model: CameraErrorModel, at: Predicted, sightings: PixelResiduals) -> CameraErrorModel:
    """Return the error model conditioned on sightings that are all inliers, their residuals about an unchanged camera.

    Without any sighting it is unchanged.
    """
    if sightings.variance.size == 0:
        return error_model
    total = joint_covariance(error_model, at) + np.diag(np.repeat(sightings.variance, 2))
    from scipy.linalg import cho_solve  # noqa: PLC0415 - a fit of sightings alone loads without it

    factor = (factored(total), True)
    shared = parameter_covariance(error_model, at)
    # the Kalman gain, all sightings at once
    gain = cho_solve(factor, shared.T).T
    residual = sightings.residual.ravel() - at.rows.reshape(sightings.residual.size, -1) @ error_model.mean
    covariance = error_model.covariance - gain @ shared.T
    field = error_model.field
    cross = np.stack([field.cross[axis] - gain @ coefficient_covariance(error_model, at, axis) for axis in (0, 1)])
    return replace(
        error_model,
        mean=error_model.mean + gain @ residual,
        covariance=0.5 * (covariance + covariance.T),
        field=replace(field, cross=cross),
    )


FEWEST = 3
_ROUNDS = 3
_SCALES_RAD = np.radians([0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 60.0])
"""How far a camera may have turned, 1-sigma. All scales are as likely before the sightings, not all their powers of
ten: a turn that is taken for smaller than it is breaks its promise."""
_ENOUGH_FOR_SCALE = 12
_CLOSE = 6.0
_SMALLEST_WEIGHT = 1e-4


def estimate_pose(
    points: Sightings,
    *,
    start: Calibration,
    site: Site,
    options: CalibrationOptions = USUAL_OPTIONS,
    wander_deg: float = 0.0,
) -> Calibration:
    """Return a calibration of the same camera in a new pose; its covariance holds the lens's own uncertainty.

    Poor data give a calibration whose verdict is refused and says why; they never raise.

    Parameters
    ----------
    points : sightings of one pose epoch.
    start : the calibration of an earlier pose; its lens is kept, within its stated error.
    site : where the camera stands.
    options : what makes the answer acceptable.
    wander_deg : 1-sigma per axis by which the pose wanders about its mean (mast, heat); it widens the uncertainty.
    """
    options = options_about(start.camera, options)
    size = (start.camera.width, start.camera.height)
    usable = filter_sightings(points, site=site, image_size=size)
    job = Job(points=points, usable=usable, site=site, image_size=size, options=options, free="pose")
    if len(usable) < FEWEST:
        return refused(job, (Finding("too_few_sightings", {"n": len(usable), "least": FEWEST}),))
    try:
        fit = fit_pose(start, assign_noise(usable, points, start))
    except np.linalg.LinAlgError:  # no pose is near the sightings: the equations mean nothing
        return refused(job, (Finding("no_camera_fits"),))
    fitted = make_outcome(fit, start, usable, wander_rad=math.radians(wander_deg))
    return calibration_from_fit(fitted, job)


def options_about(camera: Camera, options: CalibrationOptions) -> CalibrationOptions:
    """Return the options of a robust fit about a known camera: projection and handedness are its own."""
    mirrored: Mirrored = "yes" if camera.mirrored else "no"
    return replace(options, method="robust", projection=camera.projection, mirrored=mirrored)


def stated_calibration(job: Job, camera: Camera, *, covariance: FloatArray, field: Field) -> Calibration:
    """Return the calibration of a camera with stated errors; its sightings give the noise."""
    without_fit = refused(job, ())
    return replace(
        without_fit,
        evidence=replace(without_fit.evidence, sigma_px=job.usable.filtering.stated_sigma_px),
        camera=camera,
        poses=(camera.rotation_cam_enu,),
        pose=pose_angles(camera.rotation_cam_enu),
        covariance=covariance,
        field=field,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseFit:
    """Fit of the pose of a known lens.

    Attributes
    ----------
    camera : the most probable one.
    error_model : of it; its mean is 0.
    inlier : (n,) which sightings are inliers.
    sigma_px : noise of a sighting, px per axis (median).
    """

    camera: Camera
    error_model: CameraErrorModel
    inlier: BoolArray
    sigma_px: float


def fit_pose(start: Calibration, sightings: Sightings, *, turned_rad: float | None = None) -> PoseFit:
    """Return the pose fit of a known lens to sightings.

    Parameters
    ----------
    start : lens, former pose and what is known of both.
    sightings : in the order of time, with directions and sigma in px (`assign_noise`).
    turned_rad : 1-sigma of the rotation about each axis since the former pose; None where the camera may have turned
        by any angle.
    """
    error_model, camera = build_error_model(start), start.camera.at_every_angle()
    apart = sightings.pixels - project_fast(camera, sightings.directions)
    area_px2 = float(camera.width * camera.height)
    sightings = replace(sightings, false_density=false_density(apart, area_px2=area_px2))
    thin = sightings.thinned(MOST)
    tolerance = tolerance_px(error_model, camera, thin)
    rotation = ransac_rotation(camera, thin.directions, thin.pixels, tolerance)
    scales = _prior_scales_for_turn(float(np.linalg.norm(rotation))) if turned_rad is None else np.array([turned_rad])
    base = rotated(camera, rotation)
    close = np.linalg.norm(finite(thin.pixels - project_fast(base, thin.directions)), axis=-1) < _CLOSE * tolerance
    # how far the camera turned is a hyperparameter: each scale is conditioned, then all are averaged
    priors = [error_model.add_free_rotation(-rotation, sigma_rad=float(scale)) for scale in scales]
    return conditioned_pose(priors, np.log(scales), base, sightings, close, inflation=variance_inflation(start))


def conditioned_pose(
    priors: list[CameraErrorModel],
    log_prior: FloatArray,
    base: Camera,
    sightings: Sightings,
    close: BoolArray,
    *,
    inflation: float,
) -> PoseFit:
    """Return a camera conditioned on sightings, outliers left out, averaged over priors of its errors.

    Parameters
    ----------
    priors : of the camera's errors about `base`; the second one, where there are several, finds the outliers.
    log_prior : (k,) log probability of each.
    base : the camera that the equations are first made about.
    sightings : all of them, in the order of time.
    close : of `MOST` of them, which are taken to be inliers at first.
    inflation : by how much a sighting's variance grows because its neighbours err alike.
    """
    rough, mixture = settled(priors[min(1, len(priors) - 1)], base, sightings.thinned(MOST), close)
    worse = _noise_factor(mixture)
    stated_px = float(np.median(sightings.sigma_px))
    sightings = replace(sightings, sigma_px=sightings.sigma_px * worse)
    inlier = _select_inliers(rough, moved(base, rough, rough.mean), sightings)
    together = gathered(moved(base, rough, rough.mean), sightings, inlier, inflation=inflation)
    fits = [_condition_on_inliers(prior, base, together) for prior in priors]
    final = _merge_gaussians([fit for fit, _ in fits], np.array([evidence for _, evidence in fits]) + log_prior)
    return PoseFit(
        camera=moved(base, final, final.mean),
        error_model=replace(final, mean=0.0 * final.mean),
        inlier=inlier,
        sigma_px=stated_px * worse,
    )


def _prior_scales_for_turn(angle_rad: float) -> FloatArray:
    """Return the scales of a turn's prior: those with which it would be at most four sigmas."""
    return _SCALES_RAD[min(int(np.searchsorted(_SCALES_RAD, 0.25 * angle_rad)), _SCALES_RAD.size - 1) :]


def tolerance_px(error_model: CameraErrorModel, camera: Camera, sightings: Sightings) -> FloatArray:
    """Return (n,): 1-sigma, px, of a true sighting's distance from its prediction where the camera has not turned."""
    at = predicted(error_model, camera, sightings.directions)
    model_variance = np.nan_to_num(np.diag(joint_covariance(error_model, at)).reshape(-1, 2).mean(axis=1))
    return np.asarray(np.sqrt(sightings.variance + model_variance))


def settled(
    error_model: CameraErrorModel, base: Camera, sightings: Sightings, inlier: BoolArray
) -> tuple[CameraErrorModel, MixtureFit]:
    """Return the error model conditioned on sightings with outliers, linearised again in each round."""
    after = replace(error_model, mean=0.0 * error_model.mean)
    for _ in range(_ROUNDS):
        at, unchanged, about = _linearise_sightings(error_model, base, sightings, after.mean)
        mixture = fit_inlier_mixture(joint_covariance(error_model, at), about, inlier)
        inlier = mixture.inlier
        after = conditioned(error_model, picked(at, inlier), picked(unchanged, inlier))
    return after, mixture


def _linearise_sightings(
    error_model: CameraErrorModel, base: Camera, sightings: Sightings, mean: FloatArray
) -> tuple[Predicted, PixelResiduals, PixelResiduals]:
    """Return the equations of sightings at some parameters; residuals about `base`, and about the model's mean."""
    at = predicted(error_model, moved(base, error_model, mean), sightings.directions)
    residual = finite(sightings.pixels - at.pixels) + at.rows @ mean
    unchanged = PixelResiduals(residual=residual, variance=sightings.variance, false_density=sightings.false_density)
    return at, unchanged, replace(unchanged, residual=residual - at.rows @ error_model.mean)


def _noise_factor(mixture: MixtureFit) -> float:
    """Return the ratio, at least 1, of the sightings' scatter to their stated sigma."""
    if mixture.inlier.sum() < _ENOUGH_FOR_SCALE:
        return 1.0
    return max(1.0, robust_sigma(np.sqrt(np.maximum(mixture.surprise, 0.0))))


def _select_inliers(after: CameraErrorModel, camera: Camera, sightings: Sightings) -> BoolArray:
    """Return which sightings agree with a fit of some of them."""
    at = predicted(after, camera, sightings.directions)
    square, variance = np.empty(len(sightings)), sightings.variance
    for part in np.array_split(np.arange(square.size), max(square.size // MOST, 1)):
        blocks = joint_covariance(after, picked(at, part)).reshape(part.size, 2, part.size, 2)
        row = np.arange(part.size)
        spread = blocks[row, :, row] + variance[part, None, None] * np.eye(2)
        gap = finite(sightings.pixels[part] - at.pixels[part])
        square[part] = squared_sigmas(gap, spread)
    return np.asarray(square < 25.0)


def _condition_on_inliers(
    error_model: CameraErrorModel, base: Camera, sightings: Sightings
) -> tuple[CameraErrorModel, float]:
    """Return the error model conditioned on inliers, and their log evidence."""
    after = replace(error_model, mean=0.0 * error_model.mean)
    for _ in range(_ROUNDS):
        at, unchanged, about = _linearise_sightings(error_model, base, sightings, after.mean)
        after = conditioned(error_model, at, unchanged)
    return after, log_normal(joint_covariance(error_model, at), about, np.ones(len(sightings), dtype=bool))


def _merge_gaussians(fits: list[CameraErrorModel], log_weight: FloatArray) -> CameraErrorModel:
    """Return one Gaussian with the mean and covariance of a weighted mixture."""
    weight = np.exp(log_weight - log_weight.max())
    weight[weight < _SMALLEST_WEIGHT] = 0.0
    weight /= weight.sum()
    mean = np.einsum("k,kp->p", weight, np.array([fit.mean for fit in fits]))
    difference = np.array([fit.mean - mean for fit in fits])
    covariance = np.einsum("k,kpq->pq", weight, np.array([fit.covariance for fit in fits]))
    covariance += np.einsum("k,kp,kq->pq", weight, difference, difference)
    cross = np.einsum("k,kapm->apm", weight, np.array([fit.field.cross for fit in fits]))
    return replace(fits[0], mean=mean, covariance=covariance, field=replace(fits[0].field, cross=cross))


def make_outcome(fit: PoseFit, start: Calibration, usable: Sightings, *, wander_rad: float) -> FitOutcome:
    """Return the result of the pose's fit as every method's; the turn's axes become those of the rotation vector."""
    error_model, size = fit.error_model, fit.error_model.mean.size
    covariance = error_model.covariance.copy()
    covariance[np.ix_(error_model.rotation, error_model.rotation)] += wander_rad**2 * np.eye(3)
    to_vector = np.eye(size)
    to_vector[np.ix_(error_model.rotation, error_model.rotation)] = np.linalg.inv(
        right_jacobian(-np.array(fit.camera.rotation_cam_enu))
    )
    residual = finite(usable.pixels - project_fast(fit.camera, usable.directions))
    return FitOutcome(
        cameras=[fit.camera],
        parameter_names=start.parameter_names,
        covariance=to_vector @ covariance @ to_vector.T,
        field=replace(error_model.field, length_px=start.field.length_px, cross=to_vector @ error_model.field.cross),
        residual=residual,
        used=fit.inlier,
        sigma_px=fit.sigma_px,
        inflation=variance_inflation(start),
        radial_px=start.evidence.radial_px,
        held_out=None,
    )
