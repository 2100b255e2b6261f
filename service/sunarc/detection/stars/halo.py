"""The light around stars, outside of their point spread: dew on the dome, haze and thin cloud raise it."""

from __future__ import annotations

import math

import numpy as np

from sunarc.array_types import BoolArray, FloatArray, Image
from sunarc.detection.stars.maxima import plane_of
from sunarc.detection.stars.values import Stars
from sunarc.detection.values import Bayer

_RING_WIDTHS, _GROUND_WIDTHS = (4.0, 7.0), (9.0, 12.0)
"""Radii over the 1-sigma of the point spread: a Gaussian has 3e-4 of its light beyond 4."""
_DARKER = 0.8
_BRIGHT_SNR, _MOST, _FEWEST = 50.0, 80, 8


def star_halo(image: Image, stars: Stars, *, full_scale: int, bayer: Bayer | None = None) -> float:
    """Return the light between 4 and 7 widths around stars over that within, the median of the bright unclipped ones.

    Of ring and of the ground around it the darker 80 % count, so that a neighbour does not. NaN of fewer than 8 stars.
    """
    usable = np.flatnonzero(stars.sound & (stars.snr > _BRIGHT_SNR) & (stars.flux > 0.0))[:_MOST]
    if usable.size < _FEWEST:
        return math.nan
    plane, _ = plane_of(image, full_scale, bayer)
    width = float(np.median(stars.width_px[usable]))
    reach = math.ceil(_GROUND_WIDTHS[1] * width)
    offset = np.arange(-reach, reach + 1)
    dy, dx = np.meshgrid(offset, offset, indexing="ij")
    radius = np.hypot(dx, dy) / width
    ring, ground = (_within(radius, limits) for limits in (_RING_WIDTHS, _GROUND_WIDTHS))
    column, row = np.rint(stars.pixels[usable]).astype(int).T
    inside = (column >= reach) & (row >= reach) & (column < plane.shape[1] - reach) & (row < plane.shape[0] - reach)
    if np.count_nonzero(inside) < _FEWEST:
        return math.nan
    values = plane[row[inside, None, None] + dy, column[inside, None, None] + dx].astype(np.float64)
    over = _lower_mean(values[:, ring]) - _lower_mean(values[:, ground])
    return float(np.median(over * np.count_nonzero(ring) / stars.flux[usable][inside]))


def _lower_mean(values: FloatArray) -> FloatArray:
    """Return the mean of the darker 80 % of each row: a median of counts is a whole count."""
    kept = int(_DARKER * values.shape[-1])
    return np.asarray(np.mean(np.partition(values, kept - 1, axis=-1)[:, :kept], axis=-1))


def _within(radius: FloatArray, limits: tuple[float, float]) -> BoolArray:
    return np.asarray((radius >= limits[0]) & (radius < limits[1]))
