"""The lens's inverse for many pixels at once, from tables: cubic pieces over the radius, splines over the image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sunarc import _kernels
from sunarc.common.array_types import FloatArray
from sunarc.optics.camera import Camera
from sunarc.optics.displacement import Displacement
from sunarc.optics.forward import decentering_shift, distorted_radius, mirror_offset, radius_slope, rising_limit
from sunarc.optics.inverse import largest_angle, unproject
from sunarc.optics.pose import rotation_matrix


class InverseConstants(NamedTuple):
    """Numbers of a camera's inverse, as the kernels take them.

    per_fx, per_fy : inverse focal lengths, 1/px. skew, x0, y0 : px. mirror : see `pixels_of`. p1 … p4 : decentering.
    per_radius : pieces of the table per unit of the radius. limit : largest radius. exact_from : radius from which on
    the table is too coarse.
    """

    per_fx: float
    per_fy: float
    skew: float
    x0: float
    y0: float
    mirror: float
    p1: float
    p2: float
    p3: float
    p4: float
    per_radius: float
    limit: float
    exact_from: float


# The displacement taken out of many pixels at once, from cubic splines on a grid over the image.

_PER_HALF_WAVE = 32.0
"""Nodes a half wave of the shortest: a cubic spline is then off by (pi / 32)⁴ / 384 of its amplitude, 2e-7."""
_MARGIN = 4
"""Nodes beyond the image on each side: the spline's edge does not reach back further."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DisplacementTable:
    """A displacement's inverse, ready for many pixels.

    Attributes
    ----------
    displacement : answers beyond the grid.
    origin_px, step_px : of the grid, along x and y.
    coefficients : (rows, columns, 2) of the splines of the displacement, as a function of the displaced pixel, px.
    """

    displacement: Displacement
    origin_px: tuple[float, float]
    step_px: tuple[float, float]
    coefficients: FloatArray

    def inverse(self, pixels: FloatArray) -> FloatArray:
        """Return (n, 2): the pixels of `Displacement.inverse`, to 1e-6 px."""
        pixel = np.ascontiguousarray(pixels, dtype=np.float64)
        origin, step = np.array(self.origin_px), np.array(self.step_px)
        result, any_beyond = _kernels.pixels_from_grid(self.coefficients, origin, step, pixel)
        if any_beyond:
            beyond = np.isinf(result[:, 0])
            result[beyond] = self.displacement.inverse(pixel[beyond])
        return result


def displacement_table(displacement: Displacement, *, width: int, height: int) -> DisplacementTable:
    """Return the table of a displacement over an image of `width` by `height` px."""
    from scipy.ndimage import spline_filter  # noqa: PLC0415 - the command line loads without it

    orders = np.max(np.array(displacement.orders), axis=0, initial=1)
    steps = [2.0 * half / (_PER_HALF_WAVE * order) for half, order in zip(displacement.half_px, orders, strict=True)]
    counts = [math.ceil(size / step) + 1 + 2 * _MARGIN for size, step in zip((width, height), steps, strict=True)]
    origin = (-0.5 - _MARGIN * steps[0], -0.5 - _MARGIN * steps[1])
    axes = [origin[a] + steps[a] * np.arange(counts[a]) for a in (0, 1)]
    nodes = np.stack(np.meshgrid(*axes, indexing="xy"), axis=-1)
    shift = nodes - displacement.inverse(nodes.reshape(-1, 2)).reshape(nodes.shape)
    coefficients = np.stack([spline_filter(shift[..., a], order=3, mode="mirror") for a in (0, 1)], axis=-1)
    return DisplacementTable(
        displacement=displacement,
        origin_px=origin,
        step_px=(steps[0], steps[1]),
        coefficients=np.ascontiguousarray(coefficients),
    )


_PIECES = 1024
_NEWTON = 12
_TABLE_ERROR = 3e-10
_SMALLEST_ERROR = 1e-10
_MOST_ROUNDS = 60


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class InverseTable:
    """A camera's inverse, ready for many pixels: cubic pieces of sin(θ)/r and cos(θ) over the radius r.

    Attributes
    ----------
    camera : the camera.
    constants : its numbers; from the radius `exact_from` on the lens hardly rises, and the exact inverse answers.
    rotation : (3, 3) from east-north-up to the camera.
    pieces : (n, 8) coefficients.
    rounds : fixed-point rounds that take out the decentering; None where they do not converge and the exact inverse
        answers everywhere.
    displacement : takes out the camera's displacement, where it has one.
    """

    constants: InverseConstants
    camera: Camera
    rotation: FloatArray
    pieces: FloatArray
    rounds: int | None
    displacement: DisplacementTable | None

    def directions(self, pixels: ArrayLike) -> FloatArray:
        """Return directions as `unproject` does for pixels (..., 2), to about 1e-8 px."""
        pixel = np.asarray(pixels, dtype=np.float64)
        flat = np.ascontiguousarray(pixel.reshape(-1, 2))
        if self.displacement is not None:
            flat = self.displacement.inverse(flat)
        if self.rounds is None:
            result = unproject(self.camera.lens_alone(), flat)
        else:
            constants = np.array(self.constants)
            result, any_coarse = _kernels.directions_from_table(
                constants, self.rotation, self.pieces, self.rounds, flat
            )
            if any_coarse:
                coarse = np.isinf(result[:, 0])
                result[coarse] = unproject(self.camera.lens_alone(), flat[coarse])
        return result.reshape(*pixel.shape[:-1], 3)


def inverse_table(camera: Camera) -> InverseTable:
    """Return the table of a camera."""
    limit = rising_limit(camera, up_to=largest_angle(camera))
    largest = float(distorted_radius(camera, limit))
    radius = np.linspace(0.0, largest, _PIECES + 1)
    theta = _solve_angles(camera, radius, limit)
    slope = 1.0 / radius_slope(camera, theta)
    safe = np.where(radius > 0.0, radius, 1.0)
    scale = np.where(radius > 0.0, np.sin(theta) / safe, slope[0])
    scale_slope = np.where(radius > 0.0, (np.cos(theta) * slope - scale) / safe, 0.0)
    scale_slope[0] = _slope_on_axis(camera, slope[0])
    cosine, cosine_slope = np.cos(theta), -np.sin(theta) * slope
    step = largest / _PIECES
    pieces = np.concatenate(
        [_hermite_cubics(scale, scale_slope * step), _hermite_cubics(cosine, cosine_slope * step)], axis=1
    )
    p1, p2, p3, p4 = camera.decentering
    beside = camera.displacement
    constants = InverseConstants(
        1.0 / camera.focal_length_px[0],
        1.0 / camera.focal_length_px[1],
        camera.skew_px,
        *camera.principal_point_px,
        mirror_offset(camera),
        p1,
        p2,
        p3,
        p4,
        1.0 / step,
        largest * (1.0 + 1e-12),
        _find_inexact_radius(camera, pieces, radius, limit),
    )
    return InverseTable(
        camera=camera,
        constants=constants,
        rotation=rotation_matrix(camera.rotation_cam_enu),
        pieces=np.ascontiguousarray(pieces),
        rounds=decentering_rounds(camera, largest),
        displacement=None if beside is None else displacement_table(beside, width=camera.width, height=camera.height),
    )


def _find_inexact_radius(camera: Camera, pieces: FloatArray, radius: FloatArray, limit: float) -> float:
    """Return the radius of the first piece whose middle is off by more than `_TABLE_ERROR`; infinite without one."""
    middle = 0.5 * (radius[1:] + radius[:-1])
    half = 0.5 ** np.arange(4)
    theta = _solve_angles(camera, middle, limit)
    off = np.abs(pieces[:, :4] @ half * middle - np.sin(theta)) + np.abs(pieces[:, 4:] @ half - np.cos(theta))
    coarse = np.flatnonzero(off > _TABLE_ERROR)
    return float(radius[coarse[0]]) if coarse.size else math.inf


def _solve_angles(camera: Camera, radius: FloatArray, limit: float) -> FloatArray:
    grid = np.linspace(0.0, limit, 1025)
    theta = np.interp(radius, distorted_radius(camera, grid), grid)
    for _ in range(_NEWTON):
        theta = theta - (distorted_radius(camera, theta) - radius) / radius_slope(camera, theta)
        theta = np.clip(theta, 0.0, limit)
    return np.asarray(theta)


def _slope_on_axis(camera: Camera, inverse_slope: float) -> float:
    """Return d(sin θ / r)/dr on the axis, where r = aθ + bθ² + …: -b / a³."""
    quadratic = camera.radial[0] / (math.pi / 2) ** 2
    return -quadratic * inverse_slope**3


def _hermite_cubics(value: FloatArray, slope: FloatArray) -> FloatArray:
    """Return (n, 4): the Hermite cubics between knots, for a place from 0 to 1."""
    rise = value[1:] - value[:-1]
    return np.stack(
        [value[:-1], slope[:-1], 3.0 * rise - 2.0 * slope[:-1] - slope[1:], slope[:-1] + slope[1:] - 2.0 * rise],
        axis=1,
    )


def decentering_rounds(camera: Camera, largest: float) -> int | None:
    """Return how many fixed-point rounds bring the decentering's error below 1e-10 focal lengths, as tried out."""
    if not any(camera.decentering[:2]):
        return 0
    radius, azimuth = np.meshgrid(np.linspace(0.1, 1.0, 7) * largest, np.linspace(0.0, 2.0 * math.pi, 24))
    x_hat, y_hat = radius * np.cos(azimuth), radius * np.sin(azimuth)
    x, y = x_hat, y_hat
    with np.errstate(over="ignore", invalid="ignore"):  # rounds that diverge do so to infinity
        for number in range(_MOST_ROUNDS):
            r = np.hypot(x, y)
            shift_x, shift_y = decentering_shift(camera.decentering, r, x / r, y / r)
            change = float(np.max(np.hypot(x_hat - shift_x - x, y_hat - shift_y - y)))
            if change < _SMALLEST_ERROR:
                return number
            x, y = x_hat - shift_x, y_hat - shift_y
    return None
