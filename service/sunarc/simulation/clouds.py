"""Clouds: one periodic layer of optical depth, drawn once per weather and moved by the wind."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sunarc.array_types import FloatArray
from sunarc.simulation.options import Weather

_SIZE = 1024
_WIND_TEXELS_PER_S = (1.3, 0.37)  # 10 m/s under a base of 1500 m


class CloudLayer(NamedTuple):
    """The layer at one moment: transmittance (1024, 1024), periodic, and its offset in texels, positive."""

    transmittance: NDArray[np.float32]
    offset_x: np.float32
    offset_y: np.float32


CLEAR_SKY = CloudLayer(np.ones((1, 1), dtype=np.float32), np.float32(0.0), np.float32(0.0))
"""No clouds."""


def cloud_layer(weather: Weather, *, seed: int, unix_s: float) -> CloudLayer:
    """Return the clouds of a weather at a moment."""
    if weather == "clear":
        return CLEAR_SKY
    # eight periods more keep every position of the layer positive
    offset_x, offset_y = (np.float32(speed * unix_s % _SIZE + 8.0 * _SIZE) for speed in _WIND_TEXELS_PER_S)
    return CloudLayer(_transmittance(weather, seed), offset_x, offset_y)


@lru_cache(maxsize=4)
def _transmittance(weather: Weather, seed: int) -> NDArray[np.float32]:
    noise = _fractal_noise(np.random.default_rng([seed, 77]))
    match weather:
        case "veil":
            depth = np.clip(0.6 + 0.35 * noise, 0.1, None)
        case "broken":
            depth = 5.0 * np.clip(noise, 0.0, None)
        case _:
            depth = np.clip(12.0 + 3.0 * noise, 8.0, None)
    return np.exp(-depth).astype(np.float32)


def _fractal_noise(rng: np.random.Generator) -> FloatArray:
    """Draw periodic noise of unit variance with the spectrum of cloud fields (power ~ k^-11/3)."""
    frequency = np.fft.fftfreq(_SIZE)
    k = np.hypot(frequency[:, None], frequency[None, :])
    k[0, 0] = np.inf
    amplitude = (k**2 + (10.0 / _SIZE) ** 2) ** (-11.0 / 12.0)
    noise = np.fft.ifft2(np.fft.fft2(rng.standard_normal((_SIZE, _SIZE))) * amplitude).real
    return np.asarray((noise - noise.mean()) / noise.std())
