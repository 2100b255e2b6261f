"""Detections that do not turn with the sky: hot pixels and lamps."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from sunarc.array_types import BoolArray, FloatArray
from sunarc.detection.stars.values import PredictedStars, Stars

LEAST_MOTION_PX = 3.0
"""Of the sky between two images, for which a detection that stays is no star; a star's own centre errs by a tenth."""


def standing_still(first: Stars, second: Stars, *, moved_px: FloatArray) -> BoolArray:
    """Return (n,): which detections of an image stand where another has one, though the sky has turned: no stars.

    Parameters
    ----------
    first, second : detections of two images of one camera.
    moved_px : (n,) by how much the sky moved between them at each detection of the first, px. Where that is less than
        3 px (about the pole), nothing is said.
    """
    if len(first) == 0 or len(second) == 0:
        return np.zeros(len(first), dtype=bool)
    apart = np.asarray(cKDTree(second.pixels).query(first.pixels)[0])
    return np.asarray((apart < 3.0 * np.hypot(first.sigma_px, 0.2)) & (np.asarray(moved_px) > LEAST_MOTION_PX))


def sky_motion(stars: Stars, then: PredictedStars, later: PredictedStars) -> FloatArray:
    """Return by how much the sky moves at each detection, (n,) px, between two predictions: the nearest star's."""
    place = {name: row for row, name in enumerate(later.names)}
    both = np.array([row for row, name in enumerate(then.names) if name in place], dtype=np.int64)
    if both.size == 0 or len(stars) == 0:
        return np.zeros(len(stars))
    shift = later.pixels[[place[name] for name in then.names[both]]] - then.pixels[both]
    nearest = np.asarray(cKDTree(then.pixels[both]).query(stars.pixels)[1])
    return np.asarray(np.linalg.norm(shift, axis=-1)[nearest])
