"""Small planes with a saturated sun in its glare, for the tests of the parts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


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
