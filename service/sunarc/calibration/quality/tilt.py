"""Whether clock and site are as stated, by a tilt that may be none.

A wrong zone or longitude turns the sky about its pole, a wrong latitude turns it about the east, and the fit turns the
camera with it. No residual tells these from a tilt; how cameras are mounted and how often such mistakes are made does.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.findings import Finding
from sunarc.optics.camera import Camera
from sunarc.optics.pose import rotation_matrix
from sunarc.sky.directions import angles_from_direction, wrapped_deg
from sunarc.sky.site import Site

_TURN_DEG_PER_H = 15.0
_LARGEST_ZONE_H = 14.0
_QUESTIONED_DEG = 5.0
"""degrees; a mount that was levelled by hand and eye is level to 2."""
_LEVELLED_DEG = 2.0
_TILTED_ON_PURPOSE = 0.05
_STEEPEST_DEG = 75.0
"""1-sigma of a levelled mount about each axis; share of mounts that were not levelled: any tilt up to the steepest."""
_WRONG_ZONE, _WRONG_SIGN, _WRONG_COORDINATE = 0.02, 0.005, 0.001
"""Shares of sites whose times are of another zone (steps of half an hour), one of whose coordinates has the wrong sign,
or is wrong by any amount. Chosen, not measured."""
_NO_MISTAKE = 1.0 - _WRONG_ZONE - 2.0 * (_WRONG_SIGN + _WRONG_COORDINATE)
_STEP_DEG = 0.5
_HALF_HOURS = 0.1
"""How much rarer zones of half an hour are than those of whole ones."""
_NOT_WORTH_ASKING = 0.01
"""Odds."""


class _Explanation(NamedTuple):
    """What makes the camera level: by how many degrees the sky is turned about an axis, and how probable that is."""

    code: str
    density: float
    turn_deg: float


def tilt_question(camera: Camera, site: Site) -> Finding | None:
    """Return what else than a tilt may be behind a tilted camera, with its odds; None where it is level to 5 degrees.

    The data are `tilt_deg`; the `hours` that the clocks are ahead and the `longitude`, either of which makes the
    camera level, or the `latitude` that does; and `odds`, how much more probable that is than a real tilt: 0 where
    nothing simple makes it level.
    """
    axis = rotation_matrix(camera.rotation_cam_enu)[2]
    tilt_deg = float(angles_from_direction(axis)[0])
    if tilt_deg <= _QUESTIONED_DEG:
        return None
    best = max(_explanations(axis, site), key=lambda one: one.density)
    odds = best.density / (_NO_MISTAKE * float(mount_density(axis)))
    if odds < _NOT_WORTH_ASKING:
        return Finding("camera_tilted", {"tilt_deg": tilt_deg, "odds": 0.0})
    if best.code == "camera_tilted_by_latitude":
        level = {"latitude": site.latitude + best.turn_deg}
    else:  # a turn about the pole is one thing to a camera, whichever of the two is wrong
        hours, longitude = best.turn_deg / _TURN_DEG_PER_H, float(wrapped_deg(site.longitude - best.turn_deg))
        level = {"hours": hours, "longitude": longitude}
    return Finding(best.code, {**level, "tilt_deg": tilt_deg, "odds": odds})


def _explanations(axis: FloatArray, site: Site) -> tuple[_Explanation, ...]:
    latitude = math.radians(site.latitude)
    pole, east = np.array([0.0, math.cos(latitude), math.sin(latitude)]), np.array([1.0, 0.0, 0.0])
    hours = np.arange(-_LARGEST_ZONE_H, _LARGEST_ZONE_H + 0.25, 0.5)
    hours = hours[hours != 0.0]
    zones = np.where(np.mod(hours, 1.0) == 0.0, 1.0, _HALF_HOURS)
    around = np.arange(-180.0, 180.0, _STEP_DEG)
    to_poles = np.arange(-90.0, 90.0, _STEP_DEG) - site.latitude
    return (
        _explained("camera_tilted_by_clock", axis, pole, _TURN_DEG_PER_H * hours, _WRONG_ZONE * zones / zones.sum()),
        _explained("camera_tilted_by_longitude", axis, pole, *_any_or(around, 2.0 * site.longitude)),
        _explained("camera_tilted_by_latitude", axis, east, *_any_or(to_poles, -2.0 * site.latitude)),
    )


def _any_or(turns_deg: FloatArray, of_other_sign: float) -> tuple[FloatArray, FloatArray]:
    """Return turns with that of a wrong sign among them, and the shares of sites that have them."""
    evenly = np.full(turns_deg.size, _WRONG_COORDINATE / turns_deg.size)
    return np.append(turns_deg, of_other_sign), np.append(evenly, _WRONG_SIGN)


def _explained(
    code: str, axis: FloatArray, about: FloatArray, turns_deg: FloatArray, shares: FloatArray
) -> _Explanation:
    """Return the explanation of the optical axis by turns of the sky, with the one that counts most."""
    turned = rotation_matrix(np.radians(turns_deg)[:, None] * about) @ axis
    densities = shares * mount_density(turned)
    return _Explanation(code, float(densities.sum()), float(turns_deg[np.argmax(densities)]))


def mount_density(axis: FloatArray) -> FloatArray:
    """Return (...): how probable it is that a mount holds the optical axis in directions (..., 3), per steradian."""
    tilt_deg, sigma = angles_from_direction(axis)[0], math.radians(_LEVELLED_DEG)
    levelled = np.exp(-0.5 * (tilt_deg / _LEVELLED_DEG) ** 2) / (2.0 * math.pi * sigma**2)
    cap = 2.0 * math.pi * (1.0 - math.cos(math.radians(_STEEPEST_DEG)))
    on_purpose = np.where(tilt_deg <= _STEEPEST_DEG, 1.0, 0.01) / cap
    return np.asarray((1.0 - _TILTED_ON_PURPOSE) * levelled + _TILTED_ON_PURPOSE * on_purpose)
