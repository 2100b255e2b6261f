"""From a fit to a calibration: metrics, uncertainty, evidence, verdict."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, replace
from types import MappingProxyType
from typing import Literal, NamedTuple

import numpy as np

from sunarc.calibration.answers.ageing import SEASONS
from sunarc.calibration.answers.covariance import pose_error, replace_covariance, sky_sigma_deg
from sunarc.calibration.fit.cross_validation import Doubts, HeldOut, doubts, held_out, without_parts
from sunarc.calibration.fit.effects import (
    CLOCK_OFFSET_S,
    N_RADIAL,
    OFFSET_PX,
    PICTURE,
    PICTURE_PX,
    PICTURE_SCALE,
    POSE_DIFFERENCE_DEG,
    SWAY_DEG,
    SWAYS,
    TURNING,
    TURNING_DEG,
    TURNING_POWERS,
)
from sunarc.calibration.fit.robust_fit import FitState
from sunarc.calibration.model import result
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle
from sunarc.calibration.model.residual_field import Field
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.quality.widening import add_pose_spread
from sunarc.calibration.solve.priors import FREE, FREE_NAMES, LENS, N_LENS, lens_prior, precisions
from sunarc.calibration.start.initial_guess import level_camera
from sunarc.calibration.verdict import fit_verdict
from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.common.findings import Finding
from sunarc.optics.backward import NO_BACKWARD, fit_backward
from sunarc.optics.camera import POSE, Camera, Param
from sunarc.optics.displacement import wave_basis
from sunarc.optics.forward import rising_limit
from sunarc.optics.pose import pose_angles, right_jacobian, rotation_matrix, rotation_vector
from sunarc.sky.days import day_to_date
from sunarc.sky.site import Site

_UNKNOWN_POSE = math.pi**2


class Job(NamedTuple):
    """Input of a calibration, and the sightings that it can use.

    parts: whether parts of them are held against it. tilt_known: see `fit_verdict`.
    """

    points: Sightings
    usable: Sightings
    site: Site
    image_size: tuple[int, int]
    options: CalibrationOptions
    circle: ImageCircle | None = None
    start: Camera | None = None
    free: Literal["all", "pose", "prior"] = "all"
    parts: bool = True
    tilt_known: bool = False


class FitOutcome(NamedTuple):
    """Result of a fit by any method.

    cameras: one an epoch. parameter_names, covariance (p, p), cross (2, p, m): of the last one, errors that no residual
    shows not yet folded in. residual (n, 2) px; used (n,): whether a sighting counted. mixture: None for a Gaussian.
    doubts: of the fit by parts of the sightings; None where they are not asked for. sways_deg: see `add_pose_spread`.
    displaced (n, 2): px, by the proven errors of other days or hours than those of the camera.
    """

    cameras: list[Camera]
    parameter_names: tuple[str, ...]
    covariance: FloatArray
    field: Field
    residual: FloatArray
    used: BoolArray
    sigma_px: float
    inflation: float
    radial_px: float
    held_out: HeldOut | None
    log_odds: Mapping[str, float] = MappingProxyType({})
    night: result.NightDifference | None = None
    mixture: result.ErrorMixture | None = None
    doubts: Doubts | None = None
    sways_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    displaced: FloatArray | float = 0.0


def calibration_from_fit(fitted: FitOutcome, job: Job, *, others: Sequence[Finding] = ()) -> result.Calibration:
    """Return the calibration that a fit makes; `others`: findings about other cameras that refuse it."""
    usable, options = job.usable, job.options
    cameras = [tidied(camera, options) for camera in fitted.cameras]
    camera = cameras[-1]
    evidence, covariance = _make_provenance(job, fitted), fitted.covariance.copy()
    covariance[POSE, POSE] += pose_error(
        camera,
        job.site,
        clock_error_s=evidence.clock_error_s if evidence.clock_stated else 0.0,
        site_error_m=options.site_error_m,
    )
    calibration = result.Calibration(
        camera=camera,
        poses=tuple(c.rotation_cam_enu for c in cameras),
        parameter_names=fitted.parameter_names,
        covariance=fitted.covariance,
        field=fitted.field,
        sky_rms_deg=math.nan,
        sky_max_deg=math.nan,
        metrics=_make_metrics(fitted, usable, cameras),
        pose=pose_angles(camera.rotation_cam_enu),
        backward=fit_backward(camera),
        evidence=evidence,
        verdict=result.Verdict(accepted=False, findings=(Finding("not_evaluated"),)),
        method=options.method,
        site=job.site,
        mixture=fitted.mixture,
        left_out=np.setdiff1d(np.arange(len(job.points)), usable.index[fitted.used]),
        night=fitted.night,
    )
    calibration = replace_covariance(calibration, 0.5 * (covariance + covariance.T))
    rms, most = sky_sigma_deg(calibration)
    calibration = add_pose_spread(replace(calibration, sky_rms_deg=rms, sky_max_deg=most), fitted.sways_deg)
    known = job.tilt_known or not job.parts  # one that is only compared with others is not asked
    now = replace(usable, pixels=usable.pixels - fitted.displaced)  # as the camera sees them
    verdict = fit_verdict(calibration, now, options, others=others, tilt_known=known)
    return replace(calibration, verdict=verdict)


def tidied(camera: Camera, options: CalibrationOptions) -> Camera:
    """Return the camera with the shortest rotation vector, valid up to the angle that options and projection allow."""
    rotation = rotation_vector(rotation_matrix(camera.rotation_cam_enu))
    return replace(
        camera,
        rotation_cam_enu=rotation,
        max_angle=rising_limit(camera, up_to=math.radians(options.max_angle_deg)),
    )


def _make_metrics(fitted: FitOutcome, usable: Sightings, cameras: list[Camera]) -> result.Metrics:
    angle = np.full(len(usable), np.nan)
    for epoch, camera in enumerate(cameras):
        in_epoch = usable.epoch == epoch
        angle[in_epoch] = result.residual_angles(camera, usable.pixels[in_epoch], usable.directions[in_epoch])
    metrics = result.fit_metrics(fitted.residual, fitted.used, angle)
    if fitted.held_out is None:
        return metrics
    return replace(
        metrics,
        held_out_rmse_px=fitted.held_out.rmse_px,
        held_out_expected_px=fitted.held_out.expected_px,
    )


def _make_provenance(job: Job, fitted: FitOutcome | None = None) -> result.Provenance:
    """Return the evidence of a fit, or its part without one."""
    known = job.points.clock_error_s[np.isfinite(job.points.clock_error_s)]
    none = result.Provenance(
        days=tuple(day_to_date(int(day)).isoformat() for day in np.unique(job.usable.day)),
        n_supplied=len(job.points),
        n_used=0,
        n_rejected=len(job.points),
        options={**asdict(job.options), "free": job.free},
        sigma_px=math.nan,
        inflation=math.nan,
        radial_px=math.nan,
        clock_error_s=float(np.max(np.abs(known))) if known.size else CLOCK_OFFSET_S,
        clock_stated=known.size > 0,
        circle=None if job.circle is None else asdict(job.circle),
        start=None if job.start is None else asdict(job.start.lens_alone()),
    )
    if fitted is None:
        return none
    n_used = int(np.sum(fitted.used))
    return replace(
        none,
        n_used=n_used,
        n_rejected=len(job.points) - n_used,
        sigma_px=fitted.sigma_px,
        inflation=fitted.inflation,
        radial_px=fitted.radial_px,
        log_odds=dict(fitted.log_odds),
        held_out={} if fitted.doubts is None else fitted.doubts._asdict(),
    )


def refused(job: Job, findings: tuple[Finding, ...]) -> result.Calibration:
    """Return the calibration without a fit: the ideal lens, level, with its prior uncertainty."""
    options, circle = job.options, job.circle
    camera, tolerances = level_camera(circle, image_size=job.image_size, options=options), options.tolerances
    prior = lens_prior(camera, tolerances=tolerances, circle=circle, field_angle=math.pi / 2)
    covariance = np.zeros((FREE.size, FREE.size))
    lens = np.isin(FREE, LENS)
    covariance[np.ix_(lens, lens)] = (
        prior.basis / precisions(tolerances.radial_px, tolerances.decentering_px)
    ) @ prior.basis.T
    covariance[POSE, POSE] = _UNKNOWN_POSE * np.eye(3)
    return result.Calibration(
        camera=camera,
        poses=(camera.rotation_cam_enu,),
        parameter_names=FREE_NAMES,
        covariance=covariance,
        field=unseen_field(camera, size=FREE.size),
        sky_rms_deg=180.0,
        sky_max_deg=180.0,
        metrics=result.NO_METRICS,
        pose=pose_angles(camera.rotation_cam_enu),
        backward=NO_BACKWARD,
        evidence=_make_provenance(job),
        verdict=result.Verdict(accepted=False, findings=findings),
        method=options.method,
        site=job.site,
        left_out=np.arange(len(job.points)),
    )


def unseen_field(camera: Camera, *, size: int, amplitude_px: float = 0.0, length_px: float = 0.0) -> Field:
    """Return a field of which nothing is known, with `size` parameters; of amplitude 0 where it has no length."""
    if amplitude_px <= 0.0 or length_px <= 0.0:
        amplitude_px, length_px = 0.0, float(min(camera.width, camera.height))
    basis = wave_basis(width=camera.width, height=camera.height, shortest_px=length_px, longest_px=length_px)
    cross = np.zeros((2, size, len(basis.orders)))
    return Field(amplitude_px=amplitude_px, length_px=length_px, basis=basis, cross=cross)


# From the robust rounds to what every method hands over.


def robust_outcome(fit: FitState, usable: Sightings, options: CalibrationOptions, *, parts: bool = True) -> FitOutcome:
    """Return the cameras of all epochs, and the covariance and field of the last one's.

    `parts`: whether parts of the sightings are held against the fit; its covariance is widened where they ask for it.
    """
    last = fit.problem.n_epochs - 1
    displacement = None if fit.field_mean is None else fit.grid.basis.displacement(fit.field_mean)
    residual = fit.residual
    if displacement is not None:
        residual = residual - displacement.at(usable.pixels - residual)
    cameras = [replace(fit.problem.camera(fit.unknowns, epoch), displacement=displacement) for epoch in range(last + 1)]
    selected = np.r_[np.arange(N_LENS), np.arange(fit.problem.size)[fit.problem.pose_slice(last)]]
    to_parameters = np.zeros((len(Param), N_LENS + 3))
    to_parameters[LENS, :N_LENS] = fit.problem.prior.basis
    to_parameters[POSE, N_LENS:] = _rotation_derivative(cameras[last], tidied(cameras[last], options))
    to_parameters = to_parameters[FREE]
    without = without_parts(fit, usable) if parts or np.unique(usable.day).size > 1 else []
    found = doubts(fit, usable, without) if parts else None
    widening = 1.0 if found is None else found.widening
    field = fit.posterior.field
    field = replace(field, cross=np.stack([to_parameters @ part[selected] for part in field.cross]))
    covariance = to_parameters @ fit.posterior.covariance[np.ix_(selected, selected)] @ to_parameters.T
    return FitOutcome(
        cameras=cameras,
        parameter_names=FREE_NAMES,
        covariance=widening**2 * covariance,
        field=field.widened(widening),
        residual=residual,
        used=fit.noise.weight > 0.0,
        sigma_px=fit.noise.sigma_px,
        inflation=float(np.mean(fit.noise.inflation)) if len(usable) else math.nan,
        radial_px=fit.scales.radial_px,
        held_out=held_out(fit, usable, without),
        log_odds=fit.log_odds | _state_focal_change(fit, usable) | _state_picture_change(fit, usable),
        night=_night_difference(fit, usable),
        mixture=fit.posterior.mixture,
        doubts=found,
        sways_deg=_estimate_sway_deg(fit, usable),
        displaced=_displacement_by_effects(fit, {*SEASONS, PICTURE, TURNING}),
    )


def _estimate_sway_deg(fit: FitState, usable: Sightings) -> tuple[float, float, float]:
    """Return how far the mount stands turned on a day or at an hour, 1-sigma about east, north and up; 0 unproven."""
    if _is_proven(fit, TURNING):
        by_power = fit.unknowns[fit.problem.block_slice(TURNING)].reshape(3, -1) * TURNING_POWERS
        powers = np.linspace(-1.0, 1.0, 49) ** np.arange(1, len(TURNING_POWERS) + 1)[:, None]
        return _float_triple(TURNING_DEG * np.sqrt(np.mean((by_power @ powers) ** 2, axis=1)))
    if not _is_proven(fit, SWAYS):
        return 0.0, 0.0, 0.0
    of_block = fit.problem.block_slice(SWAYS)
    square = (fit.unknowns[of_block] ** 2 + np.diag(fit.posterior.covariance)[of_block]).reshape(-1, 3)
    # runs of several days have their means alone
    return _float_triple(SWAY_DEG * np.sqrt(np.mean(square, axis=0) * np.unique(usable.day).size / len(square)))


def _is_proven(fit: FitState, name: str) -> bool:
    """Return whether the sightings prove a shared error."""
    return name in fit.problem.names and result.proves(name, fit.log_odds.get(name, 0.0))


def _displacement_by_effects(fit: FitState, names: Collection[str]) -> FloatArray:
    """Return (n, 2): by how much the proven ones of some shared errors displace the sightings, px."""
    parts = [
        fit.observed.systematic_px[..., one.columns] @ fit.unknowns[fit.problem.block_slice(one.name)]
        for one in fit.problem.blocks
        if one.name in names and _is_proven(fit, one.name)
    ]
    return np.asarray(np.sum(parts, axis=0)) if parts else np.zeros(fit.residual.shape)


def _state_picture_change(fit: FitState, usable: Sightings) -> dict[str, float]:
    """Return scale and shift of the picture before its change, and the first day after it; nothing unless proven."""
    if not _is_proven(fit, PICTURE):
        return {}
    scale, x, y = fit.unknowns[fit.problem.block_slice(PICTURE)][:3].tolist()
    columns = next(one.columns for one in fit.problem.blocks if one.name == PICTURE)
    since = ~np.any(fit.observed.systematic_px[..., columns], axis=(1, 2))
    return {
        "picture_scale": 1.0 + PICTURE_SCALE * scale,
        "picture_shift_px": PICTURE_PX * math.hypot(x, y),
        "picture_day": float(np.min(usable.day[since])),
    }


def _state_focal_change(fit: FitState, usable: Sightings) -> dict[str, float]:
    """Return the relative change of the focal length within the record; nothing where it is not proven."""
    if not any(_is_proven(fit, name) for name in SEASONS):
        return {}
    away = usable.pixels - fit.residual - np.array(fit.problem.camera(fit.unknowns).principal_point_px)
    square = np.sum(away**2, axis=-1)
    changes = np.sum(_displacement_by_effects(fit, SEASONS) * away, axis=-1) / np.maximum(
        square, float(np.median(square))
    )
    return {"season_share": float(np.ptp(changes[square >= np.median(square)]))}


def _night_difference(fit: FitState, usable: Sightings) -> result.NightDifference | None:
    """Return the systematic errors of the night, as found."""
    pose, star = (fit.problem.block_slice(name) for name in ("night_pose", "night_offset"))
    if "night_pose" not in fit.problem.names:
        return None
    turn, sigma = fit.unknowns[pose], np.sqrt(np.diag(fit.posterior.covariance)[pose])
    radial = slice(star.start, min(star.start + N_RADIAL, star.stop))
    return result.NightDifference(
        n=int(np.sum((fit.noise.weight > 0.0) & usable.night)),
        pose_difference_deg=_float_triple(POSE_DIFFERENCE_DEG * turn),
        pose_sigma_deg=_float_triple(POSE_DIFFERENCE_DEG * sigma),
        star_offset_px=OFFSET_PX * float(np.sum(fit.unknowns[radial])),
        star_offset_sigma_px=OFFSET_PX * math.sqrt(float(np.sum(fit.posterior.covariance[radial, radial]))),
    )


def _float_triple(values: FloatArray) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


def _rotation_derivative(fitted: Camera, tidy: Camera) -> FloatArray:
    """Return the derivative of the tidied rotation vector by the fitted one: both turn the camera alike."""
    return np.asarray(np.linalg.solve(right_jacobian(tidy.rotation_cam_enu), right_jacobian(fitted.rotation_cam_enu)))
