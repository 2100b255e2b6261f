"""What sightings are of, as far as their noise and their systematic errors differ."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from sunarc.array_types import BoolArray, FloatArray, IntArray, NameArray
from sunarc.sky.night import STAR, SUN, WANDERERS
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles

MOON = "moon"
_NIGHT_ZENITH_DEG = 96.0
"""Of the sun: civil dusk, when the ground has been without the sun's heat for half an hour."""


class Kind(IntEnum):
    """The kind of a body: the sun (or a direction without a known body), a point of light, the moon."""

    SUN = 0
    STAR = 1
    MOON = 2


def kinds_of(bodies: NameArray) -> IntArray:
    """Return the kinds (n,) of bodies by their names (n,); planets are points of light as stars are."""
    kinds = np.full(bodies.shape, Kind.SUN, dtype=np.int64)
    rows = np.flatnonzero(bodies != SUN)  # few of millions
    other = bodies[rows]
    star = np.char.startswith(other, STAR) | np.isin(other, [name for name in WANDERERS if name != MOON])
    kinds[rows] = np.where(other == MOON, Kind.MOON, np.where(star, Kind.STAR, Kind.SUN))
    return kinds


def at_night(unix_s: FloatArray, kind: IntArray, site: Site) -> BoolArray:
    """Return (n,) which sightings are not of the sun, with the sun 6 degrees below the horizon or more."""
    other = kind != Kind.SUN
    night = np.zeros(kind.shape, dtype=np.bool_)
    night[other] = sun_angles(unix_s[other], site).apparent_zenith > _NIGHT_ZENITH_DEG
    return night
