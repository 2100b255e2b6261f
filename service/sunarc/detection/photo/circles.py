"""Level sets of a bright blob as circles: streaks, contrails and neighbouring clouds are outliers of its outline."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sunarc.array_types import FloatArray
from sunarc.robust_statistics import biweights, mad_sigma

Plane = NDArray[np.float32]

_OPENING = 1.0  # of the inscribed radius: what is thinner is cut off before the outline is taken
_ROUNDS = 25
_CUT = 4.0
_LEAST_SCALE_PX = 0.5


class Circle(NamedTuple):
    """A circle through the outline of a level set.

    x, y, radius : px. share : of its angles at which the outline follows it. scatter : typical distance of the outline
    from it there, px.
    """

    x: float
    y: float
    radius: float
    share: float
    scatter: float


def level_circle(plane: Plane, *, level: float, near: tuple[float, float]) -> Circle | None:
    """Return the circle of the region above `level` that holds, or lies next to, the point `near`; None without one."""
    mask = (plane >= level).astype(np.uint8)
    padded = cv2.distanceTransform(np.pad(mask, 1), cv2.DIST_L2, 5)
    distance = np.asarray(padded, dtype=np.float64)[1:-1, 1:-1]
    start = _inscribed(mask, distance, near)
    if start is None or start.radius < 2.0:
        return None
    points = _outline(_opened(mask, radius=0.5 * _OPENING * start.radius), start)
    return None if len(points) < 8 else _fitted(points, start)


def _opened(mask: NDArray[np.uint8], *, radius: float) -> NDArray[np.uint8]:
    """Return the mask without what is thinner than a disc of this radius; two distances, however large it is."""
    inner = np.asarray(cv2.distanceTransform(np.pad(mask, 1), cv2.DIST_L2, 5))[1:-1, 1:-1]
    outside = (inner <= radius).astype(np.uint8)
    reach = np.asarray(cv2.distanceTransform(outside, cv2.DIST_L2, 5))
    return (reach < radius).astype(np.uint8)


def _inscribed(mask: NDArray[np.uint8], distance: FloatArray, near: tuple[float, float]) -> Circle | None:
    """Return the largest circle within the region at `near`."""
    count, labels = cv2.connectedComponents(mask, connectivity=4)
    if count < 2:
        return None
    x, y = (min(max(round(v), 0), size - 1) for v, size in zip(near, mask.shape[::-1], strict=True))
    label = labels[y, x]
    if label == 0:
        rows, columns = np.nonzero(mask)
        nearest = int(np.argmin((rows - near[1]) ** 2 + (columns - near[0]) ** 2))
        label = labels[rows[nearest], columns[nearest]]
    inside = np.where(labels == label, distance, 0.0)
    row, column = divmod(int(np.argmax(inside)), mask.shape[1])
    return Circle(float(column), float(row), float(inside[row, column]), 0.0, 0.0)


def _outline(mask: NDArray[np.uint8], start: Circle) -> FloatArray:
    """Return the (n, 2) outline points of the region around the start, half a pixel outside its last pixels."""
    contours, _ = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    around = [c for c in contours if cv2.pointPolygonTest(c, (start.x, start.y), measureDist=False) >= 0]
    if not around:
        return np.zeros((0, 2))
    # Of an outline and the holes in it, the innermost one around the start is the region's own.
    points = min(around, key=cv2.contourArea)[:, 0, :].astype(np.float64)
    height, width = mask.shape
    # Points on the border are the image's outline, not the region's.
    inner = (points > 0).all(axis=1) & (points[:, 0] < width - 1) & (points[:, 1] < height - 1)
    return np.asarray(points[inner])


def _fitted(points: FloatArray, start: Circle) -> Circle:
    """Fit a circle by Gauss-Newton steps with Tukey's weights."""
    x, y, radius = start.x, start.y, start.radius
    scale = max(0.15 * radius, 1.0)
    residual = np.zeros(len(points))
    for _ in range(_ROUNDS):
        offset = points - (x, y)
        length = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), 1e-9)
        residual = length - radius
        weight = biweights(residual / (_CUT * scale))
        design = np.column_stack([offset / length[:, None], np.ones(len(points))])
        matrix = design.T @ (design * weight[:, None]) + 1e-6 * np.eye(3)
        step = np.linalg.solve(matrix, design.T @ (weight * residual))
        x, y, radius = x + float(step[0]), y + float(step[1]), max(radius + float(step[2]), 1.0)
        # Not below half a pixel: an outline of whole pixels scatters by that much.
        inlier = weight > 0.0
        scale = max(mad_sigma(residual[inlier]) if inlier.any() else scale, _LEAST_SCALE_PX)
    followed = np.abs(residual) < max(_CUT * _LEAST_SCALE_PX, 0.1 * radius)
    angle = np.arctan2(points[followed, 1] - y, points[followed, 0] - x)
    sectors = np.unique(np.floor((angle + math.pi) / (2.0 * math.pi) * 72.0).astype(int))
    scatter = mad_sigma(residual[followed]) if followed.any() else radius
    return Circle(x, y, radius, min(len(sectors), 72) / 72.0, scatter)
