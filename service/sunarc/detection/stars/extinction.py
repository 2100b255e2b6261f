"""How much light the air takes: the brightness of named stars against their catalogue magnitude, over the air mass."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sunarc.array_types import FloatArray, IntArray
from sunarc.robust_statistics import biweights, mad_sigma

LOWEST_DEG = 78.0
"""Zenith angle of 4.7 air masses; below, haze and trees."""
_FEWEST_STARS, _LEAST_AIR_MASSES = 100, 1.0
_FEWEST_OF_AN_IMAGE = 8
_ROUNDS = 10


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StarLight:
    """Named, unclipped stars of one image.

    Attributes
    ----------
    zenith_deg : (n,) apparent.
    air_mass : (n,).
    magnitude : (n,) V of the catalogue, outside the air.
    rate : (n,) counts a second.
    """

    zenith_deg: FloatArray
    air_mass: FloatArray
    magnitude: FloatArray
    rate: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Extinction:
    """What the air takes, by the stars of several images.

    Attributes
    ----------
    per_air_mass : magnitudes; a lens that is darker towards its edge raises it.
    sigma : 1-sigma of it.
    zero_point : (images,) V of a star outside the air that gives one count a second; a haze that is the same over the
        sky lowers it, as dew does. NaN of an image with fewer than 8 stars.
    transparency : share of the light that arrives by band of zenith angle, of the one that the zero points state; NaN
        in bands with fewer than 8 stars.
    """

    per_air_mass: float
    sigma: float
    zero_point: FloatArray
    transparency: FloatArray


def extinction_of(images: Sequence[StarLight], bands_deg: Sequence[float]) -> Extinction:
    """Return the extinction that the stars of a night's images have in common, and each image's zero point.

    A robust straight line of the magnitudes that a star lost over its air mass: one slope, and a zero point for each
    image. NaN where there are fewer than 100 stars, or within less than one air mass.
    """
    air_mass, lost, image, zenith = _columns(images)
    counts = np.bincount(image, minlength=len(images))
    known = counts[image] >= _FEWEST_OF_AN_IMAGE
    air_mass, lost, image, zenith = air_mass[known], lost[known], image[known], zenith[known]
    nothing = np.full(len(images), math.nan)
    if air_mass.size < _FEWEST_STARS or np.ptp(air_mass) < _LEAST_AIR_MASSES:
        bands = np.full(len(bands_deg) - 1, math.nan)
        return Extinction(per_air_mass=math.nan, sigma=math.nan, zero_point=nothing, transparency=bands)
    weight, offset, slope, sigma = np.ones(air_mass.size), nothing.copy(), 0.0, math.nan
    for _ in range(_ROUNDS):
        middle = _weighted_means(np.stack([air_mass, lost]), image, weight, len(images))
        x, y = np.stack([air_mass, lost]) - middle[:, image]
        slope = float(np.sum(weight * x * y) / np.sum(weight * x**2))
        residual = y - slope * x
        scatter = max(mad_sigma(residual), 1e-3)
        sigma = scatter / math.sqrt(float(np.sum(weight * x**2)))
        offset = middle[1] - slope * middle[0]
        weight = biweights(residual / (4.0 * scatter))
    return Extinction(
        per_air_mass=slope,
        sigma=sigma,
        zero_point=-offset,
        transparency=_by_band(lost - offset[image], zenith, bands_deg),
    )


def _columns(
    images: Sequence[StarLight],
) -> tuple[FloatArray, FloatArray, IntArray, FloatArray]:
    """Return air masses, magnitudes lost, images and zenith angles of the stars above `LOWEST_DEG`, (n,) each."""
    none = np.zeros(0)
    used = [one.zenith_deg < LOWEST_DEG for one in images]
    pairs = list(zip(images, used, strict=True))
    lost = [-2.5 * np.log10(np.maximum(one.rate, 1e-9)) - one.magnitude for one in images]
    return (
        np.concatenate([none, *(one.air_mass[row] for one, row in pairs)]),
        np.concatenate([none, *(each[row] for each, row in zip(lost, used, strict=True))]),
        np.repeat(np.arange(len(images)), [int(np.count_nonzero(row)) for row in used]),
        np.concatenate([none, *(one.zenith_deg[row] for one, row in pairs)]),
    )


def _weighted_means(columns: FloatArray, image: IntArray, weight: FloatArray, n: int) -> FloatArray:
    """Return the means (columns, n) of each image; NaN of one without a weight."""
    total = np.bincount(image, weights=weight, minlength=n)
    sums = np.stack([np.bincount(image, weights=weight * column, minlength=n) for column in columns])
    return np.asarray(np.divide(sums, total, out=np.full(sums.shape, math.nan), where=total > 0.0))


def _by_band(lost: FloatArray, zenith_deg: FloatArray, bands_deg: Sequence[float]) -> FloatArray:
    shares = []
    for begin, end in itertools.pairwise(bands_deg):
        within = lost[(zenith_deg >= begin) & (zenith_deg < end)]
        shares.append(10.0 ** (-0.4 * float(np.median(within))) if within.size >= _FEWEST_OF_AN_IMAGE else math.nan)
    return np.array(shares)
