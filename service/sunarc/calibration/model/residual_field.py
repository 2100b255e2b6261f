"""What no lens model describes: a smooth random field of displacements over the image, in a low-rank basis.

Both components are independent Gaussian processes with the kernel A² exp(-d²/2L²), written as a sum over the sine waves
that vanish on a box around the image; A and L enter only through the variances of the coefficients.
Reference: A. Solin and S. Särkkä, "Hilbert space methods for reduced-rank Gaussian process regression", Statistics and
Computing 30 (2020).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sunarc.array_types import FloatArray, IntArray

_MARGIN_LENGTHS = 1.2
_REACH = 3.6
"""Waves are kept up to this many inverse lengths: the rest holds 0.03 % of the variance."""


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
        """Return (..., m): the waves at pixels (..., 2)."""
        pixel = np.asarray(pixels, dtype=np.float64)
        along_x = self._sines(pixel[..., 0], 0)[..., self.orders[:, 0] - 1]
        along_y = self._sines(pixel[..., 1], 1)[..., self.orders[:, 1] - 1]
        return np.asarray(along_x * along_y)

    def variances(self, *, length_px: float) -> FloatArray:
        """Return (m,): the coefficients' variances of a field of unit amplitude and a length in px."""
        frequency = 0.5 * math.pi * self.orders / np.array(self.half_px)
        square = np.sum(frequency**2, axis=-1)
        return np.asarray(2.0 * math.pi * length_px**2 * np.exp(-0.5 * length_px**2 * square))

    def completed(self, *, length_px: float) -> WaveBasis:
        """Return this basis with all the waves on its box that a field of this length needs."""
        reach = _REACH / length_px
        return WaveBasis(center_px=self.center_px, half_px=self.half_px, orders=_orders(self.half_px, reach))

    def _sines(self, coordinate: FloatArray, axis: int) -> FloatArray:
        half = self.half_px[axis]
        number = np.arange(1, int(self.orders[:, axis].max(initial=0)) + 1)
        phase = (0.5 * math.pi / half) * (coordinate - self.center_px[axis] + half)
        return np.asarray(np.sin(phase[..., None] * number) / math.sqrt(half))


def wave_basis(*, width: int, height: int, shortest_px: float, longest_px: float) -> WaveBasis:
    """Return the waves that fields over an image need.

    Parameters
    ----------
    width, height : image size, px.
    shortest_px, longest_px : the lengths that the field may have.
    """
    half = tuple(0.5 * size + _MARGIN_LENGTHS * longest_px for size in (width, height))
    box = (half[0], half[1])
    orders = _orders(box, _REACH / shortest_px)
    return WaveBasis(center_px=((width - 1) / 2.0, (height - 1) / 2.0), half_px=box, orders=orders)


def _orders(half_px: tuple[float, float], reach: float) -> IntArray:
    """Return the orders of all waves on a box whose frequency is at most `reach`."""
    # a half wave on a box of half-width h has the frequency pi / 2h
    number = [math.ceil(2.0 * h * reach / math.pi) for h in half_px]
    nx, ny = np.meshgrid(np.arange(1, number[0] + 1), np.arange(1, number[1] + 1), indexing="ij")
    frequency = np.hypot(0.5 * math.pi * nx / half_px[0], 0.5 * math.pi * ny / half_px[1])
    return np.stack([nx[frequency <= reach], ny[frequency <= reach]], axis=-1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Field:
    """The discrepancy field of a calibration: how large, how smooth, and how it hangs together with the parameters.

    Attributes
    ----------
    amplitude_px : 1-sigma of a component.
    length_px : distance over which it changes.
    basis : its waves.
    cross : (2, n, m) covariance between the n estimated parameters and the coefficients of the x and y components.
    """

    amplitude_px: float
    length_px: float
    basis: WaveBasis
    cross: FloatArray
