"""Motion of the first sightings against the sun's over the stated site, before anything else is known.

The speed on the sensor gives the scale of any lens, since the sun turns by 15 degrees of hour angle an hour wherever
the camera stands. With it the way of the sun relative to the image's centre, outwards or inwards and round it, is
that of a camera that is about level. A longitude of the wrong sign takes the evening for a morning; a latitude of the
wrong sign has the sun go round the other way.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sunarc.calibration.model.options import Mirrored
from sunarc.common.array_types import FloatArray
from sunarc.common.findings import Finding
from sunarc.common.robust_statistics import mad_sigma
from sunarc.sky.directions import wrapped_deg
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles, sun_directions

FEWEST_IN_MOTION = 4
_SHORTEST_S = 60.0
_LEAST_WAY = 8.0
"""Way of the sun on the sensor over the scatter about it, and in px at least a quarter of that."""
_BELOW_DEG = 91.0
"""Zenith angle from which on no refraction shows the sun."""
_TILT_DEG, _CENTRE_SHARE = 15.0, 0.05
"""Largest tilt of a camera, and distance of its principal point from the image's centre (of the longer side)."""
_LENS_DEG = 25.0
"""By which the direction of the motion is off at most where the camera's tilt turns the lens's effect on it."""
_NEAR_ZENITH = 0.9
"""Sine of the doubt about which way is outwards, from which on it says nothing."""
_ELEVATION_DEG = 50.0
"""Largest error of the zenith angle from the scale of the motion, for that tilt; lens: see `_ExpectedMotion`."""
_PROJECTIONS = np.linspace(0.0, 1.0, 5)
"""From orthographic, whose scale along the radius falls to none at the horizon, to stereographic, where it does not."""


def site_contradiction(
    unix_s: FloatArray, pixels: FloatArray, *, site: Site, image_size: tuple[int, int], mirrored: Mirrored
) -> Finding | None:
    """Return the contradiction of the first sightings to the stated site, clock and handedness; None without one.

    Parameters
    ----------
    unix_s, pixels : (n,) and (n, 2) px, of one pose and within two hours: the motion is taken as straight; a few may
        be false.
    site : where the camera is said to stand.
    image_size : width and height, px.
    mirrored : what is known of the handedness.
    """
    zenith = sun_angles(unix_s, site).apparent_zenith
    if unix_s.size >= FEWEST_IN_MOTION and float(np.median(zenith)) > _BELOW_DEG:
        return Finding("sun_seen_below_horizon", {"n": int(unix_s.size), "zenith_deg": float(np.median(zenith))})
    motion = _measure_motion(unix_s, pixels)
    if motion is None:
        return None
    due = _compute_expected_motion(motion.unix_s, site)
    outwards = motion.middle - (np.array(image_size) - 1.0) / 2.0
    radius = float(np.linalg.norm(outwards))
    px_per_rad = float(np.linalg.norm(motion.velocity)) / due.rad_per_s
    doubt = (math.sin(math.radians(_TILT_DEG)) * px_per_rad + _CENTRE_SHARE * max(image_size)) / max(radius, 1e-9)
    if doubt >= _NEAR_ZENITH:
        return None
    seen = _list_seen_angles(outwards / radius, motion.velocity, mirrored)
    off = min(float(np.min(np.abs(wrapped_deg(one - due.ways_deg)))) for one in seen)
    allowed = math.degrees(math.asin(doubt)) + _LENS_DEG
    seen_zenith = math.degrees(radius / px_per_rad)
    lowest, highest = due.zenith_deg - _ELEVATION_DEG, max(due.zenith_deg + _ELEVATION_DEG, due.farthest_deg)
    if off <= allowed and lowest <= seen_zenith <= highest:
        return None
    data: dict[str, float | str] = {
        "off_deg": off,
        "limit_deg": allowed,
        "seen_zenith_deg": seen_zenith,
        "zenith_deg": due.zenith_deg,
        "seen": _name_vertical_motion(seen[0]),
        "expected": _name_vertical_motion(float(due.ways_deg[-1])),
    }
    return Finding("sun_contradicts_site", data)


class _Motion(NamedTuple):
    """Time, place (px) and velocity (px/s) in the middle of sightings."""

    unix_s: float
    middle: FloatArray
    velocity: FloatArray


class _ExpectedMotion(NamedTuple):
    """Motion of the sun over the stated site: zenith angle, direction in the projection, and speed.

    The direction is from outwards (away from the zenith) towards a growing azimuth; the last one is that in the sky. A
    lens that compresses the rim makes the sun slow there, and so its zenith angle large: `farthest_deg` at most.
    """

    zenith_deg: float
    ways_deg: FloatArray
    rad_per_s: float
    farthest_deg: float


def _measure_motion(unix_s: FloatArray, pixels: FloatArray) -> _Motion | None:
    """Return the motion by medians over pairs; None where too little moved."""
    if unix_s.size < FEWEST_IN_MOTION or np.ptp(unix_s) < _SHORTEST_S:
        return None
    first, second = np.triu_indices(unix_s.size, k=1)
    apart_s = unix_s[second] - unix_s[first]
    far = np.abs(apart_s) > 0.2 * np.ptp(unix_s)
    velocity = np.median((pixels[second] - pixels[first])[far] / apart_s[far, None], axis=0)
    at_s = float(np.median(unix_s))
    at_middle = pixels - (unix_s - at_s)[:, None] * velocity
    middle = np.median(at_middle, axis=0)
    scatter = mad_sigma(np.linalg.norm(at_middle - middle, axis=-1))
    way = float(np.linalg.norm(velocity)) * float(np.ptp(unix_s))
    return _Motion(at_s, middle, velocity) if way > _LEAST_WAY * max(scatter, 0.25) else None


def _compute_expected_motion(unix_s: float, site: Site) -> _ExpectedMotion:
    times = np.array([unix_s - 30.0, unix_s + 30.0])
    angles, (before, after) = sun_angles(times, site), sun_directions(times, site)
    first, last = np.radians(angles.apparent_zenith).tolist()
    turned = math.radians(float(wrapped_deg(angles.azimuth[1] - angles.azimuth[0])))
    zenith = 0.5 * (first + last)
    least = max(math.cos(zenith), 0.0)
    along = least + (1.0 - least) * _PROJECTIONS
    ways = np.degrees(np.arctan2(math.sin(zenith) * turned, along * (last - first)))
    apart = 2.0 * math.asin(0.5 * float(np.linalg.norm(after - before)))
    lowest = zenith + math.radians(_TILT_DEG)
    farthest = math.degrees(math.tan(lowest)) if lowest < 0.5 * math.pi else math.inf
    return _ExpectedMotion(math.degrees(zenith), ways, apart / 60.0, farthest)


def _name_vertical_motion(way_deg: float) -> str:
    return "sets" if math.cos(math.radians(way_deg)) > 0.0 else "rises"


def _list_seen_angles(outwards: FloatArray, velocity: FloatArray, mirrored: Mirrored) -> list[float]:
    """Return the motion's angle from outwards to counter-clockwise (that of a growing azimuth), for each handedness."""
    along = float(velocity @ outwards)
    across = float(velocity @ np.array([outwards[1], -outwards[0]]))
    signs = {"no": (1.0,), "yes": (-1.0,), "auto": (1.0, -1.0)}[mirrored]
    return [math.degrees(math.atan2(sign * across, along)) for sign in signs]
