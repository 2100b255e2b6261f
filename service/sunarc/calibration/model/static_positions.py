"""Positions that stay where they are while the sun moves: text overlays, reflections at the dome, hot pixels.

How far the sun moved decides, and not how often a position comes again: at a high cadence and with whole pixels the sun
itself stays on one pixel for a minute. All sightings of one day within 3 x 3 px are looked at together. A sun that is
seen there has moved by the 3 px only, 0.3 to 2 degrees with any all-sky camera of more than 300 px.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np

from sunarc.array_types import BoolArray, FloatArray, IntArray

_FEWEST = 8
"""Sightings at one position that can show that it stands still; fewer are left to the robust loss."""
_STILL_DEG = 2.5
"""Median angle between the sun and its middle direction above which a position does not follow it: 10 degrees of an
even motion, 40 minutes. At the edge of an orthographic image of 600 px, where 3 px are most of the sky, it is 2."""
_NEIGHBOURS = tuple(itertools.product((-1, 0, 1), repeat=2))
_LARGEST_PX = 2.0**20
"""Cells further out than this are cut to it; no image is as large."""


class StaticPosition(NamedTuple):
    """A position that does not move: its middle in px, and how many sightings lie there."""

    x: float
    y: float
    n: int


def static_sightings(pixels: FloatArray, directions: FloatArray, group: IntArray) -> BoolArray:
    """Return (n,): which sightings lie at positions that do not move with the sun.

    Parameters
    ----------
    pixels : (n, 2) px.
    directions : (n, 3) unit vectors to the sun.
    group : (n,) whole numbers from 0; sightings of one group are of one day and pose.
    """
    cell = np.floor(np.clip(pixels, -_LARGEST_PX, _LARGEST_PX)).astype(np.int64) + int(_LARGEST_PX) + 1
    width = int(2 * _LARGEST_PX + 4)
    key = (group * width + cell[:, 0]) * width + cell[:, 1]
    cells, member = np.unique(key, return_inverse=True)
    count = np.bincount(member, minlength=cells.size)
    sums = np.stack([np.bincount(member, weights=directions[:, i], minlength=cells.size) for i in range(3)], axis=-1)
    around, total = np.zeros(cells.size, dtype=np.int64), np.zeros((cells.size, 3))
    for offset in _NEIGHBOURS:
        index, present = _index_of(cells, cells + offset[0] * width + offset[1])
        around += np.where(present, count[index], 0)
        total += np.where(present[:, None], sums[index], 0.0)
    mean_cosine = np.linalg.norm(total, axis=-1) / np.maximum(around, 1)
    # the mean of unit vectors is short where they differ: cheap enough for every cell
    suspect = np.flatnonzero((around >= _FEWEST) & (mean_cosine < math.cos(math.radians(_STILL_DEG))))
    static = np.zeros(pixels.shape[0], dtype=bool)
    for one in suspect:
        near = [
            p
            for p, present in (_index_of(cells, cells[one : one + 1] + a * width + b) for a, b in _NEIGHBOURS)
            if present
        ]
        rows = np.flatnonzero(np.isin(member, np.concatenate(near)))
        static[rows] |= _stands_still(directions[rows])
    return static


def static_positions(pixels: FloatArray, static: BoolArray) -> tuple[StaticPosition, ...]:
    """Return the positions of static sightings, the most frequent one first; those within 3 px are one."""
    remaining, found = pixels[static], []
    while remaining.size:
        _, member, count = np.unique(np.floor(remaining), axis=0, return_inverse=True, return_counts=True)
        middle = np.median(remaining[member.ravel() == np.argmax(count)], axis=0)
        near = np.max(np.abs(remaining - middle), axis=-1) <= 3.0
        found.append(StaticPosition(float(middle[0]), float(middle[1]), int(near.sum())))
        remaining = remaining[~near]
    return tuple(sorted(found, key=lambda one: -one.n))


def _index_of(cells: IntArray, queried: IntArray) -> tuple[IntArray, BoolArray]:
    """Return where the wanted cells stand among the sorted ones, and whether they do."""
    index = np.minimum(np.searchsorted(cells, queried), cells.size - 1)
    return index, cells[index] == queried


def _stands_still(directions: FloatArray) -> bool:
    """Return whether most of the directions lie far from their middle: a few false sightings do not make it so."""
    middle = np.median(directions, axis=0)
    middle = middle / max(float(np.linalg.norm(middle)), 1e-9)
    return float(np.median(directions @ middle)) < math.cos(math.radians(_STILL_DEG))
