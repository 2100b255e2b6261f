"""Whether a frame shows nothing at all: a lens cap, a closed dome, a shutter that does not open."""

from __future__ import annotations

import numpy as np

from sunarc.array_types import Image

_BLOCK_PX = 16
"""Side of the blocks whose means are compared: a read noise of 1 % of full scale becomes 0.06 %."""
_FLAT = 0.003
"""Difference of the 2nd and 95th percentile of the means, of full scale, below which there is no sky: the sensors' dark
levels vary by 0.0005; an overcast sky of the simulated imager has 0.017 at 3 ms with the sun at 80 degrees."""
_SPOT = 0.02
"""Excess of the brightest block, of full scale, above which something shines (the sun behind a dense filter)."""
_PEDESTAL = 0.2
"""Median of the means, of full scale, above which a flat frame is not dark: camera's black levels are at most 0.1."""


def is_dark(image: Image, *, full_scale: int) -> bool:
    """Return whether a frame shows neither a sky nor a light in it; blind in images of less than 4 blocks."""
    down, across = image.shape[0] // _BLOCK_PX, image.shape[1] // _BLOCK_PX
    if down * across < 4:
        return False
    blocks = image[: down * _BLOCK_PX, : across * _BLOCK_PX]
    means = blocks.reshape(down, _BLOCK_PX, across, _BLOCK_PX).mean(axis=(1, 3), dtype=np.float32) / full_scale
    low, middle, high = np.percentile(means, (2.0, 50.0, 95.0))
    return bool(middle <= _PEDESTAL and high - low <= _FLAT and float(means.max()) - middle <= _SPOT)
