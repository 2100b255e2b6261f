"""The fit with the field marginalised, and how probable the data are under each choice of scales.

With the lens and pose as θ (prior precision P about 0) and the field's coefficients as c, the sightings are r = J dθ
+ Φ c + noise. Everything needed is a few sums over the sightings (`NormalEquations`), so that the amplitude and the
length of the field and the scale of the residual radial distortion can be tried at the price of one small
factorisation each (generalised least squares, Laplace's approximation of the marginal likelihood).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.least_squares.priors import N_LENS, precisions
from sunarc.calibration.model.residual_field import WaveBasis

_POSE_PRECISION = 1e-8
"""Poses are unknown; 1 / 10⁴ rad² keeps the equations solvable with the poorest data."""
_RIDGE = 1e-13
_ROUNDING = 1e-13
"""Share of the sightings' whole information that is lost to rounding where the field takes nearly all of it."""


class Scales(NamedTuple):
    """The choices, px: the field's amplitude and length, the scales of the radial distortion and the decentering."""

    amplitude_px: float
    length_px: float
    radial_px: float
    decentering_px: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NormalEquations:
    """Sums over the sightings: all that a fit needs of them.

    Attributes
    ----------
    jj, jf, ff : (p, p), (2, p, m), (m, m) products of derivatives and of basis values (both components share ff).
    jr, fr, rr : (p,), (2, m), scalar products with the residuals.
    at : (p,) the unknowns that they were made at.
    n_air : how many of the last unknowns are the refraction's, of unit prior variance.
    """

    jj: FloatArray
    jf: FloatArray
    ff: FloatArray
    jr: FloatArray
    fr: FloatArray
    rr: float
    at: FloatArray
    n_air: int = 0

    def prior_precision(self, radial_px: float, decentering_px: float) -> FloatArray:
        """Return the prior precisions of the unknowns under two scales of the lens, (p,)."""
        return prior_precision(self.at.size, radial_px, decentering_px, n_air=self.n_air)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MarginalFit:
    """The fit under one choice of scales.

    Attributes
    ----------
    unknowns : (p,) most probable unknowns.
    gain : what the step there is expected to take from the penalty.
    coefficients : (2, m) most probable coefficients of the field.
    covariance : (p, p) of the unknowns; cross: (2, p, m) with the coefficients.
    """

    unknowns: FloatArray
    gain: float
    coefficients: FloatArray
    covariance: FloatArray
    cross: FloatArray


def normal_sums(
    rows: FloatArray,
    basis_values: FloatArray,
    residual: FloatArray,
    information: FloatArray,
    *,
    at: FloatArray,
    ff: FloatArray | None = None,
    n_air: int = 0,
) -> NormalEquations:
    """Return the sums over sightings: rows (n, 2, p), basis_values (n, m), residual (n, 2), information (n,).

    `ff` does not change with the camera: who has it already gives it.
    """
    root = np.sqrt(information)
    j = rows * root[:, None, None]
    f = basis_values * root[:, None]
    r = residual * root[:, None]
    flat = j.reshape(-1, j.shape[-1])
    return NormalEquations(
        jj=flat.T @ flat,
        jf=np.stack([j[:, a].T @ f for a in (0, 1)]),
        ff=f.T @ f if ff is None else ff,
        jr=flat.T @ r.ravel(),
        fr=np.stack([f.T @ r[:, a] for a in (0, 1)]),
        rr=float(np.sum(r**2)),
        at=at,
        n_air=n_air,
    )


def prior_precision(size: int, radial_px: float, decentering_px: float, *, n_air: int = 0) -> FloatArray:
    """Return the prior precisions of all unknowns, (size,): lens, poses, and the refraction's."""
    poses = np.full(size - N_LENS - n_air, _POSE_PRECISION)
    return np.concatenate([precisions(radial_px, decentering_px), poses, np.ones(n_air)])


def marginal_fit(normal: NormalEquations, basis: WaveBasis, scales: Scales) -> MarginalFit:
    """Return the fit under one choice of scales."""
    return marginal_fits(normal, basis, [scales])[0]


def marginal_fits(normal: NormalEquations, basis: WaveBasis, choices: Sequence[Scales]) -> list[MarginalFit]:
    """Return the fits under several choices of scales."""
    reduced = {length: _Reduced.of(normal, basis, length) for length in {scales.length_px for scales in choices}}
    return [_fit(normal, reduced[scales.length_px], scales) for scales in choices]


def _fit(normal: NormalEquations, reduced: _Reduced, scales: Scales) -> MarginalFit:
    shrink = reduced.shrinkage(np.array([scales.amplitude_px]))[0]
    precision = normal.prior_precision(scales.radial_px, scales.decentering_px)
    matrix = normal.jj - reduced.absorbed(shrink) + np.diag(precision + _ROUNDING * np.diag(normal.jj))
    vector = normal.jr - reduced.explained(shrink) - precision * normal.at
    scale = 1.0 / np.sqrt(np.diag(matrix))
    scaled = matrix * scale[:, None] * scale + _RIDGE * np.eye(normal.at.size)
    covariance = np.linalg.inv(scaled) * scale[:, None] * scale
    covariance = 0.5 * (covariance + covariance.T)
    # the field is integrated out already: this is the mean of the unknowns' marginal
    step = covariance @ vector
    residual = reduced.residual - step @ reduced.rows
    return MarginalFit(
        unknowns=normal.at + step,
        gain=float(step @ vector),
        coefficients=(shrink * residual) @ reduced.transform.T,
        covariance=covariance,
        cross=-(covariance @ (reduced.rows * shrink)) @ reduced.transform.T,
    )


def responses(
    normal: NormalEquations, basis: WaveBasis, scales: Scales, *, jr: FloatArray, fr: FloatArray
) -> FloatArray:
    """Return (k, p): by how much the fit moves where the sightings are displaced in k ways.

    Parameters
    ----------
    jr, fr : (k, p), (k, 2, m) products of the derivatives and of the basis values with each displacement, see
        `NormalEquations`.
    """
    reduced = _Reduced.of(normal, basis, scales.length_px)
    shrink = reduced.shrinkage(np.array([scales.amplitude_px]))[0]
    explained = np.einsum("apm,m,kam->kp", reduced.rows, shrink, fr @ reduced.transform, optimize=True)
    return np.asarray((jr - explained) @ marginal_fit(normal, basis, scales).covariance)


def penalty(normal: NormalEquations, basis: WaveBasis, scales: Scales) -> float:
    """Return what a fit makes small at `normal.at`: twice the negative log posterior, the field at its best."""
    reduced = _Reduced.of(normal, basis, scales.length_px)
    shrink = reduced.shrinkage(np.array([scales.amplitude_px]))[0]
    precision = normal.prior_precision(scales.radial_px, scales.decentering_px)
    explained = float(np.sum(shrink * reduced.residual**2))
    return normal.rr - explained + float(np.sum(precision * normal.at**2))


def log_evidences(
    normal: NormalEquations, basis: WaveBasis, *, amplitudes: FloatArray, lengths: FloatArray, lens_scales: FloatArray
) -> FloatArray:
    """Return the log evidence on a grid, (amplitudes, lengths, lens_scales), but for a constant.

    `lens_scales` (k, 2) holds pairs of the radial distortion's and the decentering's scale.
    """
    precision = np.stack([normal.prior_precision(float(r), float(d)) for r, d in lens_scales])
    each = [_log_evidence(normal, _Reduced.of(normal, basis, float(l)), amplitudes, precision) for l in lengths]
    return np.stack(each, axis=1)


def _log_evidence(
    normal: NormalEquations, reduced: _Reduced, amplitudes: FloatArray, precision: FloatArray
) -> FloatArray:
    """Return (amplitudes, k) for one length and prior precisions (k, p)."""
    shrink = reduced.shrinkage(amplitudes)
    absorbed = np.stack([reduced.absorbed(row) for row in shrink])
    vector = normal.jr - np.stack([reduced.explained(row) for row in shrink])
    # Woodbury's identity: the inverse of noise plus field acts through the turned coefficients
    square = normal.rr - np.einsum("am,im,am->i", reduced.residual, shrink, reduced.residual, optimize=True)
    # twice: the field's two components have the same kernel and the same sightings
    determinant = 2.0 * np.sum(np.log1p(amplitudes[:, None] ** 2 * reduced.power), axis=1)
    rounding = _ROUNDING * np.diag(normal.jj)
    matrix = (normal.jj - absorbed)[:, None] + (precision + rounding)[:, :, None] * np.eye(normal.at.size)
    right = vector[:, None] - precision * normal.at
    scale = 1.0 / np.sqrt(np.diagonal(matrix, axis1=-2, axis2=-1))
    scaled = matrix * scale[..., :, None] * scale[..., None, :] + _RIDGE * np.eye(normal.at.size)
    factor = np.linalg.cholesky(scaled)
    half = np.linalg.solve(factor, (scale * right)[..., None])[..., 0]
    prior_square = np.sum(precision * normal.at**2, axis=1) - np.sum(np.log(precision), axis=1)
    log_determinant = 2.0 * np.sum(np.log(np.diagonal(factor, axis1=-2, axis2=-1)) - np.log(scale), axis=-1)
    return np.asarray(
        -0.5 * (square[:, None] + prior_square - np.sum(half**2, axis=-1) + log_determinant + determinant[:, None])
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Reduced:
    """The sums turned so that the field's own equations are diagonal, for one length and unit amplitude.

    turn (m, m) takes turned coefficients back; power (m,) what the sightings tell of each; rows (2, p, m) and
    residual (2, m) the products with the derivatives and the residuals.
    """

    transform: FloatArray
    power: FloatArray
    rows: FloatArray
    residual: FloatArray

    @classmethod
    def of(cls, normal: NormalEquations, basis: WaveBasis, length_px: float) -> _Reduced:
        spread = np.sqrt(basis.variances(length_px=length_px))
        # in these axes every amplitude costs a division per coefficient, not a factorisation
        power, vectors = np.linalg.eigh(normal.ff * spread[:, None] * spread)
        transform = spread[:, None] * vectors
        return cls(
            transform=transform,
            power=np.maximum(power, 0.0),
            rows=normal.jf @ transform,
            residual=normal.fr @ transform,
        )

    def shrinkage(self, amplitudes: FloatArray) -> FloatArray:
        """Return (amplitudes, m): prior variance over one plus what is known, of each turned coefficient."""
        square = amplitudes[:, None] ** 2
        return np.asarray(square / (1.0 + square * self.power))

    def explained(self, shrink: FloatArray) -> FloatArray:
        """Return (p,): what the field takes from the sightings' pull on the parameters."""
        first, second = (rows @ (shrink * residual) for rows, residual in zip(self.rows, self.residual, strict=True))
        return np.asarray(first + second)

    def absorbed(self, shrink: FloatArray) -> FloatArray:
        """Return (p, p): what the field takes from the sightings' information on the parameters."""
        flat = np.moveaxis(self.rows, 1, 0) * np.sqrt(shrink)
        flat = flat.reshape(flat.shape[0], -1)
        return np.asarray(flat @ flat.T)
