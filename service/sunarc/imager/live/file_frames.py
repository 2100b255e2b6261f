"""Images of files as frames of a camera."""

from __future__ import annotations

import numpy as np

from sunarc.common.array_types import Image
from sunarc.common.utc import utc_time
from sunarc.imager.cameras.frame import Frame
from sunarc.sources.detect_files import estimated_full_scale

_UNSTATED_US = 1e6
"""Exposure of a file that states none: a second, so that the night's zero point is that of one exposure."""


def make_file_frame(image: Image, unix_s: float, exposure_us: float | None, number: int) -> Frame:
    """Return an image of a file as a frame of a camera.

    Parameters
    ----------
    image : pixels, of 8 or 16 bits.
    unix_s, exposure_us : when it was taken, and for how long; None where that is not stated.
    number : among those of the night.
    """
    return Frame(
        image=image,
        time=utc_time(unix_s),
        exposure_us=exposure_us or _UNSTATED_US,
        gain_db=0.0,
        pixel_format="Mono8" if image.dtype == np.uint8 else "Mono16",
        full_scale=estimated_full_scale(image),
        frame_id=number,
    )
