"""An independent renderer of microsecond frames: supersampled disc, filtered, binned, and read out."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Image = NDArray[np.uint8] | NDArray[np.uint16]

FULL_WELL_E = 20_000.0
READ_NOISE_E = 12.0
ALPHA_PX = 601.32
SOLAR_RADIUS = math.radians(0.2666)


def equisolid_stretch(
    *, zenith_deg: float = 40.0, azimuth_deg: float = 30.0, alpha_px: float = ALPHA_PX
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return px per radian of an equisolid lens: radially by r'(theta), tangentially by r / sin(theta)."""
    theta, phi = math.radians(zenith_deg), math.radians(azimuth_deg)
    radial, tangential = alpha_px * math.cos(theta / 2), 2 * alpha_px * math.sin(theta / 2) / math.sin(theta)
    turn = np.array([[math.cos(phi), -math.sin(phi)], [math.sin(phi), math.cos(phi)]])
    matrix = turn @ np.diag([radial, tangential])
    return (float(matrix[0, 0]), float(matrix[0, 1])), (float(matrix[1, 0]), float(matrix[1, 1]))


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A sun (or none) on a small sensor; levels as fractions of full scale."""

    shape: tuple[int, int] = (48, 48)
    x: float = 24.0
    y: float = 24.0
    stretch: tuple[tuple[float, float], tuple[float, float]] = ((565.0, 0.0), (0.0, 640.0))
    peak: float = 0.7
    psf_px: float = 0.7
    limb: float = 0.6
    background: float = 0.002
    slope_per_px: tuple[float, float] = (0.0, 0.0)
    bits: int = 12
    black: float = 0.0
    bayer: str | None = None
    colours: tuple[float, float, float] = (0.6, 1.0, 0.7)
    over: int = 9


def disc_image(scene: Scene, cover: FloatArray | None = None) -> FloatArray:
    """Return the noiseless light of the disc, of unit central brightness, in full scales of `peak` 1."""
    half, over = 12, scene.over
    cx, cy = round(scene.x), round(scene.y)
    steps = (np.arange((2 * half + 1) * over) - ((2 * half + 1) * over - 1) / 2) / over
    gx, gy = np.meshgrid(steps - (scene.x - cx), steps - (scene.y - cy))
    inverse = np.linalg.inv(np.array(scene.stretch) * SOLAR_RADIUS)
    u, v = inverse[0, 0] * gx + inverse[0, 1] * gy, inverse[1, 0] * gx + inverse[1, 1] * gy
    square = u * u + v * v
    edge = np.hypot(*np.einsum("ij,i...->j...", inverse, np.stack([u, v]))) / np.maximum(np.sqrt(square), 1e-9) / over
    share = np.clip((1 - np.sqrt(square)) / np.maximum(edge, 1e-9) + 0.5, 0, 1)
    fine = share * (1 - scene.limb * (1 - np.sqrt(np.clip(1 - square, 0, 1))))
    if cover is not None:
        fine = fine * cover_on(cover, u, v)
    taps, width = 2 * math.ceil(8 * scene.psf_px * over) + 1, scene.psf_px * over
    fine = np.asarray(cv2.GaussianBlur(fine, (taps, taps), width, borderType=cv2.BORDER_CONSTANT), dtype=np.float64)
    small = fine.reshape(2 * half + 1, over, 2 * half + 1, over).mean(axis=(1, 3))
    image = np.zeros((scene.shape[0] + 2 * half, scene.shape[1] + 2 * half))
    image[cy : cy + 2 * half + 1, cx : cx + 2 * half + 1] = small
    return image[half:-half, half:-half]


def cover_on(cover: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
    """Transmission of an edge (nx, ny, offset, width, floor) in units of the disc's radius."""
    nx, ny, offset, width, floor = (float(value) for value in cover)
    along = nx * u + ny * v - offset
    return floor + (1 - floor) / (1 + np.exp(np.clip(along / max(width, 1e-3), -50, 50)))


def read_out(light: FloatArray, scene: Scene, rng: np.random.Generator) -> Image:
    """Turn light in full scales into counts: colours, photons, read noise, rounding, clipping."""
    full = 2**scene.bits - 1
    if scene.bayer is not None:
        light = light * mosaic_gains(scene)
    electrons = rng.poisson(np.clip(light, 0, None) * FULL_WELL_E) + rng.normal(0, READ_NOISE_E, light.shape)
    counts = np.rint(electrons * full / FULL_WELL_E + scene.black)
    clipped = np.asarray(np.clip(counts, 0, full))
    return clipped.astype(np.uint8) if scene.bits == 8 else clipped.astype(np.uint16)


def mosaic_gains(scene: Scene) -> FloatArray:
    gains = np.zeros(scene.shape)
    assert scene.bayer is not None
    for index, letter in enumerate(scene.bayer):
        gains[index // 2 :: 2, index % 2 :: 2] = scene.colours["RGB".index(letter)]
    return gains


def render(scene: Scene, rng: np.random.Generator, cover: FloatArray | None = None) -> Image:
    """Return one frame of the scene."""
    rows, columns = np.mgrid[: scene.shape[0], : scene.shape[1]]
    background = (
        scene.background + scene.slope_per_px[0] * (columns - scene.x) + scene.slope_per_px[1] * (rows - scene.y)
    )
    return read_out(scene.peak * disc_image(scene, cover) + np.clip(background, 0, None), scene, rng)
