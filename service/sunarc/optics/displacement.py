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

from sunarc import _kernels
from sunarc.array_types import FloatArray
from sunarc.errors import InputError

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
        return _kernels.displacement_at(*_box_and_coefficients(self), np.ascontiguousarray(pixels, dtype=np.float64))

    def with_slopes(self, pixels: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what `at` returns, and its derivatives by the pixel (n, 2, 2), last axis the pixel's."""
        pixel = np.ascontiguousarray(pixels, dtype=np.float64)
        return _kernels.displacement_and_slopes(*_box_and_coefficients(self), pixel)

    def inverse(self, pixels: FloatArray) -> FloatArray:
        """Return (n, 2): the pixels of the lens alone that are displaced to pixels (n, 2).

        By Newton's method with the slopes at the pixels themselves: fields are of tenths of a pixel over hundreds, so a
        round gains five digits. NaN where it does not converge, as with a field that folds the image over.
        """
        pixel = np.ascontiguousarray(pixels, dtype=np.float64)
        return _kernels.displacement_inverse(*_box_and_coefficients(self), pixel)


@lru_cache(maxsize=64)
def _box_and_coefficients(field: Displacement) -> tuple[FloatArray, FloatArray]:
    """Return the box as (centre x, y, half-width x, y), and the coefficients (2, orders of x, orders of y), scaled."""
    orders = np.array(field.orders, dtype=np.int64).reshape(-1, 2)
    coefficients = np.zeros((2, *np.max(orders, axis=0, initial=1)))
    scale = 1.0 / math.sqrt(field.half_px[0] * field.half_px[1])
    for axis, values in enumerate((field.x_px, field.y_px)):
        np.add.at(coefficients[axis], (orders[:, 0] - 1, orders[:, 1] - 1), scale * np.array(values))
    return np.array([*field.center_px, *field.half_px]), coefficients
