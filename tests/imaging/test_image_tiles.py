"""Whether an image has noise: as its definition says, in little memory, of left-aligned counts and raw mosaics too."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from numpy.typing import NDArray

from sunarc.common.array_types import Image
from sunarc.imaging.image_tiles import image_tiles

ROWS, COLUMNS = np.mgrid[0:192, 0:210].astype(np.float64)
SKY = 90.0 + 0.21 * COLUMNS + 0.13 * ROWS + 8.0 * np.sin(ROWS / 40.0)
COLOURS = np.stack([SKY, 0.7 * SKY, 0.5 * SKY], axis=-1)


def has_noise_by_definition(image: Image) -> bool:
    """Return the same of the whole image at once, in double precision."""
    full = 255.0 if image.dtype == np.uint8 else float(image.max())
    values = image[::2].reshape(len(image[::2]), image.shape[1], -1).astype(np.float64)
    bent = np.abs(np.diff(values, n=2, axis=1)) >= 2.0
    bent[:, [(at + 1) % 8 in {0, 7} for at in range(bent.shape[1])]] = False
    inner = values[:, 1:-1]
    mid = (inner > 0.02 * full) & (inner < 0.98 * full)
    rough, seen = [], 0
    for row in range(len(mid) // 16):
        for column in range(mid.shape[1] // 16):
            tile = (slice(16 * row, 16 * row + 16), slice(16 * column, 16 * column + 16))
            seen += 1
            if mid[tile].mean() > 0.5:
                rough.append((bent & mid)[tile].mean())
    return bool(rough) and len(rough) >= 0.5 * seen and bool(np.quantile(rough, 0.25) >= 0.02)


def counted(values: NDArray[np.float64], noise: float, seed: int, dtype: type = np.uint8, *, step: int = 1) -> Image:
    noisy = values + np.random.default_rng(seed).normal(0.0, 1.0, values.shape) * noise
    image: Image = (np.clip(np.round(noisy), 0, 255) * step).astype(dtype)
    return image


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("scene", [SKY, COLOURS], ids=["grey", "colours"])
def test_noise_is_found_as_by_definition(scene: NDArray[np.float64], dtype: type) -> None:
    images = [counted(scene, noise, seed, dtype) for seed, noise in enumerate(np.linspace(0.05, 0.3, 40))]
    for image in images[::4]:
        image[:40, :100] = 0
        image[150:, 100:] = 255
    found = [image_tiles(image).has_noise for image in images]
    assert found == [has_noise_by_definition(image) for image in images]
    assert 8 <= sum(found) <= 32


@pytest.mark.parametrize("shape", [(2000, 3000), (1200, 1600, 3)])
def test_a_large_image_takes_less_memory_than_three_of_its_size(shape: tuple[int, ...]) -> None:
    image = np.random.default_rng(1).integers(900, 1100, shape).astype(np.uint16)
    tracemalloc.start()
    try:
        assert image_tiles(image).has_noise
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 3 * image.nbytes


@pytest.mark.parametrize("saturated", [False, True])
def test_left_aligned_counts_are_rough_by_noise_alone(*, saturated: bool) -> None:
    """12 bits in 16: a smooth image goes up by steps of 16 counts."""
    smooth, noisy = (counted(SKY, noise, 2, np.uint16, step=16) for noise in (0.0, 1.5))
    if saturated:
        smooth[:20, :20] = noisy[:20, :20] = 0xFFFF
    assert not image_tiles(smooth).has_noise
    assert image_tiles(noisy).has_noise


def test_a_raw_mosaic_is_rough_by_noise_alone() -> None:
    mosaic = SKY * np.where((ROWS + COLUMNS) % 2, 1.3, np.where(ROWS % 2, 0.7, 0.4))
    assert not image_tiles(counted(mosaic, 0.0, 3)).has_noise
    assert image_tiles(counted(mosaic, 1.5, 3)).has_noise
    assert not image_tiles(counted(16.0 * mosaic, 0.0, 3, np.uint16)).has_noise


@pytest.mark.parametrize("shape", [(1, 1), (3, 2), (15, 40), (40, 3, 3)])
def test_an_image_smaller_than_a_tile_has_no_noise(shape: tuple[int, ...]) -> None:
    assert not image_tiles(np.full(shape, 100, np.uint8)).has_noise
