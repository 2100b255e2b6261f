"""Which part of a sky is clear: detections that are the texture of clouds, and predicted stars that clouds hide."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from sunarc.array_types import BoolArray, FloatArray
from sunarc.detection.stars.values import Stars

_FAINT_SNR, _TEXTURE, _CLEAREST = 25.0, 3.0, 0.25
"""A detection of a signal-to-noise ratio below 25 whose noise is 3 times that of the clearest quarter lies on cloud. On
rendered broken cloud the noise of stars is within a factor of 2, that of cloud's edges 3 to 10 times as large."""
_NEIGHBOURS, _NEIGHBOURS_SEEN, _FEWEST = 8, (4, 6), 8
"""The sky about a star is clear where 4, or 6, of the 8 bright ones next to it are detected: in haze the former leaves
the larger share, between small clouds the latter. Of neighbours that chance matches at 15 % so many are hardly ever."""


def on_cloud(stars: Stars) -> BoolArray:
    """Return (n,): which detections are faint against a texture about them: edges of clouds, at whatever flux."""
    noise = stars.flux / np.maximum(stars.snr, 1e-12)
    faint: BoolArray = stars.snr < _FAINT_SNR
    if not np.any(faint):
        return faint
    return np.asarray(faint & (noise > _TEXTURE * float(np.quantile(noise[faint], _CLEAREST))))


def share_where_clear(pixels: FloatArray, seen: BoolArray) -> float:
    """Return the share of bright stars that are seen, of those about which the sky is clear: 0 where these are few.

    Parameters
    ----------
    pixels : (n, 2) where bright stars are predicted.
    seen : (n,) whether each is detected; it says nothing of the sky about itself.
    """
    if pixels.shape[0] <= _NEIGHBOURS:
        return 0.0
    beside = np.asarray(cKDTree(pixels).query(pixels, k=_NEIGHBOURS + 1)[1])[:, 1:]
    about = seen[beside].sum(axis=1)
    clear = [about >= least for least in _NEIGHBOURS_SEEN]
    return max((float(np.mean(seen[part])) for part in clear if part.sum() >= _FEWEST), default=0.0)
