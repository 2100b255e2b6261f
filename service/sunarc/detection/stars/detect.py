"""Detection of stars in one image."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from scipy.spatial import cKDTree

from sunarc.array_types import BoolArray, FloatArray, Image
from sunarc.detection.frames import require_photo
from sunarc.detection.stars.background import Background, Plane, background_of
from sunarc.detection.stars.maxima import FAINTEST_SNR, MOST, maxima_of, plane_of
from sunarc.detection.stars.point_spread import Fitted, Stamps, axes_of, fit_point_spreads, inverse_shape, width_of
from sunarc.detection.stars.values import Stars
from sunarc.detection.values import Bayer
from sunarc.robust_statistics import biweights, mad_sigma

# Stars that are clipped so widely that no point spread can be fitted: where they are, roughly.

_FEWEST_PX = 14
"""Of the clipped pixels and those beside them: a smaller core leaves enough of a star's wings for a fit."""
_LARGEST_PX, _LONGEST = 900, 2.0
"""Of a star; and its longer side over its shorter one. Larger or longer: the moon, a lamp, an aircraft, a roof."""


class ClippedCores(NamedTuple):
    """Clipped regions: centres (n, 2) and radii (n,), px; flux (n,) in them, counts, too low; whether a star's."""

    pixels: FloatArray
    radius: FloatArray
    flux: FloatArray
    like_star: BoolArray


def clipped_cores(light: Plane, clipped: BoolArray, *, usable: BoolArray) -> ClippedCores:
    """Return the clipped regions of an image that are too large for a fit.

    Parameters
    ----------
    light : (rows, columns) counts above the background.
    clipped, usable : (rows, columns) clipped pixels and those beside them; where stars are looked for.
    """
    count, label, box, centre = cv2.connectedComponentsWithStats((clipped & usable).astype(np.uint8), connectivity=8)
    area = box[:, cv2.CC_STAT_AREA].astype(np.float64)
    flux = np.bincount(label.ravel(), weights=light.ravel(), minlength=count)
    sides = box[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].astype(np.float64)
    long = sides.max(axis=-1) / np.maximum(sides.min(axis=-1), 1.0)
    large = area >= _FEWEST_PX
    large[0] = False  # what is not clipped
    return ClippedCores(
        pixels=np.asarray(centre[large], dtype=np.float64),
        radius=np.sqrt(area[large] / math.pi),
        flux=np.asarray(flux[large], dtype=np.float64),
        like_star=((area <= _LARGEST_PX) & (long <= _LONGEST))[large],
    )


_MOVED_PX = 1.5
_FLOOR_PX = 0.01
"""1-sigma that is added: a point spread is no Gaussian, and a centre depends on where within a pixel it lies."""


def detect_stars(
    image: Image,
    *,
    full_scale: int,
    bayer: Bayer | None = None,
    gain_e_per_count: float | None = None,
    mask: BoolArray | None = None,
) -> Stars:
    """Find the point sources of an image of the night.

    Parameters
    ----------
    image : (rows, columns) or (rows, columns, 3), uint8 or uint16; the mean of the colours is used.
    full_scale : its largest count.
    bayer : colours of a raw mosaic.
    gain_e_per_count : electrons per count; None where unknown, or where counts are not proportional to light.
    mask : (rows, columns), True where nothing is looked for.

    Returns
    -------
    The stars above 5 times the noise, the brightest first, at most 2000. Their centres come of a fit of a Gaussian
    whose shape is that of the bright stars around, a quadratic function of the place in the image (elongation, coma).
    What is narrower or wider by far is left out. No star is no error.

    Raises
    ------
    InputError : the array is no image.
    """
    require_photo(image, full_scale=full_scale)
    plane, clipped = plane_of(image, full_scale, bayer)
    ground = background_of(plane, least_noise=1e-4 * full_scale)
    usable = np.ones(plane.shape, dtype=bool) if mask is None else ~mask
    first = maxima_of(plane, ground, clipped, usable, FIRST_WIDTH_PX)
    shapes = shapes_of_bright(plane, ground, clipped, first, gain_e_per_count)
    if shapes is None:
        return _none()
    width = float(np.median(width_of(shapes[1])))
    places = maxima_of(plane, ground, clipped, usable, width)
    expected = shape_at(*shapes, places, plane.shape)
    stamps, cut_off = stamps_at(plane, ground, clipped, places, width)
    fitted = fit_point_spreads(stamps, start_at(stamps, places, expected), gain_e=gain_e_per_count, shape=False)
    own = _own_shapes(stamps, fitted, expected, cut_off, gain_e_per_count)
    peak = (plane[tuple(places[:, ::-1].astype(int).T)] / full_scale).astype(np.float64)
    stars = _stars(fitted, own, expected, cut_off, peak)
    ratio = stars.width_px / width_of(expected)
    near = np.hypot(*(stars.pixels - places).T) < _MOVED_PX * max(width, 1.0)
    found = stars.select((ratio > ALIKE[0]) & (ratio < ALIKE[1]) & near & (stars.snr > FAINTEST_SNR))
    found = _with_cores(found, clipped_cores(plane - ground.level, clipped, usable=usable), width)
    return found.select(np.argsort(-found.flux, kind="stable")[:MOST])


def _with_cores(stars: Stars, cores: ClippedCores, width: float) -> Stars:
    """Return stars without what was found about clipped cores, and with these where they are like stars."""
    if cores.radius.size == 0:
        return stars
    reach = cores.radius + 3.0 * width
    distance = np.linalg.norm(stars.pixels[:, None] - cores.pixels[None], axis=-1)
    free: BoolArray = np.all(distance > reach, axis=-1)
    kept, some = stars.select(free), cores.like_star
    ones = np.ones(np.count_nonzero(some))
    added = {
        "pixels": cores.pixels[some],
        "sigma_px": 0.5 * cores.radius[some],
        "flux": cores.flux[some],
        "snr": np.inf * ones,
        "peak_fraction": ones,
        "width_px": width * ones,
        "ellipticity": 0.0 * ones,
        "saturated": ones > 0.0,
    }
    return Stars(**{name: np.concatenate([getattr(kept, name), column]) for name, column in added.items()})


def _own_shapes(
    stamps: Stamps, fitted: Fitted, expected: FloatArray, clipped: BoolArray, gain_e: float | None
) -> FloatArray:
    """Return covariances (n, 3) px²: each bright star's own, that of its place for the others."""
    bright = np.flatnonzero((_snr(fitted) > SHAPE_SNR) & ~clipped)
    part = Stamps(*(column[bright] for column in stamps))
    own = fit_point_spreads(part, fitted.parameters[bright], gain_e=gain_e, shape=True)
    shape = expected.copy()
    shape[bright] = inverse_shape(own.parameters[:, 4:])
    return shape


def _stars(fitted: Fitted, own: FloatArray, expected: FloatArray, clipped: BoolArray, peak: FloatArray) -> Stars:
    minor, major = axes_of(own)
    return Stars(
        pixels=fitted.parameters[:, :2],
        sigma_px=np.sqrt(fitted.position_variance * np.maximum(fitted.chi2, 1.0) + _FLOOR_PX**2),
        flux=fitted.parameters[:, 2] * 2.0 * math.pi * width_of(expected) ** 2,
        snr=_snr(fitted),
        peak_fraction=peak,
        width_px=np.sqrt(minor * major),
        ellipticity=1.0 - minor / np.maximum(major, 1e-12),
        saturated=clipped,
    )


def _snr(fitted: Fitted) -> FloatArray:
    return np.asarray(fitted.parameters[:, 2] / np.sqrt(np.maximum(fitted.height_variance, 1e-30)))


def _none() -> Stars:
    empty = np.zeros(0)
    return Stars(
        pixels=np.zeros((0, 2)), sigma_px=empty, flux=empty, snr=empty, peak_fraction=empty, width_px=empty,
        ellipticity=empty, saturated=np.zeros(0, dtype=bool),
    )  # fmt: skip


# The shape of the point spread over the image, by its bright stars.

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
