"""Thirteen exposures of one time by a colour camera: mosaic, noise, interpolated colours, tones and JPEG of their own.

Nothing of the package is used: the light is a limb-darkened disc with three haloes, a sky with an aureole, and clouds
or a reflection where they are asked for.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve, gaussian_filter

Light = NDArray[np.float64]
EXPOSURES_US = tuple(round(10.0 * 2.2**step) for step in range(13))
"""From 10 µs, in which the disc is a dot on black, to 0.13 s, in which the sky is saturated far about the sun."""


class Series(NamedTuple):
    """What the thirteen images are of.

    sun: centre of the disc, px; None: overcast without a sun. radius: of the disc, px. glint: a reflection's place.
    dimmed: share of the sun's light that passes a thin cloud. quality: of JPEG. lamp: a place without haloes about it.
    haze: light that falls off steeply about the sun. aside: how far right of the disc the middle of the haloes is, px.
    frosted: light of a lamp behind frosted glass at that place.
    """

    sun: tuple[float, float] | None
    radius: float = 2.1
    size: tuple[int, int] = (640, 480)
    glint: tuple[float, float] | None = None
    dimmed: float = 1.0
    cloud: float = 0.3
    quality: int = 92
    night: bool = False
    lamp: tuple[float, float] | None = None
    lamp_level: float = 0.5
    lamp_radius: float = 1.5
    haze: float = 0.0
    aside: float = 0.0
    frosted: float = 0.0


def series(what: Series, seed: int) -> dict[int, NDArray[np.uint8]]:
    """Return the image (rows, columns, 3) of each exposure in µs."""
    rng = np.random.default_rng(seed)
    light = _light(what, rng)
    return {us: _photograph(light * us * 3.0e-1 / 10.0, what, rng) for us in EXPOSURES_US}


def _light(what: Series, rng: np.random.Generator) -> Light:
    """Return the light on the sensor, 1.0 the sun's disc in the shortest exposure by 0.3 of full scale."""
    width, height = what.size
    rows, columns = np.mgrid[:height, :width].astype(np.float64)
    sky = np.full((height, width), 0.0 if what.night else 6e-4)
    texture = gaussian_filter(rng.standard_normal((height, width)), 14.0)
    sky *= 1.0 + what.cloud * np.clip(texture / texture.std(), 0.0, 3.0)
    for place, level, radius in ((what.glint, 0.02, 1.2), (what.lamp, what.lamp_level, what.lamp_radius)):
        if place is not None:
            sky += level * _disc(columns - place[0], rows - place[1], radius)
    if what.lamp is not None:
        far = np.hypot(columns - what.lamp[0], rows - what.lamp[1])
        sky += what.frosted * np.exp(-((far / (1.1 * what.lamp_radius)) ** 2))
    if what.sun is None:
        return sky
    x, y = columns - what.sun[0], rows - what.sun[1]
    far = np.hypot(x - what.aside, y)
    haloes = (
        (2.5e-3 + what.haze) / (1.0 + (far / 5.0) ** 2) ** 1.3
        + 1.2e-3 * np.exp(-far / 40.0)
        + 4e-4 / (1.0 + far / 90.0)
    )
    streak = 4e-4 * np.exp(-np.abs(0.8 * x - 0.6 * y) / 1.5) * np.exp(-far / 60.0)
    light = sky + what.dimmed * (_disc(x, y, what.radius) + haloes + streak) + (1.0 - what.dimmed) * 8e-4
    return np.asarray(light)


def _disc(x: Light, y: Light, radius: float) -> Light:
    """Return a limb-darkened disc, seen by a lens that blurs it by 0.7 px; integrated over each pixel."""
    offsets = (np.arange(5) - 2.0) / 5.0
    total = np.zeros_like(x)
    near = np.hypot(x, y) < radius + 8.0
    for dx in offsets:
        for dy in offsets:
            squared = 1.0 - ((x[near] + dx) ** 2 + (y[near] + dy) ** 2) / radius**2
            total[near] += np.where(squared > 0.0, 0.4 + 0.6 * np.sqrt(np.clip(squared, 0.0, 1.0)), 0.0) / 25.0
    return np.asarray(gaussian_filter(total, 0.7))


_GAINS = np.array([[0.62, 1.0], [1.0, 0.55]])  # of an RGGB mosaic
_GREEN = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]]) / 4.0
_OTHER = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]]) / 4.0


def _photograph(light: Light, what: Series, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return what the camera stores: mosaic of 12 bits, colours by linear interpolation, white balance, tones, JPEG."""
    height, width = light.shape
    gains = np.tile(_GAINS, (height // 2, width // 2))
    electrons = rng.poisson(np.clip(light * gains, 0.0, 1.3) * 9000.0) + rng.normal(0.0, 8.0, light.shape)
    counts = np.clip(np.round(electrons / 9000.0 * 4095.0), 0, 4095) / 4095.0
    masks = [np.zeros((height, width)) for _ in range(3)]
    masks[0][::2, ::2], masks[2][1::2, 1::2] = 1.0, 1.0
    masks[1][::2, 1::2] = masks[1][1::2, ::2] = 1.0
    planes = [convolve(counts * mask, _GREEN if n == 1 else _OTHER, mode="mirror") for n, mask in enumerate(masks)]
    balanced = np.stack([planes[0] / 0.62, planes[1], planes[2] / 0.55], axis=-1)
    tones = np.round(255.0 * np.clip(balanced, 0.0, 1.0) ** (1 / 2.2)).astype(np.uint8)
    encoded = cv2.imencode(".jpg", tones[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, what.quality])[1]
    image = cv2.imdecode(encoded, cv2.IMREAD_COLOR)
    assert image is not None
    return image.astype(np.uint8)
