"""Faults of the way from the sensor that look like cloud: rows that repeat, and bits that do not change."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sunarc.common.array_types import Image
from sunarc.imaging.levels import full_scale, level_step, levels, mid_tones

_FEWEST_ROWS, _ROWS_SHARE = 16, 0.05
"""Rows, and share of an image's rows: equal rows of a wall or of text are fewer. Chosen, not measured."""
_LEAST_STRUCTURE = 0.125
"""Of the pixels of a row that are mid-tones other than their neighbours: a mast before a white sky has few."""
_FEWEST_LEVELS = 6
"""A drawn or overexposed image has fewer."""
_COARSEST_STEPS = 32
"""Levels of 5 bits; images of fewer are named."""
_LEAST_RANGE = 0.25
"""Of the full scale, between the darkest and the brightest level: a uniform image has few levels without a fault."""


def repeated_rows(image: Image) -> int:
    """Return how many rows of an image one below the other are the same, where each has structure; 0 for few.

    Parameters
    ----------
    image : (rows, columns) or (rows, columns, channels), in counts.
    """
    values = image.reshape(len(image), -1)
    channels = 1 if image.ndim == 2 else image.shape[2]
    same = np.zeros(len(values), np.bool_)
    same[1:] = np.all(values[1:] == values[:-1], axis=1)
    if not same.any():
        return 0
    low, high = mid_tones(image)
    alike = values[same]
    mid = (alike[:, channels:] > low) & (alike[:, channels:] < high)
    same[same] = np.mean(mid & (alike[:, channels:] != alike[:, :-channels]), axis=1) >= _LEAST_STRUCTURE
    longest = _length_of_longest_run(same)
    return longest + 1 if longest >= max(_FEWEST_ROWS, _ROWS_SHARE * len(values)) else 0


def count_missing_levels(image: Image) -> int:
    """Return the number of levels of an image's full scale, where its steps are 32 or fewer; 0 for a sound image.

    Parameters
    ----------
    image : in counts.
    """
    if image.dtype.kind not in "ui" or image.size == 0:
        return 0
    full, counts = full_scale(image), levels(image)
    if len(counts) < _FEWEST_LEVELS or float(counts[-1]) - float(counts[0]) < _LEAST_RANGE * full:
        return 0
    steps = round(full / level_step(counts))
    return steps + 1 if steps <= _COARSEST_STEPS else 0


def _length_of_longest_run(marked: NDArray[np.bool_]) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]]).astype(np.int8)))
    return int(np.max(edges[1::2] - edges[::2], initial=0))
