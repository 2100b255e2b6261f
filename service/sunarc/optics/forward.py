"""From directions to pixels (the paper's section 2.1.3), with analytic derivatives."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sunarc.optics.camera import PARAMETER_NAMES, RADIAL_ORDERS, Camera
from sunarc.optics.pose import right_jacobian, rotation_matrix
from sunarc.optics.projections import angle_limit, ideal_radius, ideal_slope

FloatArray = NDArray[np.float64]

_RIGHT_ANGLE = math.pi / 2
_ON_AXIS = 1e-12


class _Ray(NamedTuple):
    """A direction in the camera frame, and what the lens makes of it, each (...)."""

    vector: FloatArray
    norm_xy: FloatArray
    theta: FloatArray
    u: FloatArray
    v: FloatArray
    radius: FloatArray


def project(camera: Camera, direction_enu: ArrayLike) -> FloatArray:
    """Project directions onto the image.

    Parameters
    ----------
    camera : the camera.
    direction_enu : (..., 3) unit vectors, east-north-up; with a translation, points at sun distance 1.

    Returns
    -------
    (..., 2) pixel (x, y); NaN beyond the camera's `max_angle`. Pixels outside the image are returned as they are.
    """
    ray = _ray(camera, direction_enu)
    return _to_pixels(camera, *_calibrated(camera, ray), ray.theta)


def project_with_jacobian(camera: Camera, direction_enu: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Project, and differentiate by the parameters and by the direction.

    Returns
    -------
    pixel : (..., 2)
    by_parameters : (..., 2, 23), in the order of `PARAMETER_NAMES`.
    by_direction : (..., 2, 3), by the components of the direction (east, north, up).
    """
    ray = _ray(camera, direction_enu)
    x_hat, y_hat = _calibrated(camera, ray)
    affine = np.array([[camera.focal_length_px[0], camera.skew_px], [0.0, camera.focal_length_px[1]]])
    if camera.mirrored:
        affine[0] *= -1.0
    rotation = rotation_matrix(camera.rotation_cam_enu)
    by_radius, basis, profile = _decentering_parts(camera, ray)
    by_vector = affine @ _by_camera_vector(camera, ray, by_radius)
    columns = np.zeros((*ray.theta.shape, 2, len(PARAMETER_NAMES)))
    sign = -1.0 if camera.mirrored else 1.0
    columns[..., 0, 0] = sign * x_hat
    columns[..., 1, 1] = y_hat
    columns[..., 0, 2] = sign * y_hat
    columns[..., 0, 3] = sign
    columns[..., 1, 4] = 1.0
    world = np.asarray(direction_enu, dtype=np.float64)
    turn = -rotation @ _skews(world) @ right_jacobian(camera.rotation_cam_enu)
    columns[..., 5:8] = by_vector @ turn
    columns[..., 8:11] = by_vector
    scaled = (ray.theta / _RIGHT_ANGLE)[..., None] ** np.array(RADIAL_ORDERS)
    columns[..., 11:19] = (affine @ by_radius[..., None]) * scaled[..., None, :]
    columns[..., 19:23] = affine @ _by_decentering(ray, basis, profile)
    return _to_pixels(camera, x_hat, y_hat, ray.theta), columns, by_vector @ rotation


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


def _ray(camera: Camera, direction_enu: ArrayLike) -> _Ray:
    world = np.asarray(direction_enu, dtype=np.float64)
    vector = world @ rotation_matrix(camera.rotation_cam_enu).T + np.array(camera.translation)
    norm_xy = np.hypot(vector[..., 0], vector[..., 1])
    theta = np.arctan2(norm_xy, vector[..., 2])
    off_axis = norm_xy > _ON_AXIS
    safe = np.where(off_axis, norm_xy, 1.0)
    u = np.where(off_axis, vector[..., 0] / safe, 1.0)
    v = np.where(off_axis, vector[..., 1] / safe, 0.0)
    with np.errstate(invalid="ignore", over="ignore"):
        radius = distorted_radius(camera, np.where(theta < angle_limit(camera.projection), theta, np.nan))
    return _Ray(vector, norm_xy, theta, u, v, radius)


def _calibrated(camera: Camera, ray: _Ray) -> tuple[FloatArray, FloatArray]:
    shift_x, shift_y = decentering_shift(camera.decentering, ray.radius, ray.u, ray.v)
    return ray.radius * ray.u + shift_x, ray.radius * ray.v + shift_y


def _to_pixels(camera: Camera, x_hat: FloatArray, y_hat: FloatArray, theta: FloatArray) -> FloatArray:
    x = camera.focal_length_px[0] * x_hat + camera.skew_px * y_hat + camera.principal_point_px[0]
    y = camera.focal_length_px[1] * y_hat + camera.principal_point_px[1]
    if camera.mirrored:
        x = camera.width - 1.0 - x
    pixel = np.stack([x, y], axis=-1)
    pixel[theta > camera.max_angle] = np.nan
    return pixel


def _decentering_parts(camera: Camera, ray: _Ray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return d(x̂, ŷ)/dr̂ (..., 2), the bracket of Eq. 12 (..., 2) and its radial profile (...)."""
    p1, p2, p3, p4 = camera.decentering
    u, v, square = ray.u, ray.v, ray.radius**2
    basis = np.stack([p1 * (1 + 2 * u * u) + 2 * p2 * u * v, 2 * p1 * u * v + p2 * (1 + 2 * v * v)], axis=-1)
    profile = square * (1.0 + square * (p3 + square * p4))
    slope = ray.radius * (2.0 + square * (4.0 * p3 + square * 6.0 * p4))
    return np.stack([u, v], axis=-1) + slope[..., None] * basis, basis, profile


def _by_decentering(ray: _Ray, basis: FloatArray, profile: FloatArray) -> FloatArray:
    """Return d(x̂, ŷ)/d(p1 … p4), (..., 2, 4)."""
    u, v, square = ray.u, ray.v, ray.radius**2
    first = np.stack([1 + 2 * u * u, 2 * u * v], axis=-1) * profile[..., None]
    second = np.stack([2 * u * v, 1 + 2 * v * v], axis=-1) * profile[..., None]
    third = basis * (square**2)[..., None]
    return np.stack([first, second, third, basis * (square**3)[..., None]], axis=-1)


def _by_camera_vector(camera: Camera, ray: _Ray, by_radius: FloatArray) -> FloatArray:
    """Return d(x̂, ŷ)/d(X, Y, Z) in the camera frame, (..., 2, 3), finite on the axis too."""
    p1, p2 = camera.decentering[:2]
    u, v, z = ray.u, ray.v, ray.vector[..., 2]
    square = ray.norm_xy**2 + z**2
    slope = radius_slope(camera, ray.theta)
    off_axis = ray.norm_xy > _ON_AXIS
    safe = np.where(off_axis, ray.norm_xy, 1.0)
    # turning about the axis: (radius · tangent + profile · d basis/dφ) / norm_xy, whose limit on the axis is the slope
    per_norm = np.where(off_axis, ray.radius / safe, slope / np.where(off_axis, 1.0, z))
    radius_square = ray.radius**2
    p3, p4 = camera.decentering[2:]
    profile = radius_square * (1.0 + radius_square * (p3 + radius_square * p4))
    twist = np.where(off_axis, profile / safe, 0.0)
    sin2, cos2 = 2 * u * v, u * u - v * v
    about_x = -v * per_norm + twist * (-2 * p1 * sin2 + 2 * p2 * cos2)
    about_y = u * per_norm + twist * (2 * p1 * cos2 + 2 * p2 * sin2)
    about = np.stack([about_x, about_y], axis=-1)
    theta_by = np.stack([z * u, z * v, -ray.norm_xy], axis=-1) / square[..., None]
    phi_by = np.stack([-v, u, np.zeros_like(u)], axis=-1)
    return (slope[..., None] * by_radius)[..., :, None] * theta_by[..., None, :] + about[..., :, None] * phi_by[
        ..., None, :
    ]


def _skews(vectors: FloatArray) -> FloatArray:
    result = np.zeros((*vectors.shape[:-1], 3, 3))
    x, y, z = np.moveaxis(vectors, -1, 0)
    result[..., 0, 1], result[..., 0, 2], result[..., 1, 2] = -z, y, -x
    return result - np.swapaxes(result, -1, -2)
