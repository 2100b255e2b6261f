"""Errors of sightings as the paper's Table 1 measures them: clear days, and days with clouds."""

from __future__ import annotations

import math
from itertools import accumulate

import numpy as np

from sunarc.array_types import BoolArray, FloatArray

SD_OF_DISTANCE = math.sqrt(2.0 - math.pi / 2.0)
"""Standard deviation of the 2-D distance of round Gaussian errors of 1 px per axis (Rayleigh's): the paper's SD."""

_CLOUD_FRAMES = 12
_CORRELATION = 0.7
_HEAVY_TAIL = 3
_LONGEST_PX = 50.0


def clear_noise(rng: np.random.Generator, n: int, *, sd_px: float) -> FloatArray:
    """Draw independent Gaussian errors, (n, 2), whose distances have the standard deviation `sd_px`."""
    return rng.normal(0.0, sd_px / SD_OF_DISTANCE, (n, 2))


def cloud_noise(rng: np.random.Generator, n: int, *, inlier_px: float, share: float, sd_px: float) -> FloatArray:
    """Draw errors with episodes of cloud, (n, 2).

    Parameters
    ----------
    inlier_px : 1-sigma per axis between the clouds.
    share : share of the sightings in episodes, whose errors are correlated, heavy-tailed (Student's t3) and at most
        50 px long in each axis.
    sd_px : standard deviation of all distances that the episodes' size is chosen for.
    """
    inlier = rng.normal(0.0, inlier_px, (n, 2))
    covered = _episodes(rng, n, share)
    shock = rng.standard_t(_HEAVY_TAIL, (n, 2)) * math.sqrt(1.0 - _CORRELATION**2)
    episode = np.array(list(accumulate(shock, lambda before, step: _CORRELATION * before + step)))

    def drawn(size: float) -> FloatArray:
        return np.where(covered[:, None], np.clip(size * episode, -_LONGEST_PX, _LONGEST_PX), inlier)

    def too_wide(size: float) -> float:
        return float(np.std(np.linalg.norm(drawn(size), axis=-1))) - sd_px

    from scipy.optimize import brentq  # noqa: PLC0415 - the service starts sooner without it

    return drawn(float(brentq(too_wide, 1e-3, 1e3)))


def _episodes(rng: np.random.Generator, n: int, share: float) -> BoolArray:
    covered = np.zeros(n, dtype=bool)
    while covered.mean() < share:
        begin, length = rng.integers(n), rng.geometric(1.0 / _CLOUD_FRAMES)
        covered[begin : begin + length] = True
    return covered
