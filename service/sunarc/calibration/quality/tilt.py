"""Tilt of a camera that may be a wrong place or clock.

A wrong zone or longitude turns the sky about its pole, a wrong latitude turns it about the east, and the fit turns the
camera with it. Every tilted camera is level at one other place: where its optical axis is the zenith. No residual but
refraction's tells the two apart; how cameras are mounted and how often such mistakes are made does.
`fit_checks` refuses the tilt that nobody stated.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from sunarc.common.array_types import FloatArray
from sunarc.common.errors import InputError
from sunarc.common.findings import Finding
from sunarc.optics.camera import Camera
from sunarc.optics.pose import rotation_matrix, rotation_vector
from sunarc.sky.directions import angles_from_direction, wrapped_deg
from sunarc.sky.site import Site, pole_enu

LEVEL_DEG = 5.0
"""degrees; a camera tilted by more is asked about. A mount that was levelled by hand and eye is level to 2."""
_DEG_PER_H, _MIN_PER_DEG = 15.0, 4.0
"""Degrees of longitude by which the sun goes in an hour, and minutes that it takes for a degree."""
_LEVELLED_DEG = 2.0
"""1-sigma of a mount levelled by hand and eye about each axis, degrees. Chosen, not measured."""
_TILTED_ON_PURPOSE = 0.05
"""Share of mounts that were not levelled, with any tilt up to the steepest. Chosen, not measured."""
_STEEPEST_DEG = 75.0
"""degrees; a camera tilted by more sees the ground. Chosen, not measured."""
_OVER_STEEPEST = 0.01
"""Density of tilts beyond the steepest as a share of that below: rare, not excluded. Chosen, not measured."""
_LARGEST_ZONE_H = 14
"""hours; the zone farthest from UTC, of Kiribati (tz database)."""
_EXCHANGED, _WRONG_SIGN, _WRONG_ZONE, _WRONG_CLOCK, _WRONG_COORDINATE = 0.005, 0.005, 0.02, 0.02, 0.001
"""Shares of sites whose coordinates are exchanged, or one of whose coordinates has the wrong sign; whose times are of
another zone (whole hours, the rarer the more), by a clock that is off, or one of whose coordinates is wrong by any
amount. Chosen, not measured."""
_CLOCK_DEG = 7.5
"""Mean turn of the sky by a clock that is off: half an hour."""
_NO_MISTAKE = 1.0 - _EXCHANGED - 3.0 * _WRONG_SIGN - _WRONG_ZONE - _WRONG_CLOCK - 3.0 * _WRONG_COORDINATE
_LEAST_TURN_DEG = 0.1
"""degrees; smaller turns than two fits of a camera distinguish are alike."""
_LEAST_COSINE = 0.02
"""Of a latitude: 89 degrees."""
_STEP_DEG = 5.0
"""The limit that is proposed is rounded up to a whole number of these."""


class Place(NamedTuple):
    """A place on the ground: latitude and longitude, degrees."""

    latitude: float
    longitude: float


class _Explanation(NamedTuple):
    """Mistake that makes the camera level: its code, its probability per steradian, and the place that is then true."""

    code: str
    density: float
    place: Place


def level_place(camera: Camera, site: Site) -> Place:
    """Return the place at which a camera that was fitted at a site is level: its optical axis is the zenith there."""
    east, north, up = rotation_matrix(camera.rotation_cam_enu)[2].tolist()
    latitude = math.radians(site.latitude)
    meridian = math.cos(latitude) * up - math.sin(latitude) * north
    declination = math.atan2(math.sin(latitude) * up + math.cos(latitude) * north, math.hypot(meridian, east))
    longitude = site.longitude + math.degrees(math.atan2(east, meridian))
    return Place(math.degrees(declination), float(wrapped_deg(longitude)))


def distance_deg(one: Place, other: Place) -> float:
    """Return the angle between two places at the centre of the earth: the tilt that taking one for the other makes."""
    a, b = math.radians(one.latitude), math.radians(other.latitude)
    turn = math.radians(other.longitude - one.longitude)
    x = math.cos(a) * math.sin(b) - math.sin(a) * math.cos(b) * math.cos(turn)
    y = math.cos(b) * math.sin(turn)
    return math.degrees(
        math.atan2(math.hypot(x, y), math.sin(a) * math.sin(b) + math.cos(a) * math.cos(b) * math.cos(turn))
    )


def tilt_deg(camera: Camera) -> float:
    """Return the angle between the optical axis and the zenith, degrees."""
    return float(angles_from_direction(rotation_matrix(camera.rotation_cam_enu)[2])[0])


def proposed_limit_deg(tilt: float) -> float:
    """Return the limit that allows a tilt, degrees: the next multiple of 5."""
    return _STEP_DEG * math.ceil(tilt / _STEP_DEG)


def tilt_question(camera: Camera, site: Site) -> Finding | None:
    """Return the mistake that may be behind a tilted camera, with its odds; None where it is level to 5 degrees.

    The data are `tilt_deg`; the `latitude` and `longitude` at which the camera is level by this mistake, to
    `level_deg`; where a turn about the pole makes it level, the `hours` and `minutes` that the clocks are ahead, and
    `longitude_off_deg`, and for a latitude `latitude_sigma_deg` (0 of a wrong sign), with the sigmas that the mount
    leaves open; `odds`, how much more probable the mistake is than a real tilt; and `level_within_deg`, the limit that
    allows the tilt.
    """
    tilt = tilt_deg(camera)
    if tilt <= LEVEL_DEG:
        return None
    level = level_place(camera, site)
    best = max(_list_explanations(level, Place(site.latitude, site.longitude)), key=lambda one: one.density)
    axis = rotation_matrix(camera.rotation_cam_enu)[2]
    data = {
        "tilt_deg": tilt,
        "latitude": best.place.latitude,
        "longitude": best.place.longitude,
        "level_deg": distance_deg(best.place, level),
        "odds": best.density / (_NO_MISTAKE * float(mount_density(axis))),
        "level_within_deg": proposed_limit_deg(tilt),
    }
    ahead_deg = float(wrapped_deg(site.longitude - best.place.longitude))
    if best.code in ("camera_tilted_by_clock", "camera_tilted_by_longitude"):
        sigma_deg = _LEVELLED_DEG / max(math.cos(math.radians(site.latitude)), _LEAST_COSINE)
        data |= {
            "hours": ahead_deg / _DEG_PER_H,
            "minutes": _MIN_PER_DEG * ahead_deg,
            "minutes_sigma": _MIN_PER_DEG * sigma_deg,
            "longitude_off_deg": ahead_deg,
            "longitude_sigma_deg": sigma_deg,
        }
    if best.code == "camera_tilted_by_latitude":
        data["latitude_sigma_deg"] = 0.0 if best.place.latitude == -site.latitude else _LEVELLED_DEG
    return Finding(best.code, data)


def _list_explanations(level: Place, stated: Place) -> Iterator[_Explanation]:
    """Yield the mistakes by which a place may have been stated in place of the one where the camera is level.

    One that leaves the camera tilted by more than a levelled one is explains nothing.
    """
    latitude, longitude = stated
    if abs(longitude) <= 90.0:
        yield _explain_by_place("camera_tilted_by_exchange", _EXCHANGED, Place(longitude, latitude), level)
    yield _explain_by_place("camera_tilted_by_latitude", _WRONG_SIGN, Place(-latitude, longitude), level)
    yield _explain_by_place("camera_tilted_by_longitude", _WRONG_SIGN, Place(latitude, -longitude), level)
    yield _explain_by_place("camera_tilted", _WRONG_SIGN, Place(-latitude, -longitude), level)
    for hours, share in _zone_shares().items():
        place = Place(latitude, float(wrapped_deg(longitude - _DEG_PER_H * hours)))
        yield _explain_by_place("camera_tilted_by_clock", _WRONG_ZONE * share, place, level)
    turn = abs(float(wrapped_deg(level.longitude - longitude)))
    by_clock = _WRONG_CLOCK * math.exp(-turn / _CLOCK_DEG) / (2.0 * _CLOCK_DEG)
    yield _explain_along_line("camera_tilted_by_clock", by_clock, Place(latitude, level.longitude), level)
    yield _explain_along_line(
        "camera_tilted_by_longitude", _WRONG_COORDINATE / 360.0, Place(latitude, level.longitude), level
    )
    yield _explain_along_line(
        "camera_tilted_by_latitude", _WRONG_COORDINATE / 180.0, Place(level.latitude, longitude), level
    )
    yield _Explanation("camera_tilted", _WRONG_COORDINATE / (4.0 * math.pi), level)


def _explain_by_place(code: str, share: float, place: Place, level: Place) -> _Explanation:
    """Return a mistake of which one place is true."""
    off, sigma = distance_deg(place, level), math.radians(_LEVELLED_DEG)
    density = share * math.exp(-0.5 * (off / _LEVELLED_DEG) ** 2) / (2.0 * math.pi * sigma**2)
    return _Explanation(code, density if off <= LEVEL_DEG else 0.0, place)


def _explain_along_line(code: str, per_deg: float, place: Place, level: Place) -> _Explanation:
    """Return a mistake of any size, whose share per degree is stated, with the place nearest to the level one."""
    off, sigma = distance_deg(place, level), math.radians(_LEVELLED_DEG)
    density = math.degrees(per_deg) * math.exp(-0.5 * (off / _LEVELLED_DEG) ** 2) / (math.sqrt(2.0 * math.pi) * sigma)
    return _Explanation(code, density if off <= LEVEL_DEG else 0.0, place)


class ClockBehindTurn(NamedTuple):
    """Whole hours by which a clock went ahead where a camera seems turned, and their odds against a real turn."""

    hours: int
    odds: float


def clock_behind_turn(before: Camera, after: Camera, site: Site) -> ClockBehindTurn:
    """Return the change of the clock by whole hours that may be behind the turn of a camera between two fits.

    The camera of a clock that is ahead by an hour seems turned by 15 degrees about the celestial pole. Real turns have
    any axis, and as many are of each order of size: their density falls with the cube of the angle.

    Parameters
    ----------
    before, after : cameras that were fitted to sightings by one clock.
    site : where they stand.
    """
    turned = rotation_matrix(before.rotation_cam_enu).T @ rotation_matrix(after.rotation_cam_enu)
    seen_deg = _turn_deg(turned)
    shares = _zone_shares()
    left_deg = {
        hours: _turn_deg(rotation_matrix(-math.radians(_DEG_PER_H * hours) * pole_enu(site)) @ turned)
        for hours in shares
    }
    odds = {hours: _WRONG_ZONE * shares[hours] * (seen_deg / left_deg[hours]) ** 3 for hours in shares}
    best = max(odds, key=lambda hours: odds[hours])
    return ClockBehindTurn(best, odds[best])


def _turn_deg(rotation: FloatArray) -> float:
    return max(math.degrees(float(np.linalg.norm(rotation_vector(rotation)))), _LEAST_TURN_DEG)


def _zone_shares() -> dict[int, float]:
    """Return the shares of wrong zones by their hours, the rarer the more."""
    shares = {hours: 1.0 / abs(hours) for hours in range(-_LARGEST_ZONE_H, _LARGEST_ZONE_H + 1) if hours}
    return {hours: share / sum(shares.values()) for hours, share in shares.items()}


def mount_density(axis: FloatArray, *, limit_deg: float | None = None) -> FloatArray:
    """Return (...): how probable it is that a mount holds the optical axis in directions (..., 3), per steradian.

    `limit_deg` is the tilt that is stated: a mount that may be tilted by more than 5 degrees was not levelled. A limit
    above the steepest tilt states nothing.
    """
    tilt, sigma = angles_from_direction(axis)[0], math.radians(_LEVELLED_DEG)
    share, steepest = _TILTED_ON_PURPOSE, _STEEPEST_DEG
    if limit_deg is not None and LEVEL_DEG < limit_deg < _STEEPEST_DEG:
        share, steepest = 1.0, limit_deg
    levelled = np.exp(-0.5 * (tilt / _LEVELLED_DEG) ** 2) / (2.0 * math.pi * sigma**2)
    cap = 2.0 * math.pi * (1.0 - math.cos(math.radians(steepest)))
    on_purpose = np.where(tilt <= steepest, 1.0, _OVER_STEEPEST) / cap
    return np.asarray((1.0 - share) * levelled + share * on_purpose)


def require_level(tilt_deg: float, limit_deg: float | None, *, field: str, name: str) -> None:
    """Raise InputError where a camera was accepted with a larger tilt than is stated now."""
    if limit_deg is not None and tilt_deg > limit_deg:
        raise InputError(
            field=field,
            problem=f"is {limit_deg:g}°, where the camera of {name} is tilted by {tilt_deg:.1f}°",
            remedy=f"give {proposed_limit_deg(tilt_deg):g} or leave it out; or leave out that calibration",
        )
