"""Frames without a sun: night, overcast, hot pixels, bright cloud edges, the moon.

    python -m tests.detection.sunless --frames 10000

looks at so many, each with a prediction and without, and prints how many of each kind were accepted.
"""

from __future__ import annotations

import argparse
import math
import sys

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from tests.detection.rendering import FloatArray, Image, Scene, disc_image, equisolid_stretch, read_out

from sunarc.detection.disc.detect import detect_sun
from sunarc.detection.values import Expectation, Sensor

KINDS = ("night", "overcast", "hot", "cloud_edge", "glint_blobs", "moon", "long_moon")
SUN_PER_US = 3.0  # full scales of a bare camera
MOON_SHARE = 2.5e-6  # of the sun's brightness: a full moon, 400 000 times fainter


def exposure_us_of(kind: str, rng: np.random.Generator) -> float:
    """Return an exposure as the controller may choose it; "long_moon": of milliseconds to seconds, which it may not."""
    return float(10.0 ** (rng.uniform(3.0, 6.3) if kind == "long_moon" else rng.uniform(0.0, 3.0)))


def sunless(kind: str, rng: np.random.Generator, *, exposure_us: float = 30.0, size: int = 128) -> Image:
    """Return a frame of a kind, drawn at random; the exposure matters to the moon only, the others are of any level."""
    scene = Scene(shape=(size, size), bits=int(rng.choice([8, 12])))
    light = np.full((size, size), rng.uniform(0.0, 0.01))
    if kind in {"overcast", "cloud_edge"}:
        light = light + _clouds(rng, size, sharp=kind == "cloud_edge")
    if kind == "glint_blobs":
        for _ in range(3):
            light = light + _blob(rng, size)
    if kind in {"moon", "long_moon"}:
        light = light + SUN_PER_US * MOON_SHARE * exposure_us * _moon(rng, size)
    image = read_out(light, scene, rng)
    return _with_hot_pixels(image, scene, rng) if kind in {"hot", "night", "cloud_edge", "moon"} else image


def _clouds(rng: np.random.Generator, size: int, *, sharp: bool) -> FloatArray:
    texture = gaussian_filter(rng.normal(size=(size, size)), rng.uniform(2.0, 12.0), mode="wrap")
    texture /= texture.std()
    level = 10.0 ** rng.uniform(-2.0, 0.3)
    if sharp:
        islands = (texture > rng.uniform(0.0, 2.0)).astype(float)
        return np.asarray(level * gaussian_filter(islands, rng.uniform(0.3, 2.0)))
    return np.asarray(level * np.clip(1.0 + 0.3 * texture, 0.0, None))


def _blob(rng: np.random.Generator, size: int) -> FloatArray:
    rows, columns = np.mgrid[:size, :size]
    x, y = rng.uniform(10, size - 10, 2)
    wide, narrow, angle = rng.uniform(2.5, 15.0), rng.uniform(0.2, 1.0), rng.uniform(0, math.pi)
    u = (columns - x) * math.cos(angle) + (rows - y) * math.sin(angle)
    v = (rows - y) * math.cos(angle) - (columns - x) * math.sin(angle)
    return np.asarray(10.0 ** rng.uniform(-2, 1) * np.exp(-0.5 * ((u / wide) ** 2 + (v / (narrow * wide)) ** 2)))


def _moon(rng: np.random.Generator, size: int) -> FloatArray:
    """Return a moon of unit brightness: no limb darkening, dark maria, any phase up to full, no earthshine."""
    stretch = equisolid_stretch(zenith_deg=rng.uniform(10, 80), azimuth_deg=rng.uniform(0, 360))
    scene = Scene(
        shape=(size, size), x=rng.uniform(30, size - 30), y=rng.uniform(30, size - 30), stretch=stretch, limb=0.0
    )
    angle = rng.uniform(0, 2 * math.pi)
    cover = np.array([math.cos(angle), math.sin(angle), rng.uniform(-1.0, 1.3), 0.03, 0.0])
    maria = 1.0 - 0.4 * gaussian_filter((rng.random((size, size)) > 0.5).astype(float), 1.0)
    return np.asarray(disc_image(scene, cover) * maria)


def _with_hot_pixels(image: Image, scene: Scene, rng: np.random.Generator) -> Image:
    hot: NDArray[np.integer] = rng.integers(0, scene.shape[0], (rng.integers(1, 20), 2))
    out = image.copy()
    for y, x in hot:
        out[y, x] = rng.integers(1, 2**scene.bits)
        if rng.random() < 0.2:
            out[y, min(x + 1, scene.shape[1] - 1)] = rng.integers(1, 2**scene.bits)
    return out


def accepted_of(kind: str, rng: np.random.Generator) -> tuple[bool, bool]:
    """Return whether a frame of a kind was accepted with default options, without a prediction and with one."""
    exposure_us = exposure_us_of(kind, rng)
    image = sunless(kind, rng, exposure_us=exposure_us)
    sensor = Sensor.from_full_well(full_scale=255 if image.dtype == np.uint8 else 4095)
    x, y = rng.uniform(20, 108, 2)
    expected = Expectation(x_px=x, y_px=y, uncertainty_px=3.0, stretch_px_per_rad=equisolid_stretch())
    unasked, asked = (
        detect_sun(image, sensor=sensor, expectation=told, exposure_us=exposure_us).accepted
        for told in (None, expected)
    )
    return unasked, asked


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=700)
    frames, rng = parser.parse_args().frames, np.random.default_rng(20)
    for index, kind in enumerate(KINDS):
        count = len(range(index, frames, len(KINDS)))
        accepted = np.array([accepted_of(kind, rng) for _ in range(count)]).sum(axis=0)
        sys.stdout.write(
            f"{kind:12} {count} frames, accepted {accepted[0]} without a prediction, {accepted[1]} with one\n"
        )


if __name__ == "__main__":
    main()
