"""What changed, and when: explanations weighed by how likely they make the last sightings.

Every explanation changes where the sun is predicted from one sighting on, with few free numbers (three for a turn, one
for a clock, none for a mirrored image); its evidence is that of all sightings, before and after, false ones among them.
Reference for the weighing: R. Kass and A. Raftery, "Bayes factors", J. Am. Stat. Assoc. 90 (1995).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.change_detection.cloud_drift import drift_evidence
from sunarc.calibration.change_detection.report import describe_change
from sunarc.calibration.change_detection.residual_model import ResidualModel, errors_at
from sunarc.calibration.change_detection.values import Change, ChangeKind, Hypothesis
from sunarc.calibration.pose.error_model import joined, predicted, rotated
from sunarc.calibration.pose.gaussian_conditioning import MixtureFit, Sightings, fit_inlier_mixture
from sunarc.calibration.pose.rotation_consensus import ransac_rotation
from sunarc.calibration.robust_loss import finite
from sunarc.optics.camera import Param
from sunarc.optics.forward import project_fast
from sunarc.optics.pose import rotation_matrix
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions

_SMALLEST_ROTATION_RAD = math.radians(0.02)
_RECENT, _STRIDE, _FEW = 12, 3, 4
_LEAST_AGREEING = 4
"""Fewest sightings after a change that agree on it: three fix a rotation with one to check it."""
_MIN_LOG_BAYES_FACTOR = 20.0
"""By how many powers of e a change must explain the sightings better than none; Kass and Raftery (1995) call 5 very
strong, but here the question is put after every sighting."""
_CLEARER = 6.0
"""Powers of e by which a rarer explanation must be better than a turn to be named."""
_CLEARER_THAN_CLOUD = 4.0
"""Powers of e by which any change must be better than cloud that draws the detections aside."""
_CLEARER_AT_FIRST = 6.0
"""The same while few sightings agree: cloud does it on most days, a change comes once a year, and ln 365 = 5.9."""
_FEW_AGREEING = 6
"""From so many agreeing sightings on `_CLEARER_THAN_CLOUD` holds: by then an episode of cloud has begun to drift."""
_LENS_CLEARER_THAN_CLOUD = 12.0
"""The same for a change of the lens, whose many free numbers follow a drift, and after which nothing is kept."""
_CLOCK_PRIOR = 5.0
"""Powers of e that a clock is less likely than a bump where the host's clock reports no step."""
_AS_LIKELY = 5.0
_CLOSE, _CLOSE_PX, _FAR_PX = 5.0, 0.5, 25.0
_LARGEST_SPREAD_PX2 = 1.0
_LONG, _ROUGH_PX = 10, 5.0
_FOCAL_SHARE, _CENTER_SHARE, _RADIAL = 0.05, 0.03, 0.02
_CENTER = (Param.PRINCIPAL_POINT_X_PX, Param.PRINCIPAL_POINT_Y_PX)
_OF_LENS: dict[ChangeKind, tuple[Param, ...]] = {
    "refocus": (Param.FOCAL_LENGTH_X_PX,),
    "shift": _CENTER,
    "lens": (Param.FOCAL_LENGTH_X_PX, *_CENTER, Param.K2, Param.K3),
}
"""Which of the camera's parameters may be others after a change of the lens."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScoredHypothesis:
    """An explanation with what the sightings say of it."""

    of: Hypothesis
    mixture: MixtureFit

    @property
    def evidence(self) -> float:
        """Logarithm of how likely it makes them."""
        return self.mixture.log_evidence

    @property
    def agreeing(self) -> int:
        """How many sightings after the change agree with it."""
        return int(self.mixture.inlier[self.of.first :].sum())


def best_hypothesis(
    window: ResidualModel, *, site: Site, small: bool, clock_stepped: bool, posed_from_few: bool
) -> Change | None:
    """Return the change that explains the last sightings far better than none does; None where there is none.

    Parameters
    ----------
    window, site : see `update_window`.
    small : whether to look for changes so small that sightings were trusted in spite of them.
    clock_stepped, posed_from_few : see `update_window`.
    """
    nothing = fit_inlier_mixture(window.covariance, window.sightings, window.watch.trusted)
    best = _best_rotation(window, small=small, least=_LEAST_AGREEING)
    best = best or _lens_alone(window)
    if not best:
        return None
    rivals = _rivals(window, best[0], site, posed_from_few=posed_from_few)
    selected = _most_probable(best[0], rivals, clock_stepped=clock_stepped)
    gain = selected.evidence - nothing.log_evidence
    if gain < _MIN_LOG_BAYES_FACTOR or selected.agreeing < _LEAST_AGREEING:
        return None
    if selected.agreeing < int(nothing.inlier[selected.of.first :].sum()):
        return None
    if selected.evidence - drift_evidence(window, selected.of.first) < _clearer_than_cloud(selected):
        return None
    alike = [rotation.of.first for rotation in best if rotation.evidence > selected.evidence - _AS_LIKELY]
    near = {one.of.kind for one in rivals if one.of.kind in _OF_LENS and one.evidence > selected.evidence - _CLEARER}
    perhaps = tuple(sorted(near)) if selected.of.kind == "bump" else ()
    return describe_change(window, selected.of, selected.mixture, gain=gain, alike=alike, perhaps=perhaps)


def _clearer_than_cloud(scored: ScoredHypothesis) -> float:
    """Return by how many powers of e a change must be better than an episode of cloud."""
    if scored.of.kind in _OF_LENS:
        return _LENS_CLEARER_THAN_CLOUD
    return _CLEARER_AT_FIRST if scored.agreeing < _FEW_AGREEING else _CLEARER_THAN_CLOUD


def _best_rotation(window: ResidualModel, *, small: bool, least: int) -> list[ScoredHypothesis]:
    """Return the turns from one sighting on that may be, the best first; a change begins with what was not trusted."""
    n = len(window.watch)
    recent = range(max(n - _RECENT, 0), n - least + 1)
    coarse = sorted({*recent, *range(0, max(n - _RECENT, 0), _STRIDE)})
    starts = coarse if small else [k for k in range(n - least + 1) if not window.watch.trusted[k]]
    candidates = _rotations(window, starts, least=least)
    if candidates and small:
        best = candidates[0].of.first
        near = range(max(best - _STRIDE, 0), min(best + _STRIDE, n - least) + 1)
        candidates += _rotations(window, [k for k in near if k not in starts], least=least)
    return sorted(candidates, key=lambda rotation: -rotation.evidence)


def _rotations(window: ResidualModel, starts: list[int], *, least: int) -> list[ScoredHypothesis]:
    found = [_rotation_from(window, first, least=least) for first in starts]
    return sorted((rotation for rotation in found if rotation is not None), key=lambda rotation: -rotation.evidence)


def _weigh(window: ResidualModel, explanation: Hypothesis) -> ScoredHypothesis:
    """Return an explanation with its evidence."""
    before = np.arange(explanation.first)
    after = predicted(window.error_model, explanation.camera, explanation.directions)
    at = joined(window.at.select(before), after)
    residual = np.concatenate([window.sightings.residual[before], finite(explanation.pixels - after.pixels)])
    residual[explanation.first :] -= after.rows @ explanation.mean
    # free numbers are integrated out by adding their covariance to that of the sightings after the change
    free = np.concatenate(
        [np.zeros((2 * before.size, explanation.free.shape[1])), _flat(after.rows @ explanation.free)]
    )
    covariance = errors_at(window, at) + free @ free.T
    sightings = Sightings(
        residual=residual, variance=window.sightings.variance, false_density=window.sightings.false_density
    )
    off = np.linalg.norm(residual[explanation.first :] + after.rows @ explanation.mean, axis=-1)
    rough = _FAR_PX if explanation.kind in _OF_LENS else _CLOSE_PX
    close = off < _CLOSE * np.sqrt(sightings.variance[explanation.first :]) + rough
    inlier = np.concatenate([window.watch.trusted[before], close])
    return ScoredHypothesis(of=explanation, mixture=fit_inlier_mixture(covariance, sightings, inlier))


def _flat(rows: FloatArray) -> FloatArray:
    return rows.reshape(-1, rows.shape[-1])


def _rotation_from(window: ResidualModel, first: int, *, least: int) -> ScoredHypothesis | None:
    """Return the turn that most sightings from one on agree with; None where fewer than `least` do."""
    watch = window.watch
    directions, pixels = watch.directions[first:], watch.pixels[first:]
    spread = np.diag(window.covariance).reshape(-1, 2).mean(axis=1)[first:]
    tolerance = np.sqrt(window.sightings.variance[first:] + np.minimum(spread, _LARGEST_SPREAD_PX2))
    rotation = ransac_rotation(window.camera, directions, pixels, tolerance)
    misfit = finite(pixels - project_fast(rotated(window.camera, rotation), directions))
    if np.sum(np.linalg.norm(misfit, axis=-1) < _CLOSE * tolerance) < least:
        return None
    size = max(float(np.linalg.norm(rotation)), _SMALLEST_ROTATION_RAD)
    return _weigh(window, _rotation_hypothesis(window, first, rotation, size * np.eye(3), kind="bump"))


def _rotation_hypothesis(
    window: ResidualModel, first: int, rotation: FloatArray, freedom: FloatArray, *, kind: ChangeKind
) -> Hypothesis:
    size = window.error_model.mean.size
    free, mean = np.zeros((size, freedom.shape[1])), np.zeros(size)
    free[window.error_model.rotation], mean[window.error_model.rotation] = freedom, -rotation
    return Hypothesis(
        kind=kind,
        first=first,
        camera=rotated(window.camera, rotation),
        directions=window.watch.directions[first:],
        pixels=window.watch.pixels[first:],
        free=free,
        mean=mean,
    )


def _rivals(
    window: ResidualModel, best: ScoredHypothesis, site: Site, *, posed_from_few: bool
) -> list[ScoredHypothesis]:
    """Return the other explanations of what the best turn explains."""
    still = _rotation_hypothesis(window, best.of.first, np.zeros(3), np.zeros((3, 0)), kind="bump")
    others = [_clock(window, best, site), *_flips(window, site, best.of.first), _other_lens(window, best.of)]
    others += [_other_lens(window, still, kind=kind) for kind in ("refocus", "shift")]
    complete = _rotation_from(window, 0, least=_FEW) if posed_from_few and best.of.first > 0 else None
    if complete is not None:
        others += [_other_lens(window, complete.of, kind=kind) for kind in _OF_LENS]
    return [_weigh(window, other) for other in others]


def _clock(window: ResidualModel, best: ScoredHypothesis, site: Site) -> Hypothesis:
    """Return the turn about the celestial pole alone that comes nearest to a turn."""
    pole = rotation_matrix(window.camera.rotation_cam_enu) @ pole_of(site)
    nearest = float(-best.of.mean[window.error_model.rotation] @ pole)
    size = max(abs(nearest), _SMALLEST_ROTATION_RAD)
    rotation = nearest * pole
    return _rotation_hypothesis(window, best.of.first, rotation, size * pole[:, None], kind="clock")


def pole_of(site: Site) -> FloatArray:
    """Return the direction of the celestial north pole, east-north-up."""
    latitude = math.radians(site.latitude)
    return np.array([0.0, math.cos(latitude), math.sin(latitude)])


def _flips(window: ResidualModel, site: Site, first: int) -> list[Hypothesis]:
    """Return the explanations without any free number: a mirrored image, a site with a wrong sign."""
    watch, size = window.watch, window.error_model.mean.size
    plain = Hypothesis(
        kind="mirrored",
        first=first,
        camera=window.camera,
        directions=watch.directions[first:],
        pixels=watch.pixels[first:],
        free=np.zeros((size, 1)),
        mean=np.zeros(size),
    )
    last = np.array([window.camera.width - 1.0, window.camera.height - 1.0])
    mirrored = [replace(plain, pixels=np.where(axis, last - plain.pixels, plain.pixels)) for axis in ([1, 0], [0, 1])]
    sites = [
        replace(site, latitude=-site.latitude),
        replace(site, longitude=-site.longitude),
        replace(site, latitude=-site.latitude, longitude=-site.longitude),
    ]
    return mirrored + [
        replace(plain, kind="site", directions=sun_directions(watch.unix_s[first:], other)) for other in sites
    ]


def _other_lens(window: ResidualModel, rotation: Hypothesis, *, kind: ChangeKind = "lens") -> Hypothesis:
    """Return a turn with a lens of which little is known, or of which only the focus or the place is another."""
    names = list(window.error_model.selected)
    camera, size = window.camera, window.error_model.mean.size
    spread = {
        Param.FOCAL_LENGTH_X_PX: _FOCAL_SHARE * camera.focal_length_px[0],
        Param.PRINCIPAL_POINT_X_PX: _CENTER_SHARE * camera.width,
        Param.PRINCIPAL_POINT_Y_PX: _CENTER_SHARE * camera.height,
        Param.K2: _RADIAL,
        Param.K3: _RADIAL,
    }
    columns = np.zeros((size, len(_OF_LENS[kind])))
    for column, index in enumerate(_OF_LENS[kind]):
        if index in names:
            columns[names.index(index), column] = spread[index]
    if Param.FOCAL_LENGTH_Y_PX in names:  # both focal lengths change alike
        columns[names.index(Param.FOCAL_LENGTH_Y_PX)] = columns[names.index(Param.FOCAL_LENGTH_X_PX)]
    return replace(rotation, kind=kind, free=np.concatenate([rotation.free, columns], axis=1))


def _lens_alone(window: ResidualModel) -> list[ScoredHypothesis]:
    """Return a change of the lens where nothing has agreed for long, and no turn explains it."""
    late = window.watch.trusted[-_LONG:]
    if late.size < _LONG or np.any(late):
        return []
    first = int(np.flatnonzero(window.watch.trusted)[-1]) + 1 if np.any(window.watch.trusted) else 0
    directions, pixels = window.watch.directions[first:], window.watch.pixels[first:]
    rotation = ransac_rotation(window.camera, directions, pixels, np.full(pixels.shape[0], _ROUGH_PX))
    size = max(float(np.linalg.norm(rotation)), _SMALLEST_ROTATION_RAD)
    of_rotation = _rotation_hypothesis(window, first, rotation, size * np.eye(3), kind="bump")
    return [_weigh(window, _other_lens(window, of_rotation))]


def _most_probable(best: ScoredHypothesis, rivals: list[ScoredHypothesis], *, clock_stepped: bool) -> ScoredHypothesis:
    """Return the explanation to name: a turn, unless a rarer one is clearly better, or the host's clock was set."""

    def handicap(weighed: ScoredHypothesis) -> float:
        if weighed.of.kind == "clock":
            return -_CLEARER if clock_stepped else _CLOCK_PRIOR
        return _CLEARER

    return max([best, *rivals], key=lambda one: one.evidence - (0.0 if one is best else handicap(one)))
