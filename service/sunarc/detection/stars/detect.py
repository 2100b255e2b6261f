"""Detection of stars in one image."""

from __future__ import annotations

import math

import numpy as np

from sunarc.array_types import BoolArray, FloatArray, Image
from sunarc.detection.frames import require_photo
from sunarc.detection.stars.background import background_of
from sunarc.detection.stars.clipped import ClippedCores, clipped_cores
from sunarc.detection.stars.maxima import FAINTEST_SNR, MOST, maxima_of, plane_of
from sunarc.detection.stars.point_spread import Fitted, Stamps, axes_of, fit_point_spreads, inverse_shape, width_of
from sunarc.detection.stars.shape_map import (
    ALIKE,
    FIRST_WIDTH_PX,
    SHAPE_SNR,
    shape_at,
    shapes_of_bright,
    stamps_at,
    start_at,
)
from sunarc.detection.stars.values import Stars
from sunarc.detection.values import Bayer

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
