"""By how much a camera stood turned on a day, against its calibration: the slow drift of masts and mounts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, cholesky

from sunarc.array_types import FloatArray
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import SunPoints, filter_sightings
from sunarc.calibration.pose.error_model import (
    CameraErrorModel,
    at_every_angle,
    error_model_of,
    joint_covariance,
    predicted,
)
from sunarc.calibration.pose.estimate_pose import fit_pose
from sunarc.calibration.pose.residuals import PredictedSightings, gathered, inflation, noise_px
from sunarc.calibration.robust_loss import finite
from sunarc.optics.camera import Camera
from sunarc.optics.pose import rotation_matrix
from sunarc.sky.site import Site

_FEWEST = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseOffset:
    """A small turn of the camera against its calibration.

    Attributes
    ----------
    turn_deg : about the axes to the east, to the north and up, degrees, right-handed: positive about "up" turns the
        camera counter-clockwise as seen from above.
    sigma_deg : 1-sigma of each.
    n : sightings that it rests on.
    """

    turn_deg: tuple[float, float, float]
    sigma_deg: tuple[float, float, float]
    n: int


def daily_pose_offset(points: SunPoints, *, calibration: Calibration, site: Site) -> PoseOffset | None:
    """Return the mean rotation of a camera on a day; None with fewer than 20 inliers.

    The lens is the calibration's; what that says of its own errors along the day's track widens the sigmas.

    Parameters
    ----------
    points : sightings of one day and one pose epoch.
    calibration : what they are compared with.
    site : where the camera stands.
    """
    usable = filter_sightings(points, site=site)
    if len(usable) < _FEWEST:
        return None
    sigma_px = noise_px(calibration, points.sigma_px[usable.index])
    inlier = fit_pose(calibration, usable.directions, usable.pixels, sigma_px).inlier
    if inlier.sum() < _FEWEST:
        return None
    sightings = PredictedSightings(
        directions=usable.directions,
        pixels=usable.pixels,
        variance=sigma_px**2,
        false_density=np.zeros(len(usable)),
    )
    camera = at_every_angle(calibration.camera)
    together = gathered(camera, sightings, inlier, inflation=inflation(calibration))
    rotation, covariance = _rotation(error_model_of(calibration), camera, together)
    to_enu = -rotation_matrix(camera.rotation_cam_enu).T  # a camera that turns one way sees the sky turn the other
    sigma = np.sqrt(np.diag(to_enu @ covariance @ to_enu.T))
    (east, north, up), (s_east, s_north, s_up) = np.degrees(to_enu @ rotation).tolist(), np.degrees(sigma).tolist()
    return PoseOffset(turn_deg=(east, north, up), sigma_deg=(s_east, s_north, s_up), n=int(inlier.sum()))


def _rotation(
    error_model: CameraErrorModel, camera: Camera, sightings: PredictedSightings
) -> tuple[FloatArray, FloatArray]:
    """Return the turn (3,) about the camera's axes by generalised least squares, and its covariance (3, 3)."""
    at = predicted(error_model, camera, sightings.directions)
    rows = at.rows[..., error_model.rotation].reshape(-1, 3)
    total = joint_covariance(error_model, at) + np.diag(np.repeat(sightings.variance, 2))
    weighed = cho_solve((cholesky(total, lower=True), True), rows)
    covariance = np.asarray(np.linalg.inv(rows.T @ weighed), dtype=np.float64)
    return covariance @ (weighed.T @ finite(sightings.pixels - at.pixels).ravel()), covariance
