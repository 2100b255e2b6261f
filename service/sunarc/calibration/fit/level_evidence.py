"""Evidence for a tilted camera against a level one at another place, from refraction and horizon."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sunarc.calibration.fit.marginal_likelihood import log_evidence, log_weights
from sunarc.calibration.fit.normal_equations import linear_system
from sunarc.calibration.fit.robust_fit import FitState
from sunarc.calibration.model.sightings import Kind
from sunarc.calibration.quality.tilt import Place, level_place, tilt_question
from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.optics.camera import Camera
from sunarc.optics.pose import rotation_matrix
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_directions

_RINGS_DEG, _AROUND = (2.0, 4.0), 8
"""Tilts of a levelled mount, degrees, and directions of each: the place that is true lies so near the level one."""
_LARGEST = 1e4
"""Log odds that are not exceeded, where the sun was below the horizon at every other place."""
_LOWEST_UP = -math.sin(math.radians(1.0))
_MOST_BELOW = 0.03
"""Share of sightings that may be of a sun below the horizon: false ones at dusk."""


def tilt_log_odds(fit: FitState, camera: Camera, site: Site) -> float | None:
    """Return the natural log odds of a fit's camera against the most probable one that is level at another place.

    The sightings are the same, and the sky is turned as a whole: only the refraction of the sun's light differs.
    None where the camera is level where it is said to stand, and without a sighting of the sun.

    Parameters
    ----------
    fit : by sightings of the sun, at the site that was stated.
    camera : of the latest pose.
    site : the one that was stated.
    """
    question = tilt_question(camera, site)
    if question is None or not np.any(_is_on_sun_path(fit)):
        return None
    level = level_place(camera, site)
    places = [Place(float(question.data["latitude"]), float(question.data["longitude"])), *_places_around(level)]
    here = _log_evidence(fit, fit.observed.directions)
    elsewhere = max(_log_evidence(fit, _directions_at_place(fit, site, place)) for place in places)
    return min(here - elsewhere, _LARGEST)


def _places_around(level: Place) -> list[Place]:
    """Return a place and the places around it."""
    latitude, longitude = math.radians(level.latitude), math.radians(level.longitude)
    up = np.array(
        [math.cos(latitude) * math.cos(longitude), math.cos(latitude) * math.sin(longitude), math.sin(latitude)]
    )
    east = np.array([-math.sin(longitude), math.cos(longitude), 0.0])
    north, found = np.cross(up, east), [level]
    for radius in np.radians(_RINGS_DEG).tolist():
        for turn in (2.0 * math.pi * np.arange(_AROUND) / _AROUND).tolist():
            x, y, z = math.cos(radius) * up + math.sin(radius) * (math.cos(turn) * east + math.sin(turn) * north)
            found.append(Place(math.degrees(math.asin(min(max(z, -1.0), 1.0))), math.degrees(math.atan2(y, x))))
    return found


def _directions_at_place(fit: FitState, site: Site, place: Place) -> FloatArray | None:
    """Return (n, 3): apparent directions at a place in the axes of the site; None where the sun was below the horizon.

    Sightings of other bodies keep theirs.
    """
    observed, of_sun = fit.observed, _is_on_sun_path(fit)
    there = sun_directions(
        observed.unix_s[of_sun],
        replace(site, latitude=place.latitude, longitude=place.longitude),
        temperature=observed.temperature[of_sun],
        pressure=observed.pressure[of_sun],
    )
    if np.mean(there[:, 2] < _LOWEST_UP) > _MOST_BELOW:
        return None
    directions = np.array(observed.directions)
    directions[of_sun] = there @ _local_axes(place) @ _local_axes(Place(site.latitude, site.longitude)).T
    return directions


def _is_on_sun_path(fit: FitState) -> BoolArray:
    """Return (n,): whether a sighting's direction is that of the sun's path."""
    return np.asarray((fit.observed.kind == Kind.SUN) & ~fit.observed.alone)


def _local_axes(place: Place) -> FloatArray:
    """Return (3, 3): east, north and up of a place as rows, in axes that are fixed to the earth."""
    latitude, longitude = math.radians(place.latitude), math.radians(place.longitude)
    about_pole = rotation_matrix((0.0, 0.0, -(longitude + 0.5 * math.pi)))
    return np.asarray(rotation_matrix((latitude - 0.5 * math.pi, 0.0, 0.0)) @ about_pole)


def _log_evidence(fit: FitState, directions: FloatArray | None) -> float:
    """Return the log evidence of the sightings where the sun was in some directions."""
    if directions is None:
        return -math.inf
    observed, bins = replace(fit.observed, directions=directions), fit.groups.bins
    information, basis = fit.noise.information, fit.grid.basis
    system = linear_system(fit.problem, observed, bins, fit.unknowns, information=information, basis=basis)
    return log_evidence(log_weights(system.normal(), fit.grid))
