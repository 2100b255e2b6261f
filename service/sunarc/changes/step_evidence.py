"""Bayes factor of a turn of the camera within a record against one pose, by the residuals of a fit with and without it.

Both hypotheses explain the residuals by small changes of the lens and the pose (linearised, with the fit's priors),
by white and first-order autoregressive noise, by a smooth misfit over the sky, and by episodes in which cloud draws
the detections aside; the first also by a turn from one sighting on. Amplitudes and episodes are chosen for each
hypothesis by its own marginal likelihood. References: R. Kass and A. Raftery, "Bayes factors", J. Am. Stat. Assoc. 90
(1995); C. Rasmussen and C. Williams, "Gaussian processes for machine learning" (2006), chapter 5.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sunarc.calibration.evidence import RECORD, log_marginal, matern_3_2
from sunarc.calibration.model.options import LensTolerances
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.solve.priors import LENS, N_LENS, lens_prior, precisions
from sunarc.common.array_types import BoolArray, FloatArray, IntArray
from sunarc.common.robust_statistics import off_neighbours, robust_sigma
from sunarc.common.utc import DAY_S
from sunarc.optics.camera import POSE, Camera, Param
from sunarc.optics.forward import project_with_rows_fast

_MOST_ROWS = 280
"""Rows of the covariance matrix; more sightings are gathered by their median (cost grows with the cube)."""
_DAYS_BESIDE = 3
"""Days with sightings on either side of the step that are used."""
LONGEST_EPISODE_S = 4500.0
"""Longest episode of cloud that competes with a step: a longer constant shift is a move."""
_EPISODES_S = (900.0, 2400.0, LONGEST_EPISODE_S)
_MOST_EPISODES = 3
_EPISODE_TIMES_S = (300.0, 1200.0)
"""Correlation times of the cloud's effect on a detection."""
_EDGE_STEPS = (0.25, 0.25, 0.12, 0.06)
"""Steps by which the ends of an episode are moved, as shares of its length: a loose interval costs log odds of 10."""
_EPISODE_GAIN = 2.0
"""Logarithm of the likelihood that an episode must gain: its own improbability."""
_POSE_RAD = math.radians(RECORD.turn_deg)
_RADIAL_PX, _DECENTERING_PX = 16.0, 3.0
_SPREAD_PER_MEDIAN = 1.2533
"""1-sigma of a median of many Gaussian numbers over that of their mean."""
_GROSS_SIGMAS = 3.5
_UNSEEN_PX = 5e3
_RIGHT_ANGLE = math.pi / 2
FLOOR_PX = 1e-3
"""Least scatter of residuals."""


class Amplitudes(NamedTuple):
    """Noise amplitudes of the residuals in units of their core's 1-sigma, and their scales, as grid indices."""

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
    """Interval in which detections drift by about an amplitude (px) with a correlation time (s)."""

    begin_s: float
    end_s: float
    amplitude_px: float
    time_s: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StepRows:
    """Grouped sightings near a step, and the kernels between them, each (n, n)."""

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
    """Return the log odds of a turn before a sighting against one pose.

    Parameters
    ----------
    row : the first sighting after the turn.
    usable : the sightings; those of the same epoch, days around the turn, count.
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
            StepModel(rows=rows, residual=gathered, derivatives=_make_derivatives(camera, rows, turn_rad=angle_rad))
        )
    windows = cloud_windows(rows)
    without, with_turn = (_maximise_likelihood(model, windows) for model in models)
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
    """Return the common part of both hypotheses; noise and gross errors are those of the residuals about two."""
    count = np.bincount(member)
    middle = np.searchsorted(member, np.arange(count.size)) + count // 2
    times, directions = usable.unix_s[picked][middle], usable.directions[picked][middle]
    medians = group_medians(residual[picked], member)
    sigma = robust_sigma(np.linalg.norm(medians, axis=-1), share=0.5, floor=FLOOR_PX)
    relative = usable.sigma_px[picked][middle]
    gross = off_neighbours(medians) / (sigma * relative)
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


def _make_derivatives(camera: Camera, rows: StepRows, *, turn_rad: float) -> FloatArray:
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
    """Return intervals in which cloud may have been: at the ends, next to and across the step, and regularly."""
    times, found = rows.unix_s, []
    at = float(times[rows.after][0])
    for long in _EPISODES_S:
        regular = np.arange(times[0], times[-1], 0.5 * long) if times[-1] - times[0] < 2.0 * DAY_S else np.zeros(0)
        begins = [times[0], times[-1] - long, at - long - 1.0, at, at - 0.5 * long, *regular.tolist()]
        found += [(float(begin), float(begin) + long) for begin in begins]
    return found


def _maximise_likelihood(model: StepModel, windows: list[tuple[float, float]]) -> float:
    """Return the largest log likelihood over amplitudes and up to three episodes."""
    amplitudes, best = fitted_amplitudes(model, Amplitudes(), ())
    episodes: tuple[Episode, ...] = ()
    for _ in range(_MOST_EPISODES):
        tried = [(*episodes, _make_episode(model, window)) for window in windows]
        values = [model.log_likelihood(amplitudes, some) for some in tried]
        refined = refined_episodes(model, amplitudes, tried[int(np.argmax(values))])
        next_amplitudes, value = fitted_amplitudes(model, amplitudes, refined)
        value -= _EPISODE_GAIN * len(refined)
        if value <= best:
            break
        amplitudes, episodes, best = next_amplitudes, refined, value
    return best


def _make_episode(model: StepModel, window: tuple[float, float]) -> Episode:
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
