"""How many of the predicted stars are detected: by zenith angle, and to which magnitude."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from sunarc.array_types import BoolArray, FloatArray
from sunarc.detection.stars.values import PredictedStars, Stars

ZENITH_BANDS_DEG = (0.0, 30.0, 50.0, 65.0, 78.0)
"""Limits of zenith angle: to 1.15, 1.55, 2.35 and 4.7 air masses; below 78 degrees are haze and trees."""
_SIGMAS, _SEEING_PX = 3.0, 0.5
"""How near to its predicted place a star's detection lies: 1-sigma of the centres beside the prediction's, px."""
_STEP_V, _ROLL_OFF_V = 0.05, 0.25
"""Of the magnitudes tried, and how soft the end is: from 0.88 to 0.12 of the stars within a magnitude."""
_BRIGHTEST_V = 1.0
_SHARES = np.linspace(0.05, 0.995, 64)
_FEWEST = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class ZenithBand:
    """Predicted stars of a band of zenith angles, and those that are detected.

    Attributes
    ----------
    from_deg, to_deg : zenith angles.
    predicted, found : counts.
    """

    from_deg: float
    to_deg: float
    predicted: int
    found: int


def detected(stars: Stars, predicted: PredictedStars) -> BoolArray:
    """Return (n,) which of the predicted stars have a detection at their place, within 3 sigma."""
    if len(stars) == 0:
        return np.zeros(len(predicted), dtype=np.bool_)
    distance = np.asarray(cKDTree(stars.pixels).query(predicted.pixels)[0])
    return np.asarray(distance < _SIGMAS * np.hypot(predicted.sigma_px, _SEEING_PX))


def zenith_bands(zenith_deg: FloatArray, found: BoolArray) -> tuple[ZenithBand, ...]:
    """Return how many of the predicted stars are detected by bands of zenith angle, (n,) degrees."""
    limits = itertools.pairwise(ZENITH_BANDS_DEG)
    within = [(begin, end, (zenith_deg >= begin) & (zenith_deg < end)) for begin, end in limits]
    return tuple(
        ZenithBand(
            from_deg=begin, to_deg=end, predicted=int(np.count_nonzero(row)), found=int(np.count_nonzero(found[row]))
        )
        for begin, end, row in within
    )


def limiting_magnitude(magnitude: FloatArray, found: BoolArray) -> float:
    """Return the V at which half as many stars are detected as of the bright ones; NaN of fewer than 20 stars.

    The most probable end of a detection probability that falls from a constant share (the sky that is free of cloud) to
    0 as a logistic function of the magnitude. It is never beyond the faintest star given.

    Parameters
    ----------
    magnitude : (n,) V of the predicted stars, with the air's extinction.
    found : (n,) which are detected.
    """
    if magnitude.size < _FEWEST or not np.any(found):
        return math.nan
    faintest = float(magnitude.max())
    ends = np.arange(_BRIGHTEST_V, max(faintest, _BRIGHTEST_V) + _STEP_V / 2.0, _STEP_V)
    fall = 1.0 / (1.0 + np.exp(np.clip((magnitude[None] - ends[:, None]) / _ROLL_OFF_V, -40.0, 40.0)))
    missed = [np.sum(np.log1p(-share * fall[:, ~found]), axis=-1) for share in _SHARES]
    hit = [np.sum(np.log(share * fall[:, found] + 1e-12), axis=-1) for share in _SHARES]
    likelihood = np.max(np.array(missed) + np.array(hit), axis=0)
    return min(float(ends[int(np.argmax(likelihood))]), faintest)
