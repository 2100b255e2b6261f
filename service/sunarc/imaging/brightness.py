"""Brightness of frames of one cycle: exposures that contradict each other, a change of all the sky, darkness."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sunarc.common.array_types import FloatArray, Image, IntArray

TOLERANCE = 1.6
"""Factor by which the light may differ from the stated exposures' ratio. Exposures stand a factor of 4 apart, and a
camera whose gamma was switched on (4 becomes 1.9) is off by 2.1; a cloud's edge brightens less in a second."""

_CEILING = 0.85  # of full scale; above it no sensor is linear
_SATURATED = 0.98
_SATURATED_TOLERANCE = 1.25  # a pixel is at full scale or it is not
_LEAST_BRIGHT_PX = 300
_DARK_SHARE = 0.05
_MUCH_SATURATED = 0.2  # a sun's blooming stays below this share of the image
_MOST_PX = 20_000
_TRIM = 0.1
_ASIDE_PX = 2  # of the same colour in a mosaic
_FIXED_PATTERN = 5e-4  # of full scale: how far the dark levels of two groups of pixels differ
_EXTRA_US = 10.0  # many sensors expose for some microseconds longer than they say
_SIGMAS = 4.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Exposed:
    """Frame for the brightness checks: counts, stated exposure, largest count."""

    image: Image
    exposure_us: float
    full_scale: int


@dataclass(frozen=True, slots=True, kw_only=True)
class _Level:
    """Mean of a group of pixels, and its standard error, counts."""

    mean: float
    error: float


def light_ratio_contradiction(first: Exposed, second: Exposed) -> str | None:
    """Return how two frames of the same scene contradict their stated exposures.

    Parameters
    ----------
    first, second : taken within a second or so of one another, with the same gain and of the same shape.

    Returns
    -------
    One sentence, or None: they agree, or cannot be compared (no contrast, or both saturated). The difference between
    the brightest unsaturated and the darkest pixels of the longer exposure is looked for in the shorter one, so that
    the black level need not be known; the pixels that the longer one saturates must be bright enough in the shorter.
    """
    shorter, longer = sorted((first, second), key=lambda frame: frame.exposure_us)
    pair = _make_pair(shorter, longer)
    light = _measure_saturated_light_ratio(pair)
    if light is None:
        light = _measure_light_ratio(pair, most=TOLERANCE * (shorter.exposure_us + _EXTRA_US) / shorter.exposure_us)
    if light is None:
        return None
    return (
        f"{shorter.exposure_us:g} µs shows {light:.2g} times the light that it should have beside "
        f"{longer.exposure_us:g} µs"
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Pair:
    """A shorter and a longer exposure: counts, where the longer is darkest, its histogram, the ratio (at most 1)."""

    short: Image
    long: Image
    dark: IntArray
    histogram: IntArray
    full_scale: int
    ratio: float

    @property
    def floor(self) -> float:
        """Differences of means, counts, that say nothing: half a count, and the sensor's fixed pattern."""
        return max(0.5, _FIXED_PATTERN * self.full_scale)


def _make_pair(shorter: Exposed, longer: Exposed) -> _Pair:
    long = longer.image.ravel()
    histogram = np.bincount(long, minlength=longer.full_scale + 1)
    level = int(np.searchsorted(np.cumsum(histogram), _DARK_SHARE * long.size))
    return _Pair(
        short=shorter.image.ravel(),
        long=long,
        dark=_thin_indices(np.flatnonzero(long <= level)),
        histogram=histogram,
        full_scale=longer.full_scale,
        ratio=shorter.exposure_us / longer.exposure_us,
    )


def _measure_light_ratio(pair: _Pair, *, most: float) -> float | None:
    """Return the ratio of the shorter exposure's light to the expected one; None where it is near 1."""
    bright, dark = (_select_neighbours(group, pair) for group in (_select_brightest(pair), pair.dark))
    if min(bright.size, dark.size) < _LEAST_BRIGHT_PX // 3:
        return None
    contrast_long, contrast_short = (
        _measure_contrast(pair.long, bright, dark),
        _measure_contrast(pair.short, bright, dark),
    )
    if contrast_long.mean < 2.0 * _SIGMAS * contrast_long.error + 4.0 * pair.floor:
        return None
    expected, margin = contrast_long.mean * pair.ratio, _SIGMAS * contrast_short.error + pair.floor
    if expected / TOLERANCE - margin <= contrast_short.mean <= expected * most + margin:
        return None
    return contrast_short.mean / expected


def _measure_saturated_light_ratio(pair: _Pair) -> float | None:
    """Return the light ratio where the longer exposure is saturated though the shorter predicts that it is not."""
    level = int(_SATURATED * pair.full_scale)
    if pair.histogram[level:].sum() < _MUCH_SATURATED * pair.long.size:
        return None
    levels = np.sort(pair.short[_thin_indices(np.flatnonzero(pair.long >= level))].astype(np.float64))
    levels = levels[levels.size // 10 : levels.size // 2]  # without the sun and its surroundings
    black_long, black_short = float(pair.long[pair.dark].mean()), float(pair.short[pair.dark].mean())
    if black_long > _CEILING * pair.full_scale:
        black_long = black_short = 0.0
    expected = (_SATURATED * pair.full_scale - black_long) * pair.ratio
    light = (float(levels.mean()) - black_short) / expected
    return light if light < 1.0 / _SATURATED_TOLERANCE - pair.floor / expected else None


def _select_brightest(pair: _Pair) -> IntArray:
    """Return the pixels where the longer exposure is brightest without being near saturation."""
    ceiling = int(_CEILING * pair.full_scale)
    n_brightest = max(_LEAST_BRIGHT_PX, pair.long.size // 2000)
    level = ceiling - 1 - int(np.searchsorted(np.cumsum(pair.histogram[:ceiling][::-1]), n_brightest))
    return _thin_indices(np.flatnonzero((pair.long >= max(level, 0)) & (pair.long < ceiling)))


def _select_neighbours(indices: IntArray, pair: _Pair) -> IntArray:
    """Return the neighbours of chosen pixels: these were not chosen for noise, nor for being hot."""
    beside = (indices + _ASIDE_PX) % pair.long.size
    return beside[pair.long[beside] < _CEILING * pair.full_scale]


def _thin_indices(indices: IntArray) -> IntArray:
    return indices[:: 1 + indices.size // _MOST_PX]


def _measure_contrast(image: Image, bright: IntArray, dark: IntArray) -> _Level:
    above, below = trimmed_mean(image[bright]), trimmed_mean(image[dark])
    return _Level(mean=above.mean - below.mean, error=float(np.hypot(above.error, below.error)))


def trimmed_mean(values: Image) -> _Level:
    """Return the mean without the extremes."""
    ordered: FloatArray = np.sort(values).astype(np.float64)
    cut = int(_TRIM * ordered.size)
    trimmed = ordered[cut : ordered.size - cut]
    return _Level(mean=float(trimmed.mean()), error=float(trimmed.std() / np.sqrt(trimmed.size)))


MOST_ALL_OVER = 2.0
"""Factor by which nearly all of the sky may gain or lose light within two minutes. The sun that comes out changes what
is near it tenfold, the far side of the sky hardly; in the middle of twilight two minutes are a factor of 1.6."""

_BLOCKS = 24  # across and down
_MOST_SAMPLES = 16  # of a block, across and down
_NEARLY_ALL = 0.9
_LEAST_BLOCKS = 20
_LEAST_CONTRAST = 4e-3  # of full scale: eight times what the fixed pattern may feign
_SAME_EXPOSURE = 0.01


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Level:
    """Brightness of the exposures of one cycle, coarsely.

    Attributes
    ----------
    exposures_us : shortest first.
    blocks : (exposures, blocks) mean counts of each block of a grid over the image.
    shape, full_scale : of the frames; only levels alike in them can be compared.
    """

    exposures_us: tuple[float, ...]
    blocks: FloatArray
    shape: tuple[int, ...]
    full_scale: int


def measure_level(frames: Sequence[Exposed]) -> Level:
    """Return how bright the frames of a cycle are; at least one, all of one shape."""
    ordered = sorted(frames, key=lambda frame: frame.exposure_us)
    return Level(
        exposures_us=tuple(frame.exposure_us for frame in ordered),
        blocks=np.stack([_block_means(frame.image) for frame in ordered]),
        shape=ordered[0].image.shape,
        full_scale=ordered[0].full_scale,
    )


def factor_all_over(before: Level, now: Level) -> float | None:
    """Return the factor by which nearly all of the image gained (above 1) or lost light (below 1).

    Returns ------- The factor that nine tenths of the image reached or exceeded; 1 where they went different ways;
    None where nothing can be compared (no contrast, other exposures, another size). Light is counted from the darkest
    twentieth of the image, so that the black level need not be known, in the shortest exposure that shows enough.
    """
    if (before.shape, before.full_scale) != (now.shape, now.full_scale):
        return None
    for exposure_us, first in zip(before.exposures_us, before.blocks, strict=True):
        for other_us, second in zip(now.exposures_us, now.blocks, strict=True):
            if abs(other_us - exposure_us) <= _SAME_EXPOSURE * exposure_us:
                factor = _measure_light_factor(first, second, full_scale=before.full_scale)
                if factor is not None:
                    return factor
    return None


def _measure_light_factor(before: FloatArray, now: FloatArray, *, full_scale: int) -> float | None:
    dark = np.argsort(before)[: max(int(_DARK_SHARE * before.size), 1)]
    light_before, light_now = before - before[dark].mean(), now - now[dark].mean()
    telling = (before < _CEILING * full_scale) & (light_before > _LEAST_CONTRAST * full_scale)
    if np.count_nonzero(telling) < _LEAST_BLOCKS:
        return None
    ratios = light_now[telling] / light_before[telling]
    least, most = np.quantile(ratios, [1.0 - _NEARLY_ALL, _NEARLY_ALL])
    if least > 1.0:
        return float(least)
    return max(float(most), 0.0) if most < 1.0 else 1.0


def _block_means(image: Image) -> FloatArray:
    """Return the mean of each block, of some of its pixels."""
    rows, columns = (min(_BLOCKS, side) for side in image.shape)
    height, width = image.shape[0] // rows, image.shape[1] // columns
    down, across = (max(side // _MOST_SAMPLES, 1) for side in (height, width))
    blocks = image[: rows * height, : columns * width].reshape(rows, height, columns, width)
    means: FloatArray = blocks[:, ::down, :, ::across].mean(axis=(1, 3)).ravel()
    return means


_BLOCK_PX = 16
"""Side of the blocks whose means are compared: a read noise of 1 % of full scale becomes 0.06 %."""
_FLAT = 0.003
"""Difference of the 2nd and 95th percentile of the means, of full scale, below which there is no sky: the sensors' dark
levels vary by 0.0005; an overcast sky of the simulated imager has 0.017 at 3 ms with the sun at 80 degrees."""
_SPOT = 0.02
"""Excess of the brightest block, of full scale, above which something shines (the sun behind a dense filter)."""
_PEDESTAL = 0.2
"""Median of the means, of full scale, above which a flat frame is not dark: camera's black levels are at most 0.1."""


def is_dark(image: Image, *, full_scale: int) -> bool:
    """Return whether a frame shows neither a sky nor a light in it; blind in images of less than 4 blocks."""
    down, across = image.shape[0] // _BLOCK_PX, image.shape[1] // _BLOCK_PX
    if down * across < 4:
        return False
    blocks = image[: down * _BLOCK_PX, : across * _BLOCK_PX]
    means = blocks.reshape(down, _BLOCK_PX, across, _BLOCK_PX).mean(axis=(1, 3), dtype=np.float32) / full_scale
    low, middle, high = np.percentile(means, (2.0, 50.0, 95.0))
    return bool(middle <= _PEDESTAL and high - low <= _FLAT and float(means.max()) - middle <= _SPOT)
