"""The paper's backward model (Eqs. 14 to 18), fitted to the forward model over the whole image (Appendix B)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from sunarc.common.array_types import FloatArray
from sunarc.optics.camera import Camera, camera_sees
from sunarc.optics.forward import decentering_shift, decentering_slopes, project, rising_limit
from sunarc.optics.inverse import calibrated
from sunarc.optics.pose import rotation_matrix
from sunarc.optics.projections import ideal_angle, ideal_radius

_ORDERS = np.arange(2, 10)
_ANGLES = 46
_AZIMUTHS = 24
_FIRST_DAMPING, _LARGEST_DAMPING = 1e-12, 1e8
"""Shares of the squared columns: the first one is that of rounding, since the start is close."""
_STEPS = 50
_GAIN = 1e-6
"""Relative gain of the squares at convergence: with q1 and q2 next to nothing, q3 to q5 are not determined."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BackwardModel:
    """Closed-form coefficients from pixels to directions.

    Attributes
    ----------
    radial : b2 … b9; b_n multiplies r^n, r in focal lengths (Eq. 16).
    decentering : q1 … q5.
    max_error_px : the largest distance, over the image, between a pixel and where its back-projection lands.
    """

    radial: tuple[float, ...]
    decentering: tuple[float, ...]
    max_error_px: float


NO_BACKWARD = BackwardModel(radial=(0.0,) * 8, decentering=(0.0,) * 5, max_error_px=math.nan)


def fit_backward(camera: Camera) -> BackwardModel:
    """Return the backward model of a camera, with its largest error inside the image and 90 degrees off the axis.

    It is of the lens alone: a displacement is taken out of the pixel before.
    """
    camera = camera.lens_alone()
    rays, pixels = synthetic_rays(camera)
    if pixels.shape[0] < 40:
        return NO_BACKWARD
    x_hat, y_hat = calibrated(camera, pixels)
    target = ideal_radius(camera.projection, np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2]))
    azimuth = np.arctan2(rays[:, 1], rays[:, 0])
    target_point = np.stack([target * np.cos(azimuth), target * np.sin(azimuth)], axis=-1)
    focal = camera.focal_length_px[0]

    def misfit(coefficients: FloatArray) -> FloatArray:
        return np.asarray(focal * (ideal_point(camera, coefficients, x_hat, y_hat) - target_point)).ravel()

    def misfit_derivatives(coefficients: FloatArray) -> FloatArray:
        return np.asarray(focal * ideal_point_derivatives(camera, coefficients, x_hat, y_hat)).reshape(
            -1, coefficients.size
        )

    found = least_squares(misfit, misfit_derivatives, first_coefficients(camera, x_hat, y_hat, target_point))
    worst = float(np.max(np.linalg.norm(misfit(found).reshape(-1, 2), axis=-1)))
    radial, decentering = found[2:10] / _fit_radius(camera) ** _ORDERS, np.r_[found[:2], found[10:]]
    return BackwardModel(radial=tuple(radial.tolist()), decentering=tuple(decentering.tolist()), max_error_px=worst)


def least_squares(
    misfit: Callable[[FloatArray], FloatArray], slopes: Callable[[FloatArray], FloatArray], start: FloatArray
) -> FloatArray:
    """Return the coefficients of the least squares by Levenberg-Marquardt, from a start (k,).

    By orthogonal decomposition, since powers of the radius are nearly dependent: the normal equations would lose twice
    the digits.
    """
    at, left, damping, size = start, misfit(start), _FIRST_DAMPING, start.size
    for _ in range(_STEPS):
        upper = np.asarray(np.linalg.qr(np.column_stack([slopes(at), left]), mode="r"))
        factor, pull = upper[:size, :size], upper[:size, size]
        scale = np.diag(np.linalg.norm(factor, axis=0))
        gain = -1.0
        while gain < 0.0 and damping < _LARGEST_DAMPING:
            damped = np.concatenate([factor, math.sqrt(damping) * scale])
            trial = at - np.linalg.lstsq(damped, np.r_[pull, np.zeros(size)])[0]
            left_there = misfit(trial)
            gain = float(left @ left - left_there @ left_there)
            damping *= 0.1 if gain >= 0.0 else 10.0
        if gain < 0.0:
            break
        converged = gain <= _GAIN * float(left @ left)
        at, left = trial, left_there
        if converged:
            break
    return at


def back_project(camera: Camera, model: BackwardModel, pixels: ArrayLike) -> FloatArray:
    """Return the directions of pixels by Eq. 18 and 19.

    Parameters
    ----------
    camera : gives K, R and the projection.
    model : the coefficients.
    pixels : (..., 2) px.

    Returns
    -------
    (..., 3) unit vectors, east-north-up; NaN where the projection has no angle for the radius.
    """
    pixel = np.asarray(pixels, dtype=np.float64)
    if camera.displacement is not None:
        pixel = camera.displacement.inverse(pixel.reshape(-1, 2)).reshape(pixel.shape)
    x_hat, y_hat = calibrated(camera, pixel)
    radial = np.array(model.radial) * _fit_radius(camera) ** _ORDERS
    coefficients = np.array([*model.decentering[:2], *radial, *model.decentering[2:]])
    point = ideal_point(camera, coefficients, x_hat, y_hat)
    radius = np.hypot(point[..., 0], point[..., 1])
    theta = ideal_angle(camera.projection, radius)
    # on the axis the direction is arbitrary, and its factor is 0
    safe = np.where(radius > 0.0, radius, 1.0)
    horizontal = np.sin(theta)[..., None] * point / safe[..., None]
    return np.asarray(
        np.concatenate([horizontal, np.cos(theta)[..., None]], axis=-1) @ rotation_matrix(camera.rotation_cam_enu)
    )


def first_coefficients(camera: Camera, x_hat: FloatArray, y_hat: FloatArray, target: FloatArray) -> FloatArray:
    """Start from the forward model's own decentering, which is the backward one's to first order.

    It is not let be 0: q3 to q5 have no effect where q1 = q2 = 0. The radial coefficients are those of linear least
    squares in addition.

    Parameters
    ----------
    x_hat, y_hat : (n,) calibrated points.
    target : (n, 2) where the ideal projection puts them.
    """
    p1, p2, p3, p4 = camera.decentering
    decentering = np.array([p1 or 1e-6, p2 or 1e-6, p3, p4, 0.0])
    radius = np.hypot(x_hat, y_hat)
    safe = np.where(radius > 0.0, radius, 1.0)
    shift = decentering_shift(decentering, radius, x_hat / safe, y_hat / safe)
    point = np.stack([x_hat, y_hat], axis=-1) - np.stack(shift, axis=-1)
    excess = np.linalg.norm(point, axis=-1) - np.linalg.norm(target, axis=-1)
    radial = np.linalg.lstsq((radius / _fit_radius(camera))[:, None] ** _ORDERS, excess)[0]
    return np.concatenate([decentering[:2], radial, decentering[2:]])


def _fit_radius(camera: Camera) -> float:
    """Return the radius by which the fit scales its coordinates, so that its coefficients are of one size."""
    return float(ideal_radius(camera.projection, math.pi / 4 if camera.projection == "perspective" else math.pi / 2))


def ideal_point(camera: Camera, coefficients: FloatArray, x_hat: FloatArray, y_hat: FloatArray) -> FloatArray:
    """Return (..., 2): where the ideal projection would have put the ray (Eqs. 14 to 17)."""
    radius = np.hypot(x_hat, y_hat)
    safe = np.where(radius > 0.0, radius, 1.0)
    shift_x, shift_y = decentering_shift(np.r_[coefficients[:2], coefficients[10:]], radius, x_hat / safe, y_hat / safe)
    point = np.stack([x_hat - shift_x, y_hat - shift_y], axis=-1)
    adjusted = np.linalg.norm(point, axis=-1)
    polynomial = np.polynomial.polynomial.polyval(radius / _fit_radius(camera), np.r_[0.0, 0.0, coefficients[2:10]])
    factor = 1.0 - polynomial / np.where(adjusted > 0.0, adjusted, 1.0)
    return np.asarray(point * factor[..., None])


def ideal_point_derivatives(
    camera: Camera, coefficients: FloatArray, x_hat: FloatArray, y_hat: FloatArray
) -> FloatArray:
    """Return (n, 2, 13): derivatives of `ideal_point` by the coefficients, for x_hat and y_hat of shape (n,)."""
    radius = np.hypot(x_hat, y_hat)
    safe = np.where(radius > 0.0, radius, 1.0)
    decentering, u, v = np.r_[coefficients[:2], coefficients[10:]], x_hat / safe, y_hat / safe
    shift = decentering_slopes(decentering, radius, u, v)
    point = np.stack([x_hat, y_hat], axis=-1) - np.stack(decentering_shift(decentering, radius, u, v), axis=-1)
    adjusted = np.linalg.norm(point, axis=-1)
    along = point / np.where(adjusted > 0.0, adjusted, 1.0)[:, None]
    powers = (radius / _fit_radius(camera))[:, None] ** _ORDERS
    ratio = (powers @ coefficients[2:10]) / np.where(adjusted > 0.0, adjusted, 1.0)
    # point (1 - P / |point|): its derivative by the point is (1 - P / |point|) I + P / |point| e e'
    by_shift = -(1.0 - ratio)[:, None, None] * shift
    by_shift -= ratio[:, None, None] * along[:, :, None] * np.einsum("na,nac->nc", along, shift)[:, None]
    by_radial = -along[:, :, None] * powers[:, None]
    return np.concatenate([by_shift[..., :2], by_radial, by_shift[..., 2:]], axis=-1)


def synthetic_rays(camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Return rays in the camera frame and their pixels, over the part of the image that is seen."""
    limit = math.radians(80.0) if camera.projection == "perspective" else math.pi / 2
    limit = rising_limit(camera, up_to=min(limit, camera.max_angle))
    theta, azimuth = np.meshgrid(
        np.linspace(0.0, limit, _ANGLES), np.linspace(0.0, 2.0 * math.pi, _AZIMUTHS, endpoint=False)
    )
    sine = np.sin(theta)
    rays = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(theta)], axis=-1).reshape(-1, 3)
    pixels = project(replace(camera, rotation_cam_enu=(0.0, 0.0, 0.0), translation=(0.0, 0.0, 0.0)), rays)
    inside = camera_sees(camera, pixels)
    return rays[inside], pixels[inside]
