"""The fit with the field marginalised, and how probable the data are under each choice of scales.

With the lens and pose as θ (prior precision P about 0) and the field's coefficients as c, the sightings are
r = J dθ + Φ c + noise. Everything needed is a few sums over the sightings (`Normal`), so that the amplitude and the
length of the field and the scale of the residual radial distortion can be tried at the price of one small
factorisation each (generalised least squares, Laplace's approximation of the marginal likelihood).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from sunarc.calibration.field import WaveBasis
from sunarc.calibration.priors import N_LENS, precisions

FloatArray = NDArray[np.float64]

_POSE_PRECISION = 1e-8
"""Poses are unknown; 1 / 10⁴ rad² keeps the equations solvable with the poorest data."""


class Scales(NamedTuple):
    """The choices: the field's amplitude and length, and the residual radial distortion's scale, px."""

    amplitude_px: float
    length_px: float
    radial_px: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Normal:
    """Sums over the sightings: all that a fit needs of them.

    Attributes
    ----------
    jj, jf, ff : (p, p), (2, p, m), (m, m) products of the derivatives and of the waves (both components share ff).
    jr, fr, rr : (p,), (2, m), scalar products with the residuals.
    at : (p,) the unknowns that they were made at.
    """

    jj: FloatArray
    jf: FloatArray
    ff: FloatArray
    jr: FloatArray
    fr: FloatArray
    rr: float
    at: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Marginal:
    """The fit under one choice of scales.

    Attributes
    ----------
    log_evidence : logarithm of the marginal likelihood, but for a constant.
    unknowns : (p,) most probable unknowns.
    waves : (2, m) most probable coefficients of the field.
    covariance : (p, p) of the unknowns; cross: (2, p, m) with the coefficients.
    """

    log_evidence: float
    unknowns: FloatArray
    waves: FloatArray
    covariance: FloatArray
    cross: FloatArray


def normal_sums(
    rows: FloatArray, waves: FloatArray, residual: FloatArray, information: FloatArray, at: FloatArray
) -> Normal:
    """Return the sums over sightings: rows (n, 2, p), waves (n, m), residual (n, 2), information (n,)."""
    root = np.sqrt(information)
    j = rows * root[:, None, None]
    f = waves * root[:, None]
    r = residual * root[:, None]
    flat = j.reshape(-1, j.shape[-1])
    return Normal(
        jj=flat.T @ flat,
        jf=np.stack([j[:, a].T @ f for a in (0, 1)]),
        ff=f.T @ f,
        jr=flat.T @ r.ravel(),
        fr=np.stack([f.T @ r[:, a] for a in (0, 1)]),
        rr=float(np.sum(r**2)),
        at=at,
    )


def prior_precision(size: int, radial_px: float) -> FloatArray:
    """Return the prior precisions of all unknowns, (size,)."""
    return np.concatenate([precisions(radial_px), np.full(size - N_LENS, _POSE_PRECISION)])


def marginal_fit(normal: Normal, basis: WaveBasis, scales: Scales) -> Marginal:
    """Return the fit under one choice of scales."""
    return _fit_with_field(_Reduced(normal, basis, scales.amplitude_px, scales.length_px), scales.radial_px)


def log_evidences(
    normal: Normal, basis: WaveBasis, amplitudes: FloatArray, lengths: FloatArray, radials: FloatArray
) -> FloatArray:
    """Return the log evidence on a grid, (amplitudes, lengths, radials)."""
    result = np.full((amplitudes.size, lengths.size, radials.size), -math.inf)
    for i, amplitude in enumerate(amplitudes):
        for j, length in enumerate(lengths):
            reduced = _Reduced(normal, basis, float(amplitude), float(length))
            for k, radial in enumerate(radials):
                result[i, j, k] = reduced.log_evidence(float(radial))
    return result


class _Reduced:
    """The normal equations with the field eliminated, for one amplitude and length."""

    def __init__(self, normal: Normal, basis: WaveBasis, amplitude: float, length: float) -> None:
        self.at = normal.at
        self.spread = amplitude * np.sqrt(basis.variances(length_px=length))
        scaled = normal.ff * self.spread[:, None] * self.spread
        scaled[np.diag_indices_from(scaled)] += 1.0
        factor = cho_factor(scaled, check_finite=False)
        jf, fr = normal.jf * self.spread, normal.fr * self.spread
        self.from_rows = np.stack([cho_solve(factor, jf[a].T, check_finite=False) for a in (0, 1)])
        self.from_residual = np.stack([cho_solve(factor, fr[a], check_finite=False) for a in (0, 1)])
        self.matrix = normal.jj - sum(jf[a] @ self.from_rows[a] for a in (0, 1))
        self.vector = normal.jr - sum(jf[a] @ self.from_residual[a] for a in (0, 1))
        self.square = normal.rr - float(np.sum(fr * self.from_residual))
        self.log_determinant = 4.0 * float(np.sum(np.log(np.diag(factor[0]))))

    def solve(self, radial: float) -> tuple[FloatArray, FloatArray, FloatArray, float]:
        """Return the scaled Cholesky factor's inverse action: covariance, step, precisions, log determinant."""
        precision = prior_precision(self.at.size, radial)
        matrix = self.matrix + np.diag(precision)
        scale = 1.0 / np.sqrt(np.diag(matrix))
        scaled = matrix * scale[:, None] * scale
        scaled[np.diag_indices_from(scaled)] += 1e-13
        factor = cho_factor(scaled, check_finite=False)
        inverse = cho_solve(factor, np.eye(self.at.size), check_finite=False) * scale[:, None] * scale
        step = inverse @ (self.vector - precision * self.at)
        log_determinant = 2.0 * float(np.sum(np.log(np.diag(factor[0])) - np.log(scale)))
        return inverse, step, precision, log_determinant

    def log_evidence(self, radial: float) -> float:
        """Return the log evidence for one scale of the residual radial distortion."""
        _, step, precision, log_determinant = self.solve(radial)
        right = self.vector - precision * self.at
        square = self.square + float(np.sum(precision * self.at**2)) - float(right @ step)
        return -0.5 * (square + self.log_determinant + log_determinant - float(np.sum(np.log(precision))))


def _fit_with_field(reduced: _Reduced, radial: float) -> Marginal:
    covariance, step, _, _ = reduced.solve(radial)
    waves = reduced.spread * (reduced.from_residual - reduced.from_rows @ step)
    cross = -np.einsum("ij,amj->aim", covariance, reduced.from_rows) * reduced.spread
    return Marginal(
        log_evidence=reduced.log_evidence(radial),
        unknowns=reduced.at + step,
        waves=waves,
        covariance=covariance,
        cross=cross,
    )
