"""Scaramuzza's omnidirectional model.

It counts pixels from 0 and names the row first: its x runs down the image and its y to the right, and so do the
first two axes of its camera frame; the third one points into the camera, away from the sky.
Reference: D. Scaramuzza et al., "A toolbox for easily calibrating omnidirectional cameras", IROS 2006.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial
from numpy.typing import NDArray

from sunarc.common.array_types import FloatArray
from sunarc.common.errors import InputError
from sunarc.formats.view import Sky, View, camera_sky
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.pose import rotation_matrix

_FORWARD = 11
_BACKWARD = tuple((0, *range(2, degree + 1)) for degree in (4, 5, 6, 7, 8))
"""Powers of the polynomial from a pixel to a ray that are tried in turn."""
_CUBIC = ((0, 1, 2, 3),)
"""Those of readers that take four coefficients."""
_GOOD_ENOUGH_PX = 0.02
_SCALE = 1000.0
_STEPS = np.r_[1.0, 1.0, np.full(5, 1e-3), np.ones(_FORWARD + 1)]
"""PriorScales of the parameters: px, affine part and radians, px."""
_NODES = 20001
"""Of the table that inverts a polynomial: a linear interpolation of it is exact to 1e-5 px."""
FRAME = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""From a camera frame of x right, y down, z out of the lens to Scaramuzza's."""


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
    rotation : (3, 3) from east-north-up to its camera frame (down the image, right, into the camera); `FRAME`
        where a file has none.
    """

    pixel_to_ray: FloatArray
    ray_to_pixel: FloatArray
    center_row_column: FloatArray
    affine: FloatArray
    rotation: FloatArray


def ocam_model(camera: Camera, *, cubic: bool = False) -> OcamModel:
    """Return Scaramuzza's model that is closest to a camera.

    Parameters
    ----------
    camera : the camera.
    cubic : four coefficients from a pixel to a ray, and no affine part but the mirroring (c = ±1, d = e = 0); fitted
        down to the horizon, where the other one is fitted to all that the lens sees.
    """
    horizon = math.pi / 2 + math.acos(float(np.clip(rotation_matrix(camera.rotation_cam_enu)[2, 2], -1.0, 1.0)))
    sky = camera_sky(camera, within=min(horizon, camera.max_angle) if cubic else camera.max_angle)
    sign = -1.0 if camera.mirrored else 1.0
    frame = np.array([[0.0, sign, 0.0], [sign, 0.0, 0.0], [0.0, 0.0, -1.0]])
    x0, y0 = camera.principal_point_px
    start = np.zeros(7 + _FORWARD + 1)
    start[:2] = y0, camera.width - 1.0 - x0 if camera.mirrored else x0
    start[2] = 1.0
    domain = [-0.5 * math.pi, sky.within - 0.5 * math.pi]
    # A radius of f times the angle off the axis, as a Chebyshev series: with plain powers the solver crawls.
    start[7:9] = np.array([0.5, 0.5]) * sky.within * camera.focal_length_px[0]
    free = np.ones(start.size, dtype=bool)
    # Readers of the cubic form ignore the affine part in places, so that it has to stay the identity.
    free[2:4] = not cubic
    rays = sky.rays @ frame.T
    row_column_of_rays = sky.pixels[:, ::-1]

    def misfit(moving: FloatArray) -> FloatArray:
        parameters = start.copy()
        parameters[free] = moving
        return np.asarray(_project_rays_by_model(parameters, rays, sign, domain) - row_column_of_rays).ravel()

    from scipy.optimize import least_squares  # noqa: PLC0415 - the service starts sooner without it

    found = start.copy()
    found[free] = least_squares(misfit, start[free], x_scale=_STEPS[free], method="lm").x
    forward_px = float(
        np.max(np.linalg.norm(_project_rays_by_model(found, rays, sign, domain) - row_column_of_rays, axis=-1))
    )
    rotation = rotation_matrix(found[4:7]) @ frame @ rotation_matrix(camera.rotation_cam_enu)
    good_px = max(_GOOD_ENOUGH_PX, 1.3 * forward_px)
    model = OcamModel(
        pixel_to_ray=np.zeros(0),
        ray_to_pixel=np.asarray(Chebyshev(found[7:], domain).convert(kind=Polynomial).coef, dtype=np.float64),
        center_row_column=found[:2],
        affine=_make_affine(found, sign),
        rotation=rotation,
    )
    polynomial = _fit_pixel_to_ray(camera, sky, model, tried=_CUBIC if cubic else _BACKWARD, good_px=good_px)
    return replace(model, pixel_to_ray=polynomial)


def ocam_view(form: str, model: OcamModel, *, size: tuple[int, int], has_pose: bool = True) -> View:
    """Return the view of a model: each of its two polynomials as far as it rises off the axis."""
    turn = model.rotation
    c, d, e = model.affine
    plane = np.array([[c, d], [e, 1.0]])
    to_radius = model.ray_to_pixel if len(model.ray_to_pixel) else None
    radii = np.linspace(0.0, math.hypot(*size), _NODES)
    z_of = np.polynomial.polynomial.polyval(radii, model.pixel_to_ray)
    elevations = np.arctan2(z_of, radii)
    last = _rise_length(elevations)
    limit = math.pi / 2 if to_radius is None else _find_rising_limit(to_radius)

    def project_rays(directions: FloatArray) -> FloatArray:
        rays = directions @ turn.T
        across = np.hypot(rays[:, 0], rays[:, 1])
        elevation = np.arctan2(rays[:, 2], across)
        if to_radius is None:
            radius = np.interp(elevation, elevations[:last], radii[:last], right=np.nan)
        else:
            radius = np.where(elevation <= limit, np.polynomial.polynomial.polyval(elevation, to_radius), np.nan)
        scaled = rays[:, :2] * (radius / np.where(across > 0.0, across, 1.0))[:, None]
        return np.asarray((scaled @ plane.T + model.center_row_column)[:, ::-1])

    def unproject_pixels(pixels: FloatArray) -> FloatArray:
        xy = (pixels[:, ::-1] - model.center_row_column) @ np.linalg.inv(plane).T
        radius = np.linalg.norm(xy, axis=-1)
        rays = np.column_stack([xy, np.polynomial.polynomial.polyval(radius, model.pixel_to_ray)])
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        return np.where((radius <= radii[last - 1])[:, None], rays, np.nan) @ turn

    return View(
        form=form,
        width=size[0],
        height=size[1],
        project=project_rays,
        unproject=unproject_pixels,
        has_pose=has_pose,
    )


def _rise_length(values: NDArray[np.floating[Any]]) -> int:
    """Return how many of the first values rise."""
    falls = np.diff(values) <= 0.0
    return int(np.argmax(falls)) + 1 if np.any(falls) else len(values)


def _find_rising_limit(ray_to_pixel: FloatArray) -> float:
    """Return the angle above the image plane up to which a radius rises, looked for beyond 10 degrees off the axis."""
    angles = np.linspace(math.radians(-80.0), math.pi / 2, _NODES)
    return float(angles[_rise_length(np.polynomial.polynomial.polyval(angles, ray_to_pixel)) - 1])


def _make_affine(parameters: FloatArray, sign: float) -> FloatArray:
    """Return c, d, e of a symmetric matrix, mirrored or not."""
    stretch, shear = parameters[2:4]
    return np.array([sign * stretch, shear, sign * shear]) + 0.0  # no -0


def _project_rays_by_model(parameters: FloatArray, rays: FloatArray, sign: float, domain: list[float]) -> FloatArray:
    """Return (n, 2) rows and columns of rays in the model's frame before its small turn.

    `parameters`: centre, two of the affine part, a rotation vector, and a Chebyshev series of the radius on `domain`.
    """
    ray = rays @ rotation_matrix(parameters[4:7]).T
    across = np.hypot(ray[:, 0], ray[:, 1])
    radius = Chebyshev(parameters[7:], domain)(np.arctan2(ray[:, 2], across))
    x, y = ray[:, 0] / across * radius, ray[:, 1] / across * radius
    c, d, e = _make_affine(parameters, sign)
    return np.stack([c * x + d * y + parameters[0], e * x + y + parameters[1]], axis=-1)


def _fit_pixel_to_ray(
    camera: Camera, sky: Sky, model: OcamModel, *, tried: tuple[tuple[int, ...], ...], good_px: float
) -> FloatArray:
    """Return the polynomial from a pixel to a ray, with the first powers that are good enough."""
    c, d, e = model.affine
    plane = (sky.pixels[:, ::-1] - model.center_row_column) @ np.linalg.inv(np.array([[c, d], [e, 1.0]])).T
    radius = np.linalg.norm(plane, axis=-1)
    ray = sky.rays @ rotation_matrix(camera.rotation_cam_enu) @ model.rotation.T
    across = np.hypot(ray[:, 0], ray[:, 1])
    weight = across / radius * _SCALE  # an error of z turns the ray by sin θ / radius of it
    for orders in tried:
        powers = (radius[:, None] / _SCALE) ** np.array(orders)
        fitted = np.linalg.lstsq(powers * weight[:, None], radius * ray[:, 2] / across * weight, rcond=None)[0]
        polynomial = np.zeros(orders[-1] + 1)
        polynomial[list(orders)] = fitted / _SCALE ** np.array(orders)
        z = Polynomial(polynomial)(radius)
        rays = np.concatenate([plane, z[:, None]], axis=-1) @ model.rotation
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        if np.nanmax(np.linalg.norm(_project_beyond_field(camera, rays) - sky.pixels, axis=-1)) < good_px:
            break
    return polynomial


def _project_beyond_field(camera: Camera, directions: FloatArray) -> FloatArray:
    """Return pixels of directions, also just beyond the field."""
    return project(replace(camera, max_angle=camera.max_angle + 0.02), directions)


_OCAMCALIB_ROTATION = "R from east-north-up to (down the image, right, into the camera): "
_REMEDY = "give the file that the toolbox's exportData writes"


def calib_results(model: OcamModel, *, width: int, height: int, notes: list[str]) -> bytes:
    """Return OCamCalib's text file; its notes stand at the end, which readers ignore."""

    def format_counted(numbers: FloatArray) -> str:
        return " ".join([str(len(numbers)), *(f"{number:.17e}" for number in numbers)])

    row, column = model.center_row_column
    c, d, e = model.affine
    blocks = [
        ('polynomial coefficients for the DIRECT mapping function (from a pixel to a ray: "cam2world")',
         format_counted(model.pixel_to_ray)),
        ('polynomial coefficients for the inverse mapping function (from a ray to a pixel: "world2cam")',
         format_counted(model.ray_to_pixel)),
        ('center: "row" and "column", starting from 0 (C convention)', f"{row:.9f} {column:.9f}"),
        ('affine parameters "c", "d", "e"', f"{c:.12f} {d:.12f} {e:.12f}"),
        ('image size: "height" and "width"', f"{height} {width}"),
    ]  # fmt: skip
    text = "\n".join(f"#{title}\n\n{values}\n" for title, values in blocks)
    rotation = "; ".join(" ".join(f"{value:.12f}" for value in line) for line in model.rotation)
    return (text + "\n" + "".join(f"# {line}\n" for line in [*notes, _OCAMCALIB_ROTATION + rotation])).encode()


def read_ocamcalib(content: bytes, *, name: str) -> View:
    """Return the view of an OCamCalib text file; it has a pose where sunarc wrote it.

    Raises
    ------
    InputError
        It is invalid: not five blocks of numbers, or not as many as they count.
    """
    lines = [line.strip() for line in content.decode(errors="replace").splitlines()]
    turn = next((line.partition(_OCAMCALIB_ROTATION)[2] for line in lines if _OCAMCALIB_ROTATION in line), "")
    try:
        blocks = [np.array(line.split(), dtype=np.float64) for line in lines if line and not line.startswith("#")]
        rotation = np.array([row.split() for row in turn.split(";")], dtype=np.float64) if turn else FRAME
    except ValueError as error:
        raise InputError(field=name, problem=f"no OCamCalib text ({error})", remedy=_REMEDY) from None
    if rotation.shape != (3, 3):
        raise InputError(field=name, problem="its rotation is not of 3 by 3 numbers", remedy=_REMEDY)
    if len(blocks) < 5 or [len(one) for one in blocks[2:5]] != [2, 3, 2]:
        raise InputError(field=name, problem="not the five blocks of OCamCalib", remedy=_REMEDY)
    if any(one[0] != len(one) - 1 or len(one) < 3 for one in blocks[:2]):
        raise InputError(field=name, problem="a polynomial is not as long as it says", remedy=_REMEDY)
    pixel_to_ray, ray_to_pixel, center, affine, size = blocks[:5]
    model = OcamModel(
        pixel_to_ray=pixel_to_ray[1:],
        ray_to_pixel=ray_to_pixel[1:],
        center_row_column=center,
        affine=affine,
        rotation=rotation,
    )
    return ocam_view("ocamcalib", model, size=(int(size[1]), int(size[0])), has_pose=bool(turn))
