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

import numpy as np
from numpy.typing import NDArray

from sunarc.calibration.bins import Bins, time_bins
from sunarc.calibration.consensus import consensus_start
from sunarc.calibration.decentering import deepest_valley
from sunarc.calibration.decentering_mixture import mixed_over_decentering
from sunarc.calibration.doubt import Doubt, doubt
from sunarc.calibration.evidence import Scales, marginal_fit, prior_precision
from sunarc.calibration.linear import LinearSystem, linear_system, settled
from sunarc.calibration.loss import INFORMATION_PER_WEIGHT, core_sigma, tukey_weights
from sunarc.calibration.noise import inflation, neighbours
from sunarc.calibration.options import CalibrationOptions
from sunarc.calibration.points import Usable
from sunarc.calibration.problem import Observations, Problem
from sunarc.calibration.scales import Grid, likely_scales, log_evidence, scale_grid
from sunarc.calibration.solve import information, most_probable
from sunarc.optics import Camera

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_ROUNDS = 5
_SETTLING = 3
_ENOUGH = 6000
"""Sightings that the first fits look at; the last ones look at all."""
_FIRST_FIELD_PX = 1.0
_SMALLEST_SIGMA_PX = 1e-4
_LOOSE_RADIAL_PX = 16.0
_LOOSE_DECENTERING_PX = 3.0
_PROOF_OF_AIR = math.log(20.0)
"""By how much more probable other air must make the sightings: as 20 to 1, the usual "strong" evidence."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobustFit:
    """What the rounds came to.

    Attributes
    ----------
    system : the bins' equations about the fit.
    unknowns : the most probable ones.
    doubt : their covariance and the field's part in it, over all plausible scales.
    scales : those of the fit, as found in the data.
    grid : the scales that were tried, and the field's waves.
    residual : (n, 2) observed minus modelled, px.
    weight : (n,) how much each sighting counted, 0 to 1.
    sigma_px : the noise's scale, px per axis (for sightings of relative sigma 1).
    inflation : (n,) by how much each sighting's variance grew because neighbours err alike.
    """

    problem: Problem
    system: LinearSystem
    unknowns: FloatArray
    doubt: Doubt
    scales: Scales
    grid: Grid
    residual: FloatArray
    weight: FloatArray
    sigma_px: float
    inflation: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _State:
    unknowns: FloatArray
    left: FloatArray
    scales: Scales


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Noise:
    sigma_px: float
    weight: FloatArray
    inflation: FloatArray

    def information(self, seen: Observations) -> FloatArray:
        """Return (n,) px⁻²."""
        variance = self.sigma_px**2 * self.inflation
        return np.asarray(seen.information * self.weight * INFORMATION_PER_WEIGHT / variance)


def fit_robustly(
    problem: Problem, seen: Observations, usable: Usable, start: FloatArray, *, options: CalibrationOptions
) -> RobustFit:
    """Return the fit of all sightings from a start in the right valley."""
    grid = _grid(problem.template, options)
    bins, run = time_bins(usable), usable.day * (1 + int(usable.epoch.max(initial=0))) + usable.epoch
    follows = neighbours(usable.unix_s, run)
    n_air = seen.refraction_sd.shape[1]
    unknowns = np.concatenate([_without_field(problem, seen, start, bins), np.zeros(n_air)])
    problem = replace(problem, n_air=n_air)
    first = Scales(_FIRST_FIELD_PX, float(grid.lengths[0]), _LOOSE_RADIAL_PX, _LOOSE_DECENTERING_PX)
    state = _State(unknowns=unknowns, left=problem.residuals(unknowns, seen), scales=first)
    for number in range(_ROUNDS):
        noise = _noise(state.left, seen, follows, run)
        system = linear_system(
            problem, seen, bins, state.unknowns, information=noise.information(seen), basis=grid.basis
        )
        state = _judged(problem, seen, system, state) if number == 0 else _improved(problem, seen, system, grid)
    state = _in_assumed_air(problem, seen.weighted(noise.information(seen)), bins, state, grid)
    system = linear_system(problem, seen, bins, state.unknowns, information=noise.information(seen), basis=grid.basis)
    gaussian = doubt(system.normal(), grid, problem, state.unknowns)
    return RobustFit(
        problem=problem,
        system=system,
        unknowns=state.unknowns,
        doubt=mixed_over_decentering(gaussian, problem, system, state.unknowns, state.scales),
        scales=state.scales,
        grid=grid,
        residual=problem.residuals(state.unknowns, seen),
        weight=noise.weight,
        sigma_px=noise.sigma_px,
        inflation=noise.inflation,
    )


def _grid(template: Camera, options: CalibrationOptions) -> Grid:
    return scale_grid(
        width=template.width,
        height=template.height,
        floor_px=options.field_floor_px,
        radial_px=options.tolerances.radial_px,
        decentering_px=options.tolerances.decentering_px,
    )


def _judged(problem: Problem, seen: Observations, system: LinearSystem, state: _State) -> _State:
    """Return the state with what a large field beside the model leaves over; the camera stays."""
    marginal = marginal_fit(system.normal(), system.basis, state.scales)
    explained = system.rows @ (marginal.unknowns - system.at) + system.waves @ marginal.waves.T
    return replace(state, left=problem.residuals(state.unknowns, seen) - explained[system.member])


def _improved(problem: Problem, seen: Observations, system: LinearSystem, grid: Grid) -> _State:
    """Return the state after a solve with the scales that the data speak for."""
    scales = likely_scales(system.normal(), grid)
    unknowns, waves = settled(problem, system, scales)
    smooth = (system.waves @ waves.T)[system.member]
    return _State(unknowns=unknowns, left=problem.residuals(unknowns, seen) - smooth, scales=scales)


def _in_assumed_air(problem: Problem, seen: Observations, bins: Bins, state: _State, grid: Grid) -> _State:
    """Return the state with the air as it is assumed, unless the sightings, by their information, prove another one."""
    assumed = replace(problem, n_air=0)
    system, known = (
        linear_system(each, seen, bins, state.unknowns[: each.size], information=seen.information, basis=grid.basis)
        for each in (problem, assumed)
    )
    if log_evidence(system.normal(), grid) - log_evidence(known.normal(), grid) > _PROOF_OF_AIR:
        return state
    scales = likely_scales(known.normal(), grid)
    unknowns, _ = settled(assumed, known, scales)
    return replace(state, unknowns=np.concatenate([unknowns, np.zeros(problem.n_air)]), scales=scales)


def _without_field(problem: Problem, seen: Observations, start: FloatArray, bins: Bins) -> FloatArray:
    """Return the robust fit without a field, the scale of the loss coming down to the core's."""
    precision = prior_precision(problem.size, _LOOSE_RADIAL_PX, _LOOSE_DECENTERING_PX)
    at = consensus_start(problem, seen, start, precision=precision)
    thin = seen.select(slice(None, None, 1 + len(seen) // _ENOUGH))
    sigma = 1.0
    for _ in range(_SETTLING):
        sigma = _widest_core(problem.residuals(at, thin), thin)
        at = most_probable(problem, thin, at, precision=precision, sigma=sigma, iterations=20).unknowns
    left = problem.residuals(at, seen)
    gathered, residual = bins.gathered(seen, left, information(left, seen, sigma))
    pixels = gathered.pixels + residual - problem.residuals(at, gathered)
    return deepest_valley(problem, replace(gathered, pixels=pixels), at, precision=precision)


def _widest_core(left: FloatArray, seen: Observations) -> float:
    """Return the scale of the pose that fits worst so far: by one that fits already, it would be left out whole."""
    distance = np.linalg.norm(left, axis=-1) * np.sqrt(seen.information)
    epochs = np.unique(seen.epoch)
    return max(core_sigma(distance[seen.epoch == epoch], floor=_SMALLEST_SIGMA_PX) for epoch in epochs)


def _noise(left: FloatArray, seen: Observations, follows: NDArray[np.bool_], run: IntArray) -> _Noise:
    """Return the noise as it shows beside model and field."""
    distance = np.hypot(left[:, 0], left[:, 1]) * np.sqrt(seen.information)
    sigma = core_sigma(distance, floor=_SMALLEST_SIGMA_PX)
    weight = tukey_weights(distance, sigma=sigma)
    return _Noise(sigma_px=sigma, weight=weight, inflation=inflation(left, weight, follows, run))
