"""Hashes of an image's tiles, by which it is recognised although text in it changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sunarc.common.array_types import Image

_TILE_PX = 16
"""The largest block that JPEG codes by itself."""
_LEAST_RANGE = 0.01
"""Of the full scale within a textured tile; 3 counts at least."""
_MID_TONES, _LEAST_MID = (0.02, 0.98), 0.125
"""Of the full scale, and the share of a textured tile that is between: black and saturated pixels do not change."""
_TEXTURED_SHARE = 0.15
"""Of all tiles: two lines of text are less, on a black image too."""
_FEWEST = 12
_TEXT_SHARE = 0.2
"""Of the tiles, which text that changes may cover."""
_AROUND_SHARE, _AROUND_TILES = 0.06, 3
"""Tiles around the sun, as a share of the image's shorter side, and at least."""
_FEWEST_AROUND = 4
_NOISE_ROWS, _LEAST_BENT = 2, 2.0
"""Every so many rows are taken; a second difference of rounded smooth values is 1 count at most."""
_BLOCK_PX = 8
"""JPEG makes steps where its blocks meet."""
_MID_TONE_TILES = 0.5
"""Share of the tiles that are of mid-tones: of fewer, a foreground may be all, and it stands still."""
_SMOOTHEST, _LEAST_ROUGH = 0.25, 0.02
"""Quantile of the tiles by their share of rough pixels. Noise of 1.5 counts gives .03 to .1 in JPEG of quality 92,
and smooth images 0 in JPEG of any."""


@dataclass(frozen=True, slots=True, eq=False)
class ImageTiles:
    """The hash of each tile of an image (rows, columns), and whether the tile is textured: of changing mid-tones.

    has_noise: whether neighbouring pixels differ by more than a smooth image's that was rounded, in its sky too.
    """

    hashes: NDArray[np.uint64]
    textured: NDArray[np.bool_]
    has_noise: bool

    @property
    def is_textured(self) -> bool:
        """Whether most of what is seen is more than black, saturation and text."""
        n = int(np.count_nonzero(self.textured))
        return n >= max(_FEWEST, _TEXTURED_SHARE * self.textured.size)


def image_tiles(image: Image) -> ImageTiles:
    """Return the hashes of an image's tiles.

    Parameters
    ----------
    image : (rows, columns) or (rows, columns, channels), of integers or of floats.
    """
    values = image.reshape(len(image), -1)
    wide = _TILE_PX * (values.shape[1] // max(image.shape[1], 1) or 1)
    full = 255.0 if image.dtype == np.uint8 else max(float(image.max(initial=0)), 1.0)
    padded = np.pad(values, ((0, -len(values) % _TILE_PX), (0, -values.shape[1] % wide)), mode="edge")
    weights = np.random.default_rng(0).integers(0, 1 << 63, (_TILE_PX, wide), dtype=np.uint64) | np.uint64(1)
    rows, columns = len(padded) // _TILE_PX, padded.shape[1] // wide
    hashes, textured = np.zeros((rows, columns), np.uint64), np.zeros((rows, columns), np.bool_)
    least, (low, high) = max(3.0, _LEAST_RANGE * full), (bound * full for bound in _MID_TONES)
    for row in range(rows):
        tiles = padded[row * _TILE_PX : (row + 1) * _TILE_PX].reshape(_TILE_PX, columns, wide)
        counts = tiles.astype(np.uint64) if tiles.dtype.kind != "f" else tiles.astype(np.float64).view(np.uint64)
        hashes[row] = np.einsum("ijk,ik->j", counts, weights)
        tones = tiles.astype(np.float64)
        mid = np.mean((tones > low) & (tones < high), axis=(0, 2))
        spread = np.ptp(tones, axis=(0, 2))
        textured[row] = (spread >= least) & (mid >= _LEAST_MID)
    return ImageTiles(hashes, textured, _has_noise(image[::_NOISE_ROWS], (low, high)))


def _has_noise(image: Image, mid_tones: tuple[float, float]) -> bool:
    """Return whether even the smoothest parts of the mid-tones are rough: foregrounds are, smooth skies are not."""
    values = image.reshape(*image.shape[:2], -1).astype(np.float64)
    bent = np.abs(values[:, 2:] - 2.0 * values[:, 1:-1] + values[:, :-2]) >= _LEAST_BENT
    bent[:, np.arange(1, values.shape[1] - 1) % _BLOCK_PX % (_BLOCK_PX - 1) == 0] = False
    mid = (values[:, 1:-1] > mid_tones[0]) & (values[:, 1:-1] < mid_tones[1])
    rows, columns = (length // _TILE_PX for length in mid.shape[:2])
    shares = [
        one[: rows * _TILE_PX, : columns * _TILE_PX]
        .reshape(rows, _TILE_PX, columns, _TILE_PX, values.shape[2])
        .mean(axis=(1, 3, 4), dtype=np.float64)
        for one in (mid, bent & mid)
    ]
    rough = shares[1][shares[0] > 0.5]
    if rough.size == 0 or rough.size < _MID_TONE_TILES * shares[0].size:
        return False
    return bool(np.quantile(rough, _SMOOTHEST) >= _LEAST_ROUGH)


def shared_texture(now: ImageTiles, before: ImageTiles) -> float | None:
    """Return the share of textured tiles that two images have in common; None where too few are textured."""
    if now.hashes.shape != before.hashes.shape or not (now.is_textured and before.is_textured):
        return None
    either = now.textured | before.textured
    return float(np.mean(now.hashes[either] == before.hashes[either]))


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
