"""The paper's penalties (section 4.2): c1 orthogonality, c2 circularity, c3 monotony."""

from __future__ import annotations

import math

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.model.options import PaperOptions
from sunarc.optics import Camera, ideal_radius
from sunarc.optics.camera import RADIAL_ORDERS
from sunarc.optics.forward import decentering_shift, distorted_radius, radius_slope

_ANGLES = 181
_AZIMUTHS = 24
_RIGHT_ANGLE = math.pi / 2


def penalties(camera: Camera, options: PaperOptions, *, largest_angle: float) -> FloatArray:
    """Return the penalty vector ε_c of Eq. 26, px.

    c2 is taken as the vector of the radius's deviations over √n, whose square is the paper's and which is smooth at 0.

    Parameters
    ----------
    camera : the camera as it stands in the iteration.
    options : weights and the scope of c2.
    largest_angle : θ_max, radians.
    """
    theta = np.linspace(0.0, largest_angle, _ANGLES)
    ideal = ideal_radius(camera.projection, theta)
    powers = (theta / _RIGHT_ANGLE)[:, None] ** np.array(RADIAL_ORDERS)
    orthogonality = np.trapezoid(ideal[:, None] * powers, theta, axis=0) @ np.array(camera.radial)
    # c3 is one-sided: a radius that rises costs nothing, however fast
    falling = np.minimum(radius_slope(camera, theta), 0.0)
    return np.concatenate(
        [
            [options.orthogonality_weight * orthogonality],
            options.circularity_weight * _out_of_round(camera, options, largest_angle),
            options.monotony_weight * falling / math.sqrt(_ANGLES),
        ]
    )


def _out_of_round(camera: Camera, options: PaperOptions, largest_angle: float) -> FloatArray:
    azimuth = np.linspace(0.0, 2.0 * math.pi, _AZIMUTHS, endpoint=False)
    u, v = np.cos(azimuth), np.sin(azimuth)
    radius = np.full(_AZIMUTHS, float(distorted_radius(camera, largest_angle)))
    x_hat, y_hat = radius * u, radius * v
    if options.ellipse_scope == "with_decentering":
        shift_x, shift_y = decentering_shift(camera.decentering, radius, u, v)
        x_hat, y_hat = x_hat + shift_x, y_hat + shift_y
    x = camera.focal_length_px[0] * x_hat + camera.skew_px * y_hat
    distance = np.hypot(x, camera.focal_length_px[1] * y_hat)
    return np.asarray((distance - distance.mean()) / math.sqrt(_AZIMUTHS))
