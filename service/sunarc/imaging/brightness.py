"""Whether two frames are as bright beside one another as their stated exposures say."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sunarc.array_types import FloatArray, Image, IntArray

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
    """A frame as far as its brightness is judged: its counts, its stated exposure, its largest count."""

    image: Image
    exposure_us: float
    full_scale: int


@dataclass(frozen=True, slots=True, kw_only=True)
class _Level:
    """Mean of a group of pixels and its standard error, counts."""

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
    pair = _pair(shorter, longer)
    light = _beyond_full_scale(pair)
    if light is None:
        light = _light(pair, most=TOLERANCE * (shorter.exposure_us + _EXTRA_US) / shorter.exposure_us)
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


def _pair(shorter: Exposed, longer: Exposed) -> _Pair:
    long = longer.image.ravel()
    histogram = np.bincount(long, minlength=longer.full_scale + 1)
    level = int(np.searchsorted(np.cumsum(histogram), _DARK_SHARE * long.size))
    return _Pair(
        short=shorter.image.ravel(),
        long=long,
        dark=_thinned(np.flatnonzero(long <= level)),
        histogram=histogram,
        full_scale=longer.full_scale,
        ratio=shorter.exposure_us / longer.exposure_us,
    )


def _light(pair: _Pair, *, most: float) -> float | None:
    """Return the light of the shorter exposure in terms of what is expected; None where that is near enough to 1."""
    bright, dark = (_beside(group, pair) for group in (_brightest(pair), pair.dark))
    if min(bright.size, dark.size) < _LEAST_BRIGHT_PX // 3:
        return None
    contrast_long, contrast_short = _contrast(pair.long, bright, dark), _contrast(pair.short, bright, dark)
    if contrast_long.mean < 2.0 * _SIGMAS * contrast_long.error + 4.0 * pair.floor:
        return None
    expected, margin = contrast_long.mean * pair.ratio, _SIGMAS * contrast_short.error + pair.floor
    if expected / TOLERANCE - margin <= contrast_short.mean <= expected * most + margin:
        return None
    return contrast_short.mean / expected


def _beyond_full_scale(pair: _Pair) -> float | None:
    """Return the same where much of the longer exposure is saturated, though the shorter one says it should not be."""
    level = int(_SATURATED * pair.full_scale)
    if pair.histogram[level:].sum() < _MUCH_SATURATED * pair.long.size:
        return None
    levels = np.sort(pair.short[_thinned(np.flatnonzero(pair.long >= level))].astype(np.float64))
    levels = levels[levels.size // 10 : levels.size // 2]  # without the sun and its surroundings
    black_long, black_short = float(pair.long[pair.dark].mean()), float(pair.short[pair.dark].mean())
    if black_long > _CEILING * pair.full_scale:
        black_long = black_short = 0.0
    expected = (_SATURATED * pair.full_scale - black_long) * pair.ratio
    light = (float(levels.mean()) - black_short) / expected
    return light if light < 1.0 / _SATURATED_TOLERANCE - pair.floor / expected else None


def _brightest(pair: _Pair) -> IntArray:
    """Return where the longer exposure is brightest without being near saturation."""
    ceiling = int(_CEILING * pair.full_scale)
    n_brightest = max(_LEAST_BRIGHT_PX, pair.long.size // 2000)
    level = ceiling - 1 - int(np.searchsorted(np.cumsum(pair.histogram[:ceiling][::-1]), n_brightest))
    return _thinned(np.flatnonzero((pair.long >= max(level, 0)) & (pair.long < ceiling)))


def _beside(indices: IntArray, pair: _Pair) -> IntArray:
    """Return the pixels beside those chosen, which were not chosen for their noise, nor for being hot."""
    beside = (indices + _ASIDE_PX) % pair.long.size
    return beside[pair.long[beside] < _CEILING * pair.full_scale]


def _thinned(indices: IntArray) -> IntArray:
    return indices[:: 1 + indices.size // _MOST_PX]


def _contrast(image: Image, bright: IntArray, dark: IntArray) -> _Level:
    above, below = _trimmed(image[bright]), _trimmed(image[dark])
    return _Level(mean=above.mean - below.mean, error=float(np.hypot(above.error, below.error)))


def _trimmed(values: Image) -> _Level:
    """Return the mean without the extremes."""
    ordered: FloatArray = np.sort(values).astype(np.float64)
    cut = int(_TRIM * ordered.size)
    trimmed = ordered[cut : ordered.size - cut]
    return _Level(mean=float(trimmed.mean()), error=float(trimmed.std() / np.sqrt(trimmed.size)))
