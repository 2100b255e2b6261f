"""Background and noise of an image of the night, by tiles."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sunarc.robust_statistics import MAD_TO_SIGMA

Plane = NDArray[np.float32]

_TILE_PX = 32
"""Large beside a star (a dozen px), small beside the gradients of glow and of the Milky Way (hundreds)."""


class Background(NamedTuple):
    """Level and 1-sigma noise of every pixel, counts, each (rows, columns)."""

    level: Plane
    noise: Plane


def background_of(plane: Plane, *, least_noise: float) -> Background:
    """Return the background of an image and its noise, without its stars.

    The median of each tile of 32 px, and the scatter about it by the median absolute deviation from the smooth level,
    both interpolated between the tiles' centres.

    Parameters
    ----------
    plane : (rows, columns) counts.
    least_noise : counts; a flat or clipped patch has no less.
    """
    tiles, shape = _tiles(plane)
    median = _smoothed(np.median(tiles, axis=-1).reshape(shape))
    level = _spread(median, plane)
    deviation, _ = _tiles(np.abs(plane - level))
    noise = MAD_TO_SIGMA * np.median(deviation, axis=-1).reshape(shape)
    return Background(level, np.maximum(_spread(_smoothed(noise), plane), np.float32(least_noise)))


def _tiles(plane: Plane) -> tuple[Plane, tuple[int, int]]:
    """Return the pixels of each tile, (tiles, pixels), and how many tiles there are down and across."""
    rows, columns = (-(-size // _TILE_PX) for size in plane.shape)
    padded = np.pad(
        plane, ((0, rows * _TILE_PX - plane.shape[0]), (0, columns * _TILE_PX - plane.shape[1])), mode="reflect"
    )
    parts = padded.reshape(rows, _TILE_PX, columns, _TILE_PX).swapaxes(1, 2)
    return parts.reshape(rows * columns, -1), (rows, columns)


def _smoothed(grid: Plane) -> Plane:
    """Return a grid of tiles with the median of each tile and its neighbours: a bright star leaves no hill."""
    return np.asarray(cv2.medianBlur(grid.astype(np.float32), 3), dtype=np.float32)


def _spread(grid: Plane, plane: Plane) -> Plane:
    """Return a grid of tiles interpolated to the pixels."""
    rows, columns = grid.shape
    whole = cv2.resize(grid, (columns * _TILE_PX, rows * _TILE_PX), interpolation=cv2.INTER_LINEAR)
    return np.asarray(whole[: plane.shape[0], : plane.shape[1]], dtype=np.float32)
