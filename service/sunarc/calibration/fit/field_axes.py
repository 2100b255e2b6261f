"""The field's coefficients turned so that its own normal equations are diagonal: an amplitude then costs a division."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

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
            self._axes[length_px] = _field_axes(self.matrix, basis, length_px)
        return self._axes[length_px]


def _field_axes(products: FloatArray, basis: WaveBasis, length_px: float) -> FieldAxes:
    spread = np.sqrt(basis.variances(length_px=length_px))
    power, vectors = np.linalg.eigh(products * spread[:, None] * spread)
    rounding = power.size * np.finfo(np.float64).eps * float(np.max(power, initial=0.0))
    informative = power > max(rounding, _NEGLIGIBLE / _LARGEST_AMPLITUDE_PX**2)
    return FieldAxes(spread[:, None] * vectors[:, informative], power[informative])
