"""Small planes with a saturated sun in its glare, for the tests of the parts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SUN = (151.3, 128.6)
"""Where the sun is in an exposure of a stack, px."""


def glare_image(
    x: float = 100.0, y: float = 90.0, *, radius: float = 9.0, size: int = 200, seed: int = 0
) -> NDArray[np.uint16]:
    """Return a linear mono image of 12 bits: a saturated blob in its own glare."""
    rows, columns = np.mgrid[:size, :size]
    far = np.hypot(columns - x, rows - y)
    light = 0.08 + 0.85 / (1.0 + (far / (3.0 * radius)) ** 2) + np.where(far < radius, 1.0, 0.0)
    light = light + np.random.default_rng(seed).normal(0.0, 0.003, light.shape)
    return np.asarray(np.clip(light * 4095.0, 0, 4095)).astype(np.uint16)


def with_text(image: NDArray[np.uint16], *, level: int = 4095) -> NDArray[np.uint16]:
    """Return the image with a line of text (strokes of 2 px) and a painted box of 24 × 12 px in a corner."""
    drawn = image.copy()
    drawn[4:24:6, 6:60] = level
    drawn[5:25:6, 6:60] = level
    drawn[180:192, 10:34] = level
    return drawn


def exposed(exposure: float, *, slope: float = 0.0, disc_px: float = 3.0, seed: int = 0) -> NDArray[np.uint8]:
    """Return an image of 8 bits with a tone curve: disc, glare, sky with a slope across."""
    rows, columns = np.mgrid[:300, :300]
    far = np.hypot(columns - SUN[0], rows - SUN[1])
    disc = 400.0 / (1.0 + np.exp(np.clip((far - disc_px) / 0.4, -50.0, 50.0)))
    sky = 0.05 * (1.0 + slope * (columns - SUN[0]) / 100.0)
    light = exposure * (disc + 8.0 / (1.0 + (far / 6.0) ** 2) + 0.5 / (1.0 + far / 40.0) + np.clip(sky, 0.0, None))
    light += np.random.default_rng(seed).normal(0.0, 0.002, light.shape)
    return np.asarray(np.round(255.0 * np.clip(light, 0.0, 1.0) ** (1 / 2.2)), dtype=np.uint8)
