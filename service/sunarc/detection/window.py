"""Window of an image for the disc fit: counts above black, colours, mask of usable pixels."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sunarc.detection.smear import column_smear
from sunarc.detection.values import Bayer, FloatArray, Image, Sensor

BoolArray = NDArray[np.bool_]

_COLOURS = {"R": 0, "G": 1, "B": 2}


class Window(NamedTuple):
    """A rectangle of the image.

    counts : (rows, columns) above the black level and the columns' smear; usable : (rows, columns); colour : (rows,
    columns) index of each pixel's colour, of `colours`; first : x and y of the top-left pixel; saturated_px : how many.
    """

    counts: FloatArray
    usable: BoolArray
    colour: NDArray[np.intp]
    colours: int
    first: tuple[int, int]
    saturated_px: int


def cut(image: Image, *, center: tuple[float, float], half: int, sensor: Sensor, saturation_fraction: float) -> Window:
    """Cut the square of 2 half + 1 pixels around `center`, as far as it lies in the image; it may be empty."""
    height, width = image.shape
    x, y = round(center[0]), round(center[1])
    x0, x1 = max(0, x - half), max(0, min(width, x + half + 1))
    y0, y1 = max(0, y - half), max(0, min(height, y + half + 1))
    part = image[y0:y1, x0:x1]
    saturated = part >= saturation_fraction * sensor.full_scale
    usable = ~_grown(saturated) if sensor.blooming else ~saturated
    colour, colours = _colours(part.shape, first=(x0, y0), bayer=sensor.bayer)
    smear = column_smear(image, x0=x0, x1=x1, y0=y0, y1=y1, mosaic=sensor.bayer is not None)
    counts = part.astype(np.float64) - sensor.black_level - smear
    return Window(counts, usable, colour, colours, (x0, y0), int(np.count_nonzero(saturated)))


def _grown(mask: BoolArray) -> BoolArray:
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8))).astype(np.bool_)


def _colours(shape: tuple[int, ...], *, first: tuple[int, int], bayer: Bayer | None) -> tuple[NDArray[np.intp], int]:
    if bayer is None:
        return np.zeros(shape, dtype=np.intp), 1
    pattern = np.array([[_COLOURS[bayer[2 * j + i]] for i in range(2)] for j in range(2)])
    rows, columns = (np.arange(n) + start for n, start in zip(shape, first[::-1], strict=True))
    return pattern[np.ix_(rows % 2, columns % 2)], 3
