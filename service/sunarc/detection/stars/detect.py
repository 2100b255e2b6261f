"""Detection of stars in one image: background, matched filter, fit of the point spread; warm pixels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import reduce
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from sunarc import _kernels
from sunarc.common.array_types import BoolArray, FloatArray, Image, IntArray
from sunarc.common.robust_statistics import MAD_TO_SIGMA, biweights, mad_sigma
from sunarc.detection.values import Bayer, Stars, require_photo

Plane = NDArray[np.float32]

_TILE_PX = 32
"""Large against a star (a dozen px), small against the gradients of glow and of the Milky Way (hundreds)."""


class Background(NamedTuple):
    """Level and 1-sigma noise of every pixel, counts, each (rows, columns)."""

    level: Plane
    noise: Plane


def estimate_background(plane: Plane, *, least_noise: float) -> Background:
    """Return the background of an image and its noise, without its stars.

    The median of each tile of 32 px, and the scatter about it by the median absolute deviation from the smooth level,
    both interpolated between the tiles' centres.

    Parameters
    ----------
    plane : (rows, columns) counts.
    least_noise : counts; a flat or clipped patch has no less.
    """
    tiles, shape = _split_into_tiles(plane)
    median = _smooth_grid(np.median(tiles, axis=-1).reshape(shape))
    level = _interpolate_grid(median, plane)
    deviation, _ = _split_into_tiles(np.abs(plane - level))
    noise = MAD_TO_SIGMA * np.median(deviation, axis=-1).reshape(shape)
    return Background(level, np.maximum(_interpolate_grid(_smooth_grid(noise), plane), np.float32(least_noise)))


def _split_into_tiles(plane: Plane) -> tuple[Plane, tuple[int, int]]:
    """Return the pixels of each tile, (tiles, pixels), and how many tiles there are down and across."""
    rows, columns = (-(-size // _TILE_PX) for size in plane.shape)
    padded = np.pad(
        plane, ((0, rows * _TILE_PX - plane.shape[0]), (0, columns * _TILE_PX - plane.shape[1])), mode="reflect"
    )
    parts = padded.reshape(rows, _TILE_PX, columns, _TILE_PX).swapaxes(1, 2)
    return parts.reshape(rows * columns, -1), (rows, columns)


def _smooth_grid(grid: Plane) -> Plane:
    """Return a grid of tiles with the median of each tile and its neighbours: a bright star leaves no hill."""
    return np.asarray(cv2.medianBlur(grid.astype(np.float32), 3), dtype=np.float32)


def _interpolate_grid(grid: Plane, plane: Plane) -> Plane:
    """Return a grid of tiles interpolated to the pixels."""
    rows, columns = grid.shape
    whole = cv2.resize(grid, (columns * _TILE_PX, rows * _TILE_PX), interpolation=cv2.INTER_LINEAR)
    return np.asarray(whole[: plane.shape[0], : plane.shape[1]], dtype=np.float32)


FAINTEST_SNR = 5.0
"""Over noise that is normal, 5 sigma leave one false maximum in about a million pixels."""
MOST = 2000
"""Stars of one image; the catalogue has 1400 above the horizon."""
_CLIPPED = 0.97
"""Of full scale; JPEG's blocks take a clipped level down by so much."""
_COLOURS = {
    "RGGB": cv2.COLOR_BayerRGGB2RGB,
    "BGGR": cv2.COLOR_BayerBGGR2RGB,
    "GRBG": cv2.COLOR_BayerGRBG2RGB,
    "GBRG": cv2.COLOR_BayerGBRG2RGB,
}


def light_plane(image: Image, full_scale: int, bayer: Bayer | None) -> tuple[Plane, BoolArray]:
    """Return the light of an image, counts, and where it is clipped in any colour, or next to such a pixel."""
    colours = cv2.cvtColor(image, _COLOURS[bayer]) if bayer is not None and image.ndim == 2 else image
    parts = [colours[..., one] for one in range(colours.shape[2])] if colours.ndim == 3 else [colours]
    top = reduce(np.maximum, parts)
    clipped = cv2.dilate((top >= _CLIPPED * full_scale).astype(np.uint8), np.ones((3, 3), dtype=np.uint8)) > 0
    light = reduce(np.add, [one.astype(np.float32) for one in parts]) / np.float32(len(parts))
    return np.asarray(light), np.asarray(clipped)


def find_maxima(plane: Plane, ground: Background, clipped: BoolArray, usable: BoolArray, width: float) -> FloatArray:
    """Return the places (n, 2) where a Gaussian of a width stands out by 5 sigma, the brightest first."""
    ratio = (plane - ground.level) / ground.noise
    ratio[~usable] = 0.0
    size = 2 * math.ceil(3.0 * width) + 1
    kernel = cv2.getGaussianKernel(size, width)
    response = cv2.sepFilter2D(ratio, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_REFLECT) / float(
        np.sum(kernel**2)
    )
    apart = 2 * round(1.5 * width) + 1
    highest = cv2.dilate(response.astype(np.float32), np.ones((apart, apart), dtype=np.uint8))
    is_top = (response >= highest) & (response > FAINTEST_SNR) & usable
    edge = math.ceil(width) + 1
    is_top[:edge] = is_top[-edge:] = False
    is_top[:, :edge] = is_top[:, -edge:] = False
    rows, columns = np.nonzero(is_top)
    # a clipped plateau has many equal maxima: the first of each counts
    order = np.argsort(-response[rows, columns], kind="stable")
    places = np.stack([columns, rows], axis=-1)[order].astype(np.float64)
    places = _remove_close(_spread_over_parts(places, plane.shape, 2 * MOST), apart * (1.0 + np.any(clipped)))
    return _spread_over_parts(places, plane.shape, MOST)


_PARTS_ACROSS = 8
"""Of an image: lamps, roofs and trees about the horizon are in few of its 64 parts."""


def _spread_over_parts(places: FloatArray, size: tuple[int, ...], most: int) -> FloatArray:
    """Return at most so many places, in their order: the first of each part of an image, then the next of each."""
    if places.shape[0] <= most:
        return places
    column, row = np.floor(places / np.array(size[::-1]) * _PARTS_ACROSS).astype(np.int64).T
    return places[np.sort(np.argsort(rank_in_part(_PARTS_ACROSS * row + column), kind="stable")[:most])]


def rank_in_part(part: IntArray) -> IntArray:
    """Return (n,): how many of the same part come before each."""
    order = np.argsort(part, kind="stable")
    rank = np.empty(order.size, dtype=np.int64)
    rank[order] = np.arange(order.size) - np.searchsorted(part[order], part[order])
    return rank


def _remove_close(places: FloatArray, apart: float) -> FloatArray:
    """Return places without those close to a brighter one."""
    if places.shape[0] < 2:
        return places
    dropped = np.zeros(places.shape[0], dtype=bool)
    for first, second in sorted(cKDTree(places).query_pairs(apart)):
        dropped[second] |= not dropped[first]
    return places[~dropped]


_ROUNDS = 12
"""Levenberg-Marquardt steps; a star converges in four to eight."""
_CONVERGED = 1e-4
"""Square of the last step in 1-sigmas; a tenth of that remains at most."""
_PLACE = 4
"""The first parameters: x, y, height, background; the shape follows."""


class Stamps(NamedTuple):
    """Pixels around stars.

    x, y : (n, m) of each pixel, px. value : (n, m) counts above the background. variance : (n, m) of the background,
    counts²; infinite where a pixel takes no part (clipped, outside, another star's).
    """

    x: FloatArray
    y: FloatArray
    value: FloatArray
    variance: FloatArray


class StarFits(NamedTuple):
    """Results of the fits, as of `LightFit`, each (n,).

    parameters : (n, 7) x, y, height, background, and the inverse covariance of the point spread: xx, xy, yy.
    sigma_px : infinite where the pixels do not determine the centre. snr : of the height. chi2 : reduced.
    """

    parameters: FloatArray
    sigma_px: FloatArray
    snr: FloatArray
    chi2: FloatArray


def fit_point_spreads(stamps: Stamps, start: FloatArray, *, gain_e: float | None, shape: bool) -> StarFits:
    """Fit a Gaussian and a constant to each stamp, by weighted least squares.

    Parameters
    ----------
    stamps : the pixels.
    start : (n, 7) parameters to begin at.
    gain_e : electrons per count, for the shot noise of the star itself; None where unknown, and where counts are not
        proportional to light.
    shape : fit the shape too; otherwise it stays as it is in `start`.
    """
    free = start.shape[1] if shape else _PLACE
    now = start.copy()
    damping = np.full(now.shape[0], 1e-3)
    moving = np.arange(now.shape[0])
    for _ in range(_ROUNDS):
        part, at = Stamps(*(column[moving] for column in stamps)), now[moving]
        weight = _pixel_weights(part, at, gain_e)
        cost, normal, gradient = _normal_equations(part, at, weight, free)
        step = _solve_pairs(normal + damping[moving, None, None] * _diagonal_matrices(normal), gradient)
        tried = at.copy()
        tried[:, :free] += step
        with np.errstate(over="ignore", invalid="ignore"):  # a step may lead anywhere, and is then not taken
            better = (_normal_equations(part, tried, weight, 0)[0] < cost) & _has_positive_shape(tried)
        now[moving[better]] = tried[better]
        damping[moving] *= np.where(better, 0.2, 8.0)
        moving = moving[np.abs(np.einsum("nk,nk->n", step, gradient)) > _CONVERGED]
        if moving.size == 0:
            break
    weight = _pixel_weights(stamps, now, gain_e)
    cost, normal, _ = _normal_equations(stamps, now, weight, free)
    variance = np.asarray(np.linalg.pinv(normal, hermitian=True), dtype=np.float64)
    chi2 = cost / np.maximum(np.sum(weight > 0.0, axis=-1) - free, 1)
    of_centre = 0.5 * (_require_positive(variance[:, 0, 0]) + _require_positive(variance[:, 1, 1]))
    return StarFits(
        parameters=now,
        sigma_px=np.sqrt(of_centre * np.maximum(chi2, 1.0) + _FLOOR_PX**2),
        snr=now[:, 2] / np.sqrt(np.maximum(_require_positive(variance[:, 2, 2]), 1e-30)),
        chi2=chi2,
    )


def _require_positive(variance: FloatArray) -> FloatArray:
    """Return variances, infinite where the pseudo-inverse of a singular matrix has 0 or a rounded negative number."""
    return np.where(variance > 0.0, variance, np.inf)


def inverse_shape(shape: FloatArray) -> FloatArray:
    """Return the inverses of symmetric 2x2 matrices given as (..., 3) xx, xy, yy."""
    xx, xy, yy = np.moveaxis(shape, -1, 0)
    return np.asarray(np.stack([yy, -xy, xx], axis=-1) / (xx * yy - xy**2)[..., None])


def ellipse_axes(shape: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the minor and the major 1-sigma axis, (...) px, of covariances (..., 3) px²."""
    xx, xy, yy = np.moveaxis(shape, -1, 0)
    half, apart = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    return np.sqrt(np.maximum(half - apart, 0.0)), np.sqrt(np.maximum(half + apart, 0.0))


def _pixel_weights(stamps: Stamps, at: FloatArray, gain_e: float | None) -> FloatArray:
    """Return 1 over the variance of each pixel, (n, m), with the shot noise of the star where the gain is known."""
    if gain_e is None:
        return np.asarray(1.0 / stamps.variance)
    x, y, height, _, xx, xy, yy = (column[:, None] for column in at.T)
    dx, dy = stamps.x - x, stamps.y - y
    light = height * np.exp(-0.5 * np.clip(xx * dx**2 + 2.0 * xy * dx * dy + yy * dy**2, 0.0, 60.0))
    return np.asarray(1.0 / (stamps.variance + np.maximum(light, 0.0) / gain_e))


def mean_width(shape: FloatArray) -> FloatArray:
    """Return the geometric mean of the 1-sigma axes, (...) px, of covariances (..., 3) px²."""
    minor, major = ellipse_axes(shape)
    width: FloatArray = np.sqrt(minor * major)
    return width


def _normal_equations(
    stamps: Stamps, at: FloatArray, weight: FloatArray, free: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return chi² (n,), the normal matrices (n, k, k) and gradients (n, k) of the first `free` parameters."""
    return _kernels.point_spread_equations(stamps.x, stamps.y, stamps.value, weight, at, free)


def _diagonal_matrices(matrices: FloatArray) -> FloatArray:
    """Return the diagonals of matrices (n, k, k) as matrices; nowhere 0."""
    size = matrices.shape[-1]
    return np.asarray((np.einsum("nii->ni", matrices) + 1e-12)[..., None] * np.eye(size))


def _solve_pairs(matrices: FloatArray, right: FloatArray) -> FloatArray:
    # in units of the diagonal, since heights and positions differ by powers of ten
    scale = 1.0 / np.sqrt(np.einsum("nii->ni", matrices))
    unit = matrices * scale[:, :, None] * scale[:, None, :] + 1e-9 * np.eye(matrices.shape[-1])
    return np.asarray(np.linalg.solve(unit, (right * scale)[..., None])[..., 0] * scale)


def _has_positive_shape(parameters: FloatArray) -> BoolArray:
    """Return (n,): whether the inverse covariance is positive."""
    xx, xy, yy = parameters[:, 4:].T
    return np.asarray((xx > 0.0) & (yy > 0.0) & (xx * yy > xy**2))


# Stars that are clipped so widely that no point spread can be fitted: where they are, roughly.

_FEWEST_PX = 14
"""Of the clipped pixels and their neighbours: a smaller core leaves enough of a star's wings for a fit."""
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
    clipped, usable : (rows, columns) clipped pixels and their neighbours; where stars are looked for.
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
    InputError : the array is not an image.
    """
    require_photo(image, full_scale=full_scale, bayer=bayer)
    plane, clipped = light_plane(image, full_scale, bayer)
    ground = estimate_background(plane, least_noise=1e-4 * full_scale)
    usable = np.ones(plane.shape, dtype=bool) if mask is None else ~mask
    first = find_maxima(plane, ground, clipped, usable, FIRST_WIDTH_PX)
    shapes = measure_bright_shapes(plane, ground, clipped, first, gain_e_per_count)
    if shapes is None or shapes[0].shape[0] < _FEW:  # aurora and roofs, or stars that this width smears
        sharp = find_maxima(plane, ground, clipped, usable, _SHARP_WIDTH_PX)
        shapes = _measure_sharp_shapes(plane, ground, clipped, sharp, gain_e_per_count) or shapes
    if shapes is None:
        return _make_no_stars()
    width = float(np.median(mean_width(shapes[1])))
    places = find_maxima(plane, ground, clipped, usable, width)
    expected = shape_at(*shapes, places, plane.shape)
    stamps, cut_off = stamps_at(plane, ground, clipped, places, width)
    fitted = fit_point_spreads(stamps, start_at(stamps, places, expected), gain_e=gain_e_per_count, shape=False)
    own = _choose_shapes(stamps, fitted, expected, cut_off, gain_e_per_count)
    peak = (plane[tuple(places[:, ::-1].astype(int).T)] / full_scale).astype(np.float64)
    stars = _make_stars(fitted, own, expected, cut_off, peak)
    ratio = stars.width_px / mean_width(expected)
    near = np.hypot(*(stars.pixels - places).T) < _MOVED_PX * max(width, 1.0)
    found = stars.select((ratio > ALIKE[0]) & (ratio < ALIKE[1]) & near & (stars.snr > FAINTEST_SNR))
    found = _merge_cores(found, clipped_cores(plane - ground.level, clipped, usable=usable), width)
    return found.select(np.argsort(-found.flux, kind="stable")[:MOST])


def _merge_cores(stars: Stars, cores: ClippedCores, width: float) -> Stars:
    """Remove detections about clipped cores, and add each core that is like a star as one clipped star."""
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


def _choose_shapes(
    stamps: Stamps, fitted: StarFits, expected: FloatArray, clipped: BoolArray, gain_e: float | None
) -> FloatArray:
    """Return covariances (n, 3) px²: each bright star's own, that of its place for the others."""
    bright = np.flatnonzero((fitted.snr > SHAPE_SNR) & ~clipped)
    part = Stamps(*(column[bright] for column in stamps))
    own = fit_point_spreads(part, fitted.parameters[bright], gain_e=gain_e, shape=True)
    shape = expected.copy()
    shape[bright] = inverse_shape(own.parameters[:, 4:])
    return shape


def _make_stars(fitted: StarFits, own: FloatArray, expected: FloatArray, clipped: BoolArray, peak: FloatArray) -> Stars:
    minor, major = ellipse_axes(own)
    return Stars(
        pixels=fitted.parameters[:, :2],
        sigma_px=fitted.sigma_px,
        flux=fitted.parameters[:, 2] * 2.0 * math.pi * mean_width(expected) ** 2,
        snr=fitted.snr,
        peak_fraction=peak,
        width_px=np.sqrt(minor * major),
        ellipticity=1.0 - minor / np.maximum(major, 1e-12),
        saturated=clipped,
    )


def _make_no_stars() -> Stars:
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
_SHARP_WIDTH_PX, _SHARPEST = 0.6, (0.35, 0.9)
"""1-sigma of stars whose lens is sharper than a pixel, and its limits: a single pixel has 0.3 and less."""
_SAME_WIDTH, _FEWEST_SHARP, _SHARE_SHARP = 1.5, 8, 0.25
"""Widest over narrowest of sources that are alike, how many these are, and their share of the sharp sources."""
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
    own = _own_pixels(places, dx, dy)
    full = clipped[row, column]
    used = inside & own & ~full
    variance = np.where(used, ground.noise[row, column].astype(np.float64) ** 2, np.inf)
    value = (plane[row, column] - ground.level[row, column]).astype(np.float64)
    near = np.hypot(dx, dy) <= 2.0 * width + 1.0
    return Stamps(x.astype(float), y.astype(float), value, variance), np.any(full & near & own, axis=-1)


def _own_pixels(places: FloatArray, dx: IntArray, dy: IntArray) -> BoolArray:
    """Return (n, m): whether no other place is nearer to the pixels around each; of two as near the first has it."""
    own = np.ones((places.shape[0], dx.size), dtype=bool)
    pairs = cKDTree(places).query_pairs(2.0 * float(np.hypot(dx, dy).max()), output_type="ndarray")
    row, other = np.concatenate([pairs, pairs[:, ::-1]]).T
    away = places[other] - places[row]
    limit = np.sum(away**2, axis=-1) - np.where(row < other, 0.0, 0.5)
    rank = rank_in_part(row)
    for turn in range(int(rank.max(initial=-1)) + 1):
        some = rank == turn
        own[row[some]] &= 2.0 * (away[some, :1] * dx + away[some, 1:] * dy) <= limit[some, None]
    return own


def start_at(stamps: Stamps, places: FloatArray, shape: FloatArray) -> FloatArray:
    """Return (n, 7) parameters to begin at: the middle pixels, and covariances (n, 3) px² of the point spread."""
    middle = stamps.value.shape[1] // 2
    height = np.maximum(stamps.value[:, middle], 1e-3)
    return np.column_stack([places, height, np.zeros(height.size), inverse_shape(shape)])


def measure_bright_shapes(
    plane: Plane, ground: Background, clipped: BoolArray, places: FloatArray, gain_e: float | None
) -> tuple[FloatArray, FloatArray] | None:
    """Return places (k, 2) and covariances (k, 3) px² of the point spread of bright stars; None without any."""
    if places.shape[0] == 0:
        return None
    width, every = FIRST_WIDTH_PX, places[: 4 * _SHAPES]
    for wanted in (every[::4] if every.shape[0] > 2 * _SHAPES else every, every):  # then with stamps of the right size
        stamps, cut_off = stamps_at(plane, ground, clipped, wanted, width)
        start = start_at(stamps, wanted, np.tile([width**2, 0.0, width**2], (wanted.shape[0], 1)))
        fitted = fit_point_spreads(stamps, start, gain_e=gain_e, shape=True)
        shape = inverse_shape(fitted.parameters[:, 4:])
        minor, major = ellipse_axes(shape)
        good = ~cut_off & (minor > 0.25) & (major < 8.0) & (major < 3.0 * minor) & (fitted.snr > FAINTEST_SNR)
        if not np.any(good):
            return None
        # at least one: the brighter half of them
        bright = good & (fitted.snr >= min(SHAPE_SNR, float(np.quantile(fitted.snr[good], 0.5))))
        width = float(np.median(np.sqrt(minor * major)[bright]))
        typical = bright & (np.abs(np.log(np.sqrt(minor * major) / width)) < math.log(ALIKE[1]))
        if not np.any(typical):
            return None  # two of widths that have nothing in common
    return wanted[typical][:_SHAPES], shape[typical][:_SHAPES]


def _measure_sharp_shapes(
    plane: Plane, ground: Background, clipped: BoolArray, places: FloatArray, gain_e: float | None
) -> tuple[FloatArray, FloatArray] | None:
    """Return places (k, 2) and covariances (k, 3) px² of point sources of a pixel's width that are alike, or None."""
    if places.shape[0] < _FEWEST_SHARP:
        return None
    wanted, variance = places[: 4 * _SHAPES], _SHARP_WIDTH_PX**2
    stamps, cut_off = stamps_at(plane, ground, clipped, wanted, _SHARP_WIDTH_PX)
    start = start_at(stamps, wanted, np.tile([variance, 0.0, variance], (wanted.shape[0], 1)))
    fitted = fit_point_spreads(stamps, start, gain_e=gain_e, shape=True)
    shape = inverse_shape(fitted.parameters[:, 4:])
    minor, major = ellipse_axes(shape)
    good = np.flatnonzero(~cut_off & (minor > 0.25) & (major < 3.0 * minor) & (fitted.snr > FAINTEST_SNR))
    width = np.sqrt(minor * major)[good]
    ordered = np.sort(width)
    count = np.searchsorted(ordered, _SAME_WIDTH * ordered, side="right") - np.arange(ordered.size)
    if count.size == 0 or int(count.max()) < max(_FEWEST_SHARP, _SHARE_SHARP * ordered.size):
        return None
    least = float(ordered[int(np.argmax(count))])
    like = good[(width >= least) & (width <= _SAME_WIDTH * least)]
    middle = float(np.median(np.sqrt(minor * major)[like]))
    return (wanted[like], shape[like]) if _SHARPEST[0] < middle < _SHARPEST[1] else None


def shape_at(known: FloatArray, shape: FloatArray, places: FloatArray, size: tuple[int, ...]) -> FloatArray:
    """Return covariances (n, 3) at places: a quadratic function of the place through those known, without outliers."""
    if known.shape[0] < _FEW:
        return np.tile(np.median(shape, axis=0), (places.shape[0], 1))
    design, weight = _quadratic_terms(known, size), np.ones(known.shape[0])
    for _ in range(6):
        rows = np.sqrt(weight)[:, None]
        coefficients = np.linalg.lstsq(design * rows, shape * rows, rcond=None)[0]
        distance = np.linalg.norm(shape - design @ coefficients, axis=-1)
        weight = biweights(distance / max(4.0 * mad_sigma(distance), 1e-6))
    smooth = _quadratic_terms(places, size) @ coefficients
    minor, major = ellipse_axes(smooth)
    middle = float(np.median(mean_width(shape)))
    # far from all bright stars a quadratic may be no shape at all
    bad = ~((minor > 0.4 * middle) & (major < 2.5 * middle))
    smooth[bad] = np.median(shape, axis=0)
    return np.asarray(smooth)


def _quadratic_terms(places: FloatArray, size: tuple[int, ...]) -> FloatArray:
    x, y = (places / np.array(size[::-1])).T
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)


_OUTSTANDING = 6.0
"""Noises above the median of the neighbours: in 4 million pixels a normal noise leaves none."""
_MOST = 20_000
"""Of an image: half a percent of 4 million; the brightest count."""
_SHARE = 0.7
"""Of the images in which a warm pixel stands out; a star leaves a pixel after 10 minutes, Polaris after 30."""


def outstanding_pixels(image: Image, *, bayer: Bayer | None = None) -> IntArray:
    """Return the pixels that stand out over their eight neighbours (of the same colour), as flat indices, ascending.

    Stars of a sharp lens are among them.

    Parameters
    ----------
    image : (rows, columns) counts.
    bayer : colours of a raw mosaic.
    """
    excess = image.astype(np.int32) - _median_filter(image, bayer)
    sampled = excess[::4, ::4]
    noise = max(MAD_TO_SIGMA * float(np.median(np.abs(sampled - np.median(sampled)))), 0.5)
    found = np.flatnonzero(excess.ravel() > _OUTSTANDING * noise)
    if found.size > _MOST:
        found = found[np.argsort(-excess.ravel()[found], kind="stable")[:_MOST]]
    return np.sort(found)


def warm_pixels(outstanding: Sequence[IntArray]) -> IntArray:
    """Return the pixels that stand out in 70 % of images of a turning sky, as flat indices, ascending.

    Parameters
    ----------
    outstanding : of each image, over an hour and a half at least: Polaris moves by 3 px at 600 px a radian.
    """
    if not outstanding:
        return np.zeros(0, dtype=np.int64)
    pixels, count = np.unique(np.concatenate(list(outstanding)), return_counts=True)
    return np.asarray(pixels[count >= _SHARE * len(outstanding)], dtype=np.int64)


def repaired(image: Image, warm: IntArray, *, bayer: Bayer | None = None) -> Image:
    """Return an image with the median of the neighbours (of the same colour) in place of warm pixels."""
    whole: Image = image.copy()
    whole.ravel()[warm] = _median_filter(image, bayer).ravel()[warm]
    return whole


def _median_filter(image: Image, bayer: Bayer | None) -> Image:
    """Return the median of each pixel and its eight neighbours, in a mosaic those of its colour."""
    if bayer is None:
        return _median_of_plane(image)
    calm = np.empty(image.shape, dtype=np.uint16)
    for row in (0, 1):
        for column in (0, 1):
            calm[row::2, column::2] = _median_of_plane(image[row::2, column::2])
    return calm


def _median_of_plane(plane: Image) -> Image:
    return np.asarray(cv2.medianBlur(plane.copy(), 3), dtype=np.uint16)
