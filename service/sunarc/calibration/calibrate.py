"""From sightings to a calibration: one, many of one geometry, or a stored one again."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.fit.assemble import Job, calibration_from_fit, refused, robust_outcome, tidied
from sunarc.calibration.fit.cross_validation import contradiction, without_night
from sunarc.calibration.fit.effects import with_effects
from sunarc.calibration.fit.marginal_likelihood import HyperparameterGrid, prior_precision
from sunarc.calibration.fit.robust_fit import RobustFit, fit_robustly, grid_of
from sunarc.calibration.fit.robust_rounds import robust_camera
from sunarc.calibration.model.options import (
    USUAL_OPTIONS,
    CalibrationOptions,
    ImageCircle,
    LensTolerances,
    Mirrored,
    PaperOptions,
)
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings, filter_sightings
from sunarc.calibration.noise import NoiseGroups
from sunarc.calibration.paper import fit_as_paper
from sunarc.calibration.quality.acceptance import with_pose_spread
from sunarc.calibration.quality.fit_checks import before_fit, below_horizon
from sunarc.calibration.robust_loss import robust_sigma
from sunarc.calibration.solve.levenberg_marquardt import information, most_probable
from sunarc.calibration.solve.priors import Whitened
from sunarc.calibration.solve.problem import FitProblem
from sunarc.calibration.start.initial_guess import first_cameras, level_camera, single_problem
from sunarc.calibration.start.multistart import SMALLEST_SIGMA_PX, distance_sigmas
from sunarc.errors import InputError
from sunarc.findings import Finding
from sunarc.optics.camera import Camera
from sunarc.sky.site import Site

_AMBIGUOUS = 3.0
"""Half squares by which one handedness must be the more plausible one."""
_BETTER = 10.0
"""Half squares by which the other handedness must be more plausible to be named as the cause of a refusal."""


class Start(NamedTuple):
    """First cameras, one an epoch, how implausible they are, in half squares, and whether the other hand is as much."""

    cameras: list[Camera]
    cost: float
    ambiguous: bool


def calibrate(
    points: Sightings,
    *,
    site: Site,
    image_size: tuple[int, int],
    options: CalibrationOptions = USUAL_OPTIONS,
    circle: ImageCircle | None = None,
    start: Camera | None = None,
    parts: bool = True,
) -> Calibration:
    """Fit a camera to sightings of the sun.

    Poor data give a calibration whose verdict is refused and says why; they never raise.

    Parameters
    ----------
    points : the sightings; several pose epochs share the lens, and the calibration is of the latest.
    site : where the camera stands.
    image_size : width and height, px.
    options : how to fit; the defaults are the service's.
    circle : the image circle, where it is known.
    start : a camera to start from, in place of a search.
    parts : whether parts of the sightings are held against the fit, and a refusal against the other handedness; one
        that is only compared with others needs it not.

    Raises
    ------
    InputError
        Where the image size is not a size.
    """
    if min(image_size) < 16:
        raise InputError(field="image size", problem=f"{image_size} px", remedy="give width and height in px")
    if start is not None:
        start = start.lens_alone()
        options = replace(options, projection=start.projection)
    usable = filter_sightings(points, site=site, image_size=image_size)
    job = Job(
        points=points,
        usable=usable,
        site=site,
        image_size=image_size,
        options=options,
        circle=circle,
        start=start,
        parts=parts,
    )
    return _calibrated(job)


def _calibrated(job: Job) -> Calibration:
    """Return the fit of a job; that of the day's sightings alone where those of the night would make it worse."""
    problems = before_fit(job.usable, job.options)
    if problems:
        return refused(job, problems)
    picked = most_plausible_start(job)
    if picked is None:
        against = (*below_horizon(job.usable, job.options), Finding("no_camera_fits"))
        return _explained(refused(job, against), job, math.inf)
    if job.options.method == "paper":
        by_paper = fit_as_paper(job.usable, picked.cameras, options=job.options)
        return _explained(calibration_from_fit(by_paper, job, ambiguous=picked.ambiguous), job, picked.cost)
    fit = fit_robustly(job.usable, picked.cameras, job.options, job.circle)
    return calibration_of(fit, job, picked)


def _explained(calibration: Calibration, job: Job, cost: float) -> Calibration:
    """Return a calibration; where it is refused and the other handedness is far more plausible, its verdict says so."""
    verdict, known = calibration.verdict, job.options.mirrored
    if verdict.accepted or known == "auto" or job.start is not None or not job.parts:
        return calibration
    other: Mirrored = "no" if known == "yes" else "yes"
    tried = most_plausible_start(job._replace(options=replace(job.options, mirrored=other)))
    if tried is None or cost - tried.cost < _BETTER:
        return calibration
    found = Finding("other_handedness_fits", {"mirrored": other, "stated": known})
    return replace(calibration, verdict=replace(verdict, findings=(found, *verdict.findings)))


def calibration_of(fit: RobustFit, job: Job, picked: Start) -> Calibration:
    """Return the calibration that a robust fit makes; that of the day alone where the night contradicts it."""
    found = contradiction(fit, job.usable)
    if found is not None:
        return _calibrated(job._replace(usable=without_night(job.usable, found)))
    outcome = robust_outcome(fit, job.usable, job.options, parts=job.parts)
    return _explained(calibration_from_fit(outcome, job, ambiguous=picked.ambiguous), job, picked.cost)


def most_plausible_start(job: Job) -> Start | None:
    """Return the start for the handedness that is set, or for the more plausible of both; None where none is found."""
    options = job.options
    both: tuple[Mirrored, Mirrored] = ("no", "yes")
    tried: tuple[Mirrored, ...] = both if options.mirrored == "auto" else (options.mirrored,)
    found = []
    for mirrored in tried:
        tried_options = replace(options, mirrored=mirrored)
        guess, known = job.start, True
        if guess is None or guess.mirrored != (mirrored == "yes"):
            guess = level_camera(job.circle, image_size=job.image_size, options=tried_options)
            known = job.circle is not None
        found.append(first_cameras(job.usable, guess, known=known, options=tried_options, circle=job.circle))
    (cameras, cost), *others = sorted(found, key=lambda pair: pair[1])
    if not math.isfinite(cost):
        return None
    return Start(cameras, cost, ambiguous=any(other - cost < _AMBIGUOUS for _, other in others))


# Many data sets of one geometry: detections at the same moments by cameras like one that is known.
#
# Monte Carlo, for one: the same arc again and again, other noise. What the sets share is made once (directions, bins,
# scales to try, the lens's prior), the search for a start is left out, since all begin at the known camera, and so is
# the uncertainty: what is returned is the camera that `calibrate` returns.

_SETTLING = 3
_STEPS = 10


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Batch:
    """What fits of one geometry share.

    Attributes
    ----------
    camera : where all fits begin: the true camera of a simulation, or the first fit.
    options : of the fits.
    usable : the sightings that count in every set; their detections are those of the first set.
    n_supplied : how many detections a set has.
    groups, grid : of the robust rounds.
    problem : the camera sought, its prior about the first image circle.
    circle : that circle, or None: then no set has one.
    """

    camera: Camera
    options: CalibrationOptions
    usable: Sightings
    n_supplied: int
    groups: NoiseGroups
    grid: HyperparameterGrid
    problem: FitProblem
    circle: ImageCircle | None

    @classmethod
    def near(
        cls,
        camera: Camera,
        points: Sightings,
        *,
        site: Site,
        options: CalibrationOptions = USUAL_OPTIONS,
        circle: ImageCircle | None = None,
    ) -> Batch:
        """Return what the fits of sightings like these share.

        Parameters
        ----------
        camera : near the cameras that are sought: within some px over the sky.
        points : one set, of one pose.
        site : where the camera stands.
        options : how to fit; projection and mirroring are the camera's.
        circle : the image circle of the first set, where the sets have one.

        Raises
        ------
        InputError
            Where the points are of several poses.
        """
        options = replace(options, projection=camera.projection, mirrored="yes" if camera.mirrored else "no")
        usable = filter_sightings(points, site=site)
        if int(usable.epoch.max(initial=0)) > 0:
            raise InputError(field="epoch", problem="several poses", remedy="fit the sightings of one pose at a time")
        camera = camera.lens_alone()
        return cls(
            camera=camera,
            options=options,
            usable=usable,
            n_supplied=len(points),
            groups=NoiseGroups.of(usable),
            grid=grid_of(camera, options),
            problem=single_problem(usable, camera, options, circle),
            circle=circle,
        )

    def fitted(self, pixels: FloatArray, *, circle: ImageCircle | None = None) -> Camera:
        """Return the camera that a set of detections gives.

        Parameters
        ----------
        pixels : (n_supplied, 2) px, in the order of the points; finite.
        circle : the set's own image circle, in place of the first one.

        Raises
        ------
        InputError
            Where the detections are not those of the geometry, or a circle comes without a first one.
        """
        if np.shape(pixels) != (self.n_supplied, 2) or not np.all(np.isfinite(pixels)):
            raise InputError(
                field="pixels", problem=f"shape {np.shape(pixels)}", remedy=f"give {self.n_supplied} finite x, y"
            )
        if circle is not None and self.circle is None:
            raise InputError(field="image circle", problem="only of this set", remedy="give the first set one, too")
        observed = replace(self.usable, pixels=np.asarray(pixels, dtype=np.float64)[self.usable.index])
        if self.options.method == "paper":
            found = fit_as_paper(observed, [self.camera], options=self.options, quickly=True).cameras[0]
        else:
            found = self._robust(observed, self._problem(circle))
        return tidied(found, self.options)

    def _problem(self, circle: ImageCircle | None) -> FitProblem:
        if circle is None:
            return self.problem
        size, mean = (self.camera.width, self.camera.height), self.problem.prior.mean.copy()
        first = level_camera(circle, image_size=size, options=self.options)
        mean[: Whitened.RADIAL] = *first.focal_length_px, 0.0, *first.principal_point_px
        return replace(self.problem, prior=replace(self.problem.prior, mean=mean))

    def _robust(self, observed: Sightings, problem: FitProblem) -> Camera:
        plain = self._without_field(observed, problem)
        problem, observed = with_effects(problem, plain, observed)
        found = robust_camera(problem, observed, plain, groups=self.groups, grid=self.grid, near_minimum=True)
        camera = found.problem.camera(found.unknowns)
        if found.state.field_odds <= 0.0:
            return camera
        mean = found.field_mean(found.system(observed, self.groups.bins).normal())
        return camera if mean is None else replace(camera, displacement=found.grid.basis.displacement(mean))

    def _without_field(self, observed: Sightings, problem: FitProblem) -> FloatArray:
        """Return the unknowns of the robust fit from the known camera: the weights by turns with the bins' solution."""
        tolerances, bins = self.options.tolerances, self.groups.bins
        precision = prior_precision(problem.size, tolerances.radial_px, tolerances.decentering_px)
        at = problem.unknowns([self.camera])
        for _ in range(_SETTLING):
            sigma = robust_sigma(distance_sigmas(problem, observed, at), floor=SMALLEST_SIGMA_PX)
            weighed = information(problem.residuals(at, observed), observed, sigma)
            means = bins.observations(observed, problem, at, information=weighed)
            at = most_probable(problem, means, at, precision=precision, iterations=_STEPS, tolerance=1e-4).unknowns
        return at


# The fit of a past calibration once more, from its own evidence.


def reproduce_calibration(past: Calibration, points: Sightings) -> Calibration:
    """Return the calibration that the evidence of a past one leads to.

    Parameters
    ----------
    past : as it was made, or as its document states it.
    points : the sightings that it was given.

    Raises
    ------
    InputError
        Where its evidence is not whole: made by hand, or by a version with other options.
    """
    evidence = past.evidence
    try:
        solved = calibrate(
            points,
            site=past.site,
            image_size=(past.camera.width, past.camera.height),
            options=_options(evidence.options),
            circle=None if evidence.circle is None else ImageCircle(**_named(evidence.circle)),
            start=None if evidence.start is None else Camera(**_named(evidence.start)),
        )
    except TypeError as error:
        raise InputError(
            field="evidence", problem=f"is of another version ({error})", remedy="use the version that made it"
        ) from error
    solved = replace(solved, evidence=replace(solved.evidence, selection=evidence.selection))
    return with_pose_spread(solved, evidence.pose_spread_deg or (0.0, 0.0, 0.0))


def _options(stored: Mapping[str, object]) -> CalibrationOptions:
    if not stored:
        raise InputError(field="evidence.options", problem="are empty", remedy="name a calibration that a fit made")
    named = _named(stored)
    if named.pop("free", "all") != "all":
        raise InputError(
            field="evidence.options.free",
            problem="only the pose was fitted, with another calibration's lens, or the camera about a stated prior",
            remedy="solve the calibration that it names as its parent, or name that camera again with --start",
        )
    if "lens_prior" in named:
        raise InputError(
            field="evidence.options.lens_prior",
            problem="the fit was given a type of lens, whose file the archive does not hold",
            remedy="fit the same sightings again with that file and --lens-prior",
        )
    lens, paper = LensTolerances(**named.pop("tolerances")), PaperOptions(**named.pop("paper"))
    return CalibrationOptions(**named, tolerances=lens, paper=paper)


def _named(stored: Mapping[str, object]) -> dict[str, Any]:
    """Return arguments by name; JSON has lists where values have tuples."""
    return {name: tuple(value) if isinstance(value, list) else value for name, value in stored.items()}
