"""Whether a fit may be used at all, and whether it may take the place of the current one."""

from __future__ import annotations

import math
from datetime import date

import numpy as np
from numpy.typing import NDArray

from sunarc.calibration.covariance import hemisphere, project_with_covariance
from sunarc.calibration.points import SunPoints
from sunarc.calibration.result import Calibration, Verdict
from sunarc.optics import project
from sunarc.sky import sun_directions

FloatArray = NDArray[np.float64]

_FIRST_DAY = date(1970, 1, 1).toordinal()

_WORSE = 1.15
"""Growth of the stated 1-sigma that still counts as staying."""
_MUCH_WORSE = 1.5
_FAR_SIGMAS = 5.0
_SHOWN = 0.5
_CHANGED = 9.0
"""Mean square of the change, in units of what both say of themselves, beyond which it is not chance."""
_FORETOLD = (2.0, 4.0)
"""Held-out error over what was expected: marginal, refused."""
_SURPRISED = 9.0
"""Median square of unseen sightings, in units of what was stated, that disproves a calibration."""
_ENOUGH = 50


def accept(
    candidate: Calibration,
    current: Calibration | None = None,
    *,
    same_pose: bool = True,
    unseen: SunPoints | None = None,
) -> Verdict:
    """Return whether a candidate may become the current calibration.

    It may where its own verdict allows, where it foretells days left out about as well as it says, where it is not less
    sure of the sky than the current one, and where the two agree within what they say of themselves. A current one that
    the sightings since disprove has no say in how sure the next one must be.

    Parameters
    ----------
    candidate : the new fit.
    current : the one in use; None where there is none.
    same_pose : whether both speak of the same pose epoch; if not, agreement is not asked for.
    unseen : sightings of the current pose epoch, of days that the current one does not know.
    """
    if not candidate.verdict.accepted:
        return candidate.verdict
    refusals, doubts = _foretold(candidate)
    reasons = ["the first calibration", *candidate.verdict.reasons]
    if current is not None:
        disproved = same_pose and _disproved(current, candidate, unseen)
        for found in (_sureness(candidate, current, disproved=disproved), _change(candidate, current, same_pose)):
            refusals += found[0]
            doubts += [] if disproved else found[1]
        before, now = current.sky_rms_deg, candidate.sky_rms_deg
        what = "the sightings since disprove the current one" if disproved else "as sure of the sky or surer"
        reasons = [f"{what}: 1-sigma {now:.4f} against {before:.4f} degrees"]
    if refusals:
        return Verdict(accepted=False, reasons=tuple(refusals + doubts))
    if doubts:
        return Verdict(accepted=False, marginal=True, reasons=tuple(doubts))
    return Verdict(accepted=True, reasons=tuple(reasons))


def unseen_points(points: SunPoints, current: Calibration) -> SunPoints:
    """Return the sightings of the latest pose epoch, of days that a calibration does not rest on."""
    known = [date.fromisoformat(day).toordinal() - _FIRST_DAY for day in current.evidence.days]
    day = np.floor((points.unix_s + current.site.longitude * 240.0) / 86_400.0).astype(np.int64)
    return points.select((points.epoch == points.epoch.max(initial=0)) & ~np.isin(day, known))


_Found = tuple[list[str], list[str]]


def _foretold(candidate: Calibration) -> _Found:
    """Return refusals and doubts from the days left out."""
    found, expected = candidate.metrics.held_out_rmse_px, candidate.metrics.held_out_expected_px
    if found is None or expected is None or found <= _FORETOLD[0] * expected:
        return [], []
    said = [f"days left out are foretold to {found:.3f} px, where {expected:.3f} px was expected"]
    return (said, []) if found > _FORETOLD[1] * expected else ([], said)


def _sureness(candidate: Calibration, current: Calibration, *, disproved: bool) -> _Found:
    before, now = current.sky_rms_deg, candidate.sky_rms_deg
    if now <= _WORSE * before or disproved:
        return [], []
    said = [f"less sure of the sky: 1-sigma {now:.4f} against {before:.4f} degrees"]
    return (said, []) if not now <= _MUCH_WORSE * before else ([], said)


def _change(candidate: Calibration, current: Calibration, same_pose: bool) -> _Found:  # noqa: FBT001 - private
    if candidate.camera.mirrored != current.camera.mirrored:
        return ["the other handedness than the current one: the setting was changed, or the image flipped"], []
    if not same_pose:
        return [], []
    square, worst_px = _squares(candidate, current)
    share = float(np.mean(square > _FAR_SIGMAS**2))
    if share > _SHOWN:
        where = f"{100 * share:.0f} % of the sky contradicts the current one, by up to {worst_px:.2f} px"
        return [f"{where}: the camera may have moved"], []
    mean = float(np.mean(square)) / 2.0
    if mean > _CHANGED:
        return [], [f"it is {math.sqrt(mean):.1f} sigma from the current one, by up to {worst_px:.2f} px"]
    return [], []


def _disproved(current: Calibration, candidate: Calibration, unseen: SunPoints | None) -> bool:
    """Return whether sightings that the current one does not know lie further off than it allows, and now do not."""
    if unseen is None or len(unseen) < _ENOUGH:
        return False
    return _surprise(current, unseen) > max(_SURPRISED, 2.0 * _surprise(candidate, unseen))


def _surprise(calibration: Calibration, points: SunPoints) -> float:
    """Return the median square distance of sightings in units of what is stated, 1 where all is as stated."""
    pixels, covariance = project_with_covariance(calibration, sun_directions(points.unix_s, calibration.site))
    known = np.all(np.isfinite(pixels), axis=-1)
    noise = calibration.evidence.sigma_px
    total = covariance[known] + (noise**2 if math.isfinite(noise) else 0.0) * np.eye(2) + 1e-12 * np.eye(2)
    apart = (points.pixels - pixels)[known]
    square = np.einsum("ni,ni->n", apart, np.linalg.solve(total, apart[..., None])[..., 0])
    return float(np.median(square)) / (2.0 * math.log(2.0)) if square.size else 0.0


def distance_px(first: Calibration, second: Calibration) -> float:
    """Return how far two cameras are apart at most over the sky that both see, px; infinite where they share none."""
    directions = hemisphere()
    apart = np.linalg.norm(project(first.camera, directions) - project(second.camera, directions), axis=-1)
    return float(np.nanmax(apart)) if np.any(np.isfinite(apart)) else math.inf


def disagreement(first: Calibration, second: Calibration) -> tuple[float, float]:
    """Return the share of the sky over which two calibrations contradict each other, and their largest distance in px.

    They contradict where their distance is beyond five of their joint sigmas.
    """
    square, worst_px = _squares(first, second)
    return float(np.mean(square > _FAR_SIGMAS**2)), worst_px


def _squares(first: Calibration, second: Calibration) -> tuple[FloatArray, float]:
    """Return (n,) squares of the distances over the sky in units of both covariances, and the largest distance, px."""
    directions = hemisphere(400)
    a, a_covariance = project_with_covariance(first, directions)
    b, b_covariance = project_with_covariance(second, directions)
    both = np.all(np.isfinite(a), axis=-1) & np.all(np.isfinite(b), axis=-1)
    if not np.any(both):
        return np.array([math.inf]), math.inf
    apart = (a - b)[both]
    joint = (a_covariance + b_covariance)[both] + 1e-12 * np.eye(2)
    square = np.einsum("ni,ni->n", apart, np.linalg.solve(joint, apart[..., None])[..., 0])
    return np.asarray(square), float(np.max(np.linalg.norm(apart, axis=-1)))
