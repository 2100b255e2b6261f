"""Warm pixels: single pixels with a dark current of their own, found by what stays while the sky turns."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from sunarc.array_types import Image, IntArray
from sunarc.detection.values import Bayer
from sunarc.robust_statistics import MAD_TO_SIGMA

_OUTSTANDING = 6.0
"""Noises above the median of the neighbours: in 4 million pixels a normal noise leaves none."""
_MOST = 20_000
"""Of an image: half a percent of 4 million; the brightest count."""
_SHARE = 0.7
"""Of the images in which a warm pixel stands out; a star leaves a pixel after 10 minutes, Polaris after 30."""


def outstanding_pixels(image: Image, *, bayer: Bayer | None = None) -> IntArray:
    """Return the pixels that stand out over their eight neighbours (of the same colour), as flat indices, ascending.

    Stars of a sharp lens are among them.

    Parameters
    ----------
    image : (rows, columns) counts.
    bayer : colours of a raw mosaic.
    """
    excess = image.astype(np.int32) - _calm(image, bayer)
    sampled = excess[::4, ::4]
    noise = max(MAD_TO_SIGMA * float(np.median(np.abs(sampled - np.median(sampled)))), 0.5)
    found = np.flatnonzero(excess.ravel() > _OUTSTANDING * noise)
    if found.size > _MOST:
        found = found[np.argsort(-excess.ravel()[found], kind="stable")[:_MOST]]
    return np.sort(found)


def warm_pixels(outstanding: Sequence[IntArray]) -> IntArray:
    """Return the pixels that stand out in 70 % of images of a turning sky, as flat indices, ascending.

    Parameters
    ----------
    outstanding : of each image, over an hour and a half at least: Polaris moves by 3 px at 600 px a radian.
    """
    if not outstanding:
        return np.zeros(0, dtype=np.int64)
    pixels, count = np.unique(np.concatenate(list(outstanding)), return_counts=True)
    return np.asarray(pixels[count >= _SHARE * len(outstanding)], dtype=np.int64)


def repaired(image: Image, warm: IntArray, *, bayer: Bayer | None = None) -> Image:
    """Return an image with the median of the neighbours (of the same colour) in place of warm pixels."""
    whole: Image = image.copy()
    whole.ravel()[warm] = _calm(image, bayer).ravel()[warm]
    return whole


def _calm(image: Image, bayer: Bayer | None) -> Image:
    """Return the median of each pixel and its eight neighbours, in a mosaic those of its colour."""
    if bayer is None:
        return _median(image)
    calm = np.empty(image.shape, dtype=np.uint16)
    for row in (0, 1):
        for column in (0, 1):
            calm[row::2, column::2] = _median(image[row::2, column::2])
    return calm


def _median(plane: Image) -> Image:
    return np.asarray(cv2.medianBlur(plane.copy(), 3), dtype=np.uint16)
