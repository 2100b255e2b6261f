"""How far a fit may be off when the scales are not known: one Gaussian that holds what all plausible scales say.

Each choice of scales gives its own covariance, and the errors are a mixture of them. The mean of the covariances would
hold far more than 95 % where a few per cent of the probability lie on a large field, and less where a large field is as
plausible as none. So the probabilities are tilted by a power of the amplitude, the one with which 95 % of the mixture
lies within the 95 % ellipses, in the mean over the sky.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray, IntArray
from sunarc.calibration.fit.choices_kernel import add_moments, write_coverage
from sunarc.calibration.fit.field_posterior import seen_field
from sunarc.calibration.fit.hyperparameter_grid import HyperparameterGrid, log_weights, normalised
from sunarc.calibration.fit.marginal_likelihood import NormalEquations, Turned, posterior_covariances
from sunarc.calibration.least_squares.problem import Observations, Problem
from sunarc.calibration.model.covariance import hemisphere
from sunarc.calibration.model.residual_field import Field, WaveBasis

_NOMINAL_COVERAGE = 0.95
_ELLIPSE = -2.0 * math.log(1.0 - _NOMINAL_COVERAGE)
"""Square of the Mahalanobis distance that holds 95 % of a Gaussian in the plane."""
_TILTS = (-3.0, 1.5)
_SAME_COVERAGE = 2e-4
"""Of the share held: a hundredth of what it differs by between fits."""
_MOST_STEPS = 20
_TAIL_TILT = 0.5
_WEIGHT_RETAINED = 0.985
_PROBES = 60
_COS_DOUBLED = np.cos((np.arange(8) + 0.5) * math.pi / 8.0)
"""Directions round a quarter of an ellipse, as the cosine of twice their angle."""


class PosteriorCovariance(NamedTuple):
    """How far a fit may be off, the scales not being known: the covariance (p, p) of the unknowns, and the field."""

    covariance: FloatArray
    field: Field


class _Field(NamedTuple):
    """The field under one amplitude and length, px: the sums in its axes, and its shrinkage (r,).

    `values` (n, r) are those of its axes at some places.
    """

    turned: Turned
    shrink: FloatArray
    amplitude_px: float
    length_px: float

    def pull(self, values: FloatArray) -> FloatArray:
        """Return (2, p, n): J' of each component with the field's posterior at the places."""
        return np.asarray((self.turned.rows * self.shrink) @ values.T)

    def reduction(self, values: FloatArray) -> FloatArray:
        """Return (n,): by how much sightings reduce the variance of either component there, the parameters given."""
        return np.asarray(values**2 @ (self.amplitude_px**2 - self.shrink))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Choices:
    """The plausible scales, those of one field together.

    share (k,): probabilities. amplitude, length (k,): px. fields: one for each `field` (k,) of them. covariance
    (k, p, p); shift (k, p): from the fit that is doubted; field_shift (k, 2, m): that of the field's mean, where it is
    predicted.
    """

    share: FloatArray
    amplitude: FloatArray
    length: FloatArray
    fields: list[_Field]
    field: IntArray
    covariance: FloatArray
    shift: FloatArray
    field_shift: FloatArray | None

    def tilted(self, tilt: float) -> FloatArray:
        """Return the shares, each times a power of its amplitude."""
        weight = self.share * self.amplitude**tilt
        return np.asarray(weight / weight.sum())

    def mean_cross(self, weight: FloatArray) -> FloatArray:
        """Return (2, p, m): the mean covariance of the unknowns with the field's coefficients."""
        in_axes: dict[float, FloatArray] = {}
        for number, field in enumerate(self.fields):
            inside = self.field == number
            mean = np.tensordot(weight[inside], self.covariance[inside], 1)
            in_axes[field.length_px] = in_axes.get(field.length_px, 0.0) - mean @ (field.turned.rows * field.shrink)
        transforms = {field.length_px: field.turned.axes.transform for field in self.fields}
        return np.asarray(np.sum([part @ transforms[length].T for length, part in in_axes.items()], axis=0))


def marginalised_covariance(
    normal: NormalEquations,
    grid: HyperparameterGrid,
    problem: Problem,
    unknowns: FloatArray,
    mean: FloatArray | None = None,
) -> PosteriorCovariance:
    """Return how far the unknowns may be off, whatever the scales are; `normal` is about them.

    `mean` (2, m) are the coefficients of the field that is part of the prediction; None: it has no part in it, and its
    errors are those before any sighting.
    """
    choices = _plausible(normal, grid, unknowns, mean)
    moments = _at_probes(choices, grid.basis, problem, unknowns)
    weight = choices.tilted(_honest_tilt(choices, moments))
    power = weight * choices.amplitude**2
    amplitude = math.sqrt(float(power.sum()))
    length = math.exp(float(power @ np.log(choices.length) / power.sum()))
    covariance = (choices.shift.T * weight) @ choices.shift + np.tensordot(weight, choices.covariance, 1)
    cross = choices.mean_cross(weight)
    unseen = Field(amplitude_px=amplitude, length_px=length, basis=grid.basis, cross=cross)
    if choices.field_shift is None:
        return PosteriorCovariance(covariance, unseen)
    cross = cross + np.einsum("k,kp,kam->apm", weight, choices.shift, choices.field_shift, optimize=True)
    return PosteriorCovariance(covariance, seen_field(replace(unseen, cross=cross), normal, covariance))


def _plausible(
    normal: NormalEquations, grid: HyperparameterGrid, unknowns: FloatArray, mean: FloatArray | None = None
) -> _Choices:
    """Return the scales that hold nearly all of the probability, tilted towards large fields or not."""
    weight = normalised(log_weights(normal, grid))
    # large fields of small probability decide the tilt: they must not be cut off beforehand
    tail = weight * grid.amplitudes[:, None, None] ** _TAIL_TILT
    either = (weight + tail / tail.sum()).ravel()
    order = np.argsort(either)[::-1]
    # in the order of the grid, so that choices of one field follow one another
    retained = np.sort(order[: 1 + int(np.searchsorted(np.cumsum(either[order]), _WEIGHT_RETAINED * either.sum()))])
    i, j, k = np.unravel_index(retained, weight.shape)
    pairs, field = np.unique(np.stack([i, j], axis=-1), axis=0, return_inverse=True)
    precision = normal.prior_precisions(grid.lens_scales)
    each_length = {length: Turned.of(normal, grid.basis, length) for length in grid.lengths[np.unique(j)].tolist()}
    fields, covariance, fitted, coefficients = [], [], [], []
    for number, (amplitude, length) in enumerate(pairs):
        length_px = float(grid.lengths[length])
        turned = each_length[length_px]
        shrink = turned.axes.shrinkage(grid.amplitudes[amplitude : amplitude + 1])[0]
        here = precision[k[field.ravel() == number]]
        covariance.append(posterior_covariances(normal.jj - turned.absorbed(shrink), normal, here))
        pull = normal.jr - turned.explained(shrink) - here * normal.at
        step = (covariance[-1] @ pull[..., None])[..., 0]
        fitted.append(normal.at + step)
        if mean is not None:
            coefficients.append(turned.coefficients(shrink, step) - mean)
        fields.append(_Field(turned, shrink, float(grid.amplitudes[amplitude]), length_px))
    share = weight.ravel()[retained]
    return _Choices(
        share=share / share.sum(),
        amplitude=grid.amplitudes[i],
        length=grid.lengths[j],
        fields=fields,
        field=field.ravel(),
        covariance=np.concatenate(covariance),
        shift=np.concatenate(fitted) - unknowns,
        field_shift=np.concatenate(coefficients) if coefficients else None,
    )


def _at_probes(choices: _Choices, basis: WaveBasis, problem: Problem, unknowns: FloatArray) -> FloatArray:
    """Return (k, 3, n): the error's second moments xx, xy, yy under each choice, at places spread over the sky.

    Camera and field together, see `covariance`, and how far the choice's fit is from the one that is doubted. Without a
    mean of the field in the prediction its own block is that before any sighting.
    """
    rows, basis_values = sky_rows(problem, unknowns, basis)
    # a component of all places after the other: (p, 2 n)
    by_unknowns = np.ascontiguousarray(np.moveaxis(rows, -1, 0).swapaxes(1, 2)).reshape(unknowns.size, -1)
    moved = (choices.shift @ by_unknowns).reshape(-1, 2, rows.shape[0])
    predicted = choices.field_shift is not None
    if choices.field_shift is not None:
        moved = moved + choices.field_shift @ basis_values.T
    x, y = np.moveaxis(moved, 1, 0)
    moments = np.stack([x * x, x * y, y * y], axis=1)
    axes = {field.length_px: field.turned.axes for field in choices.fields}
    in_axes = {length: basis_values @ one.transform for length, one in axes.items()}
    for number, field in enumerate(choices.fields):
        inside = choices.field == number
        values = in_axes[field.length_px]
        pull = np.concatenate(list(field.pull(values)), axis=-1)
        # camera and field: J C J' - J C X' - X C J', and with the field's mean in the prediction X C X' beside it
        left, right = (by_unknowns - pull,) * 2 if predicted else (by_unknowns, by_unknowns - 2.0 * pull)
        own = np.zeros((np.count_nonzero(inside), *moments.shape[1:]))
        add_moments(left, right, choices.covariance[inside], own)
        reduction = field.reduction(values) if predicted else 0.0
        own[:, ::2] += np.maximum(field.amplitude_px**2 - reduction, 0.0)
        moments[inside] += own
    return moments


def sky_rows(problem: Problem, unknowns: FloatArray, basis: WaveBasis) -> tuple[FloatArray, FloatArray]:
    """Return derivatives (n, 2, p) and basis values (n, m) of sky that the last epoch's camera shows."""
    sky = hemisphere(_PROBES)
    nowhere = np.zeros((_PROBES, 2))
    epoch = np.full(_PROBES, problem.n_epochs - 1)
    minus, rows = problem.linearised(
        unknowns,
        Observations(
            directions=sky,
            pixels=nowhere,
            information=np.ones(_PROBES),
            epoch=epoch,
            systematic_px=np.zeros((1, 2, problem.n_systematic)),
        ),
    )
    shown = np.all((minus < 0.5) & (-minus < [problem.template.width - 0.5, problem.template.height - 0.5]), axis=-1)
    return rows[shown], basis.values(-minus[shown])


def _honest_tilt(choices: _Choices, moments: FloatArray) -> float:
    """Return the power of the amplitude with which the tilted mean holds as much of the mixture as it says."""
    if moments.shape[2] == 0:
        return 0.0

    def excess(tilt: float) -> float:
        stated = np.tensordot(choices.tilted(tilt), moments, 1)
        return float(choices.share @ _coverage(moments, stated)) - _NOMINAL_COVERAGE

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


def _coverage(moments: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return (k,): the share of Gaussians (k, 3, n) within the 95 % ellipses of stated covariances (3, n).

    With l₁, l₂ the eigenvalues of stated⁻¹ · moments, it is the mean over φ of 1 - exp(-q / 2 (l₁ cos² φ + l₂ sin² φ)).
    """
    share = np.empty(moments.shape[0])
    write_coverage(moments, covariance, _ELLIPSE, _COS_DOUBLED, share)
    return share
