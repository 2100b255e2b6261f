"""How smooth a day's arc is (Eq. 20), what kind of day that makes, and whether a fit explains its days."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import date
from typing import Literal, NamedTuple

import numpy as np

from sunarc.array_types import BoolArray, FloatArray, IntArray
from sunarc.calibration.answers.covariance import project_with_covariance
from sunarc.calibration.model.result import Calibration, measures, residuals_by_pose
from sunarc.calibration.model.sightings import MAX_CLOCK_ERROR_S, Kind, Sightings, filter_sightings
from sunarc.calibration.robust_loss import robust_sigma, tukey_weights
from sunarc.calibration.selection import solid_angle_sr
from sunarc.findings import Finding
from sunarc.robust_statistics import cauchy_weights
from sunarc.sky.days import date_of_day, day_bounds_unix_s, day_of_date, solar_date
from sunarc.sky.directions import angular_distance
from sunarc.sky.site import Site
from sunarc.sky.sun import hour_angle, sun_angles

# How well the slots in which the sun was observed stand for all slots of the time between.

PERIOD_S = 600.0
"""Slots within this time count as one independent sample of the clouds, s: about half of the time in which a cumulus
cloud and a gap pass; `docs/studies/missed_slots.py` shows the error rates that come of it."""
_QUANTILE = 1.645  # of the normal distribution: one-sided 95 %


@dataclass(frozen=True, slots=True, kw_only=True)
class DaySampling:
    """The slots of a day in which sun exposures were taken.

    Attributes
    ----------
    n_observed : slots with at least one sun exposure.
    n_span : slots between the first and the last of them, both included.
    n_periods : different periods of 10 minutes with an observed slot.
    """

    n_observed: int
    n_span: int
    n_periods: int

    def lowest_share(self, n_on_arc: int) -> float:
        """Return the one-sided 95 % lower bound of the share of the span's slots that would lie on the arc.

        Wilson's (1927) score bound for `n_periods` samples at most, with the correction for a finite population: where
        every slot of the span was observed there is nothing to infer, and the bound is the share itself.
        """
        share = min(n_on_arc / max(self.n_observed, 1), 1.0)
        # the finite population's correction: slots that were seen need no inference
        not_observed = 1.0 - self.n_observed / max(self.n_span, self.n_observed, 1)
        if not_observed <= 0.0:
            return share
        square = _QUANTILE**2 * not_observed / max(min(self.n_observed, self.n_periods), 1)
        spread = math.sqrt(square * (share * (1.0 - share) + 0.25 * square))
        return (share + 0.5 * square - spread) / (1.0 + square)


def sampling_of(observed_unix_s: FloatArray, *, cadence_s: float, n_possible: int) -> DaySampling:
    """Return the sampling of a day from the times of its sun exposures.

    Parameters
    ----------
    observed_unix_s : (n,) mid-exposure times, s since 1970-01-01 UTC; those of one slot count once, NaN not at all.
    cadence_s : seconds from slot to slot.
    n_possible : slots of the day with the sun up, which the span cannot exceed.
    """
    times = observed_unix_s[np.isfinite(observed_unix_s)]
    slots = np.unique(np.floor(times / cadence_s))
    span = int(slots[-1] - slots[0]) + 1 if slots.size else 0
    return DaySampling(
        n_observed=int(slots.size),
        n_span=max(min(span, n_possible), int(slots.size)),
        n_periods=int(np.unique(np.floor(times / PERIOD_S)).size),
    )


def fully_observed(n_possible: int) -> DaySampling:
    """Return the sampling of a day of which every possible slot counts as observed."""
    return DaySampling(n_observed=n_possible, n_span=n_possible, n_periods=n_possible)


DayKind = Literal["clear", "partly", "cloudy", "unusable"]

_SHOW_THE_SUN = frozenset[DayKind]({"clear", "partly"})
_ORDER = 9
_ROUNDS = 12
_POLYNOMIAL_PX = 0.2
"""How well a 9th-order polynomial follows a whole day's arc; finer sightings must not be blamed for its misfit."""
_HORIZON_DEG = 89.6
_LARGEST_GAP = math.radians(5.0)

_CLEAR_SHARE = 0.8
"""Smallest share of the observed slots on the arc of a clear day; of its lower 95 % bound where slots were missed."""
_PARTLY_SHARE = 0.3
"""Smallest share of a partly cloudy day."""
_CLEAR_SD_PX = 1.5
"""Largest scatter of all sightings about the arc on a clear day, px."""
_MIN_COUNT = 20
_MIN_ARC_DEG = 15.0
"""Fewer sightings on the arc, or a shorter arc, make a day unusable."""
DOUBTFUL_CLOCK_SHARE = 0.5
"""A day is unusable where the clock of a larger share of its sightings may be wrong by more than 2 s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DayMeasure:
    """What a day's sightings show.

    Attributes
    ----------
    date : local mean solar date, ISO 8601; "" without sightings.
    n : sightings usable; n_on_arc: those on the smooth arc.
    n_cycles : cycles with at least one on the arc (a bracket is one); n_possible: cycles with the sun up.
    n_observed : cycles in which sun exposures were taken, whatever they showed.
    lowest_share : lower 95 % bound of the share of the cycles between the first and the last observed one that would
        lie on the arc; the share itself where all of them were observed.
    sd_px : standard deviation of the distances from the arc (Eq. 27c as the paper's Table 1 has it), all sightings.
    rmsd_px : root of the mean square distance from the arc, all sightings.
    arc_deg : length of the sun's way between the first and the last sighting on the arc, gaps counted up to 5 degrees.
    solid_angle_sr : solid angle of the patches of sky, 2 degrees wide, with a sighting on the arc.
    doubtful_clock : share of the sightings whose clock may be wrong by more than allowed.
    """

    date: str = ""
    n: int
    n_on_arc: int = 0
    n_cycles: int = 0
    n_possible: int
    n_observed: int
    lowest_share: float = 0.0
    sd_px: float = math.nan
    rmsd_px: float = math.nan
    arc_deg: float = 0.0
    solid_angle_sr: float = 0.0
    doubtful_clock: float


@dataclass(frozen=True, slots=True, kw_only=True)
class DayVerdict:
    """What kind of day it was, and why."""

    kind: DayKind
    findings: tuple[Finding, ...]


def measure_day(
    points: Sightings,
    *,
    site: Site,
    n_possible: int | None = None,
    observed_unix_s: FloatArray | None = None,
    cadence_s: float = 30.0,
    doubtful_clock: float | None = None,
) -> DayMeasure:
    """Return what one day's sightings show; each pose epoch of the day has an arc of its own.

    Parameters
    ----------
    points : sightings of one solar day.
    site : where the camera stands.
    n_possible : how many cycles could have shown the sun; None counts one every `cadence_s` while it is up.
    observed_unix_s : (m,) times of the day's sun exposures, those without a sighting included, s since 1970-01-01 UTC;
        None where they are not known: all possible cycles count as observed.
    cadence_s : seconds between cycles.
    doubtful_clock : share of the day's sightings with a doubtful clock, where those were left out of `points`; None
        takes it from `points`.
    """
    usable = filter_sightings(points, site=site)
    possible = _possible(points, site, cadence_s) if n_possible is None else n_possible
    if observed_unix_s is None:
        sampling = fully_observed(possible)
    else:  # those of every sun exposure, and of every sighting
        observed = np.concatenate([observed_unix_s, points.unix_s])
        sampling = sampling_of(observed, cadence_s=cadence_s, n_possible=possible)
    n, n_observed = len(usable), sampling.n_observed
    if n < 2:
        return DayMeasure(n=n, n_possible=possible, n_observed=n_observed, doubtful_clock=doubtful_clock or 0.0)
    if doubtful_clock is None:
        doubtful_clock = float(np.mean(np.abs(np.nan_to_num(points.clock_error_s)) > MAX_CLOCK_ERROR_S))
    residual, weight = _about_arcs(usable, site)
    on_arc = weight > 0.0
    rmsd, _, _, sd = measures(residual)
    times = usable.unix_s[on_arc]
    n_cycles = int(np.unique(np.floor(times / cadence_s)).size)
    return DayMeasure(
        date=date_of_day(int(usable.day[0])).isoformat(),
        n=n,
        n_on_arc=int(on_arc.sum()),
        n_cycles=n_cycles,
        n_possible=possible,
        n_observed=n_observed,
        lowest_share=sampling.lowest_share(n_cycles),
        sd_px=sd,
        rmsd_px=rmsd,
        arc_deg=arc_length_deg(usable.directions[on_arc]),
        solid_angle_sr=solid_angle_sr(usable.directions[on_arc]),
        doubtful_clock=doubtful_clock,
    )


def _about_arcs(usable: Sightings, site: Site) -> tuple[FloatArray, FloatArray]:
    """Return residuals (n, 2) and weights (n,) about the smooth arc of each pose epoch."""
    angle = hour_angle(usable.unix_s, site)
    residual, weight = np.zeros(usable.pixels.shape), np.zeros(len(usable))
    for epoch in np.unique(usable.epoch):
        in_epoch = usable.epoch == epoch
        if np.sum(in_epoch) > 1:
            _, residual[in_epoch], weight[in_epoch] = smooth_arc(usable.pixels[in_epoch], angle[in_epoch])
    return residual, weight


def smooth_arc(pixels: FloatArray, angle: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fit Eq. 20 robustly: polynomials of 9th order in the hour angle.

    Parameters
    ----------
    pixels : (n, 2) px.
    angle : (n,) hour angles, radians; a day across the date line of the hour angle is unwrapped.

    Returns
    -------
    arc : (n, 2) px; residual: (n, 2) observed minus arc; weight: (n,) 0 for sightings off the arc.
    """
    order = min(_ORDER, max(1, pixels.shape[0] // 3))
    # in polar summer the hour angle passes 180 degrees while the sun is up
    unwrapped = np.unwrap(angle)
    middle, half = 0.5 * (unwrapped.max() + unwrapped.min()), 0.5 * np.ptp(unwrapped)
    chebyshev = np.polynomial.chebyshev.chebvander((unwrapped - middle) / max(half, 1e-9), order)
    weight = np.ones(pixels.shape[0])
    for number in range(_ROUNDS):
        root = np.sqrt(weight)[:, None]
        arc = chebyshev @ np.linalg.lstsq(chebyshev * root, pixels * root)[0]
        distance = np.linalg.norm(pixels - arc, axis=-1)
        sigma = robust_sigma(distance, share=0.5 if number < 4 else 0.3, floor=_POLYNOMIAL_PX)
        weight = cauchy_weights(distance, scale=sigma) if number < 6 else tukey_weights(distance, sigma=sigma)
    return arc, pixels - arc, weight


def decide_day(measure: DayMeasure) -> DayVerdict:
    """Return what kind of day it was, with its findings."""
    unusable = _unusable(measure)
    if unusable is not None:
        return DayVerdict(kind="unusable", findings=(unusable,))
    share = measure.n_cycles / max(measure.n_observed, measure.n_cycles, 1)
    found = [Finding("day_share_on_arc", {"share": share, "n_observed": measure.n_observed})]
    missed = measure.n_possible - measure.n_observed
    if missed > 0:
        found.append(Finding("day_slots_missed", {"n_missed": missed, "n_possible": measure.n_possible}))
    if share < _PARTLY_SHARE:
        return DayVerdict(kind="cloudy", findings=tuple(found))
    found.append(Finding("day_scatter", {"sd_px": measure.sd_px, "limit_px": _CLEAR_SD_PX}))
    uncertain = measure.lowest_share < _CLEAR_SHARE <= share
    if uncertain:
        data = {"n_observed": measure.n_observed, "share": measure.lowest_share, "limit": _CLEAR_SHARE}
        found.append(Finding("day_share_uncertain", data))
    partly = uncertain or share < _CLEAR_SHARE or measure.sd_px > _CLEAR_SD_PX
    return DayVerdict(kind="partly" if partly else "clear", findings=tuple(found))


def _unusable(measure: DayMeasure) -> Finding | None:
    if measure.n_on_arc < _MIN_COUNT:
        return Finding("day_too_few_sightings", {"n": measure.n_on_arc, "least": _MIN_COUNT})
    if measure.arc_deg < _MIN_ARC_DEG:
        return Finding("day_arc_too_short", {"arc_deg": measure.arc_deg, "least_deg": _MIN_ARC_DEG})
    if measure.doubtful_clock > DOUBTFUL_CLOCK_SHARE:
        return Finding("day_clock_uncertain", {"share": measure.doubtful_clock, "limit": DOUBTFUL_CLOCK_SHARE})
    return None


def days_left_out(verdicts: Mapping[date, DayKind]) -> tuple[int, ...]:
    """Return the days, counted from 1970, that a fit does not use: where some show the sun, only those that do.

    Days without a verdict (today's) are used.
    """
    shown = any(kind in _SHOW_THE_SUN for kind in verdicts.values())
    kinds = _SHOW_THE_SUN if shown else _SHOW_THE_SUN | {"cloudy"}
    return tuple(sorted(day_of_date(day) for day, kind in verdicts.items() if kind not in kinds))


def _possible(points: Sightings, site: Site, cadence_s: float) -> int:
    finite = points.unix_s[np.isfinite(points.unix_s)]
    if finite.size == 0:
        return 0
    day = solar_date(float(np.median(finite)), longitude=site.longitude)
    begin, end = day_bounds_unix_s(day, longitude=site.longitude)
    frames = np.arange(begin, end, cadence_s)
    return int(np.sum(sun_angles(frames, site).apparent_zenith < _HORIZON_DEG))


def arc_length_deg(directions: FloatArray) -> float:
    """Return the length of the way through directions (n, 3) in degrees; a longer gap counts as 5 degrees.

    So few sightings far apart (a host that missed most slots) have the arc of their surroundings, and not none.
    """
    step = angular_distance(directions[1:], directions[:-1])
    return math.degrees(float(np.sum(np.minimum(step, _LARGEST_GAP))))


# Whether a fit explains the days of its sightings: one of two lenses meets half of them, and states a small error.

_FEWEST_TO_JUDGE = 20
"""Sightings of a day that show whether it was clear (see `day_quality`); fewer are taken to be of a clear one."""
_FEWEST_OF_HALF = 6
_SHORTEST_HALF_S = 9000.0
"""From the first to the last sighting of a half-day that is judged: twice as long as cloud draws them aside."""
_FEWEST_FOR_SHARE = 12
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
_FEW_HALF_DAYS = 0.05
"""Share of the half-days of a long record that may be so far off: smoke, a ladder on the mast. Of ten days none may."""
_LARGEST_CORRELATION = 0.995
_MEDIAN = 1.2533
"""1-sigma of a median over that of a mean: the root of π / 2."""


class _HalfDay(NamedTuple):
    """How far off a half-day lies, px, in how many of its sigmas, and the day, counted from 1970."""

    off_px: float
    sigmas: float
    day: int


def unexplained_days(calibration: Calibration, usable: Sightings, limit: float) -> Finding | None:
    """Return by how much a fit fails to explain the days of its sightings; None where it explains them.

    Of the sun's track alone. A day is clear where its sightings run smoothly about the fit, however far off they lie:
    false sightings scatter, and those of another lens do not.

    Parameters
    ----------
    calibration : the fit, with the sightings that it used.
    usable : the sightings that it was given.
    limit : largest share of the sightings of clear days that may be left out, of all and of the last epoch.
    """
    if calibration.left_out is None:
        return None
    track = (usable.kind == Kind.SUN) & ~usable.alone
    # as far as the lens is defined
    camera = replace(calibration.camera, max_angle=np.pi)
    residual = np.nan_to_num(residuals_by_pose(camera, calibration.poses, usable))
    used = ~np.isin(usable.index, calibration.left_out)
    clear, halves = track.copy(), list[_HalfDay]()
    for rows in _days(usable, track):
        if rows.size < _FEWEST_OF_HALF:
            continue
        _, rough, weight = smooth_arc(residual[rows], hour_angle(usable.unix_s[rows], calibration.site))
        largest = max(_CLEAR_SIGMA_PX, _CLEAR_SIGMAS * calibration.evidence.sigma_px)
        smooth = float(np.mean(weight > 0.0)) >= _SMOOTH_SHARE
        few = rows.size < _FEWEST_TO_JUDGE
        clear[rows] = few or (smooth and robust_sigma(np.linalg.norm(rough, axis=-1), floor=_FLOOR_PX) <= largest)
        if clear[rows[0]]:
            halves += _half_days(calibration, usable, rows, residual[rows], rough)
    share, n = max(_left_out(clear, used), _left_out(clear & (usable.epoch == usable.epoch.max(initial=0)), used))
    far = [one for one in halves if one.sigmas > _FAR]
    if share <= limit and len(far) <= _FEW_HALF_DAYS * len(halves):
        return None
    worst = max(halves, key=lambda one: one.sigmas, default=_HalfDay(0.0, 0.0, int(usable.day[0])))
    return Finding(
        "epoch_does_not_explain_its_days",
        {
            "share": share,
            "n": n,
            "limit": limit,
            "n_far": len(far),
            "n_half_days": len(halves),
            "far": _FAR,
            "off_px": worst.off_px,
            "sigmas": worst.sigmas,
            "day": date_of_day(worst.day).isoformat(),
        },
    )


def _days(usable: Sightings, track: BoolArray) -> Iterator[IntArray]:
    """Yield the rows of each day of each epoch, in the order of time."""
    for epoch in np.unique(usable.epoch[track]).tolist():
        for day in np.unique(usable.day[track & (usable.epoch == epoch)]).tolist():
            yield np.flatnonzero(track & (usable.epoch == epoch) & (usable.day == day))


def _left_out(counted: BoolArray, used: BoolArray) -> tuple[float, int]:
    """Return the share of some sightings that was left out, and how many they are; 0 of too few."""
    n = int(counted.sum())
    return (float(np.mean(~used[counted])), n) if n >= _FEWEST_FOR_SHARE else (0.0, n)


def _half_days(
    calibration: Calibration, usable: Sightings, rows: IntArray, residual: FloatArray, rough: FloatArray
) -> Iterator[_HalfDay]:
    """Yield the halves of a day, `rough` being the residuals (n, 2) about their own smooth groups."""
    afternoon = np.sin(hour_angle(usable.unix_s[rows], calibration.site)) > 0.0
    for half in (~afternoon, afternoon):
        n = int(half.sum())
        seen = rows[half]
        if n < _FEWEST_OF_HALF or np.ptp(usable.unix_s[seen]) < _SHORTEST_HALF_S:
            continue
        noise = robust_sigma(np.linalg.norm(rough[half], axis=-1), share=0.5, floor=_FLOOR_PX)
        alike = _inflation(rough[half])
        off = np.median(residual[half], axis=0)
        _, stated = project_with_covariance(calibration, usable.directions[seen])
        variance = np.nan_to_num(np.mean(stated, axis=0)) + np.eye(2) * (
            _MEDIAN**2 * noise**2 * alike / n + max(_MISFIT_PX, calibration.evidence.sigma_px) ** 2
        )
        yield _HalfDay(
            float(np.linalg.norm(off)), float(np.sqrt(off @ np.linalg.solve(variance, off))), int(usable.day[seen[0]])
        )


def _inflation(rough: FloatArray) -> float:
    """Return by how much the variance of a mean of residuals (n, 2) grows because neighbours err alike."""
    power = float(np.sum(rough**2))
    correlation = float(np.sum(rough[1:] * rough[:-1])) / power if power > 0.0 else 0.0
    correlation = min(max(correlation, 0.0), _LARGEST_CORRELATION)
    return (1.0 + correlation) / (1.0 - correlation)
