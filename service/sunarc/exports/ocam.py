"""Scaramuzza's omnidirectional model, and OCamCalib's `calib_results.txt`.

It counts pixels from 0 and names the row first: its x runs down the image and its y to the right, and so do the
first two axes of its camera frame; the third one points into the camera, away from the sky.
Reference: D. Scaramuzza et al., "A toolbox for easily calibrating omnidirectional cameras", IROS 2006.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import Polynomial

from sunarc.array_types import FloatArray
from sunarc.exports.sky import FitError, Sky, fit_error, sky_of
from sunarc.optics import Camera, project, rotation_matrix

_FORWARD = 11
_BACKWARD = tuple((0, *range(2, degree + 1)) for degree in (4, 5, 6, 7, 8))
"""Powers of the polynomial from a pixel to a ray that are tried in turn."""
_CUBIC = ((0, 1, 2, 3),)
"""Those of readers that take four coefficients."""
_GOOD_ENOUGH_PX = 0.02
_SCALE = 1000.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OcamModel:
    """Scaramuzza's camera.

    Attributes
    ----------
    pixel_to_ray : coefficients of z over the radius in px, the constant one first; that of the first power is 0 but
        in a cubic one.
    ray_to_pixel : coefficients of the radius in px over the angle above the image plane in radians, constant first.
    center_row_column : px from 0.
    affine : c, d, e of [row, column] = [[c, d], [e, 1]] [x, y] + center; for a mirrored image c is negative. The matrix
        is symmetric (after the mirroring): a rotation about the axis belongs to `rotation` alone.
    rotation : (3, 3) from east-north-up to its camera frame (down the image, right, into the camera).
    forward_error, backward_error : of ray_to_pixel and of pixel_to_ray.
    """

    pixel_to_ray: FloatArray
    ray_to_pixel: FloatArray
    center_row_column: FloatArray
    affine: FloatArray
    rotation: FloatArray
    forward_error: FitError
    backward_error: FitError


def ocam_model(camera: Camera, *, cubic: bool = False) -> OcamModel:
    """Return Scaramuzza's model that is closest to a camera.

    Parameters
    ----------
    camera : the camera.
    cubic : four coefficients from a pixel to a ray, and no affine part but the mirroring (c = ±1, d = e = 0); fitted
        down to the horizon, where the other one is fitted to all that the lens sees.
    """
    horizon = math.pi / 2 + math.acos(float(np.clip(rotation_matrix(camera.rotation_cam_enu)[2, 2], -1.0, 1.0)))
    sky = sky_of(camera, within=min(horizon, camera.max_angle) if cubic else camera.max_angle)
    sign = -1.0 if camera.mirrored else 1.0
    frame = np.array([[0.0, sign, 0.0], [sign, 0.0, 0.0], [0.0, 0.0, -1.0]])
    x0, y0 = camera.principal_point_px
    start = np.zeros(7 + _FORWARD + 1)
    start[:2] = y0, camera.width - 1.0 - x0 if camera.mirrored else x0
    start[2] = 1.0
    start[7:9] = 0.5 * math.pi * _SCALE * 0.6, 0.6 * _SCALE
    free = np.ones(start.size, dtype=bool)
    # Readers of the cubic form ignore the affine part in places, so that it has to stay the identity.
    free[2:4] = not cubic
    rays = sky.rays @ frame.T
    row_column_of_rays = sky.pixels[:, ::-1]

    def misfit(moving: FloatArray) -> FloatArray:
        parameters = start.copy()
        parameters[free] = moving
        return np.asarray(_forward(parameters, rays, sign) - row_column_of_rays).ravel()

    from scipy.optimize import least_squares  # noqa: PLC0415 - the service starts sooner without it

    found = start.copy()
    found[free] = least_squares(misfit, start[free], x_scale="jac", method="trf").x
    row_column = _forward(found, rays, sign)
    rotation = rotation_matrix(found[4:7]) @ frame @ rotation_matrix(camera.rotation_cam_enu)
    forward_error = fit_error(camera, sky, row_column[:, ::-1])
    good_px = max(_GOOD_ENOUGH_PX, 1.3 * forward_error.max_px)
    affine, tried = _affine(found, sign), _CUBIC if cubic else _BACKWARD
    polynomial, backward_error = _backward(camera, sky, found[:2], affine, rotation, tried=tried, good_px=good_px)
    return OcamModel(
        pixel_to_ray=polynomial,
        ray_to_pixel=found[7:],
        center_row_column=found[:2],
        affine=affine,
        rotation=rotation,
        forward_error=forward_error,
        backward_error=backward_error,
    )


def calib_results(model: OcamModel, *, width: int, height: int, notes: list[str]) -> bytes:
    """Return OCamCalib's text file; its notes stand at the end, which readers ignore."""

    def counted(numbers: FloatArray) -> str:
        return " ".join([str(len(numbers)), *(f"{number:.17e}" for number in numbers)])

    row, column = model.center_row_column
    c, d, e = model.affine
    blocks = [
        ('polynomial coefficients for the DIRECT mapping function (from a pixel to a ray: "cam2world")',
         counted(model.pixel_to_ray)),
        ('polynomial coefficients for the inverse mapping function (from a ray to a pixel: "world2cam")',
         counted(model.ray_to_pixel)),
        ('center: "row" and "column", starting from 0 (C convention)', f"{row:.9f} {column:.9f}"),
        ('affine parameters "c", "d", "e"', f"{c:.12f} {d:.12f} {e:.12f}"),
        ('image size: "height" and "width"', f"{height} {width}"),
    ]  # fmt: skip
    text = "\n".join(f"#{title}\n\n{values}\n" for title, values in blocks)
    rotation = "; ".join(" ".join(f"{value:.12f}" for value in line) for line in model.rotation)
    comments = [*notes, f"R from east-north-up to (down the image, right, into the camera): {rotation}"]
    return (text + "\n" + "".join(f"# {line}\n" for line in comments)).encode()


def _affine(parameters: FloatArray, sign: float) -> FloatArray:
    """Return c, d, e of a symmetric matrix, mirrored or not."""
    stretch, shear = parameters[2:4]
    return np.array([sign * stretch, shear, sign * shear]) + 0.0  # no -0


def _forward(parameters: FloatArray, rays: FloatArray, sign: float) -> FloatArray:
    """Return (n, 2) rows and columns of rays in the model's frame before its small turn."""
    ray = rays @ rotation_matrix(parameters[4:7]).T
    across = np.hypot(ray[:, 0], ray[:, 1])
    radius = np.polynomial.polynomial.polyval(np.arctan2(ray[:, 2], across), parameters[7:])
    x, y = ray[:, 0] / across * radius, ray[:, 1] / across * radius
    c, d, e = _affine(parameters, sign)
    return np.stack([c * x + d * y + parameters[0], e * x + y + parameters[1]], axis=-1)


def _backward(
    camera: Camera,
    sky: Sky,
    center: FloatArray,
    affine: FloatArray,
    rotation: FloatArray,
    *,
    tried: tuple[tuple[int, ...], ...],
    good_px: float,
) -> tuple[FloatArray, FitError]:
    """Return the polynomial from a pixel to a ray, with the first powers that are good enough, and its error."""
    c, d, e = affine
    plane = (sky.pixels[:, ::-1] - center) @ np.linalg.inv(np.array([[c, d], [e, 1.0]])).T
    radius = np.linalg.norm(plane, axis=-1)
    ray = sky.directions @ rotation.T
    across = np.hypot(ray[:, 0], ray[:, 1])
    weight = across / radius * _SCALE  # an error of z turns the ray by sin θ / radius of it
    for orders in tried:
        powers = (radius[:, None] / _SCALE) ** np.array(orders)
        fitted = np.linalg.lstsq(powers * weight[:, None], radius * ray[:, 2] / across * weight, rcond=None)[0]
        polynomial = np.zeros(orders[-1] + 1)
        polynomial[list(orders)] = fitted / _SCALE ** np.array(orders)
        z = Polynomial(polynomial)(radius)
        rays = np.concatenate([plane, z[:, None]], axis=-1) @ rotation
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        # The pixel's error is minus that of where its ray lands, mirrored about the pixel to keep the sign.
        error = fit_error(camera, sky, 2.0 * sky.pixels - _landing(camera, rays))
        if error.max_px < good_px:
            break
    return polynomial, error


def _landing(camera: Camera, directions: FloatArray) -> FloatArray:
    """Return pixels of directions, also just beyond the field."""
    return project(replace(camera, max_angle=camera.max_angle + 0.02), directions)
