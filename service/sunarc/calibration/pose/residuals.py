"""Sightings as a posing takes them: their noise, and neighbours taken together so that there are not too many."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sunarc.array_types import BoolArray, FloatArray, Rows, picked
from sunarc.calibration.least_squares.problem import Observations
from sunarc.calibration.least_squares.time_bins import Bins
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.robust_loss import finite
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project_fast

MOST = 80
"""Sightings, or means of neighbours, that are looked at together."""
_UNKNOWN_SIGMA_PX = 0.5
_SMALLEST_SIGMA_PX = 0.005
_LARGEST_INFLATION = 25.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PredictedSightings:
    """Where the sun was, and where it was seen, in the order of time.

    Attributes
    ----------
    directions, pixels : (n, 3), (n, 2) px.
    variance : (n,) of each axis of a true sighting, px².
    false_density : (n,) logarithm of how likely a false one is to be there, px⁻².
    """

    directions: FloatArray
    pixels: FloatArray
    variance: FloatArray
    false_density: FloatArray

    def select(self, which: Rows) -> PredictedSightings:
        """Return those that a slice, an index or a mask picks."""
        return picked(self, which)


def noise_px(start: Calibration, sigma_px: FloatArray) -> FloatArray:
    """Return (n,): 1-sigma per axis of sightings, never below what the calibration's own came to."""
    fit_sigma_px = start.evidence.sigma_px
    usual = fit_sigma_px if math.isfinite(fit_sigma_px) and fit_sigma_px > 0.0 else _UNKNOWN_SIGMA_PX
    estimated_sigma_px = np.where(np.isfinite(sigma_px) & (sigma_px > 0.0), sigma_px, usual)
    return np.maximum(estimated_sigma_px, max(usual, _SMALLEST_SIGMA_PX))


def inflation(start: Calibration) -> float:
    """Return by how much a sighting's variance grows because its neighbours err alike."""
    found = start.evidence.inflation
    return min(max(found, 1.0), _LARGEST_INFLATION) if math.isfinite(found) else 1.0


def gathered(
    camera: Camera, sightings: PredictedSightings, inlier: BoolArray, *, inflation: float
) -> PredictedSightings:
    """Return the inliers, neighbours averaged so that there are not too many."""
    true = sightings.select(np.flatnonzero(inlier))
    # rounded up, so that no more than MOST groups remain
    each = -(-true.variance.size // MOST)
    member = np.arange(true.variance.size) // max(each, 1)
    bins = Bins(member=member, count=int(member[-1]) + 1 if member.size else 0)
    observed = Observations(
        directions=true.directions, pixels=true.pixels, information=1.0 / true.variance, epoch=0 * member
    )
    residual = finite(true.pixels - project_fast(camera, true.directions))
    one, mean = bins.gathered(observed, residual, observed.information)
    pixels = project_fast(camera, one.directions) + mean
    density = np.zeros(bins.count)
    return PredictedSightings(
        directions=one.directions, pixels=pixels, variance=inflation / one.information, false_density=density
    )
