"""The three-stage Levenberg-Marquardt fit (section 4.2)."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray, IntArray
from sunarc.calibration.fit.assemble import Fitted, no_field
from sunarc.calibration.least_squares.kernels import FIRST_DAMPING
from sunarc.calibration.least_squares.problem import Observations
from sunarc.calibration.least_squares.solve import as_seen
from sunarc.calibration.least_squares.time_bins import Bins, time_bins
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.sightings import FilteredSightings
from sunarc.calibration.paper.constraints import Penalties
from sunarc.calibration.paper.dlt import direct_linear_pose
from sunarc.calibration.paper.kernels import Limits, Optics, minimised
from sunarc.calibration.robust_loss import finite
from sunarc.optics.camera import PARAMETER_NAMES, TRANSLATION, Camera, Param
from sunarc.optics.forward import kernel_lens, project_fast, project_with_rows_fast
from sunarc.optics.projections import angle_limit

_NUDGE = 1e-5
"""p1 and p2 start off 0: at 0 the fit cannot feel p3 and p4."""
_STAGE = Limits(400, 1e-8, FIRST_DAMPING)
"""Relative gain of the squares below which a stage rests: as MINPACK's `ftol` by default."""
_LAST_STEPS = Limits(10, 1e-8, 1e-8)
"""From the minimum of the means to that of all sightings, some hundredths of a sigma."""
_PERSPECTIVE_EDGE = math.radians(60.0)


def fit_as_paper(
    observed: Observations,
    usable: FilteredSightings,
    cameras: list[Camera],
    *,
    options: CalibrationOptions,
    quickly: bool = False,
) -> Fitted:
    """Return the paper's fit of the latest pose epoch's sightings: all of them, none weighted.

    Parameters
    ----------
    observed : sightings; those of other epochs are left aside, for the paper knows one pose.
    usable : the same sightings' times.
    cameras : first cameras, one an epoch.
    options : `options.paper` says what the paper leaves open.
    quickly : whether the stages' minima are sought on the means of neighbouring sightings, each as heavy as its members
        together, and only the last one is brought to rest on all sightings. Where Eq. 26 has several minima (p3 and p4
        that hardly count), another one may be found.
    """
    last = len(cameras) - 1
    in_epoch = usable.epoch == last
    one = observed.select(in_epoch).weighted(np.ones(int(np.sum(in_epoch))))
    bins = time_bins(usable).select(in_epoch) if quickly else None
    camera = _start(cameras[last], one, options)
    last_of_stage = (Param.TRANSLATION_Z, Param.K9, Param.P4)
    for last_moving in last_of_stage:
        moving = np.arange(last_moving + 1)
        if not options.paper.fit_translation:
            moving = np.delete(moving, TRANSLATION)
        if last_moving == Param.P4:
            camera = replace(camera, decentering=(_NUDGE, _NUDGE, 0.0, 0.0))
        sample = one if bins is None else _means(one, bins, camera)
        camera = _minimised(camera, sample, moving, options, _STAGE)
    if bins is not None:
        camera = _minimised(camera, one, moving, options, _LAST_STEPS)
    misfit, jacobian = equations(camera, one, options)
    residual = np.full((len(observed), 2), np.nan)
    residual[in_epoch] = -misfit[: 2 * len(one)].reshape(-1, 2)
    degrees_of_freedom = max(2 * len(one) - moving.size, 1)
    variance = float(np.sum(misfit[: 2 * len(one)] ** 2)) / degrees_of_freedom
    return Fitted(
        cameras=[*cameras[:last], camera],
        parameter_names=tuple(PARAMETER_NAMES[i] for i in moving),
        covariance=variance * _inverse(jacobian[:, moving]),
        field=no_field(camera, size=moving.size),
        residual=np.nan_to_num(residual),
        used=in_epoch,
        sigma_px=math.sqrt(variance),
        inflation=1.0,
        radial_px=math.nan,
        held_out=None,
    )


def _means(observed: Observations, bins: Bins, camera: Camera) -> Observations:
    """Return one observation a bin, its residual by a camera the mean one; all of them where one is not in view."""
    residual = observed.pixels - project_fast(camera, observed.directions)
    if not np.all(np.isfinite(residual)):
        return observed
    gathered, mean = bins.gathered(observed, residual, observed.information)
    return replace(gathered, pixels=project_fast(camera, gathered.directions) + mean)


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


class Equations(NamedTuple):
    """The misfit of Eq. 26 about some parameters: its vector (n,) and derivatives (n, 23)."""

    misfit: FloatArray
    jacobian: FloatArray


def _minimised(
    camera: Camera, observed: Observations, moving: IntArray, options: CalibrationOptions, limits: Limits
) -> Camera:
    """Return the camera at the minimum of Eq. 26.

    Levenberg-Marquardt on the normal equations, their columns brought to one size.
    """
    _, code, mirror, max_angle = kernel_lens(_unlimited(camera))
    optics, weighed = Optics(code, mirror, max_angle), _penalties(camera, options).weighed()
    vector = minimised(optics, as_seen(observed), weighed, camera.to_vector(), moving, limits)
    return camera.with_parameters(vector)


def _unlimited(camera: Camera) -> Camera:
    return replace(camera, max_angle=angle_limit(camera.projection) * (1.0 - 1e-6))


def _penalties(camera: Camera, options: CalibrationOptions) -> Penalties:
    edge = _PERSPECTIVE_EDGE if camera.projection == "perspective" else math.pi / 2
    return Penalties.of(camera.projection, options.paper, largest_angle=edge)


def equations(camera: Camera, observed: Observations, options: CalibrationOptions) -> Equations:
    """Return the misfit of a camera that answers at any angle, each sighting weighed by its information."""
    pixels, rows = project_with_rows_fast(_unlimited(camera), observed.directions)
    values, slopes = _penalties(camera, options).values_and_slopes(camera.to_vector())
    root = np.sqrt(observed.information)[:, None]
    misfit = np.concatenate([(root * finite(pixels - observed.pixels)).ravel(), values])
    return Equations(misfit, np.concatenate([(root[..., None] * rows).reshape(-1, slopes.shape[1]), slopes]))
