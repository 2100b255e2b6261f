"""Moves of the camera within a record: search for jumps, and comparison with a second pose.

The residuals of one pose run on smoothly through all that lens and sky do, within a day and from a day to the next at
the same hour. A move makes them jump. A jump is a suggestion only: a move counts when two poses lower the robust cost,
and are likelier by their marginal likelihood than one pose (`step_evidence`). In a long record the rotations of its
days show where a fit of a few days is worth its time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import NamedTuple, Unpack

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from sunarc.calibration.calibrate import FitInput, calibrate, calibrated, prepared
from sunarc.calibration.evidence import DAYS, RECORD
from sunarc.calibration.lens_library.conditioning import apply_lens_prior
from sunarc.calibration.lens_library.first_pose import first_pose
from sunarc.calibration.lens_library.lens_type import LensType
from sunarc.calibration.model.options import USUAL_OPTIONS, CalibrationOptions, FirstPoseOptions, ImageCircle
from sunarc.calibration.model.pose_change import Cause, PoseChange, pose_before, turn_between
from sunarc.calibration.model.result import Calibration, refused_for, residuals_by_pose
from sunarc.calibration.model.sightings import Sightings, filter_sightings
from sunarc.calibration.pose import options_about
from sunarc.calibration.projection_choice import options_as_served
from sunarc.changes.daily_rotations import DailyRotations, daily_pose_offset, step_gains
from sunarc.changes.step_evidence import FLOOR_PX, LONGEST_EPISODE_S, log_bayes_factor
from sunarc.common.array_types import FloatArray, IntArray, stacked
from sunarc.common.findings import Finding
from sunarc.common.robust_statistics import finite, robust_sigma, tukey_loss
from sunarc.common.utc import DAY_S, rfc3339, utc_time
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project_fast
from sunarc.optics.pose import rotation_between
from sunarc.sky.days import SECONDS_PER_DEGREE
from sunarc.sky.site import Site, pole_enu

_SIDE = 12
"""Sightings that are used on either side of a gap."""
_LONGEST_S = 7200.0
"""Time that they may take together: over a longer one a smooth error is no straight line."""
_JUMP_PER_SIGMA = 0.8
"""1-sigma of a jump without a turn, in that of a sighting: two medians of 12, each at the end of a line."""
_MEDIAN_DISTANCE = 1.1774
"""Median length of a round Gaussian vector, in sigmas."""
_JUMP_SIGMAS = 4.0
_JUMPS_TRIED = 3
_NIGHT_RATIO = 2.0
_BESIDE_POLE, _BESIDE_SIGMAS = 0.1, 3.0
"""Largest distance of a clock's turn from one about the celestial pole: in itself, and in the stated error of the sky.
One axis of 200 is so near the pole by chance."""
_GAIN = 40.0
"""Least gain of three more unknowns in the squares of the residuals, in variances, wherever the move may be."""
_MOST = 6
_FEWEST = 20
_Fit = Callable[..., Calibration]


class Moved(NamedTuple):
    """Calibration of a camera that may have moved, and its sightings numbered by pose."""

    calibration: Calibration
    points: Sightings


def calibrate_moved(points: Sightings, **given: Unpack[FitInput]) -> Moved:
    """Fit a camera that may have been moved among the sightings: one lens, and a pose before and after every move.

    The calibration is of the last pose; its evidence lists the moves, and its verdict names them. Sightings that are
    of several pose epochs already are fitted as they are, as are those of a fit by the paper's method or of the pose
    alone. Moves are sought along the sun's track; those of stated directions, which make none, belong to the pose of
    their time. A move within 20 sightings or 75 minutes of an end or of another move is not found: cloud lasts as long.

    Parameters
    ----------
    points, given : as `calibrate` takes them.
    """
    lens = prepared(points, **given)
    options, usable = lens.job.options, lens.job.usable
    judged = partial(calibrate, **(given | {"options": options, "start": None}))
    # what is only compared with another need not explain its days
    fit = partial(judged, options=replace(options, max_unexplained=1.0), parts=False)
    found, usable = calibrated(lens.job, lens.fitted), usable.select(~usable.alone)
    if not len(usable) or np.any(points.epoch != points.epoch[:1]) or options.method != "robust":
        return Moved(lens.allowed_for(found), points)
    begin: Camera | None = None
    gains = dict[float, float]()
    for _ in range(_MOST):
        if "picture_scale" in found.evidence.log_odds:
            break  # sightings of another picture jump, and are explained
        better = _add_one_move(points, usable, found, fit)
        if better is None:
            break
        begin = found.camera
        (found, points), row, gain = better
        gains[float(usable.unix_s[row])] = gain
        usable = replace(usable, epoch=points.epoch[usable.index])
    if begin is not None:
        found = judged(points, start=begin)
    return Moved(_record_moves(lens.allowed_for(found), usable, gains), points)


def _add_one_move(
    points: Sightings, usable: Sightings, solved: Calibration, fit: _Fit
) -> tuple[Moved, int, float] | None:
    """Return the fit with one move more, its row and its gain; None where none makes it clearly better."""
    residual = _residuals_by_lens(solved, usable)
    tried = []
    for suggested, smallest_deg in (*jumps_within_days(residual, usable), *night_changes(residual, usable)):
        found = _fit_with_move_at(suggested, points, usable, solved.camera, fit)
        if found is None:
            continue
        numbered = replace(usable, epoch=found.points.epoch[usable.index])
        there = _residuals_by_lens(found.calibration, numbered)
        row = int(np.flatnonzero(numbered.epoch != usable.epoch)[0])
        ended = int(usable.epoch[row])
        turn_rad = rotation_between(*found.calibration.poses[ended : ended + 2])
        gain = robust_gain(residual, there, usable, found.calibration)
        if gain > _GAIN and math.degrees(turn_rad) > smallest_deg:
            tried.append((gain, row, turn_rad, there, found))
    for _, row, turn_rad, there, found in sorted(tried, key=lambda item: -item[0]):
        ended = int(usable.epoch[row])
        one = _camera_in_pose(solved, solved.poses[ended]), residual
        two = _camera_in_pose(found.calibration, found.calibration.poses[ended + 1]), there
        gain = log_bayes_factor(row, usable, one=one, two=two, turn_rad=turn_rad)
        if gain > RECORD.gain:
            return found, row, gain
    return None


def _fit_with_move_at(row: int, points: Sightings, usable: Sightings, begin: Camera, fit: _Fit) -> Moved | None:
    """Return the fit with a move just before a row, or before one of the next ones where the two poses say so."""
    for _ in range(2):
        parted = replace(points, epoch=points.epoch + (points.unix_s >= usable.unix_s[row]))
        epoch = parted.epoch[usable.index]
        lasts = [np.ptp(usable.unix_s[epoch == one]) for one in np.unique(epoch)]
        if np.bincount(epoch).min() < _FEWEST or min(lasts) < LONGEST_EPISODE_S:
            return None  # no longer than cloud may draw sightings aside
        fitted = fit(parted, start=begin)
        if fitted.evidence.n_used == 0:
            return None  # refused before a pose of either side was there
        first = int(usable.epoch[row])
        cameras = [_camera_in_pose(fitted, pose) for pose in fitted.poses[first:]]
        better = best_row(slice(max(row - _SIDE // 2, 0), row + _SIDE // 2), usable, cameras)
        if better == row:
            break
        row = better
    return Moved(fitted, parted)


def best_row(near: slice, usable: Sightings, cameras: Sequence[Camera]) -> int:
    """Return the row before which a move took place, by the cameras before and after it.

    Parameters
    ----------
    near : the rows that it may have come before; `start` is given.
    usable : sightings in the order of time.
    cameras : the first two are used.
    """
    off = [np.linalg.norm(usable.pixels[near] - project_fast(c, usable.directions[near]), axis=-1) for c in cameras[:2]]
    scale = robust_sigma(np.minimum(*off), share=0.5, floor=FLOOR_PX)
    before, after = (tukey_loss(finite(distance), sigma=scale) for distance in off)
    # cost of every row as the first of the new pose, in one pass
    wrong = np.r_[0.0, np.cumsum(before - after)]
    return int(near.start + np.argmin(wrong))


def _camera_in_pose(solved: Calibration, pose: tuple[float, float, float]) -> Camera:
    """Return the camera in a pose, without its displacement: a field takes up a part of a move within the sightings."""
    return replace(solved.camera, rotation_cam_enu=pose, displacement=None)


def _residuals_by_lens(solved: Calibration, usable: Sightings) -> FloatArray:
    """Return observed minus predicted by the lens alone, (n, 2) px; far off outside the camera's field."""
    return finite(residuals_by_pose(replace(solved.camera, displacement=None), solved.poses, usable))


def robust_gain(before: FloatArray, after: FloatArray, usable: Sightings, solved: Calibration) -> float:
    """Return the loss of the robust squares, in variances of a sighting whose neighbours err like it."""
    distances = [np.hypot(residual[:, 0], residual[:, 1]) / usable.sigma_px for residual in (before, after)]
    sigma = robust_sigma(distances[1], floor=FLOOR_PX)
    one, other = (float(np.sum(tukey_loss(distance, sigma=sigma))) for distance in distances)
    return 2.0 * (one - other) / max(solved.evidence.inflation, 1.0)


def jumps_within_days(residual: FloatArray, usable: Sightings) -> list[tuple[int, float]]:
    """Return where the residuals jump within a day and a pose, against how they scatter there and wander elsewhere."""
    if len(usable) < 2 * _SIDE:
        return []
    time = usable.unix_s - usable.unix_s[0]
    jump, scatter = line_misses(residual, time)
    usual = float(np.median(jump)) / _MEDIAN_DISTANCE
    first, last = np.arange(jump.size), np.arange(jump.size) + 2 * _SIDE - 1
    run = usable.day * (1 + int(usable.epoch.max())) + usable.epoch
    complete = (run[first] == run[last]) & (time[last] - time[first] <= _LONGEST_S)
    score = np.where(complete, jump / np.maximum(_JUMP_PER_SIGMA * scatter, max(usual, FLOOR_PX)), 0.0)
    found: list[tuple[int, float]] = []
    while len(found) < _JUMPS_TRIED and score.max() > _JUMP_SIGMAS:
        best = int(np.argmax(score))
        found.append((best + _SIDE, 0.0))
        score[max(best - _SIDE, 0) : best + _SIDE + 1] = 0.0
    return found


def line_misses(residual: FloatArray, time: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the misfit, px, between straight lines through the sightings before and after each gap.

    Both have one slope. With it the smaller of the 1-sigmas per axis about the two, px.
    """
    windows = np.moveaxis(sliding_window_view(residual, _SIDE, axis=0), -1, 1)
    at = sliding_window_view(time, _SIDE)
    half = _SIDE // 2
    # the median of slopes between halves (Theil 1950, Sen 1968): outliers do not tilt the line
    slope = np.median((windows[:, half:] - windows[:, :half]) / (at[:, half:] - at[:, :half])[..., None], axis=1)
    shared = 0.5 * (slope[:-_SIDE] + slope[_SIDE:])
    gap = 0.5 * (at[:-_SIDE, -1] + at[_SIDE:, 0])
    ends, scatter = [], []
    for side in (slice(None, -_SIDE), slice(_SIDE, None)):
        level = windows[side] - shared[:, None] * (at[side] - gap[:, None])[..., None]
        ends.append(np.median(level, axis=1))
        scatter.append(np.median(np.linalg.norm(level - ends[-1][:, None], axis=-1), axis=1) / _MEDIAN_DISTANCE)
    return np.linalg.norm(ends[1] - ends[0], axis=-1), np.minimum(*scatter)


def night_changes(residual: FloatArray, usable: Sightings) -> list[tuple[int, float]]:
    """Return the night over which the residuals of the same hours differ most, where it stands out from the others."""
    rows = [np.flatnonzero(usable.day == day) for day in np.unique(usable.day)]
    nights = [(late[0], same_hours_difference(residual, usable, early, late)) for early, late in pairwise(rows)]
    comparable = [
        (int(row), difference)
        for row, difference in nights
        if math.isfinite(difference) and usable.epoch[row] == usable.epoch[row - 1]
    ]
    if not comparable:
        return []
    row, greatest = max(comparable, key=lambda night: night[1])
    usual = float(np.median([difference for _, difference in comparable])) if len(comparable) > 2 else 0.0
    stands_out = greatest > max(_NIGHT_RATIO * usual, FLOOR_PX)
    return [(row, RECORD.least_deg)] if stands_out else []


def same_hours_difference(residual: FloatArray, usable: Sightings, early: IntArray, late: IntArray) -> float:
    """Return by how much a day's residuals differ from the day before at the same hours (RMS of medians), px."""
    hours = np.mod(usable.unix_s[late] - usable.unix_s[early[0]], DAY_S)
    before = np.mod(usable.unix_s[early] - usable.unix_s[early[0]], DAY_S)
    index = np.clip(np.searchsorted(before, hours), 1, before.size - 1) if before.size > 1 else np.zeros(0, dtype=int)
    if index.size < _FEWEST:
        return math.nan
    nearer = index - (hours - before[index - 1] < before[index] - hours)
    close = np.abs(before[nearer] - hours) < _LONGEST_S / 12.0
    difference = (residual[late] - residual[early[nearer]])[close]
    if difference.shape[0] < _FEWEST:
        return math.nan
    medians = [np.median(part, axis=0) for part in np.array_split(difference, difference.shape[0] // 10)]
    return float(np.sqrt(np.mean(np.sum(np.square(medians), axis=-1))))


def _record_moves(solved: Calibration, usable: Sightings, gains: Mapping[float, float]) -> Calibration:
    """Return the calibration with its moves, of known gains by their time, in its evidence and in words."""
    moves, found, stepped = list[PoseChange](), list[Finding](), list[Finding]()
    pole = pole_enu(solved.site)
    for row in np.flatnonzero(np.diff(usable.epoch)):
        before, after = usable.unix_s[row : row + 2].tolist()
        turn_deg = turn_between(*solved.poses[usable.epoch[row] :][:2])
        gain = gains.get(after, math.nan)
        about_deg = float(turn_deg @ pole)
        beside_deg = float(np.linalg.norm(turn_deg - about_deg * pole))
        clock = beside_deg < min(_BESIDE_POLE * abs(about_deg), _BESIDE_SIGMAS * solved.sky_rms_deg)
        cause: Cause = "clock" if clock else "moved"
        moves.append(PoseChange(time=after, bracket=(before, after), rotation_deg=turn_deg, cause=cause, gain=gain))
        first, last = (rfc3339(utc_time(unix_s), timespec="seconds") for unix_s in (before, after))
        said: dict[str, str | float] = {"before": first, "after": last, "turn_deg": moves[-1].turn_deg}
        if clock:  # where it is ahead the sun stands farther east than predicted, as in a camera turned clockwise
            stepped.append(Finding("clock_changed", {**said, "step_s": -about_deg * SECONDS_PER_DEGREE}))
        else:
            found.append(Finding("pose_changed", said))
    verdict = replace(solved.verdict, findings=(*solved.verdict.findings, *found))
    moved = replace(solved, evidence=replace(solved.evidence, moves=tuple(moves)), verdict=verdict)
    return refused_for(moved, *stepped) if stepped else moved


# The same in a record of years: rotations of the days tell where to fit.

_PER_DAY = 150
"""Sightings of a day that the search uses; the step itself is dated among all."""
_FEWEST_PER_DAY = 20
_LENS_DAYS = 3
_LENS_TRIALS = 4
"""Places of the record that a lens is sought at where none is known: a step may lie in any of them."""
_BESIDE = 3
"""Days on either side of a step of the daily rotations that are fitted."""
_MOST_PLACES = 24
"""Places that are examined in one search; the clearest steps come first."""


def find_pose_steps(
    points: Sightings,
    *,
    site: Site,
    image_size: tuple[int, int],
    options: CalibrationOptions = USUAL_OPTIONS,
    circle: ImageCircle | None = None,
    lens: Calibration | None = None,
) -> tuple[PoseChange, ...]:
    """Return the steps of the pose within the epochs of a record, in the order of time.

    Parameters
    ----------
    points, site, image_size, options, circle : as `calibrate` takes them; epochs are searched one by one.
    lens : a calibration of the same lens; sought in the record where None.

    Returns
    -------
    None are found by the paper's method, or where no lens fits any few days.
    """
    if options.method != "robust":
        return ()
    search = StepSearch(site=site, image_size=image_size, options=options, circle=circle)
    steps: list[PoseChange] = []
    for epoch in np.unique(points.epoch).tolist():
        in_epoch = points.select(points.epoch == epoch)
        steps += search.steps(replace(in_epoch, epoch=np.zeros(len(in_epoch), dtype=np.int64)), lens)
    return tuple(sorted(steps, key=lambda step: step.bracket))


class StepSearch(NamedTuple):
    """Search for steps of the pose in a record: its inputs and stages."""

    site: Site
    image_size: tuple[int, int]
    options: CalibrationOptions
    circle: ImageCircle | None

    def steps(self, points: Sightings, lens: Calibration | None) -> list[PoseChange]:
        """Return the steps within one epoch."""
        stated = options_as_served(self.options, lens)
        if stated != self.options:
            return self._replace(options=stated).steps(points, lens)
        thin, day = _thin_by_day(points, self.site)
        days = np.unique(day)
        if days.size <= 2 * _BESIDE:
            spans = [(days[0], days[-1])] if days.size else []
        else:
            if lens is None:
                lens = self._fit_steadiest_days(thin, day, days)
                return [] if lens is None else self.steps(points, lens)
            spans = step_spans(self._measure_daily_rotations(thin, day, lens))
        found: list[PoseChange] = []
        for first, last in spans:
            found += self._verified(points, thin.select((day >= first) & (day <= last)))
        return distinct_steps(found)

    def _fit_steadiest_days(self, thin: Sightings, day: IntArray, days: IntArray) -> Calibration | None:
        """Return the fit of a few days that scatters least; a step within them makes it scatter."""
        fits = []
        for begin in np.unique(np.linspace(0, days.size - _LENS_DAYS, _LENS_TRIALS).astype(int)):
            some = thin.select(np.isin(day, days[begin : begin + _LENS_DAYS]))
            solved = calibrate(some, **self._asdict(), parts=False)
            if solved.verdict.accepted:
                fits.append((solved.metrics.rmse_px, solved.evidence.n_rejected, solved))
        return min(fits, key=lambda item: item[:2])[2] if fits else None

    def _measure_daily_rotations(self, thin: Sightings, day: IntArray, lens: Calibration) -> DailyRotations:
        """Return the rotation of each day, the lens's errors allowed for: another focus is no rotation."""
        of_days = [
            daily_pose_offset(thin.select(day == one), calibration=lens, site=self.site) for one in np.unique(day)
        ]
        days = stacked([DailyRotations.empty(), *(one for one in of_days if one is not None)])
        return replace(days, covariance_deg2=days.covariance_deg2 * np.eye(3))

    def _verified(self, points: Sightings, some: Sightings) -> list[PoseChange]:
        """Return the steps that a fit of a few days finds, dated among all sightings."""
        solved, _ = calibrate_moved(some, **self._asdict(), parts=False)
        found, pose = list[PoseChange](), solved.camera.rotation_cam_enu
        for move in reversed(solved.evidence.moves):
            before = pose_before(pose, move.rotation_deg)
            cameras = [replace(solved.camera, rotation_cam_enu=one) for one in (before, pose)]
            found.append(self._date_step(move, points, cameras))
            pose = before
        return found[::-1]

    def _date_step(self, move: PoseChange, points: Sightings, cameras: Sequence[Camera]) -> PoseChange:
        """Return the step between the sightings of the whole record that it came between."""
        near = (points.unix_s >= move.bracket[0]) & (points.unix_s <= move.bracket[1])
        usable = filter_sightings(points.select(near), site=self.site)
        row = min(max(best_row(slice(0, len(usable)), usable, cameras), 1), len(usable) - 1)
        before, after = usable.unix_s[row - 1 : row + 1].tolist()
        return replace(move, time=after, bracket=(before, after))


def _thin_by_day(points: Sightings, site: Site) -> tuple[Sightings, IntArray]:
    """Return some of each day's usable sightings, in the order of time, and the solar day of each."""
    usable = filter_sightings(points, site=site)
    retained = []
    for day in np.unique(usable.day):
        rows = np.flatnonzero(usable.day == day)
        if rows.size >= _FEWEST_PER_DAY:
            retained.append(rows[:: -(-rows.size // _PER_DAY)])
    rows = np.concatenate(retained) if retained else np.zeros(0, dtype=np.int64)
    return points.select(usable.index[rows]), usable.day[rows]


def step_spans(days: DailyRotations) -> list[tuple[int, int]]:
    """Return the first and last day around each step of the daily rotations, the clearest first."""
    gain = step_gains(days)
    found: list[tuple[int, int]] = []
    while len(found) < _MOST_PLACES and gain.max(initial=0.0) > DAYS.gain:
        row = int(np.argmax(gain))
        first, last = max(row - _BESIDE, 0), min(row + _BESIDE, len(gain)) - 1
        found.append((int(days.day[first]), int(days.day[last])))
        gain[first + 1 : last + 1] = -np.inf
    return found


def distinct_steps(steps: Sequence[PoseChange]) -> list[PoseChange]:
    """Return the steps without those that overlap one found in another place."""
    retained: list[PoseChange] = []
    for step in sorted(steps, key=lambda step: step.bracket):
        if not retained or step.bracket[0] >= retained[-1].bracket[1]:
            retained.append(step)
    return retained


# A record of a camera whose type of lens is known.


def calibrate_with_lens(
    points: Sightings,
    *,
    lens: LensType,
    site: Site,
    options: CalibrationOptions,
    circle: ImageCircle | None = None,
) -> Moved:
    """Return the camera of sightings and a type of lens: with a day of sun lens and pose, with few the pose.

    Parameters
    ----------
    points, site, options, circle : as `calibrate_moved` takes them; projection and handedness are those of the lens.
    lens : its type.
    """
    options = options_about(lens.camera, options)
    size = (lens.camera.width, lens.camera.height)
    moved_ = calibrate_moved(points, site=site, image_size=size, options=options, circle=circle)
    solved, points = moved_.calibration, moved_.points
    if solved.verdict.accepted:
        return Moved(apply_lens_prior(solved, lens, points=points, options=options), points)
    latest = points.select(np.flatnonzero(points.epoch == points.epoch.max(initial=0)))
    return Moved(first_pose(latest, lens=lens, site=site, options=options, pose=_default_pose_prior(options)), latest)


def _default_pose_prior(options: CalibrationOptions) -> FirstPoseOptions:
    """Return the prior of the pose where it is not stated: the tilt, by half of the limit of a fit."""
    if options.level_within_deg is None:
        return FirstPoseOptions()
    return FirstPoseOptions(tilt_deg=min(options.level_within_deg / 2.0, 15.0))
