"""Part of the sky in which a calibration is less certain than a limit, and when the sun passes there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import date, timedelta

import numpy as np

from sunarc.calibration.answers.covariance import seen_sky, sigma_deg
from sunarc.calibration.model.result import Calibration
from sunarc.common.array_types import BoolArray, FloatArray, IntArray
from sunarc.common.utc import DAY_S, utc_time
from sunarc.optics.mounting import COMPASS_POINTS, compass_point
from sunarc.sky.days import day_bounds_unix_s, solar_date
from sunarc.sky.directions import angles_from_direction, direction_from_angles
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles

_POINTS = len(COMPASS_POINTS)
_SHARE = 0.5
"""Of the largest share of an eighth of the horizon: one with less of the part is not named."""
_ROUND_DEG = 5.0
_EDGES_DEG = (10.0, 75.0)
"""Elevations below and above which a part is said to reach down to the horizon, and up to the zenith."""
_OUTERMOST = (0.02, 0.98)
"""Quantiles of the elevations of a part that are its bounds: a single direction has no say."""
_STEP_S = 300.0
_NEXT_DAYS = 5.0
_YEAR_DAYS = 366.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LeastCertain:
    """Part of the sky seen whose 1-sigma is above a limit."""

    directions: tuple[str, ...]
    """Points of the compass, or ranges of them clockwise, as "north-west to north-east"; empty: all round."""
    from_deg: float
    """Its lowest elevation, degrees; 0 where it reaches the horizon."""
    to_deg: float
    """Its highest elevation, degrees; 90 where it reaches the zenith."""
    sun_times: tuple[tuple[float, float], ...]
    """Intervals in which the sun is there, of those today that have not ended, else of tomorrow; unix seconds, UTC."""
    sun_is_tomorrow: bool
    """Day of these intervals: True for the next solar day, False for today."""
    sun_next: date | None
    """Solar date from which on the sun is there, to within 5 days; None where it is never there within a year."""

    @property
    def text(self) -> str:
        """Where it is, in words."""
        towards = f"towards the {' and the '.join(self.directions)}" if self.directions else "all round"
        if self.from_deg <= 0.0 and self.to_deg >= 90.0:
            return f"{towards}, at all elevations"
        if self.from_deg <= 0.0:
            return f"{towards}, below {self.to_deg:.0f}° of elevation"
        if self.to_deg >= 90.0:
            return f"{towards}, above {self.from_deg:.0f}° of elevation"
        return f"{towards}, between {self.from_deg:.0f}° and {self.to_deg:.0f}° of elevation"

    def remedy(self, *, observes_stars: bool) -> str:
        """Return which sightings make it more certain, in words."""
        if self.sun_times:
            spans = " and ".join(f"{utc_time(a):%H:%M} to {utc_time(b):%H:%M}" for a, b in self.sun_times)
            day = "tomorrow" if self.sun_is_tomorrow else "today"
            return f"it improves with sightings of the sun there, {day} from {spans} UTC"
        if self.sun_next is not None:
            return f"it improves with sightings of the sun, which is there again from about {self.sun_next:%d %b} on"
        return "the sun is never there: " + (
            "it improves with the stars of clear nights"
            if observes_stars
            else "observe the stars, `night.enabled = true`"
        )


def find_least_certain(calibration: Calibration, site: Site, *, limit_deg: float, unix_s: float) -> LeastCertain | None:
    """Return the part of the sky seen in which the 1-sigma is above a limit; None where it is nowhere.

    Parameters
    ----------
    calibration, site : of the camera.
    limit_deg : 1-sigma per axis, degrees.
    unix_s : now, seconds since 1970-01-01 UTC.
    """
    seen = seen_sky(calibration.camera)
    if not seen.size:
        return None
    beyond = ~(sigma_deg(calibration, seen) <= limit_deg)
    if not np.any(beyond):
        return None
    zenith, azimuth = angles_from_direction(seen)
    eighth = np.rint(np.asarray(azimuth) / (360.0 / _POINTS)).astype(np.int64) % _POINTS
    named = _choose_eighths(eighth, beyond)
    part = beyond & named[eighth]
    lowest, highest = np.quantile(90.0 - np.asarray(zenith)[part], _OUTERMOST)
    spans, is_tomorrow, following = _find_sun_there(seen, part, site, unix_s)
    return LeastCertain(
        directions=_name_ranges(named),
        from_deg=0.0 if lowest <= _EDGES_DEG[0] else _ROUND_DEG * math.floor(lowest / _ROUND_DEG),
        to_deg=90.0 if highest >= _EDGES_DEG[1] else _ROUND_DEG * math.ceil(highest / _ROUND_DEG),
        sun_times=spans,
        sun_is_tomorrow=is_tomorrow,
        sun_next=following,
    )


def _choose_eighths(eighth: IntArray, beyond: BoolArray) -> BoolArray:
    """Return which eighths (8,) of the horizon have much of the part, by the eighth (n,) of each direction."""
    n = np.bincount(eighth, minlength=_POINTS)
    share = np.bincount(eighth[beyond], minlength=_POINTS) / np.maximum(n, 1)
    return np.asarray(share >= _SHARE * np.max(share))


def _name_ranges(named: BoolArray) -> tuple[str, ...]:
    """Return the eighths that are named, neighbours as one range; nothing where they are all, or all but one."""
    if np.count_nonzero(named) >= _POINTS - 1:
        return ()
    starts = [k for k in range(_POINTS) if named[k] and not named[k - 1]]
    found = []
    for start in starts:
        end = start
        while named[(end + 1) % _POINTS]:
            end += 1
        first, last = (compass_point(k * 360.0 / _POINTS) for k in (start, end))
        found.append(first if start == end else f"{first} to {last}")
    return tuple(found)


def _find_sun_there(
    seen: FloatArray, part: BoolArray, site: Site, unix_s: float
) -> tuple[tuple[tuple[float, float], ...], bool, date | None]:
    """Return when the sun is in a part of the sky today or else tomorrow, whether tomorrow, and else the next date."""

    def is_there(times: FloatArray) -> BoolArray:
        angles = sun_angles(times, site)
        sun = direction_from_angles(zenith_deg=angles.apparent_zenith, azimuth_deg=angles.azimuth)
        there: BoolArray = part[np.argmax(sun @ seen.T, axis=1)] & (angles.apparent_zenith < 90.0)
        return there

    today = solar_date(unix_s, longitude=site.longitude)
    start, end = day_bounds_unix_s(today, longitude=site.longitude)
    times = np.arange(start, end, _STEP_S)
    for day in (0, 1):
        edges = np.flatnonzero(np.diff(is_there(times + day * DAY_S).astype(np.int8), prepend=0, append=0))
        ends = np.append(times, end)[edges].reshape(-1, 2) + day * DAY_S
        spans = tuple((float(first), float(last)) for first, last in ends if last > unix_s)
        if spans:
            return spans, day == 1, None
    for later in np.arange(_NEXT_DAYS, _YEAR_DAYS, _NEXT_DAYS):
        if np.any(is_there(times[::2] + later * DAY_S)):
            return (), False, today + timedelta(days=float(later))
    return (), False, None
