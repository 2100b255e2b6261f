"""Images of stars whose centres are known: Gaussians integrated over pixels, sky, shot and read noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

FloatArray = NDArray[np.float64]

GAIN_E, READ_E, SKY, BLACK = 5.0, 3.0, 40.0, 20.0
"""Electrons per count; electrons; counts of the sky, and of black."""
FULL_SCALE = 4095


def spread_places(rng: np.random.Generator, size: int, step: int = 32) -> FloatArray:
    """Return places (n, 2), one in each cell of a grid, anywhere in its middle half."""
    first = np.arange(step / 2, size - step / 2 + 1, step)
    x, y = np.meshgrid(first, first)
    grid = np.stack([x.ravel(), y.ravel()], axis=-1)
    return np.asarray(grid + rng.uniform(-step / 4, step / 4, grid.shape))


def expected(places: FloatArray, electrons: FloatArray, *, size: int, width: float) -> FloatArray:
    """Return the electrons that each pixel receives on average, (size, size), without the sky."""
    image = np.zeros((size, size))
    for (x, y), flux in zip(places, electrons, strict=True):
        reach = int(np.ceil(6.0 * width)) + 1
        columns = np.arange(max(round(x) - reach, 0), min(round(x) + reach + 1, size))
        rows = np.arange(max(round(y) - reach, 0), min(round(y) + reach + 1, size))
        across, down = (
            ndtr((part + 0.5 - at) / width) - ndtr((part - 0.5 - at) / width) for part, at in ((columns, x), (rows, y))
        )
        image[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] += flux * down[:, None] * across
    return image


def counted(rng: np.random.Generator, light: FloatArray) -> NDArray[np.uint16]:
    """Return what a 12-bit camera counts of electrons, with the sky's."""
    sky = SKY * GAIN_E * (1.0 + 0.5 * np.linspace(0.0, 1.0, light.shape[1]))
    counts = rng.poisson(light + sky) / GAIN_E + rng.normal(BLACK, READ_E / GAIN_E, light.shape)
    return np.clip(np.round(counts), 0, FULL_SCALE).astype(np.uint16)
