"""The five estimators of the paper's Appendix A, each on the V-image (the largest of red, green and blue).

Where the paper is silent: the erosion and dilation take a pixel and its four neighbours; the threshold itself belongs
to the bright region; the diameter is that of the circle of the same area; the Förstner window is a Gaussian of standard
deviation sigma, cut at the stated 7.5 sigma columns (in a flat window larger than the sun every place that holds it all
is as good); ties are averaged.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from sunarc.array_types import FloatArray, Image
from sunarc.detection.photo.blob import Blob, blobs_of, opened
from sunarc.robust_statistics import mad_sigma

Plane = NDArray[np.float32]

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
    found = blobs_of(opened(mask, 3), most=1)
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
    return peak_of(np.asarray(response))


def peak_of(response: Plane) -> tuple[float, float]:
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
        down, across = (_blur(n, part, size, sigma) for n, part in zip(value.shape, within, strict=True))
        xx, xy, yy = (down @ np.asarray(product) @ across.T for product in products)
    minor = 0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy)
    x, y = peak_of(np.asarray(minor, dtype=np.float32))
    return (x, y) if within is None else (x + within[1].start, y + within[0].start)


def _blur(length: int, part: slice, size: int, sigma: float) -> Plane:
    """Return the matrix (places, length) that blurs a row of this length, and keeps some places only."""
    kernel = np.asarray(cv2.getGaussianKernel(size, sigma, cv2.CV_32F)).ravel()
    tap = np.arange(length) - np.arange(part.start, part.stop)[:, None] + size // 2
    return np.where((tap >= 0) & (tap < size), kernel[np.clip(tap, 0, size - 1)], np.float32(0.0))
