"""What sightings say of the field: see `Field` for the covariance that this makes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.fit.marginal_likelihood import NormalEquations
from sunarc.calibration.model.residual_field import Field

_LEAST_KNOWN = 0.01
"""Share of a coefficient's variance that sightings take away, below which it counts as unknown."""
_LEAST_COUPLED = 1e-6
"""Share of the largest variance below which what the parameters leave open in the field is left out."""
_RIDGE = 1e-12


def seen_field(unseen: Field, normal: NormalEquations, covariance: FloatArray) -> Field:
    """Return the field with what sightings tell of it about its mean.

    Parameters
    ----------
    unseen : with its cross terms X with the unknowns, (2, p, m).
    normal : sums over the sightings.
    covariance : C of the unknowns, (p, p).
    """
    return replace(unseen, known=_known(unseen, normal), coupling=_coupling(covariance, unseen.cross))


def _known(field: Field, normal: NormalEquations) -> FloatArray:
    """Return K, (r, m): with the unknowns given, an axis measured to t has 1 / (1 + t) of its variance left."""
    axes = normal.ff.axes(field.basis, field.length_px)
    measured = field.amplitude_px**2 * axes.power
    counts = measured > _LEAST_KNOWN
    measured = measured[counts]
    return np.asarray(
        (field.amplitude_px * np.sqrt(measured / (1.0 + measured)))[:, None] * axes.transform[:, counts].T
    )


def _coupling(covariance: FloatArray, cross: FloatArray) -> FloatArray:
    """Return B, (2, q, m), with Bᵀ B = Xᵀ C⁻¹ X."""
    scale = np.sqrt(np.diag(covariance))
    root = np.linalg.cholesky(covariance / np.outer(scale, scale) + _RIDGE * np.eye(scale.size))
    both = np.linalg.solve(root, np.concatenate(list(cross / scale[:, None]), axis=-1))
    values, vectors = np.linalg.eigh(both @ both.T)
    turned = vectors[:, values > _LEAST_COUPLED * values[-1]].T @ both
    return np.stack(np.split(turned, 2, axis=-1))
