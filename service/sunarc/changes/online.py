"""Kind and time of a change: explanations weighed by the likelihood of the last sightings.

The test of every sighting is cheap; only when several do not agree, or agree with a bias, are the explanations weighed
against each other.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from sunarc.calibration.answers.error_model import (
    CameraErrorModel,
    Predicted,
    build_error_model,
    joint_covariance,
    predicted,
    rotated,
)
from sunarc.calibration.evidence import (
    ONLINE,
    RARER,
    MixtureFit,
    PixelResiduals,
    Weighed,
    false_density,
    fit_inlier_mixture,
    log_evidence,
    matern_3_2,
    matern_5_2,
    most_probable,
)
from sunarc.calibration.model.pose_change import PoseChange
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.pose import conditioned, noise_px
from sunarc.calibration.solve.problem import by_elevation
from sunarc.calibration.start.initial_guess import ransac_rotation
from sunarc.changes.values import (
    CENTER,
    OF_LENS,
    ChangeKind,
    Hypothesis,
    Sighting,
    SightingWindow,
    WatchOptions,
    lens_freedom,
)
from sunarc.common.array_types import BoolArray, FloatArray, IntArray, picked, stacked
from sunarc.common.findings import Data, Finding
from sunarc.common.robust_statistics import finite
from sunarc.optics.camera import Camera, Param
from sunarc.optics.forward import by_direction, project_fast, project_with_rows_fast
from sunarc.optics.pose import rotation_matrix
from sunarc.sky.refraction import ASSUMED_AIR_SD, DAILY_AIR_SD, refraction_rad
from sunarc.sky.site import Site, pole_enu
from sunarc.sky.sun import sun_directions

# The last sightings held to a calibration: what it states of its errors, and a mount that wanders, allowed for.

_WANDER_S = 2.0 * 3600.0
"""Time over which a mast and its mount wander with the sun on them."""
_AIR_SD = math.hypot(ASSUMED_AIR_SD, DAILY_AIR_SD)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ResidualModel:
    """Residuals of sightings about a calibration, and their covariance without a change.

    Attributes
    ----------
    watch : the sightings.
    camera, error_model : of the calibration.
    at : where it sees the sun.
    covariance : (2n, 2n) of its errors there, px².
    sightings : the sightings' residuals and noise.
    wander : (n, n) covariance of the mount's wandering between their times, rad².
    air : (2n, 2n) covariance of the sun's places, their air being the assumed one, px².
    """

    watch: SightingWindow
    camera: Camera
    error_model: CameraErrorModel
    at: Predicted
    covariance: FloatArray
    sightings: PixelResiduals
    wander: FloatArray
    air: FloatArray


def make_residual_model(watch: SightingWindow, calibration: Calibration, options: WatchOptions) -> ResidualModel:
    """Return the residual model of sightings about a calibration."""
    error_model, camera = build_error_model(calibration), calibration.camera.at_every_angle()
    at = predicted(error_model, camera, watch.directions)
    residual = finite(watch.pixels - at.pixels)
    wander = wandering(watch.unix_s, options)
    air = _air_covariance(camera, watch.directions, calibration.site)
    sightings = PixelResiduals(
        residual=residual,
        variance=noise_px(calibration, watch.sigma_px) ** 2,
        false_density=false_density(residual, area_px2=float(camera.width * camera.height)),
    )
    return ResidualModel(
        watch=watch,
        camera=camera,
        error_model=error_model,
        at=at,
        covariance=joint_covariance(error_model, at) + _turn_covariance(error_model, at, wander) + air,
        sightings=sightings,
        wander=wander,
        air=air,
    )


def errors_at(window: ResidualModel, at: Predicted) -> FloatArray:
    """Return (2n, 2n): the covariance of the calibration's errors where another camera sees the sun."""
    return (
        joint_covariance(window.error_model, at) + _turn_covariance(window.error_model, at, window.wander) + window.air
    )


def wandering(unix_s: FloatArray, options: WatchOptions) -> FloatArray:
    """Return (n, n): the covariance of a mount's wandering, rad² (Matérn, once differentiable)."""
    return math.radians(options.wander_deg) ** 2 * matern_3_2(unix_s[:, None] - unix_s, _WANDER_S)


def _air_covariance(camera: Camera, directions: FloatArray, site: Site) -> FloatArray:
    """Return (2n, 2n): the covariance of the sun's places from air that is not the assumed one, alike for all, px²."""
    _, by_parameters = project_with_rows_fast(camera, directions)
    up = np.nan_to_num(by_elevation(directions, by_direction(camera, by_parameters)))
    shift = (up * (_AIR_SD * refraction_rad(directions, site))[:, None]).ravel()
    return np.outer(shift, shift)


def _turn_covariance(error_model: CameraErrorModel, at: Predicted, wander: FloatArray) -> FloatArray:
    flat = at.rows[..., error_model.rotation].reshape(-1, 3)
    return (flat @ flat.T) * np.kron(wander, np.ones((2, 2)))


# What changed, and when: explanations weighed by how likely they make the last sightings.
#
# Every explanation changes where the sun is predicted from one sighting on, with few free numbers (three for a turn,
# one for a clock, none for a mirrored image); its evidence is that of all sightings, before and after, false ones among
# them. Reference for the weighing: R. Kass and A. Raftery, "Bayes factors", J. Am. Stat. Assoc. 90 (1995).

_SMALLEST_ROTATION_RAD = math.radians(ONLINE.turn_deg)
_RECENT, _STRIDE, _FEW = 12, 3, 4
_LEAST_AGREEING = 4
"""Fewest sightings after a change that agree on it: three fix a rotation with one to check it."""
_CLEARER_THAN_CLOUD = 4.0
"""Powers of e by which any change must be better than cloud that draws the detections aside."""
_CLEARER_AT_FIRST = 6.0
"""The same while few sightings agree: cloud does it on most days, a change comes once a year, and ln 365 = 5.9."""
_FEW_AGREEING = 6
"""From so many agreeing sightings on `_CLEARER_THAN_CLOUD` holds: by then an episode of cloud has begun to drift."""
_LENS_CLEARER_THAN_CLOUD = 12.0
"""The same for a change of the lens, whose many free numbers follow a drift, and after which nothing is kept."""
_AS_LIKELY = 5.0
_CLOSE, _CLOSE_PX, _FAR_PX = 5.0, 0.5, 25.0
_LARGEST_SPREAD_PX2 = 1.0
_LONG, _ROUGH_PX = 10, 5.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScoredHypothesis:
    """Hypothesis of a change with its score."""

    of: Hypothesis
    mixture: MixtureFit

    @property
    def evidence(self) -> float:
        """Log likelihood of the sightings under the hypothesis."""
        return self.mixture.log_evidence

    @property
    def agreeing(self) -> int:
        """Number of sightings after the change that agree with it."""
        return int(self.mixture.inlier[self.of.first :].sum())


def best_hypothesis(
    window: ResidualModel, *, site: Site, small: bool, clock_stepped: bool | None, posed_from_few: bool
) -> PoseChange | None:
    """Return the change that explains the last sightings far better than no change; None without one.

    Parameters
    ----------
    window, site : see `update_window`.
    small : whether to look for changes so small that sightings were trusted in spite of them.
    clock_stepped, posed_from_few : see `update_window`.
    """
    nothing = fit_inlier_mixture(window.covariance, window.sightings, window.watch.trusted)
    best = best_rotations(window, small=small, least=_LEAST_AGREEING)
    best = best or _lens_hypotheses_alone(window)
    if not best:
        return None
    rivals = _list_rivals(window, best[0], site, posed_from_few=posed_from_few)
    weighed = [Weighed(one, one.evidence, rarity(one.of.kind, clock_stepped=clock_stepped)) for one in rivals]
    selected = most_probable([Weighed(best[0], best[0].evidence), *weighed]).explanation
    gain = selected.evidence - nothing.log_evidence
    if gain < ONLINE.gain or selected.agreeing < _LEAST_AGREEING:
        return None
    if selected.agreeing < int(nothing.inlier[selected.of.first :].sum()):
        return None
    if selected.evidence - drift_evidence(window, selected.of.first) < _clearer_than_cloud(selected):
        return None
    alike = [rotation.of.first for rotation in best if rotation.evidence > selected.evidence - _AS_LIKELY]
    near = {one.of.kind for one in rivals if one.of.kind in OF_LENS and one.evidence > selected.evidence - RARER}
    perhaps = tuple(sorted(near)) if selected.of.kind == "bump" else ()
    return describe_change(window, selected.of, selected.mixture, gain=gain, alike=alike, perhaps=perhaps)


def _clearer_than_cloud(scored: ScoredHypothesis) -> float:
    """Return the log odds by which a change must exceed an episode of cloud."""
    if scored.of.kind in OF_LENS:
        return _LENS_CLEARER_THAN_CLOUD
    return _CLEARER_AT_FIRST if scored.agreeing < _FEW_AGREEING else _CLEARER_THAN_CLOUD


def best_rotations(window: ResidualModel, *, small: bool, least: int) -> list[ScoredHypothesis]:
    """Return the possible turns from one sighting on, the best first; a change begins with an untrusted sighting."""
    n = len(window.watch)
    recent = range(max(n - _RECENT, 0), n - least + 1)
    coarse = sorted({*recent, *range(0, max(n - _RECENT, 0), _STRIDE)})
    starts = coarse if small else [k for k in range(n - least + 1) if not window.watch.trusted[k]]
    candidates = _find_rotations(window, starts, least=least)
    if candidates and small:
        best = candidates[0].of.first
        near = range(max(best - _STRIDE, 0), min(best + _STRIDE, n - least) + 1)
        candidates += _find_rotations(window, [k for k in near if k not in starts], least=least)
    return sorted(candidates, key=lambda rotation: -rotation.evidence)


def _find_rotations(window: ResidualModel, starts: list[int], *, least: int) -> list[ScoredHypothesis]:
    found = [rotation_from(window, first, least=least) for first in starts]
    return sorted((rotation for rotation in found if rotation is not None), key=lambda rotation: -rotation.evidence)


def _score_hypothesis(window: ResidualModel, explanation: Hypothesis) -> ScoredHypothesis:
    """Return an explanation with its evidence."""
    before = np.arange(explanation.first)
    after = predicted(window.error_model, explanation.camera, explanation.sightings.directions)
    at = stacked([picked(window.at, before), after])
    residual = np.concatenate([window.sightings.residual[before], finite(explanation.sightings.pixels - after.pixels)])
    residual[explanation.first :] -= after.rows @ explanation.mean
    # free numbers are integrated out by adding their covariance to that of the sightings after the change
    free = (after.rows @ explanation.free).reshape(2 * len(explanation.sightings), -1)
    covariance = errors_at(window, at)
    covariance[2 * before.size :, 2 * before.size :] += free @ free.T
    sightings = replace(window.sightings, residual=residual)
    off = np.linalg.norm(residual[explanation.first :] + after.rows @ explanation.mean, axis=-1)
    rough = _FAR_PX if explanation.kind in OF_LENS else _CLOSE_PX
    close = off < _CLOSE * np.sqrt(sightings.variance[explanation.first :]) + rough
    inlier = np.concatenate([window.watch.trusted[before], close])
    return ScoredHypothesis(of=explanation, mixture=fit_inlier_mixture(covariance, sightings, inlier))


def rotation_from(window: ResidualModel, first: int, *, least: int) -> ScoredHypothesis | None:
    """Return the turn that most sightings from one on agree with; None where fewer than `least` do."""
    spread = np.diag(window.covariance).reshape(-1, 2).mean(axis=1)[first:]
    tolerance = np.sqrt(window.sightings.variance[first:] + np.minimum(spread, _LARGEST_SPREAD_PX2))
    turn = _agreed_turn(window, first, tolerance)
    misfit = finite(turn.sightings.pixels - project_fast(turn.camera, turn.sightings.directions))
    agree = np.linalg.norm(misfit, axis=-1) < _CLOSE * tolerance
    return _score_hypothesis(window, turn) if np.sum(agree) >= least else None


def _agreed_turn(window: ResidualModel, first: int, tolerance_px: FloatArray) -> Hypothesis:
    """Return the turn that most sightings from one on agree with, within tolerances (n,)."""
    since = window.watch.select(slice(first, None))
    rotation = ransac_rotation(window.camera, since.directions, since.pixels, tolerance_px)
    size = max(float(np.linalg.norm(rotation)), _SMALLEST_ROTATION_RAD)
    return rotation_hypothesis(window, first, rotation, size * np.eye(3), kind="bump")


def rotation_hypothesis(
    window: ResidualModel, first: int, rotation: FloatArray, freedom: FloatArray, *, kind: ChangeKind
) -> Hypothesis:
    """Return the hypothesis of a rotation from one sighting on, with its prior."""
    size = window.error_model.mean.size
    free, mean = np.zeros((size, freedom.shape[1])), np.zeros(size)
    free[window.error_model.rotation], mean[window.error_model.rotation] = freedom, -rotation
    return Hypothesis(
        kind=kind,
        first=first,
        camera=rotated(window.camera, rotation),
        sightings=window.watch.select(slice(first, None)),
        free=free,
        mean=mean,
    )


def _list_rivals(
    window: ResidualModel, best: ScoredHypothesis, site: Site, *, posed_from_few: bool
) -> list[ScoredHypothesis]:
    """Return the other explanations of the part that the best turn explains."""
    still = rotation_hypothesis(window, best.of.first, np.zeros(3), np.zeros((3, 0)), kind="bump")
    others = [
        clock_hypothesis(window, best, site),
        *_list_flips(window, site, best.of.first),
        lens_hypothesis(window, best.of),
    ]
    others += [lens_hypothesis(window, still, kind=kind) for kind in ("refocus", "shift")]
    complete = rotation_from(window, 0, least=_FEW) if posed_from_few and best.of.first > 0 else None
    if complete is not None:
        others += [lens_hypothesis(window, complete.of, kind=kind) for kind in OF_LENS]
    return [_score_hypothesis(window, other) for other in others]


def clock_hypothesis(window: ResidualModel, best: ScoredHypothesis, site: Site) -> Hypothesis:
    """Return the turn about the celestial pole alone that comes nearest to a turn."""
    pole = rotation_matrix(window.camera.rotation_cam_enu) @ pole_enu(site)
    nearest = float(-best.of.mean[window.error_model.rotation] @ pole)
    size = max(abs(nearest), _SMALLEST_ROTATION_RAD)
    rotation = nearest * pole
    return rotation_hypothesis(window, best.of.first, rotation, size * pole[:, None], kind="clock")


def _list_flips(window: ResidualModel, site: Site, first: int) -> list[Hypothesis]:
    """Return the explanations without any free number: a mirrored image, a site with a wrong sign."""
    watch, size = window.watch.select(slice(first, None)), window.error_model.mean.size
    plain = Hypothesis(
        kind="mirrored",
        first=first,
        camera=window.camera,
        sightings=watch,
        free=np.zeros((size, 1)),
        mean=np.zeros(size),
    )
    last = np.array([window.camera.width - 1.0, window.camera.height - 1.0])
    flipped = [np.where(axis, last - watch.pixels, watch.pixels) for axis in ([1, 0], [0, 1])]
    mirrored = [replace(plain, sightings=replace(watch, pixels=pixels)) for pixels in flipped]
    sites = [
        replace(site, latitude=-site.latitude),
        replace(site, longitude=-site.longitude),
        replace(site, latitude=-site.latitude, longitude=-site.longitude),
    ]
    return mirrored + [
        replace(plain, kind="site", sightings=replace(watch, directions=sun_directions(watch.unix_s, other)))
        for other in sites
    ]


def lens_hypothesis(window: ResidualModel, rotation: Hypothesis, *, kind: ChangeKind = "lens") -> Hypothesis:
    """Return a turn with a lens of which little is known, or of which only the focus or the place is another."""
    names = [int(one) for one in window.error_model.selected]
    columns = lens_freedom(window.camera, names, OF_LENS[kind], ONLINE)
    return replace(rotation, kind=kind, free=np.concatenate([rotation.free, columns], axis=1))


def _lens_hypotheses_alone(window: ResidualModel) -> list[ScoredHypothesis]:
    """Return lens changes where sightings have long disagreed and no turn explains them."""
    late = window.watch.trusted[-_LONG:]
    if late.size < _LONG or np.any(late):
        return []
    first = int(np.flatnonzero(window.watch.trusted)[-1]) + 1 if np.any(window.watch.trusted) else 0
    turn = _agreed_turn(window, first, np.full(len(window.watch) - first, _ROUGH_PX))
    return [_score_hypothesis(window, lens_hypothesis(window, turn))]


def rarity(kind: ChangeKind, *, clock_stepped: bool | None) -> float:
    """Return the log odds of a turn against a kind of change, before any sighting.

    A clock that the host set is not rarer, and one that nothing watches (None) is set as often as a camera is turned.
    """
    if kind == "clock" and clock_stepped is not False:
        return 0.0 if clock_stepped is None else -RARER
    return ONLINE.rarer.get(kind, RARER)


# Evidence of an episode of cloud: detections that drift away smoothly while camera, clock and lens are as they were.
#
# The drift of each axis is a Gaussian process in time (Matérn, twice differentiable) that begins at one sighting, or a
# ramp from zero, as under a cloud edge that passes at a constant speed. A turn of the camera is constant at once; what
# cloud does to a detection is not.

_AMPLITUDES_PX = (0.1, 0.5, 2.0, 8.0)
"""1-sigma of the drift: from that of noise to the largest that detectors were seen to follow."""
_TIMES_S = (200.0, 700.0, 2400.0)
"""Correlation times: episodes of a few minutes to an hour."""
_SLOPES_PX_S = (0.0005, 0.002, 0.008)
"""1-sigma of a ramp's slope: 0.5 to 8 px in 1000 s."""
_RAMP_AMPLITUDE_PX, _RAMP_TIME_S = 0.5, 2400.0
"""Departure of a ramp from a straight line; it also takes up a begin between two sightings."""
_ONSETS_BACK = (0, 2, 6, 14)
"""Sightings before the change at which the episode may have begun; a slow one is trusted at first."""


class Drift(NamedTuple):
    """Drift: its first sighting, amplitude (px), correlation time (s), and the 1-sigma slope (px/s) of a ramp."""

    begin: int
    amplitude_px: float
    time_s: float
    slope_px_s: float = 0.0


def drift_evidence(window: ResidualModel, first: int) -> float:
    """Return the log evidence of the last sightings under an episode of cloud, averaged over its unknown numbers.

    Parameters
    ----------
    window : the sightings.
    first : the first sighting after the change that the episode competes with.
    """
    untrusted = np.flatnonzero(~window.watch.trusted)
    begins = {max(first - back, 0) for back in _ONSETS_BACK}
    # the episode need not begin with the change: the change may count sightings before it as false
    begins |= find_run_starts(untrusted) | find_run_starts(untrusted[untrusted <= first])
    drifts = tuple(_list_drifts(begins))
    reached = [
        log_evidence(drift_covariance(window, drift), window.sightings, inliers_from(window, drift.begin))
        for drift in drifts
    ]
    best, likeliest = max(zip(reached, drifts, strict=True), key=lambda item: item[0])
    # the likeliest one once more, with false sightings among the episode's
    inliers = inliers_from(window, likeliest.begin)
    among_false = fit_inlier_mixture(drift_covariance(window, likeliest), window.sightings, inliers).log_evidence
    return float(np.logaddexp.reduce(reached)) - math.log(len(reached)) + max(among_false - best, 0.0)


def _list_drifts(begins: Iterable[int]) -> Iterator[Drift]:
    """Yield the drifts that are averaged over, all equally likely."""
    for begin in sorted(begins):
        for amplitude_px, time_s in itertools.product(_AMPLITUDES_PX, _TIMES_S):
            yield Drift(begin, amplitude_px, time_s)
        for slope_px_s in _SLOPES_PX_S:
            yield Drift(begin, _RAMP_AMPLITUDE_PX, _RAMP_TIME_S, slope_px_s)


def inliers_from(window: ResidualModel, begin: int) -> BoolArray:
    """Return which sightings are trusted before one of them, and all from it on."""
    return np.asarray(window.watch.trusted | (np.arange(len(window.watch)) >= begin))


def find_run_starts(rows: IntArray) -> set[int]:
    """Return where the last and the longest run of rows begin; a single row between does not end a run."""
    runs = [run for run in np.split(rows, np.flatnonzero(np.diff(rows) > 2) + 1) if run.size]
    longest = max(map(len, runs), default=0)
    return {int(run[0]) for run in runs if run is runs[-1] or len(run) == longest}


def drift_covariance(window: ResidualModel, drift: Drift) -> FloatArray:
    """Return the covariance (2n, 2n) of the sightings' errors with a drift from one of them on, px²."""
    begin, all_times = drift.begin, window.watch.unix_s
    times = all_times[begin:]
    kernel = drift.amplitude_px**2 * matern_5_2(times[:, None] - times, drift.time_s)
    # the kernel of a line without intercept (ibid., section 4.2.2), zero at the sighting before the first displaced one
    elapsed = times - all_times[max(begin - 1, 0)]
    kernel += drift.slope_px_s**2 * np.outer(elapsed, elapsed)
    covariance = window.covariance.copy()
    covariance[2 * begin :: 2, 2 * begin :: 2] += kernel
    covariance[2 * begin + 1 :: 2, 2 * begin + 1 :: 2] += kernel
    return covariance


# A change as a finding, with its size.

_SECOND_RAD = 7.292e-5
_UNITS: dict[str, str] = {"clock": "s", "refocus": "%", "shift": "px"}
_PERHAPS: dict[ChangeKind, str] = {
    "lens": "another lens",
    "refocus": "a refocused lens",
    "shift": "a sensor that shifted behind the lens",
}


def describe_change(
    window: ResidualModel,
    explanation: Hypothesis,
    mixture: MixtureFit,
    *,
    gain: float,
    alike: list[int],
    perhaps: tuple[ChangeKind, ...] = (),
) -> PoseChange:
    """Return the change that a hypothesis stands for, with its size.

    Parameters
    ----------
    window, explanation, mixture : the sightings, their explanation, and its posterior.
    gain : log odds against no change.
    alike : first sightings after a change that explain nearly as well.
    perhaps : other kinds that do.
    """
    first, times = explanation.first, window.watch.unix_s
    sure = first + int(np.argmax(mixture.inlier[first:]))
    early, late = min([first, *alike]), max([sure, *alike])
    size, sigma, rotation_deg, covariance_deg2 = _measure_change(window, explanation, mixture)
    agreeing, of = int(mixture.inlier[first:].sum()), len(window.watch) - first
    data: Data = {
        "size": size,
        "sigma": sigma,
        "agreeing": agreeing,
        "of": of,
        "alternatives": _format_alternatives(perhaps),
    }
    return PoseChange(
        time=float(times[sure]),
        bracket=(float(times[max(early - 1, 0)]), float(times[late])),
        rotation_deg=rotation_deg,
        covariance_deg2=covariance_deg2,
        cause=explanation.kind,
        gain=gain,
        perhaps=perhaps,
        finding=Finding(f"changed_{explanation.kind}", data),
    )


def change_finding(change: PoseChange) -> Finding:
    """Return the finding of a change found online."""
    if change.finding is None:
        raise ValueError(f"a change by {change.cause} has no finding")
    return change.finding


def change_details(change: PoseChange) -> dict[str, Any]:
    """Return the stored details of a change: its numbers and names, the sentence and the remedy.

    `size` is in degrees of a turn, seconds of a clock, px of a shifted sensor, % of the focal length; 0 where that has
    no meaning.
    """
    finding = change_finding(change)
    return {
        "kind": change.cause,
        "at_unix_s": change.time,
        "earliest_unix_s": change.bracket[0],
        "latest_unix_s": change.bracket[1],
        "size_sigma": finding.data["sigma"],
        "unit": _UNITS.get(change.cause, "degrees"),
        "gain": change.gain,
        "perhaps": ", ".join(change.perhaps),
        **finding.data,
        "text": finding.text,
        "remedy": finding.remedy,
    }


def _format_alternatives(perhaps: tuple[ChangeKind, ...]) -> str:
    return f" (or {', or '.join(_PERHAPS[kind] for kind in perhaps)}: cannot be distinguished yet)" if perhaps else ""


def _measure_change(
    window: ResidualModel, explanation: Hypothesis, mixture: MixtureFit
) -> tuple[float, float, FloatArray, FloatArray]:
    """Return the size of a change in its unit and its 1-sigma, the turn (3,) about east, north and up, its covariance.

    All are 0 where they have no meaning.
    """
    names, rotation, kind = list(window.error_model.selected), window.error_model.rotation, explanation.kind
    still = 0.0, 0.0, np.zeros(3), np.zeros((3, 3))
    if kind not in ("bump", "clock", "refocus", "shift") or not {Param.FOCAL_LENGTH_X_PX, *CENTER} <= set(names):
        return still
    after = _condition_on_agreeing(window, explanation, mixture)
    change = after.mean.copy()
    change[rotation] -= explanation.mean[rotation]
    axis, unit = np.zeros(change.size), 1.0
    if kind == "clock":
        axis, unit = explanation.free[:, 0] / np.linalg.norm(explanation.free[:, 0]), -1.0 / _SECOND_RAD
    elif kind == "refocus":
        axis[names.index(Param.FOCAL_LENGTH_X_PX)], unit = 1.0, 100.0 / window.camera.focal_length_px[0]
    else:
        of = rotation if kind == "bump" else [names.index(i) for i in CENTER]
        axis[of] = change[of] / max(float(np.linalg.norm(change[of])), 1e-12)
        unit = math.degrees(1.0) if kind == "bump" else 1.0
    sigma = math.sqrt(max(float(axis @ after.covariance @ axis), 0.0))
    # a camera that turns one way sees the sky turn the other
    to_enu = -math.degrees(1.0) * rotation_matrix(window.camera.rotation_cam_enu).T
    covariance = to_enu @ after.covariance[np.ix_(rotation, rotation)] @ to_enu.T
    return unit * float(axis @ change), abs(unit) * sigma, to_enu @ change[rotation], covariance


def _condition_on_agreeing(window: ResidualModel, explanation: Hypothesis, mixture: MixtureFit) -> CameraErrorModel:
    """Return the error model of the hypothesis's camera, conditioned on the sightings that agree with it."""
    free = explanation.free
    before = replace(
        window.error_model, mean=explanation.mean, covariance=window.error_model.covariance + free @ free.T
    )
    at = predicted(window.error_model, explanation.camera, explanation.sightings.directions)
    inlier = mixture.inlier[explanation.first :]
    noise = window.sightings.variance[explanation.first :][inlier]
    sightings = PixelResiduals(
        residual=finite(explanation.sightings.pixels - at.pixels)[inlier], variance=noise, false_density=0.0 * noise
    )
    return conditioned(before, picked(at, inlier), sightings)


REMEMBERED = 56
_TRUSTED_SQUARE = 30.0
_LATEST = 6
_DISTRUSTED = 3
_SPANS = (4, 8, 16, 32)
_BIASED = 25.0


def update_window(
    watch: SightingWindow,
    sighting: Sighting,
    *,
    calibration: Calibration,
    site: Site,
    options: WatchOptions,
    clock_stepped: bool | None = False,
    posed_from_few: bool = False,
) -> tuple[SightingWindow, PoseChange | None]:
    """Return the window with one more sighting, and the change that it shows, if any.

    Parameters
    ----------
    watch : what is remembered.
    sighting : the sighting, later than those remembered.
    calibration : what it is held to.
    site : where the camera is said to stand.
    options : what is not reported as a change.
    clock_stepped : whether the host says that its clock was set while these sightings were made; None where it dates
        none of them.
    posed_from_few : whether the calibration was posed from these very sightings: then its lens is in question too.
    """
    before = watch.last(REMEMBERED - 1)
    window = make_residual_model(
        before.append_sighting(sighting, trusted=True, surprise=np.zeros(2)), calibration, options
    )
    surprise = _whitened_surprise(window)
    trusted = bool(surprise @ surprise < _TRUSTED_SQUARE)
    grown = before.append_sighting(sighting, trusted=trusted, surprise=surprise if trusted else np.zeros(2))
    one_sided = biased(grown)
    if not (one_sided or distrusted(grown)):
        return grown, None
    window = replace(window, watch=grown)
    return grown, best_hypothesis(
        window, site=site, small=one_sided, clock_stepped=clock_stepped, posed_from_few=posed_from_few
    )


def biased(watch: SightingWindow) -> bool:
    """Return whether the recent trusted sightings all lie to one side of the prediction."""
    agreeing = watch.surprise[watch.trusted]
    spans = [agreeing[-span:] for span in _SPANS if agreeing.shape[0] >= span]
    return any(float(np.sum(part.sum(axis=0) ** 2)) / part.shape[0] > _BIASED for part in spans)


def distrusted(watch: SightingWindow) -> bool:
    """Return whether half of the last sightings, the very last included, disagree with those before."""
    late = watch.trusted[-_LATEST:]
    return not watch.trusted[-1] and int(np.sum(~late)) >= _DISTRUSTED


def _whitened_surprise(window: ResidualModel) -> FloatArray:
    """Return (2,): the distance of the last sighting from its prediction by the trusted ones before, whitened."""
    trusted_axes = np.repeat(window.watch.trusted, 2)
    trusted_axes[-2:] = False
    noise = np.repeat(window.sightings.variance, 2)
    mean, spread = window.sightings.residual[-1], window.covariance[-2:, -2:] + np.diag(noise[-2:])
    if np.any(trusted_axes):
        before = window.covariance[np.ix_(trusted_axes, trusted_axes)] + np.diag(noise[trusted_axes])
        shared = window.covariance[trusted_axes][:, -2:]
        from scipy.linalg import cho_solve, cholesky  # noqa: PLC0415 - a fit of one day loads without scipy

        gain = cho_solve((cholesky(before, lower=True), True), shared)
        mean = mean - gain.T @ window.sightings.residual.ravel()[trusted_axes]
        spread = spread - gain.T @ shared
    # whitened: the sum of squares is then chi-square of two if nothing has changed
    root = np.linalg.cholesky(0.5 * (spread + spread.T))
    return np.linalg.solve(root, mean) if math.isfinite(float(mean @ mean)) else np.full(2, 1e6)
