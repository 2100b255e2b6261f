"""Smoothness of a day's arc (Eq. 20), and the days of its sightings that a fit does not explain."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sunarc.calibration.answers.covariance import project_with_covariance
from sunarc.calibration.model.result import Calibration, residuals_by_pose
from sunarc.calibration.model.sightings import Kind, Sightings
from sunarc.common.array_types import BoolArray, FloatArray, IntArray
from sunarc.common.findings import Data
from sunarc.common.robust_statistics import cauchy_weights, robust_sigma, tukey_weights
from sunarc.common.utc import DAY_S
from sunarc.sky.days import day_to_date
from sunarc.sky.directions import angular_distance

_ORDER = 9
_ORDER_OF_DAYS, _ORDER_OF_CHANGE = 7, 3
"""Of the arc that days of few sightings have in common, and of its change from day to day."""
_SAME_HOURS = 0.02
"""Least change of a polynomial over the hours by which it is another one."""
_ROUNDS, _ROUNDS_OF_DAYS = 12, 3
"""Rounds of weights; of few sightings for each unknown more of them would leave only those that it meets."""
_POLYNOMIAL_PX = 0.2
"""How well a 9th-order polynomial follows a whole day's arc; finer sightings must not be blamed for its misfit."""
_LARGEST_GAP = math.radians(5.0)


def smooth_arc(
    pixels: FloatArray, angle: FloatArray, order: int | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fit Eq. 20 robustly: polynomials of 9th order in the hour angle.

    Parameters
    ----------
    pixels : (n, 2) px.
    angle : (n,) hour angles, radians; a day across the date line of the hour angle is unwrapped. Or times, days.
    order : of the polynomials; None for the ninth, a third of the sightings at most.

    Returns
    -------
    arc : (n, 2) px; residual: (n, 2) observed minus arc; weight: (n,) 0 for sightings off the arc.
    """
    order = min(_ORDER, max(1, pixels.shape[0] // 3)) if order is None else order
    return _fit_robustly(_chebyshev_columns(angle, order), pixels)


def smooth_days(pixels: FloatArray, angle: FloatArray, day: IntArray) -> tuple[FloatArray, int]:
    """Return the residuals (n, 2) of consecutive days about one arc that changes steadily, and its unknowns.

    Parameters
    ----------
    pixels : (n, 2) px.
    angle : (n,) hour angles, radians.
    day : (n,) solar days: some, over which the sun's declination changes evenly.
    """
    since = day - day.mean()
    steady = _chebyshev_columns(angle, _ORDER_OF_CHANGE) * (since / max(float(np.abs(since).max()), 1.0))[:, None]
    columns = np.concatenate([_chebyshev_columns(angle, _ORDER_OF_DAYS), steady], axis=-1)
    # images at the same hours of each day determine no more of the arc
    unknowns = int(np.linalg.matrix_rank(columns, tol=_SAME_HOURS * math.sqrt(len(columns))))
    return _fit_robustly(columns, pixels, rounds=_ROUNDS_OF_DAYS)[1], unknowns


def _chebyshev_columns(angle: FloatArray, order: int) -> FloatArray:
    """Return the Chebyshev polynomials (n, order + 1) of hour angles or times (n,)."""
    # in polar summer the hour angle passes 180 degrees while the sun is up
    unwrapped = np.unwrap(angle)
    middle, half = 0.5 * (unwrapped.max() + unwrapped.min()), 0.5 * np.ptp(unwrapped)
    return np.asarray(np.polynomial.chebyshev.chebvander((unwrapped - middle) / max(half, 1e-9), order))


def _fit_robustly(
    columns: FloatArray, pixels: FloatArray, *, rounds: int = _ROUNDS
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the fit (n, 2) of columns (n, p) to pixels, the residuals (n, 2), and the weights (n,)."""
    weight = np.ones(pixels.shape[0])
    for number in range(rounds):
        weighed = (columns * weight[:, None]).T
        arc = columns @ np.linalg.lstsq(weighed @ columns, weighed @ pixels)[0]
        distance = np.linalg.norm(pixels - arc, axis=-1)
        sigma = robust_sigma(distance, share=0.5 if number < 4 else 0.3, floor=_POLYNOMIAL_PX)
        weight = cauchy_weights(distance, scale=sigma) if number < 6 else tukey_weights(distance, sigma=sigma)
    return arc, pixels - arc, weight


def arc_length_deg(directions: FloatArray) -> float:
    """Return the length of the way through directions (n, 3) in degrees; a longer gap counts as 5 degrees.

    So few sightings far apart (a host that missed most slots) have the arc of their surroundings, and not none.
    """
    step = angular_distance(directions[1:], directions[:-1])
    return math.degrees(float(np.sum(np.minimum(step, _LARGEST_GAP))))


# Whether a fit explains the days of its sightings: one of two lenses meets half of them, and states a small error.

_FEWEST_TO_JUDGE = 20
"""Sightings that show whether it was clear; days of fewer are judged with those after them, by the same hours."""
_FEWEST_OF_HALF = 6
_STATED_AT = 40
"""Sightings of a half-day, at most, at which the stated error of a fit is evaluated: it is smooth."""
_SHORTEST_HALF_S = 9000.0
"""From the first to the last sighting of a half-day that is judged: twice as long as cloud draws them aside."""
_FEWEST_FOR_SHARE = 12
_OF_EACH_TERM, _ALIKE = 6, 0.35
"""Left-out sightings for each order of their arc, and the largest scatter about it of those of one camera, in how far
off they lie: of blocks of cloud it is half and more."""
_SMOOTH_SHARE = 0.8
"""Share of a clear day's sightings that run smoothly about the fit."""
_CLEAR_SIGMA_PX = 1.0
_CLEAR_SIGMAS = 3.0
"""Largest scatter of a clear day, px per axis, or in that of the fit where that is larger."""
_FLOOR_PX = 0.05
_MISFIT_PX = 0.3
"""1-sigma by which lens, air and mount may be wrong all through a half-day, px; the fit's scatter if larger."""
_FAR = 5.0
"""Sigmas: as far off as a single sighting that counts nothing."""
_LARGEST_CORRELATION = 0.995
_MEDIAN = 1.2533
"""1-sigma of a median over that of a mean: the root of π / 2."""


class _HalfDay(NamedTuple):
    """Deviation of a half-day, px, in how many of its sigmas, and the day, counted from 1970."""

    off_px: float
    sigmas: float
    day: int


class Unexplained(NamedTuple):
    """Sightings of clear days that a fit left out, and half-days far from it: data of two findings."""

    left_out: Data
    far: Data | None


def unexplained_days(calibration: Calibration, usable: Sightings) -> Unexplained | None:
    """Return by how much a fit fails to explain the days of its sightings; None where it is not known which it used.

    Of the sun's track alone. A day is clear where its sightings run smoothly about the fit, however far off they lie:
    false sightings scatter, and those of another lens do not. So is one whose left-out sightings run smoothly. Others
    count neither for the fit nor against it, nor do left-out sightings that scatter.

    Parameters
    ----------
    calibration : the fit, with the sightings that it used.
    usable : the sightings that it was given.
    """
    if calibration.left_out is None:
        return None
    track = (usable.kind == Kind.SUN) & ~usable.alone
    # as far as the lens is defined
    camera = replace(calibration.camera, max_angle=np.pi)
    residual = np.nan_to_num(residuals_by_pose(camera, calibration.poses, usable))
    used = ~np.isin(usable.index, calibration.left_out)
    clear, parts = np.zeros_like(track), list[tuple[IntArray, FloatArray]]()
    largest = max(_CLEAR_SIGMA_PX, _CLEAR_SIGMAS * calibration.evidence.sigma_px)
    for rows in _group_days(usable, np.flatnonzero(track), _FEWEST_TO_JUDGE):
        smooth, rough = _runs_smoothly(residual[rows], usable, rows, largest)
        if smooth:
            fresh = np.flatnonzero(~clear[rows])
            for of_day in np.split(fresh, np.flatnonzero(np.diff(usable.day[rows[fresh]])) + 1):
                parts += _split_into_halves(usable, rows[of_day], rough[of_day])
            clear[rows] = True
    # those of another camera run smoothly, from day to day too, and those that cloud draws aside do not
    for rows in _group_days(usable, np.flatnonzero(track & ~used), 2 * _FEWEST_FOR_SHARE):
        if _is_alike(residual[rows], usable, rows, largest):
            clear |= track & np.isin(usable.day, usable.day[rows]) & (usable.epoch == usable.epoch[rows[0]])
        else:
            clear[rows] = False
    share, n = max(
        _count_left_out(clear, used), _count_left_out(clear & (usable.epoch == usable.epoch.max(initial=0)), used)
    )
    halves = _measure_half_days(calibration, usable, residual, parts)
    far = [one for one in halves if one.sigmas > _FAR]
    if not far:
        return Unexplained({"share": share, "n": n}, None)
    worst = max(far, key=lambda one: one.sigmas)
    far_off: Data = {
        "n_far": len(far),
        "n_half_days": len(halves),
        "far": _FAR,
        "off_px": worst.off_px,
        "sigmas": worst.sigmas,
        "day": day_to_date(worst.day).isoformat(),
    }
    return Unexplained({"share": share, "n": n}, far_off)


def _group_days(usable: Sightings, rows: IntArray, fewest: int) -> Iterator[IntArray]:
    """Yield the rows of each day; days of few join each other, before a full day they are left out.

    The last days of few of an epoch are joined by the rows before them.
    """
    for epoch_rows in np.split(rows, np.flatnonzero(np.diff(usable.epoch[rows])) + 1):
        together = rows[:0]
        for of_day in np.split(epoch_rows, np.flatnonzero(np.diff(usable.day[epoch_rows])) + 1):
            together = np.concatenate([together, of_day]) if of_day.size < fewest else of_day
            if together.size >= fewest:
                yield together
                together = rows[:0]
        if together.size and epoch_rows.size >= _FEWEST_FOR_SHARE:
            yield epoch_rows[-max(fewest, together.size) :]


def _runs_smoothly(
    residual: FloatArray, usable: Sightings, rows: IntArray, largest_px: float
) -> tuple[bool, FloatArray]:
    """Return whether residuals (n, 2) of rows run smoothly over the day to a scatter, px, and their scatter (n, 2)."""
    _, rough, weight = smooth_arc(residual, usable.unix_s[rows] / DAY_S - usable.day[rows])
    scatter_px = robust_sigma(np.linalg.norm(rough, axis=-1), floor=_FLOOR_PX)
    return float(np.mean(weight > 0.0)) >= _SMOOTH_SHARE and scatter_px <= largest_px, rough


def _is_alike(residual: FloatArray, usable: Sightings, rows: IntArray, largest_px: float) -> bool:
    """Return whether residuals (n, 2) of sightings that a fit left out run so smoothly that they are of one camera."""
    order = min(_ORDER, rows.size // _OF_EACH_TERM)
    _, rough, weight = smooth_arc(residual, usable.unix_s[rows] / DAY_S - usable.day[rows], order)
    off, scatter = (robust_sigma(np.linalg.norm(one, axis=-1), floor=_FLOOR_PX) for one in (residual, rough))
    return float(np.mean(weight > 0.0)) >= _SMOOTH_SHARE and scatter <= min(largest_px, _ALIKE * off)


def _count_left_out(counted: BoolArray, used: BoolArray) -> tuple[float, int]:
    """Return the share of some sightings that was left out, and how many they are; 0 of too few."""
    n = int(counted.sum())
    return (float(np.mean(~used[counted])), n) if n >= _FEWEST_FOR_SHARE else (0.0, n)


def _split_into_halves(usable: Sightings, rows: IntArray, rough: FloatArray) -> Iterator[tuple[IntArray, FloatArray]]:
    """Yield the rows (k,) of the halves of a day that are judged, with their residuals (k, 2) about smooth groups."""
    afternoon = usable.directions[rows, 0] < 0.0  # the sun is in the west
    for half in (~afternoon, afternoon):
        seen = rows[half]
        if seen.size >= _FEWEST_OF_HALF and np.ptp(usable.unix_s[seen]) >= _SHORTEST_HALF_S:
            yield seen, rough[half]


def _measure_half_days(
    calibration: Calibration, usable: Sightings, residual: FloatArray, halves: Sequence[tuple[IntArray, FloatArray]]
) -> list[_HalfDay]:
    """Return how far halves of days, see `_split_into_halves`, lie off by residuals (n, 2) of all sightings."""
    some = [seen[:: -(-seen.size // _STATED_AT)] for seen, _ in halves]
    part = np.repeat(np.arange(len(some)), [one.size for one in some])
    # all at once: a call costs as much as some hundred directions
    rows = np.concatenate([*some, np.zeros(0, dtype=np.int64)])
    _, stated = project_with_covariance(calibration, usable.directions[rows])
    found = []
    for number, (seen, rough) in enumerate(halves):
        noise = robust_sigma(np.linalg.norm(rough, axis=-1), share=0.5, floor=_FLOOR_PX)
        power = float(np.sum(rough**2))
        correlation = float(np.sum(rough[1:] * rough[:-1])) / power if power > 0.0 else 0.0
        correlation = min(max(correlation, 0.0), _LARGEST_CORRELATION)
        alike = (1.0 + correlation) / (1.0 - correlation)  # by how much more a mean varies as neighbours err alike
        off = np.median(residual[seen], axis=0)
        variance = np.nan_to_num(np.mean(stated[part == number], axis=0)) + np.eye(2) * (
            _MEDIAN**2 * noise**2 * alike / seen.size + max(_MISFIT_PX, calibration.evidence.sigma_px) ** 2
        )
        sigmas = float(np.sqrt(off @ np.linalg.solve(variance, off)))
        found.append(_HalfDay(float(np.linalg.norm(off)), sigmas, int(usable.day[seen[0]])))
    return found
