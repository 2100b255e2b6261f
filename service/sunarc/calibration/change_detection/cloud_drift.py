"""Evidence of an episode of cloud: detections that drift away smoothly while camera, clock and lens are as they were.

The drift of each axis is a Gaussian process in time (Matérn, twice differentiable) that begins at one sighting, or a
ramp from zero, as under a cloud edge that passes at a constant speed. A turn of the camera is constant at once; what
cloud does to a detection is not.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from sunarc.array_types import BoolArray, FloatArray, IntArray
from sunarc.calibration.change_detection.residual_model import ResidualModel
from sunarc.calibration.pose.gaussian_conditioning import fit_inlier_mixture, log_evidence

_AMPLITUDES_PX = (0.1, 0.5, 2.0, 8.0)
"""1-sigma of the drift: from what passes for noise to the largest that detectors were seen to follow."""
_TIMES_S = (200.0, 700.0, 2400.0)
"""Correlation times: episodes of a few minutes to an hour."""
_SLOPES_PX_S = (0.0005, 0.002, 0.008)
"""1-sigma of a ramp's slope: 0.5 to 8 px in 1000 s."""
_RAMP_AMPLITUDE_PX, _RAMP_TIME_S = 0.5, 2400.0
"""What a ramp may differ from a straight line by; it also takes up a begin between two sightings."""
_ONSETS_BACK = (0, 2, 6, 14)
"""Sightings before the change at which the episode may have begun; a slow one is trusted at first."""


class Drift(NamedTuple):
    """A drift: its first sighting, amplitude (px) and correlation time (s), and the slope (px/s) of a ramp, 1-sigma."""

    begin: int
    amplitude_px: float
    time_s: float
    slope_px_s: float = 0.0


def drift_evidence(window: ResidualModel, first: int) -> float:
    """Return the log evidence of the last sightings under an episode of cloud, averaged over its unknown numbers.

    Parameters
    ----------
    window : the sightings.
    first : the first sighting after the change that the episode competes with.
    """
    untrusted = np.flatnonzero(~window.watch.trusted)
    begins = {max(first - back, 0) for back in _ONSETS_BACK}
    # the episode need not begin with the change: the change may count sightings before it as false
    begins |= _begins_of_runs(untrusted) | _begins_of_runs(untrusted[untrusted <= first])
    reached, best, likeliest = [], -math.inf, Drift(first, 0.0, 1.0)
    for drift in _drifts(begins):
        reached.append(log_evidence(_with_drift(window, drift), window.sightings, _inliers(window, drift.begin)))
        if reached[-1] > best:
            best, likeliest = reached[-1], drift
    # the likeliest one once more, with false sightings among the episode's
    inliers = _inliers(window, likeliest.begin)
    among_false = fit_inlier_mixture(_with_drift(window, likeliest), window.sightings, inliers).log_evidence
    return float(logsumexp(reached)) - math.log(len(reached)) + max(among_false - best, 0.0)


def _drifts(begins: Iterable[int]) -> Iterator[Drift]:
    """Yield the drifts that are averaged over, all equally likely."""
    for begin in sorted(begins):
        for amplitude_px, time_s in itertools.product(_AMPLITUDES_PX, _TIMES_S):
            yield Drift(begin, amplitude_px, time_s)
        for slope_px_s in _SLOPES_PX_S:
            yield Drift(begin, _RAMP_AMPLITUDE_PX, _RAMP_TIME_S, slope_px_s)


def _inliers(window: ResidualModel, begin: int) -> BoolArray:
    return np.asarray(window.watch.trusted | (np.arange(len(window.watch)) >= begin))


def _begins_of_runs(rows: IntArray) -> set[int]:
    """Return where the last and the longest run of rows begin; a single row between does not end a run."""
    runs = [run for run in np.split(rows, np.flatnonzero(np.diff(rows) > 2) + 1) if run.size]
    longest = max(map(len, runs), default=0)
    return {int(run[0]) for run in runs if run is runs[-1] or len(run) == longest}


def _with_drift(window: ResidualModel, drift: Drift) -> FloatArray:
    """Return the covariance (2n, 2n) of the sightings' errors with a drift from one of them on, px²."""
    begin, all_times = drift.begin, window.watch.unix_s
    times = all_times[begin:]
    # Matern with nu = 5/2 (Rasmussen and Williams 2006, eq. 4.17)
    lag = math.sqrt(5.0) * np.abs(times[:, None] - times) / drift.time_s
    kernel = drift.amplitude_px**2 * (1.0 + lag + lag**2 / 3.0) * np.exp(-lag)
    # the kernel of a line without intercept (ibid., section 4.2.2), zero at the sighting before the first displaced one
    elapsed = times - all_times[max(begin - 1, 0)]
    kernel += drift.slope_px_s**2 * np.outer(elapsed, elapsed)
    covariance = window.covariance.copy()
    covariance[2 * begin :: 2, 2 * begin :: 2] += kernel
    covariance[2 * begin + 1 :: 2, 2 * begin + 1 :: 2] += kernel
    return covariance
