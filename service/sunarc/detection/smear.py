"""The vertical smear of an interline CCD: a bright sun adds the same light to every row of its columns."""

from __future__ import annotations

import numpy as np

from sunarc.detection.values import FloatArray, Image

_STEP = 8  # even, so that a Bayer mosaic's rows stay apart
_MEDIAN_NOISE = 1.2533
_SIGNIFICANT = 5.0


def column_smear(image: Image, *, x0: int, x1: int, y0: int, y1: int) -> FloatArray:
    """Return the smear in a window, judged from the rows beyond it.

    Parameters
    ----------
    image : (rows, columns) counts.
    x0, x1, y0, y1 : the window, ends exclusive.

    Returns
    -------
    (y1 - y0, x1 - x0) counts, lowest column 0; all 0 where no column stands out of its noise, so that a sensor without
    smear loses nothing.
    """
    profiles = np.stack([_profile(image[parity::_STEP, x0:x1], y0, y1, parity) for parity in (0, 1)])
    return profiles[np.arange(y0, y1) % 2]


def _profile(sampled: Image, y0: int, y1: int, parity: int) -> FloatArray:
    rows = parity + _STEP * np.arange(sampled.shape[0])
    beyond = sampled[(rows < y0) | (rows >= y1)].astype(np.float64)
    if beyond.shape[0] < 2 * _STEP or beyond.shape[1] == 0:
        return np.zeros(sampled.shape[1])
    level = np.median(beyond, axis=0)
    spread = 1.4826 * float(np.median(np.abs(beyond - level)))
    excess = level - float(np.min(level))
    noise = _MEDIAN_NOISE * max(spread, 0.3) / np.sqrt(beyond.shape[0])
    if float(np.max(excess)) < _SIGNIFICANT * noise:
        return np.zeros(sampled.shape[1])
    return np.asarray(excess)
