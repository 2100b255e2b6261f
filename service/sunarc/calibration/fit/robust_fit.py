"""Robust fit: directions, priors, a redescending loss, and a field for the errors that the model does not have.

Each round weighs the sightings by the residuals of the last one, gathers them into bins, finds the most probable
scales, and solves with the field marginalised.

Errors that many sightings share are blocks of unknowns, see `effects`. Where the sightings do not prove one, the camera
is the one that fits without it: its possible effect is then in the covariance alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from sunarc.calibration.answers.ageing import SEASONS
from sunarc.calibration.fit.effects import (
    PICTURE,
    PIXELS,
    POSSIBLE,
    SHOWN_BY_STARS,
    SWAYS,
    TURNING,
    add_effects,
    worst_day_roots,
)
from sunarc.calibration.fit.marginal_likelihood import (
    LOOSE_DECENTERING_PX,
    LOOSE_RADIAL_PX,
    FieldSums,
    HyperparameterGrid,
    MarginalFit,
    NormalEquations,
    PriorScales,
    field_at,
    field_log_odds,
    field_sums,
    likely_scales,
    log_evidence,
    log_weights,
    marginal_fit,
    normalised,
    prior_precision,
    scale_grid,
)
from sunarc.calibration.fit.normal_equations import LinearSystem, linear_system, most_probable_with_field, system_about
from sunarc.calibration.fit.posterior import PosteriorCovariance, prediction_variance, stated_posterior
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle
from sunarc.calibration.model.result import probability, proves, suspects
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.noise import Noise, NoiseGroups, measured_noise
from sunarc.calibration.solve.levenberg_marquardt import information as information_of
from sunarc.calibration.solve.priors import DECENTERING, RADIAL, STRETCH, Whitened, free_pixel_aspect
from sunarc.calibration.solve.problem import FitProblem
from sunarc.calibration.start.initial_guess import single_problem
from sunarc.calibration.start.multistart import (
    SMALLEST_SIGMA_PX,
    best_start,
    distance_sigmas,
    lowest,
    solve_from_starts,
)
from sunarc.common.array_types import BoolArray, FloatArray, IntArray
from sunarc.common.robust_statistics import (
    counted_roots,
    is_shown,
    robust_sigma,
    surely_well_behaved,
)
from sunarc.optics.camera import Camera
from sunarc.optics.displacement import WaveBasis

_ROUNDS = 4
_PASSES = 3
_FEW_PER_UNKNOWN = 5
"""Sightings for each unknown below which the fit has taken up more of their noise than can be passed over."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FitState:
    """State of a robust fit: where its rounds stand, and the answer that follows from it."""

    problem: FitProblem
    """The camera sought, with the blocks of the errors that sightings share."""
    observed: Sightings
    """The sightings, with their displacement by the errors that they share."""
    groups: NoiseGroups
    """Groups of the sightings."""
    grid: HyperparameterGrid
    """The scales that are tried, and the field's basis functions."""
    unknowns: FloatArray
    """(p,) The most probable unknowns."""
    scales: PriorScales
    """The scales that they were found with."""
    noise: Noise
    """The noise of each sighting, by which the last round weighed them."""
    last_round: LinearSystem
    """The bins' equations of the last round."""
    scatter: FloatArray
    """(n, 2) px: residuals without the field's part."""
    leverage: FloatArray | None = None
    """(n,) see `compute_leverage`; None where each sighting has little."""
    field_odds: float = -math.inf
    """Log odds of a field."""
    block_odds: dict[str, float] = field(default_factory=dict)
    """Log odds of each shared error."""
    gain: float = math.inf
    """Gain of the last round in twice the log posterior."""

    @property
    def member(self) -> IntArray:
        """(n,) The bin of each sighting."""
        return self.groups.bins.member

    @cached_property
    def system(self) -> LinearSystem:
        """The bins' equations about the unknowns."""
        weighed = replace(self.observed, information=self.noise.information)
        return system_about(self.problem, weighed, self.groups.bins, self.last_round, self.unknowns)

    @cached_property
    def normal(self) -> NormalEquations:
        """The sums over the bins about the unknowns."""
        return self.system.normal()

    @cached_property
    def residual(self) -> FloatArray:
        """(n, 2) px: observed minus modelled by the lens alone."""
        return self.problem.residuals(self.unknowns, self.observed)

    @cached_property
    def field_mean(self) -> FloatArray | None:
        """(2, m) Coefficients of the most probable field; None where none is more probable."""
        return field_at(self.normal, self.grid.basis, self.scales) if self.field_odds > 0.0 else None

    @cached_property
    def log_odds(self) -> dict[str, float]:
        """Log odds of the parts of the model, see `Provenance`."""
        parts = part_log_odds(self.normal, self.grid.basis, self.scales)
        return {**parts, "field": self.field_odds, **self.block_odds}

    @cached_property
    def posterior(self) -> PosteriorCovariance:
        """The covariance of the unknowns and the field's part in it, over all plausible scales."""
        return stated_posterior(
            self.problem,
            self.system,
            self.unknowns,
            grid=self.grid,
            mean=self.field_mean,
            stretched=probability(self.block_odds.get(PIXELS, -math.inf), odds_against=self.grid.square_odds),
        )

    def camera(self) -> Camera:
        """Return the camera of the last pose."""
        return self.problem.camera(self.unknowns, self.problem.n_epochs - 1)


def robust_rounds(
    problem: FitProblem,
    observed: Sightings,
    plain: FloatArray,
    *,
    groups: NoiseGroups,
    grid: HyperparameterGrid,
) -> FitState:
    """Return the fit with a field from the robust fit without one.

    Parameters
    ----------
    problem : the camera sought, with the blocks of what the sightings share.
    observed : sightings, in the order of time within each epoch.
    plain : unknowns of the fit without a field, those of the blocks apart.
    groups : of the sightings.
    grid : scales to try.
    """
    plain = np.concatenate([plain, np.zeros(problem.n_unit)])
    for name in sorted(problem.names & {*SEASONS, TURNING, SWAYS}):
        plain = _estimate_block(problem, observed, plain, name)
    if PICTURE in problem.names:
        plain = _estimate_picture_change(problem, observed, plain)
    state = _add_proven_effects(_run_rounds(problem, observed, plain, grid, groups))
    # weighed before the camera's last step, which may bring the edge of what it shows past a low sun
    noise, shown = state.noise, is_shown(state.residual)
    noise = replace(noise, weight=noise.weight * shown, information=noise.information * shown)
    return replace(state, noise=noise)


def _estimate_block(problem: FitProblem, observed: Sightings, unknowns: FloatArray, name: str) -> FloatArray:
    """Return unknowns with a block as it seems to be by the residuals.

    Where the rounds begin without, residuals that are alike for a day or a season are noise that hides the block.
    """
    of_block = problem.block_slice(name)
    distance = distance_sigmas(problem, observed, unknowns)
    root = counted_roots(distance, observed.information, floor=SMALLEST_SIGMA_PX)
    columns = problem.linearised(unknowns, observed)[1][:, :, of_block] * root[:, None, None]
    left = problem.residuals(unknowns, observed) * root[:, None]
    products = np.einsum("nap,naq->pq", columns, columns, optimize=True) + np.eye(columns.shape[2])
    begun = unknowns.copy()
    begun[of_block] = np.linalg.solve(products, np.einsum("nap,na->p", columns, left, optimize=True))
    return begun


def _estimate_picture_change(problem: FitProblem, observed: Sightings, unknowns: FloatArray) -> FloatArray:
    """Return unknowns at which the days before another picture are met as well as those since."""
    precision = prior_precision(problem.size, LOOSE_RADIAL_PX, LOOSE_DECENTERING_PX, n_unit=problem.n_unit)
    for _ in range(_PASSES):
        root = worst_day_roots(distance_sigmas(problem, observed, unknowns), observed)
        left, columns = problem.linearised(unknowns, observed)
        columns = columns * root[:, None, None]
        products = np.einsum("nap,naq->pq", columns, columns, optimize=True) + np.diag(precision)
        pull = np.einsum("nap,na->p", columns, left * root[:, None], optimize=True) - precision * unknowns
        unknowns = unknowns + np.linalg.solve(products, pull)
    return unknowns


def _run_rounds(
    problem: FitProblem, observed: Sightings, plain: FloatArray, grid: HyperparameterGrid, groups: NoiseGroups
) -> FitState:
    """Return the rounds' answer.

    The mean of a field that is more probable than none is part of the prediction (decision 0008).
    """
    state = _round(problem, observed, grid, groups, plain, scatter=problem.residuals(plain, observed))
    for _ in range(1, _ROUNDS):
        state = _round(problem, observed, grid, groups, state.unknowns, scatter=state.scatter, leverage=state.leverage)
        if state.gain <= 0.0:
            break  # where a round does not move the camera, a further one changes nothing
    return state


def _round(
    problem: FitProblem,
    observed: Sightings,
    grid: HyperparameterGrid,
    groups: NoiseGroups,
    unknowns: FloatArray,
    *,
    scatter: FloatArray,
    leverage: FloatArray | None = None,
) -> FitState:
    """Return the state after a solve from some unknowns with the noise of a scatter, and the most probable scales."""
    noise, bins = measured_noise(scatter, observed, groups, leverage=leverage), groups.bins
    system = linear_system(problem, observed, bins, unknowns, information=noise.information, basis=grid.basis)
    log_weight = log_weights(system.normal(), grid)
    scales = likely_scales(normalised(log_weight), grid)
    found = most_probable_with_field(problem, system, scales)
    leverage = None
    few = len(observed) < _FEW_PER_UNKNOWN * (problem.size - problem.n_unit)
    if "night_pose" in problem.names or few:
        there = system.moved(problem, found.unknowns)
        which = few | np.any(there.rows[..., problem.block_slice("night_pose")] != 0.0, axis=(1, 2))
        leverage = compute_leverage(there, there.normal(), found.fit, scales, which=which)[bins.member]
    smooth = (system.basis_values @ found.fit.coefficients.T)[bins.member]
    return FitState(
        problem=problem,
        observed=observed,
        groups=groups,
        grid=grid,
        unknowns=found.unknowns,
        scales=scales,
        noise=noise,
        last_round=system,
        scatter=problem.residuals(found.unknowns, observed) - smooth,
        leverage=leverage,
        field_odds=field_log_odds(log_weight),
        gain=found.gain,
    )


def _add_proven_effects(state: FitState) -> FitState:
    """Return the state with the shared errors that are possible, or that the sightings make so by their information.

    Those that are not proven are 0.
    """
    problem, grid, system = state.problem, state.grid, state.system
    proven, log_weight, odds = proven_blocks(problem, field_sums(state.normal, grid), grid)
    suspected = {name for name, one in odds.items() if suspects(name, one)} - {PIXELS}  # these are of the lens's prior
    kept, places = problem.only(POSSIBLE | proven | suspected)
    state = replace(state, problem=kept, unknowns=state.unknowns[places], block_odds=odds)
    estimated, places = kept.only(proven)
    if len(estimated.blocks) == len(problem.blocks):
        return state
    scales = likely_scales(normalised(log_weight), grid)
    unknowns = np.zeros(kept.size)
    unknowns[places] = most_probable_with_field(
        estimated, system.moved(estimated, state.unknowns[places]), scales
    ).unknowns
    return replace(state, unknowns=unknowns, scales=scales)


def proven_blocks(
    problem: FitProblem, sums: FieldSums, grid: HyperparameterGrid
) -> tuple[set[str], FloatArray, dict[str, float]]:
    """Return the names of the shared errors without which the sightings are far less probable.

    Beside the stars of a night, those that stars show count as proven. One is added at a time, the most probable first.

    Returns
    -------
    The names, the log weights (i, j, k) of the scales with these errors alone, and the log odds of each block.
    """
    proven = set(SHOWN_BY_STARS & problem.names) if "night_pose" in problem.names else set[str]()
    log_weight, odds = sums.only(problem.only(proven)[1]).log_weights(grid), dict[str, float]()
    while others := sorted(problem.names - proven):
        tried = {name: sums.only(problem.only({*proven, name})[1]).log_weights(grid) for name in others}
        odds |= {name: log_evidence(one) - log_evidence(log_weight) for name, one in tried.items()}
        best = max(others, key=lambda name: (proves(name, odds[name]), odds[name]))
        if not proves(best, odds[best]):
            break
        proven.add(best)
        log_weight = tried[best]
    return proven, log_weight, odds


# How much of the noise of each star the fit has taken up: with a field the residuals of 150 stars are too small.

_LARGEST = 0.8
"""Of a star that stands alone; beyond it the residual says nothing of the noise."""


def compute_leverage(
    system: LinearSystem, normal: NormalEquations, fit: MarginalFit, scales: PriorScales, *, which: BoolArray
) -> FloatArray:
    """Return (b,): the share of its noise's variance that the fit has taken up, of some bins; else 0.

    The variance of a residual is that of the noise less that of the prediction, with the sighting among its data.

    Parameters
    ----------
    system, normal : the bins' equations, with systematic errors, and their sums.
    fit : the fit under the scales.
    which : (b,) bins.
    """
    variance = prediction_variance(
        fit, scales, system.basis, rows=system.rows[which], basis_values=system.basis_values[which], normal=normal
    )
    leverage = np.zeros(which.size)
    # the trace is of two axes
    leverage[which] = np.clip(0.5 * variance * system.observed.information[which], 0.0, _LARGEST)
    return leverage


def fit_robustly(
    observed: Sightings, cameras: list[Camera], options: CalibrationOptions, circle: ImageCircle | None
) -> FitState:
    """Return the fit of all sightings from the answer of the coarse search.

    Parameters
    ----------
    observed : sightings, in the order of time within each epoch.
    cameras : of the coarse search, one an epoch; other starts are tried as well.
    options : floor of the field, and tolerances of the lens.
    circle : the image circle, where it is known.
    """
    problem = single_problem(observed, cameras[0], options, circle, n_epochs=len(cameras))
    groups = NoiseGroups.of(observed)
    fit = _fit_with_lens_prior(problem, observed, problem.unknowns(cameras), groups, options)
    if not proves(PIXELS, fit.block_odds.get(PIXELS, 0.0)):
        return fit
    wide = replace(problem, prior=free_pixel_aspect(problem.prior))
    start = wide.unknowns([fit.problem.camera(fit.unknowns, epoch) for epoch in range(problem.n_epochs)])
    start[STRETCH] += fit.unknowns[fit.problem.block_slice(PIXELS)]
    again = _fit_with_lens_prior(wide, observed, start, groups, options)
    return replace(again, block_odds={**again.block_odds, PIXELS: fit.block_odds[PIXELS]})


def _fit_with_lens_prior(
    problem: FitProblem, observed: Sightings, start: FloatArray, groups: NoiseGroups, options: CalibrationOptions
) -> FitState:
    """Return the fit with the lens's prior as it is."""
    grid = make_hyperparameter_grid(problem.template, options)
    # first without a field: the best of several starts
    precision = prior_precision(problem.size, LOOSE_RADIAL_PX, LOOSE_DECENTERING_PX)
    at = best_start(problem, observed, start, precision=precision)
    residuals = problem.residuals(at, observed)
    share = surely_well_behaved(len(observed), problem.size)
    sigma = robust_sigma(distance_sigmas(problem, observed, at), share=share, floor=SMALLEST_SIGMA_PX)
    information = information_of(residuals, observed, sigma)
    means = groups.bins.observations(observed, problem, at, information=information)
    deepest = solve_from_starts(problem, means, at, precision=precision)
    plain = lowest(problem, observed, [at, deepest], precision=precision)
    problem, observed = add_effects(problem, plain, observed, outwards_px=options.outwards_px)
    return robust_rounds(problem, observed, plain, groups=groups, grid=grid)


def make_hyperparameter_grid(template: Camera, options: CalibrationOptions) -> HyperparameterGrid:
    """Return the scales that are tried for a camera's image."""
    return scale_grid(
        width=template.width,
        height=template.height,
        floor_px=options.field_floor_px,
        radial_px=options.tolerances.radial_px,
        decentering_px=options.tolerances.decentering_px,
        square_odds=options.tolerances.square_odds,
    )


# How much more probable the sightings are with each part of the lens model than without it.

_PARTS = {"skew": slice(Whitened.SKEW, Whitened.SKEW + 1), "radial": RADIAL, "decentering": DECENTERING}

_MENTIONED = math.log(3.0)
"""Log odds below which a difference is "not worth more than a bare mention" (Kass and Raftery 1995)."""


def part_log_odds(normal: NormalEquations, basis: WaveBasis, scales: PriorScales) -> dict[str, float]:
    """Return the log odds, natural and at even ones before, of each part of the lens model against its being zero.

    Parameters
    ----------
    normal : the equations about the fit.
    basis, scales : of the fit.

    Returns
    -------
    `skew`, `radial` (k2 … k9 of the projection) and `decentering` (p1 and p2). `radial_terms` is how many of the
    eight shapes of the radial distortion, the largest first, are needed: the odds of all others are below 3 to 1.

    Notes
    -----
    The ratio of Savage and Dickey (J. Dickey, Annals of Mathematical Statistics 42, 1971): for a nested model the
    Bayes factor is the posterior density of the part at zero over the prior's, all else integrated out. Both densities
    are taken as Gaussian, at the scales of the fit.
    """
    fit = marginal_fit(normal, basis, scales)
    precision = normal.prior_precision(scales.radial_px, scales.decentering_px)
    odds = {name: log_bayes_factor(fit, precision, np.arange(part.start, part.stop)) for name, part in _PARTS.items()}
    return {**odds, "radial_terms": float(_count_radial_terms(fit, precision))}


def log_bayes_factor(fit: MarginalFit, precision: FloatArray, part: IntArray) -> float:
    """Return the log Bayes factor of unknowns (k,) being free, of prior precisions (p,), against their being zero."""
    mean, covariance = fit.unknowns[part], fit.covariance[np.ix_(part, part)]
    sharpness = np.linalg.slogdet(covariance)[1] + float(np.sum(np.log(precision[part])))
    return float(0.5 * (mean @ np.linalg.solve(covariance, mean) + sharpness))


def _count_radial_terms(fit: MarginalFit, precision: FloatArray) -> int:
    """Return the least number of radial shapes beyond which the odds of all others together are below 3 to 1."""
    # the last column of the prior's basis is its largest shape
    for count in range(RADIAL.stop - RADIAL.start):
        others = np.arange(RADIAL.start, RADIAL.stop - count)
        if not log_bayes_factor(fit, precision, others) > _MENTIONED:
            return count
    return RADIAL.stop - RADIAL.start
