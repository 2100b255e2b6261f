"""Which of the five projections a lens has, where none is named: by the evidence of the sightings.

Every projection is fitted, and the fits are compared by their log evidence: over lens and pose (Laplace's
approximation), over the scales of the residual distortion, and over those of the field. All are looked at with the
noise and the weights of one fit, that of the lowest robust cost, else each would have a likelihood of its own.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sunarc.calibration.calibrate import Start, calibration_of, most_plausible_start, robust_fit
from sunarc.calibration.changes.change_points import Moved, calibrate_moved
from sunarc.calibration.fit.assemble import Job
from sunarc.calibration.fit.marginal_likelihood import STRONG_EVIDENCE, log_evidence, log_weights
from sunarc.calibration.fit.normal_equations import linear_system
from sunarc.calibration.fit.robust_fit import RobustFit
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle
from sunarc.calibration.model.result import Verdict
from sunarc.calibration.model.sightings import Sightings, filter_sightings
from sunarc.calibration.quality.fit_checks import before_fit, missing_hours
from sunarc.calibration.robust_loss import robust_sigma, tukey_loss
from sunarc.calibration.solve.problem import observations, time_bins
from sunarc.calibration.start.multistart import SMALLEST_SIGMA_PX, distance_sigmas
from sunarc.findings import Finding
from sunarc.optics.projections import PROJECTIONS, Projection
from sunarc.sky.site import Site

_IMPOSSIBLE = -1e4
"""Log evidence below which the odds are not given any more."""
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


class _Fit(NamedTuple):
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
    job = _job(points, site, image_size, options, circle)
    fits = _fits(job)
    choice = _choice(fits, job)
    finding, options = choice.finding, replace(options, projection=choice.projection)
    solved = None
    if fits and options.method == "robust":
        of_lens = fits[choice.projection]
        solved = calibration_of(of_lens.fit, job._replace(options=options, parts=True), of_lens.start)
    moved = calibrate_moved(points, site=site, image_size=image_size, options=options, circle=circle, solved=solved)
    verdict = moved.calibration.verdict
    if finding.code == "projection_ambiguous" and verdict.accepted:
        hours = missing_hours(job.usable, site)
        verdict = Verdict(accepted=False, findings=(finding, *hours))
    elif choice.compared:
        verdict = replace(verdict, findings=(*verdict.findings, finding))
    return moved._replace(calibration=replace(moved.calibration, verdict=verdict))


def choose_projection(
    points: Sightings,
    *,
    site: Site,
    image_size: tuple[int, int],
    options: CalibrationOptions,
    circle: ImageCircle | None = None,
) -> ProjectionChoice:
    """Return the projection that the sightings make most probable, all five being as probable before them.

    Parameters
    ----------
    points, site, image_size, options, circle : as `calibrate` takes them; the options' projection is what is returned
        where no fit is possible.
    """
    job = _job(points, site, image_size, options, circle)
    return _choice(_fits(job), job)


def _job(
    points: Sightings, site: Site, image_size: tuple[int, int], options: CalibrationOptions, circle: ImageCircle | None
) -> Job:
    usable = filter_sightings(points, site=site, image_size=image_size)
    return Job(points=points, usable=usable, site=site, image_size=image_size, options=options, circle=circle)


def _fits(job: Job) -> dict[Projection, _Fit]:
    """Return the fit with each projection; none where none is possible."""
    fits: dict[Projection, _Fit] = {}
    if before_fit(job.usable, job.options):
        return fits
    observed = observations(job.usable)
    for projection in PROJECTIONS:
        one = job._replace(options=replace(job.options, projection=projection))
        start = most_plausible_start(observed, one)
        if start is not None:
            fits[projection] = _Fit(start, robust_fit(observed, one, start.cameras))
    return fits


def _choice(fits: dict[Projection, _Fit], job: Job) -> ProjectionChoice:
    """Return the most probable of some projections that were fitted."""
    found = {name: one.fit for name, one in fits.items()}
    evidence = _log_evidences(found, observations(job.usable), job.usable) if fits else {job.options.projection: 0.0}
    best = max(evidence, key=lambda name: evidence[name])
    relative = {name: evidence.get(name, -math.inf) - evidence[best] for name in PROJECTIONS}
    return ProjectionChoice(best, relative, len(job.usable))


def _log_evidences(
    fits: dict[Projection, RobustFit], observed: Sightings, usable: Sightings
) -> dict[Projection, float]:
    """Return the log evidence of each, but for a constant."""
    distances = {name: distance_sigmas(fit.problem, observed, fit.unknowns) for name, fit in fits.items()}
    sigma = min(robust_sigma(distance, floor=SMALLEST_SIGMA_PX) for distance in distances.values())
    costs = {name: float(np.sum(tukey_loss(distance, sigma=sigma))) for name, distance in distances.items()}
    reference = fits[min(costs, key=lambda name: costs[name])]
    bins = time_bins(usable)
    systems = {
        name: linear_system(
            fit.problem, observed, bins, fit.unknowns, information=reference.information, basis=reference.grid.basis
        )
        for name, fit in fits.items()
    }
    return {name: log_evidence(log_weights(system.normal(), fits[name].grid)) for name, system in systems.items()}
