"""Stars as detected, and as predicted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sunarc.array_types import BoolArray, FloatArray, IntArray, NameArray, picked

FWHM = 2.355
"""Full width at half maximum of a Gaussian, in its sigmas: 2 sqrt(2 ln 2)."""
MOST_PEAK = 0.9
"""Share of full scale: a star with a brighter peak may be clipped in part, and many sensors are not linear there."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stars:
    """Point sources of one image, the brightest first.

    Attributes
    ----------
    pixels : (n, 2) centres, px; (0, 0) is the centre of the top-left pixel.
    sigma_px : (n,) 1-sigma per axis.
    flux : (n,) counts above the background.
    snr : (n,) flux over its standard deviation.
    peak_fraction : (n,) the brightest pixel over full scale, with the background.
    width_px : (n,) 1-sigma of the point spread, geometric mean of its axes: the star's own where it is bright enough
        (20 times the noise), else that of its place in the image.
    ellipticity : (n,) 1 - minor / major axis, likewise.
    saturated : (n,) whether pixels of it were clipped; such a centre is pulled along the coma by up to half a pixel.
    """

    pixels: FloatArray
    sigma_px: FloatArray
    flux: FloatArray
    snr: FloatArray
    peak_fraction: FloatArray
    width_px: FloatArray
    ellipticity: FloatArray
    saturated: BoolArray

    def __len__(self) -> int:
        return int(self.flux.size)

    @property
    def sound(self) -> BoolArray:
        """Which are neither clipped nor near full scale, (n,)."""
        return np.asarray(~self.saturated & (self.peak_fraction < MOST_PEAK))

    def select(self, which: BoolArray | IntArray) -> Stars:
        """Return those that a mask or an index picks."""
        return picked(self, which)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PredictedStars:
    """Where the stars above the horizon should be in an image, the brightest first.

    Attributes
    ----------
    names : (n,).
    pixels : (n, 2) px; those outside the image are left out before.
    sigma_px : (n,) 1-sigma per axis of the prediction.
    magnitude : (n,) V with the air's extinction.
    azimuth_deg : (n,).
    """

    names: NameArray
    pixels: FloatArray
    sigma_px: FloatArray
    magnitude: FloatArray
    azimuth_deg: FloatArray

    def __len__(self) -> int:
        return int(self.magnitude.size)

    def select(self, which: BoolArray | IntArray) -> PredictedStars:
        """Return those that a mask or an index picks."""
        return picked(self, which)
