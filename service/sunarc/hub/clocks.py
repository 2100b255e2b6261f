"""The clocks of a group of cameras from the lags of cloud edges between them.

On a day a cloud edge reaches camera k by s · r_k later, with r_k its place and s the clouds' slowness (the inverse of
their speed, along their course), which is not known. Three cameras and fewer cannot tell a day's slowness from
clocks; days of different winds can, as far as the prevailing wind averages out, and four cameras and more add to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from sunarc.common.array_types import FloatArray
from sunarc.common.robust_statistics import MAD_TO_SIGMA

DAILY_SLOWNESS_S_PER_M = 0.1
"""1-sigma of a component of a day's slowness about the season's mean: clouds at 10 m/s."""
MEAN_SLOWNESS_S_PER_M = 0.05
"""1-sigma of a component of the season's mean: prevailing winds."""
_RIGHT_S, _UNKNOWN_S = 0.1, 1e4
"""1-sigma of a clock beforehand, s: one that follows a time server, and one of which nothing is known."""
_COHERENCE = 0.1
"""1-sigma of the change of clouds on their way, over the time that they take for it at the daily slowness."""
_OUTLYING = 4.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Lag:
    """On one day, by how many seconds later edges came at the second camera, each by the camera's own clock."""

    day: int
    first: int
    second: int
    lag_s: float
    sigma_s: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClockOffsets:
    """Offsets of the cameras' clocks, where the clocks of the others are right.

    Attributes
    ----------
    offset_s, sigma_s : (c,); NaN for a camera without lags.
    n_lags : that were used.
    """

    offset_s: FloatArray
    sigma_s: FloatArray
    n_lags: int


def clock_offsets(lags: Sequence[Lag], *, east_north_m: FloatArray) -> ClockOffsets:
    """Return the clocks of cameras that stand at places (c, 2), metres east and north, by generalised least squares.

    Each camera's is asked for by itself: clocks that are wrong in proportion to their places are a wind. Of several
    that are off, the one of the most sigmas is the wrong one. A lag that stands off from those of its pair on other
    days, as one of another cloud does, is left out.
    """
    count = len(east_north_m)
    used = [lag for pair in combinations(range(count), 2) for lag in _select_consistent(lags, pair)]
    offset, sigma = np.full(count, np.nan), np.full(count, np.nan)
    for camera in sorted({number for lag in used for number in (lag.first, lag.second)}):
        mean, covariance = _compute_posterior(used, east_north_m, camera)
        offset[camera], sigma[camera] = mean[camera], np.sqrt(covariance[camera, camera])
    return ClockOffsets(offset_s=offset, sigma_s=sigma, n_lags=len(used))


def _select_consistent(lags: Sequence[Lag], pair: tuple[int, int]) -> list[Lag]:
    """Return the lags of a pair that are near their median."""
    own = [lag for lag in lags if (lag.first, lag.second) == pair]
    if not own:
        return []
    off = np.array([lag.lag_s for lag in own])
    off = np.abs(off - np.median(off))
    limit = _OUTLYING * max(MAD_TO_SIGMA * float(np.median(off)), *(lag.sigma_s for lag in own))
    return [lag for lag, one in zip(own, off, strict=True) if one <= limit]


def _compute_posterior(lags: Sequence[Lag], places: FloatArray, camera: int) -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance of the clocks, one of them unknown, of the season's slowness and of the days'."""
    count = len(places)
    days = sorted({lag.day for lag in lags})
    design, noise = np.zeros((len(lags), count + 2 + 2 * len(days))), np.zeros(len(lags))
    for row, lag in enumerate(lags):
        apart = places[lag.second] - places[lag.first]
        first = count + 2 + 2 * days.index(lag.day)
        design[row, [lag.first, lag.second]] = -1.0, 1.0
        design[row, count : count + 2] = design[row, first : first + 2] = apart
        noise[row] = np.hypot(lag.sigma_s, _COHERENCE * DAILY_SLOWNESS_S_PER_M * np.linalg.norm(apart))
    prior = np.full(design.shape[1], DAILY_SLOWNESS_S_PER_M)
    prior[:count], prior[camera], prior[count : count + 2] = _RIGHT_S, _UNKNOWN_S, MEAN_SLOWNESS_S_PER_M
    # the pairs of c cameras are c (c - 1) / 2, but a camera's own noise is in c - 1 of them
    cameras = len({number for lag in lags for number in (lag.first, lag.second)})
    weight = 1.0 / (noise**2 * max(cameras / 2.0, 1.0))
    covariance = np.linalg.inv(design.T @ (weight[:, None] * design) + np.diag(prior**-2.0))
    mean = covariance @ design.T @ (weight * np.array([lag.lag_s for lag in lags]))
    return mean, np.asarray(covariance, dtype=np.float64)
