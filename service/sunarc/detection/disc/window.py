"""Window of an image for the disc fit: counts above black, colours, mask of usable pixels."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sunarc.common.array_types import BoolArray, FloatArray, Image
from sunarc.common.robust_statistics import mad_sigma
from sunarc.detection.values import Bayer, Sensor

_CLIPPED_MEAN = 2.0
"""The brightest mean over n by n pixels, times n² over full scale, from which on a pixel of it may be clipped. The
brightest pixel of a disc of 1.5 px radius exceeds the brightest mean by 1.9, 3.6 and 7.1 at n = 2, 3 and 4 (rendered at
81 phases, with 0.7 px of point spread), that of a larger disc by less."""
_COLOURS = {"R": 0, "G": 1, "B": 2}


class Window(NamedTuple):
    """A rectangle of the image.

    counts : (rows, columns) above the black level and the columns' smear; usable : (rows, columns); linear : (rows,
    columns) where no pixel of the sensor can be clipped; colour : (rows, columns) index of each pixel's colour, of
    `colours`; first : x and y of the top-left pixel; saturated_px : how many are not linear.
    """

    counts: FloatArray
    usable: BoolArray
    linear: BoolArray
    colour: NDArray[np.intp]
    colours: int
    first: tuple[int, int]
    saturated_px: int


def cut(image: Image, *, center: tuple[float, float], half: int, sensor: Sensor, saturation_fraction: float) -> Window:
    """Cut the square of 2 half + 1 pixels around `center`, as far as it lies in the image; it may be empty."""
    height, width = image.shape
    x, y = round(center[0]), round(center[1])
    x0, x1 = (min(max(0, end), width) for end in (x - half, x + half + 1))
    y0, y1 = (min(max(0, end), height) for end in (y - half, y + half + 1))
    part = image[y0:y1, x0:x1]
    saturated = saturated_pixels(part, sensor=sensor, saturation_fraction=saturation_fraction)
    # A mean that only may hold clipped pixels still tells the disc's size; the model clips it as the sensor did.
    full = part >= saturation_fraction * sensor.full_scale if sensor.binning > 1 else saturated
    usable = ~_grow_mask(saturated) if sensor.blooming else ~full
    colour, colours = _make_colour_indices(part.shape, first=(x0, y0), bayer=sensor.bayer)
    smear = column_smear(image, x0=x0, x1=x1, y0=y0, y1=y1, mosaic=sensor.bayer is not None)
    counts = part.astype(np.float64) - sensor.black_level - smear
    return Window(counts, usable, usable & ~saturated, colour, colours, (x0, y0), int(np.count_nonzero(saturated)))


def saturated_level(sensor: Sensor, saturation_fraction: float) -> float:
    """Return the counts from which on a spot's brightest pixel may be clipped."""
    if sensor.binning == 1:
        return saturation_fraction * sensor.full_scale
    return sensor.black_level + _CLIPPED_MEAN / sensor.binning**2 * (sensor.full_scale - sensor.black_level)


def saturated_pixels(part: Image, *, sensor: Sensor, saturation_fraction: float) -> BoolArray:
    """Return which pixels of a window are, or may be means over, clipped ones.

    The mean of n² pixels of which one is clipped may be as low as full scale over n². Such a mean is only found next to
    brighter ones: all of a connected region above that level counts where its maximum reaches `saturated_level`.
    """
    bright = np.asarray(part >= saturated_level(sensor, saturation_fraction))
    if sensor.binning == 1 or not bright.any():
        return bright
    clipped = saturation_fraction * sensor.full_scale - sensor.black_level
    lowest = sensor.black_level + clipped / sensor.binning**2
    _, region = cv2.connectedComponents((part >= lowest).astype(np.uint8), connectivity=8)
    return np.isin(region, np.unique(region[bright]))


def _grow_mask(mask: BoolArray) -> BoolArray:
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8))).astype(np.bool_)


def _make_colour_indices(
    shape: tuple[int, ...], *, first: tuple[int, int], bayer: Bayer | None
) -> tuple[NDArray[np.intp], int]:
    if bayer is None:
        return np.zeros(shape, dtype=np.intp), 1
    pattern = np.array([[_COLOURS[bayer[2 * j + i]] for i in range(2)] for j in range(2)])
    rows, columns = (np.arange(n) + start for n, start in zip(shape, first[::-1], strict=True))
    return pattern[np.ix_(rows % 2, columns % 2)], 3


# The vertical smear of an interline CCD: a bright sun adds the same light to every row of its columns.

_STEP, _FINE_STEP = 32, 8  # rows looked at first, and where smear shows; even: a Bayer mosaic's rows stay apart
_FEWEST_ROWS = 8
_MEDIAN_NOISE = 1.2533
_SIGNIFICANT = 5.0


def column_smear(image: Image, *, x0: int, x1: int, y0: int, y1: int, mosaic: bool) -> FloatArray:
    """Return the column smear in a window, estimated from the rows beyond it.

    Parameters
    ----------
    image : (rows, columns) counts.
    x0, x1, y0, y1 : the window, ends exclusive.
    mosaic : whether even and odd rows have different colours.

    Returns
    -------
    (y1 - y0, x1 - x0) counts, lowest column 0; all 0 where no column stands out of its noise, so that a sensor without
    smear loses nothing.
    """
    profiles = np.zeros((2, x1 - x0))
    for parity in range(2 if mosaic else 1):
        rows = _select_rows_beyond(image.shape[0], parity, y0, y1)
        for step in (_STEP, _FINE_STEP):
            profile = column_excess(image[rows[:: step // _FINE_STEP], x0:x1])
            if not profile.any():
                break
        profiles[parity] = profile
    return profiles[np.arange(y0, y1) % 2 * mosaic]


def _select_rows_beyond(height: int, parity: int, y0: int, y1: int) -> NDArray[np.intp]:
    rows = np.arange(parity, height, _FINE_STEP)
    return rows[(rows < y0) | (rows >= y1)]


def column_excess(beyond: Image) -> FloatArray:
    """Return the excess of each column of some rows; zeros where it is noise."""
    nothing = np.zeros(beyond.shape[1])
    if beyond.shape[0] < _FEWEST_ROWS or beyond.shape[1] == 0:
        return nothing
    ordered, half = np.sort(beyond, axis=0), len(beyond) // 2
    level = 0.5 * (ordered[half].astype(np.float64) + ordered[half - 1 + len(beyond) % 2])
    # The window's darkest column stands for the sky: smear is never negative.
    excess = level - level.min()
    spread = mad_sigma(beyond - level)
    noise = _MEDIAN_NOISE * max(spread, 0.3) / math.sqrt(beyond.shape[0])
    return excess if float(excess.max()) >= _SIGNIFICANT * noise else nothing
