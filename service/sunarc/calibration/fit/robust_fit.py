"""The service's method: directions, priors, a redescending loss, and a field for what the model cannot say.

Errors that many sightings share are blocks of unknowns, see `effects`. Where the sightings do not prove one, the camera
is the one that fits without it: what it may change is then in the covariance alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from sunarc.calibration.fit.effects import PIXELS, with_effects
from sunarc.calibration.fit.marginal_likelihood import (
    HyperparameterGrid,
    MarginalFit,
    NormalEquations,
    Scales,
    marginal_fit,
    prior_precision,
    scale_grid,
)
from sunarc.calibration.fit.normal_equations import LinearSystem
from sunarc.calibration.fit.posterior import PosteriorCovariance, stated_posterior
from sunarc.calibration.fit.robust_rounds import LOOSE_DECENTERING_PX, LOOSE_RADIAL_PX, robust_camera
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle
from sunarc.calibration.model.result import probability, proves
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.noise import Noise, NoiseGroups
from sunarc.calibration.solve.levenberg_marquardt import information as information_of
from sunarc.calibration.solve.priors import DECENTERING, RADIAL, STRETCH, Whitened, with_wide_pixels
from sunarc.calibration.solve.problem import FitProblem
from sunarc.calibration.start.initial_guess import single_problem
from sunarc.calibration.start.multistart import SMALLEST_SIGMA_PX, best_of_starts, best_start, distance_sigmas, lowest
from sunarc.common.array_types import FloatArray, IntArray
from sunarc.common.robust_statistics import robust_sigma, surely_well_behaved
from sunarc.optics.camera import Camera
from sunarc.optics.displacement import WaveBasis


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
    grid = grid_of(problem.template, options)
    groups = NoiseGroups.of(observed)
    fit = _fitted(problem, observed, problem.unknowns(cameras), groups, grid)
    if not proves(PIXELS, fit.log_odds.get(PIXELS, 0.0)):
        return fit
    wide = replace(problem, prior=with_wide_pixels(problem.prior))
    start = wide.unknowns([fit.problem.camera(fit.unknowns, epoch) for epoch in range(problem.n_epochs)])
    start[STRETCH] += fit.unknowns[fit.problem.block_slice(PIXELS)]
    again = _fitted(wide, observed, start, groups, grid)
    return replace(again, log_odds={**again.log_odds, PIXELS: fit.log_odds[PIXELS]})


def _fitted(
    problem: FitProblem, observed: Sightings, start: FloatArray, groups: NoiseGroups, grid: HyperparameterGrid
) -> RobustFit:
    """Return the fit with the lens's prior as it is."""
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
    problem, observed = with_effects(problem, plain, observed)
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
