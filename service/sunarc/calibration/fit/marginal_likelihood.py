"""The fit with the field marginalised, and how probable the data are under each choice of scales.

With the lens and pose as θ (prior precision P, mean 0) and the field's coefficients as c, the sightings are r = J dθ
+ Φ c + noise. Everything needed is a few sums over the sightings (`NormalEquations`), so that the amplitude and the
length of the field and the scale of the residual radial distortion can be tried at the price of one small
factorisation each (generalised least squares, Laplace's approximation of the marginal likelihood).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from sunarc import _kernels
from sunarc.calibration.solve.priors import DECENTERING, N_LENS, RADIAL, STRETCH, precisions
from sunarc.common.array_types import FloatArray, IntArray
from sunarc.optics.displacement import WaveBasis, wave_basis

_BEYOND_ANY_FIELD_PX = 64.0
"""px; far beyond any field that is tried."""
_NEGLIGIBLE = 1e-13
"""Share of a coefficient's prior variance that sightings must take away for it to matter at that amplitude."""


class FieldAxes(NamedTuple):
    """The axes for one length and unit amplitude.

    transform (m, r) takes turned coefficients back; information (r,), px⁻², is the sightings' on each. Those that
    they do not determine are left out: products with derivatives and residuals are 0 there.
    """

    transform: FloatArray
    information: FloatArray

    def posterior_variances(self, amplitudes_px: FloatArray) -> FloatArray:
        """Return (amplitudes, r), px²: posterior variance of each coefficient, 1 / (1 / amplitude² + information)."""
        square = amplitudes_px[:, None] ** 2
        return np.asarray(square / (1.0 + square * self.information))


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
                _lengthen_axes(self._axes[max(shorter)], basis, max(shorter), length_px)
                if shorter
                else _field_axes(self.matrix, basis, length_px)
            )
        return self._axes[length_px]


def _field_axes(products: FloatArray, basis: WaveBasis, length_px: float) -> FieldAxes:
    spread = np.sqrt(basis.variances(length_px=length_px))
    return _principal_axes(spread, _low_rank_factor(products * spread[:, None] * spread))


def _lengthen_axes(axes: FieldAxes, basis: WaveBasis, length_px: float, longer_px: float) -> FieldAxes:
    """Return the axes of a longer field from those of one of `length_px`, which has more of every short wave.

    With S and T the spreads of the two, S P S = V diag(p) V' gives T P T = B B', B = T S⁻¹ V diag(√p), and what P has
    in addition that the longer field has still less of.
    """
    spread, longer = (np.sqrt(basis.variances(length_px=length)) for length in (length_px, longer_px))
    return _principal_axes(longer, (longer / spread**2)[:, None] * axes.transform * np.sqrt(axes.information))


def _principal_axes(spread: FloatArray, factor: FloatArray) -> FieldAxes:
    """Return the axes where the products in units of the spread (m,) are B B' of a factor (m, few)."""
    # the eigenvectors of B' B have half of the digits: the weakly determined axes keep components along the strongly
    # determined ones, and exact sightings would be no evidence; the QR decomposition removes these components
    turned = np.linalg.eigh(factor.T @ factor)[1][:, ::-1]
    vectors, upper = np.linalg.qr(factor @ turned)
    power = np.diag(upper) ** 2
    rounding = spread.size * np.finfo(np.float64).eps * float(np.max(power, initial=0.0))
    informative = power > max(rounding, _NEGLIGIBLE / _BEYOND_ANY_FIELD_PX**2)
    return FieldAxes(spread[:, None] * vectors[:, informative], power[informative])


def _low_rank_factor(products: FloatArray) -> FloatArray:
    """Return B (m, few) with B B' a matrix of products of low rank: Cholesky's, the largest left over first."""
    left, rows = np.diag(products).copy(), np.zeros_like(products)
    rounding = np.finfo(np.float64).eps * float(np.max(left, initial=0.0))
    for rank in range(left.size):
        pivot = int(np.argmax(left))
        if left[pivot] <= rounding:
            return rows[:rank].T
        row = products[pivot] - rows[:rank, pivot] @ rows[:rank]
        rows[rank] = np.where(left > 0.0, row / math.sqrt(left[pivot]), 0.0)
        left = np.maximum(left - rows[rank] ** 2, 0.0)
        left[pivot] = 0.0
    return rows.T


_POSE_PRECISION = 1e-8
"""Poses are unknown; 1 / 10⁴ rad² keeps the equations solvable with the poorest data."""
RIDGE = 1e-13
ROUNDING = 1e-13
"""Share of the sightings' whole information that is lost to rounding where the field takes nearly all of it."""
_VARIED = np.r_[RADIAL, DECENTERING]
"""Places of the unknowns whose prior precisions are sought: the radial distortion, p1 and p2."""
_N_RADIAL = RADIAL.stop - RADIAL.start


class PriorScales(NamedTuple):
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
    jj, jf : (p, p), (2, p, m) products of the derivatives with themselves and with the basis values.
    ff : products of the basis values; both components share them.
    jr, fr, rr : (p,), (2, m), scalar products with the residuals.
    at : (p,) the unknowns that they were made at.
    n_unit : how many of the last unknowns have unit prior variance: those of shared errors.
    """

    jj: FloatArray
    jf: FloatArray
    ff: BasisProducts
    jr: FloatArray
    fr: FloatArray
    rr: float
    at: FloatArray
    n_unit: int = 0

    def prior_precision(self, radial_px: float, decentering_px: float) -> FloatArray:
        """Return the prior precisions of the unknowns under two scales of the lens, (p,)."""
        return prior_precision(self.at.size, radial_px, decentering_px, n_unit=self.n_unit)


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

    def transform_coefficients(self, transform: FloatArray) -> MarginalFit:
        """Return the fit with its field's coefficients (r) as those (m) that an (m, r) matrix makes of them."""
        return replace(self, coefficients=self.coefficients @ transform.T, cross=self.cross @ transform.T)


def normal_sums(
    rows: FloatArray,
    basis_values: FloatArray,
    residual: FloatArray,
    information: FloatArray,
    *,
    at: FloatArray,
    ff: BasisProducts | None = None,
    n_unit: int = 0,
) -> NormalEquations:
    """Return the sums over sightings: rows (n, 2, p), basis_values (n, m), residual (n, 2), information (n,).

    `ff` does not change with the camera: who has it already gives it.
    """
    root = np.sqrt(information)
    # one row a component: a product with rows that lie apart in memory would be copied first
    j = np.ascontiguousarray(np.swapaxes(rows, 0, 1)) * root[:, None]
    f = basis_values * root[:, None]
    r = residual.T * root
    flat = j.reshape(-1, j.shape[-1])
    return NormalEquations(
        jj=flat.T @ flat,
        jf=np.swapaxes(j, -1, -2) @ f,
        ff=BasisProducts(matrix=f.T @ f) if ff is None else ff,
        jr=flat.T @ r.ravel(),
        fr=r @ f,
        rr=float(np.sum(r**2)),
        at=at,
        n_unit=n_unit,
    )


LOOSE_RADIAL_PX = 16.0
LOOSE_DECENTERING_PX = 3.0
"""PriorScales of the lens before its sightings are seen."""


def prior_precision(size: int, radial_px: float, decentering_px: float, *, n_unit: int = 0) -> FloatArray:
    """Return the prior precisions of all unknowns, (size,): lens, poses, and those of shared errors."""
    poses = np.full(size - N_LENS - n_unit, _POSE_PRECISION)
    return np.concatenate([precisions(radial_px, decentering_px), poses, np.ones(n_unit)])


def marginal_fit(normal: NormalEquations, basis: WaveBasis, scales: PriorScales) -> MarginalFit:
    """Return the fit under one choice of scales."""
    turned = Turned.of(normal, basis, scales.length_px)
    shrink = turned.axes.posterior_variances(np.array([scales.amplitude_px]))[0]
    precision = normal.prior_precision(scales.radial_px, scales.decentering_px)
    vector = normal.jr - turned.explained(shrink) - precision * normal.at
    information = normal.jj - turned.absorbed(shrink)
    covariance = inverses(information + np.diag(precision + ROUNDING * np.diag(normal.jj)))
    # the field is integrated out already: this is the mean of the unknowns' marginal
    step = covariance @ vector
    return MarginalFit(
        unknowns=normal.at + step,
        gain=float(step @ vector),
        coefficients=turned.coefficients(shrink, step),
        covariance=covariance,
        cross=-(covariance @ (turned.rows * shrink)) @ turned.axes.transform.T,
    )


def field_at(normal: NormalEquations, basis: WaveBasis, scales: PriorScales) -> FloatArray:
    """Return (2, m): the most probable coefficients of the field with the unknowns at `normal.at`."""
    turned = Turned.of(normal, basis, scales.length_px)
    shrink = turned.axes.posterior_variances(np.array([scales.amplitude_px]))[0]
    return turned.coefficients(shrink, np.zeros(normal.at.size))


def inverses(matrices: FloatArray) -> FloatArray:
    """Return the inverses of symmetric matrices (..., p, p), with a ridge, see `RIDGE`."""
    scale = 1.0 / np.sqrt(np.diagonal(matrices, axis1=-2, axis2=-1))
    both = scale[..., :, None] * scale[..., None, :]
    covariance = np.linalg.inv(matrices * both + RIDGE * np.eye(matrices.shape[-1])) * both
    return np.asarray(0.5 * (covariance + np.swapaxes(covariance, -1, -2)))


class FieldSums(NamedTuple):
    """Information of sightings about the unknowns with each field of a grid, whatever the priors of the unknowns are.

    turned (j): the sums in the axes of each length; none of some of the unknowns. shrink (j): (i, r) of each amplitude.
    information (n, p, p), pull (n, p), penalty (n,): of the n = j · i fields, a length's together, each integrated out.
    at (p,), n_unit: of the normal equations.
    """

    turned: list[Turned]
    shrink: list[FloatArray]
    information: FloatArray
    pull: FloatArray
    penalty: FloatArray
    at: FloatArray
    n_unit: int

    @classmethod
    def of(cls, normal: NormalEquations, basis: WaveBasis, amplitudes: FloatArray, lengths: FloatArray) -> FieldSums:
        """Return the sums with fields of all amplitudes (i,) and lengths (j,), px."""
        turned = [Turned.of(normal, basis, float(length)) for length in lengths]
        shrink = [one.axes.posterior_variances(amplitudes) for one in turned]
        pairs = list(zip(turned, shrink, strict=True))
        # Woodbury's identity: the inverse of noise plus field acts through the turned coefficients
        known = normal.jj + ROUNDING * np.diag(np.diag(normal.jj))
        square = normal.rr - np.array([of_length @ np.sum(one.residual**2, axis=0) for one, of_length in pairs])
        # twice: the field's two components have the same kernel and the same sightings
        field = [2.0 * np.sum(np.log1p(amplitudes[:, None] ** 2 * one.axes.information), axis=1) for one in turned]
        return cls(
            turned=turned,
            shrink=shrink,
            information=known - np.concatenate([one.absorbed(of_length) for one, of_length in pairs]),
            pull=normal.jr - np.concatenate([one.explained(of_length) for one, of_length in pairs]),
            penalty=(square + np.array(field)).ravel(),
            at=normal.at,
            n_unit=normal.n_unit,
        )

    def only(self, places: IntArray) -> FieldSums:
        """Return the sums by some of the unknowns, all of the lens and the poses among them; the others are 0."""
        others = np.setdiff1d(np.arange(self.at.size), places)
        gone = self.at[others]
        pull = self.pull + self.information[..., others] @ gone
        return self._replace(
            turned=[],
            information=np.ascontiguousarray(self.information[:, places][..., places]),
            pull=np.ascontiguousarray(pull[:, places]),
            penalty=self.penalty + (self.pull + pull)[:, others] @ gone,
            at=self.at[places],
            n_unit=self.n_unit - others.size,
        )

    def log_evidence(self, lens_scales: FloatArray, square: FloatArray | float = 1.0) -> FloatArray:
        """Return the log evidence of each choice (i, j, k), but for a constant.

        Parameters
        ----------
        lens_scales : (k, 2) of the radial distortion and of the decentering.
        square : (2,) or of both: the prior precisions of the aspect ratio and of the skew.
        """
        precision, tried = self._make_precision(square), lens_scales**-2.0
        order = np.r_[np.delete(np.arange(self.at.size), _VARIED), _VARIED]
        terms = _kernels.evidence_terms(self.information, self.pull, self.at, precision, order, tried)
        weighed = precision * self.at**2
        prior = (tried - 1.0) @ [np.sum(weighed[RADIAL]), np.sum(weighed[DECENTERING])] + np.sum(weighed)
        prior -= np.log(tried) @ [_N_RADIAL, _VARIED.size - _N_RADIAL] + np.sum(np.log(precision))
        terms = (terms - self.penalty[:, None] - prior).reshape(len(self.shrink), -1, len(tried))
        return np.asarray(0.5 * np.swapaxes(terms, 0, 1))

    def equations(
        self, fields: IntArray, lens_scales: FloatArray, square: FloatArray | float = 1.0
    ) -> LensScaleEquations:
        """Return the equations with some of the fields under the same."""
        precision = self._make_precision(square)
        return LensScaleEquations.of(self.information[fields], self.pull[fields], self.at, precision, lens_scales**-2.0)

    def _make_precision(self, square: FloatArray | float) -> FloatArray:
        precision = prior_precision(self.at.size, 1.0, 1.0, n_unit=self.n_unit)
        precision[STRETCH] = square
        return precision

    def log_weights(self, grid: HyperparameterGrid) -> FloatArray:
        """Return the log of prior times evidence of each choice of scales, (i, j, k), but for one constant."""
        return grid.log_prior + self.log_evidence(grid.lens_scales)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LensScaleEquations:
    """The equations of n fields under k pairs of prior precisions: of the radial distortion, and of p1 and p2.

    All else is eliminated (the Schur complement), and the radial coefficients are turned to the eigenvectors of what is
    left of theirs: a pair then costs divisions and two equations of two unknowns. "Turned" are these q, p1 and p2 last.

    Attributes
    ----------
    others : (o,) places of what is eliminated.
    information, scale : (n, o, o) of the others, the diagonal brought to 1; (n, o) by these factors.
    solved : (n, o, q + 1) their inverse times the couplings to the q, not turned, and times their pull.
    eigenvectors : (n, 8, 8) of the radial coefficients.
    coupling : (n, 8, 2) of the turned ones to p1 and p2.
    of_pair : (k,) which of the u precisions of the radial coefficients each pair has.
    radial, pull : (n, u, 8) variances of the turned ones where all others of the q are known, and their pull.
    decentering, step : (n, k, 3) covariance of p1 and p2, its xx, xy and yy; (n, k, 2) their steps.
    """

    others: IntArray
    information: FloatArray
    scale: FloatArray
    solved: FloatArray
    eigenvectors: FloatArray
    coupling: FloatArray
    of_pair: IntArray
    radial: FloatArray
    pull: FloatArray
    decentering: FloatArray
    step: FloatArray

    @classmethod
    def of(
        cls, matrices: FloatArray, vectors: FloatArray, at: FloatArray, precision: FloatArray, pairs: FloatArray
    ) -> LensScaleEquations:
        """Return the equations of matrices (n, p, p) and pulls (n, p) about unknowns (p,).

        Parameters
        ----------
        precision : (p,) prior precisions of the others.
        pairs : (k, 2) those of the radial coefficients, and of p1 and p2.
        """
        others = np.delete(np.arange(at.size), _VARIED)
        rows = matrices[:, others]
        information = rows[..., others] + np.diag(precision[others])
        scale = 1.0 / np.sqrt(np.diagonal(information, axis1=1, axis2=2))
        information = information * scale[..., :, None] * scale[..., None, :] + RIDGE * np.eye(others.size)
        pull = vectors[:, others] - precision[others] * at[others]
        right = scale[..., None] * np.concatenate([rows[..., _VARIED], pull[..., None]], axis=-1)
        solved = np.linalg.solve(information, right)
        own = matrices[:, _VARIED][..., _VARIED]
        schur = np.zeros((len(matrices), _VARIED.size + 1, _VARIED.size + 1))
        schur[:, :-1, :-1] = own + RIDGE * np.eye(_VARIED.size) * own
        schur[:, :-1, -1] = vectors[:, _VARIED]
        schur -= right.swapaxes(1, 2) @ solved
        radial_precision, of_pair = np.unique(pairs[:, 0], return_inverse=True)
        values, eigenvectors = np.linalg.eigh(schur[:, :_N_RADIAL, :_N_RADIAL])
        turned = eigenvectors.swapaxes(1, 2) @ schur[:, :_N_RADIAL, _N_RADIAL:]
        coupling = turned[..., :-1]
        pull = turned[:, None, :, -1] - radial_precision[:, None] * (at[RADIAL] @ eigenvectors)[:, None]
        # below that share of the largest is rounding, which may be negative: a lens that cannot show the sightings
        values = np.maximum(values, RIDGE * values[:, -1:])[:, None] + (1.0 + RIDGE) * radial_precision[:, None]
        radial = 1.0 / values
        # p1 and p2 with the radial coefficients eliminated, too: two equations each
        x, y = np.moveaxis(coupling, -1, 0)
        taken = radial @ np.stack([x * x, x * y, y * y], axis=-1), (radial * pull) @ coupling
        decentering_precision, rest = (1.0 + RIDGE) * pairs[:, 1], schur[:, None, _N_RADIAL:]
        xx, xy, yy = np.moveaxis(taken[0][:, of_pair], -1, 0)
        xx, xy = rest[..., 0, -3] + decentering_precision - xx, rest[..., 0, -2] - xy
        yy = rest[..., 1, -2] + decentering_precision - yy
        left = rest[..., :2, -1] - pairs[:, 1:] * at[DECENTERING] - taken[1][:, of_pair]
        size = xx * yy - xy * xy
        step = np.stack([yy * left[..., 0] - xy * left[..., 1], xx * left[..., 1] - xy * left[..., 0]], axis=-1)
        step /= size[..., None]
        return cls(
            others=others,
            information=information,
            scale=scale,
            solved=solved,
            eigenvectors=eigenvectors,
            coupling=coupling,
            of_pair=of_pair,
            radial=radial,
            pull=pull,
            decentering=np.stack([yy, -xy, xx], axis=-1) / size[..., None],
            step=step,
        )

    def fits(self, field: IntArray, pair: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the steps (c, q) and covariances (c, q, q) of the turned unknowns in c fields under a pair each."""
        radial, coupling, step = self.radial[field, self.of_pair[pair]], self.coupling[field], self.step[field, pair]
        pull = self.pull[field, self.of_pair[pair]] - (coupling @ step[..., None])[..., 0]
        along = radial[..., None] * coupling
        decentering = self.decentering[field, pair][:, [0, 1, 1, 2]].reshape(-1, 2, 2)
        result = np.empty((field.size, _VARIED.size, _VARIED.size))
        both = along @ decentering
        result[:, :_N_RADIAL, :_N_RADIAL] = both @ along.swapaxes(1, 2)
        result[:, range(_N_RADIAL), range(_N_RADIAL)] += radial
        result[:, :_N_RADIAL, _N_RADIAL:] = -both
        result[:, _N_RADIAL:, :_N_RADIAL] = -both.swapaxes(1, 2)
        result[:, _N_RADIAL:, _N_RADIAL:] = decentering
        return np.concatenate([radial * pull, step], axis=-1), result

    def part_from_others(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the part that all unknowns take from the others, the turned ones being known and at rest.

        Returns
        -------
        Their covariances (n, p, p), their steps (n, p), and the derivatives (n, p, q) of all by the turned ones.
        """
        n, p, scale, solved = len(self.scale), self.others.size + _VARIED.size, self.scale[..., None], self.solved
        covariance, step, back = np.zeros((n, p, p)), np.zeros((n, p)), np.zeros((n, p, _VARIED.size))
        inverse = np.linalg.inv(self.information) * (scale * scale.swapaxes(1, 2))
        covariance[:, self.others[:, None], self.others] = inverse
        step[:, self.others] = self.scale * solved[..., -1]
        back[:, self.others] = -scale * solved[..., :-1]
        back[:, _VARIED] = np.eye(_VARIED.size)
        back[..., :_N_RADIAL] = back[..., :_N_RADIAL] @ self.eigenvectors
        return covariance, step, back


# The field's coefficients turned so that its own normal equations are diagonal: an amplitude then costs a division.
class Turned(NamedTuple):
    """The sums in the field's axes: rows (2, p, r) and residual (2, r), products with derivatives and residuals."""

    axes: FieldAxes
    rows: FloatArray
    residual: FloatArray

    @classmethod
    def of(cls, normal: NormalEquations, basis: WaveBasis, length_px: float) -> Turned:
        """Return the sums in the axes of a field of some length in px."""
        axes = normal.ff.axes(basis, length_px)
        return cls(axes, normal.jf @ axes.transform, normal.fr @ axes.transform)

    def coefficients(self, shrink: FloatArray, step: FloatArray) -> FloatArray:
        """Return (..., 2, m): the most probable coefficients of the field, the unknowns being steps (..., p) away."""
        explained = (step[..., None, None, :] @ self.rows)[..., 0, :]
        return np.asarray((shrink * (self.residual - explained)) @ self.axes.transform.T)

    def explained(self, shrink: FloatArray) -> FloatArray:
        """Return (..., p): the part of fields of variances (..., r) in the sightings' pull on the parameters."""
        return np.asarray(shrink @ np.einsum("apr,ar->rp", self.rows, self.residual))

    def absorbed(self, shrink: FloatArray) -> FloatArray:
        """Return (..., p, p): the part of fields of variances (..., r) in the sightings' information on them."""
        both, twice = np.concatenate(list(self.rows), axis=-1), np.concatenate([shrink, shrink], axis=-1)
        return np.asarray((both * twice[..., None, :]) @ both.T)


# Which scales the data speak for: the field's amplitude and length, the radial distortion's and the decentering's.

_LENGTH_FRACTIONS = (0.16, 0.24, 0.36)
"""Lengths tried, as fractions of the image's shorter side."""

_LARGEST_AMPLITUDE_PX = 8.0
_AMPLITUDES = 16
_RADIAL_FACTORS = np.array([0.1, 0.15, 0.22, 0.33, 0.5, 0.75, 1.2, 2.0, 4.0, 8.0])
RADIAL_LOG_SIGMA = math.log(2.6)
_DECENTERING_FACTORS = np.array([0.25, 0.5, 1.0, 2.0, 4.0, 8.0])
DECENTERING_LOG_SIGMA = math.log(2.0)
"""1-sigma of the logarithms of the two scales about their tolerances, of published lenses (decision 0011): 14 of them
have a decentering, and the factor 1.6 of these is taken for 2."""
_USUAL_FIELD_PX = 0.3
_FIELD_LOG_SIGMA = math.log(3.0)
"""Where a lens is not as modelled, it is by tenths of px: the paper's own data miss the model by 0.5 to 1.2 px."""
_LARGEST_FIELD_PX = 1.5
"""1-sigma, px, of a Gaussian bound on the amplitude. A displacement of several px is a matter of the lens's own
parameters; without the bound, a large field with a lens that fits nothing can be the more probable explanation of a
lens with a strong radial residual."""
_NO_FIELD = 1.5
"""Odds, before any sighting, that there is no field but the floor's."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HyperparameterGrid:
    """The scales that are tried.

    Attributes
    ----------
    amplitudes (i,), lengths (j,) of the field; lens_scales (k, 2) of radial distortion and decentering; px.
    log_prior : (i, j, k) how plausible they are before the sightings.
    basis : the field's basis functions.
    square_odds : odds, before the sightings, that pixels are square.
    """

    amplitudes: FloatArray
    lengths: FloatArray
    lens_scales: FloatArray
    log_prior: FloatArray
    basis: WaveBasis
    square_odds: float = 100.0


def scale_grid(
    *, width: int, height: int, floor_px: float, radial_px: float, decentering_px: float, square_odds: float = 100.0
) -> HyperparameterGrid:
    """Return the grid of scales for an image size.

    Parameters
    ----------
    width, height : px.
    floor_px : the smallest field that is ever assumed.
    radial_px, decentering_px : the usual scales of the residual radial distortion and of the decentering.
    square_odds : see `LensTolerances`.
    """
    lengths = np.array(_LENGTH_FRACTIONS) * min(width, height)
    amplitudes = np.geomspace(max(floor_px, 1e-4), _LARGEST_AMPLITUDE_PX, _AMPLITUDES)
    radial, decentering = np.meshgrid(_RADIAL_FACTORS, _DECENTERING_FACTORS, indexing="ij")
    # the grid's steps differ: each place counts by the interval of the logarithm that it stands for
    of_lens = np.log(np.gradient(np.log(_RADIAL_FACTORS)))[:, None] + np.log(np.gradient(np.log(_DECENTERING_FACTORS)))
    of_lens = of_lens - 0.5 * (np.log(radial) / RADIAL_LOG_SIGMA) ** 2
    of_lens = of_lens - 0.5 * (np.log(decentering) / DECENTERING_LOG_SIGMA) ** 2
    of_amplitude = -0.5 * (np.log(amplitudes / _USUAL_FIELD_PX) / _FIELD_LOG_SIGMA) ** 2
    of_amplitude -= 0.5 * (amplitudes / _LARGEST_FIELD_PX) ** 2
    # the floor stands for no field, too: its prior odds are added to it
    of_amplitude[0] = np.logaddexp(of_amplitude[0], math.log(_NO_FIELD) + np.logaddexp.reduce(of_amplitude))
    return HyperparameterGrid(
        amplitudes=amplitudes,
        lengths=lengths,
        lens_scales=np.stack([radial_px * radial.ravel(), decentering_px * decentering.ravel()], axis=-1),
        log_prior=of_amplitude[:, None, None] + np.zeros((1, lengths.size, 1)) + of_lens.ravel(),
        basis=wave_basis(width=width, height=height, shortest_px=float(lengths[0]), longest_px=float(lengths[-1])),
        square_odds=square_odds,
    )


def log_weights(normal: NormalEquations, grid: HyperparameterGrid) -> FloatArray:
    """Return the log of prior times evidence of each choice of scales, (i, j, k), but for one constant."""
    return field_sums(normal, grid).log_weights(grid)


def field_sums(normal: NormalEquations, grid: HyperparameterGrid) -> FieldSums:
    """Return the sums with the fields of a grid."""
    return FieldSums.of(normal, grid.basis, grid.amplitudes, grid.lengths)


def log_evidence(log_weight: FloatArray) -> float:
    """Return the log evidence over all scales together, but for a constant that depends on the sightings alone."""
    return float(np.logaddexp.reduce(log_weight, axis=None))


def normalised(log_weight: FloatArray) -> FloatArray:
    """Return how probable each choice of scales is, (i, j, k)."""
    weight = np.exp(log_weight - np.max(log_weight))
    return np.asarray(weight / weight.sum())


def likely_scales(weight: FloatArray, grid: HyperparameterGrid) -> PriorScales:
    """Return the scales to fit with: the mean amplitude, and the mean logarithms of the others.

    Parameters
    ----------
    weight : (i, j, k), see `normalised`.
    """
    radial, decentering = np.exp(np.sum(weight, axis=(0, 1)) @ np.log(grid.lens_scales))
    moment = np.sum(weight, axis=2) * grid.amplitudes[:, None]
    length = math.exp(float(np.sum(moment * np.log(grid.lengths)) / moment.sum()))
    return PriorScales(float(moment.sum()), length, float(radial), float(decentering))


def field_log_odds(log_weight: FloatArray) -> float:
    """Return the log odds that there is a field larger than the floor; -inf where none larger is tried."""
    return float(np.logaddexp.reduce(log_weight[1:], axis=None) - np.logaddexp.reduce(log_weight[0], axis=None))
