"""A night sky, a lens and what a detector gives of it, drawn with formulas of their own.

Of the project only the table of bright stars is read, as data: precession, sidereal time, refraction, lens, clouds,
glare and photometry are written here a second time, so that an error of the project is none of the judge's.
"""

from __future__ import annotations

import gzip
import math
from dataclasses import dataclass, field
from pathlib import Path

import ephem  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import NDArray

import sunarc

FloatArray = NDArray[np.float64]
TABLE = Path(sunarc.__file__).parent / "sky" / "stars.csv.gz"
J2000_S = 946_728_000.0
PLANETS = ("Venus", "Mars", "Jupiter", "Saturn", "Mercury")


def catalogue() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return right ascension and declination (rad, J2000 axes, epoch 2024) and V of the stars of the table."""
    lines = gzip.decompress(TABLE.read_bytes()).decode().splitlines()
    rows = np.array([[float(cell) for cell in line.split(",")] for line in lines if line[0].isdigit()])
    return np.radians(rows[:, 1]), np.radians(rows[:, 2]), rows[:, 5]


RIGHT_ASCENSION, DECLINATION, MAGNITUDE = catalogue()


def turn(axis: int, angle: float) -> FloatArray:
    """Return the matrix that turns the frame about one of its axes."""
    c, s = math.cos(angle), math.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[i, i], matrix[i, j], matrix[j, i], matrix[j, j] = c, s, -s, c
    return matrix


def equatorial(unix_s: float) -> tuple[FloatArray, FloatArray]:
    """Return unit vectors (n, 3) of stars and planets in the equator of date, and V."""
    c = np.cos(DECLINATION)
    stars = np.stack([c * np.cos(RIGHT_ASCENSION), c * np.sin(RIGHT_ASCENSION), np.sin(DECLINATION)], axis=-1)
    t = (unix_s - J2000_S) / 86_400.0 / 36_525.0
    arcsec = math.radians(1.0 / 3600.0)
    zeta = (2306.2181 * t + 0.30188 * t * t) * arcsec
    z = (2306.2181 * t + 1.09468 * t * t) * arcsec
    theta = (2004.3109 * t - 0.42665 * t * t) * arcsec
    stars = stars @ (turn(2, -z) @ turn(1, theta) @ turn(2, -zeta)).T
    date = ephem.Date(unix_s / 86_400.0 + 25_567.5)
    others, light = [], []
    for name in PLANETS:
        body = getattr(ephem, name)(date, epoch=date)
        ra, dec = float(body.g_ra), float(body.g_dec)
        others.append([math.cos(dec) * math.cos(ra), math.cos(dec) * math.sin(ra), math.sin(dec)])
        light.append(float(body.mag))
    return np.concatenate([stars, np.array(others)]), np.r_[MAGNITUDE, light]


def horizontal(directions: FloatArray, unix_s: float, latitude: float, longitude: float) -> FloatArray:
    """Return east, north, up (n, 3), raised by refraction, of directions in the equator of date; degrees."""
    days = (unix_s - J2000_S) / 86_400.0
    sidereal = math.radians((280.46061837 + 360.98564736629 * days + longitude) % 360.0)
    hour = directions @ turn(2, sidereal).T  # x to the meridian, y to the east
    lat = math.radians(latitude)
    up = math.cos(lat) * hour[:, 0] + math.sin(lat) * hour[:, 2]
    north = math.cos(lat) * hour[:, 2] - math.sin(lat) * hour[:, 0]
    height = np.degrees(np.arcsin(np.clip(up, -1.0, 1.0)))
    low = np.maximum(height, -1.0)
    raised = height + 1.02 / 60.0 / np.tan(np.radians(low + 10.3 / (low + 5.11)))
    level = np.maximum(np.hypot(hour[:, 1], north), 1e-12)
    flat, high = np.cos(np.radians(raised)) / level, np.sin(np.radians(raised))
    return np.stack([hour[:, 1] * flat, north * flat, high], axis=-1)


@dataclass(frozen=True, kw_only=True)
class Lens:
    """A camera that looks up: radius(angle) = focal * shape(angle) * (1 + a (angle²) + b (angle⁴)); `pose` from ENU."""

    size: tuple[int, int]
    focal: float
    kind: str
    bend: tuple[float, float]
    centre: FloatArray
    pose: FloatArray
    mirrored: bool
    widest: float
    wave: FloatArray

    def pixels(self, directions: FloatArray) -> FloatArray:
        """Return (n, 2) px, NaN beyond the lens's field."""
        x, y, z = (directions @ self.pose.T).T
        angle = np.arctan2(np.hypot(x, y), z)
        ideal = {
            "linear": angle,
            "equal area": 2.0 * np.sin(0.5 * angle),
            "conformal": 2.0 * np.tan(0.5 * np.minimum(angle, 2.5)),
            "between": 0.6 * angle + 0.4 * np.sin(np.minimum(angle, 1.55)),
        }[self.kind]
        radius = self.focal * ideal * (1.0 + self.bend[0] * angle**2 + self.bend[1] * angle**4)
        around = np.arctan2(y, x)
        places = self.centre + radius[:, None] * np.stack([np.cos(around), np.sin(around)], axis=-1)
        places += self.wave[0] * np.sin(places / self.wave[1] + self.wave[2:4])
        places[angle > self.widest] = np.nan
        if self.mirrored:
            places[:, 0] = self.size[0] - 1.0 - places[:, 0]
        return np.asarray(places)


def draw_lens(rng: np.random.Generator, *, tilt_deg: float = 15.0) -> Lens:
    """Return a lens whose focal length is within a factor of two of what the image suggests."""
    width = int(rng.integers(480, 2049))
    size = (width, round(width * float(rng.choice([1.0, 1.0, 0.75, 0.6667]))))
    short = min(size)
    kind = str(rng.choice(["linear", "equal area", "conformal", "between"]))
    widest = math.radians(rng.uniform(70.0, 98.0))
    edge = {"linear": 1.5708, "equal area": 1.4142, "conformal": 2.0, "between": 1.3425}[kind]
    # the radius of 90 degrees: half the shorter side, times 0.6 to 1.7
    focal = 0.5 * short * math.exp(rng.uniform(math.log(0.6), math.log(1.7))) / edge
    about, tilt, north = rng.uniform(0.0, 2.0 * math.pi), math.radians(tilt_deg) * rng.uniform(), rng.uniform(0, 6.2832)
    pose = turn(2, north) @ turn(2, -about) @ turn(1, tilt) @ turn(2, about)
    return Lens(
        size=size,
        focal=focal,
        kind=kind,
        bend=(float(rng.normal(0.0, 0.01)), float(rng.normal(0.0, 0.003))),
        centre=0.5 * np.array(size) - 0.5 + rng.normal(0.0, 0.02 * short, 2),
        pose=pose,
        mirrored=bool(rng.integers(2)),
        widest=widest,
        wave=np.r_[rng.uniform(0.0, 0.2), rng.uniform(0.1, 0.3) * short, rng.uniform(0.0, 6.28, 2)],
    )


@dataclass(frozen=True, kw_only=True)
class Sky:
    """What a night holds: limit of V at the zenith, share of the sky behind clouds, false lights of each kind."""

    limit: float = 5.3
    noise_px: float = 0.2
    scatter: float = 0.3
    lost: float = 0.05
    clouds: float = 0.0
    patches: bool = False
    faint: int = 60
    hot: int = 0
    lamps: int = 0
    glare_deg: float = 0.0
    edges: int = 0
    trail: int = 0
    text: int = 0
    rays: int = 0
    stars: bool = True


@dataclass(frozen=True, kw_only=True)
class Shot:
    """What a detector gives, the brightest first: pixels, flux, 1-sigma; `star` is the row of the sky, or -1."""

    pixels: FloatArray
    flux: FloatArray
    sigma: FloatArray
    star: NDArray[np.int64]
    hidden: float = field(default=0.0)


def shoot(rng: np.random.Generator, lens: Lens, sky: Sky, directions: FloatArray, magnitude: FloatArray) -> Shot:
    """Return what a lens shows of directions (n, 3), ENU."""
    up = directions[:, 2]
    mass = 1.0 / np.maximum(up + 0.03 * np.exp(-8.0 * up), 0.03)
    apparent = magnitude + rng.uniform(0.15, 0.4) * (mass - 1.0)
    seen = (
        (up > 0.03) & (apparent < sky.limit + rng.normal(0.0, 0.15, up.size)) & (rng.uniform(size=up.size) > sky.lost)
    )
    covered = _covered(rng, sky, directions)
    seen &= ~covered & sky.stars
    if sky.glare_deg:
        moon = _somewhere(rng)
        near = np.degrees(np.arccos(np.clip(directions @ moon, -1.0, 1.0)))
        seen &= (near > sky.glare_deg) & (apparent < sky.limit - 3.0 * np.exp(-near / sky.glare_deg))
    places = lens.pixels(directions)
    sigma = np.clip(sky.noise_px * 10.0 ** (0.2 * (apparent - 3.5)), 0.05, 1.5)
    places = places + sigma[:, None] * rng.standard_normal(places.shape)
    flux = 10.0 ** (-0.4 * (apparent + rng.normal(0.0, sky.scatter, up.size)))
    flux = np.minimum(flux, 10.0 ** (-0.4 * rng.uniform(0.0, 1.5)))  # clipped
    parts = [(places[seen], flux[seen], sigma[seen], np.flatnonzero(seen))]
    parts += _false(rng, lens, sky)
    pixels, light, noise, rows = (np.concatenate(column) for column in zip(*parts, strict=True))
    inside = np.all((pixels > 1.0) & (pixels < np.array(lens.size) - 2.0), axis=-1)
    order = np.flatnonzero(inside)[np.argsort(-light[inside], kind="stable")]
    hidden = float(np.mean(covered[up > 0.2]))
    return Shot(pixels=pixels[order], flux=light[order], sigma=noise[order], star=rows[order], hidden=hidden)


def _somewhere(rng: np.random.Generator) -> FloatArray:
    up, about = rng.uniform(0.2, 0.95), rng.uniform(0.0, 2.0 * math.pi)
    flat = math.sqrt(1.0 - up * up)
    return np.array([flat * math.cos(about), flat * math.sin(about), up])


def _covered(rng: np.random.Generator, sky: Sky, directions: FloatArray) -> NDArray[np.bool_]:
    if sky.clouds == 0.0:
        return np.zeros(directions.shape[0], dtype=bool)
    if not sky.patches:  # a bank of cloud from one side
        bank = directions @ np.append(rng.standard_normal(2), 0.0)
        return np.asarray(bank < np.quantile(bank[directions[:, 2] > 0.1], sky.clouds))
    thick = np.max(directions @ np.stack([_somewhere(rng) for _ in range(14)]).T, axis=-1)
    return np.asarray(thick > np.quantile(thick[directions[:, 2] > 0.1], 1.0 - sky.clouds))


def _false(
    rng: np.random.Generator, lens: Lens, sky: Sky
) -> list[tuple[FloatArray, FloatArray, FloatArray, NDArray[np.int64]]]:
    size, edge = np.array(lens.size), lens.pixels(_ring(lens, 0.97))
    middle = np.nanmean(edge, axis=0)
    reach = float(np.nanmedian(np.linalg.norm(edge - middle, axis=-1)))

    def in_circle(count: int, *, least: float = 0.0) -> FloatArray:
        far, about = reach * np.sqrt(rng.uniform(least**2, 1.0, count)), rng.uniform(0.0, 2.0 * math.pi, count)
        return np.asarray(middle + far[:, None] * np.stack([np.cos(about), np.sin(about)], axis=-1))

    parts = [(in_circle(sky.faint), rng.uniform(sky.limit - 1.0, sky.limit + 0.3, sky.faint))]
    parts.append((rng.uniform(0.0, 1.0, (sky.hot, 2)) * size, rng.uniform(1.0, 6.0, sky.hot)))
    parts.append((in_circle(sky.lamps, least=0.88), rng.uniform(-1.0, 3.0, sky.lamps)))
    # cosmic rays: anywhere, and as many of each brightness as there are stars
    parts.append((rng.uniform(0.0, 1.0, (sky.rays, 2)) * size, sky.limit + 2.0 * np.log10(rng.uniform(size=sky.rays))))
    for _ in range(sky.trail):
        begin, heading = in_circle(1)[0], rng.uniform(0.0, 2.0 * math.pi)
        step = np.array([math.cos(heading), math.sin(heading)]) * rng.uniform(5.0, 15.0)
        parts.append((begin + np.arange(8)[:, None] * step, rng.uniform(1.0, 4.0, 8)))
    if sky.edges:  # the texture of cloud's edges: in clumps
        clumps = in_circle(max(sky.edges // 12, 1))
        rows = rng.integers(clumps.shape[0], size=sky.edges)
        places = clumps[rows] + rng.normal(0.0, 0.04 * min(lens.size), (sky.edges, 2))
        parts.append((places, rng.uniform(2.0, 5.0, sky.edges)))
    if sky.text:
        begin = np.array([0.02, 0.03]) * size
        parts.append((begin + np.arange(sky.text)[:, None] * np.array([7.0, 0.0]), rng.uniform(-1.0, 1.0, sky.text)))
    return [
        (places, 10.0 ** (-0.4 * light), np.full(light.size, 0.15), np.full(light.size, -1, dtype=np.int64))
        for places, light in parts
    ]


def _ring(lens: Lens, share: float) -> FloatArray:
    about = np.linspace(0.0, 2.0 * math.pi, 72, endpoint=False)
    angle = share * min(lens.widest, 1.5)
    ring = np.stack([math.sin(angle) * np.cos(about), math.sin(angle) * np.sin(about), np.full(72, math.cos(angle))])
    return np.asarray(ring.T @ lens.pose)


def render(rng: np.random.Generator, lens: Lens, sky: Sky, shot: Shot) -> NDArray[np.uint8]:
    """Return what a camera of 8 bits shows of a shot: spots that widen outwards, a sky, clouds, a glare, and noise."""
    width, height = lens.size
    x, y = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    middle = np.nanmean(lens.pixels(_ring(lens, 0.97)), axis=0)
    reach = float(np.nanmedian(np.linalg.norm(lens.pixels(_ring(lens, 0.97)) - middle, axis=-1)))
    far = np.hypot(x - middle[0], y - middle[1]) / reach
    light = 60.0 + 40.0 * far**2
    for _ in range(round(20 * sky.clouds)):
        at, wide = middle + reach * rng.uniform(-1.0, 1.0, 2), reach * rng.uniform(0.08, 0.3)
        light += rng.uniform(20.0, 90.0) * np.exp(-(((x - at[0]) ** 2 + (y - at[1]) ** 2) / (2.0 * wide**2)))
    if sky.glare_deg:
        at = middle + 0.6 * reach * rng.uniform(-1.0, 1.0, 2)
        light += 4000.0 / (1.0 + (((x - at[0]) ** 2 + (y - at[1]) ** 2) / (0.02 * reach) ** 2))
    light[far > 1.05] = 5.0
    for (u, v), flux in zip(shot.pixels, shot.flux, strict=True):
        out = math.hypot(u - middle[0], v - middle[1]) / reach
        spread = 0.9 + 0.5 * out**2
        columns = np.arange(max(int(u) - 7, 0), min(int(u) + 9, width))
        rows = np.arange(max(int(v) - 7, 0), min(int(v) + 9, height))
        across = np.exp(-0.5 * ((columns - u) / spread) ** 2)
        down = np.exp(-0.5 * ((rows - v) / spread) ** 2)
        peak = 2.2e4 * flux * 10.0 / (2.0 * math.pi * spread**2)
        light[np.ix_(rows, columns)] += peak * down[:, None] * across
    counts = rng.poisson(light * 2.0) / 2.0 + rng.normal(0.0, 3.0, light.shape)
    return np.asarray(np.round(255.0 * np.clip(counts / 2500.0, 0.0, 1.0) ** 0.5), dtype=np.uint8)
