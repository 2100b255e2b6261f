"""Which of the five projections a lens has, where none is named: by the evidence of the sightings.

Cameras are compared by their log evidence: over lens and pose (Laplace's approximation), over the scales of the
residual distortion, and over those of the field. All are looked at with the noise and the weights of one of them, that
of the lowest robust cost, else each would have a likelihood of its own. The start with each projection is looked at
first; the two most probable ones, and what comes near them, are fitted, and looked at again.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.answers.covariance import seen_sky, sigma_deg
from sunarc.calibration.calibrate import Start, calibration_of, most_plausible_start
from sunarc.calibration.change_points import Moved, calibrate_moved
from sunarc.calibration.fit.assemble import Job
from sunarc.calibration.fit.marginal_likelihood import (
    HyperparameterGrid,
    log_evidence,
    log_weights,
)
from sunarc.calibration.fit.normal_equations import linear_system
from sunarc.calibration.fit.robust_fit import RobustFit, fit_robustly, grid_of
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle
from sunarc.calibration.model.result import STRONG_EVIDENCE, Calibration, Verdict
from sunarc.calibration.model.sightings import Sightings, filter_sightings
from sunarc.calibration.noise import NoiseGroups, measured_noise
from sunarc.calibration.quality.fit_checks import before_fit, determined
from sunarc.calibration.quality.widening import with_larger_errors
from sunarc.calibration.solve.problem import Bins, FitProblem
from sunarc.calibration.start.initial_guess import single_problem
from sunarc.calibration.start.multistart import SMALLEST_SIGMA_PX, distance_sigmas
from sunarc.findings import Finding
from sunarc.optics.forward import project
from sunarc.optics.inverse import unproject
from sunarc.optics.projections import PROJECTIONS, Projection
from sunarc.robust_statistics import robust_sigma, tukey_loss
from sunarc.sky.directions import angular_distance
from sunarc.sky.site import Site

_IMPOSSIBLE = -1e4
"""Log evidence below which the odds are not given any more."""
_NEAR = 20.0
"""Log evidence at the start, beside the best, within which a projection is fitted. Of 200 it rose by 44 at most by the
fit, and never changed which one is the best."""
_POSSIBLE = 10.0
"""Log evidence beside the best's within which a projection is possible where sightings do not decide."""
_FEWEST = 60
"""Usable sightings that a choice needs: of 35, a third of them drawn aside by cloud, a wrong lens was made by far the
most probable one."""


class ProjectionChoice(NamedTuple):
    """The most probable projection, and the log evidence of each over its: 0 for itself, negative for the others.

    `n` is the number of sightings that were looked at.
    """

    projection: Projection
    log_evidence: dict[Projection, float]
    n: int

    @property
    def compared(self) -> bool:
        """Whether two projections or more could be fitted."""
        return sum(math.isfinite(value) for value in self.log_evidence.values()) > 1

    @property
    def finding(self) -> Finding:
        """How far the sightings decide: `projection_chosen` or `projection_ambiguous`, with the next best one."""
        others = {name: value for name, value in self.log_evidence.items() if name != self.projection}
        name = max(others, key=lambda one: others[one])
        decided = self.n >= _FEWEST and others[name] < -STRONG_EVIDENCE
        return Finding(
            "projection_chosen" if decided else "projection_ambiguous",
            {
                "projection": self.projection,
                "next": name,
                "log10_odds": -max(others[name], _IMPOSSIBLE) / math.log(10.0),
                "n": self.n,
                "least": _FEWEST,
                "least_log10_odds": STRONG_EVIDENCE / math.log(10.0),
            },
        )


class _Lens(NamedTuple):
    """A camera about which the evidence is looked at, what it was found from, and the scales that are tried."""

    problem: FitProblem
    observed: Sightings
    unknowns: FloatArray
    grid: HyperparameterGrid


class Fitted(NamedTuple):
    """The fit with one projection, and where it began."""

    start: Start
    fit: RobustFit


def calibrate_unknown_lens(
    points: Sightings,
    *,
    site: Site,
    image_size: tuple[int, int],
    options: CalibrationOptions,
    circle: ImageCircle | None = None,
) -> Moved:
    """Return what `calibrate_moved` does with the most probable projection, and its verdict with the choice.

    Where the sightings do not decide, the fit is refused: two lenses that meet the sun's track alike differ elsewhere.

    Parameters
    ----------
    points, site, image_size, options, circle : as `calibrate_moved` takes them; the options' projection has no effect.
    """
    usable = filter_sightings(points, site=site, image_size=image_size)
    job = Job(points=points, usable=usable, site=site, image_size=image_size, options=options, circle=circle)
    choice, fits = compare_projections(job)
    finding, options = choice.finding, replace(options, projection=choice.projection)
    solved = None
    if fits and options.method == "robust":
        of_lens = fits[choice.projection]
        solved = calibration_of(of_lens.fit, job._replace(options=options, parts=True), of_lens.start), usable
    moved = calibrate_moved(points, site=site, image_size=image_size, options=options, circle=circle, solved=solved)
    if finding.code == "projection_ambiguous":
        moved = moved._replace(calibration=_with_others(moved.calibration, choice, fits))
    verdict = moved.calibration.verdict
    if finding.code == "projection_ambiguous" and verdict.accepted:
        verdict = Verdict(accepted=False, findings=(finding, *determined(moved.calibration, job.usable)))
    elif choice.compared:
        verdict = replace(verdict, findings=(*verdict.findings, finding))
    return moved._replace(calibration=replace(moved.calibration, verdict=verdict))


def _with_others(calibration: Calibration, choice: ProjectionChoice, fits: dict[Projection, Fitted]) -> Calibration:
    """Return a calibration whose uncertainty holds its mean square distance to the fits with other projections, too.

    Those that are not out of the question count alike: few sightings do not weigh them.
    """
    directions = seen_sky(calibration.camera)
    sigma, squares = sigma_deg(calibration, directions), [0.0]
    for name, fitted in fits.items():
        if name != choice.projection and choice.log_evidence[name] > -_POSSIBLE:
            other = fitted.fit.problem.camera(fitted.fit.unknowns)
            off = angular_distance(unproject(calibration.camera, project(other, directions)), directions)
            square = 0.5 * (np.degrees(off) / sigma) ** 2
            squares.append(float(np.mean(square[np.isfinite(square)])) if np.any(np.isfinite(square)) else 0.0)
    factor = math.sqrt(1.0 + float(np.mean(squares)))
    return with_larger_errors(calibration, factor) if factor > 1.0 else calibration


def compare_projections(job: Job) -> tuple[ProjectionChoice, dict[Projection, Fitted]]:
    """Return the projection that the sightings make most probable, all five being as probable before them, and fits.

    The job's projection has no effect but where no fit is possible: it is then the answer. The fits are those with the
    most probable projections.
    """
    observed, groups = job.usable, NoiseGroups.of(job.usable)
    jobs = {name: job._replace(options=replace(job.options, projection=name)) for name in PROJECTIONS}
    tried = {} if before_fit(job.usable, job.options) else {n: most_plausible_start(jobs[n]) for n in jobs}
    starts = {name: start for name, start in tried.items() if start is not None}
    if not starts:
        return _choice({job.options.projection: 0.0}, len(observed)), {}
    lenses: dict[Projection, _Lens] = {}
    for name, (cameras, _, _) in starts.items():
        options = jobs[name].options
        problem = single_problem(observed, cameras[0], options, job.circle, n_epochs=len(cameras))
        lenses[name] = _Lens(problem, observed, problem.unknowns(cameras), grid_of(problem.template, options))
    best = lenses[_closest(lenses)]
    noise = measured_noise(best.problem.residuals(best.unknowns, observed), observed, groups)
    rough = _log_evidences(lenses, groups.bins, noise.information(observed))
    order = sorted(rough, key=lambda name: -rough[name])
    near = [name for k, name in enumerate(order) if k < 2 or rough[name] > -_NEAR]
    fits = {
        name: Fitted(starts[name], fit_robustly(observed, starts[name].cameras, jobs[name].options, job.circle))
        for name in near
    }
    lenses = {n: _Lens(one.fit.problem, one.fit.observed, one.fit.unknowns, one.fit.grid) for n, one in fits.items()}
    closest = fits[_closest(lenses)].fit
    exact = _log_evidences(lenses, groups.bins, closest.noise.information(closest.observed))
    return _choice({**rough, **exact}, len(observed)), fits


def _choice(evidence: dict[Projection, float], n: int) -> ProjectionChoice:
    best = max(evidence, key=lambda name: evidence[name])
    return ProjectionChoice(best, {name: evidence.get(name, -math.inf) for name in PROJECTIONS}, n)


def _closest(lenses: dict[Projection, _Lens]) -> Projection:
    """Return the one of the lowest robust cost, at one scale for all."""
    distances = {name: distance_sigmas(one.problem, one.observed, one.unknowns) for name, one in lenses.items()}
    sigma = min(robust_sigma(distance, floor=SMALLEST_SIGMA_PX) for distance in distances.values())
    return min(distances, key=lambda name: float(np.sum(tukey_loss(distances[name], sigma=sigma))))


@np.errstate(invalid="ignore", over="ignore")
def _log_evidences(lenses: dict[Projection, _Lens], bins: Bins, information: FloatArray) -> dict[Projection, float]:
    """Return the log evidence of each over the best's, the sightings of some information (n,), px⁻²."""
    found: dict[Projection, float] = {}
    for name, (problem, observed, at, grid) in lenses.items():
        system = linear_system(problem, observed, bins, at, information=information, basis=grid.basis)
        value = log_evidence(log_weights(system.normal(), grid))
        found[name] = -math.inf if math.isnan(value) else value  # a camera may miss the sightings by 1e11 px
    return {name: value - max(found.values()) for name, value in found.items()}
