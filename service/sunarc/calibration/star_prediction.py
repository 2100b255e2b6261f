"""Pixels of the stars that a calibration predicts."""

from __future__ import annotations

import numpy as np

from sunarc.calibration.model.backward import camera_sees
from sunarc.calibration.model.covariance import project_with_covariance, sigma_px
from sunarc.calibration.model.result import Calibration
from sunarc.detection.stars.values import PredictedStars
from sunarc.sky import NightSky, angles_from_direction, relative_air_mass

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
    zenith, azimuth = angles_from_direction(sky.directions)
    camera = calibration.camera
    inside = np.all((pixels > -0.5) & (pixels < np.array([camera.width, camera.height]) - 0.5), axis=-1)
    visible = inside & camera_sees(camera, pixels) & (zenith < furthest_deg)
    magnitude = sky.magnitude + _EXTINCTION * (relative_air_mass(zenith) - 1.0)
    return PredictedStars(
        names=sky.names,
        pixels=pixels,
        sigma_px=np.hypot(sigma_px(covariance), within_px),
        magnitude=magnitude,
        azimuth_deg=azimuth,
    ).select(visible)
