"""Residuals of an epoch that its state does not explain: a change or drift among them, by the days' own noise.

A sun's track runs smoothly over the image whatever the camera is: its scatter about a smooth arc is the day's own
noise, known before any camera is. By it a state's residuals are explained by a change of the clock, of the pose, or of
the lens from one sighting on, or by none: the evidences are compared (`calibration.evidence`). So is that of a mount or
a clock that drifts all the time, which no step explains as well. What detectors in photographs do wrong all through a
half-day (cloud, glare) is no noise that many sightings average out, and is allowed for by half-days.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from sunarc.calibration.evidence import EPOCHS, Explained, Weighed, explained, most_probable, step_evidences
from sunarc.calibration.model.pose_change import PoseChange
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.quality.day_arcs import smooth_arc, smooth_days
from sunarc.changes.values import CENTER, lens_freedom
from sunarc.common.array_types import FloatArray, IntArray
from sunarc.common.findings import Finding
from sunarc.common.robust_statistics import off_neighbours, robust_sigma
from sunarc.common.utc import DAY_S
from sunarc.optics.camera import Camera, Param
from sunarc.optics.forward import by_direction, project_fast, project_with_rows_fast
from sunarc.sky.days import SECONDS_PER_DEGREE, solar_days
from sunarc.sky.site import Site, pole_enu
from sunarc.sky.sun import hour_angle, sun_directions

StepCause = Literal["moved", "lens", "clock"]
EpochCause = StepCause | Literal["start", "unexplained", "resized"]
N_TURN = 3
_STEPS: tuple[StepCause, ...] = ("clock", "moved", "lens")
_OF_POSE_OR_LENS = _STEPS[1:]

_FEWEST_OF_ARC, _MANY_OF_ARC = 9, 60
"""Sightings of a day that show its noise; that of fewer is the usual one of all days."""
_DAYS_OF_FEW, _FEWEST_OF_DAYS = 12, 48
"""Days of fewer sightings that show their noise together, at most, and their sightings, at least."""
_UNKNOWN_NOISE_PX = 1.0
_LEAST_NOISE_PX = 0.05
_GROSS_SIGMAS = 3.5
_MISFIT_PX, _MISFIT_SHARE = 0.15, 0.5
"""1-sigma by which a half-day's sightings err alike: px, and in the day's noise."""
_HALF_DAY_S = 6.0 * 3600.0
_FEWEST_BESIDE = 8
"""Sightings on either side of a change within a state."""
_CLOCK_DEG = 2.5
"""1-sigma of a change of the clock, 600 s."""
_COMMON_LENS = 0.3
"""1-sigma of the error of the state itself, in that of a change of the lens."""
_LENS_AMONG_CHANGES = 3.0
"""Powers of e from which a change is clearly one of the lens, too, or of the pose alone. Turns have -13 to -8."""
_AGREES_PX, _AGREES_SIGMAS, _FEWEST_OF_HALF = 0.3, 1.5, 4
"""How far off the middle of half a day may lie: px, and in the day's noise; fewer sightings have no middle."""
_CHANGED = (Param.FOCAL_LENGTH_X_PX, *CENTER, Param.K2)
_LENS = [*_CHANGED, Param.FOCAL_LENGTH_Y_PX]
_DRIFT_DEG = (0.05, 0.2, 0.8)
"""1-sigma of a camera's drift at either end of an epoch, about each axis or the pole: all equally likely."""
_DRIFT_GAIN = 10.0
"""Powers of e by which a drift must explain an epoch better than none: it is asked for once. Of 24 archives of cameras
that stood still none reached 0."""
_ONE_VIEW = 0.1
"""Of the focal length: how far off one camera's predictions the days of its drift lie, at most."""


def spread_deg(drift: PoseChange) -> FloatArray:
    """Return (3,): root mean square of a drift's turn between two times about east, north and up, degrees.

    Weighted by how probable the drift is.
    """
    # between two times of the epoch, twice the mean square from its middle, which is a third of that at its ends
    probable = 1.0 / (1.0 + math.exp(-min(drift.gain, 50.0)))
    mean_square = 0.25 * (drift.rotation_deg**2 + np.diag(drift.covariance_deg2))
    return np.asarray(np.sqrt(2.0 / 3.0 * probable * mean_square))


def drift_finding(drift: PoseChange) -> Finding | None:
    """Return that the sightings of an epoch are of no one camera; None where they may be."""
    return None if drift.gain < _DRIFT_GAIN or max(spread_deg(drift)) < EPOCHS.least_deg else drift.finding


def estimate_daily_noise(points: Sightings, site: Site) -> FloatArray:
    """Return (n,): 1-sigma per axis of each sighting by its own day, that of one off its day's arc being larger.

    Parameters
    ----------
    points : of the sun, in the order of time.
    site : where the camera stands.
    """
    day = solar_days(points.unix_s, longitude=site.longitude)
    found = np.full(len(points), np.nan)
    for one in np.unique(day).tolist():
        rows = np.flatnonzero(day == one)
        if rows.size < _FEWEST_OF_ARC:
            continue
        angle = hour_angle(points.unix_s[rows], site)
        _, rough, _ = smooth_arc(points.pixels[rows], angle)
        distance = np.hypot(rough[:, 0], rough[:, 1])
        # the arc has taken its share of the scatter: a polynomial of order n // 3, of the ninth at most
        free = 1.0 - min(10.0, 1.0 + rows.size // 3) / rows.size
        sigma = robust_sigma(distance, share=0.5, floor=_LEAST_NOISE_PX) / math.sqrt(free)
        if rows.size < _MANY_OF_ARC:  # and more than its share of a few, for it leaves out those that are off it
            sigma = max(sigma, _noise_beside_neighbours(points.pixels[rows], np.unwrap(angle)))
        found[rows] = sigma * np.maximum(distance / sigma / _GROSS_SIGMAS, 1.0) ** 2
    if not np.any(np.isfinite(found)):
        found = _estimate_noise_together(points, day, site)
    usual = float(np.nanmedian(found)) if np.any(np.isfinite(found)) else _UNKNOWN_NOISE_PX
    return np.where(np.isfinite(found), found, usual)


def _estimate_noise_together(points: Sightings, day: IntArray, site: Site) -> FloatArray:
    """Return the noise (n,) by some days of few sightings each; NaN where too few days follow each other."""
    found, every, group = np.full(len(points), np.nan), np.unique(day), np.zeros(0, dtype=np.int64)
    for one in every.tolist():
        group = np.append(group[day[group] > one - _DAYS_OF_FEW], np.flatnonzero(day == one))
        if group.size < _FEWEST_OF_DAYS:
            continue
        angle = hour_angle(points.unix_s[group], site)
        rough, unknowns = smooth_days(points.pixels[group], angle, day[group])
        free = 1.0 - unknowns / group.size
        distance = np.hypot(rough[:, 0], rough[:, 1])
        sigma = robust_sigma(distance, share=0.5, floor=_LEAST_NOISE_PX) / math.sqrt(free)
        new = group[~np.isfinite(found[group])]
        found[new] = sigma
    return found


def _noise_beside_neighbours(pixels: FloatArray, angle: FloatArray) -> float:
    """Return 1-sigma per axis of sightings (n, 2) by the cubics through the two before and the two after each."""
    distinct = np.append(True, np.diff(angle) > 1e-9)
    pixels, angle = pixels[distinct], angle[distinct]
    window = np.arange(max(len(angle) - 4, 0))[:, None] + np.arange(5)
    beside = np.delete(window, 2, axis=1)
    apart = angle[beside][:, :, None] - angle[beside][:, None, :] + np.eye(4)
    to_middle = angle[window[:, 2]][:, None] - angle[beside]
    others = np.where(np.eye(4, dtype=bool), 1.0, to_middle[:, None, :])
    weight = np.prod(others / apart, axis=-1)  # Lagrange's
    off = pixels[window[:, 2]] - np.einsum("ij,ijk->ik", weight, pixels[beside])
    scale = np.sqrt(1.0 + np.sum(weight**2, axis=-1))
    return robust_sigma(np.hypot(off[:, 0], off[:, 1]) / scale, share=0.5, floor=_LEAST_NOISE_PX)


class _LinearProblem(NamedTuple):
    """Whitened residuals of n sightings and their derivatives; columns have unit prior variance."""

    values: FloatArray
    """(n, 2) residuals."""
    turns: FloatArray
    """(n, 2, 3) by a turn about east, north and up."""
    lens: FloatArray
    """(n, 2, 4) by a change of the lens."""
    clock: FloatArray
    """(n, 2, 1) by a change of the clock: a turn about the celestial pole."""

    @property
    def common(self) -> FloatArray:
        """Return the columns by which the camera itself may be wrong."""
        return np.concatenate([self.turns, _COMMON_LENS * self.lens], axis=-1)

    def step(self, cause: StepCause) -> FloatArray:
        """Return the columns of a change; those of a turn come first."""
        if cause == "clock":
            return self.clock
        return self.turns if cause == "moved" else np.concatenate([self.turns, self.lens], axis=-1)

    def explained(self, *columns: FloatArray) -> Explained:
        """Return the evidence of the residuals with further columns (n, 2, q)."""
        every = np.concatenate([*columns, self.common], axis=-1)
        return explained(self.values, np.ones(len(self.values)), every)


def change_within(points: Sightings, camera: Camera, site: Site, noise_px: FloatArray) -> PoseChange | None:
    """Return the likeliest change among sightings that one camera is said to have seen; None where none is likelier.

    Parameters
    ----------
    points : of the sun, in the order of time, at the times of the camera's clock.
    camera, site : see there.
    noise_px : (n,) see `estimate_daily_noise`.
    """
    linear, index = _make_problem_of_seen(points, camera, site, noise_px)
    if linear is None:
        return None
    none = step_evidences(linear.values, linear.common, linear.common[..., :0])[0]
    weighed: list[Weighed[tuple[StepCause, int] | None]] = [Weighed(None, 0.0)]
    for cause in _STEPS:
        gains = step_evidences(linear.values, linear.common, linear.step(cause))[_FEWEST_BESIDE:-_FEWEST_BESIDE] - none
        first = int(index[_FEWEST_BESIDE + int(np.argmax(gains))])
        weighed.append(Weighed((cause, first), float(gains.max()), EPOCHS.rarer[cause] + EPOCHS.gain))
    best = most_probable(weighed)
    if best.explanation is None:
        return None
    cause, first = best.explanation
    turn = linear.explained(linear.step("lens" if cause == "lens" else "moved") * (index >= first)[:, None, None])
    return PoseChange(
        time=float(points.unix_s[first]),
        bracket=(float(points.unix_s[first - 1]), float(points.unix_s[first])),
        rotation_deg=EPOCHS.turn_deg * turn.mean[:N_TURN],
        covariance_deg2=EPOCHS.turn_deg**2 * turn.covariance[:N_TURN, :N_TURN],
        cause=cause,
        gain=best.log_evidence - EPOCHS.rarer[cause],
    )


def is_lens_change(sides: Sequence[tuple[Sightings, Camera, FloatArray]], site: Site) -> bool | None:
    """Return whether a change between two poses of one lens is likelier one of the lens, too; None where unclear.

    Parameters
    ----------
    sides : sightings before and after it, at the times of the clock, the camera of their state and their noise (n,);
        each camera is linear about the sightings of its own.
    site : where the camera stands.
    """
    first, second = (_make_problem_of_seen(points, camera, site, noise_px)[0] for points, camera, noise_px in sides)
    if first is None or second is None:
        return None
    both = _LinearProblem(*(np.concatenate(pair) for pair in zip(first, second, strict=True)))
    after = (np.arange(len(both.values)) >= len(first.values))[:, None, None]
    moved, lens = (both.explained(both.step(one) * after).log_evidence for one in _OF_POSE_OR_LENS)
    return None if abs(lens - moved) <= _LENS_AMONG_CHANGES else lens > moved


def _make_problem_of_seen(
    points: Sightings, camera: Camera, site: Site, noise_px: FloatArray
) -> tuple[_LinearProblem | None, IntArray]:
    """Return the linear problem of the sightings that a camera sees, and their rows; None of too few."""
    predicted = project_fast(camera, sun_directions(points.unix_s, site))
    index = np.flatnonzero(np.all(np.isfinite(predicted), axis=-1))
    if index.size <= 2 * _FEWEST_BESIDE:
        return None, index
    some = points.select(index)
    residual = some.pixels - predicted[index]
    return _linearise(some, camera, residual, _raise_gross_noise(residual, noise_px[index]), site=site), index


def drift_within(
    points: Sightings,
    camera: Camera,
    site: Site,
    noise_px: FloatArray,
    *,
    changes: Sequence[tuple[int, EpochCause]] = (),
) -> PoseChange | None:
    """Return the drift of a mount, or of a clock: the sun does not distinguish that from one about the pole.

    Its gain is that over no drift and no change. None where the sightings are too few or of another camera, or where
    changes explain them better.

    Parameters
    ----------
    points : of the sun, in the order of time, at the times of the camera's clock.
    camera, site : see there.
    noise_px : (n,) see `estimate_daily_noise`.
    changes : the first sighting after each change that was found among them, and its cause.
    """
    linear, index = _make_problem_of_seen(points, camera, site, noise_px)
    if linear is None or not _are_near_predictions(camera, points, site, [row for row, _ in changes]):
        return None
    times = points.unix_s[index]
    half_s = 0.5 * float(times[-1] - times[0])
    along = ((times - times[0]) / half_s - 1.0)[:, None, None]
    none = linear.explained().log_evidence
    found = dict[bool, float]()
    for clock, turns in ((True, linear.turns @ pole_enu(site)[:, None]), (False, linear.turns)):
        each = [linear.explained(_drift_columns(one * turns, along)).log_evidence for one in _DRIFT_DEG]
        found[clock] = float(np.logaddexp.reduce(each)) - math.log(len(each)) - none
    gain = max(found.values())
    if changes:
        causes: list[StepCause] = [cause if cause in _STEPS else "moved" for _, cause in changes]
        begun = [(index >= row)[:, None, None] for row, _ in changes]
        steps = linear.explained(*(linear.step(one) * late for one, late in zip(causes, begun, strict=True)))
        rarer = sum(EPOCHS.gain + EPOCHS.rarer[one] for one in causes)
        if gain - EPOCHS.gain < steps.log_evidence - none - rarer:
            return None
    middle = _DRIFT_DEG[len(_DRIFT_DEG) // 2]
    turn = linear.explained(_drift_columns(middle * linear.turns, along))
    rotation_deg = 2.0 * middle * turn.mean[:N_TURN]  # at the end; twice that from the first
    clock, days = found[True] >= found[False] - 1.0, 2.0 * half_s / DAY_S
    turn_deg = float(rotation_deg @ pole_enu(site)) if clock else float(np.linalg.norm(rotation_deg))
    said = {"turn_deg": turn_deg, "days": days, "log_odds": gain}
    finding = Finding("mount_drifts", said)
    if clock:  # where it is ahead the sun stands farther east than predicted, as in a camera turned clockwise
        s_per_day = -turn_deg * SECONDS_PER_DEGREE / max(days, 1.0)
        finding = Finding("clock_drifts_on", {**said, "s_per_day": s_per_day})
    return PoseChange(
        time=float(times[0]),
        bracket=(float(times[0]), float(times[-1])),
        settling=math.inf,
        rotation_deg=rotation_deg,
        covariance_deg2=(2.0 * middle) ** 2 * turn.covariance[:N_TURN, :N_TURN],
        cause="clock" if clock else "slow_turn",
        gain=gain,
        finding=finding,
    )


def _are_near_predictions(camera: Camera, points: Sightings, site: Site, begins: Sequence[int]) -> bool:
    """Return whether sightings between changes all lie near a camera's predictions: so they are linear in turns."""
    off = np.linalg.norm(points.pixels - project_fast(camera, sun_directions(points.unix_s, site)), axis=-1)
    # what the camera does not see is far from all that it does
    parts = np.split(np.where(np.isfinite(off), off, np.inf), list(begins))
    return all(float(np.median(part)) < _ONE_VIEW * camera.focal_length_px[0] for part in parts if part.size)


def _drift_columns(turns: FloatArray, along: FloatArray) -> FloatArray:
    """Return the columns of a drift that is steady, and of one that begins or ends, by times (n, 1, 1) from -1 to 1."""
    return np.concatenate([turns * along, 0.5 * turns * (along**2 - 1.0 / 3.0)], axis=-1)


def _raise_gross_noise(residual: FloatArray, noise_px: FloatArray) -> FloatArray:
    """Return the noise (n,), larger where a residual (n, 2) lies far from those of its neighbours."""
    beside = off_neighbours(residual) / noise_px
    return np.asarray(noise_px * np.maximum(beside / (2.0 * _GROSS_SIGMAS), 1.0) ** 2)


def _linearise(
    points: Sightings, camera: Camera, residual: FloatArray, noise_px: FloatArray, *, site: Site
) -> _LinearProblem:
    """Return the linear problem of residuals (n, 2) of noise (n,)."""
    directions = sun_directions(points.unix_s, site)
    rows = project_with_rows_fast(camera, directions)[1]
    about = -math.radians(EPOCHS.turn_deg) * np.cross(np.eye(3), directions[:, None, :])
    turns = np.einsum("nai,nki->nak", by_direction(camera, rows), about)
    alike = np.floor((points.unix_s + SECONDS_PER_DEGREE * site.longitude) / _HALF_DAY_S).astype(np.int64)
    _, member, count = np.unique(alike, return_inverse=True, return_counts=True)
    misfit = max(_MISFIT_PX, _MISFIT_SHARE * float(np.median(noise_px)))
    root = 1.0 / np.sqrt(noise_px**2 + count[member] * misfit**2)[:, None, None]
    return _LinearProblem(
        values=residual * root[..., 0],
        turns=turns * root,
        lens=rows[..., _LENS] @ lens_freedom(camera, _LENS, _CHANGED, EPOCHS) * root,
        clock=turns @ (_CLOCK_DEG * pole_enu(site)[:, None]) * root,
    )


def agreeing_days(residual: FloatArray, noise_px: FloatArray, unix_s: FloatArray, site: Site) -> list[IntArray]:
    """Return the days that agree with a camera, as rows (k,) of consecutive ones, the longest run first.

    A day agrees where the middle of each of its halves lies no farther off than the day's own noise and a misfit allow.

    Parameters
    ----------
    residual : (n, 2) of the sightings about the camera, px.
    noise_px : (n,) see `estimate_daily_noise`.
    unix_s : (n,) their times, in order.
    site : where the camera stands.
    """
    day = solar_days(unix_s, longitude=site.longitude)
    half = np.floor((unix_s + 240.0 * site.longitude) / (2.0 * _HALF_DAY_S)).astype(np.int64)
    runs: list[list[int]] = [[]]
    for one in np.unique(day).tolist():
        rows = np.flatnonzero(day == one)
        most = _AGREES_PX + _AGREES_SIGMAS * float(np.median(noise_px[rows]))
        halves = [rows[half[rows] == number] for number in np.unique(half[rows])]
        off = [np.linalg.norm(np.median(residual[part], axis=0)) for part in halves if part.size >= _FEWEST_OF_HALF]
        if all(distance <= most for distance in off):
            runs[-1] += rows.tolist()
        else:
            runs.append([])
    return [np.array(run) for run in sorted(runs, key=len, reverse=True) if run]
