"""The shape of the point spread over the image, by its bright stars."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree

from sunarc.array_types import BoolArray, FloatArray
from sunarc.detection.stars.background import Background, Plane
from sunarc.detection.stars.maxima import FAINTEST_SNR
from sunarc.detection.stars.point_spread import Stamps, axes_of, fit_point_spreads, inverse_shape, width_of
from sunarc.robust_statistics import biweights, mad_sigma

FIRST_WIDTH_PX = 1.2
"""1-sigma of the point spread to begin with: that of real lenses is 0.8 to 2."""
SHAPE_SNR = 20.0
"""Of stars whose own shape is known to 5 %."""
ALIKE = (0.6, 1.7)
"""Widths over that of the point spread that a star may have: hot pixels are narrower, clouds, lamps, trails wider."""
_SHAPES = 300
"""Bright stars that tell the point spread's shape; a quadratic over the image has six numbers each."""
_FEW = 25


def stamps_at(
    plane: Plane, ground: Background, clipped: BoolArray, places: FloatArray, width: float
) -> tuple[Stamps, BoolArray]:
    """Return the pixels around places, and whether clipped ones are among those near each."""
    reach = min(max(math.ceil(3.5 * width), 3), 15)
    offset = np.arange(-reach, reach + 1)
    dy, dx = (part.ravel() for part in np.meshgrid(offset, offset, indexing="ij"))
    x, y = places[:, :1].astype(int) + dx, places[:, 1:].astype(int) + dy
    inside = (x >= 0) & (y >= 0) & (x < plane.shape[1]) & (y < plane.shape[0])
    column, row = np.clip(x, 0, plane.shape[1] - 1), np.clip(y, 0, plane.shape[0] - 1)
    nearest = cKDTree(places).query(np.stack([x, y], axis=-1))[1]
    own = nearest == np.arange(places.shape[0])[:, None]
    full = clipped[row, column]
    used = inside & own & ~full
    variance = np.where(used, ground.noise[row, column].astype(np.float64) ** 2, np.inf)
    value = (plane[row, column] - ground.level[row, column]).astype(np.float64)
    near = np.hypot(dx, dy) <= 2.0 * width + 1.0
    return Stamps(x.astype(float), y.astype(float), value, variance), np.any(full & near & own, axis=-1)


def start_at(stamps: Stamps, places: FloatArray, shape: FloatArray) -> FloatArray:
    """Return (n, 7) parameters to begin at: the middle pixels, and covariances (n, 3) px² of the point spread."""
    middle = stamps.value.shape[1] // 2
    height = np.maximum(stamps.value[:, middle], 1e-3)
    return np.column_stack([places, height, np.zeros(height.size), inverse_shape(shape)])


def shapes_of_bright(
    plane: Plane, ground: Background, clipped: BoolArray, places: FloatArray, gain_e: float | None
) -> tuple[FloatArray, FloatArray] | None:
    """Return places (k, 2) and covariances (k, 3) px² of the point spread of bright stars; None where there is none."""
    if places.shape[0] == 0:
        return None
    width, wanted = FIRST_WIDTH_PX, places[: 4 * _SHAPES]
    for _ in range(2):  # the second time with stamps of the right size
        stamps, cut_off = stamps_at(plane, ground, clipped, wanted, width)
        start = start_at(stamps, wanted, np.tile([width**2, 0.0, width**2], (wanted.shape[0], 1)))
        fitted = fit_point_spreads(stamps, start, gain_e=gain_e, shape=True)
        shape = inverse_shape(fitted.parameters[:, 4:])
        minor, major = axes_of(shape)
        snr = fitted.parameters[:, 2] / np.sqrt(np.maximum(fitted.height_variance, 1e-30))
        good = ~cut_off & (minor > 0.25) & (major < 8.0) & (major < 3.0 * minor) & (snr > FAINTEST_SNR)
        if not np.any(good):
            return None
        # at least one: the brighter half of them
        bright = good & (snr >= min(SHAPE_SNR, float(np.quantile(snr[good], 0.5))))
        width = float(np.median(np.sqrt(minor * major)[bright]))
        typical = bright & (np.abs(np.log(np.sqrt(minor * major) / width)) < math.log(ALIKE[1]))
        if not np.any(typical):
            return None  # two of widths that have nothing in common
    return wanted[typical][:_SHAPES], shape[typical][:_SHAPES]


def shape_at(known: FloatArray, shape: FloatArray, places: FloatArray, size: tuple[int, ...]) -> FloatArray:
    """Return covariances (n, 3) at places: a quadratic function of the place through those known, without outliers."""
    if known.shape[0] < _FEW:
        return np.tile(np.median(shape, axis=0), (places.shape[0], 1))
    design, weight = _quadratic(known, size), np.ones(known.shape[0])
    for _ in range(6):
        rows = np.sqrt(weight)[:, None]
        coefficients = np.linalg.lstsq(design * rows, shape * rows, rcond=None)[0]
        distance = np.linalg.norm(shape - design @ coefficients, axis=-1)
        weight = biweights(distance / max(4.0 * mad_sigma(distance), 1e-6))
    smooth = _quadratic(places, size) @ coefficients
    minor, major = axes_of(smooth)
    middle = float(np.median(width_of(shape)))
    # far from all bright stars a quadratic may be no shape at all
    bad = ~((minor > 0.4 * middle) & (major < 2.5 * middle))
    smooth[bad] = np.median(shape, axis=0)
    return np.asarray(smooth)


def _quadratic(places: FloatArray, size: tuple[int, ...]) -> FloatArray:
    x, y = (2.0 * places / np.array(size[::-1]) - 1.0).T
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
