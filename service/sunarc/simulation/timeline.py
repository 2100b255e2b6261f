"""Simulated time: faster than real, with the nights left out."""

from __future__ import annotations

import numpy as np

from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles
from sunarc.utc import DAY_S

_TWILIGHT_ZENITH_DEG = 92.0
_STEP_S = 60.0
_LONGEST_NIGHT_DAYS = 200


class Timeline:
    """Simulated time as a function of elapsed real time.

    Parameters
    ----------
    site : whose nights are skipped.
    start_unix_s : simulated time at 0.
    speed : simulated seconds per real second.
    skip_nights : jump from the end of a day's twilight to the beginning of the next one's.
    """

    def __init__(self, site: Site, *, start_unix_s: float, speed: float, skip_nights: bool = True) -> None:
        self._site = site
        self._start_unix_s = start_unix_s
        self._speed = speed
        self._skip_nights = skip_nights
        self._skipped_s = 0.0
        self._since_s = 0.0

    @property
    def speed(self) -> float:
        """Simulated seconds per real second."""
        return self._speed

    def set_speed(self, speed: float, *, elapsed_s: float) -> None:
        """Go on at another speed from an elapsed real time on, without a step."""
        self._start_unix_s += (elapsed_s - self._since_s) * self._speed
        self._since_s, self._speed = elapsed_s, speed

    def at(self, elapsed_s: float) -> float:
        """Return the simulated time in seconds since 1970-01-01 UTC; must not be called for earlier times again."""
        now = self._start_unix_s + (elapsed_s - self._since_s) * self._speed + self._skipped_s
        if self._skip_nights and _is_night(now, self._site):
            dawn = next_dawn(now, self._site)
            self._skipped_s += dawn - now
            return dawn
        return now


def next_dawn(unix_s: float, site: Site) -> float:
    """Return the next minute at which the sun is at most 92° from the zenith; `unix_s` itself if there is none."""
    minutes = np.arange(0.0, DAY_S, _STEP_S)
    for day in range(_LONGEST_NIGHT_DAYS):
        times = unix_s + day * DAY_S + minutes
        light = np.flatnonzero(sun_angles(times, site).apparent_zenith <= _TWILIGHT_ZENITH_DEG)
        if light.size:
            return float(times[light[0]])
    return unix_s


def _is_night(unix_s: float, site: Site) -> bool:
    return float(sun_angles(unix_s, site).apparent_zenith) > _TWILIGHT_ZENITH_DEG
