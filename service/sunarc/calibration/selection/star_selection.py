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


def surest_of_epochs(
    pixels: FloatArray, sigma_px: FloatArray, epoch: IntArray, image_size: tuple[int, int]
) -> IntArray:
    """Return rows of the stars that a fit uses, in their order: those of the latest epoch first, then of the others.

    Parameters
    ----------
    pixels : (n, 2) px, of stars and planets.
    sigma_px : (n,) px.
    epoch : (n,) pose epochs, by number.
    image_size : width and height, px.
    """
    chosen = np.zeros(0, dtype=np.int64)
    for one in np.unique(epoch)[::-1]:
        rows = np.flatnonzero(epoch == one)
        part = image_parts(pixels[rows], image_size)
        chosen = np.concatenate([chosen, rows[surest_of_parts(part, sigma_px[rows], MOST_STARS - chosen.size)]])
    return np.sort(chosen)
