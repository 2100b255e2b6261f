"""A moon rendered by brute force: points of a sphere in sunlight on a fine grid, blurred there, binned, read out."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

FloatArray = NDArray[np.float64]
OVER = 15
WELL_E, READ_E = 20_000.0, 12.0
MARIA = (
    (-57.0, 18.0, 24.0), (-16.0, 33.0, 19.0), (17.0, 28.0, 11.0), (31.0, 9.0, 14.0), (59.0, 17.0, 8.0),
    (51.0, -8.0, 12.0), (-16.0, -20.0, 11.0), (-39.0, -24.0, 7.0), (35.0, -15.0, 5.0), (-24.0, 0.0, 12.0),
)  # fmt: skip
"""Longitude, latitude and radius of the large seas, degrees; they are about half as bright as the highlands."""


@dataclass(frozen=True, kw_only=True)
class Moon:
    """A moon on a small sensor."""

    phase_deg: float = 90.0
    limb_deg: float = 20.0
    radius_px: float = 2.7
    stretch: tuple[float, float] = (1.0, 1.0)
    x: float = 24.3
    y: float = 23.6
    side: int = 48
    peak: float = 0.5
    law: str = "mixed"
    seas: float = 0.45
    north_deg: float = 30.0
    psf_px: float = 0.8
    wings: float = 0.15
    halo: float = 0.0
    halo_px: float = 6.0
    cloud: float = 0.0
    background: float = 0.001
    bits: int = 12
    bayer: str | None = None

    @property
    def edges(self) -> FloatArray:
        a = math.radians(self.limb_deg)
        turn = np.array([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]])
        return np.asarray(np.diag(self.stretch) @ turn * self.radius_px)

    @property
    def centroid_px(self) -> FloatArray:
        """Where the middle of the light lies, (2,) px."""
        light, size = fine_light(self), (2 * half(self) + 1) * OVER
        line = (np.arange(size) - (size - 1) / 2) / OVER
        middle = np.array([light.sum(0) @ line, light.sum(1) @ line]) / light.sum()
        return np.asarray(middle + np.array([round(self.x), round(self.y)]))


def half(moon: Moon) -> int:
    return math.ceil(moon.radius_px * max(moon.stretch) + 12)


def fine_light(moon: Moon) -> FloatArray:
    """Return the light of the sphere on the fine grid, with the sensor's phase."""
    count = (2 * half(moon) + 1) * OVER
    line = (np.arange(count) - (count - 1) / 2) / OVER
    gx, gy = np.meshgrid(line - (moon.x - round(moon.x)), line - (moon.y - round(moon.y)))
    inverse = np.linalg.inv(moon.edges)
    u, v = inverse[0, 0] * gx + inverse[0, 1] * gy, inverse[1, 0] * gx + inverse[1, 1] * gy
    inside = u * u + v * v < 1.0
    w = np.sqrt(np.clip(1.0 - u * u - v * v, 0.0, 1.0))
    i = math.radians(moon.phase_deg)
    sun = u * math.sin(i) + w * math.cos(i)
    lit = inside & (sun > 0.0)
    seeliger, lambert = sun / np.maximum(sun + w, 1e-9), sun
    share = {"seeliger": 0.0, "lambert": 1.0, "mixed": 0.4}[moon.law]
    turn = math.radians(moon.north_deg)
    east, north = u * math.cos(turn) + v * math.sin(turn), -u * math.sin(turn) + v * math.cos(turn)
    dark = np.zeros_like(u)
    for longitude, latitude, size in MARIA:
        up, along = math.radians(latitude), math.radians(longitude)
        middle = np.array([math.cos(up) * math.sin(along), math.sin(up), math.cos(up) * math.cos(along)])
        cosine = east * middle[0] + north * middle[1] + w * middle[2]
        dark = np.maximum(dark, 1.0 / (1.0 + np.exp((np.arccos(np.clip(cosine, -1, 1)) - math.radians(size)) / 0.05)))
    albedo = 1.0 - moon.seas * dark
    return np.where(lit, ((1 - share) * 2 * seeliger + share * lambert) * albedo, 0.0)


def point_spread(moon: Moon) -> FloatArray:
    """Return a Gaussian with wider wings and a little astigmatism, on the fine grid."""
    reach = 8 * OVER
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1] / OVER
    core = np.exp(-0.5 * ((x / (1.1 * moon.psf_px)) ** 2 + (y / (0.92 * moon.psf_px)) ** 2))
    wing = (1 + (x * x + y * y) / (2.0 * moon.psf_px) ** 2) ** -2.5
    kernel = (1 - moon.wings) * core / core.sum() + moon.wings * wing / wing.sum()
    return np.asarray(kernel)


def render(moon: Moon, *, noise: bool = True, seed: int = 0) -> NDArray[np.uint16]:
    light = fine_light(moon)
    size = 2 * half(moon) + 1
    if moon.cloud > 0.0:  # the edge of a cloud over a part of the disc
        line = np.arange(light.shape[1]) / OVER - size / 2
        light = light * (1 - moon.cloud / (1 + np.exp(-(line[None, :] + line[:, None]) / 1.0)))
    blurred = fftconvolve(light, point_spread(moon), mode="same")
    small = blurred.reshape(size, OVER, size, OVER).mean(axis=(1, 3))
    image = np.zeros((moon.side + 2 * half(moon),) * 2)
    cx, cy = round(moon.x), round(moon.y)
    image[cy : cy + size, cx : cx + size] = small
    edge = half(moon)
    image = image[edge:-edge, edge:-edge]
    image = image / max(image.max(), 1e-9) * moon.peak
    if moon.halo > 0.0:  # light scattered by a thin cloud about the light of the moon
        reach = 2 * moon.side
        y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
        kernel = (1 + (x * x + y * y) / moon.halo_px**2) ** -1.5
        image = image + moon.halo * moon.peak * (scattered := fftconvolve(image, kernel, mode="same")) / scattered.max()
    image = image + moon.background
    if moon.bayer is not None:
        rows, columns = np.indices(image.shape)
        gains = {"R": 0.6, "G": 1.0, "B": 0.7}
        image = image * np.array([gains[one] for one in moon.bayer])[2 * (rows % 2) + columns % 2]
    full = 2**moon.bits - 1
    electrons = image * WELL_E
    if noise:
        rng = np.random.default_rng(seed)
        electrons = rng.poisson(electrons) + rng.normal(0.0, READ_E, electrons.shape)
    return np.asarray(np.clip(np.round(electrons / WELL_E * full), 0, full).astype(np.uint16))
