"""Many directions and pixels at once: the compiled forward model, and the inverse from a one-dimensional table."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sunarc.optics.camera import Camera
from sunarc.optics.forward import decentering_shift, distorted_radius, radius_slope
from sunarc.optics.inverse import unproject
from sunarc.optics.kernels import PROJECTION_CODES, directions_of, pixels_and_rows_of, pixels_of
from sunarc.optics.pose import right_jacobian, rotation_matrix
from sunarc.optics.projections import angle_limit
from sunarc.optics.stretch import rising_limit

FloatArray = NDArray[np.float64]

_PIECES = 1024
_NEWTON = 12
_TABLE_ERROR = 3e-10
_SMALLEST_ERROR = 1e-10
_MOST_ROUNDS = 60


def project_fast(camera: Camera, direction_enu: FloatArray) -> FloatArray:
    """Return what `project` returns for directions (n, 3), compiled."""
    rotation = rotation_matrix(camera.rotation_cam_enu)
    code = PROJECTION_CODES[camera.projection]
    directions = np.ascontiguousarray(direction_enu, dtype=np.float64)
    return np.asarray(pixels_of(camera.to_vector(), code, _mirror(camera), camera.max_angle, rotation, directions))


def project_with_rows_fast(camera: Camera, direction_enu: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return pixels (n, 2) and derivatives by the parameters (n, 2, 23) of directions (n, 3), compiled.

    As `project_with_jacobian`, without the derivatives by the direction; beyond the largest angle the rows are 0.
    """
    rotation = rotation_matrix(camera.rotation_cam_enu)
    turn = right_jacobian(camera.rotation_cam_enu)
    code = PROJECTION_CODES[camera.projection]
    directions = np.ascontiguousarray(direction_enu, dtype=np.float64)
    vector, mirror = camera.to_vector(), _mirror(camera)
    pixels, rows = pixels_and_rows_of(vector, code, mirror, camera.max_angle, rotation, turn, directions)
    return pixels, rows


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class InverseTable:
    """A camera's inverse, ready for many pixels: cubic pieces of sin(θ)/r and cos(θ) over the radius r.

    Attributes
    ----------
    camera : the camera.
    constants : (12,) inverse focal lengths, skew, principal point, mirror, p1 … p4, pieces per radius, largest radius.
    rotation : (3, 3) from east-north-up to the camera.
    pieces : (n, 8) coefficients.
    exact_below : cosine of the angle off the axis below which the lens hardly rises and the table is too coarse:
        there the exact inverse answers.
    rounds : fixed-point rounds that take out the decentering.
    """

    constants: FloatArray
    camera: Camera
    rotation: FloatArray
    pieces: FloatArray
    exact_below: float
    rounds: int

    def directions(self, pixels: ArrayLike) -> FloatArray:
        """Return what `unproject` returns for pixels (..., 2), to about 1e-8 px."""
        pixel = np.ascontiguousarray(pixels, dtype=np.float64)
        result = np.empty((*pixel.shape[:-1], 3))
        self.write_directions(pixel, result)
        return result

    def write_directions(self, pixels: FloatArray, result: FloatArray) -> None:
        """Write into `result` (..., 3) what `directions` returns; both arrays are contiguous."""
        flat, into = pixels.reshape(-1, 2), result.reshape(-1, 3)
        directions_of(self.constants, self.rotation, self.pieces, self.rounds, flat, into)
        if self.exact_below > -1.0:
            steep = into @ self.rotation[2] < self.exact_below
            if np.any(steep):
                into[steep] = unproject(self.camera, flat[steep])


def inverse_table(camera: Camera) -> InverseTable:
    """Return the table of a camera."""
    limit = min(camera.max_angle, angle_limit(camera.projection) * (1.0 - 1e-9))
    limit = rising_limit(camera, up_to=limit)
    largest = float(distorted_radius(camera, limit))
    radius = np.linspace(0.0, largest, _PIECES + 1)
    theta = _angles(camera, radius, limit)
    slope = 1.0 / radius_slope(camera, theta)
    safe = np.where(radius > 0.0, radius, 1.0)
    scale = np.where(radius > 0.0, np.sin(theta) / safe, slope[0])
    scale_slope = np.where(radius > 0.0, (np.cos(theta) * slope - scale) / safe, 0.0)
    scale_slope[0] = _first_slope(camera, slope[0])
    cosine, cosine_slope = np.cos(theta), -np.sin(theta) * slope
    step = largest / _PIECES
    pieces = np.concatenate([_cubic(scale, scale_slope * step), _cubic(cosine, cosine_slope * step)], axis=1)
    ax, ay = camera.focal_length_px
    x0, y0 = camera.principal_point_px
    constants = np.array(
        [
            1.0 / ax,
            1.0 / ay,
            camera.skew_px,
            x0,
            y0,
            _mirror(camera),
            *camera.decentering,
            1.0 / step,
            largest * (1.0 + 1e-12),
        ]
    )
    return InverseTable(
        camera=camera,
        constants=constants,
        rotation=rotation_matrix(camera.rotation_cam_enu),
        pieces=np.ascontiguousarray(pieces),
        exact_below=_exact_below(camera, pieces, radius, limit),
        rounds=_rounds(camera, largest),
    )


def _exact_below(camera: Camera, pieces: FloatArray, radius: FloatArray, limit: float) -> float:
    """Return the cosine at the first piece whose middle is off by more than a billionth; -1 where there is none."""
    middle = 0.5 * (radius[1:] + radius[:-1])
    half = 0.5 ** np.arange(4)
    theta = _angles(camera, middle, limit)
    off = np.abs(pieces[:, :4] @ half * middle - np.sin(theta)) + np.abs(pieces[:, 4:] @ half - np.cos(theta))
    coarse = np.flatnonzero(off > _TABLE_ERROR)
    return math.cos(float(_angles(camera, radius[coarse[:1]], limit)[0])) if coarse.size else -1.0


def _mirror(camera: Camera) -> float:
    return camera.width - 1.0 if camera.mirrored else -1.0


def _angles(camera: Camera, radius: FloatArray, limit: float) -> FloatArray:
    grid = np.linspace(0.0, limit, 1025)
    theta = np.interp(radius, distorted_radius(camera, grid), grid)
    for _ in range(_NEWTON):
        theta = theta - (distorted_radius(camera, theta) - radius) / radius_slope(camera, theta)
        theta = np.clip(theta, 0.0, limit)
    return np.asarray(theta)


def _first_slope(camera: Camera, inverse_slope: float) -> float:
    """Return d(sin θ / r)/dr on the axis, where r = aθ + bθ² + …: -b / a³."""
    quadratic = camera.radial[0] / (math.pi / 2) ** 2
    return -quadratic * inverse_slope**3


def _cubic(value: FloatArray, slope: FloatArray) -> FloatArray:
    """Return (n, 4): the Hermite cubics between knots, for a place from 0 to 1."""
    rise = value[1:] - value[:-1]
    return np.stack(
        [value[:-1], slope[:-1], 3.0 * rise - 2.0 * slope[:-1] - slope[1:], slope[:-1] + slope[1:] - 2.0 * rise],
        axis=1,
    )


def _rounds(camera: Camera, largest: float) -> int:
    """Return how many fixed-point rounds bring the decentering's error below 1e-10 focal lengths, as tried out."""
    if not any(camera.decentering[:2]):
        return 0
    radius, azimuth = np.meshgrid(np.linspace(0.1, 1.0, 7) * largest, np.linspace(0.0, 2.0 * math.pi, 24))
    x_hat, y_hat = radius * np.cos(azimuth), radius * np.sin(azimuth)
    x, y = x_hat, y_hat
    for number in range(1, _MOST_ROUNDS):
        r = np.hypot(x, y)
        shift_x, shift_y = decentering_shift(camera.decentering, r, x / r, y / r)
        change = float(np.max(np.hypot(x_hat - shift_x - x, y_hat - shift_y - y)))
        if change < _SMALLEST_ERROR:
            return number - 1
        x, y = x_hat - shift_x, y_hat - shift_y
    return _MOST_ROUNDS
