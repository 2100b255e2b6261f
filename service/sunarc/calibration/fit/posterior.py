"""Posterior of a fit: a mixture over all plausible scales, stated as a Gaussian and its departure.

Each choice of scales gives its own covariance, and the errors are a mixture of them. What is stated is the mean of the
covariances, enlarged or made smaller as a whole such that its 95 % ellipses hold 95 % of the mixture in the mean over
the sky, and with it how the mixture is spread about that at places over the image (`ErrorMixture`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sunarc import _kernels
from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.fit.marginal_likelihood import (
    FieldSums,
    HyperparameterGrid,
    MarginalFit,
    NormalEquations,
    PriorScales,
    Turned,
    field_sums,
    normalised,
)
from sunarc.calibration.fit.normal_equations import LinearSystem
from sunarc.calibration.model.residual_field import Field
from sunarc.calibration.model.result import ErrorMixture
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.solve.priors import STRETCH, free_pixel_aspect
from sunarc.calibration.solve.problem import FitProblem
from sunarc.common.array_types import FloatArray, IntArray
from sunarc.optics.displacement import WaveBasis

# What sightings say of the field: see `Field` for the covariance that this makes.

_LEAST_KNOWN = 0.01
"""Share of a coefficient's variance that sightings take away, below which it counts as unknown."""
_RIDGE = 1e-12
_NEGLIGIBLE_WAVE = 1e-9
"""Share of the largest variance of a wave below which it has no part in the unknowns' errors."""
_LEAST_COUPLED = 1e-6
"""Share of the largest variance below which the coupling of parameters and field is left out."""


def seen_field(unseen: Field, normal: NormalEquations, covariance: FloatArray) -> Field:
    """Return the field with the information of sightings about its mean.

    Parameters
    ----------
    unseen : with its cross terms X with the unknowns, (2, p, m).
    normal : sums over the sightings.
    covariance : C of the unknowns, (p, p).
    """
    return replace(unseen, known=_known_field_rows(unseen, normal), coupling=_coupling_matrix(covariance, unseen.cross))


def prediction_variance(
    fit: MarginalFit,
    scales: PriorScales,
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


def _known_field_rows(field: Field, normal: NormalEquations) -> FloatArray:
    """Return K, (r, m): with the unknowns given, an axis measured to t has 1 / (1 + t) of its variance left."""
    axes = normal.ff.axes(field.basis, field.length_px)
    measured = field.amplitude_px**2 * axes.information
    counts = measured > _LEAST_KNOWN
    measured = measured[counts]
    return np.asarray(
        (field.amplitude_px * np.sqrt(measured / (1.0 + measured)))[:, None] * axes.transform[:, counts].T
    )


def _whiten_cross_terms(covariance: FloatArray, cross: FloatArray) -> FloatArray:
    """Return L⁻¹ X, (p, 2 m), of terms X (2, p, m), with L Lᵀ = C the covariance of the unknowns."""
    scale = np.sqrt(np.diag(covariance))
    correlation, terms = covariance / np.outer(scale, scale), np.concatenate(list(cross / scale[:, None]), axis=-1)
    try:
        root = np.linalg.cholesky(correlation + _RIDGE * np.eye(scale.size))
    except np.linalg.LinAlgError:  # sightings of no camera leave unknowns that only rounding tells apart
        values, vectors = np.linalg.eigh(correlation)
        return np.asarray((vectors.T @ terms) / np.sqrt(np.maximum(values, _RIDGE * values[-1]))[:, None])
    return np.asarray(np.linalg.solve(root, terms))


def _coupling_matrix(covariance: FloatArray, cross: FloatArray) -> FloatArray:
    """Return B, (2, q, m), with Bᵀ B = Xᵀ C⁻¹ X."""
    both = _whiten_cross_terms(covariance, cross)
    values, vectors = np.linalg.eigh(both @ both.T)
    turned = vectors[:, values > _LEAST_COUPLED * values[-1]].T @ both
    return np.stack(np.split(turned, 2, axis=-1))


_TAIL = 0.5
"""Power of the amplitude by which large fields count when choices are left out."""
_WEIGHT_RETAINED = 0.985
_NEGLIGIBLE_SHARE = 1e-3
"""Probability of pixels that are not square below which they are left out."""
PROBES = 60
"""Directions over the sky at which the mixture is evaluated: 18 degrees apart."""
SHARES = np.array([0.4, 0.3, 0.18, 0.09, 0.03])
"""Of the classes of the mixture, from small errors to large ones."""
_SMALLEST = 1e-6
"""Variance of a class, in units of the stated one."""
_COS_DOUBLED = np.cos((np.arange(4) + 0.5) * math.pi / 4.0)
"""Directions round a quarter of an ellipse, as the cosine of twice their angle."""


class PosteriorCovariance(NamedTuple):
    """Covariance of a fit, the scales not being known.

    The covariance (p, p) of the unknowns, the field, and how the mixture is spread about these; None: not known.
    """

    covariance: FloatArray
    field: Field
    mixture: ErrorMixture | None = None


class _Field(NamedTuple):
    """The field under one amplitude and length, px: the sums in its axes, and its posterior variances (r,), px²."""

    turned: Turned
    shrink: FloatArray
    amplitude_px: float
    length_px: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Choices:
    """The plausible scales, those of one field together.

    share (k,): probabilities. amplitude, length (k,): px. field (k,): each choice's among the f fields.
    known (f, p, p), back (f, p, q): the covariance of the unknowns where those q whose scales are tried are known, and
    the derivatives by these, turned; covariance (k, q, q): theirs under each choice; see `LensScaleEquations`.
    shift (k, p): from the fit that is doubted; field_shift (k, 2, m): that of the field's mean, where it is predicted.
    """

    share: FloatArray
    amplitude: FloatArray
    length: FloatArray
    fields: list[_Field]
    field: IntArray
    known: FloatArray
    back: FloatArray
    covariance: FloatArray
    shift: FloatArray
    field_shift: FloatArray | None

    def mixed(self, other: Choices, share: float) -> Choices:
        """Return these and those of another prior, which have a share of the probability."""
        shift, theirs = self.field_shift, other.field_shift
        both = {
            name: np.concatenate([getattr(self, name), getattr(other, name)])
            for name in ("amplitude", "length", "known", "back", "covariance", "shift")
        }
        return replace(
            self,
            share=np.concatenate([(1.0 - share) * self.share, share * other.share]),
            fields=[*self.fields, *other.fields],
            field=np.concatenate([self.field, other.field + len(self.fields)]),
            field_shift=None if shift is None or theirs is None else np.concatenate([shift, theirs]),
            **both,
        )

    def mean_covariances(self) -> tuple[FloatArray, FloatArray]:
        """Return the mean covariance of the unknowns, (p, p), and theirs with the field's coefficients, (2, p, m)."""
        begin = np.searchsorted(self.field, np.arange(len(self.fields)))
        turned = np.add.reduceat(self.share[:, None, None] * self.covariance, begin)
        weight = np.add.reduceat(self.share, begin)[:, None, None]
        means = weight * self.known + self.back @ turned @ self.back.swapaxes(1, 2)
        in_axes, transforms = dict[float, FloatArray](), dict[float, FloatArray]()
        for mean, field in zip(means, self.fields, strict=True):
            in_axes[field.length_px] = in_axes.get(field.length_px, 0.0) - mean @ (field.turned.rows * field.shrink)
            transforms[field.length_px] = field.turned.axes.transform
        cross = np.sum([part @ transforms[length].T for length, part in in_axes.items()], axis=0)
        if self.field_shift is not None:
            cross = cross + np.einsum("k,kp,kam->apm", self.share, self.shift, self.field_shift, optimize=True)
        return np.sum(means, axis=0) + (self.shift.T * self.share) @ self.shift, cross

    def moments(self, left: FloatArray, right: FloatArray, beside: FloatArray, shift: FloatArray) -> FloatArray:
        """Return (k, 3, n): L' C R made symmetric, xx, xy and yy at n places, of each field's L and R (f, 2, p, n).

        With the part of each field in `beside` (f, 3, n), and the products of a shift (2, k, n) of each choice.
        """
        through = self.known[:, None] @ right
        xx, xy, yx, yy = (np.einsum("fpn,fpn->fn", left[:, a], through[:, b]) for a in (0, 1) for b in (0, 1))
        own, back = np.stack([xx, 0.5 * (xy + yx), yy], axis=1) + beside, self.back.swapaxes(1, 2)[:, None]
        return _kernels.moments_of(self.covariance, self.field, back @ left, back @ right, own, shift)


def stated_posterior(
    problem: FitProblem,
    system: LinearSystem,
    unknowns: FloatArray,
    *,
    grid: HyperparameterGrid,
    mean: FloatArray | None,
    stretched: float = 0.0,
) -> PosteriorCovariance:
    """Return how far the unknowns of a fit may be off, whatever the scales are.

    Parameters
    ----------
    problem, system : of the fit; the system is about the unknowns.
    unknowns : the fit, (p,).
    grid : the scales that are tried.
    mean : (2, m) coefficients of the field that is part of the prediction; None: it has no part in it, and its errors
        are those before any sighting.
    stretched : the probability that pixels are not square, of which the problem may have the prior already.
    """
    normal = system.normal()
    sums = field_sums(normal, grid)
    choices = plausible(sums, grid, unknowns, mean)
    wide = free_pixel_aspect(problem.prior).basis[STRETCH, STRETCH]
    square = (problem.prior.basis[STRETCH, STRETCH] / wide) ** 2
    if stretched > _NEGLIGIBLE_SHARE and np.any(square != 1.0):
        choices = choices.mixed(plausible(sums, grid, unknowns, mean, square=square), stretched)
    power = choices.share * choices.amplitude**2
    amplitude = math.sqrt(float(power.sum()))
    length = math.exp(float(power @ np.log(choices.length) / power.sum()))
    covariance, cross = choices.mean_covariances()
    if mean is None:
        # the field has one length, and short waves less variance than in the mean over several: in the same proportion
        # as their roots its terms with the unknowns leave the covariance of both together positive
        variances = {one: grid.basis.variances(length_px=one) for one in np.unique(choices.length).tolist()}
        meant = np.sum([power[choices.length == one].sum() * each for one, each in variances.items()], axis=0)
        stated_waves = amplitude**2 * grid.basis.variances(length_px=length)
        cross = _limit_cross_terms(covariance, cross * np.sqrt(stated_waves / meant), stated_waves)
    field = Field(amplitude_px=amplitude, length_px=length, basis=grid.basis, cross=cross)
    if mean is not None:
        field = seen_field(field, normal, covariance)
    _, pixels, rows = shown_sky(problem, unknowns)
    if pixels.shape[0] == 0:
        return PosteriorCovariance(covariance, field)
    values = grid.basis.values(pixels)
    stated = rows @ covariance @ rows.swapaxes(1, 2) + field.covariance(rows, values)
    mixture = _make_error_mixture(choices.share, at_probes(choices, rows, values), stated, pixels)
    factor = mixture.sigma_factor()
    return PosteriorCovariance(factor**2 * covariance, field.widened(factor), mixture.about(factor))


def _limit_cross_terms(covariance: FloatArray, cross: FloatArray, variances: FloatArray) -> FloatArray:
    """Return terms (2, p, m) of unknowns and waves of some variances (m,) that a covariance of both can have."""
    counts = variances > _NEGLIGIBLE_WAVE * variances.max()
    both = _whiten_cross_terms(covariance, cross[:, :, counts] / np.sqrt(variances[counts]))
    return np.asarray(cross * counts / math.sqrt(max(float(np.linalg.eigvalsh(both @ both.T)[-1]), 1.0)))


def plausible(
    sums: FieldSums,
    grid: HyperparameterGrid,
    unknowns: FloatArray,
    mean: FloatArray | None = None,
    *,
    square: FloatArray | float = 1.0,
) -> Choices:
    """Return the scales that hold nearly all of the probability.

    Parameters
    ----------
    sums : with the fields of the grid.
    grid, unknowns, mean : see `stated_posterior`.
    square : prior precisions of the aspect ratio and of the skew, (2,) or of both.
    """
    weight = normalised(grid.log_prior + sums.log_evidence(grid.lens_scales, square))
    # large fields of small probability have much of the covariance: they must not be cut off
    tail = weight * grid.amplitudes[:, None, None] ** _TAIL
    either = (weight + tail / tail.sum()).ravel()
    order = np.argsort(either)[::-1]
    # in the order of the grid, so that choices of one field follow one another
    retained = np.sort(order[: 1 + int(np.searchsorted(np.cumsum(either[order]), _WEIGHT_RETAINED * either.sum()))])
    i, j, k = np.unravel_index(retained, weight.shape)
    pairs, field = np.unique(np.stack([i, j], axis=-1), axis=0, return_inverse=True)
    field = field.ravel()
    equations = sums.equations(pairs[:, 1] * grid.amplitudes.size + pairs[:, 0], grid.lens_scales, square)
    step, reduced = equations.fits(field, k)
    known, at_rest, back = equations.part_from_others()
    fitted = at_rest[field] + (back[field] @ step[..., None])[..., 0]
    fields = [
        _Field(sums.turned[b], sums.shrink[b][a], float(grid.amplitudes[a]), float(grid.lengths[b])) for a, b in pairs
    ]
    field_shift = None
    if mean is not None:
        field_shift = np.empty((field.size, *mean.shape))
        for length in np.unique(j):
            here, turned = j == length, sums.turned[length]
            shrink = sums.shrink[length][i[here]][:, None]
            field_shift[here] = turned.coefficients(shrink, fitted[here]) - mean
    share = weight.ravel()[retained]
    return Choices(
        share=share / share.sum(),
        amplitude=grid.amplitudes[i],
        length=grid.lengths[j],
        fields=fields,
        field=field,
        known=known,
        back=back,
        covariance=reduced,
        shift=sums.at - unknowns + fitted,
        field_shift=field_shift,
    )


def at_probes(choices: Choices, rows: FloatArray, values: FloatArray) -> FloatArray:
    """Return (k, 3, n): the error's second moments xx, xy, yy under each choice, at places over the sky.

    Camera and field together, see `covariance`, and how far the choice's fit is from the one that is doubted. Without a
    mean of the field in the prediction its own block is that before any sighting.

    Parameters
    ----------
    rows, values : derivatives by the unknowns there, (n, 2, p), and values of the field's basis, (n, m).
    """
    by_unknowns = np.ascontiguousarray(rows.transpose(1, 2, 0))
    shift = choices.shift @ by_unknowns
    if choices.field_shift is not None:
        shift = shift + choices.field_shift.swapaxes(0, 1) @ values.T
    axes = {field.length_px: field.turned.axes for field in choices.fields}
    in_axes = {length: values @ one.transform for length, one in axes.items()}
    # J' of each component with the field's posterior at the places; of either component what sightings leave of it
    pull = np.stack([(one.turned.rows * one.shrink) @ in_axes[one.length_px].T for one in choices.fields])
    left_over = np.square([one.amplitude_px for one in choices.fields])[:, None] + np.zeros(len(values))
    # camera and field: J C J' - J C X' - X C J', and with the field's mean in the prediction X C X' beside it
    left, right = np.broadcast_to(by_unknowns, pull.shape), by_unknowns - 2.0 * pull
    if choices.field_shift is not None:
        left = right = by_unknowns - pull
        left_over -= [in_axes[one.length_px] ** 2 @ (one.amplitude_px**2 - one.shrink) for one in choices.fields]
    of_field = np.maximum(left_over, 0.0)[:, None] * np.array([1.0, 0.0, 1.0])[:, None]
    return choices.moments(left, right, of_field, shift)


def shown_sky(problem: FitProblem, unknowns: FloatArray) -> tuple[Sightings, FloatArray, FloatArray]:
    """Return sky that the last epoch's camera shows, its pixels (n, 2) and their derivatives (n, 2, p)."""
    sky = Sightings(
        directions=hemisphere(PROBES),
        pixels=np.zeros((PROBES, 2)),
        information=np.ones(PROBES),
        epoch=np.full(PROBES, problem.n_epochs - 1),
        systematic_px=np.zeros((PROBES, 2, problem.n_unit)),
    )
    minus, rows = problem.linearised(unknowns, sky)
    shown = np.all((minus < 0.5) & (-minus < [problem.template.width - 0.5, problem.template.height - 0.5]), axis=-1)
    return sky.select(shown), -minus[shown], rows[shown]


def _make_error_mixture(share: FloatArray, moments: FloatArray, stated: FloatArray, pixels: FloatArray) -> ErrorMixture:
    """Return Gaussians (k, 3, n) of some shares (k,) as classes about stated covariances (n, 2, 2).

    With l₁, l₂ the eigenvalues of stated⁻¹ · moments, the square of the distance in stated sigmas is, over φ, that of a
    Gaussian of variance l₁ cos² φ + l₂ sin² φ. These variances of all choices are cut into the classes by their size.
    """
    three, bounds = np.ascontiguousarray(stated.reshape(-1, 4).T[[0, 1, 3]]), np.r_[0.0, np.cumsum(SHARES)]
    upto = _kernels.moments_below(moments, share, three, _COS_DOUBLED, bounds, _SMALLEST)
    return ErrorMixture(shares=SHARES, pixels_px=pixels, scales=np.sqrt(np.diff(upto, axis=1) / SHARES))
