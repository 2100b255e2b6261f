"""Pixels of the stars that a calibration predicts."""

from __future__ import annotations

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.model.backward import camera_sees
from sunarc.calibration.model.covariance import project_with_covariance, sigma_px
from sunarc.calibration.model.result import Calibration
from sunarc.detection.stars.values import PredictedStars
from sunarc.optics.camera import Camera
from sunarc.sky.air import relative_air_mass
from sunarc.sky.directions import angles_from_direction
from sunarc.sky.night import NightSky

_EXTINCTION = 0.25
"""Magnitudes an air mass, of a clear sky in the visible: Rayleigh scattering 0.1, and as much and more of aerosol."""


def predict_stars(
    calibration: Calibration, sky: NightSky, *, within_px: float = 0.0, furthest_deg: float = 85.0
) -> PredictedStars:
    """Return where a calibration sees the stars of a moment.

    Parameters
    ----------
    calibration : the camera, and how sure one is of it.
    sky : stars and planets above the horizon.
    within_px : 1-sigma that is added to the prediction's, px.
    furthest_deg : stars further from the zenith are left out: the refraction of the horizon, and trees.

    Returns
    -------
    Those within the image, as in `sky`: the brightest first.
    """
    pixels, covariance = project_with_covariance(calibration, sky.directions)
    sigma = np.hypot(sigma_px(covariance), within_px)
    return stars_in_image(calibration.camera, sky, pixels, sigma, furthest_deg=furthest_deg)


def stars_in_image(
    camera: Camera, sky: NightSky, pixels: FloatArray, sigma: FloatArray, *, furthest_deg: float = 85.0
) -> PredictedStars:
    """Return the stars within a camera's image, of their pixels (n, 2) and 1-sigmas (n,) px; the brightest first."""
    zenith, azimuth = angles_from_direction(sky.directions)
    inside = np.all((pixels > -0.5) & (pixels < np.array([camera.width, camera.height]) - 0.5), axis=-1)
    visible = inside & camera_sees(camera, pixels) & (zenith < furthest_deg)
    magnitude = sky.magnitude + _EXTINCTION * (relative_air_mass(zenith) - 1.0)
    return PredictedStars(
        names=sky.names,
        pixels=pixels,
        sigma_px=sigma,
        magnitude=magnitude,
        azimuth_deg=azimuth,
    ).select(visible)
