"""The field's coefficients turned so that its own normal equations are diagonal: an amplitude then costs a division."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpstrf

from sunarc.array_types import FloatArray
from sunarc.calibration.model.residual_field import WaveBasis

_LARGEST_AMPLITUDE_PX = 64.0
"""px; far beyond any field that is tried."""
_NEGLIGIBLE = 1e-13
"""Share of a coefficient's prior variance that sightings must take away for it to matter at that amplitude."""


class FieldAxes(NamedTuple):
    """The axes for one length and unit amplitude.

    transform (m, r) takes turned coefficients back; power (r,) is what the sightings tell of each. Those of which they
    tell nothing are left out: products with derivatives and residuals are 0 there.
    """

    transform: FloatArray
    power: FloatArray

    def shrinkage(self, amplitudes: FloatArray) -> FloatArray:
        """Return (amplitudes, r): prior variance over one plus what is known, of each turned coefficient."""
        square = amplitudes[:, None] ** 2
        return np.asarray(square / (1.0 + square * self.power))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BasisProducts:
    """Products of the basis functions over the sightings, and their axes, each length's made once.

    Attributes
    ----------
    matrix : (m, m); the same for every camera.
    """

    matrix: FloatArray
    _axes: dict[float, FieldAxes] = field(default_factory=dict)

    def axes(self, basis: WaveBasis, length_px: float) -> FieldAxes:
        """Return the axes of a field of some length in px."""
        if length_px not in self._axes:
            shorter = [length for length in self._axes if length < length_px]
            self._axes[length_px] = (
                _longer(self._axes[max(shorter)], basis, max(shorter), length_px)
                if shorter
                else _field_axes(self.matrix, basis, length_px)
            )
        return self._axes[length_px]


def _field_axes(products: FloatArray, basis: WaveBasis, length_px: float) -> FieldAxes:
    spread = np.sqrt(basis.variances(length_px=length_px))
    return _axes_of(spread, _factor(products * spread[:, None] * spread))


def _longer(axes: FieldAxes, basis: WaveBasis, length_px: float, longer_px: float) -> FieldAxes:
    """Return the axes of a longer field from those of one of `length_px`, which has more of every short wave.

    With S and T the spreads of the two, S P S = V diag(p) V' gives T P T = B B', B = T S⁻¹ V diag(√p), and what P has
    beside that the longer field has still less of.
    """
    spread, longer = (np.sqrt(basis.variances(length_px=length)) for length in (length_px, longer_px))
    return _axes_of(longer, (longer / spread**2)[:, None] * axes.transform * np.sqrt(axes.power))


def _axes_of(spread: FloatArray, factor: FloatArray) -> FieldAxes:
    """Return the axes where the products in units of the spread (m,) are B B' of a factor (m, few)."""
    # not by B' B: the axes that sightings tell little of would not be orthogonal, and exact sightings then no evidence
    vectors, roots, _ = np.linalg.svd(factor, full_matrices=False)
    power = roots**2
    rounding = spread.size * np.finfo(np.float64).eps * float(np.max(power, initial=0.0))
    informative = power > max(rounding, _NEGLIGIBLE / _LARGEST_AMPLITUDE_PX**2)
    return FieldAxes(spread[:, None] * vectors[:, informative], power[informative])


def _factor(products: FloatArray) -> FloatArray:
    """Return B (m, few) with B B' a matrix of products of low rank: Cholesky's, the largest left over first."""
    largest = float(np.max(np.diag(products), initial=0.0))
    if largest <= 0.0:
        return np.zeros((products.shape[0], 0))
    lower, order, rank, _ = dpstrf(products, lower=1, tol=np.finfo(np.float64).eps * largest)
    factor = np.empty((products.shape[0], rank))
    factor[order - 1] = np.tril(lower)[:, :rank]
    return factor
