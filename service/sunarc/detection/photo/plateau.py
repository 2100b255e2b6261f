"""Where the sun may be in an ordinary image: compact regions that one level fills.

The level is the highest that a region of some thickness reaches, not the brightest pixel: a camera may clip the sun at
160 of 255 beneath a text overlay of 255. It is looked for in the faintest of the three colours, whose plateau is the
smallest and the roundest.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sunarc.common.array_types import BoolArray, Image
from sunarc.common.errors import InputError


class Blob(NamedTuple):
    """A connected bright region.

    x, y : centroid, px. diameter : of the circle of the same area. box : x, y, width, height.
    """

    x: float
    y: float
    diameter: float
    box: tuple[int, int, int, int]


def largest_blobs(mask: Mask, *, most: int) -> list[Blob]:
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
    """Return the mask without the parts thinner than a disc of this diameter."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (max(diameter, 1), max(diameter, 1)))
    return np.asarray(cv2.morphologyEx(mask, cv2.MORPH_OPEN, kernel), dtype=np.uint8)


Plane = NDArray[np.float32]
Mask = NDArray[np.uint8]

_SEARCHED_PX = 960
"""Smaller side of the image in which plateaus are looked for; a sun of 5 px radius in 1920 px is still 2.5 px there."""
_LEVEL = 0.97
"""Of the plateau: JPEG's ringing and the sensor's unevenness stay above it (real images: 247 of 255 at the lowest)."""
_LOWEST = 0.5
"""Of the highest plateau: a lower one is no sun."""
_LEVELS, _IN_A_LEVEL, _TRIED = 3, 4, 48
_LEAST_RADIUS_PX = 1.4  # in the reduced image: the 3 × 3 pixels of the erosion
_HOLE = 0.3  # of the region's area: a black-sun artefact or a painted mark, not the clear sky within a ring of cloud
_NEAR, _NEAR_PX = 1.7, 1.5  # radii, and px of the reduced image: where the light beside a circle is taken
_APART_PX = 9  # about a plateau its own glare is no second one

_ANGLES = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
_COSINE, _SINE = np.cos(_ANGLES), np.sin(_ANGLES)


class Near(NamedTuple):
    """A predicted place, px, and how far from it a centre may be."""

    x: float
    y: float
    reach: float


class Plateau(NamedTuple):
    """The largest circle within a region that one level fills.

    x, y, radius : px of the image. level : counts.
    """

    x: float
    y: float
    radius: float
    level: float


def faintest_colour(image: Image) -> Image:
    """Return the smallest of the colours, (rows, columns); a mono image as it is."""
    if image.ndim == 2:
        return image
    first, second, third = cv2.split(image)
    faintest: Image = cv2.min(cv2.min(first, second), third)  # type: ignore[assignment]
    return faintest


def cell_minimum(image: Image) -> Image:
    """Return the smallest count of each 2 × 2 cell of a raw mosaic, (rows // 2, columns // 2)."""
    rows, columns = (size // 2 * 2 for size in image.shape)
    cells = [image[row:rows:2, column:columns:2] for row in (0, 1) for column in (0, 1)]
    faintest: Image = np.minimum(np.minimum(cells[0], cells[1]), np.minimum(cells[2], cells[3]))
    return faintest


def plateau_step(size: int) -> int:
    """Return the reduction factor, by the image's smaller side, at which plateaus are searched."""
    return max(1, round(size / _SEARCHED_PX))


def plateaus(
    plane: Image,
    *,
    least_level: float,
    least_near: float = 0.0,
    static: BoolArray | None = None,
    size: int | None = None,
    near: Near | None = None,
) -> list[Plateau]:
    """Return the largest circles within the plateaus of a plane, those of the highest level first.

    Parameters
    ----------
    plane : (rows, columns), the faintest colour.
    least_level : counts below which nothing is looked for.
    least_near : light around a circle over its level, below which it is left out (text, boxes, snow on a roof).
    static : (rows, columns), pixels that do not take part.
    size : smaller side of the image that the plane is a part of; None for all of it.
    near : only plateaus are returned in whose circle, or out of it by `reach` at most, a predicted place is; their
        levels are those of places within its reach. None for all plateaus.
    """
    step = plateau_step(min(plane.shape) if size is None else size)
    small = _average_blocks(plane, step, static)
    found, taken = list[Plateau](), np.zeros(small.shape, np.uint8)
    highest = cv2.erode(small, np.ones((3, 3), np.uint8))
    top, searched = float(highest.max(initial=0.0)), highest[_reachable_zone(near, step)]
    for _ in range(_LEVELS):
        level = float(searched.max(initial=0.0))
        if level < max(least_level, _LOWEST * top, 1.0):
            break
        region = _remove_overlapping_regions(_fill_small_holes((small >= _LEVEL * level).astype(np.uint8)), taken)
        circles = [Plateau(*each, level) for each in thickest(region, most=_TRIED, least_radius=_LEAST_RADIUS_PX)]
        found += _sort_by_surrounding_light(small, _select_within_reach(circles, near, step), least_near * level, step)
        taken |= (small >= _LEVEL * level).astype(np.uint8) | region
        highest[cv2.dilate(taken, np.ones((_APART_PX, _APART_PX), np.uint8)) > 0] = 0.0
    return found


def _average_blocks(plane: Image, step: int, static: BoolArray | None) -> Plane:
    """Return means of step × step pixels."""
    shown: Image = plane if static is None else np.where(static, 0, plane).astype(plane.dtype)  # type: ignore[assignment]
    rows, columns = (size // step for size in plane.shape)
    part = shown[: rows * step, : columns * step]
    return np.asarray(cv2.resize(part, (columns, rows), interpolation=cv2.INTER_AREA), dtype=np.float32)


def _reachable_zone(near: Near | None, step: int) -> tuple[slice, slice]:
    """Return where in the reduced plane the levels are sought: within reach of a predicted place."""
    if near is None:
        return slice(None), slice(None)
    reach = math.ceil(near.reach / step)
    row, column = round(near.y / step), round(near.x / step)
    return slice(max(row - reach, 0), max(row + reach + 1, 0)), slice(
        max(column - reach, 0), max(column + reach + 1, 0)
    )


def _select_within_reach(circles: list[Plateau], near: Near | None, step: int) -> list[Plateau]:
    if near is None:
        return circles
    shift, reach = (step - 1) / 2.0, near.reach / step
    x, y = (near.x - shift) / step, (near.y - shift) / step
    return [circle for circle in circles if math.hypot(circle.x - x, circle.y - y) <= circle.radius + reach]


def _sort_by_surrounding_light(small: Plane, circles: list[Plateau], least: float, step: int) -> list[Plateau]:
    """Return the circles with light around them in px of the image, the largest with light all around first."""
    lit = []
    for circle in circles:
        light = _sample_light_about(small, circle)
        if float(np.median(light)) >= least:
            lit.append((-circle.radius * float(np.quantile(light, 0.25)), circle))
    shift = (step - 1) / 2.0
    return [
        Plateau(step * circle.x + shift, step * circle.y + shift, step * circle.radius, circle.level)
        for _, circle in sorted(lit)[:_IN_A_LEVEL]
    ]


def _sample_light_about(small: Plane, circle: Plateau) -> Plane:
    """Return the light at 1.7 radii (and 1.5 px) of a circle in all directions, 0 beyond the image."""
    far = _NEAR * circle.radius + _NEAR_PX
    columns = np.rint(circle.x + far * _COSINE).astype(np.intp)
    rows = np.rint(circle.y + far * _SINE).astype(np.intp)
    inside = (columns >= 0) & (rows >= 0) & (columns < small.shape[1]) & (rows < small.shape[0])
    return np.where(inside, small[np.where(inside, rows, 0), np.where(inside, columns, 0)], np.float32(0.0))


def _fill_small_holes(region: Mask) -> Mask:
    """Return a mask with its small holes filled."""
    box = _bounding_box(region)
    part = region[box]
    count, labels, stats, _ = cv2.connectedComponentsWithStats(np.pad(1 - part, 1, constant_values=1), connectivity=4)
    if count <= 2:
        return region
    small = stats[:, cv2.CC_STAT_AREA] < _HOLE * np.count_nonzero(part)
    small[[0, labels[0, 0]]] = False
    filled = region.copy()
    filled[box] |= small[labels][1:-1, 1:-1]
    return filled


def _remove_overlapping_regions(region: Mask, taken: Mask) -> Mask:
    """Return a mask without the connected regions that hold some of another: they are the glare of a higher plateau."""
    box = _bounding_box(region)
    count, labels = cv2.connectedComponents(region[box], connectivity=8)
    keep = np.ones(count, np.uint8)
    keep[0] = 0
    keep[labels[taken[box] > 0]] = 0
    kept = np.zeros_like(region)
    kept[box] = keep[labels]
    return kept


def _bounding_box(region: Mask) -> tuple[slice, slice]:
    """Return the rows and columns in which a mask has something."""
    left, top, width, height = cv2.boundingRect(region)
    return slice(top, top + max(height, 1)), slice(left, left + max(width, 1))


_SAMPLED = 120
"""Rows and columns in which an image circle is looked for."""
_LIT = (0.06, 0.03)
"""From the darkest to the brightest place: an image circle's edge is sharp, a lamp's glare is not."""
_LIGHT_SIDE = 0.2
"""Of the brightest place in the middle: more is sky, and not the surroundings of an image circle."""
_SURROUND = 0.02
"""Share of the image that is beyond a small image circle at least."""
_AS_SHARP, _AS_ROUND, _FULL = 1.2, 0.1, 0.6
"""Area at the lower level over that at the upper, difference of the sides, and share of the ellipse in its box."""
_SMALL_CIRCLE, _CIRCLE_MARGIN = (0.3, 0.9), 0.05
"""Side of the box about a circle over the image's smaller side; margin about it, of its side."""


def circle_box(image: Image) -> tuple[slice, slice] | None:
    """Return the rows and columns about an image circle that is smaller than its image; None where none is seen.

    Parameters
    ----------
    image : (rows, columns) or (rows, columns, 3); the first row and column of the box are even.
    """
    size = min(image.shape[:2])
    step = max(1, size // _SAMPLED)
    if _reaches_border(image, step):
        return None
    light = cv2.medianBlur(_maximum_over_colours(image[::step, ::step]), 3)
    dark = float(np.partition(light.ravel(), round(_SURROUND * light.size))[round(_SURROUND * light.size)])
    masks = [(light > dark + share * (float(light.max()) - dark)).astype(np.uint8) for share in _LIT]
    narrow, wide = (_measure_largest_region(opened(mask, 3)) for mask in masks)
    left, top, width, height, area = narrow
    is_disc = abs(width - height) <= _AS_ROUND * width and area >= _FULL * math.pi / 4.0 * width * height
    if (
        not is_disc
        or wide[-1] > _AS_SHARP * area
        or not _SMALL_CIRCLE[0] <= max(width, height) * step / size < _SMALL_CIRCLE[1]
    ):
        return None
    margin = math.ceil(_CIRCLE_MARGIN * max(width, height)) + 1
    rows, columns = ((first - margin, first + side + margin) for first, side in ((top, height), (left, width)))
    return tuple(slice(max(first, 0) * step // 2 * 2, last * step) for first, last in (rows, columns))  # type: ignore[return-value]


def _maximum_over_colours(image: Image) -> Image:
    brightest: Image = image if image.ndim == 2 else image[..., 0].copy()
    for colour in range(1, 1 if image.ndim == 2 else 3):
        np.maximum(brightest, image[..., colour], out=brightest)
    return brightest.copy()


def _reaches_border(image: Image, step: int) -> bool:
    """Return whether the middle of two sides of an image or more is as light as its middle."""
    rows, columns = image.shape[:2]
    down, across = (slice(size // 3, size - size // 3, step) for size in (rows, columns))
    sides = (image[0, across], image[-1, across], image[down, 0], image[down, -1])
    least = _LIGHT_SIDE * float(np.max(image[down, columns // 2]))
    return sum(float(np.median(side)) > least for side in sides) > 1


def _measure_largest_region(mask: Mask) -> tuple[int, int, int, int, int]:
    """Return left, top, width, height and area of the largest connected region of a mask; 0 without one."""
    found = cv2.connectedComponentsWithStats(mask, connectivity=8)[2][1:]
    return tuple(found[int(np.argmax(found[:, -1]))].tolist()) if len(found) else (0, 0, 0, 0, 0)


_BRIGHT = 0.5  # of full scale: what is darker is no plateau beside a sun
_STILL = 0.06  # of full scale: JPEG's own changes from image to image
_MARGIN = 0.006  # of the smaller side: the width of a digit, for those that change beside those that do not
_LEAST_IMAGES = 3


def static_mask(images: Iterable[Image], *, full_scale: int) -> BoolArray | None:
    """Return where a bright level does not move in a series (rows, columns); None where the series cannot show it.

    Parameters
    ----------
    images : of one camera, (rows, columns) or (rows, columns, 3), in one size, full or reduced; three at least, over
        hours: the sun must have left every place that it saturates (it moves by 15 degrees in an hour, and its glare
        may be 20 degrees wide).
    full_scale : their largest count.

    Raises
    ------
    InputError : images of several sizes.
    """
    lowest: Image | None = None
    highest: Image | None = None
    count = 0
    for image in images:
        plane = faintest_colour(image)
        if lowest is None or highest is None:
            lowest, highest = plane.copy(), plane.copy()
        elif plane.shape != lowest.shape:
            raise InputError(
                field="images", problem=f"sizes {lowest.shape} and {plane.shape}", remedy="give images of one size"
            )
        else:
            np.minimum(lowest, plane, out=lowest)
            np.maximum(highest, plane, out=highest)
        count += 1
    if lowest is None or highest is None or count < _LEAST_IMAGES:
        return None
    still = (lowest >= _BRIGHT * full_scale) & (highest - lowest <= _STILL * full_scale)
    size = 2 * max(1, round(_MARGIN * min(lowest.shape))) + 1
    grown = cv2.dilate(still.astype(np.uint8), np.ones((size, size), np.uint8))
    return np.asarray(grown, dtype=np.bool_)
