"""Bright spots of an image, without knowing where: hot pixels are passed over, every tile has its say."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sunarc.detection.values import FloatArray, Image

_TILE = 64


class Spot(NamedTuple):
    """A bright spot.

    x, y : centre, px. level : counts of its core. background : counts around it.
    axes : (2, 2) symmetric, px: the stretch of the uniform disc that has the same second moments.
    """

    x: float
    y: float
    level: float
    background: float
    axes: FloatArray

    @property
    def contrast(self) -> float:
        """Counts above the surroundings."""
        return self.level - self.background

    @property
    def semi_axes(self) -> tuple[float, float]:
        """Minor and major semi-axis of the spot, px."""
        minor, major = np.linalg.eigvalsh(self.axes)
        return float(minor), float(major)


@njit(cache=True, nogil=True)
def _tile_maxima(image: Image, tile: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the largest minimum over 2×2 pixels of every tile, and its flat index; a lone hot pixel never counts."""
    height, width = image.shape
    down, across = (height + tile - 1) // tile, (width + tile - 1) // tile
    best, where = np.full(down * across, -1, np.int64), np.zeros(down * across, np.int64)
    least = np.zeros(across * tile, image.dtype)
    for y in range(0, height - 1, 2):
        upper, lower = image[y], image[y + 1]
        for x in range(width - 1):
            least[x] = min(upper[x], upper[x + 1], lower[x], lower[x + 1])
        for tile_x in range(across):
            row = least[tile_x * tile : (tile_x + 1) * tile]
            top = row[0]
            for value in row:
                top = max(top, value)
            k = (y // tile) * across + tile_x
            if top > best[k]:
                best[k] = top
                where[k] = y * width + tile_x * tile + np.argmax(row)
    return best, where


def brightest_spots(image: Image, *, count: int, reach: int, floor: float) -> list[Spot]:
    """Return up to `count` bright spots, brightest core first.

    Parameters
    ----------
    image : (rows, columns) counts.
    count : how many at most.
    reach : half the window, px, in which a spot is measured.
    floor : counts that its core must exceed.
    """
    if min(image.shape) < 8:
        return []
    best, where = _tile_maxima(image, _TILE)
    spots: list[Spot] = []
    for k in np.argsort(best, kind="stable")[::-1]:
        if len(spots) >= count or best[k] <= floor:
            break
        y, x = divmod(int(where[k]), image.shape[1])
        if not _belongs(x, y, spots):
            spot = measure_spot(image, x=x, y=y, reach=reach)
            if not _belongs(spot.x, spot.y, spots):
                spots.append(spot)
    return spots


def _belongs(x: float, y: float, spots: list[Spot]) -> bool:
    return any(math.hypot(spot.x - x, spot.y - y) < 4.0 + 2.0 * spot.semi_axes[1] for spot in spots)


def measure_spot(image: Image, *, x: int, y: int, reach: int) -> Spot:
    """Measure the spot at a pixel by what exceeds half its level, the window moved onto it once."""
    for last in (False, True):
        x0, y0 = max(0, min(x - reach, image.shape[1] - 2)), max(0, min(y - reach, image.shape[0] - 2))
        part = image[y0 : y + reach + 2, x0 : x + reach + 2].astype(np.float64)
        mean = 0.25 * (part[:-1, :-1] + part[1:, :-1] + part[:-1, 1:] + part[1:, 1:])
        spot = _moments(mean, x0=x0 + 0.5, y0=y0 + 0.5)
        if last or math.hypot(spot.x - x, spot.y - y) < 0.3 * reach:
            break
        x, y = round(spot.x), round(spot.y)
    return spot


def _moments(mean: FloatArray, *, x0: float, y0: float) -> Spot:
    level = float(mean.max())
    edge = np.concatenate([mean[0], mean[-1], mean[:, 0], mean[:, -1]])
    background = float(np.median(edge))
    above = mean - 0.5 * (level + background)
    rows, columns = np.nonzero(above > 0.0)
    if rows.size == 0:
        rows, columns = np.array([mean.shape[0] // 2]), np.array([mean.shape[1] // 2])
        above = np.ones_like(mean)
    weight = above[rows, columns]
    total = float(weight.sum())
    x, y = float(weight @ columns) / total, float(weight @ rows) / total
    dx, dy = columns - x, rows - y
    covariance = np.array([[np.mean(dx * dx), np.mean(dx * dy)], [np.mean(dx * dy), np.mean(dy * dy)]])
    return Spot(x + x0, y + y0, level, background, symmetric_root(4.0 * covariance + 1e-3 * np.eye(2)))


def symmetric_root(matrix: FloatArray) -> FloatArray:
    """Return the symmetric square root of a positive (2, 2) matrix."""
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 1e-9))) @ vectors.T)
