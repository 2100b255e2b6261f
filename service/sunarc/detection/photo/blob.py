"""The bright regions of an ordinary image, and how much each looks like a saturated sun."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sunarc.detection.values import FloatArray

Mask = NDArray[np.uint8]


class Blob(NamedTuple):
    """A connected bright region.

    x, y : centroid, px. diameter : of the circle of the same area. roundness : 4 pi area / perimeter², 1 for a disc.
    box : x, y, width, height. mask : of the box.
    """

    x: float
    y: float
    diameter: float
    roundness: float
    box: tuple[int, int, int, int]
    mask: Mask


def blobs_of(mask: Mask, *, most: int) -> list[Blob]:
    """Return the largest connected regions of a mask, largest first."""
    x, y, width, height = cv2.boundingRect(mask)
    part = np.ascontiguousarray(mask[y : y + height, x : x + width])
    if part.size == 0:
        return []
    count, raw_labels, stats, centroids = cv2.connectedComponentsWithStats(part, connectivity=8)
    labels = np.asarray(raw_labels, dtype=np.int32)
    order = np.argsort(stats[1:count, cv2.CC_STAT_AREA], kind="stable")[::-1][:most] + 1
    return [
        _blob(labels, int(k), np.asarray(stats[k], np.int32), np.asarray(centroids[k], np.float64), (x, y))
        for k in order
    ]


def _blob(
    labels: NDArray[np.int32], k: int, stats: NDArray[np.int32], centroid: FloatArray, first: tuple[int, int]
) -> Blob:
    x, y, width, height, area = (int(value) for value in stats)
    own = (labels[y : y + height, x : x + width] == k).astype(np.uint8)
    # The padding keeps the outline closed where the region touches its box.
    contours, _ = cv2.findContours(np.pad(own, 1), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outline = max(contours, key=len)
    perimeter = max(float(cv2.arcLength(outline, closed=True)), 1.0)
    filled = max(float(cv2.contourArea(outline)), float(area))
    return Blob(
        float(centroid[0]) + first[0],
        float(centroid[1]) + first[1],
        2.0 * math.sqrt(area / math.pi),
        min(4.0 * math.pi * filled / perimeter**2, 1.0),
        (x + first[0], y + first[1], width, height),
        own,
    )


def thickest(mask: Mask, *, most: int, least_radius: float) -> list[tuple[float, float, float]]:
    """Return centre and radius of the largest circles within a mask, largest first, no two in one another."""
    padded = np.pad(mask, 1)
    distance = np.asarray(cv2.distanceTransform(padded, cv2.DIST_L2, 5), dtype=np.float32)
    found: list[tuple[float, float, float]] = []
    while len(found) < most:
        _, radius, _, (column, row) = cv2.minMaxLoc(distance)
        if radius < least_radius:
            break
        found.append((float(column - 1), float(row - 1), float(radius)))
        cv2.circle(distance, (column, row), math.ceil(2.0 * radius), 0.0, thickness=-1)
    return found


def opened(mask: Mask, diameter: int) -> Mask:
    """Return the mask without what is thinner than a disc of this diameter."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (max(diameter, 1), max(diameter, 1)))
    return np.asarray(cv2.morphologyEx(mask, cv2.MORPH_OPEN, kernel), dtype=np.uint8)
