"""The light of an image, and where a point source stands out of its noise."""

from __future__ import annotations

import math

import cv2
import numpy as np
from scipy.spatial import cKDTree

from sunarc.array_types import BoolArray, FloatArray, Image
from sunarc.detection.stars.background import Background, Plane
from sunarc.detection.values import Bayer

FAINTEST_SNR = 5.0
"""Over noise that is normal, 5 sigma leave one false maximum in about a million pixels."""
MOST = 2000
"""Stars of one image; the catalogue has 1400 above the horizon."""
_CLIPPED = 0.97
"""Of full scale; JPEG's blocks take a clipped level down by so much."""
_COLOURS = {
    "RGGB": cv2.COLOR_BayerRGGB2RGB,
    "BGGR": cv2.COLOR_BayerBGGR2RGB,
    "GRBG": cv2.COLOR_BayerGRBG2RGB,
    "GBRG": cv2.COLOR_BayerGBRG2RGB,
}


def plane_of(image: Image, full_scale: int, bayer: Bayer | None) -> tuple[Plane, BoolArray]:
    """Return the light of an image, counts, and where it is clipped in any colour, or beside such a pixel."""
    colours = cv2.cvtColor(image, _COLOURS[bayer]) if bayer is not None and image.ndim == 2 else image
    top = colours.max(axis=-1) if colours.ndim == 3 else colours
    clipped = cv2.dilate((top >= _CLIPPED * full_scale).astype(np.uint8), np.ones((3, 3), dtype=np.uint8)) > 0
    light = colours.mean(axis=-1, dtype=np.float32) if colours.ndim == 3 else colours.astype(np.float32)
    return light, np.asarray(clipped)


def maxima_of(plane: Plane, ground: Background, clipped: BoolArray, usable: BoolArray, width: float) -> FloatArray:
    """Return the places (n, 2) where a Gaussian of a width stands out by 5 sigma, the brightest first."""
    ratio = (plane - ground.level) / ground.noise
    ratio[~usable] = 0.0
    size = 2 * math.ceil(3.0 * width) + 1
    kernel = cv2.getGaussianKernel(size, width)
    response = cv2.sepFilter2D(ratio, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_REFLECT) / float(
        np.sum(kernel**2)
    )
    apart = 2 * round(1.5 * width) + 1
    highest = cv2.dilate(response.astype(np.float32), np.ones((apart, apart), dtype=np.uint8))
    is_top = (response >= highest) & (response > FAINTEST_SNR) & usable
    edge = math.ceil(width) + 1
    is_top[:edge] = is_top[-edge:] = False
    is_top[:, :edge] = is_top[:, -edge:] = False
    rows, columns = np.nonzero(is_top)
    # a clipped plateau has many equal maxima: the first of each counts
    order = np.argsort(-response[rows, columns], kind="stable")[: 2 * MOST]
    places = np.stack([columns, rows], axis=-1)[order].astype(np.float64)
    return _single(places, apart * (1.0 + np.any(clipped)))


def _single(places: FloatArray, apart: float) -> FloatArray:
    """Return places without those close to a brighter one."""
    if places.shape[0] < 2:
        return places
    dropped = np.zeros(places.shape[0], dtype=bool)
    for first, second in sorted(cKDTree(places).query_pairs(apart)):
        dropped[second] |= not dropped[first]
    return places[~dropped][:MOST]
