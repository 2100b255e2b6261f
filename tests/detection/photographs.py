"""Stand-ins for ordinary all-sky photographs: JPEG, a saturated sun with glare, and what else such images hold."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from tests.detection.rendering import FloatArray

WHITE = (255, 255, 255)


@dataclass(frozen=True, kw_only=True)
class Photograph:
    """What is in the picture; an equidistant lens, light in full scales of the sensor."""

    size: int = 720
    wider: int = 0  # px that the picture is wider than high
    zenith_deg: float = 40.0
    azimuth_deg: float = 30.0
    exposure: float = 1.0
    haze: float = 0.3
    streaks: int = 0
    contrails: int = 0
    dirt: int = 0
    bright_cloud: bool = False
    thin_cloud: float = 0.0  # optical depth; it is the sun's own light that it scatters
    ghost: bool = False
    snow: bool = False
    smear: float = 0.0
    stamp: bool = True
    quality: int = 85

    @property
    def radius(self) -> float:
        return 0.48 * self.size

    @property
    def middle(self) -> tuple[float, float]:
        return (self.size + self.wider - 1) / 2, (self.size - 1) / 2

    @property
    def sun_px(self) -> tuple[float, float]:
        r, a = self.radius * self.zenith_deg / 90.0, math.radians(self.azimuth_deg)
        return self.middle[0] + r * math.sin(a), self.middle[1] - r * math.cos(a)


class _Grid(NamedTuple):
    """Of every pixel: its place, its zenith angle and its angle from the sun in degrees, its px from the sun / 1920."""

    columns: FloatArray
    rows: FloatArray
    zenith: FloatArray
    apart: FloatArray
    far: FloatArray


def photograph(scene: Photograph, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return the picture, (rows, columns, 3) in OpenCV's colour order, after JPEG."""
    grid = _grid(scene)
    depth = _thin_cloud(scene, rng)
    light = _sun_light(scene, grid, depth) + _contrails(scene, grid, rng) + _dirt(scene, grid, rng)
    if scene.bright_cloud:
        light += _bright_cloud(scene, grid, rng)
    if scene.ghost:
        opposite = [2 * m - s for m, s in zip(scene.middle, scene.sun_px, strict=True)]
        light += 0.8 * (np.hypot(grid.columns - opposite[0], grid.rows - opposite[1]) < 0.012 * scene.size)
    if scene.smear:
        light += scene.smear * np.exp(-0.5 * ((grid.columns - scene.sun_px[0]) / 6.0) ** 2)
    sky = 0.10 + 0.25 * (grid.zenith / 90.0) ** 2
    colours = scene.exposure * np.stack([light + sky * c for c in (1.6, 1.0, 0.7)], axis=-1)
    colours *= (grid.zenith < 90.0)[..., None]
    if scene.snow:
        colours[(grid.zenith > 83.0) & (grid.zenith < 90.0) & (np.sin(grid.columns / 40.0) > 0)] = 1.2
    colours = _blurred(colours, 0.8) + 0.004 * rng.standard_normal(colours.shape, dtype=np.float32)
    picture = (255 * np.clip(colours, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    if scene.stamp:
        cv2.putText(picture, "2016-08-30 12:00:00", (5, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.8, WHITE, 2)
    done, packed = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, scene.quality])
    assert done
    return np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR), dtype=np.uint8)


def _blurred(image: NDArray[np.floating], sigma_px: float) -> FloatArray:
    """Return a Gaussian blur, wide ones on a coarser grid."""
    step = max(1, round(sigma_px / 3.0))
    small = cv2.resize(image.astype(np.float32), None, fx=1 / step, fy=1 / step, interpolation=cv2.INTER_AREA)
    soft = cv2.GaussianBlur(small, (0, 0), sigma_px / step)
    return np.asarray(cv2.resize(soft, image.shape[1::-1]), dtype=np.float64)


def _grid(scene: Photograph) -> _Grid:
    rows, columns = np.mgrid[: scene.size, : scene.size + scene.wider].astype(np.float64)
    x, y = columns - scene.middle[0], rows - scene.middle[1]
    zenith = np.radians(np.hypot(x, y) / scene.radius * 90.0)
    sun, azimuth = math.radians(scene.zenith_deg), np.arctan2(x, -y) - math.radians(scene.azimuth_deg)
    cosine = np.cos(zenith) * math.cos(sun) + np.sin(zenith) * math.sin(sun) * np.cos(azimuth)
    far = np.hypot(columns - scene.sun_px[0], rows - scene.sun_px[1]) * 1920.0 / scene.size
    return _Grid(columns, rows, np.degrees(zenith), np.degrees(np.arccos(np.clip(cosine, -1, 1))), far)


def _sun_light(scene: Photograph, grid: _Grid, depth: FloatArray) -> FloatArray:
    """Return disc and lens glare (round in pixels), the air's aureole and the cloud's (round in the sky)."""
    through = np.exp(-float(_at_sun(scene, depth)))
    glare = through * (4000.0 * (grid.apart < 0.27) + 20.0 / (1 + (grid.far / 4.0) ** 2) + 1.5 / (1 + grid.far / 8))
    air = through * scene.haze * (2.0 / (0.3 + grid.apart**1.5) + 0.4 * np.exp(-grid.apart / 25.0))
    cloud = depth * np.exp(-depth) * (30.0 / (1 + (grid.apart / 1.5) ** 2) + 0.8 * np.exp(-grid.apart / 30.0))
    light = glare + air + cloud
    angle = np.arctan2(grid.rows - scene.sun_px[1], grid.columns - scene.sun_px[0])
    for k in range(scene.streaks):
        ray = (k * math.pi / scene.streaks + 0.3) % math.pi
        across = np.abs(np.sin(angle - ray)) * grid.far
        light = light + 3.0 * np.exp(-0.5 * (across / 2.5) ** 2) / (1 + (grid.far / 30.0) ** 2)
    return np.asarray(light)


def _at_sun(scene: Photograph, values: FloatArray) -> float:
    return float(values[round(scene.sun_px[1]), round(scene.sun_px[0])])


def _thin_cloud(scene: Photograph, rng: np.random.Generator) -> FloatArray:
    shape = (scene.size, scene.size + scene.wider)
    if scene.thin_cloud == 0.0:
        return np.zeros(shape)
    texture = np.zeros(shape)
    for octave in range(4):
        part = _blurred(rng.standard_normal(shape, dtype=np.float32), scene.size / 20 / 2**octave)
        texture += part / part.std() * 0.6**octave
    return np.asarray(scene.thin_cloud * np.exp(0.7 * texture))


def _contrails(scene: Photograph, grid: _Grid, rng: np.random.Generator) -> FloatArray:
    """Return streaks across the sky, near the sun, of any width; they shine the more the nearer the sun."""
    light = np.zeros_like(grid.columns)
    for _ in range(scene.contrails):
        angle, offset = rng.uniform(0, math.pi), rng.normal(0, 0.04 * scene.size)
        x, y = grid.columns - scene.sun_px[0], grid.rows - scene.sun_px[1]
        across = x * math.sin(angle) - y * math.cos(angle) - offset
        width = rng.uniform(0.002, 0.012) * scene.size
        light += rng.uniform(0.2, 1.0) * np.exp(-0.5 * (across / width) ** 2) * (0.4 + 3.0 / (1 + grid.apart / 3.0))
    return light


def _dirt(scene: Photograph, grid: _Grid, rng: np.random.Generator) -> FloatArray:
    """Return specks on the dome beside the sun, lit by it."""
    light = np.zeros_like(grid.columns)
    for _ in range(scene.dirt):
        angle, far, wide = rng.uniform(0, 2 * math.pi), rng.uniform(0.02, 0.08), rng.uniform(0.003, 0.012)
        x, y = (s + far * scene.size * f(angle) for s, f in zip(scene.sun_px, (math.cos, math.sin), strict=True))
        apart = np.hypot(grid.columns - x, grid.rows - y) / (wide * scene.size)
        light += rng.uniform(0.3, 1.5) * np.exp(-0.5 * apart**2)
    return light


def _bright_cloud(scene: Photograph, grid: _Grid, rng: np.random.Generator) -> FloatArray:
    cx, cy = scene.sun_px[0] + 0.12 * scene.size, scene.sun_px[1] - 0.05 * scene.size
    lumps = _blurred(rng.standard_normal(grid.rows.shape, dtype=np.float32), 6.0) * 25
    return np.asarray(1.6 * (np.hypot((grid.columns - cx) / 1.6, grid.rows - cy) + lumps < 0.05 * scene.size))


def sky(*, x: float, y: float, radius: float, size: int = 600, smear: float = 0.0, seed: int = 0) -> NDArray[np.uint16]:
    """Return an RGB image of a saturated blob with glare, on a graded sky."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[:size, :size]
    far = np.hypot(columns - x, rows - y)
    light = 0.1 + 1.2 / (1 + np.exp(np.minimum((far - radius) / 1.5, 50.0))) + 0.4 / (1 + (far / (2 * radius)) ** 2)
    light = light + smear * np.exp(-0.5 * ((columns - x) / 1.5) ** 2)
    colour = np.stack([light * c for c in (0.9, 1.0, 1.1)], axis=-1) + rng.normal(0, 0.003, (size, size, 3))
    return np.clip(colour * 4095, 0, 4095).astype(np.uint16)
