"""Stars that are clipped so widely that no point spread can be fitted: where they are, roughly."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from sunarc.array_types import BoolArray, FloatArray
from sunarc.detection.stars.background import Plane

_FEWEST_PX = 14
"""Of the clipped pixels and those beside them: a smaller core leaves enough of a star's wings for a fit."""
_LARGEST_PX, _LONGEST = 900, 2.0
"""Of a star; and its longer side over its shorter one. Larger or longer: the moon, a lamp, an aircraft, a roof."""


class ClippedCores(NamedTuple):
    """Clipped regions: centres (n, 2) and radii (n,), px; flux (n,) in them, counts, too low; whether a star's."""

    pixels: FloatArray
    radius: FloatArray
    flux: FloatArray
    like_star: BoolArray


def clipped_cores(light: Plane, clipped: BoolArray, *, usable: BoolArray) -> ClippedCores:
    """Return the clipped regions of an image that are too large for a fit.

    Parameters
    ----------
    light : (rows, columns) counts above the background.
    clipped, usable : (rows, columns) clipped pixels and those beside them; where stars are looked for.
    """
    count, label, box, centre = cv2.connectedComponentsWithStats((clipped & usable).astype(np.uint8), connectivity=8)
    area = box[:, cv2.CC_STAT_AREA].astype(np.float64)
    flux = np.bincount(label.ravel(), weights=light.ravel(), minlength=count)
    sides = box[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].astype(np.float64)
    long = sides.max(axis=-1) / np.maximum(sides.min(axis=-1), 1.0)
    large = area >= _FEWEST_PX
    large[0] = False  # what is not clipped
    return ClippedCores(
        pixels=np.asarray(centre[large], dtype=np.float64),
        radius=np.sqrt(area[large] / math.pi),
        flux=np.asarray(flux[large], dtype=np.float64),
        like_star=((area <= _LARGEST_PX) & (long <= _LONGEST))[large],
    )
