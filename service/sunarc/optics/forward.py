"""From directions to pixels (the paper's section 2.1.3), with analytic derivatives; how the lens scales the sky."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sunarc import _kernels
from sunarc.common.array_types import FloatArray
from sunarc.optics.camera import TRANSLATION, Camera, Param
from sunarc.optics.pose import right_jacobian, rotation_matrix
from sunarc.optics.projections import PROJECTIONS, angle_limit, ideal_radius, ideal_slope

_RIGHT_ANGLE = math.pi / 2


class Optics(NamedTuple):
    """Arguments of the kernels besides a camera's 23 parameters.

    code : of the projection (`projections.PROJECTIONS`). mirror : width - 1 of a mirrored image, negative for one that
    is not. max_angle : angle off the axis up to which it shows anything, radians.
    """

    code: int
    mirror: float
    max_angle: float


def project(camera: Camera, direction_enu: ArrayLike) -> FloatArray:
    """Project directions onto the image.

    Parameters
    ----------
    camera : the camera.
    direction_enu : (..., 3) unit vectors, east-north-up; with a translation, points at sun distance 1.

    Returns
    -------
    (..., 2) pixel (x, y); NaN beyond the camera's `max_angle` and its projection's limit. Pixels outside the image are
    returned as they are.
    """
    direction = np.asarray(direction_enu, dtype=np.float64)
    return project_fast(camera, direction.reshape(-1, 3)).reshape(*direction.shape[:-1], 2)


def project_with_jacobian(camera: Camera, direction_enu: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Project, and differentiate by the parameters and by the direction; NaN where `project` is.

    Returns
    -------
    pixel : (..., 2)
    by_parameters : (..., 2, 23), in the order of `Param`.
    by_direction : (..., 2, 3), by the components of the direction (east, north, up).
    """
    direction = np.asarray(direction_enu, dtype=np.float64)
    pixels, rows = project_with_rows_fast(camera, direction.reshape(-1, 3))
    rows[np.isnan(pixels[:, 0])] = np.nan
    rows = rows.reshape(*direction.shape[:-1], 2, len(Param))
    return pixels.reshape(*direction.shape[:-1], 2), rows, by_direction(camera, rows)


def by_direction(camera: Camera, by_parameters: FloatArray) -> FloatArray:
    """Return derivatives by the direction (..., 2, 3) from those by the parameters (..., 2, 23), px."""
    return np.asarray(by_parameters[..., TRANSLATION] @ rotation_matrix(camera.rotation_cam_enu))


def project_fast(camera: Camera, direction_enu: FloatArray) -> FloatArray:
    """Return pixels as `project` does, for directions (n, 3)."""
    rotation = rotation_matrix(camera.rotation_cam_enu)
    directions = np.ascontiguousarray(direction_enu, dtype=np.float64)
    pixels = _kernels.pixels_of(camera.to_vector(), *kernel_optics(camera), rotation, directions)
    return pixels if camera.displacement is None else pixels + camera.displacement.at(pixels)


def project_with_rows_fast(camera: Camera, direction_enu: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return pixels (n, 2) and derivatives by the parameters (n, 2, 23) of directions (n, 3); rows are 0 beyond."""
    rotation, jacobian = rotation_matrix(camera.rotation_cam_enu), right_jacobian(camera.rotation_cam_enu)
    directions = np.ascontiguousarray(direction_enu, dtype=np.float64)
    vector, optics = camera.to_vector(), kernel_optics(camera)
    pixels, rows = _kernels.pixels_and_rows_of(vector, *optics, rotation, jacobian, directions)
    if camera.displacement is not None:
        shift, slopes = camera.displacement.value_and_slopes(pixels)
        pixels, rows = pixels + shift, rows + slopes @ rows
    return pixels, rows


def kernel_optics(camera: Camera) -> Optics:
    """Return projection, mirror and largest angle as the kernels take them; the displacement does not count."""
    limit = min(camera.max_angle, math.nextafter(angle_limit(camera.projection), 0.0))
    return Optics(PROJECTIONS[camera.projection].code, mirror_offset(camera), limit)


def mirror_offset(camera: Camera) -> float:
    """Return the number from which the kernels subtract x: width - 1 of a mirrored image, -1 of another."""
    return camera.width - 1.0 if camera.mirrored else -1.0


def distorted_radius(camera: Camera, theta: ArrayLike) -> FloatArray:
    """Return the normalised radius of Eq. 9 at angles off the axis in radians."""
    angle = np.asarray(theta, dtype=np.float64)
    coefficients = np.array([0.0, 0.0, *camera.radial])
    residual = np.polynomial.polynomial.polyval(angle / _RIGHT_ANGLE, coefficients)
    return np.asarray(ideal_radius(camera.projection, angle) + residual)


def radius_slope(camera: Camera, theta: ArrayLike) -> FloatArray:
    """Return the derivative of `distorted_radius`, per radian."""
    angle = np.asarray(theta, dtype=np.float64)
    slope = np.polynomial.polynomial.polyder(np.array([0.0, 0.0, *camera.radial]))
    return (
        ideal_slope(camera.projection, angle)
        + np.polynomial.polynomial.polyval(angle / _RIGHT_ANGLE, slope) / _RIGHT_ANGLE
    )


def decentering_shift(
    coefficients: ArrayLike, radius: FloatArray, u: FloatArray, v: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return Eq. 12 (p1 … p4) or Eq. 14 (q1 … q5): the shift in focal lengths at radius r along (u, v).

    Parameters
    ----------
    coefficients : first two of the direction, the rest of the even powers r^4, r^6, ….
    radius : (...) in focal lengths.
    u, v : (...) cosine and sine of the angle about the axis.
    """
    first, second, *higher = (float(c) for c in np.asarray(coefficients))
    square = radius**2
    profile = square * np.polynomial.polynomial.polyval(square, np.array([1.0, *higher]))
    return (
        profile * (first * (1.0 + 2.0 * u * u) + 2.0 * second * u * v),
        profile * (2.0 * first * u * v + second * (1.0 + 2.0 * v * v)),
    )


def decentering_slopes(coefficients: ArrayLike, radius: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
    """Return (..., 2, k): derivatives of `decentering_shift` by its k coefficients; arguments as there."""
    first, second, *higher = (float(c) for c in np.asarray(coefficients))
    square = radius**2
    profile = square * np.polynomial.polynomial.polyval(square, np.array([1.0, *higher]))
    by_first = np.stack([1.0 + 2.0 * u * u, 2.0 * u * v], axis=-1)
    by_second = np.stack([2.0 * u * v, 1.0 + 2.0 * v * v], axis=-1)
    bracket = first * by_first + second * by_second
    slopes = [profile[..., None] * by_first, profile[..., None] * by_second]
    slopes += [(square**power)[..., None] * bracket for power in range(2, 2 + len(higher))]
    return np.stack(slopes, axis=-1)


def local_stretch(camera: Camera, direction_enu: ArrayLike) -> FloatArray:
    """Return the 2×2 matrix that takes small angles on the sphere to pixels.

    Parameters
    ----------
    camera : the camera.
    direction_enu : (..., 3) unit vectors, east-north-up.

    Returns
    -------
    (..., 2, 2) px per radian, from some orthonormal basis of the tangent plane: a round disc of angular radius a
    lands on the ellipse {a M e, |e| = 1}, whatever the basis. NaN beyond the projection's own limit.
    """
    direction = np.asarray(direction_enu, dtype=np.float64)
    _, _, by_direction = project_with_jacobian(camera, direction)
    return np.asarray(by_direction @ tangent_basis(direction))


def tangent_basis(direction_enu: FloatArray) -> FloatArray:
    """Return (..., 3, 2): two unit vectors orthogonal to each direction and to each other, without a seam."""
    helper = np.where(np.abs(direction_enu[..., 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    first = np.cross(helper, direction_enu)
    first = first / np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, np.cross(direction_enu, first)], axis=-1)


def rising_limit(camera: Camera, *, up_to: float) -> float:
    """Return the angle in radians, at most `up_to`, up to which the lens's radius rises with the angle."""
    limit = min(up_to, angle_limit(camera.projection) * (1.0 - 1e-6))
    theta = np.linspace(0.0, limit, 2001)
    falling = np.flatnonzero(radius_slope(camera, theta) <= 0.0)
    return float(theta[falling[0] - 1]) if falling.size and falling[0] > 0 else limit


_LEAST_RESOLVED = 0.1
"""Share of the pixels of a degree at the center from which on a lens resolves angles off the axis."""


def resolved_limit(camera: Camera) -> float:
    """Return the angle in radians, at most `max_angle`, beyond which the lens's radius hardly grows with the angle.

    That of an orthographic lens stands still at 90 degrees: there a pixel is several degrees of sky, and more than a
    tenth of the center's slope is what errors of a hundredth of the focal length need to be linear.
    """
    theta = np.linspace(0.0, camera.max_angle, 2001)
    resolved = np.flatnonzero(radius_slope(camera, theta) > _LEAST_RESOLVED)
    return float(theta[resolved[-1]]) if resolved.size else camera.max_angle
