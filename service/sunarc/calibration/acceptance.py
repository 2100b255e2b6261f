"""Whether a fit may take the place of the calibration in use; drift of the pose from day to day."""

from __future__ import annotations

import math
from collections.abc import Iterator
from datetime import date
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sunarc.calibration.answers.covariance import (
    hemisphere,
    project_with_covariance,
    with_covariance,
    without_clock,
)
from sunarc.calibration.evidence import squared_sigmas
from sunarc.calibration.model.result import Calibration, Verdict
from sunarc.calibration.model.sightings import Sightings, apparent_directions
from sunarc.calibration.quality.widening import fit_direction_sigma_rms_deg
from sunarc.common.array_types import FloatArray
from sunarc.common.findings import Finding
from sunarc.common.robust_statistics import MAD_TO_SIGMA
from sunarc.optics.camera import FOCAL_LENGTH, PARAMETER_NAMES
from sunarc.optics.forward import project
from sunarc.sky.days import day_of_date, solar_days

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
_MUCH_WORSE = 1.5
_FOUND_OUT = 4.0
"""Growth that is accepted of a fit of more days: the uncertainty of the current one was too small."""
_FAR_SIGMAS = 5.0
_SHOWN = 0.5
_CHANGED = 2.0
"""Change over the sky, in units of the larger of both stated sigmas, that needs proof by later sightings."""
_HELD_OUT_RATIOS = (2.0, 4.0)
"""Held-out error over what was expected: marginal, refused."""
_PROOF = 100.0
"""By how much the sightings since must be met better, as a difference of chi-squares."""
_OUTLIER = 9.0
_NEW = 1e-3
"""Change of the camera or of what is stated, as a share of what is stated, below which a fit adds no information."""


def accept(
    candidate: Calibration,
    current: Calibration | None = None,
    *,
    same_pose: bool = True,
    unseen: Sightings | None = None,
) -> Verdict:
    """Return whether a candidate may become the current calibration.

    It may where its own verdict allows, where it predicts days left out about as well as it states, where it is not
    less sure of the sky than the current one (or knows more, and finds that one too sure of itself), and where the
    two agree within what they say of themselves: so the error served does not rise by more than twice what is stated.
    A larger change needs proof: that the sightings since are met far better. One that says the same again is
    marginal: the current one stays.

    Parameters
    ----------
    candidate : the new fit.
    current : the one in use; None where there is none.
    same_pose : whether both speak of the same pose epoch; if not, agreement is not asked for.
    unseen : sightings of the current pose epoch, of days that the current one does not know.
    """
    if not candidate.verdict.accepted:
        return candidate.verdict
    if current is not None:
        current = _in_any_season(without_clock(current), candidate.evidence.log_odds.get("season_share", 0.0))
    found = (Finding("first_calibration"), *candidate.verdict.findings)
    against = [*_held_out_problems(candidate)]
    if current is not None:
        found = (Finding("direction_sigma_compared", _sigmas(candidate, current)),)
        against += _compared(candidate, current, same_pose=same_pose, unseen=unseen)
    if not against:
        return Verdict(accepted=True, findings=found)
    against.sort(key=lambda one: not one.refuses)
    return Verdict(accepted=False, marginal=not against[0].refuses, findings=tuple(one.finding for one in against))


def _in_any_season(calibration: Calibration, share: float) -> Calibration:
    """Return a calibration with a focal length that may be another by now, by a share of itself (1-sigma).

    What it states of the sky stays that of its own time.
    """
    names = calibration.parameter_names
    change = np.zeros(len(names))
    for name, focal in zip(PARAMETER_NAMES[FOCAL_LENGTH], calibration.camera.focal_length_px, strict=True):
        if name in names:
            change[names.index(name)] = share * focal
    return with_covariance(calibration, calibration.covariance + np.outer(change, change)) if share else calibration


def unseen_points(points: Sightings, current: Calibration) -> Sightings:
    """Return the sightings of the latest pose epoch, of days that a calibration does not rest on."""
    known_days = [day_of_date(date.fromisoformat(day)) for day in current.evidence.days]
    day = solar_days(points.unix_s, longitude=current.site.longitude)
    return points.select((points.epoch == points.epoch.max(initial=0)) & ~np.isin(day, known_days))


class _Against(NamedTuple):
    """What speaks against a candidate, and whether it refuses it; else it is marginal."""

    finding: Finding
    refuses: bool = False


def _held_out_problems(candidate: Calibration) -> Iterator[_Against]:
    found, expected = candidate.metrics.held_out_rmse_px, candidate.metrics.held_out_expected_px
    if found is not None and expected is not None and found > _HELD_OUT_RATIOS[0] * expected:
        finding = Finding("cross_validation_rmse", {"rmse_px": found, "expected_px": expected})
        yield _Against(finding, found > _HELD_OUT_RATIOS[1] * expected)


def _compared(
    candidate: Calibration, current: Calibration, *, same_pose: bool, unseen: Sightings | None
) -> Iterator[_Against]:
    """Yield what speaks against the candidate in comparison with the current one."""
    if candidate.camera.mirrored != current.camera.mirrored:
        yield _Against(Finding("handedness_differs"), refuses=True)
    elif same_pose and says_the_same(candidate, current):
        yield _Against(Finding("no_change", {"limit": _NEW}))
    elif same_pose:
        change = _change(candidate, current)
        if change is not None and (change.refuses or not _met_better(candidate, current, unseen)):
            yield change
        sigmas = _sigmas(candidate, current)
        before, now = sigmas["before_deg"], sigmas["now_deg"]
        allowed = _FOUND_OUT if _knows_more(candidate, current) else _WORSE
        if not now <= allowed * before:
            yield _Against(
                Finding("direction_sigma_increased", sigmas), refuses=not now <= _MUCH_WORSE * allowed * before
            )


def _sigmas(candidate: Calibration, current: Calibration) -> dict[str, float]:
    return {"now_deg": fit_direction_sigma_rms_deg(candidate), "before_deg": fit_direction_sigma_rms_deg(current)}


def _knows_more(candidate: Calibration, current: Calibration) -> bool:
    """Return whether a fit rests on days that the current one does not know, and on about as much beside."""
    new, old = candidate.evidence, current.evidence
    return bool(set(new.days) - set(old.days)) and new.n_used > 0.8 * old.n_used


def says_the_same(candidate: Calibration, current: Calibration) -> bool:
    """Return whether both are of the same sightings, and differ by less than is stated."""
    new, old = candidate.evidence, current.evidence
    if (new.days, new.n_used, candidate.method) != (old.days, old.n_used, current.method):
        return False
    difference, _, uncertainty = _over_the_sky(candidate, current)
    moved = float(np.sum(difference**2)) <= _NEW**2 * float(np.sum(np.trace(uncertainty, axis1=1, axis2=2)))
    return moved and math.isclose(candidate.sky_rms_deg, current.sky_rms_deg, rel_tol=_NEW)


def _change(candidate: Calibration, current: Calibration) -> _Against | None:
    share, worst_px = disagreement(candidate, current)
    if share > _SHOWN:
        return _Against(Finding("contradicts_active", {"share": share, "distance_px": worst_px}), refuses=True)
    difference, first, second = _over_the_sky(candidate, current)
    uncertainty = max(float(np.sqrt(np.mean(np.trace(part, axis1=1, axis2=2)))) for part in (first, second))
    change = float(np.sqrt(np.mean(np.sum(difference**2, axis=-1))))
    if change <= _CHANGED * uncertainty:
        return None
    return _Against(Finding("change_not_confirmed", {"change_px": change, "stated_px": uncertainty}))


def _met_better(candidate: Calibration, current: Calibration, unseen: Sightings | None) -> bool:
    """Return whether the candidate meets sightings that the current one does not know far better than that does."""
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
    """Return how far two cameras are apart at most over the sky that both see, px; infinite where they share none."""
    directions = hemisphere()
    distance = np.linalg.norm(project(first.camera, directions) - project(second.camera, directions), axis=-1)
    return float(np.nanmax(distance)) if np.any(np.isfinite(distance)) else math.inf


def disagreement(first: Calibration, second: Calibration) -> tuple[float, float]:
    """Return the share of the sky over which two calibrations contradict each other, and their largest distance, px.

    They contradict where their distance is beyond five of their joint sigmas.
    """
    difference, square = _in_joint_sigmas(first, second)
    if difference.size == 0:
        return 1.0, math.inf
    return float(np.mean(square > _FAR_SIGMAS**2)), float(np.max(np.linalg.norm(difference, axis=-1)))


def apart_sigmas(first: Calibration, second: Calibration) -> float:
    """Return the root mean square distance of two calibrations over the sky per axis, in their joint sigmas."""
    _, square = _in_joint_sigmas(first, second)
    return math.sqrt(0.5 * float(np.mean(square))) if square.size else math.inf


def _in_joint_sigmas(first: Calibration, second: Calibration) -> tuple[FloatArray, FloatArray]:
    """Return how far two calibrations are apart over the sky, (n, 2) px, and its square (n,) in their joint sigmas."""
    difference, a_covariance, b_covariance = _over_the_sky(first, second)
    return difference, squared_sigmas(difference, a_covariance + b_covariance + 1e-12 * np.eye(2))


def _over_the_sky(first: Calibration, second: Calibration) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return how far two calibrations are apart, (n, 2) px, and the covariances of both where they see the sky."""
    directions = hemisphere(400)
    a, a_covariance = project_with_covariance(without_clock(first), directions)
    b, b_covariance = project_with_covariance(without_clock(second), directions)
    both = np.all(np.isfinite(a), axis=-1) & np.all(np.isfinite(b), axis=-1)
    return (a - b)[both], a_covariance[both], b_covariance[both]
