"""Hashes of an image's tiles, by which it is recognised although text in it changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sunarc.common.array_types import BoolArray, FloatArray, Image
from sunarc.imaging.levels import full_scale, level_step, levels, mid_tones

_TILE_PX = 16
"""The largest block that JPEG codes by itself."""
_LEAST_RANGE = 0.01
"""Of the full scale within a textured tile; 3 counts at least."""
_LEAST_MID = 0.125
"""Share of a textured tile's pixels that are mid-tones: black and saturated ones do not change."""
_TEXTURED_SHARE = 0.15
"""Of all tiles: two lines of text are less, on a black image too."""
_FEWEST = 12
_TEXT_SHARE = 0.2
"""Of the tiles, which text that changes may cover."""
_AROUND_SHARE, _AROUND_TILES = 0.06, 3
"""Tiles around the sun, as a share of the image's shorter side, and at least."""
_FEWEST_AROUND = 4
_NOISE_ROWS, _LEAST_BENT = 2, 2.0
"""Every so many rows are taken; steps between levels: a second difference of rounded smooth values is 1 at most."""
_BLOCK_PX = 8
"""JPEG makes steps where its blocks meet."""
_MID_TONE_TILES = 0.5
"""Share of the tiles that are of mid-tones: of fewer, a foreground may be all, and it stands still."""
_LEAST_TONES = 0.5
"""Share of the pixels of such a tile that are mid-tones: of fewer, an edge may be all that is seen in it."""
_PERHAPS_MOSAIC = 0.25
"""Share of a tile's pixels that are rough, exceeded in every mosaic of two colours, and by noise of 0.6 counts."""
_AGREEING, _FEWEST_NEIGHBOURS = 0.6, 30
"""Neighbouring tiles that become brighter or darker together: half of them by noise, most where light or clouds change.
Among so many pairs at least."""
_SMOOTHEST, _LEAST_ROUGH = 0.25, 0.02
"""Quantile of the tiles by their share of rough pixels. Noise of 1.5 counts gives .03 to .1 in JPEG of quality 92,
and smooth images 0 in JPEG of any."""


@dataclass(frozen=True, slots=True, eq=False)
class ImageTiles:
    """The hash of each tile of an image (rows, columns), and whether the tile is textured: of changing mid-tones.

    means: of the counts of each tile.
    has_noise: whether neighbouring pixels differ by more than a smooth image's that was rounded, in its sky too.
    """

    hashes: NDArray[np.uint64]
    textured: NDArray[np.bool_]
    means: FloatArray
    has_noise: bool

    @property
    def is_textured(self) -> bool:
        """Return whether most of the visible image is more than black, saturation and text."""
        n = int(np.count_nonzero(self.textured))
        return n >= max(_FEWEST, _TEXTURED_SHARE * self.textured.size)


def image_tiles(image: Image) -> ImageTiles:
    """Return the hashes of an image's tiles.

    Parameters
    ----------
    image : (rows, columns) or (rows, columns, channels), of integers or of floats.
    """
    values = image.reshape(len(image), -1)
    wide = _TILE_PX * (1 if image.ndim == 2 else image.shape[2])
    padded = np.pad(values, ((0, -len(values) % _TILE_PX), (0, -values.shape[1] % wide)), mode="edge")
    weights = np.random.default_rng(0).integers(0, 1 << 63, (_TILE_PX, wide), dtype=np.uint64) | np.uint64(1)
    rows, columns = len(padded) // _TILE_PX, padded.shape[1] // wide
    hashes, textured = np.zeros((rows, columns), np.uint64), np.zeros((rows, columns), np.bool_)
    means = np.zeros((rows, columns))
    least, (low, high) = max(3.0, _LEAST_RANGE * full_scale(image)), mid_tones(image)
    for row in range(rows):
        tiles = padded[row * _TILE_PX : (row + 1) * _TILE_PX].reshape(_TILE_PX, columns, wide)
        counts = tiles.astype(np.uint64) if tiles.dtype.kind != "f" else tiles.astype(np.float64).view(np.uint64)
        hashes[row] = np.einsum("ijk,ik->j", counts, weights)
        tones = tiles.astype(np.float64)
        mid = np.mean((tones > low) & (tones < high), axis=(0, 2))
        spread = np.ptp(tones, axis=(0, 2))
        means[row] = np.mean(tones, axis=(0, 2))
        textured[row] = (spread >= least) & (mid >= _LEAST_MID)
    return ImageTiles(hashes, textured, means, _has_noise(image))


def _has_noise(image: Image) -> bool:
    """Return whether even the smoothest parts of the mid-tones are rough: foregrounds are, smooth skies are not."""
    low, high = mid_tones(image)
    least = _LEAST_BENT * _level_step(image, low, high)
    every = image[::_NOISE_ROWS]
    firsts = range(0, len(every) - _TILE_PX + 1, _TILE_PX)
    shares = [_measure_tile_shares(every[first : first + _TILE_PX], (low, high), least) for first in firsts]
    if not shares:
        return False
    mid, rough = np.concatenate(shares, axis=1)
    rough = rough[mid > _LEAST_TONES]
    if rough.size == 0 or rough.size < _MID_TONE_TILES * mid.size:
        return False
    return bool(np.quantile(rough, _SMOOTHEST) >= _LEAST_ROUGH)


def _level_step(image: Image, low: float, high: float) -> int:
    """Return the step between the levels of an image's mid-tones, in counts; 1 of floats, and of fewer than two."""
    if image.dtype.kind == "f":
        return 1
    counts = levels(image)
    return max(level_step(counts[(counts > low) & (counts < high)]), 1)


def _measure_tile_shares(strip: Image, tones: tuple[float, float], least: float) -> FloatArray:
    """Return (2, tiles): of the pixels of each tile of a strip, the shares that are mid-tones, and rough ones.

    The columns of a raw mosaic are of two colours by turns: where most pixels are rough, those of one are compared.
    """
    values = strip.reshape(*strip.shape[:2], -1).astype(np.result_type(strip.dtype, np.float32))
    mid = (strip > tones[0]) & (strip < tones[1])
    mid = mid.reshape(values.shape)[:, 1:-1]
    bent = _is_off_line(values, 1, least)
    bent[:, np.arange(1, values.shape[1] - 1) % _BLOCK_PX % (_BLOCK_PX - 1) == 0] = False
    rough = _average_tiles(bent & mid)
    if values.shape[2] == 1 and np.any(rough > _PERHAPS_MOSAIC):
        same_colour = np.zeros_like(mid)
        same_colour[:, 1:-1] = _is_off_line(values, 2, least)
        rough = np.where(rough > _PERHAPS_MOSAIC, _average_tiles(same_colour & mid), rough)
    return np.stack([_average_tiles(mid), rough])


def _is_off_line(values: NDArray[np.floating], apart: int, least: float) -> BoolArray:
    """Return whether each pixel is off the line through those so many columns to its left and right."""
    left, middle, right = values[:, : -2 * apart], values[:, apart:-apart], values[:, 2 * apart :]
    return np.asarray(np.abs(right - 2.0 * middle + left) >= least)


def _average_tiles(marked: BoolArray) -> FloatArray:
    columns = marked.shape[1] // _TILE_PX
    tiles = marked[:, : columns * _TILE_PX].reshape(len(marked), columns, _TILE_PX, marked.shape[2])
    return np.asarray(tiles.mean(axis=(0, 2, 3), dtype=np.float64))


def shared_texture(now: ImageTiles, before: ImageTiles) -> float | None:
    """Return the share of textured tiles that two images have in common; None where too few are textured."""
    if now.hashes.shape != before.hashes.shape or not (now.is_textured and before.is_textured):
        return None
    either = now.textured | before.textured
    return float(np.mean(now.hashes[either] == before.hashes[either]))


def differs_by_noise(now: ImageTiles, before: ImageTiles) -> bool:
    """Return whether two images differ as by noise: each textured tile independently, up or down."""
    either = now.textured | before.textured
    change = np.where(either, np.sign(now.means - before.means), 0.0)
    products = np.concatenate([(change[1:] * change[:-1]).ravel(), (change[:, 1:] * change[:, :-1]).ravel()])
    n = np.count_nonzero(products)
    return bool(n >= _FEWEST_NEIGHBOURS and np.count_nonzero(products > 0.0) <= _AGREEING * n)


def is_same_texture(now: ImageTiles, before: ImageTiles) -> bool:
    """Return whether two images have the same texture, but for text that changes."""
    shared = shared_texture(now, before)
    return shared is not None and shared >= 1.0 - _TEXT_SHARE


def is_same_sun(now: ImageTiles, before: ImageTiles, at_px: tuple[float, float]) -> bool:
    """Return whether two images are the same around the sun, x and y px, and all over but for text that changes."""
    if now.hashes.shape != before.hashes.shape:
        return False
    equal = now.hashes == before.hashes
    column, row = (int(at // _TILE_PX) for at in at_px)
    reach = max(_AROUND_TILES, round(_AROUND_SHARE * min(equal.shape)))
    around = (slice(max(row - reach, 0), row + reach + 1), slice(max(column - reach, 0), column + reach + 1))
    textured = now.textured[around] | before.textured[around]
    if np.count_nonzero(textured) < _FEWEST_AROUND or not equal[around][textured].all():
        return False
    return float(np.mean(equal)) >= 1.0 - _TEXT_SHARE
