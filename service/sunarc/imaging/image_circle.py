"""The circle that a fisheye draws on the sensor, found in a daytime frame by a Hough transform (section 4.1.1)."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from sunarc.common.array_types import FloatArray
from sunarc.common.errors import InputError
from sunarc.common.robust_statistics import cauchy_weights

_WORKING_SIZE = 480
_RAYS = 360
_ROUNDS = 8


class FoundCircle(NamedTuple):
    """A circle in an image, px."""

    x: float
    y: float
    radius: float


def find_image_circle(image: ArrayLike) -> FoundCircle | None:
    """Return the image circle, or None where the frame shows none.

    Parameters
    ----------
    image : (h, w) or (h, w, channels), any unsigned type; bright sky inside, dark outside.

    Returns
    -------
    The circle to about a pixel: the Hough transform's, then a least-squares circle through the edge's steepest points.
    """
    grey = as_grey(image)
    shrink = min(1.0, _WORKING_SIZE / min(grey.shape))
    small = cv2.resize(grey, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
    blurred = cv2.medianBlur(small, 5)
    least, most = 0.3 * min(small.shape), 0.75 * max(small.shape)
    circles = cv2.HoughCircles(
        blurred,
        cv2.HOUGH_GRADIENT,
        dp=2,
        minDist=float(max(small.shape)),
        param1=60,
        param2=30,
        minRadius=int(least),
        maxRadius=int(most),
    )
    if circles is None:
        return None
    x, y, radius = (float(v) / shrink for v in np.asarray(circles).reshape(-1, 3)[0])
    return refined_circle(grey.astype(np.float64), x, y, radius)


def as_grey(image: ArrayLike) -> NDArray[np.uint8]:
    """Return a frame as 8 bit grey values; InputError where it is not a frame."""
    array = np.asarray(image)
    if array.ndim not in (2, 3) or array.size == 0 or min(array.shape[:2]) < 32:
        raise InputError(field="image", problem=f"shape {array.shape}", remedy="give a frame of at least 32 × 32 px")
    values = array.astype(np.float64)
    values = values.mean(axis=-1) if values.ndim == 3 else values
    top = max(float(np.percentile(values, 99.0)), 1.0)
    return np.asarray(np.clip(255.0 * np.sqrt(np.clip(values, 0.0, None) / top), 0.0, 255.0), dtype=np.uint8)


def refined_circle(grey: FloatArray, x: float, y: float, radius: float) -> FoundCircle:
    """Fit a circle through the steepest outward drop along rays, those that lie off counting less and less."""
    angle = np.linspace(0.0, 2.0 * np.pi, _RAYS, endpoint=False)
    offset = np.arange(-0.06 * radius, 0.06 * radius, 0.5)
    for _ in range(_ROUNDS):
        reach = radius + offset
        px = x + np.cos(angle)[:, None] * reach
        py = y + np.sin(angle)[:, None] * reach
        inside = (px > 1) & (px < grey.shape[1] - 2) & (py > 1) & (py < grey.shape[0] - 2)
        values = cv2.remap(grey.astype(np.float32), px.astype(np.float32), py.astype(np.float32), cv2.INTER_LINEAR)
        # a drop within 2 px: lens flare and vignetting fall more slowly
        drop = np.where(inside[:, 4:] & inside[:, :-4], values[:, :-4] - values[:, 4:], 0.0)
        best = np.argmax(drop, axis=1)
        strong = drop[np.arange(_RAYS), best] > 0.25 * float(np.max(drop, initial=0.0))
        if strong.sum() < 24:
            break
        edge = reach[best + 2][strong]
        x, y, radius = circle_through(x + np.cos(angle[strong]) * edge, y + np.sin(angle[strong]) * edge)
    return FoundCircle(x, y, radius)


def circle_through(px: FloatArray, py: FloatArray) -> tuple[float, float, float]:
    """Return centre and radius of the circle through points."""
    weight = np.ones_like(px)
    for _ in range(10):
        rows = np.stack([2.0 * px, 2.0 * py, np.ones_like(px)], axis=-1) * weight[:, None]
        cx, cy, c = np.linalg.lstsq(rows, (px**2 + py**2) * weight)[0]
        radius = float(np.sqrt(max(c + cx**2 + cy**2, 1.0)))
        off = np.abs(np.hypot(px - cx, py - cy) - radius)
        weight = cauchy_weights(off, scale=max(float(np.median(off)), 0.1))
    return float(cx), float(cy), radius
