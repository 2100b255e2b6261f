"""The three-stage Levenberg-Marquardt fit (section 4.2)."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray, IntArray
from sunarc.calibration.fit.assemble import Fitted, no_field
from sunarc.calibration.least_squares.kernels import FIRST_DAMPING, LARGEST_DAMPING, SMALLEST_DAMPING, damped_step_of
from sunarc.calibration.least_squares.problem import Observations
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.sightings import FilteredSightings
from sunarc.calibration.paper.constraints import Penalties
from sunarc.calibration.paper.dlt import direct_linear_pose
from sunarc.calibration.robust_loss import finite
from sunarc.optics import PARAMETER_NAMES, Camera, Param, angle_limit, project_with_rows_fast
from sunarc.optics.camera import TRANSLATION

_NUDGE = 1e-5
"""p1 and p2 start off 0: at 0 the fit cannot feel p3 and p4."""
_MOST_STEPS = 400
_GAIN = 1e-8
"""Relative gain of the squares below which a stage rests, as MINPACK's `ftol` by default."""
_PERSPECTIVE_EDGE = math.radians(60.0)


def fit_as_paper(
    observed: Observations, usable: FilteredSightings, cameras: list[Camera], *, options: CalibrationOptions
) -> Fitted:
    """Return the paper's fit of the latest pose epoch's sightings: all of them, none weighted.

    Parameters
    ----------
    observed : sightings; those of other epochs are left aside, for the paper knows one pose.
    usable : the same sightings' times.
    cameras : first cameras, one an epoch.
    options : `options.paper` says what the paper leaves open.
    """
    last = len(cameras) - 1
    in_epoch = usable.epoch == last
    one = observed.select(in_epoch)
    camera = _start(cameras[last], one, options)
    last_of_stage = (Param.TRANSLATION_Z, Param.K9, Param.P4)
    for last_moving in last_of_stage:
        moving = np.arange(last_moving + 1)
        if not options.paper.fit_translation:
            moving = np.delete(moving, TRANSLATION)
        if last_moving == Param.P4:
            camera = replace(camera, decentering=(_NUDGE, _NUDGE, 0.0, 0.0))
        camera, jacobian, misfit = _minimised(camera, one, moving, options)
    residual = np.full((len(observed), 2), np.nan)
    residual[in_epoch] = -misfit[: 2 * len(one)].reshape(-1, 2)
    degrees_of_freedom = max(2 * len(one) - moving.size, 1)
    variance = float(np.sum(misfit[: 2 * len(one)] ** 2)) / degrees_of_freedom
    return Fitted(
        cameras=[*cameras[:last], camera],
        parameter_names=tuple(PARAMETER_NAMES[i] for i in moving),
        covariance=variance * _inverse(jacobian),
        field=no_field(camera, size=moving.size),
        residual=np.nan_to_num(residual),
        used=in_epoch,
        sigma_px=math.sqrt(variance),
        inflation=1.0,
        radial_px=math.nan,
        held_out=None,
    )


def _inverse(jacobian: FloatArray) -> FloatArray:
    """Return (J'J)⁻¹ with its columns brought to one size first; what nothing determines comes out large."""
    size = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    scaled = jacobian / size
    inverse = np.linalg.inv(scaled.T @ scaled + 1e-14 * np.eye(size.size))
    return np.asarray(inverse / size[:, None] / size, dtype=np.float64)


def _start(camera: Camera, observed: Observations, options: CalibrationOptions) -> Camera:
    """Return K0 with the pose of the chosen start, without distortion."""
    focal = 0.5 * (camera.focal_length_px[0] + camera.focal_length_px[1])
    plain = replace(camera, focal_length_px=(focal, focal), skew_px=0.0, radial=(0.0,) * 8, decentering=(0.0,) * 4)
    if options.paper.pose_start == "wahba":
        return plain
    posed = direct_linear_pose(plain, observed)
    return posed if options.paper.fit_translation else replace(posed, translation=(0.0, 0.0, 0.0))


class _Equations(NamedTuple):
    """The misfit of Eq. 26 about some parameters: its vector and derivatives, and what the steps are made of."""

    misfit: FloatArray
    jacobian: FloatArray
    normal: FloatArray
    gradient: FloatArray
    cost: float


def _minimised(
    camera: Camera, observed: Observations, moving: IntArray, options: CalibrationOptions
) -> tuple[Camera, FloatArray, FloatArray]:
    """Return the camera at the minimum of Eq. 26, with the Jacobian (n, f) and the residuals there.

    Levenberg-Marquardt on the normal equations, their columns brought to one size.
    """
    unlimited = replace(camera, max_angle=angle_limit(camera.projection) * (1.0 - 1e-6))
    edge = _PERSPECTIVE_EDGE if camera.projection == "perspective" else math.pi / 2
    penalties = Penalties.of(camera.projection, options.paper, largest_angle=edge)
    vector = unlimited.to_vector()
    now = _equations(unlimited, observed, penalties)
    room, step, damping = np.empty((moving.size, moving.size)), np.empty(moving.size), FIRST_DAMPING
    for _ in range(_MOST_STEPS):
        damped_step_of(now.normal, now.gradient, moving, damping, room, step)
        trial = vector.copy()
        trial[moving] += step
        then = _equations(unlimited.with_parameters(trial), observed, penalties)
        if not then.cost <= now.cost:
            damping *= 10.0
            if damping > LARGEST_DAMPING:
                break
            continue
        gain, vector, now = now.cost - then.cost, trial, then
        damping = max(damping * 0.1, SMALLEST_DAMPING)
        if gain <= _GAIN * now.cost:
            break
    found = replace(unlimited.with_parameters(vector), max_angle=camera.max_angle)
    return found, now.jacobian[:, moving], now.misfit


def _equations(camera: Camera, observed: Observations, penalties: Penalties) -> _Equations:
    pixels, rows = project_with_rows_fast(camera, observed.directions)
    values, slopes = penalties.values_and_slopes(camera.to_vector())
    misfit = np.concatenate([finite(pixels - observed.pixels).ravel(), values])
    jacobian = np.concatenate([rows.reshape(-1, slopes.shape[1]), slopes])
    return _Equations(misfit, jacobian, jacobian.T @ jacobian, -(misfit @ jacobian), float(misfit @ misfit))
