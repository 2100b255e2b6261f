"""Moves of the camera within a record: where one pose leaves a jump, and the Bayes factor of two poses.

What one pose leaves over runs on smoothly through all that lens and sky do, within a day and from a day to the next at
the same hour. A move makes it jump. A jump is a suggestion only: a move counts when two poses lower the robust cost,
and are likelier by their marginal likelihood than one pose with a misfit of the lens and episodes of cloud.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import NamedTuple, Unpack

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from sunarc.calibration.calibrate import FitInput, calibrate, calibrate_chosen, prepared
from sunarc.calibration.evidence import RECORD_GAIN, log_marginal, matern_3_2
from sunarc.calibration.model.options import LensTolerances
from sunarc.calibration.model.result import Calibration, Move, residuals_by_pose
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.solve.priors import LENS, N_LENS, lens_prior, precisions
from sunarc.common.array_types import BoolArray, FloatArray, IntArray
from sunarc.common.findings import Finding
from sunarc.common.robust_statistics import finite, robust_sigma, tukey_loss
from sunarc.common.utc import DAY_S, rfc3339, utc_time
from sunarc.optics.camera import POSE, Camera, Param
from sunarc.optics.forward import project_fast, project_with_rows_fast
from sunarc.optics.pose import rotation_between

# Bayes factor of a step of the pose against one pose, by the residuals of a fit with and of one without it.
#
# Both hypotheses explain the residuals by small changes of the lens and the pose (linearised, with the fit's priors),
# by white and first-order autoregressive noise, by a smooth misfit over the sky, and by episodes in which cloud draws
# the detections aside; the first also by a turn from one sighting on. Amplitudes and episodes are chosen for each
# hypothesis by its own marginal likelihood. References: R. Kass and A. Raftery, "Bayes factors", J. Am. Stat. Assoc. 90
# (1995); C. Rasmussen and C. Williams, "Gaussian processes for machine learning" (2006), chapter 5.

_MOST_ROWS = 280
"""Rows of the covariance matrix; more sightings are gathered by their median (cost grows with the cube)."""
_DAYS_BESIDE = 3
"""Days with sightings on either side of the step that are looked at."""
LONGEST_EPISODE_S = 4500.0
"""Longest episode of cloud that competes with a step: what lasts longer and is constant is a move."""
_EPISODES_S = (900.0, 2400.0, LONGEST_EPISODE_S)
_MOST_EPISODES = 3
_EPISODE_TIMES_S = (300.0, 1200.0)
"""Correlation times of what cloud does to a detection."""
_EDGE_STEPS = (0.25, 0.25, 0.12, 0.06)
"""Steps by which the ends of an episode are moved, as shares of its length: a loose interval costs 10 powers of e."""
_EPISODE_GAIN = 2.0
"""Logarithm of the likelihood that an episode must gain: its own improbability."""
_POSE_RAD = 0.1
"""Prior 1-sigma of a correction of the pose about the fit; the same in both hypotheses."""
_RADIAL_PX, _DECENTERING_PX = 16.0, 3.0
_SPREAD_PER_MEDIAN = 1.2533
"""1-sigma of a median of many Gaussian numbers over that of their mean."""
_LOCAL = 4
"""Neighbours on each side whose running median reveals an isolated gross error."""
_GROSS_SIGMAS = 3.5
_UNSEEN_PX = 5e3
_RIGHT_ANGLE = math.pi / 2


class Amplitudes(NamedTuple):
    """Noise of the residuals, in units of the core's 1-sigma, and its scales by their place in the grid."""

    white: float = 1.0
    autoregressive: float = 0.0
    autoregressive_time: float = 0
    misfit: float = 0.0
    misfit_angle: float = 0


_GRID: dict[str, tuple[float, ...]] = {
    "white": (0.25, 0.5, 0.75, 1.0, 1.5),
    "autoregressive": (0.0, 0.5, 0.8, 1.1, 1.6),
    "autoregressive_time": (0, 1, 2),
    "misfit": (0.0, 0.5, 1.0, 2.0, 4.0),
    "misfit_angle": (0, 1),
}
_AUTOREGRESSIVE_STEPS = (1.5, 5.0, 15.0)
"""Correlation times of the noise, in usual steps between sightings."""
_MISFIT_ANGLES = (math.radians(9.0), math.radians(20.0))


class Episode(NamedTuple):
    """An interval in which detections drift by about an amplitude (px) with a correlation time (s)."""

    begin_s: float
    end_s: float
    amplitude_px: float
    time_s: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StepRows:
    """Gathered sightings near a step, and kernels between them, each (n, n)."""

    unix_s: FloatArray
    directions: FloatArray
    variance: FloatArray
    after: BoolArray
    sigma_px: float
    separation_s: FloatArray
    autoregressive: tuple[FloatArray, ...]
    misfit: tuple[FloatArray, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StepModel:
    """A linearised hypothesis: residuals (n, 2), derivatives (n, 2, p) by unknowns of unit prior variance."""

    rows: StepRows
    residual: FloatArray
    derivatives: FloatArray

    def log_likelihood(self, amplitudes: Amplitudes, episodes: tuple[Episode, ...]) -> float:
        """Return the logarithm of the marginal likelihood; minus infinity where the matrix is not positive definite."""
        covariance = noise_covariance(self.rows, amplitudes, episodes)
        try:
            return log_marginal(self.residual, covariance, self.derivatives)
        except np.linalg.LinAlgError:
            return -math.inf


def log_bayes_factor(
    row: int,
    usable: Sightings,
    *,
    one: tuple[Camera, FloatArray],
    two: tuple[Camera, FloatArray],
    turn_rad: float,
) -> float:
    """Return by how many powers of e a turn before a sighting explains the residuals better than one pose does.

    Parameters
    ----------
    row : the first sighting after the turn.
    usable : the sightings; those of the same epoch, days beside the turn, count.
    one : the camera without the turn, and its residuals (n, 2), px.
    two : the camera after the turn, and the residuals of the fit with two poses (n, 2), px.
    turn_rad : the angle between the two poses.
    """
    day = np.unique(usable.day, return_inverse=True)[1]
    near = (usable.epoch == usable.epoch[row]) & (np.abs(day - day[row]) <= _DAYS_BESIDE)
    for _, residual in (one, two):  # what either camera cannot see says nothing of the difference
        near &= np.linalg.norm(residual, axis=-1) < _UNSEEN_PX
    picked = np.flatnonzero(near)
    if not np.any(picked < row) or not np.any(picked >= row):
        return -math.inf
    member = group_members(picked, row, usable)
    rows = step_rows(picked, member, row, usable, two[1])
    models = []
    for (camera, residual), angle_rad in ((one, 0.0), (two, turn_rad)):
        gathered = group_medians(residual[picked], member)
        models.append(
            StepModel(rows=rows, residual=gathered, derivatives=_derivatives(camera, rows, turn_rad=angle_rad))
        )
    windows = cloud_windows(rows)
    without, with_turn = (_best(model, windows) for model in models)
    return with_turn - without - 1.5  # the turn that was fitted is one 1-sigma of its prior in each axis


def group_members(picked: IntArray, row: int, usable: Sightings) -> IntArray:
    """Return (n,): the group of consecutive sightings, of one day and side of the step, that each belongs to."""
    size = -(-picked.size // _MOST_ROWS)
    run = np.r_[0, np.cumsum((np.diff(usable.day[picked]) != 0) | (np.diff(picked >= row) != 0))]
    first = np.searchsorted(run, run)
    _, member = np.unique(run * picked.size + (np.arange(picked.size) - first) // size, return_inverse=True)
    return member.astype(np.int64)


def group_medians(values: FloatArray, member: IntArray) -> FloatArray:
    """Return the medians of groups (k, 2) of consecutive values (n, 2)."""
    starts = np.flatnonzero(np.r_[True, np.diff(member) != 0])
    return np.array([np.median(part, axis=0) for part in np.split(values, starts[1:])])


def step_rows(picked: IntArray, member: IntArray, row: int, usable: Sightings, residual: FloatArray) -> StepRows:
    """Return what both hypotheses share; the noise's scale and gross errors are those of the residuals about two."""
    count = np.bincount(member)
    middle = np.searchsorted(member, np.arange(count.size)) + count // 2
    times, directions = usable.unix_s[picked][middle], usable.directions[picked][middle]
    medians = group_medians(residual[picked], member)
    sigma = robust_sigma(np.linalg.norm(medians, axis=-1), share=0.5, floor=_FLOOR_PX)
    relative = usable.sigma_px[picked][middle]
    padded = np.pad(medians, ((_LOCAL, _LOCAL), (0, 0)), mode="reflect")
    running = np.median(sliding_window_view(padded, 2 * _LOCAL + 1, axis=0), axis=-1)
    gross = np.linalg.norm(medians - running, axis=-1) / (sigma * relative)
    variance = (
        relative**2 * np.where(count > 2, _SPREAD_PER_MEDIAN**2, 1.0) * np.maximum(gross / _GROSS_SIGMAS, 1.0) ** 4
    )
    separation = np.abs(times[:, None] - times)
    step = float(np.median(np.diff(times))) if times.size > 1 else 1.0
    angle = np.linalg.norm(directions[:, None] - directions, axis=-1)
    return StepRows(
        unix_s=times,
        directions=directions,
        variance=variance,
        after=picked[middle] >= row,
        sigma_px=sigma,
        separation_s=separation,
        autoregressive=tuple(np.exp(-separation / (steps * step)) for steps in _AUTOREGRESSIVE_STEPS),
        misfit=tuple(np.exp(-0.5 * (angle / length) ** 2) for length in _MISFIT_ANGLES),
    )


def _derivatives(camera: Camera, rows: StepRows, *, turn_rad: float) -> FloatArray:
    """Return (n, 2, p): the prediction by lens, pose and (`turn_rad` > 0) step, each of unit prior variance."""
    widest = float(np.clip(camera.max_angle, 0.1, _RIGHT_ANGLE))
    prior = lens_prior(camera, tolerances=LensTolerances(), circle=None, field_angle=widest)
    basis = np.zeros((len(Param), N_LENS + 3))
    basis[LENS, :N_LENS] = prior.basis / np.sqrt(precisions(_RADIAL_PX, _DECENTERING_PX))
    basis[POSE, N_LENS:] = _POSE_RAD * np.eye(3)
    by_parameters = project_with_rows_fast(camera, rows.directions)[1]
    derivatives = np.nan_to_num(by_parameters @ basis)
    if turn_rad <= 0.0:
        return np.asarray(derivatives)
    step = derivatives[..., N_LENS:] * (turn_rad / math.sqrt(3.0) / _POSE_RAD) * rows.after[:, None, None]
    return np.concatenate([derivatives, step], axis=-1)


def noise_covariance(rows: StepRows, amplitudes: Amplitudes, episodes: tuple[Episode, ...]) -> FloatArray:
    """Return the covariance (n, n) of one axis of the residuals, px²."""
    noise = amplitudes.autoregressive**2 * rows.autoregressive[int(amplitudes.autoregressive_time)]
    noise = noise + amplitudes.misfit**2 * rows.misfit[int(amplitudes.misfit_angle)]
    noise[np.diag_indices_from(noise)] += amplitudes.white**2 * rows.variance
    covariance = rows.sigma_px**2 * noise
    for episode in episodes:
        inside = np.flatnonzero((rows.unix_s >= episode.begin_s) & (rows.unix_s <= episode.end_s))
        square = np.ix_(inside, inside)
        covariance[square] += episode.amplitude_px**2 * matern_3_2(rows.separation_s[square], episode.time_s)
    return np.asarray(covariance)


def cloud_windows(rows: StepRows) -> list[tuple[float, float]]:
    """Return intervals in which cloud may have been: at the ends, beside and across the step, and regularly."""
    times, found = rows.unix_s, []
    at = float(times[rows.after][0])
    for long in _EPISODES_S:
        regular = np.arange(times[0], times[-1], 0.5 * long) if times[-1] - times[0] < 2.0 * DAY_S else np.zeros(0)
        begins = [times[0], times[-1] - long, at - long - 1.0, at, at - 0.5 * long, *regular.tolist()]
        found += [(float(begin), float(begin) + long) for begin in begins]
    return found


def _best(model: StepModel, windows: list[tuple[float, float]]) -> float:
    """Return the largest log likelihood over amplitudes and up to three episodes."""
    amplitudes, best = fitted_amplitudes(model, Amplitudes(), ())
    episodes: tuple[Episode, ...] = ()
    for _ in range(_MOST_EPISODES):
        tried = [(*episodes, _episode(model, window)) for window in windows]
        values = [model.log_likelihood(amplitudes, some) for some in tried]
        refined = refined_episodes(model, amplitudes, tried[int(np.argmax(values))])
        next_amplitudes, value = fitted_amplitudes(model, amplitudes, refined)
        value -= _EPISODE_GAIN * len(refined)
        if value <= best:
            break
        amplitudes, episodes, best = next_amplitudes, refined, value
    return best


def _episode(model: StepModel, window: tuple[float, float]) -> Episode:
    """Return an episode of the amplitude that the residuals have within an interval."""
    inside = (model.rows.unix_s >= window[0]) & (model.rows.unix_s <= window[1])
    size = float(np.median(np.linalg.norm(model.residual[inside], axis=-1))) if np.any(inside) else 0.0
    return Episode(*window, amplitude_px=max(size, 2.0 * model.rows.sigma_px), time_s=_EPISODE_TIMES_S[1])


def refined_episodes(model: StepModel, amplitudes: Amplitudes, episodes: tuple[Episode, ...]) -> tuple[Episode, ...]:
    """Return the episodes, the last one with its best interval, amplitude and correlation time."""

    def best(tried: Iterable[Episode]) -> tuple[Episode, ...]:
        candidates = [episodes, *((*episodes[:-1], one) for one in tried)]
        return max(candidates, key=lambda some: model.log_likelihood(amplitudes, some))

    for step in _EDGE_STEPS:
        last = episodes[-1]
        shift = step * (last.end_s - last.begin_s)
        moved = [
            last._replace(begin_s=last.begin_s + begin * shift, end_s=last.end_s + end * shift)
            for begin, end in itertools.product((-1, 0, 1), repeat=2)
        ]
        episodes = best(one for one in moved if one.end_s - one.begin_s <= LONGEST_EPISODE_S)
        last = episodes[-1]
        episodes = best(
            last._replace(amplitude_px=factor * last.amplitude_px, time_s=time)
            for factor, time in itertools.product((0.5, 1.0, 2.0), _EPISODE_TIMES_S)
        )
    return episodes


def fitted_amplitudes(model: StepModel, begin: Amplitudes, episodes: tuple[Episode, ...]) -> tuple[Amplitudes, float]:
    """Return the amplitudes of the largest log likelihood by coordinate ascent on the grid, and that likelihood."""
    best, value = begin, model.log_likelihood(begin, episodes)
    for _ in range(2):
        before = value
        for name, choices in _GRID.items():
            for choice in choices:
                trial = best._replace(**{name: choice})
                if trial == best:
                    continue
                reached = model.log_likelihood(trial, episodes)
                if reached > value:
                    best, value = trial, reached
        if value - before < 0.5:
            break
    return best, value


_SIDE = 12
"""Sightings that are looked at on either side of a gap."""
_LONGEST_S = 7200.0
"""Time that they may take together: over a longer one a smooth error is no straight line."""
_JUMP_PER_SIGMA = 0.8
"""1-sigma of a jump where there is none, in that of a sighting: two medians of 12, each at the end of a line."""
_MEDIAN_DISTANCE = 1.1774
"""Median length of a round Gaussian vector, in sigmas."""
_JUMP_SIGMAS = 4.0
_JUMPS_TRIED = 3
_NIGHT_RATIO = 4.0
_SMALLEST_NIGHT_DEG = 0.05
"""Mounts wander by less from a day to the next."""
_GAIN = 40.0
"""What three more unknowns must take from the squares of the residuals, in variances, wherever the move may be."""
_MOST = 6
_FEWEST = 20
_FLOOR_PX = 1e-3
_Fit = Callable[..., Calibration]


class Moved(NamedTuple):
    """A calibration, and the sightings as it was given them: numbered by the pose that they belong to."""

    calibration: Calibration
    points: Sightings


class _Parted(NamedTuple):
    row: int
    smallest_deg: float


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
    found, usable = calibrate_chosen(lens), usable.select(~usable.alone)
    if not len(usable) or np.any(points.epoch != points.epoch[:1]) or options.method != "robust":
        return Moved(lens.allowed_for(found), points)
    begin: Camera | None = None
    for _ in range(_MOST):
        better = _with_one_more(points, usable, found, fit)
        if better is None:
            break
        begin = found.camera
        found, points = better
        usable = replace(usable, epoch=points.epoch[usable.index])
    if begin is not None:
        found = judged(points, start=begin)
    return Moved(_with_moves(lens.allowed_for(found), usable), points)


def _with_one_more(points: Sightings, usable: Sightings, solved: Calibration, fit: _Fit) -> Moved | None:
    """Return the fit with one move more, or None where none makes it clearly better."""
    residual = _residuals(solved, usable)
    tried = []
    for suggested in (*jumps_within_days(residual, usable), *night_changes(residual, usable)):
        found = _parted_at(suggested.row, points, usable, solved.camera, fit)
        if found is None:
            continue
        numbered = replace(usable, epoch=found.points.epoch[usable.index])
        there = _residuals(found.calibration, numbered)
        row = int(np.flatnonzero(numbered.epoch != usable.epoch)[0])
        ended = int(usable.epoch[row])
        turn_rad = rotation_between(*found.calibration.poses[ended : ended + 2])
        gain = robust_gain(residual, there, usable, found.calibration)
        if gain > _GAIN and math.degrees(turn_rad) > suggested.smallest_deg:
            tried.append((gain, row, turn_rad, there, found))
    for _, row, turn_rad, there, found in sorted(tried, key=lambda item: -item[0]):
        ended = int(usable.epoch[row])
        one = _lens_in(solved, solved.poses[ended]), residual
        two = _lens_in(found.calibration, found.calibration.poses[ended + 1]), there
        if log_bayes_factor(row, usable, one=one, two=two, turn_rad=turn_rad) > RECORD_GAIN:
            return found
    return None


def _parted_at(row: int, points: Sightings, usable: Sightings, begin: Camera, fit: _Fit) -> Moved | None:
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
        cameras = [_lens_in(fitted, pose) for pose in fitted.poses[first:]]
        better = best_row(slice(max(row - _SIDE // 2, 0), row + _SIDE // 2), usable, cameras)
        if better == row:
            break
        row = better
    return Moved(fitted, parted)


def best_row(near: slice, usable: Sightings, cameras: Sequence[Camera]) -> int:
    """Return which row a move came before, by the cameras before and after it.

    Parameters
    ----------
    near : the rows that it may have come before; `start` is given.
    usable : sightings in the order of time.
    cameras : the first two are looked at.
    """
    off = [np.linalg.norm(usable.pixels[near] - project_fast(c, usable.directions[near]), axis=-1) for c in cameras[:2]]
    scale = robust_sigma(np.minimum(*off), share=0.5, floor=_FLOOR_PX)
    before, after = (tukey_loss(finite(distance), sigma=scale) for distance in off)
    # cost of every row as the first of the new pose, in one pass
    wrong = np.r_[0.0, np.cumsum(before - after)]
    return int(near.start + np.argmin(wrong))


def _lens_in(solved: Calibration, pose: tuple[float, float, float]) -> Camera:
    """Return the camera in a pose, without its displacement: a field takes up what a move within the sightings does."""
    return replace(solved.camera, rotation_cam_enu=pose, displacement=None)


def _residuals(solved: Calibration, usable: Sightings) -> FloatArray:
    """Return observed minus predicted by the lens alone, (n, 2) px; what the camera cannot see is far off."""
    return finite(residuals_by_pose(replace(solved.camera, displacement=None), solved.poses, usable))


def robust_gain(before: FloatArray, after: FloatArray, usable: Sightings, solved: Calibration) -> float:
    """Return what the robust squares lost, in variances of a sighting whose neighbours err like it."""
    distances = [np.hypot(residual[:, 0], residual[:, 1]) / usable.sigma_px for residual in (before, after)]
    sigma = robust_sigma(distances[1], floor=_FLOOR_PX)
    one, other = (float(np.sum(tukey_loss(distance, sigma=sigma))) for distance in distances)
    return 2.0 * (one - other) / max(solved.evidence.inflation, 1.0)


def jumps_within_days(residual: FloatArray, usable: Sightings) -> list[_Parted]:
    """Return where the residuals jump within a day and a pose, against how they scatter there and wander elsewhere."""
    if len(usable) < 2 * _SIDE:
        return []
    time = usable.unix_s - usable.unix_s[0]
    jump, scatter = line_misses(residual, time)
    usual = float(np.median(jump)) / _MEDIAN_DISTANCE
    first, last = np.arange(jump.size), np.arange(jump.size) + 2 * _SIDE - 1
    run = usable.day * (1 + int(usable.epoch.max())) + usable.epoch
    complete = (run[first] == run[last]) & (time[last] - time[first] <= _LONGEST_S)
    score = np.where(complete, jump / np.maximum(_JUMP_PER_SIGMA * scatter, max(usual, _FLOOR_PX)), 0.0)
    found: list[_Parted] = []
    while len(found) < _JUMPS_TRIED and score.max() > _JUMP_SIGMAS:
        best = int(np.argmax(score))
        found.append(_Parted(best + _SIDE, 0.0))
        score[max(best - _SIDE, 0) : best + _SIDE + 1] = 0.0
    return found


def line_misses(residual: FloatArray, time: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return by how much the lines through the sightings before and after each gap miss one another, px.

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


def night_changes(residual: FloatArray, usable: Sightings) -> list[_Parted]:
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
    stands_out = greatest > max(_NIGHT_RATIO * usual, _FLOOR_PX)
    return [_Parted(row, _SMALLEST_NIGHT_DEG)] if stands_out else []


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


def _with_moves(solved: Calibration, usable: Sightings) -> Calibration:
    """Return the calibration with its moves in its evidence, and in words."""
    moves, found = [], []
    for row in np.flatnonzero(np.diff(usable.epoch)):
        poses = solved.poses[usable.epoch[row] :][:2]
        before, after = usable.unix_s[row : row + 2].tolist()
        turn_deg = math.degrees(rotation_between(*poses))
        moves.append(Move(before_unix_s=before, after_unix_s=after, turn_deg=turn_deg, pose_before=poses[0]))
        first, last = (rfc3339(utc_time(unix_s), timespec="seconds") for unix_s in (before, after))
        found.append(Finding("pose_changed", {"before": first, "after": last, "turn_deg": turn_deg}))
    verdict = replace(solved.verdict, findings=(*solved.verdict.findings, *found))
    return replace(solved, evidence=replace(solved.evidence, moves=tuple(moves)), verdict=verdict)
