"""From a camera's timestamp to UTC."""

from __future__ import annotations

from datetime import datetime, timedelta

from sunarc.cameras.options import AravisOptions
from sunarc.utc import EPOCH

TAI_MINUS_UTC_S = 37.0
"""Seconds by which TAI is ahead of UTC since 2017-01-01 (IERS Bulletin C 52). Should a leap second change it,
the comparison with the host's clock shows a difference of 1 s."""


def utc_of_timestamp(timestamp_ns: int, options: AravisOptions) -> datetime:
    """Return the UTC time of a camera's timestamp.

    Parameters
    ----------
    timestamp_ns : nanoseconds since 1970-01-01 on the camera's time scale.
    options : which scale that is, and what is to be added.
    """
    added_s = options.timestamp_offset_s - (TAI_MINUS_UTC_S if options.timestamp_scale == "tai" else 0.0)
    return EPOCH + timedelta(microseconds=timestamp_ns // 1000, seconds=added_s)
