"""Positions of clouds that pixels see, by a calibration and the height of the cloud base."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sunarc.calibration.answers.direction_table import Lookup
from sunarc.common.array_types import FloatArray
from sunarc.geolocation.locate import Located, clouds
from sunarc.sky.site import Site

HIGHEST_CLOUD_M = 30_000.0


def cloud_positions(
    ready: Lookup, pixels: FloatArray, *, height_m: FloatArray, height_sigma_m: ArrayLike, site: Site
) -> Located:
    """Return the positions of the clouds that pixels (n, 2) see; NaN elsewhere.

    Parameters
    ----------
    ready : the calibration.
    pixels : (n, 2) px.
    height_m : (n,) of the cloud base above the site's altitude; NaN has no place.
    height_sigma_m : (n,) or one: its 1-sigma.
    site : where the camera stands.
    """
    directions = np.asarray(ready.back_project(np.ascontiguousarray(pixels))[:, 2:5], dtype=np.float64)
    with np.errstate(all="ignore"):  # a direction without a place gives NaN
        covariance = ready.direction_covariance(np.ascontiguousarray(directions))
        return clouds(directions, height_m=height_m, covariance=covariance, site=site, height_sigma_m=height_sigma_m)
