"""The vertical smear of an interline CCD: a bright sun adds the same light to every row of its columns."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sunarc.array_types import FloatArray, Image
from sunarc.robust_statistics import mad_sigma

_STEP, _FINE_STEP = 32, 8  # rows looked at first, and where smear shows; even: a Bayer mosaic's rows stay apart
_FEWEST_ROWS = 8
_MEDIAN_NOISE = 1.2533
_SIGNIFICANT = 5.0


def column_smear(image: Image, *, x0: int, x1: int, y0: int, y1: int, mosaic: bool) -> FloatArray:
    """Return the smear in a window, judged from the rows beyond it.

    Parameters
    ----------
    image : (rows, columns) counts.
    x0, x1, y0, y1 : the window, ends exclusive.
    mosaic : whether even and odd rows have different colours.

    Returns
    -------
    (y1 - y0, x1 - x0) counts, lowest column 0; all 0 where no column stands out of its noise, so that a sensor without
    smear loses nothing.
    """
    profiles = np.zeros((2, x1 - x0))
    for parity in range(2 if mosaic else 1):
        rows = _rows_beyond(image.shape[0], parity, y0, y1)
        for step in (_STEP, _FINE_STEP):
            profile = _profile(image[rows[:: step // _FINE_STEP], x0:x1])
            if not profile.any():
                break
        profiles[parity] = profile
    return profiles[np.arange(y0, y1) % 2 * mosaic]


def _rows_beyond(height: int, parity: int, y0: int, y1: int) -> NDArray[np.intp]:
    rows = np.arange(parity, height, _FINE_STEP)
    return rows[(rows < y0) | (rows >= y1)]


def _profile(beyond: Image) -> FloatArray:
    """Return what each column of some rows has in excess; zeros where it is noise."""
    nothing = np.zeros(beyond.shape[1])
    if beyond.shape[0] < _FEWEST_ROWS or beyond.shape[1] == 0:
        return nothing
    ordered, half = np.sort(beyond, axis=0), len(beyond) // 2
    level = 0.5 * (ordered[half].astype(np.float64) + ordered[half - 1 + len(beyond) % 2])
    # The window's darkest column stands for the sky: smear is never negative.
    excess = level - level.min()
    spread = mad_sigma(beyond - level)
    noise = _MEDIAN_NOISE * max(spread, 0.3) / math.sqrt(beyond.shape[0])
    return excess if float(excess.max()) >= _SIGNIFICANT * noise else nothing
