"""What displaces the image beside the lens: a smooth field that the lens's formula cannot say.

Lenses and sensors are not quite as a formula with twelve coefficients has them. The rest, tenths of a pixel, is smooth
over the image, and is written in sine waves on a box around it (`calibration.model.residual_field` says where they come
from). It is added to the pixel that the lens alone gives, so it stays where it is in the image when the camera turns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.compiled_math import sine_and_cosine_of_half
from sunarc.errors import InputError
from sunarc.jit import njit

_BLOCK = 128
"""Pixels taken together, so that the loops over waves run in vector registers."""
_ROUNDS = 60
_TOLERANCE_PX = 1e-10


@njit(nogil=True, fastmath={"contract"})
def _write_sines(angles: FloatArray, sines: FloatArray) -> None:
    """Write sin(k a), k = 1 … n, of angles (m,) into (n, m): sin((k + 1) a) = 2 cos(a) sin(k a) - sin((k - 1) a)."""
    twice = np.empty(angles.size)
    for i in range(angles.size):
        sine, cosine = sine_and_cosine_of_half(angles[i])
        sines[0, i], twice[i] = 2.0 * sine * cosine, 2.0 - 4.0 * sine * sine
    for k in range(1, sines.shape[0]):
        for i in range(angles.size):
            before = sines[k - 2, i] if k > 1 else 0.0
            sines[k, i] = twice[i] * sines[k - 1, i] - before


@njit(nogil=True, fastmath={"contract"})
def _write_slopes_of_sines(angles: FloatArray, per_px: float, slopes: FloatArray) -> None:
    """Write the derivatives by the pixel, k cos(k a) times that of the angle, k = 1 … n, into (n, m)."""
    twice = np.empty(angles.size)
    for i in range(angles.size):
        sine, _ = sine_and_cosine_of_half(angles[i])
        slopes[0, i], twice[i] = 1.0 - 2.0 * sine * sine, 2.0 - 4.0 * sine * sine
    for k in range(1, slopes.shape[0]):
        for i in range(angles.size):
            before = slopes[k - 2, i] if k > 1 else 1.0
            slopes[k, i] = twice[i] * slopes[k - 1, i] - before
    for k in range(slopes.shape[0]):
        for i in range(angles.size):
            slopes[k, i] *= (k + 1) * per_px


@njit(nogil=True)
def _write_angles(box: FloatArray, pixels: FloatArray, angles: FloatArray) -> None:
    """Write the angles (2, m) of the lowest waves at pixels (m, 2): 0 to pi within the box."""
    for i in range(pixels.shape[0]):
        for a in range(2):
            angles[a, i] = 0.5 * math.pi * ((pixels[i, a] - box[a]) / box[2 + a] + 1.0)


@njit(nogil=True, fastmath={"contract"})
def _write_sums(sines_x: FloatArray, rows: FloatArray, total: FloatArray) -> None:
    """Write the sums (2, m) over the orders along x, of rows (2 × orders of x, m)."""
    nx = sines_x.shape[0]
    total[:] = 0.0
    for c in range(2):
        for j in range(nx):
            for i in range(total.shape[1]):
                total[c, i] += sines_x[j, i] * rows[c * nx + j, i]


@njit(nogil=True)
def _keep_within(angles: FloatArray, total: FloatArray) -> None:
    """Set sums (2, m) to 0 beyond the box, and to NaN at what is no pixel."""
    for i in range(angles.shape[1]):
        if math.isnan(angles[0, i]) or math.isnan(angles[1, i]):
            total[:, i] = math.nan
        elif not (0.0 < angles[0, i] < math.pi and 0.0 < angles[1, i] < math.pi):
            total[:, i] = 0.0


@njit(nogil=True)
def write_field(box: FloatArray, coefficients: FloatArray, pixels: FloatArray, result: FloatArray) -> None:
    """Write the displacements (n, 2) at pixels (n, 2); 0 beyond the box, NaN for NaN.

    Parameters
    ----------
    box : centre (x, y) and half-widths (x, y), px.
    coefficients : (2, orders of x, orders of y), px.
    """
    nx, ny = coefficients.shape[1], coefficients.shape[2]
    flat, rows = coefficients.reshape(2 * nx, ny), np.empty((2 * nx, _BLOCK))
    sines_x, sines_y = np.empty((nx, _BLOCK)), np.empty((ny, _BLOCK))
    angles, total = np.zeros((2, _BLOCK)), np.empty((2, _BLOCK))
    for begin in range(0, pixels.shape[0], _BLOCK):
        size = min(_BLOCK, pixels.shape[0] - begin)
        _write_angles(box, pixels[begin : begin + size], angles)
        _write_sines(angles[0], sines_x)
        _write_sines(angles[1], sines_y)
        np.dot(flat, sines_y, rows)
        _write_sums(sines_x, rows, total)
        _keep_within(angles, total)
        for i in range(size):
            for c in range(2):
                result[begin + i, c] = total[c, i]


@njit(nogil=True)
def write_field_and_slopes(
    box: FloatArray, coefficients: FloatArray, pixels: FloatArray, result: FloatArray, slopes: FloatArray
) -> None:
    """Write the displacements (n, 2) at pixels (n, 2), and their derivatives (n, 2, 2), last axis the pixel's.

    Parameters
    ----------
    box, coefficients : as of `write_field`.
    """
    nx, ny = coefficients.shape[1], coefficients.shape[2]
    flat, rows = coefficients.reshape(2 * nx, ny), np.empty((2 * nx, _BLOCK))
    waves_x, waves_y = np.empty((2, nx, _BLOCK)), np.empty((2, ny, _BLOCK))
    angles, total = np.zeros((2, _BLOCK)), np.empty((3, 2, _BLOCK))
    for begin in range(0, pixels.shape[0], _BLOCK):
        size = min(_BLOCK, pixels.shape[0] - begin)
        _write_angles(box, pixels[begin : begin + size], angles)
        for a, waves in enumerate((waves_x, waves_y)):
            _write_sines(angles[a], waves[0])
            _write_slopes_of_sines(angles[a], 0.5 * math.pi / box[2 + a], waves[1])
        np.dot(flat, waves_y[0], rows)
        _write_sums(waves_x[0], rows, total[0])
        _write_sums(waves_x[1], rows, total[1])
        np.dot(flat, waves_y[1], rows)
        _write_sums(waves_x[0], rows, total[2])
        for of in range(3):
            _keep_within(angles, total[of])
        for i in range(size):
            for c in range(2):
                result[begin + i, c] = total[0, c, i]
                slopes[begin + i, c, 0], slopes[begin + i, c, 1] = total[1, c, i], total[2, c, i]


@njit(nogil=True)
def write_inverse(box: FloatArray, coefficients: FloatArray, pixels: FloatArray, result: FloatArray) -> None:
    """Write (n, 2): what is displaced to pixels (n, 2), by Newton's method with the slopes at the pixels.

    NaN where the last step, times the ratio of it to the one before (which is the next one), does not become as small
    as the tolerance.

    Parameters
    ----------
    box, coefficients : as of `write_field`.
    """
    shift, slopes = np.empty((_BLOCK, 2)), np.empty((_BLOCK, 2, 2))
    largest = np.empty(_BLOCK)
    for begin in range(0, pixels.shape[0], _BLOCK):
        given, found = pixels[begin : begin + _BLOCK], result[begin : begin + _BLOCK]
        size = given.shape[0]
        found[:] = given
        write_field_and_slopes(box, coefficients, given, shift[:size], slopes[:size])
        largest[:size] = math.inf
        for _ in range(_ROUNDS):
            if _step(given, shift[:size], slopes[:size], found, largest[:size]):
                break
            write_field(box, coefficients, found, shift[:size])
        for i in range(size):
            if largest[i] > 0.0:
                found[i] = math.nan


@njit(nogil=True)
def _step(given: FloatArray, shift: FloatArray, slopes: FloatArray, found: FloatArray, largest: FloatArray) -> bool:
    """Take a step with each pixel that has not converged; return whether all have.

    `largest` is the size of the last step, px, and 0 where the pixel has converged.
    """
    all_done = True
    for i in range(given.shape[0]):
        if largest[i] == 0.0:
            continue
        x, y = found[i, 0] + shift[i, 0] - given[i, 0], found[i, 1] + shift[i, 1] - given[i, 1]
        xx, xy, yx, yy = 1.0 + slopes[i, 0, 0], slopes[i, 0, 1], slopes[i, 1, 0], 1.0 + slopes[i, 1, 1]
        determinant = xx * yy - xy * yx
        if determinant == 0.0:
            determinant = math.nan
        step_x, step_y = (yy * x - xy * y) / determinant, (xx * y - yx * x) / determinant
        found[i, 0] -= step_x
        found[i, 1] -= step_y
        size = max(abs(step_x), abs(step_y))
        expected = size * size / largest[i] if largest[i] < math.inf else size
        if expected <= _TOLERANCE_PX:
            largest[i] = 0.0
        else:
            largest[i] = size
            all_done = all_done and math.isnan(size)
    return all_done


HIGHEST_ORDER = 512
"""Half waves across the box: the shortest is then some pixels long."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Displacement:
    """A displacement of the image, as a sum of sine waves on a box; 0 outside of it.

    Attributes
    ----------
    center_px, half_px : centre and half-widths of the box.
    orders : of the m waves: whole numbers of half waves along x and y, 1 to `HIGHEST_ORDER`.
    x_px, y_px : (m,) coefficients of the two components; the waves have unit norm over the box, so these are in px
        times the root of its area (px).
    """

    center_px: tuple[float, float]
    half_px: tuple[float, float]
    orders: tuple[tuple[int, int], ...]
    x_px: tuple[float, ...]
    y_px: tuple[float, ...]

    def __post_init__(self) -> None:
        """Refuse what is not a displacement."""
        if not len(self.orders) == len(self.x_px) == len(self.y_px):
            raise InputError(
                field="displacement", problem="orders and coefficients differ in number", remedy="give one for each"
            )
        if any(not 1 <= order <= HIGHEST_ORDER for pair in self.orders for order in pair):
            remedy = f"give whole numbers from 1 to {HIGHEST_ORDER}"
            raise InputError(field="displacement.orders", problem="an order is out of bounds", remedy=remedy)
        if (
            not np.all(np.isfinite([*self.center_px, *self.half_px, *self.x_px, *self.y_px]))
            or min(self.half_px) <= 0.0
        ):
            raise InputError(field="displacement", problem="not finite, or an empty box", remedy="give finite numbers")

    def at(self, pixels: FloatArray) -> FloatArray:
        """Return (n, 2): by how much what the lens alone puts at pixels (n, 2) is displaced, px; NaN for NaN."""
        result = np.empty(pixels.shape)
        write_field(*_box_and_coefficients(self), np.ascontiguousarray(pixels, dtype=np.float64), result)
        return result

    def with_slopes(self, pixels: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what `at` returns, and its derivatives by the pixel (n, 2, 2), last axis the pixel's."""
        result, slopes = np.empty(pixels.shape), np.empty((*pixels.shape, 2))
        pixel = np.ascontiguousarray(pixels, dtype=np.float64)
        write_field_and_slopes(*_box_and_coefficients(self), pixel, result, slopes)
        return result, slopes

    def inverse(self, pixels: FloatArray) -> FloatArray:
        """Return (n, 2): the pixels of the lens alone that are displaced to pixels (n, 2).

        By Newton's method with the slopes at the pixels themselves: fields are of tenths of a pixel over hundreds, so a
        round gains five digits. NaN where it does not converge, as with a field that folds the image over.
        """
        result = np.empty(pixels.shape)
        write_inverse(*_box_and_coefficients(self), np.ascontiguousarray(pixels, dtype=np.float64), result)
        return result


@lru_cache(maxsize=64)
def _box_and_coefficients(field: Displacement) -> tuple[FloatArray, FloatArray]:
    """Return the box as (centre x, y, half-width x, y), and the coefficients (2, orders of x, orders of y), scaled."""
    orders = np.array(field.orders, dtype=np.int64).reshape(-1, 2)
    coefficients = np.zeros((2, *np.max(orders, axis=0, initial=1)))
    scale = 1.0 / math.sqrt(field.half_px[0] * field.half_px[1])
    for axis, values in enumerate((field.x_px, field.y_px)):
        np.add.at(coefficients[axis], (orders[:, 0] - 1, orders[:, 1] - 1), scale * np.array(values))
    return np.array([*field.center_px, *field.half_px]), coefficients
