"""Whether all of the sky became brighter or darker at once: what the ratios of one cycle's exposures cannot tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sunarc.array_types import FloatArray, Image
from sunarc.imaging.brightness import Exposed

MOST_ALL_OVER = 2.0
"""Factor by which nearly all of the sky may gain or lose light within two minutes. The sun that comes out changes what
is near it tenfold, the far side of the sky hardly; in the middle of twilight two minutes are a factor of 1.6."""

_BLOCKS = 24  # across and down
_MOST_SAMPLES = 16  # of a block, across and down
_CEILING = 0.85  # of full scale
_DARK_SHARE = 0.05
_NEARLY_ALL = 0.9
_LEAST_BLOCKS = 20
_LEAST_CONTRAST = 4e-3  # of full scale: eight times what the fixed pattern may feign
_SAME_EXPOSURE = 0.01


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Level:
    """How bright the exposures of one cycle are, coarsely.

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


def level_of(frames: Sequence[Exposed]) -> Level:
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
                factor = _factor(first, second, full_scale=before.full_scale)
                if factor is not None:
                    return factor
    return None


def _factor(before: FloatArray, now: FloatArray, *, full_scale: int) -> float | None:
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
