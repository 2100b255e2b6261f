"""Solar days: midnight to midnight of local mean solar time, cut where the sun is lowest, wherever that is."""

from __future__ import annotations

from datetime import date, timedelta

import numpy as np

from sunarc.common.array_types import FloatArray, IntArray
from sunarc.common.utc import DAY_S, EPOCH

SECONDS_PER_DEGREE = 240.0
"""A degree of longitude in mean solar time, s."""
_FIRST_DAY = EPOCH.date()


def solar_date(unix_s: float, *, longitude: float) -> date:
    """Return the local mean solar date of a moment.

    Parameters
    ----------
    unix_s : seconds since 1970-01-01 UTC.
    longitude : degrees, east positive.
    """
    # Rounded to a microsecond, as times are: the first moment of a day must not fall before midnight by rounding.
    return (EPOCH + timedelta(seconds=unix_s + longitude * SECONDS_PER_DEGREE)).date()


def solar_days(unix_s: FloatArray, *, longitude: float) -> IntArray:
    """Return the local mean solar days (n,) of times (n,), counted from 1970."""
    return np.floor((unix_s + longitude * SECONDS_PER_DEGREE) / DAY_S).astype(np.int64)


def day_to_date(day: int) -> date:
    """Return the date of a day counted from 1970."""
    return _FIRST_DAY + timedelta(days=day)


def date_to_day(day: date) -> int:
    """Return the number of a date, counted from 1970."""
    return (day - _FIRST_DAY).days


def day_bounds_unix_s(day: date, *, longitude: float) -> tuple[float, float]:
    """Return the first moment of a solar day and of the next, in seconds since 1970-01-01 UTC."""
    start = date_to_day(day) * DAY_S - longitude * SECONDS_PER_DEGREE
    return start, start + DAY_S
