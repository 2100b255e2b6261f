"""The sun in ordinary and HDR images: the five estimators of Appendix A, and level circles for photographs."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sunarc.detection import estimators
from sunarc.detection.blob import Blob
from sunarc.detection.values import Image
from sunarc.errors import InputError

Plane = NDArray[np.float32]


class Estimates(NamedTuple):
    """What the single estimators say.

    columns, rows : their x and y, px: disc, Gaussian and flattened kernel, Förstner, and (x only) the smear where it
    stands out. diameter : of the sun's blob, px. sigma : of the kernels, px. blob : the blob.
    """

    columns: tuple[float, ...]
    rows: tuple[float, ...]
    diameter: float
    sigma: float
    blob: Blob

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
    """An image as fractions of full scale: V (the largest colour) and the mean of the colours, both (rows, columns)."""

    value: Plane
    grey: Plane


def planes_of(image: Image, *, full_scale: int) -> Planes:
    """Return V and grey of a mono (rows, columns) or colour (rows, columns, 3) image, uint8 or uint16.

    Raises
    ------
    InputError : another shape or type, or a full scale beyond it.
    """
    if image.ndim not in {2, 3} or (image.ndim == 3 and image.shape[2] != 3) or min(image.shape) < 1:
        raise InputError(
            field="image", problem=f"its shape is {image.shape}", remedy="give rows, columns (and 3 colours)"
        )
    if image.dtype not in (np.uint8, np.uint16) or not 0 < full_scale <= np.iinfo(image.dtype).max:
        raise InputError(
            field="image", problem=f"{image.dtype} with full scale {full_scale}", remedy="give uint8 or uint16 counts"
        )
    if image.ndim == 2:
        plane = image.astype(np.float32) * np.float32(1.0 / full_scale)
        return Planes(plane, plane)
    first, second, third = cv2.split(image)
    value = cv2.max(cv2.max(first, second), third).astype(np.float32) * np.float32(1.0 / full_scale)
    total = first.astype(np.float32) + second + third
    return Planes(np.asarray(value), np.asarray(total * np.float32(1.0 / 3.0 / full_scale)))


def locate(planes: Planes, *, apparent_zenith: float | None, full_image: bool = False) -> Estimates | None:
    """Return the five estimators' answers, or None where nothing is bright.

    Parameters
    ----------
    planes : of the image.
    apparent_zenith : of the sun, radians, which sets the kernels' width; without one the blob's radius does.
    full_image : convolve the whole image, as the paper does; otherwise only the sun's surroundings, which gives the
        same answer as long as nothing else in the image is as large and bright.
    """
    value = planes.value
    blob = estimators.sun_blob(value)
    if blob is None:
        return None
    sigma = estimators.gaussian_sigma_px(apparent_zenith) if apparent_zenith is not None else _blob_sigma(blob)
    kernels = estimators.kernels(diameter=blob.diameter, sigma=sigma)
    x0, y0, part = (0, 0, value) if full_image else _around(value, blob, kernels[0].shape[0])
    found = [estimators.strongest(part, kernel) for kernel in kernels]
    columns, rows = [x + x0 for x, _ in found], [y + y0 for _, y in found]
    smear = estimators.smear_column(value[0].astype(np.float64), 3.0 * planes.grey[0].astype(np.float64))
    middle = smear if smear is not None and abs(smear - blob.x) < blob.diameter else float(np.median(columns))
    x1 = max(0, round(middle - 5.0 * sigma - 0.5 * blob.diameter))
    strip = value[:, x1 : round(middle + 5.0 * sigma + 0.5 * blob.diameter) + 1]
    top, bottom = (0, value.shape[0]) if full_image else (y0, y0 + part.shape[0])
    x, y = estimators.forstner(np.ascontiguousarray(strip[top:bottom]), sigma=sigma)
    columns, rows = [*columns, x + x1], [*rows, y + top]
    return Estimates(tuple(columns if smear is None else [*columns, smear]), tuple(rows), blob.diameter, sigma, blob)


def _blob_sigma(blob: Blob) -> float:
    """Return a width at which Förstner's maximum is the centre of a ring of the blob's size (it must exceed Ø/4)."""
    return max(0.5 * blob.diameter, 1.0)


def _around(value: Plane, blob: Blob, kernel_size: int) -> tuple[int, int, Plane]:
    """Cut the blob's surroundings, so wide that its convolution's maximum sees all that it would in the whole image."""
    x, y, width, height = blob.box
    margin = kernel_size
    x0, y0 = max(0, x - margin), max(0, y - margin)
    part = value[y0 : y + height + margin, x0 : x + width + margin]
    return x0, y0, np.ascontiguousarray(part)
