"""The sun in ordinary and HDR images: the five estimators of Appendix A."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sunarc.common.array_types import FloatArray, Image
from sunarc.common.robust_statistics import mad_sigma
from sunarc.detection.photo.plateau import Blob, largest_blobs, opened
from sunarc.detection.values import require_photo

# The five estimators of the paper's Appendix A, each on the V-image (the largest of red, green and blue).
#
# Where the paper is silent: the erosion and dilation take a pixel and its four neighbours; the threshold itself
# belongs
# to the bright region; the diameter is that of the circle of the same area; the Förstner window is a Gaussian of
# standard
# deviation sigma, cut at the stated 7.5 sigma columns (in a flat window larger than the sun every place that holds it
# all
# is as good); ties are averaged.

_PERCENTILE = 99.99
_SIGMA_CAP_PX = 24.0
_SMEAR_AVERAGE = 100
_SMEAR_STANDS_OUT = 25.0


def gaussian_sigma_px(apparent_zenith: float) -> float:
    """Return the kernels' standard deviation, min(3 (ln(91° - zenith))² + 1, 24) px.

    The square is read as that of the logarithm, the zenith angle (radians here) as the apparent one.
    """
    argument = max(91.0 - math.degrees(apparent_zenith), 1.0)
    return min(3.0 * math.log(argument) ** 2 + 1.0, _SIGMA_CAP_PX)


def sun_blob(counts: Image) -> Blob | None:
    """Return the largest region at or above the 99.99th percentile of the V-image, after erosion and dilation."""
    bins = int(np.iinfo(counts.dtype).max) + 1
    histogram = np.asarray(cv2.calcHist([np.ascontiguousarray(counts)], [0], None, [bins], [0, bins])).ravel()
    # A percentile by histogram: counts are whole numbers, so that millions of pixels need not be sorted.
    brighter = np.cumsum(histogram[::-1], dtype=np.float64)[::-1]
    level = int(np.flatnonzero(brighter >= max((1.0 - _PERCENTILE / 100.0) * counts.size, 1.0))[-1])
    mask = (counts >= level).astype(np.uint8)
    found = largest_blobs(opened(mask, 3), most=1)
    return found[0] if found else None


def kernels(*, diameter: float, sigma: float) -> tuple[Plane, Plane, Plane]:
    """Return the three kernels: binary disc, Gaussian, Gaussian with a flat top of the sun's diameter; sums are 1."""
    half = math.ceil(max(diameter / 2.0, 4.0 * sigma) + 1.0)
    rows, columns = np.mgrid[-half : half + 1, -half : half + 1]
    radius = np.hypot(rows, columns)
    disc = (radius <= diameter / 2.0).astype(np.float64)
    gaussian = np.exp(-0.5 * (radius / sigma) ** 2)
    flattened = np.minimum(gaussian, math.exp(-0.5 * (diameter / 2.0 / sigma) ** 2))
    first, second, third = ((kernel / kernel.sum()).astype(np.float32) for kernel in (disc, gaussian, flattened))
    return first, second, third


def strongest(value: Plane, kernel: Plane) -> tuple[float, float]:
    """Return x, y of the maximum of the plane convolved with a symmetric kernel; beyond the edge it is dark."""
    response = cv2.filter2D(value, cv2.CV_32F, kernel, borderType=cv2.BORDER_CONSTANT)
    return find_peak(np.asarray(response))


def find_peak(response: Plane) -> tuple[float, float]:
    """Return x, y of the maximum; the mean where several places are as high to within rounding."""
    top = float(response.max())
    rows, columns = np.nonzero(response >= top - 2e-6 * max(abs(top), 1e-30))
    return float(columns.mean()), float(rows.mean())


def smear_column(value_row: FloatArray, sum_row: FloatArray) -> float | None:
    """Return the column of the sensor's vertical smear from the first row of V and of R + G + B.

    Each row loses its moving average over 100 px; the peak of their product is the column. None where no peak stands
    out, as with a sensor that does not smear.
    """
    if value_row.size < 2 * _SMEAR_AVERAGE:
        return None
    box = np.ones(_SMEAR_AVERAGE) / _SMEAR_AVERAGE
    # At the ends the box covers fewer pixels: without the weight both ends would look bright.
    weight = np.convolve(np.ones(value_row.size), box, mode="same")
    above = [row - np.convolve(row, box, mode="same") / weight for row in (value_row, sum_row)]
    product = above[0] * above[1]
    scale = max(mad_sigma(product), 1e-12)
    column = int(np.argmax(product))
    return float(column) if product[column] > _SMEAR_STANDS_OUT * scale else None


def forstner(value: Plane, *, sigma: float, within: tuple[slice, slice] | None = None) -> tuple[float, float]:
    """Return x, y of the largest minor eigenvalue of the window's gradient matrix (Förstner and Gülch 1987).

    within : rows and columns among which it is looked for; None is all.
    """
    dx = cv2.Sobel(value, cv2.CV_32F, 1, 0, ksize=3)
    dy = cv2.Sobel(value, cv2.CV_32F, 0, 1, ksize=3)
    size = 2 * math.ceil(3.75 * sigma) + 1
    products = (dx * dx, dx * dy, dy * dy)
    if within is None:
        xx, xy, yy = (
            np.asarray(cv2.GaussianBlur(product, (size, size), sigma, borderType=cv2.BORDER_CONSTANT))
            for product in products
        )
    else:
        down, across = (_blur_matrix(n, part, size, sigma) for n, part in zip(value.shape, within, strict=True))
        xx, xy, yy = (down @ np.asarray(product) @ across.T for product in products)
    minor = 0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy)
    x, y = find_peak(np.asarray(minor, dtype=np.float32))
    return (x, y) if within is None else (x + within[1].start, y + within[0].start)


def _blur_matrix(length: int, part: slice, size: int, sigma: float) -> Plane:
    """Return the matrix (places, length) that blurs a row of this length, and keeps some places only."""
    kernel = np.asarray(cv2.getGaussianKernel(size, sigma, cv2.CV_32F)).ravel()
    tap = np.arange(length) - np.arange(part.start, part.stop)[:, None] + size // 2
    return np.where((tap >= 0) & (tap < size), kernel[np.clip(tap, 0, size - 1)], np.float32(0.0))


Plane = NDArray[np.float32]

_ALL = slice(None)
_SPARE_PX = 8


class Estimates(NamedTuple):
    """Estimates of the single estimators.

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
        """Return the mean of the colours over a window of the image, as fractions of full scale."""
        part = self.image[rows, columns].astype(np.float32)
        mean = part if part.ndim == 2 else cv2.transform(part, np.full((1, 3), 1.0 / 3.0, np.float32))
        return np.asarray(mean, dtype=np.float32) * np.float32(1.0 / self.full_scale)

    def part(self, rows: slice, columns: slice) -> Planes:
        """Return a rectangle of the image."""
        return Planes(self.counts[rows, columns], self.image[rows, columns], self.full_scale)


def split_planes(image: Image, *, full_scale: int) -> Planes:
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
    blob = sun_blob(planes.counts)
    if blob is None:
        return None
    sigma = gaussian_sigma_px(apparent_zenith) if apparent_zenith is not None else _ring_filter_sigma(blob)
    cut_out = kernels(diameter=blob.diameter, sigma=sigma)
    rows, columns = (_ALL, _ALL) if full_image else surroundings(planes, blob, cut_out[0].shape[0] // 2)
    part = planes.value(rows, columns)
    found = [strongest(part, kernel) for kernel in cut_out]
    xs, ys = [x + (columns.start or 0) for x, _ in found], [y + (rows.start or 0) for _, y in found]
    first_row = slice(0, 1)
    smear = smear_column(
        planes.value(first_row)[0].astype(np.float64), 3.0 * planes.grey(first_row)[0].astype(np.float64)
    )
    middle = smear if smear is not None and abs(smear - blob.x) < blob.diameter else float(np.median(xs))
    half = 5.0 * sigma + 0.5 * blob.diameter
    strip = slice(max(0, round(middle - half)), round(middle + half) + 1)
    surrounded = planes.value(rows, strip)
    within = None if full_image else centre_window(surrounded.shape, blob, first=(strip.start, rows.start))
    x, y = forstner(surrounded, sigma=sigma, within=within)
    xs, ys = [*xs, x + strip.start], [*ys, y + (rows.start or 0)]
    return Estimates(tuple(xs if smear is None else [*xs, smear]), tuple(ys), blob.diameter, sigma)


def centre_window(shape: tuple[int, ...], blob: Blob, *, first: tuple[int, int]) -> tuple[slice, slice]:
    """Return the rows and columns of a window at `first` (x, y) in which the blob's centre must lie."""
    (x, y, width, height), (x0, y0) = blob.box, first
    top, left = max(0, y - _SPARE_PX - y0), max(0, x - _SPARE_PX - x0)
    return (
        slice(top, max(top + 1, min(shape[0], y + height + _SPARE_PX - y0))),
        slice(left, max(left + 1, min(shape[1], x + width + _SPARE_PX - x0))),
    )


def _ring_filter_sigma(blob: Blob) -> float:
    """Return a width at which Förstner's maximum is the centre of a ring of the blob's size (it must exceed Ø/4)."""
    return max(0.5 * blob.diameter, 1.0)


def surroundings(planes: Planes, blob: Blob, reach: int) -> tuple[slice, slice]:
    """Return the blob's surroundings, so wide that a kernel of that reach sees all from any place in the blob."""
    x, y, width, height = blob.box
    margin = reach + _SPARE_PX
    bottom, right = planes.shape
    return (
        slice(max(0, y - margin), min(bottom, y + height + margin)),
        slice(max(0, x - margin), min(right, x + width + margin)),
    )
