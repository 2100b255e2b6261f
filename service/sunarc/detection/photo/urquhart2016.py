"""The sun in ordinary and HDR images: the five estimators of Appendix A."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sunarc.array_types import Image
from sunarc.detection.frames import require_photo
from sunarc.detection.photo import centroids as estimators
from sunarc.detection.photo.blob import Blob

Plane = NDArray[np.float32]

_ALL = slice(None)
_SPARE_PX = 8


class Estimates(NamedTuple):
    """What the single estimators say.

    columns, rows : their x and y, px: disc, Gaussian and flattened kernel, Förstner, and (x only) the smear where it
    stands out. diameter : of the sun's blob, px. sigma : of the kernels, px.
    """

    columns: tuple[float, ...]
    rows: tuple[float, ...]
    diameter: float
    sigma: float

    @property
    def position(self) -> tuple[float, float]:
        """Medians of the columns and of the rows."""
        return float(np.median(self.columns)), float(np.median(self.rows))

    def shifted(self, x: float, y: float) -> Estimates:
        """Return the same seen from a window whose first pixel is (x, y)."""
        return self._replace(columns=tuple(c + x for c in self.columns), rows=tuple(r + y for r in self.rows))

    @property
    def spread_px(self) -> float:
        """Root mean square distance of the four full estimators from the medians."""
        x, y = self.position
        squares = [(c - x) ** 2 + (r - y) ** 2 for c, r in zip(self.columns, self.rows, strict=False)]
        return math.sqrt(float(np.mean(squares)))


class Planes(NamedTuple):
    """An image as the estimators want it.

    counts : V, the largest colour, (rows, columns), counts. image : as it was given. full_scale : of both.
    """

    counts: Image
    image: Image
    full_scale: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.image.shape[0], self.image.shape[1]

    def value(self, rows: slice = _ALL, columns: slice = _ALL) -> Plane:
        """Return a part of V as fractions of full scale."""
        return self.counts[rows, columns].astype(np.float32) * np.float32(1.0 / self.full_scale)

    def grey(self, rows: slice = _ALL, columns: slice = _ALL) -> Plane:
        """Return a part of the mean of the colours as fractions of full scale."""
        part = self.image[rows, columns].astype(np.float32)
        mean = part if part.ndim == 2 else cv2.transform(part, np.full((1, 3), 1.0 / 3.0, np.float32))
        return np.asarray(mean, dtype=np.float32) * np.float32(1.0 / self.full_scale)

    def part(self, rows: slice, columns: slice) -> Planes:
        """Return a rectangle of the image."""
        return Planes(self.counts[rows, columns], self.image[rows, columns], self.full_scale)


def planes_of(image: Image, *, full_scale: int) -> Planes:
    """Return the planes of a mono (rows, columns) or colour (rows, columns, 3) image, uint8 or uint16.

    Raises
    ------
    InputError : another shape or type, or a full scale beyond it.
    """
    require_photo(image, full_scale=full_scale)
    if image.ndim == 2:
        return Planes(image, image, full_scale)
    first, second, third = cv2.split(image)
    value = np.asarray(cv2.max(cv2.max(first, second), third))
    counts: Image = (
        value.astype(np.uint8, copy=False) if image.dtype == np.uint8 else value.astype(np.uint16, copy=False)
    )
    return Planes(counts, image, full_scale)


def locate(planes: Planes, *, apparent_zenith: float | None, full_image: bool = False) -> Estimates | None:
    """Return the five estimators' answers, or None where nothing is bright.

    Parameters
    ----------
    planes : of the image.
    apparent_zenith : of the sun, radians, which sets the kernels' width; without one the blob's radius does.
    full_image : convolve the whole image, as the paper does; otherwise only the sun's surroundings, which gives the
        same answer as long as nothing else in the image is as large and bright.
    """
    blob = estimators.sun_blob(planes.counts)
    if blob is None:
        return None
    sigma = estimators.gaussian_sigma_px(apparent_zenith) if apparent_zenith is not None else _blob_sigma(blob)
    kernels = estimators.kernels(diameter=blob.diameter, sigma=sigma)
    rows, columns = (_ALL, _ALL) if full_image else _around(planes, blob, kernels[0].shape[0] // 2)
    part = planes.value(rows, columns)
    found = [estimators.strongest(part, kernel) for kernel in kernels]
    xs, ys = [x + (columns.start or 0) for x, _ in found], [y + (rows.start or 0) for _, y in found]
    first_row = slice(0, 1)
    smear = estimators.smear_column(
        planes.value(first_row)[0].astype(np.float64), 3.0 * planes.grey(first_row)[0].astype(np.float64)
    )
    middle = smear if smear is not None and abs(smear - blob.x) < blob.diameter else float(np.median(xs))
    half = 5.0 * sigma + 0.5 * blob.diameter
    strip = slice(max(0, round(middle - half)), round(middle + half) + 1)
    surrounded = planes.value(rows, strip)
    within = None if full_image else _among(surrounded.shape, blob, first=(strip.start, rows.start))
    x, y = estimators.forstner(surrounded, sigma=sigma, within=within)
    xs, ys = [*xs, x + strip.start], [*ys, y + (rows.start or 0)]
    return Estimates(tuple(xs if smear is None else [*xs, smear]), tuple(ys), blob.diameter, sigma)


def _among(shape: tuple[int, ...], blob: Blob, *, first: tuple[int, int]) -> tuple[slice, slice]:
    """Return the rows and columns of a window at `first` (x, y) in which the blob's centre must lie."""
    (x, y, width, height), (x0, y0) = blob.box, first
    top, left = max(0, y - _SPARE_PX - y0), max(0, x - _SPARE_PX - x0)
    return (
        slice(top, max(top + 1, min(shape[0], y + height + _SPARE_PX - y0))),
        slice(left, max(left + 1, min(shape[1], x + width + _SPARE_PX - x0))),
    )


def _blob_sigma(blob: Blob) -> float:
    """Return a width at which Förstner's maximum is the centre of a ring of the blob's size (it must exceed Ø/4)."""
    return max(0.5 * blob.diameter, 1.0)


def _around(planes: Planes, blob: Blob, reach: int) -> tuple[slice, slice]:
    """Return the blob's surroundings, so wide that a kernel of that reach sees all from any place in the blob."""
    x, y, width, height = blob.box
    margin = reach + _SPARE_PX
    bottom, right = planes.shape
    return (
        slice(max(0, y - margin), min(bottom, y + height + margin)),
        slice(max(0, x - margin), min(right, x + width + margin)),
    )
