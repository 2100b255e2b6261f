"""What sightings say of the field: see `Field` for the covariance that this makes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.fit.marginal_likelihood import MarginalFit, NormalEquations, Scales
from sunarc.calibration.model.residual_field import Field, WaveBasis

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


def prediction_variance(
    fit: MarginalFit,
    scales: Scales,
    basis: WaveBasis,
    *,
    rows: FloatArray,
    basis_values: FloatArray,
    normal: NormalEquations | None = None,
) -> FloatArray:
    """Return (n,): trace of the covariance of the predicted pixel under some scales, px².

    Parameters
    ----------
    fit, scales, basis : the fit under the scales, and the basis of the field.
    rows, basis_values : slopes of the pixels to the unknowns, (n, 2, p), and of the field there, (n, m).
    normal : sums over the sightings; None for a field whose mean is not part of the prediction.
    """
    field = Field(amplitude_px=scales.amplitude_px, length_px=scales.length_px, basis=basis, cross=fit.cross)
    if normal is not None:
        field = seen_field(field, normal, fit.covariance)
    by_parameters = np.einsum("nap,pq,naq->n", rows, fit.covariance, rows, optimize=True)
    by_field = np.trace(field.covariance(rows, basis_values), axis1=-2, axis2=-1)
    return np.asarray(np.maximum(by_parameters + by_field, 0.0))


def joint_covariance(covariance: FloatArray, field: Field, rows: FloatArray, values: FloatArray) -> FloatArray:
    """Return (2 n, 2 n), px²: of the errors of n predicted pixels together, x and y of each by turns.

    Parameters
    ----------
    covariance, field : of the unknowns, (p, p), and of the field about its mean.
    rows, values : slopes of the pixels to the unknowns, (n, 2, p), and of the field there, (n, m).
    """
    n = rows.shape[0]
    flat = rows.reshape(2 * n, -1)
    crossed, coupled = (
        np.stack([values @ one.T for one in part], axis=1).reshape(2 * n, -1) for part in (field.cross, field.coupling)
    )
    mixed = flat @ crossed.T
    variances = field.amplitude_px**2 * field.basis.variances(length_px=field.length_px)
    known = values @ field.known.T
    own = (values * variances) @ values.T - known @ known.T
    return np.asarray(flat @ covariance @ flat.T + mixed + mixed.T + coupled @ coupled.T + np.kron(own, np.eye(2)))


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
