"""Kind of a day: how many of its slots show the sun on a smooth arc (Eq. 20), and the decision by that."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from typing import Literal

import numpy as np

from sunarc.calibration.model.result import measures
from sunarc.calibration.model.sightings import MAX_CLOCK_ERROR_S, Sightings, filter_sightings
from sunarc.calibration.quality.day_arcs import arc_length_deg, smooth_arc
from sunarc.calibration.selection import solid_angle_sr
from sunarc.common.array_types import FloatArray
from sunarc.common.findings import Finding
from sunarc.sky.days import date_to_day, day_bounds_unix_s, day_to_date, solar_date
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


def measure_sampling(observed_unix_s: FloatArray, *, cadence_s: float, n_possible: int) -> DaySampling:
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
_HORIZON_DEG = 89.6

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
    """Measures of a day's sightings.

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
    """Kind of a day, and its reasons."""

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
    """Return the measures of one day's sightings; each pose epoch of the day has an arc of its own.

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
    possible = _count_possible_slots(points, site, cadence_s) if n_possible is None else n_possible
    if observed_unix_s is None:
        sampling = fully_observed(possible)
    else:  # those of every sun exposure, and of every sighting
        observed = np.concatenate([observed_unix_s, points.unix_s])
        sampling = measure_sampling(observed, cadence_s=cadence_s, n_possible=possible)
    n, n_observed = len(usable), sampling.n_observed
    if n < 2:
        return DayMeasure(n=n, n_possible=possible, n_observed=n_observed, doubtful_clock=doubtful_clock or 0.0)
    if doubtful_clock is None:
        doubtful_clock = float(np.mean(np.abs(np.nan_to_num(points.clock_error_s)) > MAX_CLOCK_ERROR_S))
    residual, weight = _residuals_about_arcs(usable, site)
    on_arc = weight > 0.0
    rmsd, _, _, sd = measures(residual)
    times = usable.unix_s[on_arc]
    n_cycles = int(np.unique(np.floor(times / cadence_s)).size)
    return DayMeasure(
        date=day_to_date(int(usable.day[0])).isoformat(),
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


def _residuals_about_arcs(usable: Sightings, site: Site) -> tuple[FloatArray, FloatArray]:
    """Return residuals (n, 2) and weights (n,) about the smooth arc of each pose epoch."""
    angle = hour_angle(usable.unix_s, site)
    residual, weight = np.zeros(usable.pixels.shape), np.zeros(len(usable))
    for epoch in np.unique(usable.epoch):
        in_epoch = usable.epoch == epoch
        if np.sum(in_epoch) > 1:
            _, residual[in_epoch], weight[in_epoch] = smooth_arc(usable.pixels[in_epoch], angle[in_epoch])
    return residual, weight


def decide_day(measure: DayMeasure) -> DayVerdict:
    """Return the kind of a day, with its findings."""
    unusable = _find_unusable_reason(measure)
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


def _find_unusable_reason(measure: DayMeasure) -> Finding | None:
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
    return tuple(sorted(date_to_day(day) for day, kind in verdicts.items() if kind not in kinds))


def _count_possible_slots(points: Sightings, site: Site, cadence_s: float) -> int:
    finite = points.unix_s[np.isfinite(points.unix_s)]
    if finite.size == 0:
        return 0
    day = solar_date(float(np.median(finite)), longitude=site.longitude)
    begin, end = day_bounds_unix_s(day, longitude=site.longitude)
    frames = np.arange(begin, end, cadence_s)
    return int(np.sum(sun_angles(frames, site).apparent_zenith < _HORIZON_DEG))
