"""What stands still in a series of images: text overlays, logos, painted marks."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np

from sunarc.array_types import BoolArray, Image
from sunarc.detection.photo.plateau import faintest_colour
from sunarc.errors import InputError

_BRIGHT = 0.5  # of full scale: what is darker is no plateau beside a sun
_STILL = 0.06  # of full scale: JPEG's own changes from image to image
_MARGIN = 0.006  # of the smaller side: the width of a digit, for those that change beside those that do not
_LEAST_IMAGES = 3


def static_mask(images: Iterable[Image], *, full_scale: int) -> BoolArray | None:
    """Return where a bright level stands still in a series, (rows, columns); None where the series cannot tell.

    Parameters
    ----------
    images : of one camera, (rows, columns) or (rows, columns, 3), in one size, full or reduced; three at least, over
        hours: the sun must have left every place that it saturates (it moves by 15 degrees in an hour, and its glare
        may be 20 degrees wide).
    full_scale : their largest count.

    Raises
    ------
    InputError : images of several sizes.
    """
    lowest: Image | None = None
    highest: Image | None = None
    count = 0
    for image in images:
        plane = faintest_colour(image)
        if lowest is None or highest is None:
            lowest, highest = plane.copy(), plane.copy()
        elif plane.shape != lowest.shape:
            raise InputError(
                field="images", problem=f"sizes {lowest.shape} and {plane.shape}", remedy="give images of one size"
            )
        else:
            np.minimum(lowest, plane, out=lowest)
            np.maximum(highest, plane, out=highest)
        count += 1
    if lowest is None or highest is None or count < _LEAST_IMAGES:
        return None
    still = (lowest >= _BRIGHT * full_scale) & (highest - lowest <= _STILL * full_scale)
    size = 2 * max(1, round(_MARGIN * min(lowest.shape))) + 1
    grown = cv2.dilate(still.astype(np.uint8), np.ones((size, size), np.uint8))
    return np.asarray(grown, dtype=np.bool_)
