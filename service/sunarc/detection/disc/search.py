"""Search for bright spots in a whole image; single hot pixels are ignored."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray, Image
from sunarc.jit import njit
from sunarc.robust_statistics import median_of

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
        return semi_axes(self.axes)


@njit(nogil=True)
def _tile_maxima(image: Image, tile: int) -> Image:
    """Return the largest minimum over 2×2 pixels of every tile, (tiles down, across); a lone hot pixel never counts."""
    height, width = image.shape
    down, across = (height + tile - 1) // tile, (width + tile - 1) // tile
    best, top = np.zeros((down, across), image.dtype), np.zeros(across * tile, image.dtype)
    for row in range(down):
        for x in range(top.size):
            top[x] = 0
        for y in range(row * tile, min((row + 1) * tile, height - 1), 2):
            upper, lower = image[y], image[y + 1]
            # Two rows at a time: of a core of three by three pixels one 2×2 block is always whole.
            for x in range(width - 1):
                left, right = min(upper[x], lower[x]), min(upper[x + 1], lower[x + 1])
                top[x] = max(top[x], min(left, right))
        for column in range(across):
            for x in range(column * tile, (column + 1) * tile):
                best[row, column] = max(best[row, column], top[x])
    return best


def _top_of(image: Image, *, x0: int, y0: int) -> tuple[int, int]:
    """Return x, y of the first pixel of a tile's largest minimum over 2×2 pixels."""
    part = image[y0 : y0 + _TILE, x0 : x0 + _TILE + 1]
    pair = np.minimum(part[: part.shape[0] // 2 * 2 : 2], part[1::2])
    y, x = divmod(int(np.argmax(np.minimum(pair[:, :-1], pair[:, 1:]))), pair.shape[1] - 1)
    return x0 + x, y0 + 2 * y


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
    best = _tile_maxima(image, _TILE)
    levels = best.ravel()
    spots: list[Spot] = []
    for k in np.argsort(levels, kind="stable")[::-1]:
        if len(spots) >= count or levels[k] <= floor:
            break
        row, column = divmod(int(k), best.shape[1])
        x, y = _top_of(image, x0=column * _TILE, y0=row * _TILE)
        if not _belongs(x, y, spots):
            spot = measure_spot(image, x=x, y=y, reach=reach)
            if not _belongs(spot.x, spot.y, spots):
                spots.append(spot)
    return spots


def _belongs(x: float, y: float, spots: list[Spot]) -> bool:
    return any(math.hypot(spot.x - x, spot.y - y) < 4.0 + 2.0 * spot.semi_axes[1] for spot in spots)


def measure_spot(image: Image, *, x: int, y: int, reach: int) -> Spot:
    """Measure the spot at a pixel by what exceeds half its level, the window moved onto it once."""
    # A spot at the window's edge is cut: its centroid is pulled inward, so that the window is moved once.
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
    background = median_of(np.concatenate([mean[0], mean[-1], mean[:, 0], mean[:, -1]]))
    x, y, xx, xy, yy = _moments_above(mean, 0.5 * (level + background))
    covariance = np.array([[xx, xy], [xy, yy]])
    return Spot(x + x0, y + y0, level, background, symmetric_root(4.0 * covariance + 1e-3 * np.eye(2)))


@njit(nogil=True)
def _moments_above(mean: FloatArray, cut: float) -> tuple[float, float, float, float, float]:
    """Return the centre of what exceeds a level, weighted by it, and about that the unweighted second moments."""
    height, width = mean.shape
    total, x, y = 0.0, 0.0, 0.0
    for j in range(height):
        for i in range(width):
            weight = max(mean[j, i] - cut, 0.0)
            total, x, y = total + weight, x + weight * i, y + weight * j
    if total <= 0.0:
        return width // 2, height // 2, 0.0, 0.0, 0.0
    x, y = x / total, y / total
    count, xx, xy, yy = 0, 0.0, 0.0, 0.0
    for j in range(height):
        for i in range(width):
            if mean[j, i] > cut:
                count, dx, dy = count + 1, i - x, j - y
                xx, xy, yy = xx + dx * dx, xy + dx * dy, yy + dy * dy
    return x, y, xx / count, xy / count, yy / count


def semi_axes(stretch: FloatArray) -> tuple[float, float]:
    """Return minor and major semi-axis of the ellipse to which a symmetric (2, 2) matrix takes the unit disc."""
    a, b, d = float(stretch[0, 0]), float(stretch[0, 1]), float(stretch[1, 1])
    middle, half = abs(0.5 * (a + d)), math.hypot(0.5 * (a - d), b)
    return abs(middle - half), middle + half


def symmetric_root(matrix: FloatArray) -> FloatArray:
    """Return the symmetric square root of a positive (2, 2) matrix (by Cayley and Hamilton's theorem)."""
    a, b, d = float(matrix[0, 0]), float(matrix[0, 1]), float(matrix[1, 1])
    root = math.sqrt(max(a * d - b * b, 0.0))
    trace = math.sqrt(max(a + d + 2.0 * root, 1e-9))
    return np.array([[a + root, b], [b, d + root]]) / trace
