"""Scaramuzza's omnidirectional model: OCamCalib's `calib_results.txt` and asi_core's camera YAML.

Both count pixels from 0 and name the row first: their x runs down the image and their y to the right, and so do the
first two axes of their camera frame; the third one points into the camera, away from the sky.
Reference: D. Scaramuzza et al., "A toolbox for easily calibrating omnidirectional cameras", IROS 2006.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sunarc.exports.sky import FitError, Sky, fit_error, sky_of
from sunarc.optics import Camera, project, rotation_matrix

FloatArray = NDArray[np.float64]

_FORWARD = 11
_BACKWARD = (4, 5, 6, 7, 8)
_GOOD_ENOUGH_PX = 0.02
_SCALE = 1000.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OcamModel:
    """Scaramuzza's camera.

    Attributes
    ----------
    pixel_to_ray : coefficients of z over the radius in px, the constant one first; that of the first power is 0.
    ray_to_pixel : coefficients of the radius in px over the angle above the image plane in radians, constant first.
    center_row_column : px from 0.
    affine : c, d, e of [row, column] = [[c, d], [e, 1]] [x, y] + center.
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


def ocam_model(camera: Camera) -> OcamModel:
    """Return Scaramuzza's model that is closest to a camera."""
    sky = sky_of(camera, within=camera.max_angle)
    sign = -1.0 if camera.mirrored else 1.0
    frame = np.array([[0.0, sign, 0.0], [sign, 0.0, 0.0], [0.0, 0.0, -1.0]])
    x0, y0 = camera.principal_point_px
    start = np.zeros(8 + _FORWARD + 1)
    start[:2] = y0, camera.width - 1.0 - x0 if camera.mirrored else x0
    start[2] = sign
    start[8:10] = 0.5 * math.pi * _SCALE * 0.6, 0.6 * _SCALE
    rays = sky.rays @ frame.T
    wanted = sky.pixels[:, ::-1]

    def misfit(parameters: FloatArray) -> FloatArray:
        return np.asarray(_forward(parameters, rays) - wanted).ravel()

    from scipy.optimize import least_squares  # noqa: PLC0415 - the service starts sooner without it

    found = least_squares(misfit, start, x_scale="jac", method="trf").x
    row_column = _forward(found, rays)
    rotation = rotation_matrix(found[5:8]) @ frame @ rotation_matrix(camera.rotation_cam_enu)
    forward_error = fit_error(camera, sky, row_column[:, ::-1])
    good_px = max(_GOOD_ENOUGH_PX, 1.3 * forward_error.max_px)
    polynomial, backward_error = _backward(camera, sky, found, rotation, good_px=good_px)
    return OcamModel(
        pixel_to_ray=polynomial,
        ray_to_pixel=found[8:],
        center_row_column=found[:2],
        affine=found[2:5],
        rotation=rotation,
        forward_error=forward_error,
        backward_error=backward_error,
    )


def calib_results(model: OcamModel, *, width: int, height: int, notes: list[str]) -> bytes:
    """Return OCamCalib's text file; what it says of itself stands at its end, where readers no longer look."""

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
    said = [*notes, f"R from east-north-up to (down the image, right, into the camera): {rotation}"]
    return (text + "\n" + "".join(f"# {line}\n" for line in said)).encode()


def asi_core_yaml(
    model: OcamModel, *, width: int, height: int, camera: dict[str, str | float], notes: list[str]
) -> bytes:
    """Return asi_core's camera file.

    Parameters
    ----------
    model, width, height : the camera.
    camera : camera_name, mounted, demounted, latitude, longitude, altitude.
    notes : what is said at its top.
    """
    alpha, beta, gamma = Rotation.from_matrix(model.rotation.T).as_euler("XYZ")  # their R is Rx(α) Ry(β) Rz(γ)
    row, column = model.center_row_column
    c, d, e = model.affine
    radius = 2.0 * float(np.polynomial.polynomial.polyval(0.0, model.ray_to_pixel))
    lines = [
        *(f"# {note}" for note in notes),
        f"camera_name: '{camera['camera_name']}'",
        *(f"{name}: !!timestamp '{camera[name]}'" for name in ("mounted", "demounted")),
        *(f"{name}: {camera[name]!r}" for name in ("latitude", "longitude", "altitude")),
        "timezone: 'GMT+0'  # of image times; the service's are UTC",
        "min_ele_evaluated: 0.0",
        "internal_calibration:",
        f"  ss: [{_numbers(model.pixel_to_ray)}]",
        f"  invpol: [{_numbers(model.ray_to_pixel)}]",
        f"  xc: {row:.9f}  # the centre's row: asi_core's x runs down the image",
        f"  yc: {column:.9f}  # the centre's column",
        f"  c: {c:.12f}",
        f"  d: {d:.12f}",
        f"  e: {e:.12f}",
        f"  width: {width}",
        f"  height: {height}",
        f"  diameter: {radius:.3f}  # of the horizon of a level camera, px",
        f"external_orientation: [{alpha:.12f}, {beta:.12f}, {gamma:.12f}]",
        "camera_mask_file: null",
    ]
    return ("\n".join(lines) + "\n").encode()


def _numbers(values: FloatArray) -> str:
    return ", ".join(f"{value:.17e}" for value in values)


def _forward(parameters: FloatArray, rays: FloatArray) -> FloatArray:
    """Return (n, 2) rows and columns of rays in the model's frame before its small turn."""
    ray = rays @ rotation_matrix(parameters[5:8]).T
    across = np.hypot(ray[:, 0], ray[:, 1])
    radius = np.polynomial.polynomial.polyval(np.arctan2(ray[:, 2], across), parameters[8:])
    x, y = ray[:, 0] / across * radius, ray[:, 1] / across * radius
    c, d, e = parameters[2:5]
    return np.stack([c * x + d * y + parameters[0], e * x + y + parameters[1]], axis=-1)


def _backward(
    camera: Camera, sky: Sky, found: FloatArray, rotation: FloatArray, *, good_px: float
) -> tuple[FloatArray, FitError]:
    """Return the polynomial from a pixel to a ray, of the lowest degree that is good enough, and its error."""
    c, d, e = found[2:5]
    plane = (sky.pixels[:, ::-1] - found[:2]) @ np.linalg.inv(np.array([[c, d], [e, 1.0]])).T
    radius = np.linalg.norm(plane, axis=-1)
    ray = sky.directions @ rotation.T
    across = np.hypot(ray[:, 0], ray[:, 1])
    weight = across / radius * _SCALE  # an error of z turns the ray by sin θ / radius of it
    for degree in _BACKWARD:
        powers = (radius[:, None] / _SCALE) ** np.array([0, *range(2, degree + 1)])
        fitted = np.linalg.lstsq(powers * weight[:, None], radius * ray[:, 2] / across * weight, rcond=None)[0]
        polynomial = np.r_[fitted[0], 0.0, fitted[1:]] / _SCALE ** np.arange(degree + 1)
        z = Polynomial(polynomial)(radius)
        told = np.concatenate([plane, z[:, None]], axis=-1) @ rotation
        told /= np.linalg.norm(told, axis=-1, keepdims=True)
        error = fit_error(camera, sky, 2.0 * sky.pixels - _landing(camera, told))
        if error.max_px < good_px:
            break
    return polynomial, error


def _landing(camera: Camera, directions: FloatArray) -> FloatArray:
    """Return pixels of directions, also just beyond the field."""
    return project(replace(camera, max_angle=camera.max_angle + 0.02), directions)
