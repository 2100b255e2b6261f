"""The part of an ordinary image in which the sun is looked for: all of it, or a window about a predicted place."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from sunarc.array_types import BoolArray, Image
from sunarc.detection.photo.plateau import Near, faintest_colour, faintest_of_mosaic
from sunarc.detection.photo.rim import reach_of
from sunarc.detection.values import Bayer, Expectation

MAX_SIGMA = 0.01
"""Of the image's smaller side: a less certain position is of no use."""
REACH_SIGMAS, REACH_PX = 5.0, 2.0
"""A plateau within so many sigmas (and px) of the prediction is the sun's."""
SURROUNDINGS = 0.08
"""Of the smaller side, beyond the radius: where a predicted sun is the brightest."""

_WINDOW_RADIUS = 0.05
"""Of the smaller side: the largest plateau that a window has room for at the edge of the prediction's reach. Clear suns
have up to 0.05; one of 0.07, as thin cloud before the sun gave, has room where it is near the prediction."""
_BLUR = 0.035
"""Of the smaller side: twice the blur in which the middle of the glare is found."""


class Part(NamedTuple):
    """A part of the faintest colour of an image.

    Attributes
    ----------
    plane : (rows, columns), counts.
    static : (rows, columns), pixels that do not take part; None for none.
    left, top : columns and rows of the whole plane before it.
    whole : rows and columns of the whole plane.
    cell : px of the image in one of the plane: 2 for a mosaic's, else 1.
    near : the predicted place in its px; None for all of an image.
    """

    plane: Image
    static: BoolArray | None
    left: int
    top: int
    whole: tuple[int, int]
    cell: int
    near: Near | None = None

    @property
    def size(self) -> int:
        """Smaller side of the whole plane, px."""
        return min(self.whole)

    def has_room(self, x: float, y: float, radius: float) -> bool:
        """Return whether the rays of a plateau end within it, or at the edge of the image."""
        reach, (rows, columns) = reach_of(radius), self.plane.shape
        return (
            (x - reach >= 0.0 or self.left == 0)
            and (y - reach >= 0.0 or self.top == 0)
            and (x + reach <= columns - 1 or self.left + columns >= self.whole[1])
            and (y + reach <= rows - 1 or self.top + rows >= self.whole[0])
        )

    def holds(self, x: float, y: float, radius: float) -> bool:
        """Return whether it has room for a plateau that is stated in px of the image."""
        shift = (self.cell - 1) / 2.0
        return self.has_room(
            (x - shift) / self.cell - self.left, (y - shift) / self.cell - self.top, radius / self.cell
        )


def whole_part(image: Image, *, static: BoolArray | None, bayer: Bayer | None) -> Part:
    """Return all of an image; see `detect_sun_in_photo`."""
    plane = plane_of(image, bayer)
    rows, columns = plane.shape
    cell = 1 if plane.shape == image.shape[:2] else 2
    return Part(plane, _enlarged(static, (rows, columns)), 0, 0, (rows, columns), cell)


def part_near(
    image: Image,
    expectation: Expectation,
    *,
    step: int,
    static: BoolArray | None,
    bayer: Bayer | None,
    complete: bool = False,
) -> Part:
    """Return the window of an image in which a predicted sun is.

    Parameters
    ----------
    image, expectation, static, bayer : as in `detect_sun_in_photo`.
    step : px of the plane that its left and top are a multiple of.
    complete : all of the image is the window.
    """
    cell = 1 if bayer is None or image.ndim == 3 else 2
    rows, columns = image.shape[0] // cell, image.shape[1] // cell
    size = min(rows, columns)
    x, y = ((value - (cell - 1) / 2.0) / cell for value in (expectation.x_px, expectation.y_px))
    reach = REACH_SIGMAS * math.hypot(expectation.uncertainty_px / cell, MAX_SIGMA * size) + REACH_PX
    radius = _WINDOW_RADIUS * size
    half = reach + max(reach_of(radius), radius + (SURROUNDINGS + _BLUR) * size)
    half = max(rows, columns) + abs(x) + abs(y) if complete else half
    left, right = _range(x, half, columns, step)
    top, bottom = _range(y, half, rows, step)
    window = slice(cell * top, cell * bottom), slice(cell * left, cell * right)
    shown = _enlarged(static, (rows, columns), (top, bottom, left, right))
    near = Near(x - left, y - top, reach)
    return Part(plane_of(image[window], bayer), shown, left, top, (rows, columns), cell, near)


def plane_of(image: Image, bayer: Bayer | None) -> Image:
    """Return the faintest colour of an image, (rows, columns), or of the cells of a raw mosaic, half of both."""
    return faintest_colour(image) if bayer is None or image.ndim == 3 else faintest_of_mosaic(image)


def _range(middle: float, half: float, size: int, step: int) -> tuple[int, int]:
    """Return first and end of a window along an axis; it has one step at least."""
    first = min(max(math.floor((middle - half) / step), 0), (size - 1) // step) * step
    return first, max(min(math.ceil(middle + half) + 1, size), min(first + step, size))


def _enlarged(
    static: BoolArray | None, whole: tuple[int, int], window: tuple[int, int, int, int] | None = None
) -> BoolArray | None:
    """Return the mask of what stands still in the size of a plane, or of a window of it (top, bottom, left, right)."""
    if static is None:
        return None
    if static.shape != whole:
        enlarged = cv2.resize(static.view(np.uint8), (whole[1], whole[0]), interpolation=cv2.INTER_NEAREST)
        static = np.asarray(enlarged).view(np.bool_)
    top, bottom, left, right = (0, whole[0], 0, whole[1]) if window is None else window
    return static[top:bottom, left:right]
