"""Displacement outside the lens model: a smooth random field over the image, in a low-rank basis.

Both components are independent Gaussian processes with the kernel A² exp(-d²/2L²), written as a sum over the sine waves
that vanish on a box around the image; A and L enter only through the variances of the coefficients.
Reference: A. Solin and S. Särkkä, "Hilbert space methods for reduced-rank Gaussian process regression", Statistics and
Computing 30 (2020).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from sunarc.common.array_types import FloatArray
from sunarc.optics.displacement import WaveBasis

LEAST_UNKNOWN = 0.02
"""1-sigma of a field, as a share of its amplitude, that always stays unknown: about that of the waves left out."""


def _empty_array() -> FloatArray:
    return np.zeros(0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Field:
    """Uncertainty of the field: the errors of the camera's displacement.

    With D the variances of the coefficients before any sighting, `WaveBasis.variances` times the square of the
    amplitude, the errors of the coefficients have the covariance D - Kᵀ K for either component, and in addition Bᵀ B
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
    known: FloatArray = field(default_factory=_empty_array)
    coupling: FloatArray = field(default_factory=_empty_array)

    def __post_init__(self) -> None:
        """Give the omitted parts their shape: nothing is known but how field and parameters hang together."""
        waves = len(self.basis.orders)
        object.__setattr__(self, "known", self.known.reshape(-1, waves) if waves else np.zeros((0, 0)))
        object.__setattr__(self, "coupling", self.coupling.reshape(2, -1, waves) if waves else np.zeros((2, 0, 0)))

    def widened(self, factor: float) -> Field:
        """Return the field with all its errors, and those shared with the parameters, multiplied by a factor."""
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
        """Return (n, 2, 2), px²: the field's part of the covariance of the prediction's errors.

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
