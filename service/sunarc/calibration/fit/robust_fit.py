"""The service's method: directions, priors, a redescending loss, and a field for what the model cannot say.

The refraction's scale is one of the unknowns. Where the sightings do not prove that the air is another than the assumed
one, the camera is the one that fits with the assumed air: what the air may change is then in the covariance alone.

Rounds of: weigh the sightings by what the last fit leaves over, gather them into bins, ask which scales the data speak
for, solve with the field marginalised. The first round lets the field be large, so that the noise is judged from what
no smooth error explains.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sunarc.array_types import BoolArray, FloatArray, IntArray
from sunarc.calibration.fit.decentering_mixture import mixed_over_decentering
from sunarc.calibration.fit.hyperparameter_grid import (
    HyperparameterGrid,
    likely_scales,
    log_evidence,
    log_odds_of_a_field,
    log_weights,
    normalised,
    scale_grid,
)
from sunarc.calibration.fit.hyperparameter_marginalisation import PosteriorCovariance, marginalised_covariance
from sunarc.calibration.fit.least_squares_reference import allowed_level, at_least_least_squares, finest_weight
from sunarc.calibration.fit.marginal_likelihood import STRONG_EVIDENCE, Scales, field_at, marginal_fit, prior_precision
from sunarc.calibration.fit.noise import inflation, neighbours
from sunarc.calibration.fit.normal_equations import LinearSystem, irls_converged, linear_system
from sunarc.calibration.initial_guess.decentering_starts import best_of_starts
from sunarc.calibration.initial_guess.multistart import SMALLEST_SIGMA_PX, best_start, distance_sigmas, lowest
from sunarc.calibration.least_squares.problem import Observations, Problem
from sunarc.calibration.least_squares.solve import information as information_of
from sunarc.calibration.least_squares.time_bins import Bins, time_bins
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.sightings import FilteredSightings
from sunarc.calibration.robust_loss import INFORMATION_PER_WEIGHT, robust_sigma, tukey_weights
from sunarc.optics import Camera

_ROUNDS = 5
_FIRST_FIELD_PX = 1.0
_LOOSE_RADIAL_PX = 16.0
_LOOSE_DECENTERING_PX = 3.0
_ENOUGH = 20
"""Sightings of one kind, at least, for a scale of their own."""
_FIELD_MAY_COST = 1.1
"""Robust cost with a field over that without: priors and correlated noise make it 1.04 at most where all is well."""
_FIELD_SHRINKS = 0.25
_FIELD_BOUNDS = 4
"""How often the largest field is made smaller; 1 px is 0.004 px then, the floor's size."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobustFit:
    """What the rounds came to.

    Attributes
    ----------
    system : the bins' equations about the fit.
    unknowns : the most probable ones.
    posterior : their covariance and the field's part in it, over all plausible scales.
    scales : those of the fit, as found in the data.
    grid : the scales that were tried, and the field's basis functions.
    residual : (n, 2) observed minus modelled by the lens alone, px.
    field_mean : (2, m) coefficients of the most probable field; None where none is more probable.
    weight : (n,) how much each sighting counted, 0 to 1.
    sigma_px : the noise's scale, px per axis (for sightings of relative sigma 1).
    inflation : (n,) by how much each sighting's variance grew because neighbours err alike.
    information : (n,) what each sighting tells of either axis, all of these together, px⁻².
    """

    problem: Problem
    system: LinearSystem
    unknowns: FloatArray
    posterior: PosteriorCovariance
    scales: Scales
    grid: HyperparameterGrid
    residual: FloatArray
    field_mean: FloatArray | None
    weight: FloatArray
    sigma_px: float
    inflation: FloatArray
    information: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _State:
    """Where the rounds stand, and the log odds of a field."""

    unknowns: FloatArray
    residuals: FloatArray
    scales: Scales
    field_odds: float = -math.inf

    @property
    def proven_field_px(self) -> float:
        """The field's 1-sigma where the sightings prove one, else 0."""
        return self.scales.amplitude_px if self.field_odds > STRONG_EVIDENCE else 0.0


class _Course(NamedTuple):
    """Bins; runs of one day and pose (n,); which follow the one before (n - 1,); which have no neighbours (n,)."""

    bins: Bins
    run: IntArray
    follows: BoolArray
    alone: BoolArray

    @classmethod
    def of(cls, usable: FilteredSightings) -> _Course:
        run = 2 * (usable.day * (1 + int(usable.epoch.max(initial=0))) + usable.epoch) + usable.alone
        each_apart = np.where(usable.alone, -1 - np.arange(len(usable)), run)
        return cls(time_bins(usable), run, neighbours(usable.unix_s, each_apart), usable.alone)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Noise:
    """The noise of each sighting, (n,): its scale for a relative sigma of 1, px; its weight; see `RobustFit`."""

    scale: FloatArray
    weight: FloatArray
    inflation: FloatArray

    @property
    def sigma_px(self) -> float:
        """The scale of the track, which comes first; without one, of all."""
        return float(self.scale[0])

    def information(self, observed: Observations) -> FloatArray:
        """Return (n,) px⁻²."""
        variance = self.scale**2 * self.inflation
        return np.asarray(observed.information * self.weight * INFORMATION_PER_WEIGHT / variance)


def fit_robustly(
    problem: Problem,
    observed: Observations,
    usable: FilteredSightings,
    start: FloatArray,
    *,
    options: CalibrationOptions,
) -> RobustFit:
    """Return the fit of all sightings from the answer of the coarse search.

    Parameters
    ----------
    problem : the camera sought.
    observed : sightings, in the order of time within each epoch.
    usable : their times, days and epochs.
    start : (p,) unknowns of the coarse search; other starts are tried beside it.
    options : floor of the field, and tolerances of the lens.
    """
    grid = _grid(problem.template, options)
    course = _Course.of(usable)
    bins = course.bins
    plain = _without_field(problem, observed, start, bins)
    problem = replace(problem, n_air=observed.refraction_sd.shape[1])
    plain = np.concatenate([plain, np.zeros(problem.n_air)])
    state, noise, grid = _with_field(problem, observed, plain, grid, course)
    information = noise.information(observed)
    state = _in_assumed_air(problem, observed.weighted(information), bins, state, grid)
    weighed = observed.weighted(observed.information * (noise.sigma_px / noise.scale) ** 2)
    unknowns = _as_good_as_least_squares(problem, weighed, bins, state, sigma=noise.sigma_px)
    system = linear_system(problem, observed, bins, unknowns, information=information, basis=grid.basis)
    normal = system.normal()
    mean = field_at(normal, grid.basis, state.scales) if state.field_odds > 0.0 else None
    gaussian = marginalised_covariance(normal, grid, problem, unknowns, mean)
    return RobustFit(
        problem=problem,
        system=system,
        unknowns=unknowns,
        posterior=mixed_over_decentering(gaussian, problem, system, unknowns, state.scales, mean),
        scales=state.scales,
        grid=grid,
        residual=problem.residuals(unknowns, observed),
        field_mean=mean,
        weight=noise.weight,
        sigma_px=noise.sigma_px,
        inflation=noise.inflation,
        information=information,
    )


def _grid(template: Camera, options: CalibrationOptions) -> HyperparameterGrid:
    return scale_grid(
        width=template.width,
        height=template.height,
        floor_px=options.field_floor_px,
        radial_px=options.tolerances.radial_px,
        decentering_px=options.tolerances.decentering_px,
    )


def _with_field(
    problem: Problem, observed: Observations, plain: FloatArray, grid: HyperparameterGrid, course: _Course
) -> tuple[_State, _Noise, HyperparameterGrid]:
    """Return the rounds' answer, and the grid of scales that it took.

    A field is there to widen the uncertainty, and does not enter the prediction. One that lets the camera itself miss
    the sightings has taken over what the lens's parameters explain: it is bounded more tightly, and the rounds begin
    again.
    """
    distance = distance_sigmas(problem, observed, plain)
    sigma, weight = robust_sigma(distance, floor=SMALLEST_SIGMA_PX), finest_weight(observed)
    state, noise = _rounds(problem, observed, plain, grid, course)
    for _ in range(_FIELD_BOUNDS):
        level = allowed_level(
            distance, sigma=sigma, field_px=state.proven_field_px, weight=weight, cost_ratio=_FIELD_MAY_COST
        )
        if level.reached_by(distance_sigmas(problem, observed, state.unknowns)):
            break
        grid = grid.up_to(_FIELD_SHRINKS * state.scales.amplitude_px)
        state, noise = _rounds(problem, observed, plain, grid, course)
    return state, noise, grid


def _rounds(
    problem: Problem, observed: Observations, unknowns: FloatArray, grid: HyperparameterGrid, course: _Course
) -> tuple[_State, _Noise]:
    first = Scales(_FIRST_FIELD_PX, float(grid.lengths[0]), _LOOSE_RADIAL_PX, _LOOSE_DECENTERING_PX)
    state = _State(unknowns=unknowns, residuals=problem.residuals(unknowns, observed), scales=first)
    noise = _noise(state.residuals, observed, course)
    for number in range(_ROUNDS):
        noise = _noise(state.residuals, observed, course)
        system = linear_system(
            problem, observed, course.bins, state.unknowns, information=noise.information(observed), basis=grid.basis
        )
        state = _judged(problem, observed, system, state) if number == 0 else _improved(problem, observed, system, grid)
    return state, noise


def _as_good_as_least_squares(
    problem: Problem, observed: Observations, bins: Bins, state: _State, *, sigma: float
) -> FloatArray:
    """Return the unknowns, those of the camera brought to what least squares reaches in the same air."""
    assumed, unknowns = replace(problem, n_air=0), state.unknowns
    in_this_air = replace(observed, directions=problem.directions(unknowns, observed))
    camera = at_least_least_squares(
        assumed, in_this_air, bins, unknowns[: assumed.size], sigma=sigma, field_px=state.proven_field_px
    )
    return np.concatenate([camera, unknowns[assumed.size :]])


def _judged(problem: Problem, observed: Observations, system: LinearSystem, state: _State) -> _State:
    """Return the state with what a large field beside the model leaves over; the camera stays."""
    marginal = marginal_fit(system.normal(), system.basis, state.scales)
    explained = system.rows @ (marginal.unknowns - system.at) + system.basis_values @ marginal.coefficients.T
    return replace(state, residuals=problem.residuals(state.unknowns, observed) - explained[system.member])


def _improved(problem: Problem, observed: Observations, system: LinearSystem, grid: HyperparameterGrid) -> _State:
    """Return the state after a solve with the scales that the data speak for."""
    log_weight = log_weights(system.normal(), grid)
    scales = likely_scales(normalised(log_weight), grid)
    unknowns, coefficients = irls_converged(problem, system, scales)
    smooth = (system.basis_values @ coefficients.T)[system.member]
    return _State(
        unknowns=unknowns,
        residuals=problem.residuals(unknowns, observed) - smooth,
        scales=scales,
        field_odds=log_odds_of_a_field(log_weight),
    )


def _in_assumed_air(
    problem: Problem, observed: Observations, bins: Bins, state: _State, grid: HyperparameterGrid
) -> _State:
    """Return the state with the air as it is assumed, unless the sightings, by their information, prove another one."""
    assumed = replace(problem, n_air=0)
    system, in_assumed_air = (
        linear_system(
            each, observed, bins, state.unknowns[: each.size], information=observed.information, basis=grid.basis
        )
        for each in (problem, assumed)
    )
    other, usual = (log_weights(each.normal(), grid) for each in (system, in_assumed_air))
    if log_evidence(other) - log_evidence(usual) > STRONG_EVIDENCE:
        return state
    scales = likely_scales(normalised(usual), grid)
    unknowns, _ = irls_converged(assumed, in_assumed_air, scales)
    return replace(state, unknowns=np.concatenate([unknowns, np.zeros(problem.n_air)]), scales=scales)


def _without_field(problem: Problem, observed: Observations, start: FloatArray, bins: Bins) -> FloatArray:
    """Return the robust fit without a field: the best of several starts."""
    precision = prior_precision(problem.size, _LOOSE_RADIAL_PX, _LOOSE_DECENTERING_PX)
    at = best_start(problem, observed, start, precision=precision)
    residuals = problem.residuals(at, observed)
    sigma = robust_sigma(distance_sigmas(problem, observed, at), floor=SMALLEST_SIGMA_PX)
    means = bins.observations(observed, problem, at, information=information_of(residuals, observed, sigma))
    deepest = best_of_starts(problem, means, at, precision=precision)
    return lowest(problem, observed, [at, deepest], precision=precision)


def _noise(residuals: FloatArray, observed: Observations, course: _Course) -> _Noise:
    """Return the noise as it shows beside model and field."""
    distance = np.hypot(residuals[:, 0], residuals[:, 1]) * np.sqrt(observed.information)
    scale = np.full(distance.size, robust_sigma(distance, floor=SMALLEST_SIGMA_PX))
    for kind in (course.alone, ~course.alone):
        # sigmas stated with directions and by the sun's detector may be wrong by different factors
        if np.count_nonzero(kind) >= _ENOUGH:
            scale[kind] = robust_sigma(distance[kind], floor=SMALLEST_SIGMA_PX)
    weight = tukey_weights(distance / scale, sigma=1.0)
    inflated = inflation(residuals, weight, course.follows, course.run)
    return _Noise(scale=scale, weight=weight, inflation=np.where(course.alone, 1.0, inflated))
