"""From the robust rounds to what every method hands over."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.fit.assemble import Fitted, tidied
from sunarc.calibration.fit.cross_validation import doubts, held_out
from sunarc.calibration.fit.robust_fit import RobustFit
from sunarc.calibration.fit.systematic_errors import N_OFFSET, N_RADIAL, OFFSET_PX, POSE_DIFFERENCE_DEG
from sunarc.calibration.least_squares.priors import FREE, FREE_NAMES, LENS, N_LENS
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import NightDifference
from sunarc.calibration.model.sightings import FilteredSightings
from sunarc.optics.camera import POSE, Camera, Param
from sunarc.optics.displacement import Displacement
from sunarc.optics.pose import right_jacobian


def robust_outcome(
    fit: RobustFit, usable: FilteredSightings, options: CalibrationOptions, *, parts: bool = True
) -> Fitted:
    """Return the cameras of all epochs, and the covariance and field of the last one's.

    `parts`: whether parts of the sightings are held against the fit; its covariance is widened where they ask for it.
    """
    last = fit.problem.n_epochs - 1
    displacement = None if fit.field_mean is None else fit.grid.basis.displacement(fit.field_mean)
    cameras = [replace(fit.problem.camera(fit.unknowns, epoch), displacement=displacement) for epoch in range(last + 1)]
    selected = np.r_[np.arange(N_LENS), np.arange(fit.problem.size)[fit.problem.pose_slice(last)]]
    to_parameters = np.zeros((len(Param), N_LENS + 3))
    to_parameters[LENS, :N_LENS] = fit.problem.prior.basis
    to_parameters[POSE, N_LENS:] = _rotation_derivative(cameras[last], tidied(cameras[last], options))
    to_parameters = to_parameters[FREE]
    found = doubts(fit, usable) if parts else None
    widening = 1.0 if found is None else found.widening
    field = fit.posterior.field
    field = replace(field, cross=np.stack([to_parameters @ part[selected] for part in field.cross]))
    covariance = to_parameters @ fit.posterior.covariance[np.ix_(selected, selected)] @ to_parameters.T
    return Fitted(
        cameras=cameras,
        parameter_names=FREE_NAMES,
        covariance=widening**2 * covariance,
        field=field.widened(widening),
        residual=fit.residual if displacement is None else _beside(fit.residual, displacement, usable.pixels),
        used=fit.weight > 0.0,
        sigma_px=fit.sigma_px,
        inflation=float(np.mean(fit.inflation)) if fit.inflation.size else math.nan,
        radial_px=fit.scales.radial_px,
        held_out=held_out(fit, usable),
        log_odds=fit.log_odds,
        night=_night_difference(fit, usable),
        doubts=found,
    )


def _night_difference(fit: RobustFit, usable: FilteredSightings) -> NightDifference | None:
    """Return the systematic errors of the night, as found."""
    if fit.problem.n_systematic == 0:
        return None
    part = fit.problem.systematic_slice
    offset, turn = np.split(fit.unknowns[part], [N_OFFSET])
    covariance = fit.posterior.covariance[part, part]
    sigma = np.sqrt(np.diag(covariance)[N_OFFSET:])
    return NightDifference(
        n=int(np.sum((fit.weight > 0.0) & usable.night)),
        pose_difference_deg=_three(POSE_DIFFERENCE_DEG * turn),
        pose_sigma_deg=_three(POSE_DIFFERENCE_DEG * sigma),
        star_offset_px=OFFSET_PX * float(np.sum(offset[:N_RADIAL])),
        star_offset_sigma_px=OFFSET_PX * math.sqrt(float(np.sum(covariance[:N_RADIAL, :N_RADIAL]))),
    )


def _three(values: FloatArray) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


def _beside(residual: FloatArray, displacement: Displacement, pixels: FloatArray) -> FloatArray:
    """Return what the lens leaves over (n, 2) without the displacement there."""
    return np.asarray(residual - displacement.at(pixels - residual))


def _rotation_derivative(fitted: Camera, tidy: Camera) -> FloatArray:
    """Return the derivative of the tidied rotation vector by the fitted one: both turn the camera alike."""
    return np.asarray(np.linalg.solve(right_jacobian(tidy.rotation_cam_enu), right_jacobian(fitted.rotation_cam_enu)))
