"""From sightings to a calibration: a new one, or a stored one again."""

from __future__ import annotations

from dataclasses import replace
from functools import reduce
from typing import Required, TypedDict, Unpack

from sunarc.calibration.fit.assemble import Job, calibration_from_fit, refused, robust_outcome
from sunarc.calibration.fit.cross_validation import contradiction, day_contradicts_night, select_one_kind
from sunarc.calibration.fit.level_evidence import tilt_log_odds
from sunarc.calibration.fit.robust_fit import fit_robustly
from sunarc.calibration.handedness import Fitted, HandChoice, chosen_hand, log_odds_against_twin, named_other
from sunarc.calibration.model.options import USUAL_OPTIONS, CalibrationOptions, ImageCircle
from sunarc.calibration.model.result import Calibration, add_finding
from sunarc.calibration.model.sightings import Sightings, filter_sightings
from sunarc.calibration.paper import fit_as_paper
from sunarc.calibration.plausible_start import most_plausible_start
from sunarc.calibration.projection_choice import ChosenLens, chosen_lens
from sunarc.calibration.quality.fit_checks import TILT, TILT_SHOWN
from sunarc.calibration.verdict import before_fit, below_horizon
from sunarc.common.errors import InputError
from sunarc.common.findings import Finding
from sunarc.optics.camera import Camera
from sunarc.sky.site import Site


class FitInput(TypedDict, total=False):
    """Arguments of `calibrate` by their names."""

    site: Required[Site]
    """Where the camera stands."""
    image_size: Required[tuple[int, int]]
    """Width and height, px."""
    options: CalibrationOptions
    """Options of the fit; the defaults are the service's."""
    circle: ImageCircle | None
    """The image circle, where it is known."""
    start: Camera | None
    """A camera to start from, in place of a search."""
    parts: bool
    """Tests of the fit against parts of the sightings and the other handedness; default True. A fit that is
    only compared with others needs no such test."""
    tilt_known: bool
    """Former acceptance of the camera at this site by this clock: its tilt is not asked about; default False."""


def calibrate(points: Sightings, **given: Unpack[FitInput]) -> Calibration:
    """Fit a camera to sightings of the sun.

    Poor data give a calibration whose verdict is refused and says why; they never raise.

    Parameters
    ----------
    points : the sightings; several pose epochs share the lens, and the calibration is of the latest.
    given : see `FitInput`.

    Raises
    ------
    InputError
        Where the image size is not a size.
    """
    lens = prepared(points, **given)
    return lens.allowed_for(calibrated(lens.job, lens.fitted))


def prepared(
    points: Sightings,
    *,
    site: Site,
    image_size: tuple[int, int],
    options: CalibrationOptions = USUAL_OPTIONS,
    circle: ImageCircle | None = None,
    start: Camera | None = None,
    parts: bool = True,
    tilt_known: bool = False,
) -> ChosenLens:
    """Return the input of a fit with usable sightings and a projection; arguments as for `calibrate`."""
    if min(image_size) < 16:
        raise InputError(field="image size", problem=f"{image_size} px", remedy="give width and height in px")
    usable = filter_sightings(points, site=site, image_size=image_size)
    begin = None if start is None else start.lens_alone()
    return chosen_lens(
        Job(points, usable, site, image_size, options, circle, begin, parts=parts, tilt_known=tilt_known)
    )


def calibrated(job: Job, fitted: Fitted | None = None) -> Calibration:
    """Return the calibration of a job with a stated projection; by a part of the sightings where parts contradict.

    `fitted` is its fit, where it is there already.
    """
    problems = before_fit(job.usable, job.options)
    if problems:
        return refused(job, problems)
    if fitted is None:
        picked = most_plausible_start(job)
        if picked is None:
            against = (*below_horizon(job.usable, job.options), Finding("no_camera_fits"))
            return _add_handedness_finding(refused(job, against), job, None)
        fitted = Fitted(picked, fit_robustly(job.usable, picked.cameras, job.options, job.circle))
    by_paper = job.options.method == "paper"
    found = None if by_paper else contradiction(fitted.fit, job.usable)
    if found is not None:
        return _fit_one_kind(job, found)
    hand = chosen_hand(fitted, job) if job.parts else HandChoice(fitted)
    start, fit = hand.fitted
    if by_paper:
        outcome = fit_as_paper(job.usable, start.cameras, options=job.options)
    else:
        outcome = robust_outcome(fit, job.usable, job.options, parts=job.parts)
        of_tilt = tilt_log_odds(fit, outcome.cameras[-1], job.site) if job.parts else None
        if of_tilt is not None:
            if of_tilt >= TILT_SHOWN:  # a mirror image of a level camera is no tilted one either
                of_tilt = min(of_tilt, log_odds_against_twin(hand.fitted, job))
            outcome = outcome._replace(log_odds={**outcome.log_odds, TILT: of_tilt})
    calibration = calibration_from_fit(outcome, job, others=hand.against)
    if calibration.verdict.accepted:
        return reduce(add_finding, hand.found, calibration)
    return calibration if hand.against else _add_handedness_finding(calibration, job, hand.fitted)


def _add_handedness_finding(calibration: Calibration, job: Job, fitted: Fitted | None) -> Calibration:
    """Return a calibration; where it is refused and the other handedness is far more probable, its verdict says so."""
    verdict = calibration.verdict
    if verdict.accepted or not job.parts or job.options.mirrored == "auto":
        return calibration
    if fitted is not None and job.options.mirrored is None:
        return calibration  # it was asked already
    return replace(calibration, verdict=replace(verdict, findings=(*named_other(fitted, job), *verdict.findings)))


def _fit_one_kind(job: Job, found: Finding) -> Calibration:
    """Return the fit of the day's sightings; of the night's where the day's are at fault."""
    day = calibrated(job._replace(usable=select_one_kind(job.usable, found, night=False)))
    night = calibrated(job._replace(usable=select_one_kind(job.usable, found, night=True)))
    suns = job.usable.select(~job.usable.night)
    suns = replace(suns, sigma_px=job.points.sigma_px[suns.index])
    fault = day_contradicts_night(found, day, night, suns)
    if fault is None:
        return day
    return calibrated(job._replace(usable=select_one_kind(job.usable, fault, night=True)))
