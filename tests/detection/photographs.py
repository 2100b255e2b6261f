"""Stand-ins for ordinary all-sky photographs: JPEG, a saturated sun with glare, and what else such images hold."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from tests.detection.rendering import FloatArray


@dataclass(frozen=True, kw_only=True)
class Photograph:
    """What is in the picture; lengths in px, light in full scales of the sensor."""

    size: int = 960
    zenith_deg: float = 40.0
    azimuth_deg: float = 30.0
    sun: float = 4000.0
    aureole: float = 1.0
    streaks: int = 0
    contrails: int = 0
    bright_cloud: bool = False
    thin_cloud: float = 0.0
    ghost: bool = False
    stamp: bool = True
    quality: int = 85

    @property
    def radius(self) -> float:
        return 0.48 * self.size

    @property
    def sun_px(self) -> tuple[float, float]:
        r = self.radius * self.zenith_deg / 90.0
        a, middle = math.radians(self.azimuth_deg), (self.size - 1) / 2
        return middle + r * math.sin(a), middle - r * math.cos(a)


def photograph(scene: Photograph, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return the picture, (rows, columns, 3) in OpenCV's colour order, after JPEG."""
    rows, columns = np.mgrid[: scene.size, : scene.size].astype(np.float64)
    x, y = scene.sun_px
    middle = (scene.size - 1) / 2
    out = np.hypot(columns - middle, rows - middle)
    far = np.hypot(columns - x, rows - y) / scene.size * 1920.0
    light = _sun_light(scene, columns - x, rows - y, far)
    light *= _thin_cloud(scene, rng)
    light += _contrails(scene, columns, rows, rng)
    if scene.bright_cloud:
        cx, cy = x + 0.12 * scene.size, y - 0.05 * scene.size
        lumps = gaussian_filter(rng.normal(size=light.shape), 6) * 25
        light += 1.6 * (np.hypot((columns - cx) / 1.6, rows - cy) + lumps < 0.05 * scene.size)
    if scene.ghost:
        light += 0.8 * (np.hypot(columns - (2 * middle - x), rows - (2 * middle - y)) < 0.012 * scene.size)
    sky = 0.10 + 0.25 * (out / scene.radius) ** 2
    colours = np.stack([light + sky * c for c in (1.6, 1.0, 0.7)], axis=-1)
    colours *= (out < scene.radius)[..., None]
    colours = gaussian_filter(colours, (0.8, 0.8, 0)) + rng.normal(0, 0.004, colours.shape)
    picture = (255 * np.clip(colours, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    if scene.stamp:
        cv2.putText(picture, "2016-08-30 12:00:00", (5, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.8, (255, 255, 255), 2)
    done, packed = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, scene.quality])
    assert done
    return np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR), dtype=np.uint8)


def _sun_light(scene: Photograph, dx: FloatArray, dy: FloatArray, far: FloatArray) -> FloatArray:
    light = scene.sun * (far < 3) + scene.aureole * 60.0 / (1 + (far / 4.0) ** 2) + scene.aureole * 6.0 / (5 + far / 8)
    angle = np.arctan2(dy, dx)
    for k in range(scene.streaks):
        ray = (k * math.pi / scene.streaks + 0.3) % math.pi
        across = np.abs(np.sin(angle - ray)) * far
        light = light + 3.0 * np.exp(-0.5 * (across / 2.5) ** 2) / (1 + (far / 30.0) ** 2)
    return np.asarray(light)


def _thin_cloud(scene: Photograph, rng: np.random.Generator) -> FloatArray:
    if scene.thin_cloud == 0.0:
        return np.ones((scene.size, scene.size))
    texture = gaussian_filter(rng.normal(size=(scene.size, scene.size)), scene.size / 60)
    return np.asarray(np.exp(scene.thin_cloud * texture / texture.std()))


def _contrails(scene: Photograph, columns: FloatArray, rows: FloatArray, rng: np.random.Generator) -> FloatArray:
    light = np.zeros_like(columns)
    for _ in range(scene.contrails):
        angle, offset = rng.uniform(0, math.pi), rng.normal(0, 0.01 * scene.size)
        across = (columns - scene.sun_px[0]) * math.sin(angle) - (rows - scene.sun_px[1]) * math.cos(angle) - offset
        light += rng.uniform(0.3, 1.2) * np.exp(-0.5 * (across / (0.004 * scene.size)) ** 2)
    return light
