"""From a fit to a calibration: metrics, uncertainty, evidence, verdict."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sunarc.calibration.backward import NO_BACKWARD, fit_backward
from sunarc.calibration.covariance import last_angle, pose_error, sky_sigma_deg
from sunarc.calibration.field import Field, wave_basis
from sunarc.calibration.heldout import held_out_rmse
from sunarc.calibration.metrics import NO_METRICS, Metrics, fit_metrics, residual_angles
from sunarc.calibration.options import CalibrationOptions, ImageCircle
from sunarc.calibration.points import SunPoints, Usable
from sunarc.calibration.priors import FREE_NAMES, LENS, N_LENS, POSE, lens_prior, precisions
from sunarc.calibration.result import Calibration, Evidence, Verdict
from sunarc.calibration.robust import RobustFit
from sunarc.calibration.start import camera_from_circle, camera_from_size
from sunarc.calibration.verdict import Handedness, own_verdict
from sunarc.optics import PARAMETER_NAMES, Camera, pose_angles, rotation_matrix, rotation_vector
from sunarc.optics.pose import right_jacobian
from sunarc.sky import Site

FloatArray = NDArray[np.float64]

_UNKNOWN_POSE = math.pi**2


class Job(NamedTuple):
    """What a calibration was asked for, and the sightings that it can use."""

    points: SunPoints
    usable: Usable
    site: Site
    image_size: tuple[int, int]
    options: CalibrationOptions
    circle: ImageCircle | None


def finished(fit: RobustFit, job: Job, handedness: Handedness) -> Calibration:
    """Return the calibration that a robust fit makes."""
    usable, options = job.usable, job.options
    n_epochs = fit.problem.n_epochs
    cameras = [_tidied(fit.problem.camera(fit.unknowns, e), options) for e in range(n_epochs)]
    camera = cameras[-1]
    metrics = _metrics(fit, usable, cameras)
    covariance, field = _uncertainty(fit, camera, job)
    calibration = Calibration(
        camera=camera,
        poses=tuple(c.rotation_cam_enu for c in cameras),
        parameter_names=FREE_NAMES,
        covariance=covariance,
        field=field,
        sky_rms_deg=math.nan,
        sky_max_deg=math.nan,
        metrics=metrics,
        pose=pose_angles(camera.rotation_cam_enu),
        backward=fit_backward(camera),
        evidence=_evidence(fit, job),
        verdict=Verdict(accepted=False, reasons=("not judged yet",)),
        method="robust",
        site=job.site,
    )
    rms, most = sky_sigma_deg(calibration)
    calibration = replace(calibration, sky_rms_deg=rms, sky_max_deg=most)
    return replace(calibration, verdict=own_verdict(calibration, usable, handedness, options))


def _tidied(camera: Camera, options: CalibrationOptions) -> Camera:
    """Return the camera with the shortest rotation vector, answering as far as it is asked to and can."""
    turn = rotation_vector(rotation_matrix(camera.rotation_cam_enu))
    return replace(
        camera,
        rotation_cam_enu=turn,
        max_angle=last_angle(camera, wanted=math.radians(options.max_angle_deg)),
    )


def _metrics(fit: RobustFit, usable: Usable, cameras: list[Camera]) -> Metrics:
    angle = np.full(len(usable), np.nan)
    for epoch, camera in enumerate(cameras):
        mine = usable.epoch == epoch
        angle[mine] = residual_angles(camera, usable.pixels[mine], usable.directions[mine])
    metrics = fit_metrics(fit.residual, fit.weight > 0.0, angle)
    return replace(metrics, held_out_rmse_px=held_out_rmse(fit, usable))


def _uncertainty(fit: RobustFit, camera: Camera, job: Job) -> tuple[FloatArray, Field]:
    """Return the covariance of the latest epoch's camera in the order of `FREE_NAMES`, and the field."""
    last = fit.problem.n_epochs - 1
    chosen = np.r_[np.arange(N_LENS), np.arange(N_LENS, fit.problem.size)[3 * last : 3 * last + 3]]
    to_parameters = np.zeros((23, N_LENS + 3))
    to_parameters[np.ix_(LENS, np.arange(N_LENS))] = fit.problem.prior.basis
    to_parameters[POSE, N_LENS:] = _turned(fit.problem.camera(fit.unknowns, last), camera)
    to_parameters = to_parameters[[PARAMETER_NAMES.index(name) for name in FREE_NAMES]]
    covariance = to_parameters @ fit.doubt.covariance[np.ix_(chosen, chosen)] @ to_parameters.T
    place = slice(5, 8)
    covariance[place, place] += pose_error(
        camera, job.site, clock_error_s=_clock_error(job.points), site_error_m=job.options.site_error_m
    )
    cross = np.stack([to_parameters @ part[chosen] for part in fit.doubt.cross])
    field = Field(
        amplitude_px=fit.doubted.amplitude_px, length_px=fit.doubted.length_px, basis=fit.grid.basis, cross=cross
    )
    return 0.5 * (covariance + covariance.T), field


def _turned(fitted: Camera, tidied: Camera) -> FloatArray:
    """Return the derivative of the tidied rotation vector by the fitted one: both turn the camera alike."""
    return np.asarray(np.linalg.solve(right_jacobian(tidied.rotation_cam_enu), right_jacobian(fitted.rotation_cam_enu)))


def _clock_error(points: SunPoints) -> float:
    stated = points.clock_error_s[np.isfinite(points.clock_error_s)]
    return float(np.max(np.abs(stated), initial=0.0))


def _evidence(fit: RobustFit, job: Job) -> Evidence:
    n_used = int(np.sum(fit.weight > 0.0))
    return Evidence(
        days=_dates(job.usable),
        n_supplied=len(job.points),
        n_used=n_used,
        n_rejected=len(job.points) - n_used,
        options=asdict(job.options),
        sigma_px=fit.sigma_px,
        inflation=float(np.mean(fit.inflation)),
        radial_px=fit.scales.radial_px,
        clock_error_s=_clock_error(job.points),
    )


def _dates(usable: Usable) -> tuple[str, ...]:
    first = datetime(1970, 1, 1, tzinfo=UTC)
    return tuple((first + timedelta(days=int(day))).date().isoformat() for day in np.unique(usable.day))


def refused(job: Job, reasons: tuple[str, ...]) -> Calibration:
    """Return what is known without a fit: the ideal lens, level, with all of its doubt."""
    options, circle, image_size = job.options, job.circle, job.image_size
    if circle is None:
        camera = camera_from_size(image_size=image_size, options=options)
    else:
        camera = camera_from_circle(circle, image_size=image_size, options=options)
    tolerances = options.tolerances
    prior = lens_prior(camera, tolerances=tolerances, circle=circle, field_angle=math.pi / 2)
    covariance = np.zeros((20, 20))
    lens = np.r_[0:5, 8:20]
    covariance[np.ix_(lens, lens)] = (
        prior.basis / precisions(tolerances.radial_px, tolerances.decentering_px)
    ) @ prior.basis.T
    covariance[5:8, 5:8] = _UNKNOWN_POSE * np.eye(3)
    basis = wave_basis(
        width=image_size[0], height=image_size[1], shortest_px=min(image_size), longest_px=min(image_size)
    )
    return Calibration(
        camera=camera,
        poses=(camera.rotation_cam_enu,),
        parameter_names=FREE_NAMES,
        covariance=covariance,
        field=Field(
            amplitude_px=0.0, length_px=float(min(image_size)), basis=basis, cross=np.zeros((2, 20, len(basis.orders)))
        ),
        sky_rms_deg=180.0,
        sky_max_deg=180.0,
        metrics=NO_METRICS,
        pose=pose_angles(camera.rotation_cam_enu),
        backward=NO_BACKWARD,
        evidence=Evidence(
            days=_dates(job.usable),
            n_supplied=len(job.points),
            n_used=0,
            n_rejected=len(job.points),
            options=asdict(options),
            sigma_px=math.nan,
            inflation=math.nan,
            radial_px=math.nan,
            clock_error_s=_clock_error(job.points),
        ),
        verdict=Verdict(accepted=False, reasons=reasons),
        method=options.method,
        site=job.site,
    )
