"""The moon's disc as a site sees it: which way its lit limb points, how far it is lit, how the air flattens it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.sky.directions import angles_from_direction, direction_from_angles
from sunarc.sky.night import true_place
from sunarc.sky.refraction import apparent_elevation
from sunarc.sky.site import Site

MOON_RADIUS_KM = 1737.4
"""Mean radius; IAU Working Group on Cartographic Coordinates and Rotational Elements (2015)."""
_AU_KM = 149_597_870.7


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MoonDisc:
    """The moon at one moment.

    Attributes
    ----------
    direction : (3,) apparent unit vector, east-north-up, of the disc's centre.
    edges : (3, 2) from there to the middle of the lit limb, and to the limb a quarter of the circle onwards, radians;
        the refraction of the horizon flattens them.
    cos_phase : cosine of the phase angle (sun, moon, site): 1 is full, 0 half, -1 new.
    magnitude : V, outside the atmosphere.
    """

    direction: FloatArray
    edges: FloatArray
    cos_phase: float
    magnitude: float

    @property
    def lit(self) -> float:
        """Share of the disc that is lit, 0 to 1."""
        return 0.5 * (1.0 + self.cos_phase)


def moon_disc(unix_s: float, site: Site) -> MoonDisc:
    """Return the moon's disc at one moment, seen from the site.

    Raises
    ------
    InputError : ephem is not installed (extra `night`).
    """
    moon, sun = true_place("moon", unix_s, site), true_place("sun", unix_s, site)
    distance_km = MOON_RADIUS_KM / np.sin(moon.radius)
    to_sun = sun.direction * sun.distance_au * _AU_KM - moon.direction * distance_km
    to_sun /= np.linalg.norm(to_sun)
    along = to_sun - (to_sun @ moon.direction) * moon.direction
    along /= max(float(np.linalg.norm(along)), 1e-12)
    tangents = np.stack([along, np.cross(moon.direction, along)])
    limbs = [_apparent(moon.direction + side * moon.radius * tangents, site) for side in (1.0, -1.0)]
    return MoonDisc(
        direction=_apparent(moon.direction[None], site)[0],
        edges=np.asarray(0.5 * (limbs[0] - limbs[1]).T),
        cos_phase=float(np.clip(-to_sun @ moon.direction, -1.0, 1.0)),
        magnitude=moon.magnitude,
    )


def _apparent(directions: FloatArray, site: Site) -> FloatArray:
    """Return the apparent directions (n, 3) of true ones."""
    zenith, azimuth = angles_from_direction(directions / np.linalg.norm(directions, axis=-1, keepdims=True))
    return direction_from_angles(zenith_deg=90.0 - apparent_elevation(90.0 - zenith, site), azimuth_deg=azimuth)
