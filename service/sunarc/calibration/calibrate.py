"""From sightings to a calibration: a new one, or a stored one again."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

from sunarc.calibration.fit.assemble import Job, calibration_from_fit, refused, robust_outcome
from sunarc.calibration.fit.cross_validation import contradiction, day_contradicts_night, of_one_kind
from sunarc.calibration.fit.robust_fit import RobustFit, fit_robustly
from sunarc.calibration.model.options import (
    USUAL_OPTIONS,
    CalibrationOptions,
    ImageCircle,
    Mirrored,
)
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings, filter_sightings
from sunarc.calibration.paper import fit_as_paper
from sunarc.calibration.quality.fit_checks import before_fit, below_horizon
from sunarc.calibration.start.initial_guess import first_cameras, level_camera
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
    return _calibrated(Job(points, usable, site, image_size, options, circle, start, parts=parts))


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
        return _of_one_kind(job, found)
    outcome = robust_outcome(fit, job.usable, job.options, parts=job.parts)
    return _explained(calibration_from_fit(outcome, job, ambiguous=picked.ambiguous), job, picked.cost)


def _of_one_kind(job: Job, found: Finding) -> Calibration:
    """Return the fit of the day's sightings; of the night's where the day's are at fault."""
    day = _calibrated(job._replace(usable=of_one_kind(job.usable, found, night=False)))
    night = _calibrated(job._replace(usable=of_one_kind(job.usable, found, night=True)))
    suns = job.usable.select(~job.usable.night)
    suns = replace(suns, sigma_px=job.points.sigma_px[suns.index])
    fault = day_contradicts_night(found, day, night, suns)
    if fault is None:
        return day
    return _calibrated(job._replace(usable=of_one_kind(job.usable, fault, night=True)))


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
