"""The bright regions of an ordinary image, and how much each looks like a saturated sun."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.uint8]


class Blob(NamedTuple):
    """A connected bright region.

    x, y : centroid, px. diameter : of the circle of the same area. box : x, y, width, height.
    """

    x: float
    y: float
    diameter: float
    box: tuple[int, int, int, int]


def blobs_of(mask: Mask, *, most: int) -> list[Blob]:
    """Return the largest connected regions of a mask, largest first."""
    x, y, width, height = cv2.boundingRect(mask)
    part = np.ascontiguousarray(mask[y : y + height, x : x + width])
    if part.size == 0:
        return []
    count, _, stats, centroids = cv2.connectedComponentsWithStats(part, connectivity=8)
    order = np.argsort(stats[1:count, cv2.CC_STAT_AREA], kind="stable")[::-1][:most] + 1
    found = []
    for (left, top, wide, high, area), (cx, cy) in zip(stats[order].tolist(), centroids[order].tolist(), strict=True):
        diameter = 2.0 * math.sqrt(area / math.pi)
        found.append(Blob(cx + x, cy + y, diameter, (left + x, top + y, wide, high)))
    return found


def thickest(mask: Mask, *, most: int, least_radius: float) -> list[tuple[float, float, float]]:
    """Return centre and radius of the largest circles within a mask, largest first, no two in one another."""
    left, top, width, height = cv2.boundingRect(mask)
    padded = np.pad(mask[top : top + height, left : left + width], 1)
    distance = np.asarray(cv2.distanceTransform(padded, cv2.DIST_L2, 5), dtype=np.float32)
    found: list[tuple[float, float, float]] = []
    while len(found) < most:
        _, radius, _, (column, row) = cv2.minMaxLoc(distance)
        if radius < least_radius:
            break
        found.append((float(left + column - 1), float(top + row - 1), float(radius)))
        cv2.circle(distance, (column, row), math.ceil(2.0 * radius), 0.0, thickness=-1)
    return found


def opened(mask: Mask, diameter: int) -> Mask:
    """Return the mask without what is thinner than a disc of this diameter."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (max(diameter, 1), max(diameter, 1)))
    return np.asarray(cv2.morphologyEx(mask, cv2.MORPH_OPEN, kernel), dtype=np.uint8)
