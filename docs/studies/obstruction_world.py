"""A rendered sky with trees, buildings, a mast and a crane, for the study of obstruction masks.

It shares no code with sunarc: its own equidistant lens, sun, sky, clouds and surfaces.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Weather = Literal["clear", "scattered", "broken", "overcast", "fog", "haze", "thin", "bank"]
DEPTH: dict[Weather, float] = {"overcast": 20.0, "fog": 20.0, "bank": 20.0, "thin": 6.0}
"""Optical depth before the sun of an even cloud, added to that of its structure: stratus 20, altostratus 6."""
FULL_16, FULL_8 = 65535.0, 255.0


def sun_enu(time: datetime, latitude_deg: float, longitude_deg: float) -> Array:
    """Return the sun's unit vector, east-north-up: the low-precision formulae of the Astronomical Almanac (0.01°)."""
    days = (time - datetime(2000, 1, 1, 12, tzinfo=UTC)).total_seconds() / 86400.0
    anomaly = math.radians(357.528 + 0.9856003 * days)
    mean = 280.460 + 0.9856474 * days
    ecliptic = math.radians(mean + 1.915 * math.sin(anomaly) + 0.020 * math.sin(2.0 * anomaly))
    tilt = math.radians(23.439 - 4e-7 * days)
    ascension = math.atan2(math.cos(tilt) * math.sin(ecliptic), math.cos(ecliptic))
    declination = math.asin(math.sin(tilt) * math.sin(ecliptic))
    hour = math.radians((280.46062 + 360.98564737 * days + longitude_deg) % 360.0) - ascension
    latitude = math.radians(latitude_deg)
    return np.array(
        [
            -math.cos(declination) * math.sin(hour),
            math.sin(declination) * math.cos(latitude) - math.cos(declination) * math.cos(hour) * math.sin(latitude),
            math.sin(declination) * math.sin(latitude) + math.cos(declination) * math.cos(hour) * math.cos(latitude),
        ]
    )


def texture(shape: tuple[int, int], rng: np.random.Generator, *, coarsest: int, roughness: float = 0.6) -> Array:
    """Return fractal noise of unit variance, periodic in nothing."""
    total, size, weight = np.zeros(shape), coarsest, 1.0
    while size >= 1:
        small = rng.standard_normal((shape[0] // size + 3, shape[1] // size + 3))
        big = cv2.resize(small, None, fx=size, fy=size, interpolation=cv2.INTER_CUBIC)
        total += weight * big[: shape[0], : shape[1]]
        size, weight = size // 2, weight * roughness
    return np.asarray((total - total.mean()) / total.std())


@dataclass
class World:
    """A camera on a roof: an upright equidistant lens whose image circle is the horizon at 92 degrees.

    `truth` is (n, n): whether something hides the sky, at a moment with or without the crane; `horizon_deg` (360,).
    """

    n: int
    seed: int
    latitude_deg: float = 47.0
    longitude_deg: float = 8.0
    rotation_deg: float = 20.0
    linear: bool = True
    text: bool = False
    start: datetime = datetime(2026, 5, 10, tzinfo=UTC)
    rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        """Draw the surroundings."""
        self.rng = np.random.default_rng(self.seed)
        self.focal_px = 0.49 * self.n / math.radians(92.0)
        y, x = np.mgrid[0 : self.n, 0 : self.n] - (self.n - 1) / 2.0
        self.theta = np.hypot(x, y) / self.focal_px
        # x to the west, y to the south for a camera that looks up with its top to the north, then turned
        self.azimuth = np.degrees(np.arctan2(-x, -y)) % 360.0 - self.rotation_deg
        self.azimuth %= 360.0
        self.elevation = 90.0 - np.degrees(self.theta)
        up, across = np.cos(self.theta), np.sin(self.theta)
        a = np.radians(self.azimuth)
        self.directions = np.stack([across * np.sin(a), across * np.cos(a), up], axis=-1)
        self.field = self.elevation > -2.0
        self.speed = self.rng.uniform(0.002, 0.006, 2)
        self._things()
        self._surfaces()
        pattern = texture((1024, 1024), self.rng, coarsest=256)
        self.clouds = pattern.astype(np.float32)

    def _things(self) -> None:
        """Draw outlines: sharp ones of houses and mast, ragged ones of trees, as functions of azimuth."""
        az = np.arange(0.0, 360.0, 0.05)
        rough = texture((1, az.size), self.rng, coarsest=256, roughness=0.75)[0]
        self.trees, self.houses = np.full(az.size, -5.0), np.full(az.size, 0.5)
        for _ in range(5):
            centre, width, top = self.rng.uniform(0, 360), self.rng.uniform(10, 28), self.rng.uniform(8, 26)
            off = (az - centre + 180.0) % 360.0 - 180.0
            shape = top * np.sqrt(np.clip(1.0 - (off / width) ** 2, 0.0, 1.0)) + 1.6 * rough
            self.trees = np.where(np.abs(off) < width, np.maximum(self.trees, shape), self.trees)
        for _ in range(4):
            centre, width, top = self.rng.uniform(0, 360), self.rng.uniform(5, 18), self.rng.uniform(5, 18)
            off = (az - centre + 180.0) % 360.0 - 180.0
            self.houses = np.where(np.abs(off) < width, np.maximum(self.houses, top), self.houses)
        self.mast_at, self.crane_at = self.rng.uniform(0, 360, 2)
        self._az = az

    def _outline(self, outline: Array) -> Array:
        return np.asarray(np.interp(self.azimuth, self._az, outline, period=360.0))

    def _off(self, centre: float) -> Array:
        return np.asarray((self.azimuth - centre + 180.0) % 360.0 - 180.0)

    def _surfaces(self) -> None:
        shape = (self.n, self.n)
        self.tree = self.elevation < self._outline(self.trees)
        self.house = (self.elevation < self._outline(self.houses)) & ~self.tree
        mast = np.abs(self._off(self.mast_at)) * np.cos(np.radians(self.elevation)) < 0.5
        self.mast = mast & (self.elevation < 35.0)
        off = self._off(self.crane_at)
        tower = (np.abs(off) * np.cos(np.radians(self.elevation)) < 1.0) & (self.elevation < 32.0)
        jib = (off > -8.0) & (off < 28.0) & (np.abs(self.elevation - 30.0) < 1.0)
        self.crane = tower | jib
        leaves = texture(shape, self.rng, coarsest=max(self.n // 64, 4), roughness=0.9)
        self.leaf = 0.06 * np.exp(0.6 * leaves)
        columns, rows = np.floor(self.azimuth / 1.6), np.floor(self.elevation / 1.9)
        window = (self.azimuth / 1.6 % 1.0 > 0.35) & (self.elevation / 1.9 % 1.0 > 0.4)
        paint = 0.35 + 0.25 * np.sin(np.floor(self.azimuth / 13.0) * 2.4)
        self.wall = np.where(window, 0.06, paint) + 0.02 * texture(shape, self.rng, coarsest=4)
        self.window = window & (np.sin(columns * 12.9 + rows * 78.2) > 0.2)
        self.lamp = window & (np.sin(columns * 5.9 + rows * 38.2) > 0.8)

    def truth(self, *, crane: bool) -> NDArray[np.bool_]:
        """Return the obstructions of the sky."""
        return np.asarray((self.tree | self.house | self.mast | (self.crane if crane else False)) & self.field)

    def horizon_deg(self, *, crane: bool = False, azimuth_deg: Array | None = None) -> Array:
        """Return the highest elevation that something hides, by azimuth (whole degrees)."""
        azimuth = np.arange(360.0) if azimuth_deg is None else azimuth_deg
        top = np.maximum(np.interp(azimuth, self._az, self.trees), np.interp(azimuth, self._az, self.houses))
        off = np.abs((azimuth - self.mast_at + 180.0) % 360.0 - 180.0) * math.cos(math.radians(35.0))
        top = np.where(off < 0.5, 35.0, top)
        if crane:
            away = (azimuth - self.crane_at + 180.0) % 360.0 - 180.0
            top = np.where((away > -8.0) & (away < 28.0), np.maximum(top, 31.0), top)
        return np.maximum(top, 0.0)

    def sun(self, time: datetime) -> Array:
        """Return the sun's unit vector."""
        return sun_enu(time, self.latitude_deg, self.longitude_deg)

    def frame(self, time: datetime, weather: Weather, *, crane: bool = False) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """Return an image: linear counts of 16 bits, or a JPEG's of 8 bits with a burnt-in line of text."""
        light, hidden = self._sky(time, weather), self.truth(crane=crane)
        light = np.where(hidden, self._ground(time, weather, light), light)
        if weather == "fog":
            veil = float(np.median(light[self.field]))
            light = veil * (0.55 + 0.45 * np.clip(self.directions[..., 2], 0.0, 1.0)) + 0.01 * light
        return self._exposed(np.asarray(cv2.GaussianBlur(np.where(self.field, light, 0.0), (0, 0), 0.6), np.float64))

    def _sky(self, time: datetime, weather: Weather) -> Array:
        """Return radiance: clear gradient and circumsolar light, clouds that drift on a plane, or a town's glow."""
        sun, up = self.sun(time), np.clip(self.directions[..., 2], 0.02, 1.0)
        away = np.arccos(np.clip(self.directions @ sun, -1.0, 1.0))
        height = math.degrees(math.asin(sun[2]))
        day = float(np.interp(height, [-18, -6, 0, 10, 60], [1e-6, 3e-4, 0.05, 0.35, 1.0]))
        haze = 2.5 if weather == "haze" else 1.0
        clear = (1.0 - np.exp(-0.32 * haze / up)) / (1.0 - math.exp(-0.32 * haze))
        clear *= 0.91 + 10.0 * np.exp(-3.0 * away) * (height > -4) + 0.45 * np.cos(away) ** 2
        azimuth = np.radians(self.azimuth - 200.0)
        glow = 2e-5 * (1.0 + 4.0 * np.exp(-(1.0 - np.cos(azimuth)) * 3.0) * np.exp(-self.elevation / 15.0))
        cover = {"clear": 0.0, "haze": 0.0, "scattered": 0.35, "broken": 0.65}.get(weather, 1.0)
        thick = self._cloud(time, cover) + (1.5 if weather == "fog" else 0.0)
        disc = 3e4 * (away < math.radians(0.27)) + 60.0 * np.exp(-away / math.radians(1.2)) / haze
        even = DEPTH.get(weather, 0.0)
        disc = disc * day * (height > -0.3) * np.exp(-even - (2.0 if weather == "thin" else 9.0) * thick)
        lit = (1.3 + 1.5 * np.exp(-2.0 * away)) * (1.0 - 0.55 * np.clip(thick, 0.0, 1.0)) * (0.4 + 0.6 * up)
        if weather == "thin":  # as through ground glass
            lit = lit + 12.0 * np.exp(-away / 0.12) * (height > -0.3)
        if weather == "bank":  # stands over a ridge all week, with a ragged lower edge
            below = 1.0 / (1.0 + np.exp((self.elevation - 14.0 - 3.0 * thick) / 1.5))
            lit = lit * (1.0 - 0.75 * below * (np.cos(azimuth) > 0.3))
        lit = lit + (clear - lit) * (1.0 - np.exp(-0.12 / up)) * (cover < 1.0)  # the air before far clouds is lit
        veil = np.clip(1.6 * thick, 0.0, 1.0) if even == 0.0 else 1.0  # an even cloud has no holes
        return np.asarray((clear * (1.0 - veil) + lit * veil) * day + disc + glow)

    def _cloud(self, time: datetime, cover: float) -> Array:
        if cover == 0.0:
            return np.zeros((self.n, self.n))
        seconds = (time - self.start).total_seconds()
        up = np.clip(self.directions[..., 2], 0.05, 1.0)
        east, north = (self.directions[..., k] / up * 90.0 + seconds * self.speed[k] * 12.0 for k in range(2))
        east, north = (np.abs((at % 2046.0) - 1023.0).astype(np.float32) for at in (east, north))  # reflected
        picked = cv2.remap(self.clouds, east, north, cv2.INTER_LINEAR)
        level = {0.35: 0.5, 0.65: -0.4, 1.0: -4.0}[cover]
        return np.clip((picked.astype(np.float64) - level) * (0.9 if cover < 1 else 0.25), 0.0, 1.5)

    def _ground(self, time: datetime, weather: Weather, light: Array) -> Array:
        """Return the radiance of the surroundings: lit by the sky's mean and, where they face it, by the sun."""
        sun = self.sun(time)
        height = math.degrees(math.asin(sun[2]))
        day = float(np.interp(height, [-18, -6, 0, 10, 60], [1e-6, 3e-4, 0.05, 0.35, 1.0]))
        direct = 4.0 * (weather in ("clear", "scattered", "haze")) * (height > 1.0)
        facing = np.clip(-(self.directions[..., :2] @ sun[:2]), 0.0, 1.0) * direct
        ambient = 0.5 * float(np.mean(np.minimum(light[self.field], 5.0)))  # an upright surface faces half of the sky
        day, shade = max(day, 1e-9), ambient / max(day, 1e-9)
        shake = np.roll(self.leaf, self.rng.integers(-1, 2, 2), axis=(0, 1))
        tree = shake * (shade + 0.6 * facing)
        mirrored = self.window & (facing > 0.7 * max(direct, 1e-9)) & (direct > 0)
        house = self.wall * (shade + facing) + 0.4 * shade * self.window + 2.0 * mirrored
        metal = 0.12 * (shade + facing)
        ground = np.where(self.tree, tree, np.where(self.house, house, metal))
        return np.asarray(ground * day + np.where(self.house & self.lamp & (height < -2), 4e-4, 2e-6))

    def _exposed(self, light: Array) -> NDArray[np.uint8] | NDArray[np.uint16]:
        if self.linear:
            counts = light * FULL_16 / 40.0 + self.rng.normal(
                0.0, 1.0 + 0.02 * np.sqrt(np.maximum(light, 0.0) * FULL_16)
            )
            return np.clip(np.rint(counts), 0.0, FULL_16).astype(np.uint16)
        white = 3.0 * float(np.median(light[self.field]))  # auto exposure
        grey = FULL_8 * np.clip(light / white, 0.0, 1.0) ** (1.0 / 2.2) + self.rng.normal(0.0, 1.0, light.shape)
        image = np.repeat(np.clip(grey, 0.0, FULL_8).astype(np.uint8)[..., None], 3, axis=-1)
        if self.text:
            stamp = f"CAM 3 {self.rng.integers(1_000_000):06d}"
            cv2.putText(image, stamp, (8, 22), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (255, 255, 255), 1)
        coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 85])[1]
        return np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), dtype=np.uint8)

    def bumped(self, image: NDArray[Any], turn: Array) -> NDArray[Any]:
        """Return an image as the camera shows it once it was turned: its directions are `turn` (3, 3) times before."""
        east, north, up = np.moveaxis(self.directions @ turn.T, -1, 0)
        away = self.focal_px * np.arctan2(np.hypot(east, north), up)
        bearing = np.arctan2(east, north) + math.radians(self.rotation_deg)
        x, y = ((self.n - 1) / 2.0 - away * part(bearing) for part in (np.sin, np.cos))
        return np.asarray(cv2.remap(image, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR))

    def times(self, day: int, *, every_min: float = 10.0) -> list[datetime]:
        """Return the moments of a day with the sun above -6 degrees."""
        first = self.start + timedelta(days=day)
        every = [first + timedelta(minutes=every_min * k) for k in range(round(1440 / every_min))]
        return [time for time in every if self.sun(time)[2] > math.sin(math.radians(-6.0))]
