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
from sunarc.errors import InputError
from sunarc.jit import njit

HIGHEST_ORDER = 512
"""Half waves across the box: the shortest is then some pixels long."""
_ROUNDS = 60
_TOLERANCE_PX = 1e-11
_BLOCK = 128
"""Pixels taken together, so that the loops over waves run in vector registers."""


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
        """Refuse what is no displacement."""
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
        _write_field(*_box_and_coefficients(self), np.ascontiguousarray(pixels, dtype=np.float64), result)
        return result

    def with_slopes(self, pixels: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what `at` returns, and its derivatives by the pixel (n, 2, 2), last axis the pixel's."""
        result, slopes = np.empty(pixels.shape), np.empty((*pixels.shape, 2))
        pixel = np.ascontiguousarray(pixels, dtype=np.float64)
        _write_field_and_slopes(*_box_and_coefficients(self), pixel, result, slopes)
        return result, slopes

    def taken_out(self, pixels: FloatArray) -> FloatArray:
        """Return (n, 2): the pixels of the lens alone that are displaced to pixels (n, 2).

        By fixed-point iteration: fields are of tenths of a pixel over hundreds, so each round gains two digits or more.
        NaN where it does not converge, as with a field that folds the image over.
        """
        before = np.array(pixels, dtype=np.float64)
        change = np.full(before.shape[0], np.inf)
        for _ in range(_ROUNDS):
            then = pixels - self.at(before)
            change = np.max(np.abs(then - before), axis=-1, initial=0.0)
            before = then
            if not np.any(change > _TOLERANCE_PX):
                break
        before[change > _TOLERANCE_PX] = np.nan
        return before


@lru_cache(maxsize=64)
def _box_and_coefficients(field: Displacement) -> tuple[FloatArray, FloatArray]:
    """Return the box as (centre x, y, half-width x, y), and the coefficients (2, orders of x, orders of y), scaled."""
    orders = np.array(field.orders, dtype=np.int64).reshape(-1, 2)
    coefficients = np.zeros((2, *np.max(orders, axis=0, initial=1)))
    scale = 1.0 / math.sqrt(field.half_px[0] * field.half_px[1])
    for axis, values in enumerate((field.x_px, field.y_px)):
        np.add.at(coefficients[axis], (orders[:, 0] - 1, orders[:, 1] - 1), scale * np.array(values))
    return np.array([*field.center_px, *field.half_px]), coefficients


@njit(nogil=True)
def _write_sines(angle: float, sines: FloatArray, cosines: FloatArray) -> None:
    """Write sin(k a) and cos(k a) for k = 1 … n, by the addition theorem."""
    sine, cosine = math.sin(angle), math.cos(angle)
    sines[0], cosines[0] = sine, cosine
    for k in range(1, sines.size):
        sines[k] = sines[k - 1] * cosine + cosines[k - 1] * sine
        cosines[k] = cosines[k - 1] * cosine - sines[k - 1] * sine


@njit(nogil=True, fastmath={"contract"})
def _write_sines_of(angles: FloatArray, sines: FloatArray) -> None:
    """Write sin(k a), k = 1 … n, of angles (m,) into (n, m): sin((k + 1) a) = 2 cos(a) sin(k a) - sin((k - 1) a)."""
    twice = np.empty(angles.size)
    for i in range(angles.size):
        sines[0, i], twice[i] = math.sin(angles[i]), 2.0 * math.cos(angles[i])
    for k in range(1, sines.shape[0]):
        for i in range(angles.size):
            before = sines[k - 2, i] if k > 1 else 0.0
            sines[k, i] = twice[i] * sines[k - 1, i] - before


@njit(nogil=True, fastmath={"contract"})
def _write_field(box: FloatArray, coefficients: FloatArray, pixels: FloatArray, result: FloatArray) -> None:
    """Write the displacements (n, 2) at pixels (n, 2), in blocks: Cʹ sin(y) is then a product of matrices."""
    nx, ny = coefficients.shape[1], coefficients.shape[2]
    flat, rows = coefficients.reshape(2 * nx, ny), np.empty((2 * nx, _BLOCK))
    sines_x, sines_y = np.empty((nx, _BLOCK)), np.empty((ny, _BLOCK))
    across, down, total = np.zeros(_BLOCK), np.zeros(_BLOCK), np.empty((2, _BLOCK))
    for begin in range(0, pixels.shape[0], _BLOCK):
        size = min(_BLOCK, pixels.shape[0] - begin)
        for i in range(size):
            across[i] = 0.5 * math.pi * ((pixels[begin + i, 0] - box[0]) / box[2] + 1.0)
            down[i] = 0.5 * math.pi * ((pixels[begin + i, 1] - box[1]) / box[3] + 1.0)
        _write_sines_of(across, sines_x)
        _write_sines_of(down, sines_y)
        np.dot(flat, sines_y, rows)
        total[:] = 0.0
        for c in range(2):
            for j in range(nx):
                for i in range(_BLOCK):
                    total[c, i] += sines_x[j, i] * rows[c * nx + j, i]
        for i in range(size):
            is_within = 0.0 < across[i] < math.pi and 0.0 < down[i] < math.pi
            is_number = not (math.isnan(across[i]) or math.isnan(down[i]))
            for c in range(2):
                result[begin + i, c] = total[c, i] if is_within else (0.0 if is_number else math.nan)


@njit(nogil=True)
def _write_field_and_slopes(
    box: FloatArray, coefficients: FloatArray, pixels: FloatArray, result: FloatArray, slopes: FloatArray
) -> None:
    _write_field(box, coefficients, pixels, result)
    nx, ny = coefficients.shape[1], coefficients.shape[2]
    sx, cx, sy, cy = np.empty(nx), np.empty(nx), np.empty(ny), np.empty(ny)
    per_x, per_y = 0.5 * math.pi / box[2], 0.5 * math.pi / box[3]
    for i in range(pixels.shape[0]):
        across, down = (pixels[i, 0] - box[0]) / box[2], (pixels[i, 1] - box[1]) / box[3]
        slopes[i] = 0.0
        if not (abs(across) < 1.0 and abs(down) < 1.0):
            continue
        _write_sines(0.5 * math.pi * (across + 1.0), sx, cx)
        _write_sines(0.5 * math.pi * (down + 1.0), sy, cy)
        for a in range(2):
            for j in range(nx):
                for k in range(ny):
                    slopes[i, a, 0] += coefficients[a, j, k] * (j + 1) * per_x * cx[j] * sy[k]
                    slopes[i, a, 1] += coefficients[a, j, k] * (k + 1) * per_y * sx[j] * cy[k]
