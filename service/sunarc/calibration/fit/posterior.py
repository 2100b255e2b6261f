"""How far a fit may be off: one Gaussian that holds what all plausible scales and decenterings say.

Each choice of scales gives its own covariance, and the errors are a mixture of them. The mean of the covariances would
hold far more than 95 % where a few per cent of the probability lie on a large field, and less where a large field is as
plausible as none. So the probabilities are tilted by a power of the amplitude, the one with which 95 % of the mixture
lies within the 95 % ellipses, in the mean over the sky.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray, IntArray
from sunarc.calibration.answers.covariance import hemisphere
from sunarc.calibration.fit.marginal_likelihood import (
    ROUNDING,
    HyperparameterGrid,
    MarginalFit,
    NormalEquations,
    Scales,
    Turned,
    choices_of,
    inverses,
    normal_sums,
    normalised,
)
from sunarc.calibration.fit.normal_equations import LinearSystem, converged_in_axes, log_determinants
from sunarc.calibration.model.residual_field import Field, WaveBasis
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.solve.priors import DECENTERING, HIGHER
from sunarc.calibration.solve.problem import FitProblem

# What sightings say of the field: see `Field` for the covariance that this makes.

_LEAST_KNOWN = 0.01
"""Share of a coefficient's variance that sightings take away, below which it counts as unknown."""
_LEAST_COUPLED = 1e-6
"""Share of the largest variance below which what the parameters leave open in the field is left out."""


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


def _known(field: Field, normal: NormalEquations) -> FloatArray:
    """Return K, (r, m): with the unknowns given, an axis measured to t has 1 / (1 + t) of its variance left."""
    axes = normal.ff.axes(field.basis, field.length_px)
    measured = field.amplitude_px**2 * axes.information
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


_NOMINAL_COVERAGE = 0.95
ELLIPSE = -2.0 * math.log(1.0 - _NOMINAL_COVERAGE)
"""Square of the Mahalanobis distance that holds 95 % of a Gaussian in the plane."""
_TILTS = (-3.0, 1.5)
_SAME_COVERAGE = 2e-4
"""Of the share held: a hundredth of what it differs by between fits."""
_MOST_STEPS = 20
_TAIL_TILT = 0.5
_WEIGHT_RETAINED = 0.985
PROBES = 60
COS_DOUBLED = np.cos((np.arange(8) + 0.5) * math.pi / 8.0)
"""Directions round a quarter of an ellipse, as the cosine of twice their angle."""


class PosteriorCovariance(NamedTuple):
    """How far a fit may be off, the scales not being known: the covariance (p, p) of the unknowns, and the field."""

    covariance: FloatArray
    field: Field


class _Field(NamedTuple):
    """The field under one amplitude and length, px: the sums in its axes, and its posterior variances (r,), px².

    known (p, p), back (p, q): the covariance of the unknowns where those q whose scales are tried are known, and the
    derivatives by these, turned; covariance (k, q, q): theirs under each choice; see `LensScaleEquations`.
    """

    turned: Turned
    shrink: FloatArray
    amplitude_px: float
    length_px: float
    known: FloatArray
    back: FloatArray
    covariance: FloatArray

    def mean_covariance(self, weight: FloatArray) -> FloatArray:
        """Return (p, p): the sum of the covariances of the unknowns, times weights (k,)."""
        mean = np.tensordot(weight, self.covariance, 1)
        return np.asarray(weight.sum() * self.known + self.back @ mean @ self.back.T)

    def moments(self, left: FloatArray, right: FloatArray) -> FloatArray:
        """Return (k, 3, n): L' C R made symmetric, xx, xy and yy at n places, of L and R (2, p, n), x before y."""
        own = np.sum(left[:, None] * (self.known @ right), axis=-2)
        left, right = self.back.T @ left, self.back.T @ right
        through = self.covariance[:, None] @ left
        products = np.sum(through[:, :, None] * right, axis=-2) + own
        return np.stack([products[:, 0, 0], 0.5 * (products[:, 0, 1] + products[:, 1, 0]), products[:, 1, 1]], axis=1)

    def pull(self, values: FloatArray) -> FloatArray:
        """Return (2, p, n): J' of each component with the field's posterior at the places."""
        return np.asarray((self.turned.rows * self.shrink) @ values.T)

    def reduction(self, values: FloatArray) -> FloatArray:
        """Return (n,): by how much sightings reduce the variance of either component there, the parameters given."""
        return np.asarray(values**2 @ (self.amplitude_px**2 - self.shrink))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Choices:
    """The plausible scales, those of one field together.

    share (k,): probabilities. amplitude, length (k,): px. fields: with the covariances; `field` (k,) is each choice's.
    shift (k, p): from the fit that is doubted; field_shift (k, 2, m): that of the field's mean, where it is predicted.
    """

    share: FloatArray
    amplitude: FloatArray
    length: FloatArray
    fields: list[_Field]
    field: IntArray
    shift: FloatArray
    field_shift: FloatArray | None

    def tilted(self, tilt: float) -> FloatArray:
        """Return the shares, each times a power of its amplitude."""
        weight = self.share * self.amplitude**tilt
        return np.asarray(weight / weight.sum())

    def mean_covariances(self, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the mean covariance of the unknowns, (p, p), and theirs with the field's coefficients, (2, p, m)."""
        total, in_axes, transforms = np.zeros(()), dict[float, FloatArray](), dict[float, FloatArray]()
        for number, field in enumerate(self.fields):
            mean = field.mean_covariance(weight[self.field == number])
            total = total + mean
            in_axes[field.length_px] = in_axes.get(field.length_px, 0.0) - mean @ (field.turned.rows * field.shrink)
            transforms[field.length_px] = field.turned.axes.transform
        return total, np.sum([part @ transforms[length].T for length, part in in_axes.items()], axis=0)


def marginalised_covariance(
    normal: NormalEquations,
    grid: HyperparameterGrid,
    problem: FitProblem,
    unknowns: FloatArray,
    mean: FloatArray | None = None,
) -> PosteriorCovariance:
    """Return how far the unknowns may be off, whatever the scales are; `normal` is about them.

    `mean` (2, m) are the coefficients of the field that is part of the prediction; None: it has no part in it, and its
    errors are those before any sighting.
    """
    choices = plausible(normal, grid, unknowns, mean)
    moments = at_probes(choices, grid.basis, problem, unknowns)
    weight = choices.tilted(honest_tilt(choices, moments))
    power = weight * choices.amplitude**2
    amplitude = math.sqrt(float(power.sum()))
    length = math.exp(float(power @ np.log(choices.length) / power.sum()))
    covariance, cross = choices.mean_covariances(weight)
    covariance = covariance + (choices.shift.T * weight) @ choices.shift
    unseen = Field(amplitude_px=amplitude, length_px=length, basis=grid.basis, cross=cross)
    if choices.field_shift is None:
        return PosteriorCovariance(covariance, unseen)
    cross = cross + np.einsum("k,kp,kam->apm", weight, choices.shift, choices.field_shift, optimize=True)
    return PosteriorCovariance(covariance, seen_field(replace(unseen, cross=cross), normal, covariance))


def plausible(
    normal: NormalEquations, grid: HyperparameterGrid, unknowns: FloatArray, mean: FloatArray | None = None
) -> _Choices:
    """Return the scales that hold nearly all of the probability, tilted towards large fields or not."""
    tried = choices_of(normal, grid)
    weight = normalised(grid.log_prior + tried.log_evidence)
    # large fields of small probability decide the tilt: they must not be cut off beforehand
    tail = weight * grid.amplitudes[:, None, None] ** _TAIL_TILT
    either = (weight + tail / tail.sum()).ravel()
    order = np.argsort(either)[::-1]
    # in the order of the grid, so that choices of one field follow one another
    retained = np.sort(order[: 1 + int(np.searchsorted(np.cumsum(either[order]), _WEIGHT_RETAINED * either.sum()))])
    i, j, k = np.unravel_index(retained, weight.shape)
    pairs, field = np.unique(np.stack([i, j], axis=-1), axis=0, return_inverse=True)
    equations, row = tried.equations, j * grid.amplitudes.size + i
    step, reduced = equations.fits(row, k)
    fields, fitted, coefficients = [], [], []
    for number, (amplitude, length) in enumerate(pairs):
        here = field.ravel() == number
        known, at_rest, back = equations.others_of(length * grid.amplitudes.size + amplitude)
        turned, shrink = tried.turned[length], tried.shrink[length][amplitude]
        fitted.append(at_rest + step[here] @ back.T)
        if mean is not None:
            coefficients.append(turned.coefficients(shrink, fitted[-1]) - mean)
        scales = float(grid.amplitudes[amplitude]), float(grid.lengths[length])
        fields.append(_Field(turned, shrink, *scales, known, back, reduced[here]))
    share = weight.ravel()[retained]
    return _Choices(
        share=share / share.sum(),
        amplitude=grid.amplitudes[i],
        length=grid.lengths[j],
        fields=fields,
        field=field.ravel(),
        shift=normal.at - unknowns + np.concatenate(fitted),
        field_shift=np.concatenate(coefficients) if coefficients else None,
    )


def at_probes(choices: _Choices, basis: WaveBasis, problem: FitProblem, unknowns: FloatArray) -> FloatArray:
    """Return (k, 3, n): the error's second moments xx, xy, yy under each choice, at places spread over the sky.

    Camera and field together, see `covariance`, and how far the choice's fit is from the one that is doubted. Without a
    mean of the field in the prediction its own block is that before any sighting.
    """
    rows, basis_values = sky_rows(problem, unknowns, basis)
    by_unknowns = np.ascontiguousarray(rows.transpose(1, 2, 0))
    moved = choices.shift @ by_unknowns
    predicted = choices.field_shift is not None
    if choices.field_shift is not None:
        moved = moved + choices.field_shift.swapaxes(0, 1) @ basis_values.T
    x, y = moved
    moments = np.stack([x * x, x * y, y * y], axis=1)
    axes = {field.length_px: field.turned.axes for field in choices.fields}
    in_axes = {length: basis_values @ one.transform for length, one in axes.items()}
    for number, field in enumerate(choices.fields):
        inside = choices.field == number
        values = in_axes[field.length_px]
        pull = field.pull(values)
        # camera and field: J C J' - J C X' - X C J', and with the field's mean in the prediction X C X' beside it
        left, right = (by_unknowns - pull,) * 2 if predicted else (by_unknowns, by_unknowns - 2.0 * pull)
        own = field.moments(left, right)
        reduction = field.reduction(values) if predicted else 0.0
        own[:, ::2] += np.maximum(field.amplitude_px**2 - reduction, 0.0)
        moments[inside] += own
    return moments


def sky_rows(problem: FitProblem, unknowns: FloatArray, basis: WaveBasis) -> tuple[FloatArray, FloatArray]:
    """Return derivatives (n, 2, p) and basis values (n, m) of sky that the last epoch's camera shows."""
    sky = hemisphere(PROBES)
    nowhere = np.zeros((PROBES, 2))
    epoch = np.full(PROBES, problem.n_epochs - 1)
    minus, rows = problem.linearised(
        unknowns,
        Sightings(
            directions=sky,
            pixels=nowhere,
            information=np.ones(PROBES),
            epoch=epoch,
            systematic_px=np.zeros((1, 2, problem.n_unit)),
        ),
    )
    shown = np.all((minus < 0.5) & (-minus < [problem.template.width - 0.5, problem.template.height - 0.5]), axis=-1)
    return rows[shown], basis.values(-minus[shown])


def honest_tilt(choices: _Choices, moments: FloatArray) -> float:
    """Return the power of the amplitude with which the tilted mean holds as much of the mixture as it says."""
    if moments.shape[2] == 0:
        return 0.0

    def excess(tilt: float) -> float:
        stated = np.tensordot(choices.tilted(tilt), moments, 1)
        return float(choices.share @ coverage(moments, stated)) - _NOMINAL_COVERAGE

    return root_of_rising(excess, *_TILTS, close=_SAME_COVERAGE)


def root_of_rising(function: Callable[[float], float], low: float, high: float, *, close: float) -> float:
    """Return where a rising function is 0, to values of `close`; the end that is nearer to it where it is 0 nowhere.

    By the secant through the ends of the interval, the value of an end that stays halved (the Illinois method;
    M. Dowell and P. Jarratt, BIT 11 (1971)).
    """
    below, above = function(low), function(high)
    if below >= 0.0 or above <= 0.0:
        return low if below >= 0.0 else high
    middle, side = low, 0
    for _ in range(_MOST_STEPS):
        middle = (low * above - high * below) / (above - below)
        value = function(middle)
        if abs(value) <= close:
            break
        if value < 0.0:
            low, below = middle, value
            above *= 0.5 if side < 0 else 1.0
        else:
            high, above = middle, value
            below *= 0.5 if side > 0 else 1.0
        side = -1 if value < 0.0 else 1
    return middle


def coverage(moments: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return (k,): the share of Gaussians (k, 3, n) within the 95 % ellipses of stated covariances (3, n).

    With l₁, l₂ the eigenvalues of stated⁻¹ · moments, it is the mean over φ of 1 - exp(-q / 2 (l₁ cos² φ + l₂ sin² φ)).
    """
    (xx, xy, yy), (a, b, d) = moments.swapaxes(0, 1), covariance
    inverse = 1.0 / (a * d - b * b)
    half = 0.5 * inverse * (d * xx - 2.0 * b * xy + a * yy)
    gap = np.sqrt(np.maximum(half * half - inverse * (xx * yy - xy * xy), 0.0))
    outside, work = np.zeros_like(half), np.empty_like(half)
    for cosine in COS_DOUBLED:
        np.multiply(gap, cosine, out=work)
        np.maximum(np.add(half, work, out=work), 1e-12, out=work)
        outside += np.exp(np.divide(-0.5 * ELLIPSE, work, out=work), out=work)
    return np.asarray(1.0 - np.mean(outside, axis=1) / COS_DOUBLED.size)


# Covariance where the decentering's higher coefficients are not known: a mixture over them.
#
# The decentering is a product, (p1, p2) × (1 + p3 θ² + p4 θ⁴). A part of a day's arc leaves p3 and p4 open, and the
# other unknowns depend on them along a curve, or have two optima of opposite sign: the Gaussian about one optimum is
# then far too narrow. So p3 and p4 are integrated out on a grid of their prior, and the covariance is that of the
# mixture about the fit that is returned. Given p3 and p4 the decentering is exactly linear in p1 and p2, and nearly
# always all else is linear about the fit, as it is taken to be in every covariance: each place is a linear fit with its
# evidence, by sums over the sightings that are made once. Where the residuals at the plausible places contradict that,
# each place is solved on the whole lens.

_SPACING = 1.0
NODES = np.array(list(itertools.product(np.arange(-2.0, 2.5, _SPACING), repeat=2)))
"""Values of p3 and p4 in units of their prior's 1-sigma: they hold 98 % of it in each."""
CELL = math.log(_SPACING**2 / (2.0 * math.pi))
_RIDGE = 1e-12
_KNOWN = 0.15
"""1-sigma of p3 and p4, in units of the prior's, below which they are known and the Gaussian holds."""
_PRODUCTS = 4
_WIDEST = 3.0
"""p3 and p4 of a fit, in units of their prior's 1-sigma: one spacing beyond the places."""
_PLAUSIBLE = 1e-3
"""Probability from which on a place counts in the test of linearity."""
_CURVED = 0.3
"""Departure of twice the log posterior from the linear fit's: it changes a share by a sixth."""


class Conditionals(NamedTuple):
    """Fits where p3 and p4 are known, k of them.

    shift (k, p): of the unknowns, from the free fit; covariance (k, p, p) of them; penalty (k,): twice the negative log
    posterior; log_evidence (k,), but for one constant. coefficients (k, 2, m) of the field, and cross (k, 2, p, m) with
    the unknowns.
    """

    shift: FloatArray
    covariance: FloatArray
    penalty: FloatArray
    log_evidence: FloatArray
    coefficients: FloatArray
    cross: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BilinearSums:
    """Sums over the bins for a prediction that is linear in p unknowns and in the products p1 p3, p1 p4, p2 p3, p2 p4.

    Attributes
    ----------
    information, pull : (p + 4, p + 4), (p + 4,) of the unknowns and the products, the field integrated out.
    square : what the field leaves of the squares of the residuals.
    precision, at : (p,) of the prior; and the unknowns that the sums are about.
    turned, shrink : the sums in the field's axes, and its posterior variances, under the scales.
    """

    information: FloatArray
    pull: FloatArray
    square: float
    precision: FloatArray
    at: FloatArray
    turned: Turned
    shrink: FloatArray

    @classmethod
    def about(cls, problem: FitProblem, system: LinearSystem, unknowns: FloatArray, scales: Scales) -> BilinearSums:
        """Return the sums of a system about some unknowns (p,)."""
        rows = np.concatenate([system.rows, *_by_products(problem, system, unknowns)], axis=-1)
        normal = normal_sums(
            rows,
            system.basis_values,
            system.residual,
            system.observed.information,
            at=unknowns,
            ff=system.basis_products,
            n_unit=system.n_unit,
        )
        turned = Turned.of(normal, system.basis, scales.length_px)
        shrink = turned.axes.posterior_variances(np.array([scales.amplitude_px]))[0]
        return cls(
            information=normal.jj + ROUNDING * np.diag(np.diag(normal.jj)) - turned.absorbed(shrink),
            pull=normal.jr - turned.explained(shrink),
            square=normal.rr - float(np.sum(shrink * turned.residual**2)),
            precision=normal.prior_precision(scales.radial_px, scales.decentering_px),
            at=unknowns,
            turned=turned,
            shrink=shrink,
        )

    def free(self) -> Conditionals:
        """Return the fit with p3 and p4 free: the only one, k = 1."""
        p = self.at.size
        return self._fits(np.eye(p + _PRODUCTS, p)[None], np.zeros((1, p + _PRODUCTS)), self.at)

    def conditional(self, places: FloatArray) -> Conditionals:
        """Return the fits with p3 and p4 held at places (k, 2), in units of their prior's 1-sigma."""
        p, count = self.at.size, places.shape[0]
        away = places - self.at[HIGHER]
        columns, offset = np.tile(np.eye(p + _PRODUCTS, p), (count, 1, 1)), np.zeros((count, p + _PRODUCTS))
        columns[:, HIGHER, HIGHER] = 0.0
        for number, of_first in enumerate(range(DECENTERING.start, DECENTERING.stop)):
            products = slice(p + 2 * number, p + 2 * number + 2)
            columns[:, products, of_first] = away
            offset[:, products] = away * self.at[of_first]
        others = self.at.copy()
        others[HIGHER] = 0.0
        fits = self._fits(columns, offset, others)
        fits.covariance[:, HIGHER] = fits.covariance[:, :, HIGHER] = fits.cross[:, :, HIGHER] = 0.0
        fits.shift[:, HIGHER] = away
        return fits

    def _fits(self, columns: FloatArray, offset: FloatArray, begin: FloatArray) -> Conditionals:
        """Return the fits of unknowns about `begin` (p,).

        The columns' factors are offset (k, p + 4) plus columns (k, p + 4, p) times the step of the unknowns.
        """
        back = columns.swapaxes(-1, -2)
        matrix = back @ self.information @ columns + np.diag(self.precision)
        vector = (back @ (self.pull - offset @ self.information)[..., None])[..., 0] - self.precision * begin
        covariance = inverses(matrix)
        step = (covariance @ vector[..., None])[..., 0]
        # where the step begins
        penalty = self.square + np.sum(offset * (offset @ self.information - 2.0 * self.pull), axis=1)
        penalty = penalty + self.precision @ begin**2 - np.sum(step * vector, axis=1)
        determinant = log_determinants(matrix) - np.sum(np.log(self.precision))
        moved = offset + (columns @ step[..., None])[..., 0]
        return Conditionals(
            shift=step,
            covariance=covariance,
            penalty=penalty,
            log_evidence=-0.5 * (penalty + determinant),
            coefficients=self.turned.coefficients(self.shrink, moved),
            cross=-((covariance @ back)[:, None] @ (self.turned.rows * self.shrink)) @ self.turned.axes.transform.T,
        )

    def true_penalty(self, problem: FitProblem, system: LinearSystem, shift: FloatArray) -> float:
        """Return twice the negative log posterior of the whole lens where the unknowns have moved by a shift (p,)."""
        at = self.at + shift
        residual = problem.residuals(at, system.observed)
        weighed = residual.T * system.observed.information
        in_axes = (weighed @ system.basis_values) @ self.turned.axes.transform
        fitted = float(np.sum(weighed * residual.T)) - float(np.sum(self.shrink * in_axes**2))
        others = at.copy()
        others[HIGHER] = 0.0
        return fitted + float(self.precision @ others**2)


def _by_products(problem: FitProblem, system: LinearSystem, unknowns: FloatArray) -> list[FloatArray]:
    """Return two times (b, 2, 2): derivatives of the prediction by p1 p3 and p1 p4, and by p2 p3 and p2 p4."""
    found = []
    for one in range(DECENTERING.start, DECENTERING.stop):
        # those by p3 and p4 are linear in p1 and p2: where one of them is 1 and the other 0, they are those sought
        unit = unknowns.copy()
        unit[DECENTERING] = 0.0
        unit[one] = 1.0
        found.append(problem.linearised(unit, system.observed)[1][..., HIGHER])
    return found


def mixed_over_decentering(  # noqa: PLR0917 - the fit, piece by piece
    posterior: PosteriorCovariance,
    problem: FitProblem,
    system: LinearSystem,
    unknowns: FloatArray,
    scales: Scales,
    mean: FloatArray | None = None,
) -> PosteriorCovariance:
    """Return the covariance with p3 and p4 integrated out.

    Parameters
    ----------
    posterior : the covariance about the fit, all unknowns taken as Gaussian.
    problem, system : of the fit; the system about `unknowns`.
    unknowns : the fit, (p,).
    scales : those of the fit.
    mean : (2, m) coefficients of the field in the prediction; None: it has no part there.
    """
    inner = posterior.covariance[HIGHER, HIGHER]
    if float(np.sqrt(np.max(np.diag(inner)))) < _KNOWN:
        return posterior
    sums = BilinearSums.about(problem, system, unknowns, scales)
    free, nodes = sums.free(), sums.conditional(NODES)
    share = shares(free, nodes)
    if not is_linear(sums, problem, system, nodes, share):
        nodes = of_whole_lens(problem, system, unknowns, scales)
        share = shares(free, nodes)
    moments = nodes.covariance + nodes.shift[:, :, None] * nodes.shift[:, None, :]
    excess = np.tensordot(share, moments - free.covariance, 1)
    part, positive = positive_part(excess, free.covariance[0])
    covariance = posterior.covariance + part
    if mean is None:
        return posterior._replace(covariance=covariance)
    field_shift = (nodes.coefficients - mean)[:, :, None, :]
    with_field = np.tensordot(share, nodes.cross + nodes.shift[:, None, :, None] * field_shift - free.cross, 1)
    field = replace(posterior.field, cross=posterior.field.cross + positive @ with_field)
    return PosteriorCovariance(covariance, seen_field(field, system.normal(), covariance))


def shares(free: Conditionals, nodes: Conditionals) -> FloatArray:
    """Return (k,): how probable the places are.

    The free fit takes part: where the grid misses the optimum, the Gaussian about it holds.
    """
    log_mass = np.r_[free.log_evidence, nodes.log_evidence - 0.5 * np.sum(NODES**2, axis=1) + CELL]
    share = np.exp(log_mass - np.max(log_mass))
    return np.asarray((share / share.sum())[1:])


def is_linear(
    sums: BilinearSums, problem: FitProblem, system: LinearSystem, nodes: Conditionals, share: FloatArray
) -> bool:
    """Return whether the whole lens is, at all plausible places, about as probable as the linear fits are.

    A fit far beyond the places says nothing of them.
    """
    if float(np.max(np.abs(sums.at[HIGHER]))) > _WIDEST:
        return False
    for one in np.flatnonzero(share > _PLAUSIBLE):
        if abs(sums.true_penalty(problem, system, nodes.shift[one]) - nodes.penalty[one]) > _CURVED:
            return False
    return True


def of_whole_lens(problem: FitProblem, system: LinearSystem, unknowns: FloatArray, scales: Scales) -> Conditionals:
    """Return the conditional fits of the whole lens, p3 and p4 in its prior's mean and not in its basis."""
    in_axes, transform = system.in_field_axes(scales)
    prior, start, found = problem.prior, unknowns.copy(), []
    start[HIGHER] = 0.0
    for place in NODES:
        basis = prior.basis.copy()
        basis[:, HIGHER] = 0.0
        held = replace(problem, prior=replace(prior, mean=prior.mean + prior.basis[:, HIGHER] @ place, basis=basis))
        converged = converged_in_axes(held, in_axes, scales, start)
        fit = converged.fit.with_coefficients_on(transform)
        shift = converged.unknowns - unknowns
        shift[HIGHER] = place - unknowns[HIGHER]
        fit.covariance[HIGHER] = fit.covariance[:, HIGHER] = fit.cross[:, HIGHER] = 0.0
        found.append((shift, fit.covariance, math.nan, converged.log_evidence, fit.coefficients, fit.cross))
    return Conditionals(*(np.array(column) for column in zip(*found, strict=True)))


def positive_part(excess: FloatArray, reference: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a symmetric matrix (p, p) without what it takes from a covariance, in units of that one.

    And the projection (p, p) that does so.
    """
    scale = np.sqrt(np.diag(reference))
    # in units of the Gaussian's covariance, positive and negative parts do not depend on the unknowns' units
    root = np.linalg.cholesky(reference / np.outer(scale, scale) + _RIDGE * np.eye(scale.size))
    left = np.linalg.solve(root, excess / np.outer(scale, scale))
    values, vectors = np.linalg.eigh(np.linalg.solve(root, left.T))
    shape = (scale[:, None] * root) @ vectors
    back = np.linalg.solve(root, np.diag(1.0 / scale))
    return (shape * np.maximum(values, 0.0)) @ shape.T, (shape * (values > 0.0)) @ vectors.T @ back
