"""From pixels to directions: the exact inverse of the forward model.

The forward model splits in two, so that its inverse is two small Newton iterations: in the plane for the
decentering, then in one dimension for the angle.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sunarc.array_types import FloatArray
from sunarc.compiled_math import sine_and_cosine_of_half
from sunarc.jit import njit
from sunarc.optics.camera import Camera
from sunarc.optics.forward import kernel_optics
from sunarc.optics.kernels import (
    EQUIDISTANT,
    EQUISOLID,
    PERSPECTIVE,
    STEREOGRAPHIC,
    Optics,
    distortion_and_slope,
    radius_and_slope,
    require_code,
)
from sunarc.optics.pose import rotation_matrix
from sunarc.optics.projections import angle_limit

_ITERATIONS = 30
_LAST_STEP = 1e-8
"""A step of Newton's method this small leaves an error of its square."""
_KNOTS = 257
"""Of the table that the angle's steps begin at: cubic pieces of 1/256 of the field leave 1e-11 of an angle."""
_BLOCK = 256


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def remove_decentering(decentering: FloatArray, x_hat: FloatArray, y_hat: FloatArray) -> None:
    """Replace points (n,), in focal lengths, by those q with q + shift(q) at them: Eq. 12 taken out."""
    p1, p2, p3, p4 = decentering[0], decentering[1], decentering[2], decentering[3]
    x, y = x_hat.copy(), y_hat.copy()
    for _ in range(_ITERATIONS):
        moving = 0
        for i in range(x.size):
            px, py = x[i], y[i]
            xx, yy, xy = px * px, py * py, 2.0 * px * py
            square = xx + yy
            profile, rise = 1.0 + square * (p3 + square * p4), 2.0 * (p3 + 2.0 * square * p4)
            a, b = p1 * (square + 2.0 * xx) + p2 * xy, p1 * xy + p2 * (square + 2.0 * yy)
            both = 2.0 * (p1 * py + p2 * px)
            jxx = 1.0 + rise * px * a + profile * (6.0 * p1 * px + 2.0 * p2 * py)
            jyy = 1.0 + rise * py * b + profile * (2.0 * p1 * px + 6.0 * p2 * py)
            jxy, jyx = rise * py * a + profile * both, rise * px * b + profile * both
            fx, fy = px + profile * a - x_hat[i], py + profile * b - y_hat[i]
            per_determinant = 1.0 / (jxx * jyy - jxy * jyx)
            dx, dy = (jyy * fx - jxy * fy) * per_determinant, (jxx * fy - jyx * fx) * per_determinant
            x[i], y[i] = px - dx, py - dy
            moving += int(abs(dx) + abs(dy) > _LAST_STEP)
        if moving == 0:
            break
    x_hat[:] = x
    y_hat[:] = y


@njit(nogil=True, error_model="numpy")
def angle_table(code: int, radial: FloatArray, limit: float) -> FloatArray:
    """Return the angles, rad, at radii spread evenly from 0 to that of the limit, and their slopes a piece: (m, 2)."""
    table = np.empty((_KNOTS, 2))
    theta, step = 0.0, radius_and_slope(code, radial, limit)[0] / (_KNOTS - 1)
    for k in range(_KNOTS):
        for _ in range(_ITERATIONS):
            found, slope = radius_and_slope(code, radial, theta)
            following = min(max(theta - (found - k * step) / slope, 0.0), limit)
            moved = abs(following - theta)
            theta = following
            if not moved > _LAST_STEP:
                break
        table[k, 0], table[k, 1] = theta, step / slope if slope > 0.0 else math.inf
    table[-1, 0] = limit
    return table


@njit(nogil=True, error_model="numpy")
def _first_angle(table: FloatArray, share: float) -> float:
    """Return the angle at a share, 0 to 1, of the largest radius from the table's cubic pieces."""
    last = table.shape[0] - 1
    position = share * last
    piece = min(int(position), last - 1)
    s = position - piece
    low, high = table[piece, 0], table[piece + 1, 0]
    first, second, rise = table[piece, 1], table[piece + 1, 1], high - low
    angle = low + s * (first + s * (3.0 * rise - 2.0 * first - second + s * (first + second - 2.0 * rise)))
    # where the lens hardly rises the slopes are no help
    return float(angle) if low <= angle <= high else float(low + s * rise)


class InverseLens(NamedTuple):
    """What the exact inverse takes of a camera.

    optics : as of the forward kernels. plane : (5,) fx, fy, skew, x0, y0, px. radial, decentering : k2 … k9, p1 … p4.
    table : of `angle_table`, to the largest angle.
    """

    optics: Optics
    plane: FloatArray
    radial: FloatArray
    decentering: FloatArray
    table: FloatArray


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _step_angles(lens: InverseLens, radius: FloatArray, theta: FloatArray, sine: FloatArray, cosine: FloatArray) -> int:
    """Make one step of Newton's method for angles (n,), write their sines and cosines, and return how many moved."""
    code, radial, limit = lens.optics.code, lens.radial, lens.table[-1, 0]
    require_code(code)  # not in the loop, which is to run in vector registers
    moving = 0
    for i in range(theta.size):
        s, c = sine_and_cosine_of_half(theta[i])
        sine_whole, cosine_whole = 2.0 * s * c, 1.0 - 2.0 * s * s
        if code == PERSPECTIVE:
            ideal, slope = sine_whole / cosine_whole, 1.0 / (cosine_whole * cosine_whole)
        elif code == EQUIDISTANT:
            ideal, slope = theta[i], 1.0
        elif code == EQUISOLID:
            ideal, slope = 2.0 * s, c
        elif code == STEREOGRAPHIC:
            ideal, slope = 2.0 * s / c, 1.0 / (c * c)
        else:  # orthographic
            ideal, slope = sine_whole, cosine_whole
        distortion, rise = distortion_and_slope(radial, theta[i])
        after = min(max(theta[i] - (ideal + distortion - radius[i]) / (slope + rise), 0.0), limit)
        step = after - theta[i]
        # a last step is so small that its square does not matter
        sine[i], cosine[i] = sine_whole + step * cosine_whole, cosine_whole - step * sine_whole
        theta[i] = after
        moving += int(abs(step) > _LAST_STEP)
    return moving


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def write_exact_directions(lens: InverseLens, rotation: FloatArray, pixels: FloatArray, result: FloatArray) -> None:
    """Write the directions (n, 3) that pixels (n, 2) look at; NaN where there is none.

    `rotation` (3, 3) leads to the camera.
    """
    decentering, mirror, plane = lens.decentering, lens.optics.mirror, lens.plane
    edge = radius_and_slope(lens.optics.code, lens.radial, lens.table[-1, 0])[0]
    fx, fy, skew, x0, y0 = plane[0], plane[1], plane[2], plane[3], plane[4]
    work = np.empty((6, _BLOCK))
    for begin in range(0, pixels.shape[0], _BLOCK):
        size = min(_BLOCK, pixels.shape[0] - begin)
        x, y, radius, theta = work[0, :size], work[1, :size], work[2, :size], work[3, :size]
        sine, cosine = work[4, :size], work[5, :size]
        for k in range(size):
            column = mirror - pixels[begin + k, 0] if mirror >= 0.0 else pixels[begin + k, 0]
            y[k] = (pixels[begin + k, 1] - y0) / fy
            x[k] = (column - x0 - skew * y[k]) / fx
        if decentering[0] != 0.0 or decentering[1] != 0.0:
            remove_decentering(decentering, x, y)
        for k in range(size):
            radius[k] = math.sqrt(x[k] * x[k] + y[k] * y[k])
            if not radius[k] <= edge * (1.0 + 1e-12):
                x[k], radius[k] = math.nan, 0.0  # no direction, and nothing to wait for
            theta[k] = _first_angle(lens.table, min(radius[k] / edge, 1.0))
        for _ in range(_ITERATIONS):
            if _step_angles(lens, radius, theta, sine, cosine) == 0:
                break
        for k in range(size):
            scale = sine[k] / max(radius[k], 1e-300)
            across, down, along = scale * x[k], scale * y[k], cosine[k] + 0.0 * x[k]
            for c in range(3):
                result[begin + k, c] = rotation[0, c] * across + rotation[1, c] * down + rotation[2, c] * along


def unproject(camera: Camera, pixel: ArrayLike) -> FloatArray:
    """Return the directions that pixels look at.

    Parameters
    ----------
    camera : the camera; its translation is taken as 0, for it names no direction.
    pixel : (..., 2) px, inside the image or not.

    Returns
    -------
    (..., 3) unit vectors, east-north-up; NaN where no direction within `max_angle` lands on the pixel.
    """
    place = np.asarray(pixel, dtype=np.float64)
    if camera.displacement is not None:
        place = camera.displacement.inverse(place.reshape(-1, 2)).reshape(place.shape)
    flat = np.ascontiguousarray(place.reshape(-1, 2))
    result = np.empty((flat.shape[0], 3))
    optics, radial = kernel_optics(camera), np.array(camera.radial)
    lens = InverseLens(
        optics=optics,
        plane=np.array([*camera.focal_length_px, camera.skew_px, *camera.principal_point_px]),
        radial=radial,
        decentering=np.array(camera.decentering),
        table=angle_table(optics.code, radial, largest_angle(camera)),
    )
    write_exact_directions(lens, rotation_matrix(camera.rotation_cam_enu), flat, result)
    return result.reshape(*place.shape[:-1], 3)


def calibrated(camera: Camera, pixel: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return x̂, ŷ (...) of pixels (..., 2): in focal lengths from the axis, the decentering still in it."""
    x, y = pixel[..., 0], pixel[..., 1]
    if camera.mirrored:
        x = camera.width - 1.0 - x
    y_hat = (y - camera.principal_point_px[1]) / camera.focal_length_px[1]
    return (x - camera.principal_point_px[0] - camera.skew_px * y_hat) / camera.focal_length_px[0], y_hat


def largest_angle(camera: Camera) -> float:
    """Return the angle off the axis, rad, up to which the inverse is looked for."""
    return min(camera.max_angle, angle_limit(camera.projection) * (1.0 - 1e-9))
