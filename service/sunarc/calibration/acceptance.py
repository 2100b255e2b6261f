"""Comparison of a fit with the calibration in use; drift of the pose from day to day."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import date
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from sunarc.calibration.answers.ageing import add_focal_change, focal_share
from sunarc.calibration.answers.covariance import (
    hemisphere,
    project_with_covariance,
    without_clock,
)
from sunarc.calibration.evidence import squared_sigmas
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings, apparent_directions
from sunarc.calibration.quality.widening import fit_direction_sigma_rms_deg
from sunarc.common.array_types import FloatArray
from sunarc.common.findings import Data
from sunarc.common.robust_statistics import MAD_TO_SIGMA
from sunarc.optics.forward import project
from sunarc.sky.days import date_to_day, solar_days

# How much a camera turns to and fro from day to day, and what that does to how sure one is of it.
#
# Heat bends masts and time lets them lean: the pose of a single day is not the mean one that a fit gives. What the
# days' poses scatter beyond their own errors is allowed for in every direction.

_FEWEST = 5
"""Days that tell a spread."""


def pose_spread_deg(turns_deg: ArrayLike, sigmas_deg: ArrayLike) -> tuple[float, float, float]:
    """Return the spread of daily poses beyond their own errors, 1-sigma about east, north and up, degrees.

    Parameters
    ----------
    turns_deg : (n, 3) how the camera stood turned on each day.
    sigmas_deg : (n, 3) 1-sigma of each.

    Returns
    -------
    0 where fewer than five days are given, or their errors explain what they scatter.
    """
    turns = np.asarray(turns_deg, dtype=np.float64).reshape(-1, 3)
    if turns.shape[0] < _FEWEST:
        return 0.0, 0.0, 0.0
    sigma = MAD_TO_SIGMA * np.median(np.abs(turns - np.median(turns, axis=0)), axis=0)
    # days differ in how well they tell the pose: the usual one counts, as in the spread
    estimation_variance = np.median(np.asarray(sigmas_deg, dtype=np.float64).reshape(-1, 3) ** 2, axis=0)
    east, north, up = np.sqrt(np.maximum(sigma**2 - estimation_variance, 0.0)).tolist()
    return east, north, up


_WORSE = 1.15
"""Growth of the stated 1-sigma that still counts as staying."""
_FOUND_OUT = 4.0
"""Growth that is accepted of a fit of more days: the uncertainty of the current one was too small."""
_FAR_SIGMAS = 5.0
SHOWN = 0.5
"""Share of the sky over which two calibrations may contradict each other."""
_PROOF = 100.0
"""By how much the sightings since must be met better, as a difference of chi-squares."""
_OUTLIER = 9.0
_NEW = 1e-3
"""Change of the camera or of its stated values, as a share of its stated error, below which a fit is not new."""


def allow_for_age(candidate: Calibration, current: Calibration) -> Calibration:
    """Return the calibration in use with a focal length that may be another by the time of a candidate.

    By the season that the candidate's sightings prove, or by its age. Its 1-sigma over the sky stays.
    """
    days = [one.evidence.days for one in (candidate, current) if one.evidence.days]
    ends = [date_to_day(date.fromisoformat(max(one))) for one in days]
    by_age = focal_share(candidate.evidence, ends[0] - ends[-1]) if ends else 0.0
    return add_focal_change(current, max(candidate.evidence.log_odds.get("season_share", 0.0), by_age))


def unseen_points(points: Sightings, current: Calibration) -> Sightings:
    """Return the sightings of the latest pose epoch from days that a calibration does not use."""
    known_days = [date_to_day(date.fromisoformat(day)) for day in current.evidence.days]
    day = solar_days(points.unix_s, longitude=current.site.longitude)
    return points.select((points.epoch == points.epoch.max(initial=0)) & ~np.isin(day, known_days))


@dataclass(frozen=True, kw_only=True, eq=False)
class Succession:
    """Candidate calibration and the calibration in use that it may replace."""

    candidate: Calibration
    current: Calibration | None = None
    """The one in use, without the clock's error that is stated for all sightings; None without one."""
    same_pose: bool = True
    """True where both are of the same pose epoch; else agreement is not asked for."""
    unseen: Sightings | None = None
    """Sightings of the current pose epoch, of days that the current one does not know."""

    @property
    def comparable(self) -> Calibration | None:
        """The one in use, where it is of the same pose and handedness."""
        current = self.current
        same = self.same_pose and current is not None and current.camera.mirrored == self.candidate.camera.mirrored
        return current if same else None

    @cached_property
    def changed_from(self) -> Calibration | None:
        """The comparable one, where the candidate adds to it."""
        current = self.comparable
        return None if current is None or says_the_same(self.candidate, current) else current


def cross_validation(succession: Succession) -> Data | None:
    """Return the candidate's error on days left out of the fit, as found and as expected."""
    found, expected = (getattr(succession.candidate.metrics, f"held_out_{one}_px") for one in ("rmse", "expected"))
    return None if found is None or expected is None else {"rmse_px": found, "expected_px": expected}


def other_hand(succession: Succession) -> Data | None:
    """Return data where the candidate's handedness differs from that of the calibration in use."""
    current = succession.current
    return None if current is None or current.camera.mirrored == succession.candidate.camera.mirrored else {}


def contradiction(succession: Succession) -> Data | None:
    """Return the share of the sky over which candidate and current calibration contradict each other."""
    if succession.changed_from is None:
        return None
    share, worst_px = disagreement(succession.candidate, succession.changed_from)
    return {"share": share, "distance_px": worst_px}


def growth(succession: Succession) -> Data | None:
    """Return the stated uncertainties of candidate and current calibration."""
    current = succession.changed_from
    return None if current is None else stated_sigmas(succession.candidate, current)


def allowed_growth(succession: Succession) -> float:
    """Return the factor 1.15; the factor 4 for a fit of more days and about as many sightings."""
    current = succession.current
    return _FOUND_OUT if current is not None and _has_more_evidence(succession.candidate, current) else _WORSE


def largest_growth(succession: Succession) -> float:
    """Return 1.5 times the allowed error."""
    return 1.5 * allowed_growth(succession)


def no_change(succession: Succession) -> Data | None:
    """Return data where candidate and current calibration are equal within their uncertainty."""
    return {"limit": _NEW} if succession.comparable is not None and succession.changed_from is None else None


def unproven_change(succession: Succession) -> Data | None:
    """Return the change over the sky, and the larger of both stated; None where later sightings prove it.

    One that contradicts the current calibration is refused in any case.
    """
    candidate, current = succession.candidate, succession.changed_from
    if current is None or _predicts_unseen_better(candidate, current, succession.unseen):
        return None
    if disagreement(candidate, current)[0] > SHOWN:
        return None
    difference, first, second = _compare_over_sky(candidate, current)
    stated = max(float(np.sqrt(np.mean(np.trace(part, axis1=1, axis2=2)))) for part in (first, second))
    return {"change_px": float(np.sqrt(np.mean(np.sum(difference**2, axis=-1)))), "stated_px": stated}


def stated_sigmas(candidate: Calibration, current: Calibration) -> dict[str, float]:
    """Return the stated 1-sigma over the sky, degrees, of the fits alone."""
    return {"now_deg": fit_direction_sigma_rms_deg(candidate), "before_deg": fit_direction_sigma_rms_deg(current)}


def _has_more_evidence(candidate: Calibration, current: Calibration) -> bool:
    """Return whether a fit uses days that the current one does not, and about as much in addition."""
    new, old = candidate.evidence, current.evidence
    return bool(set(new.days) - set(old.days)) and new.n_used > 0.8 * old.n_used


def says_the_same(candidate: Calibration, current: Calibration) -> bool:
    """Return whether two calibrations of the same sightings differ by less than is stated."""
    new, old = candidate.evidence, current.evidence
    if (new.days, new.n_used, candidate.method) != (old.days, old.n_used, current.method):
        return False
    difference, _, uncertainty = _compare_over_sky(candidate, current)
    moved = float(np.sum(difference**2)) <= _NEW**2 * float(np.sum(np.trace(uncertainty, axis1=1, axis2=2)))
    return moved and math.isclose(candidate.sky_rms_deg, current.sky_rms_deg, rel_tol=_NEW)


def _predicts_unseen_better(candidate: Calibration, current: Calibration, unseen: Sightings | None) -> bool:
    """Return whether the candidate predicts sightings that the current one did not use far better than that does."""
    noise = candidate.evidence.sigma_px * math.sqrt(max(candidate.evidence.inflation, 1.0))
    if unseen is None or len(unseen) == 0 or not noise > 0.0:
        return False
    gain = chi_square(current, unseen, noise) - chi_square(candidate, unseen, noise)
    return gain > _PROOF


def chi_square(calibration: Calibration, points: Sightings, noise_px: float) -> float:
    """Return the sum of squares of sightings about a camera in units of the noise; none counts more than an outlier."""
    directions = apparent_directions(points, site=calibration.site)
    difference = points.pixels - project(calibration.camera, directions)
    square = np.sum(difference**2, axis=-1) / noise_px**2
    return float(np.sum(np.minimum(np.nan_to_num(square, nan=np.inf), _OUTLIER)))


def distance_px(first: Calibration, second: Calibration) -> float:
    """Return the largest distance of two cameras over their common sky, px; infinite where they share none."""
    directions = hemisphere()
    distance = np.linalg.norm(project(first.camera, directions) - project(second.camera, directions), axis=-1)
    return float(np.nanmax(distance)) if np.any(np.isfinite(distance)) else math.inf


def disagreement(first: Calibration, second: Calibration) -> tuple[float, float]:
    """Return the share of the sky over which two calibrations contradict each other, and their largest distance, px.

    They contradict where their distance is beyond five of their joint sigmas.
    """
    difference, square = _distances_in_joint_sigmas(first, second)
    if difference.size == 0:
        return 1.0, math.inf
    return float(np.mean(square > _FAR_SIGMAS**2)), float(np.max(np.linalg.norm(difference, axis=-1)))


def apart_sigmas(first: Calibration, second: Calibration) -> float:
    """Return the root mean square distance of two calibrations over the sky per axis, in their joint sigmas."""
    _, square = _distances_in_joint_sigmas(first, second)
    return math.sqrt(0.5 * float(np.mean(square))) if square.size else math.inf


def _distances_in_joint_sigmas(first: Calibration, second: Calibration) -> tuple[FloatArray, FloatArray]:
    """Return how far two calibrations are apart over the sky, (n, 2) px, and its square (n,) in their joint sigmas."""
    difference, a_covariance, b_covariance = _compare_over_sky(first, second)
    return difference, squared_sigmas(difference, a_covariance + b_covariance + 1e-12 * np.eye(2))


def _compare_over_sky(first: Calibration, second: Calibration) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return how far two calibrations are apart, (n, 2) px, and the covariances of both where they see the sky."""
    directions = hemisphere(400)
    a, a_covariance = project_with_covariance(without_clock(first), directions)
    b, b_covariance = project_with_covariance(without_clock(second), directions)
    both = np.all(np.isfinite(a), axis=-1) & np.all(np.isfinite(b), axis=-1)
    return (a - b)[both], a_covariance[both], b_covariance[both]
