"""A mask of pixels as few bytes: each task carries it to its process."""

from __future__ import annotations

import zlib
from typing import NamedTuple

import cv2
import numpy as np

from sunarc.array_types import BoolArray

_LARGEST_SIDE = 640


class PackedMask(NamedTuple):
    """A mask, (rows, columns), compressed."""

    shape: tuple[int, int]
    compressed: bytes

    def unpacked(self) -> BoolArray:
        """Return the mask, (rows, columns)."""
        bits = np.frombuffer(zlib.decompress(self.compressed), dtype=np.uint8)
        return np.unpackbits(bits, count=self.shape[0] * self.shape[1]).reshape(self.shape).astype(np.bool_)


def pack_mask(mask: BoolArray) -> PackedMask:
    """Return a mask reduced to 640 px at most; a reduced pixel is set where any of it is."""
    shrink = min(1.0, _LARGEST_SIDE / max(mask.shape))
    size = max(1, round(shrink * mask.shape[1])), max(1, round(shrink * mask.shape[0]))
    reduced = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.0
    return PackedMask((size[1], size[0]), zlib.compress(np.packbits(reduced).tobytes()))
