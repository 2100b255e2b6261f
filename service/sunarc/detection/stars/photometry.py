"""Photometry of a night's stars: extinction, completeness, the light around them, their trend over the night."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Gt
from scipy.spatial import cKDTree

from sunarc.common.array_types import BoolArray, FloatArray, Image, IntArray
from sunarc.common.bounds import require_bounds
from sunarc.common.robust_statistics import biweights, mad_sigma
from sunarc.detection.stars.detect import light_plane
from sunarc.detection.values import Bayer, PredictedStars, Stars

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
    """Extinction of the air, by the stars of several images.

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


def fit_extinction(images: Sequence[StarLight], bands_deg: Sequence[float]) -> Extinction:
    """Return the extinction that the stars of a night's images have in common, and each image's zero point.

    A robust straight line of the magnitudes that a star lost over its air mass: one slope, and a zero point for each
    image. NaN where there are fewer than 100 stars, or within less than one air mass.
    """
    air_mass, lost, image, zenith = _make_star_columns(images)
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
        transparency=_light_share_by_band(lost - offset[image], zenith, bands_deg),
    )


def _make_star_columns(
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


def _light_share_by_band(lost: FloatArray, zenith_deg: FloatArray, bands_deg: Sequence[float]) -> FloatArray:
    shares = []
    for begin, end in itertools.pairwise(bands_deg):
        within = lost[(zenith_deg >= begin) & (zenith_deg < end)]
        shares.append(10.0 ** (-0.4 * float(np.median(within))) if within.size >= _FEWEST_OF_AN_IMAGE else math.nan)
    return np.array(shares)


ZENITH_BANDS_DEG = (0.0, 30.0, 50.0, 65.0, 78.0)
"""Limits of zenith angle: to 1.15, 1.55, 2.35 and 4.7 air masses; below 78 degrees are haze and trees."""
_SIGMAS, _SEEING_PX = 3.0, 0.5
"""Distance of a star from its predicted place: 1-sigma of the centres in addition to the prediction's, px."""
_STEP_V, _ROLL_OFF_V = 0.05, 0.25
"""Of the magnitudes tried, and how soft the end is: from 0.88 to 0.12 of the stars within a magnitude."""
_BRIGHTEST_V = 1.0
_SHARES = np.linspace(0.05, 0.995, 64)
_FEWEST_OF_A_BAND = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class ZenithBand:
    """Predicted stars of a band of zenith angles, and those that are detected.

    Attributes
    ----------
    from_deg, to_deg : zenith angles.
    predicted, found : counts.
    """

    from_deg: float
    to_deg: float
    predicted: int
    found: int


def detected(stars: Stars, predicted: PredictedStars) -> BoolArray:
    """Return (n,) which of the predicted stars have a detection at their place, within 3 sigma."""
    if len(stars) == 0:
        return np.zeros(len(predicted), dtype=np.bool_)
    distance = np.asarray(cKDTree(stars.pixels).query(predicted.pixels)[0])
    return np.asarray(distance < _SIGMAS * np.hypot(predicted.sigma_px, _SEEING_PX))


def zenith_bands(zenith_deg: FloatArray, found: BoolArray) -> tuple[ZenithBand, ...]:
    """Return how many of the predicted stars are detected by bands of zenith angle, (n,) degrees."""
    limits = itertools.pairwise(ZENITH_BANDS_DEG)
    within = [(begin, end, (zenith_deg >= begin) & (zenith_deg < end)) for begin, end in limits]
    return tuple(
        ZenithBand(
            from_deg=begin, to_deg=end, predicted=int(np.count_nonzero(row)), found=int(np.count_nonzero(found[row]))
        )
        for begin, end, row in within
    )


def limiting_magnitude(magnitude: FloatArray, found: BoolArray) -> float:
    """Return the V at which half as many stars are detected as of the bright ones; NaN of fewer than 20 stars.

    The most probable end of a detection probability that falls from a constant share (the sky that is free of cloud) to
    0 as a logistic function of the magnitude. It is never beyond the faintest star given.

    Parameters
    ----------
    magnitude : (n,) V of the predicted stars, with the air's extinction.
    found : (n,) which are detected.
    """
    if magnitude.size < _FEWEST_OF_A_BAND or not np.any(found):
        return math.nan
    faintest = float(magnitude.max())
    ends = np.arange(_BRIGHTEST_V, max(faintest, _BRIGHTEST_V) + _STEP_V / 2.0, _STEP_V)
    fall = 1.0 / (1.0 + np.exp(np.clip((magnitude[None] - ends[:, None]) / _ROLL_OFF_V, -40.0, 40.0)))
    missed = [np.sum(np.log1p(-share * fall[:, ~found]), axis=-1) for share in _SHARES]
    hit = [np.sum(np.log(share * fall[:, found] + 1e-12), axis=-1) for share in _SHARES]
    likelihood = np.max(np.array(missed) + np.array(hit), axis=0)
    return min(float(ends[int(np.argmax(likelihood))]), faintest)


_FEWEST_IMAGES = 6
_PARTS = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class NightLimits:
    """Limits of a night's numbers, beyond which dew or a lost focus is suspected.

    Attributes
    ----------
    width_growth : of the stars' width, its last third over its first.
    halo_growth : growth of the halo's share of the light, absolute.
    fading_mag : loss of brightness over the night, magnitudes.
    width_ratio : of a night's width over that of the nights before.
    nights : nights in a row with such a ratio.
    """

    width_growth: Annotated[float, Gt(1.0)] = 1.1
    halo_growth: Annotated[float, Gt(0.0)] = 0.05
    fading_mag: Annotated[float, Gt(0.0)] = 0.25
    width_ratio: Annotated[float, Gt(1.0)] = 1.2
    nights: int = 2

    def __post_init__(self) -> None:
        """Refuse invalid limits."""
        require_bounds(self, section_path="night")


@dataclass(frozen=True, slots=True, kw_only=True)
class NightTrend:
    """Change from the beginning to the end of a night; NaN where fewer than 6 images have the number.

    Attributes
    ----------
    width_growth : ratio of the stars' widths.
    halo_growth : difference of the halo's share of the light.
    fading_mag : difference of the zero points, magnitudes; positive: fainter.
    """

    width_growth: float
    halo_growth: float
    fading_mag: float


def night_trend(width: FloatArray, halo: FloatArray, zero_point: FloatArray) -> NightTrend:
    """Return the medians of the last third of a night's images against those of its first, (n,) in their order."""
    first, last = zip(*(_medians_of_end_thirds(column) for column in (width, halo, zero_point)), strict=True)
    return NightTrend(
        width_growth=last[0] / first[0] if first[0] > 0.0 else math.nan,
        halo_growth=last[1] - first[1],
        fading_mag=first[2] - last[2],
    )


def dew_suspected(trend: NightTrend, limits: NightLimits) -> bool:
    """Return whether the stars grew wider, or their halo brighter, while they faded."""
    spread = trend.width_growth >= limits.width_growth or trend.halo_growth >= limits.halo_growth
    return spread and trend.fading_mag >= limits.fading_mag


def focus_ratio(widths: Sequence[float], limits: NightLimits) -> float | None:
    """Return how much wider the stars are than they were, where that holds for the last nights in a row; else None.

    Parameters
    ----------
    widths : of clear nights, the newest first; the nights before the last ones are the reference, 3 at least.
    limits : how much, and for how many nights.
    """
    known = [width for width in widths if math.isfinite(width) and width > 0.0]
    last, before = known[: limits.nights], known[limits.nights :]
    if len(last) < limits.nights or len(before) < _PARTS:
        return None
    ratio = min(last) / float(np.median(before))
    return ratio if ratio >= limits.width_ratio else None


def _medians_of_end_thirds(column: FloatArray) -> tuple[float, float]:
    """Return the medians of the first and of the last third of the numbers that are known."""
    known = column[np.isfinite(column)]
    if known.size < _FEWEST_IMAGES:
        return math.nan, math.nan
    part = known.size // _PARTS
    return float(np.median(known[:part])), float(np.median(known[-part:]))


_RING_WIDTHS, _GROUND_WIDTHS = (4.0, 7.0), (9.0, 12.0)
"""Radii over the 1-sigma of the point spread: a Gaussian has 3e-4 of its light beyond 4."""
_DARKER = 0.8
_BRIGHT_SNR, _MOST, _FEWEST_RINGS = 50.0, 80, 8


def star_halo(image: Image, stars: Stars, *, full_scale: int, bayer: Bayer | None = None) -> float:
    """Return the light between 4 and 7 widths around stars over that within, the median of the bright unclipped ones.

    Of ring and of the ground around it the darker 80 % count, so that a neighbour does not. NaN of fewer than 8 stars.
    """
    usable = np.flatnonzero(stars.sound & (stars.snr > _BRIGHT_SNR) & (stars.flux > 0.0))[:_MOST]
    if usable.size < _FEWEST_RINGS:
        return math.nan
    plane, _ = light_plane(image, full_scale, bayer)
    width = float(np.median(stars.width_px[usable]))
    reach = math.ceil(_GROUND_WIDTHS[1] * width)
    offset = np.arange(-reach, reach + 1)
    dy, dx = np.meshgrid(offset, offset, indexing="ij")
    radius = np.hypot(dx, dy) / width
    ring, ground = (_is_within(radius, limits) for limits in (_RING_WIDTHS, _GROUND_WIDTHS))
    column, row = np.rint(stars.pixels[usable]).astype(int).T
    inside = (column >= reach) & (row >= reach) & (column < plane.shape[1] - reach) & (row < plane.shape[0] - reach)
    if np.count_nonzero(inside) < _FEWEST_RINGS:
        return math.nan
    values = plane[row[inside, None, None] + dy, column[inside, None, None] + dx].astype(np.float64)
    over = _lower_mean(values[:, ring]) - _lower_mean(values[:, ground])
    return float(np.median(over * np.count_nonzero(ring) / stars.flux[usable][inside]))


def _lower_mean(values: FloatArray) -> FloatArray:
    """Return the mean of the darker 80 % of each row: a median of counts is a whole count."""
    kept = int(_DARKER * values.shape[-1])
    return np.asarray(np.mean(np.partition(values, kept - 1, axis=-1)[:, :kept], axis=-1))


def _is_within(radius: FloatArray, limits: tuple[float, float]) -> BoolArray:
    return np.asarray((radius >= limits[0]) & (radius < limits[1]))
