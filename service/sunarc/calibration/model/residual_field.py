"""What no lens model describes: a smooth random field of displacements over the image, in a low-rank basis.

Both components are independent Gaussian processes with the kernel A² exp(-d²/2L²), written as a sum over the sine waves
that vanish on a box around the image; A and L enter only through the variances of the coefficients.
Reference: A. Solin and S. Särkkä, "Hilbert space methods for reduced-rank Gaussian process regression", Statistics and
Computing 30 (2020).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from sunarc import _kernels
from sunarc.array_types import FloatArray, IntArray
from sunarc.optics.displacement import Displacement

_MARGIN_LENGTHS = 1.2
_REACH = 3.6
"""Waves are kept up to this many inverse lengths: the rest holds exp(-3.6² / 2), 0.15 % of the variance."""
LEAST_UNKNOWN = 0.02
"""1-sigma of a field, as a share of its amplitude, that always stays unknown: about what the waves left out hold."""


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
        return WaveBasis(center_px=self.center_px, half_px=self.half_px, orders=_orders(self.half_px, reach))

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

    def coefficients_of(self, displacement: Displacement | None) -> FloatArray:
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
    orders = _orders(box, _REACH / shortest_px)
    return WaveBasis(center_px=((width - 1) / 2.0, (height - 1) / 2.0), half_px=box, orders=orders)


def _orders(half_px: tuple[float, float], reach: float) -> IntArray:
    """Return the orders of all waves on a box whose frequency is at most `reach`."""
    # a half wave on a box of half-width h has the frequency pi / 2h
    number = [math.ceil(2.0 * h * reach / math.pi) for h in half_px]
    nx, ny = np.meshgrid(np.arange(1, number[0] + 1), np.arange(1, number[1] + 1), indexing="ij")
    frequency = np.hypot(0.5 * math.pi * nx / half_px[0], 0.5 * math.pi * ny / half_px[1])
    return np.stack([nx[frequency <= reach], ny[frequency <= reach]], axis=-1)


def _nothing() -> FloatArray:
    return np.zeros(0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Field:
    """What a calibration does not know of the field: its errors about the camera's displacement.

    With D the variances of the coefficients before any sighting, `WaveBasis.variances` times the square of the
    amplitude, the errors of the coefficients have the covariance D - Kᵀ K for either component, and beside it Bᵀ B
    over both.

    Attributes
    ----------
    amplitude_px : 1-sigma of a component before any sighting.
    length_px : distance over which it changes.
    basis : its m waves.
    cross : (2, p, m) covariance between the p estimated parameters' errors and those of the coefficients of the x and y
        components.
    known : K, (r, m): what the sightings tell of the field of either component, the parameters given; nothing: r = 0.
    coupling : B, (2, q, m): what the parameters' errors leave open in the field.
    """

    amplitude_px: float
    length_px: float
    basis: WaveBasis
    cross: FloatArray
    known: FloatArray = field(default_factory=_nothing)
    coupling: FloatArray = field(default_factory=_nothing)

    def __post_init__(self) -> None:
        """Give what is left out its shape: nothing is known but how field and parameters hang together."""
        waves = len(self.basis.orders)
        object.__setattr__(self, "known", self.known.reshape(-1, waves) if waves else np.zeros((0, 0)))
        object.__setattr__(self, "coupling", self.coupling.reshape(2, -1, waves) if waves else np.zeros((2, 0, 0)))

    def widened(self, factor: float) -> Field:
        """Return the field with all its errors, and those that it shares with the parameters, larger by a factor."""
        return replace(
            self,
            amplitude_px=factor * self.amplitude_px,
            cross=factor**2 * self.cross,
            known=factor * self.known,
            coupling=factor * self.coupling,
        )

    def reduction(self, values: FloatArray) -> FloatArray:
        """Return (n, r): K φ at places of basis values (n, m), px, as if the waves had the whole of A² there.

        They are 0.15 % short of it, and shorter near the box's edge: what is known is a share of what there is.
        """
        if self.known.shape[0] == 0:
            return np.zeros((values.shape[0], 0))
        own = values**2 @ self.basis.variances(length_px=self.length_px)
        return np.asarray((values @ self.known.T) / np.sqrt(np.where(own > 0.0, own, 1.0))[:, None])

    def covariance(self, rows: FloatArray, values: FloatArray) -> FloatArray:
        """Return (n, 2, 2), px²: what the field adds to the covariance of the prediction's errors.

        Parameters
        ----------
        rows : (n, 2, p) derivatives of the prediction by the parameters.
        values : (n, m) of the basis there.
        """
        crossed = np.stack([values @ self.cross[a].T for a in (0, 1)])
        mixed = np.einsum("nap,bnp->nab", rows, crossed)
        coupled = np.stack([values @ self.coupling[a].T for a in (0, 1)])
        unknown = np.maximum(self.amplitude_px**2 - np.sum(self.reduction(values) ** 2, axis=-1), 0.0)
        unknown = np.maximum(unknown, (LEAST_UNKNOWN * self.amplitude_px) ** 2)
        both = mixed + np.swapaxes(mixed, -1, -2) + np.einsum("anq,bnq->nab", coupled, coupled)
        return np.asarray(both + unknown[:, None, None] * np.eye(2))
