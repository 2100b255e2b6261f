"""Handedness of an image: the finished fits of both, compared by their evidence and by how cameras are mounted.

The mirrored track of the sun is that of another latitude: at the equator of the same one, elsewhere of about the one
with the other sign. So both are fitted where nobody stated the handedness, and a mirrored camera is compared with one
that is not mirrored at the latitude of the other sign.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sunarc.calibration.compared_fits import compare_log_evidences
from sunarc.calibration.fit.assemble import Job
from sunarc.calibration.fit.robust_fit import FitState, fit_robustly
from sunarc.calibration.model.sightings import Kind, filter_sightings
from sunarc.calibration.plausible_start import Hand, Start, plausible_start
from sunarc.calibration.quality.tilt import LEVEL_DEG, mount_density, tilt_deg
from sunarc.calibration.verdict import before_fit, below_horizon
from sunarc.common.findings import Finding
from sunarc.optics.pose import rotation_matrix

_AMBIGUOUS = 3.0
"""Natural log odds for a handedness to be taken: 20 to 1. Chosen."""
_BETTER = 10.0
"""Natural log odds for another camera to be named as the right one: 22,000 to 1. Chosen."""
_FAR = 60.0
"""Natural log odds between starts, from which the worse one is not fitted: of 36 days near the equator
none became the better one by the fit."""


class Fitted(NamedTuple):
    """Robust fit for one handedness, and its start."""

    start: Start
    fit: FitState


class HandChoice(NamedTuple):
    """Fit of the chosen handedness, the findings that refuse it, and those of an accepted fit."""

    fitted: Fitted
    against: tuple[Finding, ...] = ()
    found: tuple[Finding, ...] = ()


def chosen_hand(fitted: Fitted, job: Job) -> HandChoice:
    """Return the fit of the stated or more probable handedness, and the findings about the other one.

    Parameters
    ----------
    fitted : of the handedness that is assumed.
    job : its input; "no" and "yes" are stated, all else is asked about.
    """
    stated, other, gain = job.options.mirrored, None, math.inf
    if stated not in {"no", "yes"}:
        other = fit_handedness(job, _other_hand(fitted.start.hand), than=fitted.start.cost)
        gain = math.inf if other is None else -other_fit_log_odds(fitted, other, job)
        if other is not None and stated == "auto" and gain < 0.0:
            fitted, other, gain = other, fitted, -gain
    if other is not None and gain < -_BETTER:
        return HandChoice(fitted, other_fits(other, job))
    if gain < _AMBIGUOUS:
        return HandChoice(fitted, (Finding("mirroring_ambiguous"),))
    twin = _check_other_latitude(fitted, job) if fitted.start.hand == "yes" else None
    if twin is None:
        return HandChoice(fitted)
    return HandChoice(fitted, found=(twin,)) if stated == "yes" else HandChoice(fitted, (twin,))


def named_other(fitted: Fitted | None, job: Job) -> tuple[Finding, ...]:
    """Return the finding that the handedness not assumed fits far better, or alone; empty otherwise."""
    if fitted is None:
        stated: Hand = "yes" if job.options.mirrored == "yes" else "no"
        found = fit_handedness(job, _other_hand(stated), than=math.inf)
        return () if found is None else other_fits(found, job, compared=False)
    hand = _other_hand(fitted.start.hand)
    other = fit_handedness(job, hand, than=fitted.start.cost)
    if other is None or other_fit_log_odds(fitted, other, job) < _BETTER:
        return ()
    return other_fits(other, job)


def other_fits(other: Fitted, job: Job, *, compared: bool = True) -> tuple[Finding, ...]:
    """Return the findings that another handedness fits better, or that it alone gave a camera.

    The latitude of the other sign goes first where a camera that is not mirrored fits there about as well: near the
    equator it mostly does not, and both latitudes would name each other.
    """
    hand = other.start.hand
    twin = _check_other_latitude(other, job) if hand == "yes" else None
    found = Finding(
        "other_handedness_fits" if compared else "other_handedness_alone_fits",
        {"mirrored": hand, "stated": _other_hand(hand), "latitude": -job.site.latitude},
    )
    return (found,) if twin is None else (twin, found)


def fit_handedness(job: Job, hand: Hand, *, than: float) -> Fitted | None:
    """Return the fit of one handedness; None where no camera is found, or its start costs far more than another."""
    start = plausible_start(job, hand)
    if start is None or start.cost > than + _FAR:
        return None
    return Fitted(start, fit_robustly(job.usable, start.cameras, job.options, job.circle))


def other_fit_log_odds(fitted: Fitted, other: Fitted, job: Job) -> float:
    """Return the natural log odds of another fit of the job's sightings, mounts considered.

    0 where neither camera comes near the sightings, so that they tell nothing.
    """
    both = {False: fitted.fit, True: other.fit}
    evidence = compare_log_evidences(both)
    limit_deg = job.options.level_within_deg
    mounts = _log_mount_density(other.fit, limit_deg) - _log_mount_density(fitted.fit, limit_deg)
    gain = evidence[True] - evidence[False] + mounts
    return 0.0 if math.isnan(gain) else gain


def log_odds_against_twin(fitted: Fitted, job: Job) -> float:
    """Return the log odds of a tilted camera against the other handedness's; infinite where both tilt alike.

    Asked whatever handedness is stated: at another latitude a mirror image of a level camera is that of a tilted one.
    """
    twin = fit_handedness(job, _other_hand(fitted.start.hand), than=fitted.start.cost)
    if twin is None or _tilt_deg(twin) > _tilt_deg(fitted) - LEVEL_DEG:
        return math.inf
    return -other_fit_log_odds(fitted, twin, job)


def _tilt_deg(fitted: Fitted) -> float:
    """Return the tilt of the last pose of a fit."""
    return tilt_deg(fitted.fit.camera())


def _log_mount_density(fit: FitState, limit_deg: float | None) -> float:
    """Return the log density of a mount that holds the optical axis of the last pose, its tilt's limit being stated."""
    axis = rotation_matrix(fit.camera().rotation_cam_enu)[2]
    return math.log(float(mount_density(axis, limit_deg=limit_deg)))


def _other_hand(hand: Hand) -> Hand:
    return "no" if hand == "yes" else "yes"


def _check_other_latitude(fitted: Fitted, job: Job) -> Finding | None:
    """Return that a camera that is not mirrored fits about as well at the latitude of the other sign; None otherwise.

    The stars tell a latitude, and stated directions are of one: only the sun's track is asked.
    """
    if np.any(job.usable.kind != Kind.SUN) or np.any(job.usable.alone):
        return None
    site = replace(job.site, latitude=-job.site.latitude)
    usable = filter_sightings(job.points, site=site, image_size=job.image_size)
    if len(usable) == 0 or below_horizon(usable, job.options):
        return None
    there, here = np.isin(usable.index, job.usable.index), np.isin(job.usable.index, usable.index)
    some = usable.select(there)
    if before_fit(some, job.options) or np.unique(some.epoch).size != np.unique(job.usable.epoch).size:
        return None
    twin = fit_handedness(job._replace(usable=some, site=site, start=None), "no", than=fitted.start.cost)
    if twin is None:
        return None
    if not np.all(here):  # the same sightings on both sides
        job = job._replace(usable=job.usable.select(here))
        fitted = fitted._replace(fit=fit_robustly(job.usable, fitted.start.cameras, job.options, job.circle))
    if other_fit_log_odds(fitted, twin, job) <= -_BETTER:
        return None
    return Finding("latitude_of_other_sign_fits", {"latitude": -job.site.latitude})
