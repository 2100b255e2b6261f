"""The last sightings held to a calibration: what it states of its errors, and a mount that wanders, allowed for."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.change_detection.values import SightingWindow, WatchOptions
from sunarc.calibration.least_squares.problem import by_elevation
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.pose.error_model import (
    CameraErrorModel,
    Predicted,
    at_every_angle,
    error_model_of,
    joint_covariance,
    predicted,
)
from sunarc.calibration.pose.gaussian_conditioning import Sightings, false_density
from sunarc.calibration.pose.residuals import noise_px
from sunarc.calibration.robust_loss import finite
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project_with_rows_fast
from sunarc.sky.refraction import ASSUMED_AIR_SD, DAILY_AIR_SD, refraction_rad
from sunarc.sky.site import Site

_WANDER_S = 2.0 * 3600.0
"""Time over which a mast and its mount wander with the sun on them."""
_AIR_SD = math.hypot(ASSUMED_AIR_SD, DAILY_AIR_SD)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ResidualModel:
    """Sightings, a calibration, and how far the two may lie apart when nothing has changed.

    Attributes
    ----------
    watch : the sightings.
    camera, error_model : of the calibration.
    at : where it sees the sun.
    covariance : (2n, 2n) of its errors there, px².
    sightings : the sightings' residuals and noise.
    wander : (n, n) covariance of the mount's wandering between their times, rad².
    air : (2n, 2n) covariance of the sun's places, their air being the assumed one, px².
    """

    watch: SightingWindow
    camera: Camera
    error_model: CameraErrorModel
    at: Predicted
    covariance: FloatArray
    sightings: Sightings
    wander: FloatArray
    air: FloatArray


def window_of(watch: SightingWindow, calibration: Calibration, options: WatchOptions) -> ResidualModel:
    """Return the residual model of sightings about a calibration."""
    error_model, camera = error_model_of(calibration), at_every_angle(calibration.camera)
    at = predicted(error_model, camera, watch.directions)
    residual = finite(watch.pixels - at.pixels)
    wander = wandering(watch.unix_s, options)
    air = _of_air(camera, watch.directions, calibration.site)
    sightings = Sightings(
        residual=residual,
        variance=noise_px(calibration, watch.sigma_px) ** 2,
        false_density=false_density(residual, area_px2=float(camera.width * camera.height)),
    )
    return ResidualModel(
        watch=watch,
        camera=camera,
        error_model=error_model,
        at=at,
        covariance=joint_covariance(error_model, at) + _of_turns(error_model, at, wander) + air,
        sightings=sightings,
        wander=wander,
        air=air,
    )


def errors_at(window: ResidualModel, at: Predicted) -> FloatArray:
    """Return (2n, 2n): the covariance of the calibration's errors where another camera sees the sun."""
    return joint_covariance(window.error_model, at) + _of_turns(window.error_model, at, window.wander) + window.air


def wandering(unix_s: FloatArray, options: WatchOptions) -> FloatArray:
    """Return (n, n): the covariance of a mount's wandering, rad² (Matérn, once differentiable)."""
    # Matern with nu = 3/2 (Rasmussen and Williams 2006, eq. 4.17)
    lag = math.sqrt(3.0) * np.abs(unix_s[:, None] - unix_s) / _WANDER_S
    return np.asarray(math.radians(options.wander_deg) ** 2 * (1.0 + lag) * np.exp(-lag))


def _of_air(camera: Camera, directions: FloatArray, site: Site) -> FloatArray:
    """Return (2n, 2n): the covariance of the sun's places from air that is not the assumed one, alike for all, px²."""
    _, by_parameters = project_with_rows_fast(camera, directions)
    up = np.nan_to_num(by_elevation(camera, directions, by_parameters))
    shift = (up * (_AIR_SD * refraction_rad(directions, site))[:, None]).ravel()
    return np.outer(shift, shift)


def _of_turns(error_model: CameraErrorModel, at: Predicted, wander: FloatArray) -> FloatArray:
    flat = at.rows[..., error_model.rotation].reshape(-1, 3)
    return (flat @ flat.T) * np.kron(wander, np.ones((2, 2)))
