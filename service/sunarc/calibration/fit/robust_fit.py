"""Robust fit: directions, priors, a redescending loss, and a field for the errors that the model does not have.

Each round weighs the sightings by the residuals of the last one, gathers them into bins, finds the most probable
scales, and solves with the field marginalised. The first round lets the field be large, so that the noise is measured
from residuals that no smooth error explains. The field may not cost the camera the sightings.

Errors that many sightings share are blocks of unknowns, see `effects`. Where the sightings do not prove one, the camera
is the one that fits without it: its possible effect is then in the covariance alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from sunarc.calibration.fit.effects import PIXELS, POSSIBLE, SEASONS, SHOWN_BY_STARS, SWAYS, with_effects
from sunarc.calibration.fit.marginal_likelihood import (
    FieldSums,
    HyperparameterGrid,
    MarginalFit,
    NormalEquations,
    Scales,
    field_at,
    field_sums,
    likely_scales,
    log_evidence,
    log_odds_of_a_field,
    log_weights,
    marginal_fit,
    normalised,
    prior_precision,
    scale_grid,
)
from sunarc.calibration.fit.normal_equations import LinearSystem, linear_system, most_probable_with_field, system_about
from sunarc.calibration.fit.posterior import PosteriorCovariance, prediction_variance, stated_posterior
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle
from sunarc.calibration.model.result import STRONG_EVIDENCE, probability, proves, suspects
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.noise import Noise, NoiseGroups, measured_noise
from sunarc.calibration.solve.levenberg_marquardt import information as information_of
from sunarc.calibration.solve.priors import DECENTERING, RADIAL, STRETCH, Whitened, with_wide_pixels
from sunarc.calibration.solve.problem import Bins, FitProblem
from sunarc.calibration.start import multistart
from sunarc.calibration.start.initial_guess import single_problem
from sunarc.calibration.start.multistart import SMALLEST_SIGMA_PX, best_of_starts, best_start, distance_sigmas, lowest
from sunarc.common.array_types import BoolArray, FloatArray, IntArray
from sunarc.common.robust_statistics import (
    CUT,
    counted_roots,
    is_shown,
    robust_sigma,
    surely_well_behaved,
    tukey_loss,
)
from sunarc.optics.camera import Camera
from sunarc.optics.displacement import WaveBasis

# How well a fit must meet the sightings, by another one: a field, or a prior of a type of lens, may not cost the data.

_SCALES = (0.7, 1.0, 1.4)
"""The cost is compared at these multiples of the noise: a fit must not win by the choice of its scale."""
LENS_MISFIT_PX = 1.0
"""px per axis; lenses are not as modelled by tenths of px, the paper's own by 0.5 to 1.2. A field that takes more from
the camera has taken over what its parameters explain."""
FIELD_EXCESS = 2.0
"""Root mean square along the sun's way over the amplitude of a field. With a kernel k there are 2 / mean(k²)
independent parts there, both components counted: four of a field of 0.36 of the image, nine of one of 0.16, on a day as
on several. 99 % of the chi-squares of four are below 3.3 times their mean, that is 1.8 times the amplitude, and that is
itself estimated."""
_MEDIAN_OF_SIGMA = math.sqrt(2.0 * math.log(2.0))
"""Median distance of a round Gaussian over its 1-sigma per axis."""
_FINEST = 0.9


class AllowedLevel(NamedTuple):
    """How well sightings must be met.

    scales, costs (3,): scales of the loss, px, and the largest robust cost at each. median: the largest one, px.
    """

    scales: FloatArray
    costs: FloatArray
    median: float

    def reached_by(self, distance: FloatArray) -> bool:
        """Return whether distances (n,) between seen and modelled pixels, px, are as small."""
        return bool(np.all(_costs(distance, self.scales) <= self.costs) and np.median(distance) <= self.median)


def allowed_level(
    distance: FloatArray,
    *,
    sigma: float,
    field_px: float,
    weight: float = 1.0,
    cost_ratio: float,
    median_ratio: float = math.inf,
) -> AllowedLevel:
    """Return the level that a fit must reach beside another one that met the sightings at some distances.

    Parameters
    ----------
    distance : (n,) of the other one, px.
    sigma : px, the noise.
    field_px : 1-sigma of what no lens explains, as the data speak for it: the camera may miss them by `FIELD_EXCESS`
        times as much, `LENS_MISFIT_PX` of it counted at most.
    weight : what a px counts in the distances, see `finest_weight`.
    cost_ratio, median_ratio : by how much cost and median may be larger without a field.
    """
    missed = weight * FIELD_EXCESS * min(field_px, LENS_MISFIT_PX)
    scales = math.hypot(sigma, missed) * np.array(_SCALES)
    counted = float(np.sum(distance < CUT * scales[1]))
    costs = cost_ratio * _costs(distance, scales) + counted * (missed / scales) ** 2
    return AllowedLevel(scales, costs, math.hypot(median_ratio * float(np.median(distance)), _MEDIAN_OF_SIGMA * missed))


def finest_weight(observed: Sightings) -> float:
    """Return what a px counts in the weighted distances of the finest sightings: a field moves them as others.

    Beside 5,000 stars of 0.2 px a sun of 0.03 px counts six times, and so does what a field moves it by.
    """
    return float(np.quantile(np.sqrt(observed.information), _FINEST))


def _costs(distance: FloatArray, scales: FloatArray) -> FloatArray:
    """Return the robust costs (s,) of distances (n,) at scales (s,), px."""
    return np.array([float(np.sum(tukey_loss(distance, sigma=float(scale)))) for scale in scales])


_ROUNDS = 5
_FIRST_FIELD_PX = 1.0
LOOSE_RADIAL_PX = 16.0
LOOSE_DECENTERING_PX = 3.0
_FIELD_MAY_COST = 1.1
"""Robust cost with a field over that without: priors and correlated noise make it 1.04 at most where all is well."""
_FIELD_SHRINKS = 0.25
_FEW_PER_UNKNOWN = 5
"""Sightings for each unknown below which the fit has taken up more of their noise than can be passed over."""
_FIELD_BOUNDS = 4
"""How often the largest field is made smaller; 1 px is 0.004 px then, the floor's size."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoundState:
    """Where the rounds stand, the log odds of a field, and what the last round gained in twice the log posterior.

    leverage : (n,) see `leverage_of`. block_odds: log odds of each shared error.
    """

    unknowns: FloatArray
    residuals: FloatArray
    scales: Scales
    field_odds: float = -math.inf
    gain: float = math.inf
    leverage: FloatArray | None = None
    block_odds: dict[str, float] = field(default_factory=dict)

    @property
    def proven_field_px(self) -> float:
        """The field's 1-sigma where the sightings prove one, else 0."""
        return self.scales.amplitude_px if self.field_odds > STRONG_EVIDENCE else 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobustCamera:
    """The camera of a robust fit, and all that its uncertainty follows from.

    Attributes
    ----------
    problem : of the fit.
    unknowns : (p,) the most probable ones.
    state, noise : as the last round left them.
    grid : the scales that were tried.
    last_round : the bins' equations of the last round.
    """

    problem: FitProblem
    unknowns: FloatArray
    state: RoundState
    noise: Noise
    grid: HyperparameterGrid
    last_round: LinearSystem

    def system(self, observed: Sightings, bins: Bins) -> LinearSystem:
        """Return the bins' equations about the camera."""
        weighed = replace(observed, information=self.noise.information(observed))
        return system_about(self.problem, weighed, bins, self.last_round, self.unknowns)

    def field_mean(self, normal: NormalEquations) -> FloatArray | None:
        """Return the field's coefficients (2, m) by the sums about the camera; None where none is more probable."""
        return field_at(normal, self.grid.basis, self.state.scales) if self.state.field_odds > 0.0 else None


def robust_camera(
    problem: FitProblem,
    observed: Sightings,
    plain: FloatArray,
    *,
    groups: NoiseGroups,
    grid: HyperparameterGrid,
) -> RobustCamera:
    """Return the fit beside a field from the robust fit without one.

    Parameters
    ----------
    problem : the camera sought, with the blocks of what the sightings share.
    observed : sightings, in the order of time within each epoch.
    plain : unknowns of the fit without a field, those of the blocks apart.
    groups : of the sightings.
    grid : scales to try.
    """
    plain = np.concatenate([plain, np.zeros(problem.n_unit)])
    for name in sorted(problem.names & {*SEASONS, SWAYS}):
        plain = _begun(problem, observed, plain, name)
    state, noise, grid, last_round = _with_field(problem, observed, plain, grid, groups)
    informed = replace(observed, information=noise.information(observed))
    problem, state = _with_proven(problem, informed, groups.bins, last_round, state, grid)
    unknowns = state.unknowns
    # weighed before the camera's last step, which may bring the edge of what it shows past a low sun
    shown = is_shown(problem.residuals(unknowns, observed))
    return RobustCamera(
        problem=problem,
        unknowns=unknowns,
        state=state,
        noise=replace(noise, weight=noise.weight * shown),
        grid=grid,
        last_round=last_round,
    )


def _begun(problem: FitProblem, observed: Sightings, unknowns: FloatArray, name: str) -> FloatArray:
    """Return unknowns with a block as it seems to be by the residuals.

    Where the rounds begin without, residuals that are alike for a day or a season are noise that hides the block.
    """
    of_block = problem.block_slice(name)
    distance = multistart.distance_sigmas(problem, observed, unknowns)
    root = counted_roots(distance, observed.information, floor=multistart.SMALLEST_SIGMA_PX)
    columns = problem.linearised(unknowns, observed)[1][:, :, of_block] * root[:, None, None]
    left = problem.residuals(unknowns, observed) * root[:, None]
    products = np.einsum("nap,naq->pq", columns, columns, optimize=True) + np.eye(columns.shape[2])
    begun = unknowns.copy()
    begun[of_block] = np.linalg.solve(products, np.einsum("nap,na->p", columns, left, optimize=True))
    return begun


def _with_field(
    problem: FitProblem, observed: Sightings, plain: FloatArray, grid: HyperparameterGrid, groups: NoiseGroups
) -> tuple[RoundState, Noise, HyperparameterGrid, LinearSystem]:
    """Return the rounds' answer, the grid of scales that it took, and the last round's equations.

    The mean of a field that is more probable than none is part of the prediction (decision 0008). One that lets the
    camera itself miss the sightings has taken over what the lens's parameters explain: it is bounded more tightly, and
    the rounds begin again.
    """
    distance = multistart.distance_sigmas(problem, observed, plain)
    share = surely_well_behaved(len(observed), problem.size - problem.n_unit)
    sigma, weight = robust_sigma(distance, share=share, floor=multistart.SMALLEST_SIGMA_PX), finest_weight(observed)
    state, noise, system = _rounds(problem, observed, plain, grid, groups)
    for _ in range(_FIELD_BOUNDS):
        level = allowed_level(
            distance, sigma=sigma, field_px=state.proven_field_px, weight=weight, cost_ratio=_FIELD_MAY_COST
        )
        if level.reached_by(multistart.distance_sigmas(problem, observed, state.unknowns)):
            break
        grid = grid.up_to(_FIELD_SHRINKS * state.scales.amplitude_px)
        state, noise, system = _rounds(problem, observed, plain, grid, groups)
    return state, noise, grid, system


def _rounds(
    problem: FitProblem, observed: Sightings, unknowns: FloatArray, grid: HyperparameterGrid, groups: NoiseGroups
) -> tuple[RoundState, Noise, LinearSystem]:
    first = Scales(_FIRST_FIELD_PX, float(grid.lengths[0]), LOOSE_RADIAL_PX, LOOSE_DECENTERING_PX)
    state = RoundState(unknowns=unknowns, residuals=problem.residuals(unknowns, observed), scales=first)
    noise, system = _round(problem, observed, state, grid, groups)
    state = _judged(problem, observed, system, state, groups.bins)
    for _ in range(1, _ROUNDS):
        noise, system = _round(problem, observed, state, grid, groups)
        state = _improved(problem, observed, system, grid, groups.bins)
        if state.gain <= 0.0:
            break  # where a round does not move the camera, a further one changes nothing
    return state, noise, system


def _round(
    problem: FitProblem, observed: Sightings, state: RoundState, grid: HyperparameterGrid, groups: NoiseGroups
) -> tuple[Noise, LinearSystem]:
    """Return the noise as a state shows it, and the equations with the sightings weighed by it."""
    noise = measured_noise(state.residuals, observed, groups, leverage=state.leverage)
    information = noise.information(observed)
    return noise, linear_system(
        problem, observed, groups.bins, state.unknowns, information=information, basis=grid.basis
    )


def _judged(
    problem: FitProblem, observed: Sightings, system: LinearSystem, state: RoundState, bins: Bins
) -> RoundState:
    """Return the state with what a large field beside the model leaves over; the camera stays."""
    marginal = marginal_fit(system.normal(), system.basis, state.scales)
    explained = system.rows @ (marginal.unknowns - system.at) + system.basis_values @ marginal.coefficients.T
    return replace(state, residuals=problem.residuals(state.unknowns, observed) - explained[bins.member])


def _improved(
    problem: FitProblem, observed: Sightings, system: LinearSystem, grid: HyperparameterGrid, bins: Bins
) -> RoundState:
    """Return the state after a solve with the scales that the data speak for."""
    log_weight = log_weights(system.normal(), grid)
    scales = likely_scales(normalised(log_weight), grid)
    found = most_probable_with_field(problem, system, scales)
    leverage = None
    few = len(observed) < _FEW_PER_UNKNOWN * (problem.size - problem.n_unit)
    if "night_pose" in problem.names or few:
        there = system.moved(problem, found.unknowns)
        which = few | np.any(there.rows[..., problem.block_slice("night_pose")] != 0.0, axis=(1, 2))
        leverage = leverage_of(there, there.normal(), found.fit, scales, which=which)[bins.member]
    unknowns, smooth = found.unknowns, (system.basis_values @ found.fit.coefficients.T)[bins.member]
    return RoundState(
        unknowns=unknowns,
        residuals=problem.residuals(unknowns, observed) - smooth,
        scales=scales,
        field_odds=log_odds_of_a_field(log_weight),
        gain=found.gain,
        leverage=leverage,
    )


def _with_proven(  # noqa: PLR0917 - the fit, piece by piece
    problem: FitProblem,
    observed: Sightings,
    bins: Bins,
    last_round: LinearSystem,
    state: RoundState,
    grid: HyperparameterGrid,
) -> tuple[FitProblem, RoundState]:
    """Return the problem with the shared errors that are possible, or that the sightings make so by their information.

    And the state with those that are not proven at 0.
    """
    system = system_about(problem, observed, bins, last_round, state.unknowns)
    proven, log_weight, odds = proven_blocks(problem, field_sums(system.normal(), grid), grid)
    suspected = {name for name, one in odds.items() if suspects(one)} - {PIXELS}  # these are of the lens's prior
    kept, places = problem.only(POSSIBLE | proven | suspected)
    state = replace(state, unknowns=state.unknowns[places], block_odds=odds)
    estimated, places = kept.only(proven)
    if len(estimated.blocks) == len(problem.blocks):
        return kept, state
    scales = likely_scales(normalised(log_weight), grid)
    unknowns = np.zeros(kept.size)
    unknowns[places] = most_probable_with_field(
        estimated, system.moved(estimated, state.unknowns[places]), scales
    ).unknowns
    return kept, replace(state, unknowns=unknowns, scales=scales)


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


# How much of the noise of each star the fit has taken up: beside a field the residuals of 150 stars are too small.

_LARGEST = 0.8
"""Of a star that stands alone; beyond it the residual says nothing of the noise."""


def leverage_of(
    system: LinearSystem, normal: NormalEquations, fit: MarginalFit, scales: Scales, *, which: BoolArray
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobustFit:
    """What the rounds came to.

    Attributes
    ----------
    observed : the sightings, with what the errors that they share displace them by.
    member : (n,) the bin of each.
    system : the bins' equations about the fit.
    unknowns : the most probable ones.
    posterior : their covariance and the field's part in it, over all plausible scales.
    scales : those of the fit, as found in the data.
    grid : the scales that were tried, and the field's basis functions.
    residual : (n, 2) observed minus modelled by the lens alone, px.
    field_mean : (2, m) coefficients of the most probable field; None where none is more probable.
    noise : of each sighting.
    log_odds : of the parts of the model, see `Provenance`.
    """

    problem: FitProblem
    observed: Sightings
    member: IntArray
    system: LinearSystem
    unknowns: FloatArray
    posterior: PosteriorCovariance
    scales: Scales
    grid: HyperparameterGrid
    residual: FloatArray
    field_mean: FloatArray | None
    noise: Noise
    log_odds: dict[str, float]


def fit_robustly(
    observed: Sightings, cameras: list[Camera], options: CalibrationOptions, circle: ImageCircle | None
) -> RobustFit:
    """Return the fit of all sightings from the answer of the coarse search.

    Parameters
    ----------
    observed : sightings, in the order of time within each epoch.
    cameras : of the coarse search, one an epoch; other starts are tried beside it.
    options : floor of the field, and tolerances of the lens.
    circle : the image circle, where it is known.
    """
    problem = single_problem(observed, cameras[0], options, circle, n_epochs=len(cameras))
    groups = NoiseGroups.of(observed)
    fit = _fitted(problem, observed, problem.unknowns(cameras), groups, options)
    if not proves(PIXELS, fit.log_odds.get(PIXELS, 0.0)):
        return fit
    wide = replace(problem, prior=with_wide_pixels(problem.prior))
    start = wide.unknowns([fit.problem.camera(fit.unknowns, epoch) for epoch in range(problem.n_epochs)])
    start[STRETCH] += fit.unknowns[fit.problem.block_slice(PIXELS)]
    again = _fitted(wide, observed, start, groups, options)
    return replace(again, log_odds={**again.log_odds, PIXELS: fit.log_odds[PIXELS]})


def _fitted(
    problem: FitProblem, observed: Sightings, start: FloatArray, groups: NoiseGroups, options: CalibrationOptions
) -> RobustFit:
    """Return the fit with the lens's prior as it is."""
    grid = grid_of(problem.template, options)
    # first without a field: the best of several starts
    precision = prior_precision(problem.size, LOOSE_RADIAL_PX, LOOSE_DECENTERING_PX)
    at = best_start(problem, observed, start, precision=precision)
    residuals = problem.residuals(at, observed)
    share = surely_well_behaved(len(observed), problem.size)
    sigma = robust_sigma(distance_sigmas(problem, observed, at), share=share, floor=SMALLEST_SIGMA_PX)
    information = information_of(residuals, observed, sigma)
    means = groups.bins.observations(observed, problem, at, information=information)
    deepest = best_of_starts(problem, means, at, precision=precision)
    plain = lowest(problem, observed, [at, deepest], precision=precision)
    problem, observed = with_effects(problem, plain, observed, outwards_px=options.outwards_px)
    found = robust_camera(problem, observed, plain, groups=groups, grid=grid)
    problem, unknowns, state = found.problem, found.unknowns, found.state
    system = found.system(observed, groups.bins)
    normal = system.normal()
    mean = found.field_mean(normal)
    # a field that was bounded for the camera's sake is possible all the same
    stretched = probability(state.block_odds.get(PIXELS, -math.inf))
    posterior = stated_posterior(
        problem, system, unknowns, grid=grid, scales=state.scales, mean=mean, stretched=stretched
    )
    return RobustFit(
        problem=problem,
        observed=observed,
        member=groups.bins.member,
        system=system,
        unknowns=unknowns,
        posterior=posterior,
        scales=state.scales,
        grid=grid,
        residual=problem.residuals(unknowns, observed),
        field_mean=mean,
        noise=found.noise,
        log_odds={**log_odds_of_parts(normal, grid.basis, state.scales), "field": state.field_odds, **state.block_odds},
    )


def grid_of(template: Camera, options: CalibrationOptions) -> HyperparameterGrid:
    """Return the scales that are tried for a camera's image."""
    return scale_grid(
        width=template.width,
        height=template.height,
        floor_px=options.field_floor_px,
        radial_px=options.tolerances.radial_px,
        decentering_px=options.tolerances.decentering_px,
    )


# How much more probable the sightings are with each part of the lens model than without it.

_PARTS = {"skew": slice(Whitened.SKEW, Whitened.SKEW + 1), "radial": RADIAL, "decentering": DECENTERING}

_MENTIONED = math.log(3.0)
"""Log odds below which a difference is "not worth more than a bare mention" (Kass and Raftery 1995)."""


def log_odds_of_parts(normal: NormalEquations, basis: WaveBasis, scales: Scales) -> dict[str, float]:
    """Return the log odds, natural and at even ones before, of each part of the lens model against its being zero.

    Parameters
    ----------
    normal : the equations about the fit.
    basis, scales : of the fit.

    Returns
    -------
    `skew`, `radial` (k2 … k9 beside the projection) and `decentering` (p1 and p2). `radial_terms` is how many of the
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
    return {**odds, "radial_terms": float(_radial_terms(fit, precision))}


def log_bayes_factor(fit: MarginalFit, precision: FloatArray, part: IntArray) -> float:
    """Return the log Bayes factor of unknowns (k,) being free, of prior precisions (p,), against their being zero."""
    mean, covariance = fit.unknowns[part], fit.covariance[np.ix_(part, part)]
    sharpness = np.linalg.slogdet(covariance)[1] + float(np.sum(np.log(precision[part])))
    return float(0.5 * (mean @ np.linalg.solve(covariance, mean) + sharpness))


def _radial_terms(fit: MarginalFit, precision: FloatArray) -> int:
    """Return the least number of radial shapes beyond which the odds of all others together are below 3 to 1."""
    # the last column of the prior's basis is its largest shape
    for count in range(RADIAL.stop - RADIAL.start):
        others = np.arange(RADIAL.start, RADIAL.stop - count)
        if not log_bayes_factor(fit, precision, others) > _MENTIONED:
            return count
    return RADIAL.stop - RADIAL.start
