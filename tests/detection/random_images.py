"""Random images, constant ones, noise, crops, scales and bit depths, for detectors that must answer about any image."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[Any]
_KINDS = ("crop", "crop", "crop", "constant", "noise", "gradient", "points", "plateau")


def random_images(count: int, *, seed: int, photographs: Sequence[Image] = ()) -> Iterator[Image]:
    """Yield images (rows, columns) or (rows, columns, 3) of 8 or 16 bits, from 1 x 1 px on.

    Parameters
    ----------
    count, seed : how many, and of which sequence.
    photographs : 8-bit images of which crops are taken; without them points of light are.
    """
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield _with_depth(_random_plane(rng, photographs), rng)


def _random_plane(rng: np.random.Generator, photographs: Sequence[Image]) -> NDArray[np.float64]:
    """Return counts from 0 to 255."""
    kind = str(rng.choice(_KINDS))
    rows, columns = (int(size) for size in np.exp(rng.uniform(0.0, np.log(500.0), 2)))
    if kind == "crop" and photographs:
        whole = photographs[int(rng.integers(len(photographs)))]
        top, left = (int(rng.integers(size)) for size in whole.shape[:2])
        part = whole[top : top + rows, left : left + columns].astype(np.float64)
        scale = float(np.exp(rng.uniform(np.log(0.2), np.log(3.0))))
        size = max(1, round(part.shape[1] * scale)), max(1, round(part.shape[0] * scale))
        return np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA), dtype=np.float64)
    shape = (rows, columns, 3) if rng.uniform() < 0.5 else (rows, columns)
    if kind == "constant":
        return np.full(shape, rng.choice([0.0, 1.0, 127.0, 254.0, 255.0]))
    if kind == "noise":
        return rng.normal(rng.uniform(0.0, 255.0), rng.uniform(0.0, 100.0), shape)
    if kind == "gradient":
        return np.broadcast_to(np.linspace(0.0, 255.0, columns).reshape(1, -1, *([1] * (len(shape) - 2))), shape)
    plane = rng.normal(30.0, 3.0, shape)
    y, x = np.mgrid[:rows, :columns]
    for _ in range(int(rng.integers(1, 80)) if kind == "points" else 1):
        row, column = rng.uniform(0.0, rows), rng.uniform(0.0, columns)
        width = rng.uniform(0.5, 2.0) if kind == "points" else rng.uniform(2.0, 60.0)
        bell = rng.uniform(20.0, 600.0) * np.exp(-((y - row) ** 2 + (x - column) ** 2) / (2.0 * width**2))
        plane += bell if plane.ndim == 2 else bell[..., None]
    return plane


def _with_depth(plane: NDArray[np.float64], rng: np.random.Generator) -> Image:
    bits = int(rng.choice([1, 4, 8, 10, 12, 16]))
    counts = np.clip(np.rint(plane / 255.0 * (2**bits - 1)), 0, 2**bits - 1)
    image: Image = counts.astype(np.uint8 if bits <= 8 else np.uint16)
    if image.ndim == 3 and rng.uniform() < 0.3:
        image = np.ascontiguousarray(image[..., 0])
    return image
