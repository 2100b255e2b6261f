"""The sigma of sightings in image files, learned from how far they are from a calibration."""

from __future__ import annotations

import numpy as np

from sunarc.archive import Archive
from sunarc.array_types import FloatArray
from sunarc.calibration import Calibration
from sunarc.calibration.robust_loss import robust_sigma
from sunarc.optics import project
from sunarc.settings import Settings
from sunarc.sky import sun_directions

_LEAST_SIGHTINGS = 20
_LARGEST_FACTOR = 5.0
"""A factor beyond is no detector's error: the calibration or the detector is wrong."""
_AS_STATED = 1.15
"""By so much the scatter may exceed what is stated before the stated sigma is changed: about 2 sigma of what 50
sightings tell of it."""


def learn_sigma(archive: Archive, settings: Settings, calibration: Calibration) -> dict[str, float]:
    """Enlarge the stated sigma of each method's image sightings to their scatter about a calibration.

    It is never made smaller: the scatter is that of the good ones; those at clouds, contrails and haze scatter more.

    Returns
    -------
    By what factor the sigma of each method was multiplied; methods whose sigma was enough are not in it.
    """
    factors = {}
    for method in archive.methods_of_files(settings.name):
        columns = archive.sun_point_columns(settings.name, method=method, of_files=True)
        directions = sun_directions(columns.unix_s, settings.site)
        residual = columns.pixels - project(calibration.camera, directions)
        factor = sigma_factor(residual, columns.sigma_px)
        if factor is not None:
            archive.scale_sigma(settings.name, method=method, factor=factor)
            factors[method] = factor
    return factors


def sigma_factor(residual: FloatArray, sigma_px: FloatArray) -> float | None:
    """Return by what a stated sigma has to be multiplied to be the scatter of the inliers; None where it is enough.

    Parameters
    ----------
    residual : (n, 2) px; NaN where the camera does not see the direction.
    sigma_px : (n,) stated 1-sigma per axis; NaN where not known.
    """
    ratio = np.hypot(residual[:, 0], residual[:, 1]) / sigma_px
    ratio = ratio[np.isfinite(ratio)]
    if ratio.size < _LEAST_SIGHTINGS:
        return None
    factor = robust_sigma(ratio)
    return factor if _AS_STATED < factor <= _LARGEST_FACTOR else None
