"""Which sightings of stars a fit uses: a few of each part of the image, the surest ones."""

from __future__ import annotations

import numpy as np

from sunarc.array_types import FloatArray, IntArray

MOST_STARS = 150
"""Stars that a fit uses. Beside a day of the sun they tell what thousands do (docs/studies.md, "The night"); with
thousands the fit takes the lens's unmodelled field for noise, and states far too little."""
_SECTORS, _RINGS = 12, 4


def image_parts(pixels: FloatArray, image_size: tuple[int, int]) -> IntArray:
    """Return (n,) in which of 48 parts of equal area about the middle of an image pixels (n, 2) are."""
    middle = 0.5 * (np.array(image_size) - 1.0)
    across, down = ((pixels - middle) / (0.5 * min(image_size))).T
    return _parts(np.arctan2(down, across), across**2 + down**2)


def sky_parts(directions: FloatArray) -> IntArray:
    """Return (n,) in which of 48 parts of equal area of the sky directions (n, 3) are."""
    east, north, up = directions.T
    return _parts(np.arctan2(east, north), 1.0 - up)


def _parts(angle: FloatArray, area: FloatArray) -> IntArray:
    """Return the number of sector and ring of angles, rad, and of the share of the area within, 0 to 1."""
    sector = np.floor((angle / (2.0 * np.pi) % 1.0) * _SECTORS).astype(np.int64) % _SECTORS
    return np.asarray(_RINGS * sector + np.clip(np.floor(_RINGS * area), 0, _RINGS - 1).astype(np.int64))


def surest_of_parts(part: IntArray, sigma_px: FloatArray, most: int) -> IntArray:
    """Return rows of at most so many sightings, in their order: the surest of each part (n,), then the next ones."""
    order = np.lexsort((sigma_px, part))
    first = np.searchsorted(part[order], part[order])
    rank = np.arange(order.size) - first
    return np.sort(order[np.lexsort((sigma_px[order], rank))[:most]])
