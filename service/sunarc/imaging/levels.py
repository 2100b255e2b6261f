"""The levels of an image's counts: its full scale, its mid-tones, and the step between neighbouring levels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sunarc.common.array_types import Image

MID_TONES = (0.02, 0.98)
"""Bounds as shares of the full scale: darker is black level and text, brighter saturates."""
_STRIP_ROWS = 64
"""Rows that are converted at a time: NumPy's indices take 8 bytes each."""


def full_scale(image: Image) -> float:
    """Return the brightest count that an image can have: 255 of 8 bits, the brightest that is there of others."""
    return 255.0 if image.dtype == np.uint8 else max(float(image.max(initial=0)), 1.0)


def mid_tones(image: Image) -> tuple[float, float]:
    """Return the counts between which an image's mid-tones are."""
    full = full_scale(image)
    return MID_TONES[0] * full, MID_TONES[1] * full


def levels(image: Image) -> NDArray[np.integer]:
    """Return the counts that an image of integers has, each once, in ascending order."""
    if image.dtype.kind != "u" or image.dtype.itemsize > 2:
        return np.unique(image)
    there = np.zeros(1 << 8 * image.dtype.itemsize, np.bool_)
    for first in range(0, len(image), _STRIP_ROWS):
        there[image[first : first + _STRIP_ROWS]] = True
    return np.flatnonzero(there)


def level_step(counts: NDArray[np.integer]) -> int:
    """Return the greatest common divisor of the steps between levels, in counts; 0 of fewer than two levels.

    Of 12 bits left-aligned in 16 it is 16.
    """
    return int(np.gcd.reduce(np.diff(counts.astype(np.int64)))) if len(counts) > 1 else 0
