"""Suns, lenses and errors that share no code with what is judged: numpy's and SOFA's formulas, written anew.

The sun is SOFA's (`erfa`: the earth's orbit, aberration, precession and nutation, sidereal time), the refraction is
Saemundsson's in the air of a standard atmosphere. Lenses are an ideal projection and a radial residual of four cosines,
decentering in Conrady's form, a level camera within some degrees.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import erfa
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Shift = Callable[[FloatArray], FloatArray]
"""Of pixels or directions (n, k): what is added to them."""

SIZE = 1748
_AU_M = 149_597_870_700.0
_LIGHT_S = 499.004784
"""That light takes for one astronomical unit, s."""
_EARTH_RATE = 7.292115e-5
_TERRESTRIAL_S = 69.0
"""Terrestrial time minus universal time, s; one second moves the sun by 0.04 arcseconds."""
_RADIUS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "equidistant": lambda angle: angle,
    "equisolid": lambda angle: 2.0 * np.sin(angle / 2.0),
    "stereographic": lambda angle: 2.0 * np.tan(angle / 2.0),
}


@dataclass(frozen=True, kw_only=True)
class Place:
    """Where a camera stands: degrees north, degrees east, metres."""

    latitude: float
    longitude: float
    altitude: float

    @property
    def density(self) -> float:
        """Return the air's density over that at 1010 hPa and 10 °C: a standard atmosphere's pressure, and 12 °C."""
        pressure_hpa = ((44_331.514 - self.altitude) / 11_880.516) ** (1.0 / 0.190_263_2)
        return float(pressure_hpa / 1010.0 * 283.0 / (273.0 + 12.0))


def sun(unix_s: FloatArray, place: Place) -> FloatArray:
    """Return apparent directions of the sun's centre, (n, 3) east-north-up."""
    day, part = np.floor(unix_s / 86_400.0) + 2_440_587.5, unix_s / 86_400.0 % 1.0
    terrestrial = part + _TERRESTRIAL_S / 86_400.0
    heliocentric, barycentric = erfa.epv00(day, terrestrial)
    back = np.linalg.norm(heliocentric["p"], axis=-1) * _LIGHT_S / 86_400.0
    then_heliocentric, then_barycentric = erfa.epv00(day, terrestrial - back)
    to_date = erfa.pnm06a(day, terrestrial)
    sidereal = erfa.gst06(day, part, day, terrestrial, to_date)
    latitude, longitude = math.radians(place.latitude), math.radians(place.longitude)
    x, _, z = erfa.gd2gc(1, 0.0, latitude, place.altitude) / _AU_M
    turned = sidereal + longitude
    stands = np.stack([x * np.cos(turned), x * np.sin(turned), np.full_like(turned, z)], axis=-1)
    rate = _EARTH_RATE * 86_400.0
    moves = np.stack([-rate * stands[:, 1], rate * stands[:, 0], np.zeros_like(turned)], axis=-1)
    at, velocity = (np.einsum("nji,nj->ni", to_date, one) for one in (stands, moves))
    ray = then_barycentric["p"] - then_heliocentric["p"] - barycentric["p"] - at
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    ray = ray + (barycentric["v"] + velocity) * _LIGHT_S / 86_400.0
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    of_date = np.einsum("nij,nj->ni", to_date, ray)
    a, b, c = of_date.T
    outwards, east = a * np.cos(turned) + b * np.sin(turned), b * np.cos(turned) - a * np.sin(turned)
    north = c * math.cos(latitude) - outwards * math.sin(latitude)
    up = c * math.sin(latitude) + outwards * math.cos(latitude)
    return lifted(np.stack([east, north, up], axis=-1), place.density)


def lifted(directions: FloatArray, density: float) -> FloatArray:
    """Return true directions (n, 3) lifted by the refraction of Saemundsson, and by none below -0.8 degrees."""
    east, north, up = directions.T
    height = np.degrees(np.arcsin(up))
    minutes = 1.02 / np.tan(np.radians(height + 10.3 / (height + 5.11)))
    raised = np.radians(height + np.where(height > -0.8, density * minutes / 60.0, 0.0))
    flat = np.cos(raised) / np.hypot(east, north)
    return np.stack([east * flat, north * flat, np.sin(raised)], axis=-1)


def turn(vector: FloatArray) -> FloatArray:
    """Return the matrix (3, 3) that turns about a vector, by its length in radians (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross)


@dataclass(frozen=True, kw_only=True, eq=False)
class Lens:
    """A camera: an ideal projection and what is beside it.

    residual_px : of angles off the axis (n,), rad. decentering : Conrady's two coefficients, in focal lengths. wide :
    width of a pixel over its height. bend : what is added to rays (n, 3) before the lens; smear : to pixels behind it.
    """

    projection: str = "equisolid"
    focal_px: float
    center_px: FloatArray
    residual_px: Callable[[FloatArray], FloatArray]
    decentering: FloatArray
    pose: FloatArray
    wide: float = 1.0
    bend: Shift | None = None
    smear: Shift | None = None

    def project(self, directions: FloatArray) -> FloatArray:
        """Return the pixels (n, 2) of directions (n, 3); NaN beyond 95 degrees off the axis."""
        ray = directions if self.bend is None else directions + self.bend(directions)
        x, y, z = self.pose @ (ray / np.linalg.norm(ray, axis=-1, keepdims=True)).T
        across = np.hypot(x, y)
        angle = np.arctan2(across, z)
        radius = _RADIUS[self.projection](angle) + self.residual_px(angle) / self.focal_px
        scale = np.where(across > 0.0, radius / np.maximum(across, 1e-300), 1.0)
        u, v = x * scale, y * scale
        square, (p, q) = u * u + v * v, self.decentering
        du, dv = p * (square + 2.0 * u * u) + 2.0 * q * u * v, q * (square + 2.0 * v * v) + 2.0 * p * u * v
        pixel = self.center_px + self.focal_px * np.stack([(u + du) / self.wide, v + dv], axis=-1)
        if self.smear is not None:
            pixel = pixel + self.smear(pixel)
        return np.where((angle < math.radians(95.0))[:, None], pixel, np.nan)

    def moved(self, rng: np.random.Generator, degrees: float) -> Lens:
        """Return the camera turned by an angle about an axis that is drawn."""
        axis = rng.normal(size=3)
        return replace(self, pose=turn(math.radians(degrees) * axis / np.linalg.norm(axis)) @ self.pose)


def drawn_lens(rng: np.random.Generator, *, decentering_px: float | None = None) -> Lens:
    """Draw a lens as the priors expect one: 1.5 px of radial residual, 0.6 px of decentering at the horizon."""
    focal = 601.0 + rng.normal(0.0, 6.0)
    # cosines of 2.2, 3.3 and 4.4 radians of the angle: smooth over about half a radian
    heights, phases = rng.normal(0.0, 1.0, 3) * np.array([1.2, 0.8, 0.4]), rng.uniform(0.0, 2.0 * math.pi, 3)
    waves = np.array([2.2, 3.3, 4.4])

    def residual(angle: FloatArray) -> FloatArray:
        start = heights @ np.cos(phases)
        slope = -heights @ (waves * np.sin(phases))
        here = np.cos(np.asarray(angle)[..., None] * waves + phases) @ heights
        # on the axis neither a step nor a scale: the focal length is the lens's
        return np.asarray(here - start - slope * np.sin(angle))

    size = rng.normal(0.0, 0.6, 2)
    if decentering_px is not None:
        size *= decentering_px / np.linalg.norm(size)
    lean = turn(np.append(rng.normal(0.0, math.radians(1.8), 2), 0.0))
    azimuth = rng.uniform(0.0, 2.0 * math.pi)
    cosine, sine = math.cos(azimuth), math.sin(azimuth)
    return Lens(
        focal_px=focal,
        center_px=(SIZE - 1) / 2.0 + rng.normal(0.0, 5.0, 2),
        residual_px=residual,
        decentering=size / (focal * 3.0 * 2.0),
        pose=lean @ np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]),
    )


def smooth_field(rng: np.random.Generator, *, size_px: float, length_px: float) -> Shift:
    """Draw a smooth displacement over the image: 60 plane waves an axis, `size_px` 1-sigma."""
    vectors, phases = rng.normal(0.0, 1.0 / length_px, (2, 60, 2)), rng.uniform(0.0, 2.0 * math.pi, (2, 60))

    def shift(pixels: FloatArray) -> FloatArray:
        parts = [np.cos(pixels @ vectors[i].T + phases[i]).sum(axis=-1) for i in (0, 1)]
        return np.asarray(size_px * math.sqrt(2.0 / 60.0) * np.stack(parts, axis=-1))

    return shift


def dome(rng: np.random.Generator, *, displaced_mm: float, radius_mm: float = 50.0, thick_mm: float = 3.0) -> Shift:
    """Return how a hemispherical dome of acrylic bends rays to a pupil beside its centre: traced, Snell at both sides.

    The pupil stands lower than the centre by a third of what it is beside it.
    """
    azimuth = rng.uniform(0.0, 2.0 * math.pi)
    pupil = displaced_mm * np.array([math.cos(azimuth), math.sin(azimuth), -1.0 / 3.0])

    def outside(inner: FloatArray) -> FloatArray:
        ray, point = inner, np.broadcast_to(pupil, inner.shape)
        for radius, ratio in ((radius_mm - thick_mm, 1.0 / 1.49), (radius_mm, 1.49)):
            along = np.sum(point * ray, axis=-1)
            far = -along + np.sqrt(along**2 - np.sum(point**2, axis=-1) + radius**2)
            point = point + far[:, None] * ray
            normal = point / radius
            cosine = np.sum(normal * ray, axis=-1)
            after = np.sqrt(1.0 - ratio**2 * (1.0 - cosine**2))
            ray = ratio * ray + (after - ratio * cosine)[:, None] * normal
        return np.asarray(ray)

    def bend(directions: FloatArray) -> FloatArray:
        inner = directions
        for _ in range(4):
            inner = inner - (outside(inner) - directions)
            inner = inner / np.linalg.norm(inner, axis=-1, keepdims=True)
        return np.asarray(inner - directions)

    return bend


@dataclass(frozen=True, kw_only=True, eq=False)
class World:
    """What is seen, and what is true: `lens` as it stands at the end; times and pixels as they are recorded."""

    place: Place
    lens: Lens
    unix_s: FloatArray
    pixels: FloatArray
    sigma_px: float
    note: dict[str, float] = field(default_factory=dict)


def drawn_place(rng: np.random.Generator) -> Place:
    """Draw a place between 28 and 52 degrees of latitude."""
    side = 1.0 if rng.random() < 0.7 else -1.0
    return Place(
        latitude=side * rng.uniform(28.0, 52.0), longitude=rng.uniform(-120.0, 120.0), altitude=rng.uniform(0.0, 900.0)
    )


def times_of(rng: np.random.Generator, place: Place, *, days: int, cadence_s: float, apart: int = 5) -> FloatArray:
    """Draw clear days from spring to autumn, `apart` days from one to the next: times with the sun above 2 degrees."""
    spring = 1_364_000_000.0 if place.latitude > 0.0 else 1_348_500_000.0
    noon = spring // 86_400.0 * 86_400.0 + 43_200.0 - 240.0 * place.longitude
    first = rng.integers(0, max(150 - apart * days, 1))
    some = noon + 86_400.0 * (first + apart * np.arange(days))
    times = (some[:, None] + np.arange(-32_400.0, 32_400.0, cadence_s)).ravel()
    return np.asarray(times[sun(times, place)[:, 2] > math.sin(math.radians(2.0))])


def hemisphere(count: int) -> FloatArray:
    """Return directions uniform over the upper hemisphere, (count, 3), by Fibonacci's lattice."""
    up = (np.arange(count) + 0.5) / count
    azimuth = 2.0 * math.pi * 0.618_033_988_75 * np.arange(count)
    flat = np.sqrt(1.0 - up**2)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), up], axis=-1)
