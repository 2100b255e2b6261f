"""What a state of a camera does not explain of its sightings: a change or drift among them, by the days' own noise.

A sun's track runs smoothly over the image whatever the camera is: its scatter about a smooth arc is the day's own
noise, known before any camera is. By it a state's residuals are explained by a change of the clock, of the pose, or of
the lens from one sighting on, or by none: the evidences are compared (`calibration.evidence`). So is that of a mount or
a clock that drifts all the time, which no step explains as well. What detectors in photographs do wrong all through a
half-day (cloud, glare) is no noise that many sightings average out, and is allowed for by half-days.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from sunarc.calibration.evidence import SEQUENCE_GAIN, Weighed, most_probable
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.quality.day_arcs import smooth_arc
from sunarc.changes.detect_change import rarity
from sunarc.common.array_types import FloatArray, IntArray
from sunarc.common.findings import Finding
from sunarc.common.robust_statistics import robust_sigma
from sunarc.optics.camera import POSE, Camera, Param
from sunarc.optics.forward import by_direction, project_fast, project_with_rows_fast
from sunarc.sky.days import solar_days
from sunarc.sky.site import Site, pole_enu
from sunarc.sky.sun import hour_angle, sun_directions

Cause = Literal["start", "moved", "lens", "clock", "unexplained"]

_FEWEST_OF_ARC, _MANY_OF_ARC = 9, 60
"""Sightings of a day that show its noise; that of fewer is the usual one of all days."""
_LEAST_NOISE_PX = 0.05
_GROSS_SIGMAS = 3.5
_NEIGHBOURS = 4
"""Sightings on each side whose median shows that one is false."""
_MISFIT_PX, _MISFIT_SHARE = 0.15, 0.5
"""1-sigma by which a half-day's sightings err alike: px, and in the day's noise."""
_HALF_DAY_S = 6.0 * 3600.0
_FEWEST_BESIDE = 8
"""Sightings on either side of a change within a state."""
_CLOCK_S, _POSE_RAD = 600.0, math.radians(1.0)
_FOCAL_SHARE, _CENTER_SHARE, _RADIAL = 0.03, 0.01, 0.02
"""1-sigma of a change: of the clock, of the pose about each axis, of focal length, place (share of the width), k2."""
_COMMON_LENS = 0.3
"""1-sigma of what the state itself is wrong by, in that of a change of the lens."""
_LENS_AMONG_CHANGES = 3.0
"""Powers of e by which a change that is found is rarely one of the lens, too: one in twenty. Turns have -13 to -8."""
_STEP_S = 30.0
_AGREES_PX, _AGREES_SIGMAS, _FEWEST_OF_HALF = 0.3, 1.5, 4
"""How far off the middle of half a day may lie: px, and in the day's noise; fewer sightings have no middle."""
_LENS = (Param.FOCAL_LENGTH_X_PX, Param.PRINCIPAL_POINT_X_PX, Param.PRINCIPAL_POINT_Y_PX, Param.K2)
_DRIFT_DEG = (0.05, 0.2, 0.8)
"""1-sigma of what a camera has drifted at either end of an epoch, about each axis or the pole: all equally likely."""
_DRIFT_GAIN = 10.0
"""Powers of e by which a drift must explain an epoch better than none: it is asked for once. Of 24 archives of cameras
that stood still none reached 0."""
_DRIFT_STATED_DEG = 0.05
"""Root mean square of a drift up to which it is allowed for by the uncertainty; every mount leans within a decade."""
_ONE_VIEW = 0.1
"""Of the focal length: how far off one camera's predictions the days of its drift lie, at most."""
_DEG_PER_S = 360.0 / 86_400.0


class ChangeWithin(NamedTuple):
    """A change within a state: the first sighting after it, what changed, and by how many powers of e likelier."""

    row: int
    cause: Cause
    gain: float


class DriftWithin(NamedTuple):
    """What sightings say of a drift of the mount, or of the clock: the sun does not tell that from one about the pole.

    clock: whether it is about the pole. log_odds: by how many powers of e it is likelier than no drift and no change.
    over_steps: by how many it is likelier than the changes that were found, and by less than they are rarer.
    turn_deg: of the camera from the first sighting to the last, about the pole where it is one of the clock; days
    between them. spread_deg: root mean square of the turn between two times about east, north and up, weighted by how
    probable a drift is.
    """

    clock: bool
    log_odds: float
    over_steps: float
    turn_deg: float
    days: float
    spread_deg: tuple[float, float, float]

    @property
    def finding(self) -> Finding | None:
        """That the sightings are of no one camera; None where they may be."""
        if self.log_odds < _DRIFT_GAIN or max(self.spread_deg) < _DRIFT_STATED_DEG:
            return None
        said = {"turn_deg": self.turn_deg, "days": self.days, "log_odds": self.log_odds}
        if not self.clock:
            return Finding("mount_drifts", said)
        # where the clock is ahead the sun stands farther east than predicted, as in a camera turned clockwise
        return Finding("clock_drifts_on", {**said, "s_per_day": -self.turn_deg / _DEG_PER_S / max(self.days, 1.0)})


def noise_of_days(points: Sightings, site: Site) -> FloatArray:
    """Return (n,): 1-sigma per axis of each sighting by its own day, that of one beside its day's arc being larger.

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
    usual = float(np.nanmedian(found)) if np.any(np.isfinite(found)) else 1.0
    return np.where(np.isfinite(found), found, usual)


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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Linear:
    """Residuals of n sightings and what moves them, whitened: values (2 n,), columns (2 n, p) of prior variance 1.

    turns: (2 n, 3) by a degree about east, north and up.
    """

    values: FloatArray
    common: FloatArray
    steps: dict[Cause, FloatArray]
    turns: FloatArray


def change_within(points: Sightings, camera: Camera, site: Site, noise_px: FloatArray) -> ChangeWithin | None:
    """Return the likeliest change among sightings that one camera is said to have seen; None where none is likelier.

    Parameters
    ----------
    points : of the sun, in the order of time, at the times of the camera's clock.
    camera, site : see there.
    noise_px : (n,) see `noise_of_days`.
    """
    linear, index = _seen(points, camera, site, noise_px)
    if linear is None:
        return None
    weighed = [Weighed(ChangeWithin(0, "start", 0.0), _log_evidence(linear.common, linear.values))]
    none = weighed[0].log_evidence
    for cause, columns in linear.steps.items():
        gains = np.array(list(_gains(linear, columns))) - none
        row = _FEWEST_BESIDE + int(np.argmax(gains))
        rarer = 0.0 if cause == "moved" else rarity("clock" if cause == "clock" else "lens", clock_stepped=False)
        change = ChangeWithin(int(index[row]), cause, float(gains.max()) - rarer)
        weighed.append(Weighed(change, none + float(gains.max()), rarer + SEQUENCE_GAIN))
    best = most_probable(weighed).explanation
    return None if best.cause == "start" else best


class Side(NamedTuple):
    """Sightings (n,) on one side of a change, at the times of the clock, their noise, and the camera of its state."""

    points: Sightings
    noise_px: FloatArray
    camera: Camera


def is_of_lens(before: Side, after: Side, site: Site) -> bool:
    """Return whether a change between two poses that were found for one lens is likelier one of the lens, too.

    Parameters
    ----------
    before, after : its sides; each camera is linear about the sightings of its own.
    site : where the camera stands.
    """
    first, second = (_seen(one.points, one.camera, site, one.noise_px)[0] for one in (before, after))
    if first is None or second is None:
        return False
    common, values = np.concatenate([first.common, second.common]), np.concatenate([first.values, second.values])
    moved, lens = (
        _log_evidence(np.column_stack([common, np.concatenate([0.0 * first.steps[one], second.steps[one]])]), values)
        for one in ("moved", "lens")
    )
    return lens - moved > _LENS_AMONG_CHANGES


def _seen(points: Sightings, camera: Camera, site: Site, noise_px: FloatArray) -> tuple[_Linear | None, IntArray]:
    """Return the linear problem of the sightings that a camera sees, and their rows; None of too few."""
    predicted = project_fast(camera, sun_directions(points.unix_s, site))
    index = np.flatnonzero(np.all(np.isfinite(predicted), axis=-1))
    if index.size <= 2 * _FEWEST_BESIDE:
        return None, index
    some = points.select(index)
    residual = some.pixels - predicted[index]
    return _linear(some, camera, residual, _with_gross(residual, noise_px[index]), site=site), index


def drift_within(
    points: Sightings, camera: Camera, site: Site, noise_px: FloatArray, *, changes: Sequence[tuple[int, Cause]] = ()
) -> DriftWithin | None:
    """Return what sightings say of a drift instead of changes; None where they are too few or of another camera.

    Parameters
    ----------
    points : of the sun, in the order of time, at the times of the camera's clock.
    camera, site : see there.
    noise_px : (n,) see `noise_of_days`.
    changes : the first sighting after each change that was found among them, and its cause.
    """
    linear, index = _seen(points, camera, site, noise_px)
    if linear is None or not _are_of(camera, points, site, [row for row, _ in changes]):
        return None
    times = points.unix_s[index]
    half_s = 0.5 * float(times[-1] - times[0])
    along = np.repeat((times - times[0]) / half_s - 1.0, 2)[:, None]
    none = _log_evidence(linear.common, linear.values)
    found = dict[bool, float]()
    for clock, turns in ((True, linear.turns @ pole_enu(site)[:, None]), (False, linear.turns)):
        each = [
            _log_evidence(np.concatenate([linear.common, _drifting(one * turns, along)], axis=1), linear.values)
            for one in _DRIFT_DEG
        ]
        found[clock] = float(np.logaddexp.reduce(each)) - math.log(len(each)) - none
    clock = found[True] >= found[False] - 1.0
    log_odds = max(found.values())
    stepped, rarer = [linear.common], 0.0
    for row, cause in changes:
        kind: Cause = cause if cause in linear.steps else "moved"
        stepped.append(linear.steps[kind] * np.repeat(index >= row, 2)[:, None])
        rarer += SEQUENCE_GAIN + (
            0.0 if kind == "moved" else rarity("clock" if kind == "clock" else "lens", clock_stepped=False)
        )
    steps = _log_evidence(np.concatenate(stepped, axis=1), linear.values) - none
    over_steps = log_odds - SEQUENCE_GAIN - (steps - rarer)
    mean_deg, product = _posterior_turn(linear, along)
    pole = pole_enu(site)
    turn_deg = 2.0 * float(mean_deg @ pole if clock else np.linalg.norm(mean_deg))
    # between two times of the epoch, twice the mean square from its middle, which is a third of that at its ends
    probable = 1.0 / (1.0 + math.exp(-min(log_odds, 50.0)))
    east, north, up = np.sqrt(2.0 / 3.0 * probable * np.diag(product)).tolist()
    return DriftWithin(clock, log_odds, over_steps, turn_deg, 2.0 * half_s / 86_400.0, (east, north, up))


def _are_of(camera: Camera, points: Sightings, site: Site, begins: Sequence[int]) -> bool:
    """Return whether sightings between changes all lie near a camera's predictions: so they are linear in turns."""
    off = np.linalg.norm(points.pixels - project_fast(camera, sun_directions(points.unix_s, site)), axis=-1)
    # what the camera does not see is far from all that it does
    parts = np.split(np.where(np.isfinite(off), off, np.inf), list(begins))
    return all(float(np.median(part)) < _ONE_VIEW * camera.focal_length_px[0] for part in parts if part.size)


def _drifting(turns: FloatArray, along: FloatArray) -> FloatArray:
    """Return the columns of a drift that is steady, and of one that begins or ends, by times (n, 1) from -1 to 1."""
    return np.concatenate([turns * along, 0.5 * turns * (along**2 - 1.0 / 3.0)], axis=1)


def _posterior_turn(linear: _Linear, along: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the turn (3,) at the end of a steady drift, degrees, and the mean product (3, 3) of it with itself."""
    middle = _DRIFT_DEG[len(_DRIFT_DEG) // 2]
    columns = np.concatenate([linear.common, _drifting(middle * linear.turns, along)], axis=1)
    covariance = np.linalg.inv(columns.T @ columns + np.eye(columns.shape[1]))
    place = slice(linear.common.shape[1], linear.common.shape[1] + 3)
    mean = middle * (covariance @ (columns.T @ linear.values))[place]
    return mean, np.outer(mean, mean) + middle**2 * covariance[place, place]


def _with_gross(residual: FloatArray, noise_px: FloatArray) -> FloatArray:
    """Return the noise (n,), larger where a residual (n, 2) lies far beside those of its neighbours."""
    padded = np.pad(residual, ((_NEIGHBOURS, _NEIGHBOURS), (0, 0)), mode="reflect")
    middle = np.median(sliding_window_view(padded, 2 * _NEIGHBOURS + 1, axis=0), axis=-1)
    beside = np.linalg.norm(residual - middle, axis=-1) / noise_px
    return np.asarray(noise_px * np.maximum(beside / (2.0 * _GROSS_SIGMAS), 1.0) ** 2)


def _linear(points: Sightings, camera: Camera, residual: FloatArray, noise_px: FloatArray, *, site: Site) -> _Linear:
    """Return the linear problem of residuals (n, 2) of noise (n,)."""
    directions = sun_directions(points.unix_s, site)
    rows = project_with_rows_fast(camera, directions)[1]
    about = -math.radians(1.0) * np.cross(np.eye(3), directions[:, None, :])
    turns = np.einsum("nai,nki->nak", by_direction(camera, rows), about)
    alike = np.floor((points.unix_s + 240.0 * site.longitude) / _HALF_DAY_S).astype(np.int64)
    _, member, count = np.unique(alike, return_inverse=True, return_counts=True)
    usual = np.median(noise_px)
    misfit = max(_MISFIT_PX, _MISFIT_SHARE * float(usual))
    root = 1.0 / np.sqrt(noise_px**2 + count[member] * misfit**2)
    lens = rows[..., list(_LENS)].copy()
    lens[..., 0] += rows[..., Param.FOCAL_LENGTH_Y_PX]
    lens *= np.array([_FOCAL_SHARE * camera.focal_length_px[0], *(2 * [_CENTER_SHARE * camera.width]), _RADIAL])
    pose = rows[..., POSE] * _POSE_RAD
    before, after = (
        project_with_rows_fast(camera, sun_directions(points.unix_s + one, site))[0] for one in (-_STEP_S, _STEP_S)
    )
    clock = np.nan_to_num((before - after) / (2.0 * _STEP_S))[..., None] * _CLOCK_S

    def white(columns: FloatArray) -> FloatArray:
        return np.asarray((columns * root[:, None, None]).reshape(2 * root.size, -1))

    return _Linear(
        values=(residual * root[:, None]).ravel(),
        common=white(np.concatenate([pose, _COMMON_LENS * lens], axis=-1)),
        steps={"clock": white(clock), "moved": white(pose), "lens": white(np.concatenate([pose, lens], axis=-1))},
        turns=white(turns),
    )


def _log_evidence(columns: FloatArray, values: FloatArray) -> float:
    """Return the log evidence of whitened values, numbers of unit prior variance integrated out, up to a constant."""
    information = columns.T @ columns + np.eye(columns.shape[1])
    return _of_sums(information, columns.T @ values)


def _of_sums(information: FloatArray, pull: FloatArray) -> float:
    return 0.5 * float(pull @ np.linalg.solve(information, pull)) - 0.5 * float(np.linalg.slogdet(information)[1])


def _gains(linear: _Linear, columns: FloatArray) -> Iterator[float]:
    """Yield the log evidence of a step before each sighting but the first and last few."""
    common, size = linear.common, linear.common.shape[1]
    both = np.concatenate([common, columns], axis=1)
    n, total = both.shape[0] // 2, both.shape[1]
    pairs = both.reshape(n, 2, total)
    # sums over the sightings from each on
    products = np.cumsum(np.einsum("nap,naq->npq", pairs, pairs)[::-1], axis=0)[::-1]
    pulls = np.cumsum(np.einsum("nap,na->np", pairs, linear.values.reshape(n, 2))[::-1], axis=0)[::-1]
    for row in range(_FEWEST_BESIDE, n - _FEWEST_BESIDE):
        information = np.eye(total)
        information[:size, :size] += products[0, :size, :size]
        information[size:, :] = products[row, size:, :]
        information[:size, size:] = products[row, :size, size:]
        information[size:, size:] += np.eye(total - size)
        yield _of_sums(information, np.concatenate([pulls[0, :size], pulls[row, size:]]))


def agreeing_days(residual: FloatArray, noise_px: FloatArray, unix_s: FloatArray, site: Site) -> list[IntArray]:
    """Return the days that agree with a camera, as rows (k,) of consecutive ones, the longest run first.

    A day agrees where the middle of each of its halves lies no farther off than the day's own noise and a misfit allow.

    Parameters
    ----------
    residual : (n, 2) of the sightings about the camera, px.
    noise_px : (n,) see `noise_of_days`.
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
