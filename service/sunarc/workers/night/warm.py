"""The camera's warm pixels, as the images of its nights show them."""

from __future__ import annotations

from collections import deque
from datetime import datetime, timedelta

import numpy as np

from sunarc.array_types import BoolArray, Image, IntArray
from sunarc.cameras import Frame
from sunarc.detection import Bayer, Stars, outstanding_pixels, repaired, warm_pixels

_MOST_IMAGES = 36
"""Six hours of slots of ten minutes; 6 MB at most."""
_FEWEST, _SHORTEST = 6, timedelta(minutes=90)


class WarmPixelMap:
    """Learns which pixels stand out in every image, and repairs them in those that follow.

    From an hour and a half after the first image on there is a list; it is made anew with each image, stays over the
    day, and is empty after a restart.
    """

    def __init__(self) -> None:
        self._seen: deque[tuple[datetime, IntArray]] = deque(maxlen=_MOST_IMAGES)
        self._shape: tuple[int, ...] = ()
        self._warm: IntArray = np.zeros(0, dtype=np.int64)

    def __len__(self) -> int:
        return int(self._warm.size)

    def repair(self, frame: Frame, bayer: Bayer | None) -> Image:
        """Learn from a frame, and return its image without the warm pixels that are known."""
        if frame.image.shape != self._shape:
            self._seen.clear()  # another region or binning
            self._shape, self._warm = frame.image.shape, np.zeros(0, dtype=np.int64)
        self._seen.append((frame.time, outstanding_pixels(frame.image, bayer=bayer)))
        if len(self._seen) >= _FEWEST and self._seen[-1][0] - self._seen[0][0] >= _SHORTEST:
            self._warm = warm_pixels([pixels for _, pixels in self._seen])
        return repaired(frame.image, self._warm, bayer=bayer) if len(self) else frame.image

    def without_warm(self, stars: Stars) -> Stars:
        """Return detections without those on a warm pixel: of images from before there was a list."""
        if len(self) == 0 or len(stars) == 0:
            return stars
        column, row = np.round(stars.pixels).astype(np.int64).T
        on_warm: BoolArray = np.isin(row * self._shape[1] + column, self._warm)
        return stars.select(~on_warm)
