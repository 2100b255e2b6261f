"""Displacement of the image with respect to the lens: a smooth field outside the lens's formula.

Lenses and sensors are not quite as a formula with twelve coefficients has them. The rest, tenths of a pixel, is smooth
over the image, and is written in sine waves on a box around it (`calibration.model.residual_field` says where they come
from). It is added to the pixel that the lens alone gives, so it stays where it is in the image when the camera turns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from sunarc import _kernels
from sunarc.common.array_types import FloatArray, IntArray
from sunarc.common.errors import InputError

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
        """Refuse an invalid displacement."""
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
        """Return (n, 2): the displacement of pixels (n, 2) of the lens alone, px; NaN for NaN."""
        return _kernels.displacement_at(
            *_get_box_and_coefficients(self), np.ascontiguousarray(pixels, dtype=np.float64)
        )

    def value_and_slopes(self, pixels: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the displacement as `at` does, and its derivatives by the pixel (n, 2, 2), last axis the pixel's."""
        pixel = np.ascontiguousarray(pixels, dtype=np.float64)
        return _kernels.displacement_and_slopes(*_get_box_and_coefficients(self), pixel)

    def inverse(self, pixels: FloatArray) -> FloatArray:
        """Return (n, 2): the pixels of the lens alone that are displaced to pixels (n, 2).

        By Newton's method with the slopes at the pixels themselves: fields are of tenths of a pixel over hundreds, so a
        round gains five digits. NaN where it does not converge, as with a field that folds the image over.
        """
        pixel = np.ascontiguousarray(pixels, dtype=np.float64)
        return _kernels.displacement_inverse(*_get_box_and_coefficients(self), pixel)


@lru_cache(maxsize=64)
def _get_box_and_coefficients(field: Displacement) -> tuple[FloatArray, FloatArray]:
    """Return the box as (centre x, y, half-width x, y), and the coefficients (2, orders of x, orders of y), scaled."""
    orders = np.array(field.orders, dtype=np.int64).reshape(-1, 2)
    coefficients = np.zeros((2, *np.max(orders, axis=0, initial=1)))
    scale = 1.0 / math.sqrt(field.half_px[0] * field.half_px[1])
    for axis, values in enumerate((field.x_px, field.y_px)):
        np.add.at(coefficients[axis], (orders[:, 0] - 1, orders[:, 1] - 1), scale * np.array(values))
    return np.array([*field.center_px, *field.half_px]), coefficients


# The waves as a basis of smooth fields: both components of a displacement are written in it.
#
# A field of a length in px is a Gaussian process with the kernel A² exp(-d²/2L²) (calibration/model/residual_field).

_MARGIN_LENGTHS = 1.2
_REACH = 3.6
"""Waves are kept up to this many inverse lengths: the rest holds exp(-3.6² / 2), 0.15 % of the variance."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WaveBasis:
    """Sine waves on a box: an orthonormal basis for smooth fields over an image.

    Attributes
    ----------
    center_px, half_px : centre and half-widths of the box.
    orders : (m, 2) whole numbers of half waves along x and y.
    """

    center_px: tuple[float, float]
    half_px: tuple[float, float]
    orders: IntArray

    def values(self, pixels: ArrayLike) -> FloatArray:
        """Return (..., m): the waves at pixels (..., 2); 0 beyond the box."""
        pixel = np.asarray(pixels, dtype=np.float64)
        orders = np.ascontiguousarray(self.orders, dtype=np.int64)
        if orders.size == 0:
            return np.zeros((*pixel.shape[:-1], 0))
        flat = np.ascontiguousarray(pixel.reshape(-1, 2))
        box = np.array([*self.center_px, *self.half_px], dtype=np.float64)
        return np.asarray(_kernels.waves_at(flat, box, orders).reshape(*pixel.shape[:-1], orders.shape[0]))

    def variances(self, *, length_px: float) -> FloatArray:
        """Return (m,): the coefficients' variances of a field of unit amplitude and a length in px."""
        frequency = 0.5 * math.pi * self.orders / np.array(self.half_px)
        square = np.sum(frequency**2, axis=-1)
        return np.asarray(2.0 * math.pi * length_px**2 * np.exp(-0.5 * length_px**2 * square))

    def completed(self, *, length_px: float) -> WaveBasis:
        """Return this basis with all the waves on its box that a field of this length needs."""
        reach = _REACH / length_px
        return WaveBasis(center_px=self.center_px, half_px=self.half_px, orders=_list_wave_orders(self.half_px, reach))

    @classmethod
    def of(cls, displacement: Displacement) -> WaveBasis:
        """Return the basis that a displacement is written in."""
        orders = np.array(displacement.orders, dtype=np.int64).reshape(-1, 2)
        return cls(center_px=displacement.center_px, half_px=displacement.half_px, orders=orders)

    def displacement(self, coefficients: FloatArray) -> Displacement:
        """Return the displacement with coefficients (2, m) of its x and y components."""
        return Displacement(
            center_px=self.center_px,
            half_px=self.half_px,
            orders=tuple((int(x), int(y)) for x, y in self.orders),
            x_px=tuple(coefficients[0].tolist()),
            y_px=tuple(coefficients[1].tolist()),
        )

    def spread(self, terms: FloatArray, complete: WaveBasis) -> FloatArray:
        """Return terms (..., m) on a basis of more functions on the same box; those that it does not have are lost."""
        index = {(int(x), int(y)): k for k, (x, y) in enumerate(complete.orders)}
        shared = [(k, index[int(x), int(y)]) for k, (x, y) in enumerate(self.orders) if (int(x), int(y)) in index]
        result = np.zeros((*terms.shape[:-1], len(complete.orders)))
        if shared:
            old, new = np.array(shared).T
            result[..., new] = terms[..., old]
        return result

    def fit_coefficients(self, displacement: Displacement | None) -> FloatArray:
        """Return (2, m): the coefficients of a displacement on the same box in this basis; 0 without one."""
        if displacement is None:
            return np.zeros((2, len(self.orders)))
        return WaveBasis.of(displacement).spread(np.array([displacement.x_px, displacement.y_px]), self)


def wave_basis(*, width: int, height: int, shortest_px: float, longest_px: float) -> WaveBasis:
    """Return the waves that fields over an image need.

    Parameters
    ----------
    width, height : image size, px.
    shortest_px, longest_px : the lengths that the field may have.
    """
    half = tuple(0.5 * size + _MARGIN_LENGTHS * longest_px for size in (width, height))
    box = (half[0], half[1])
    orders = _list_wave_orders(box, _REACH / shortest_px)
    return WaveBasis(center_px=((width - 1) / 2.0, (height - 1) / 2.0), half_px=box, orders=orders)


def _list_wave_orders(half_px: tuple[float, float], reach: float) -> IntArray:
    """Return the orders of all waves on a box whose frequency is at most `reach`."""
    # a half wave on a box of half-width h has the frequency pi / 2h
    number = [math.ceil(2.0 * h * reach / math.pi) for h in half_px]
    nx, ny = np.meshgrid(np.arange(1, number[0] + 1), np.arange(1, number[1] + 1), indexing="ij")
    frequency = np.hypot(0.5 * math.pi * nx / half_px[0], 0.5 * math.pi * ny / half_px[1])
    return np.stack([nx[frequency <= reach], ny[frequency <= reach]], axis=-1)
