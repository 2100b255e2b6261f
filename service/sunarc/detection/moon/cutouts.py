"""The brightest places of a short exposure of the night, small enough to be kept until the night is over."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from sunarc.array_types import Image
from sunarc.detection.frames import require_photo

_HALF_PX = 24
"""Of a moon of 5 px as much sky as the aureole needs; one of 40 px still has its limb inside."""
_MOST = 4
"""The moon, and lamps that are brighter."""
_BLUR_PX = 1.5
_LEAST_FRACTION = 0.01
"""Of full scale, above the median of the image."""


class Cutout(NamedTuple):
    """A part of an image: its first pixel, and its counts."""

    x: int
    y: int
    image: Image


def brightest_cutouts(image: Image, *, full_scale: int) -> tuple[Cutout, ...]:
    """Return the parts around the brightest places of an image, at most four, the brightest first.

    Parameters
    ----------
    image : (rows, columns) counts, a mosaic too.
    full_scale : its largest count.

    Raises
    ------
    InputError : the array is no image.
    """
    require_photo(image, full_scale=full_scale)
    # a median first: pixels that are stuck at full scale are no lights
    calm = np.asarray(cv2.medianBlur(image, 3), dtype=np.float32)
    smooth = np.asarray(cv2.GaussianBlur(calm, (0, 0), _BLUR_PX), dtype=np.float32)
    smooth -= np.float32(np.median(image[::4, ::4]))
    near = _HALF_PX // 2
    found: list[Cutout] = []
    while len(found) < _MOST:
        row, column = np.unravel_index(int(np.argmax(smooth)), smooth.shape)
        if smooth[row, column] < _LEAST_FRACTION * full_scale:
            break
        # even first pixels: the mosaic begins with the same colour
        top, left = (max(int(at) - _HALF_PX, 0) & ~1 for at in (row, column))
        found.append(Cutout(left, top, image[top : row + _HALF_PX + 1, left : column + _HALF_PX + 1].copy()))
        smooth[max(row - near, 0) : row + near, max(column - near, 0) : column + near] = 0.0
    return tuple(found)


def cutout_around(cutouts: tuple[Cutout, ...], x_px: float, y_px: float, *, within_px: float) -> Cutout | None:
    """Return the cutout whose middle lies nearest to a pixel; None where none is as near as `within_px`."""
    distances = [
        math.hypot(one.x + one.image.shape[1] / 2 - x_px, one.y + one.image.shape[0] / 2 - y_px) for one in cutouts
    ]
    distance, nearest = min(zip(distances, cutouts, strict=True), key=lambda pair: pair[0], default=(math.inf, None))
    return nearest if distance <= within_px + _HALF_PX else None
