"""Loops of the sky of the night: its diffuse light, and the images of its points."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sunarc.jit import njit
from sunarc.simulation.kernels import Float32Array, transmittance_towards

_REACH = 4.0
"""Radius of a point's image in units of its sigma."""


@njit(nogil=True, error_model="numpy")
def add_glow(  # noqa: PLR0917 - numba takes arguments by position
    field: Float32Array,
    levels: Float32Array,
    city: Float32Array,
    moon: Float32Array,
    layer: Float32Array,
    offset_x: np.float32,
    offset_y: np.float32,
    out: Float32Array,
) -> None:
    """Add the diffuse light of the night to an image.

    Parameters
    ----------
    field : (h, w, 4) from `pixel_field`.
    levels : the dark zenith, the town's dome on the horizon, the moonlit sky far from the moon, the lens's glare one
        degree from the moon; in light.
    city : (2,) east and north of the town.
    moon : (3,) direction of the moon.
    layer, offset_x, offset_y : the clouds; a layer of size 1 is a clear sky.
    out : (h, w) light.
    """
    airglow, dome, moonlit, glare = levels
    one, steep = np.float32(1.0), np.float32(4.0)
    core, degree = np.float32(8e-5), np.float32(3.05e-4)
    height, width = out.shape
    for row in range(height):
        for column in range(width):
            sees = field[row, column, 3]
            if sees <= np.float32(0.0):
                continue  # the ground is dark
            east, north, up = field[row, column, 0], field[row, column, 1], field[row, column, 2]
            low = one - up
            towards = max(east * city[0] + north * city[1], np.float32(0.0))
            town = dome * (np.float32(0.15) + np.float32(0.85) * towards * towards) * np.exp(-steep * up)
            dx, dy, dz = east - moon[0], north - moon[1], up - moon[2]
            chord2 = dx * dx + dy * dy + dz * dz
            lit = moonlit * (one + np.float32(0.1) / (chord2 + np.float32(0.05)))
            sky = airglow * (one + low * low) + town + lit
            through = transmittance_towards(layer, offset_x, offset_y, east, north, up)
            # a cloud takes away the airglow above it, and throws back the town's light and the moon's
            cloud = np.float32(0.2) * airglow + np.float32(3.0) * town + np.float32(2.0) * lit
            light = sky * through + cloud * (one - through) + glare * through * degree / (chord2 + core)
            out[row, column] += sees * light


@njit(nogil=True)
def add_points(points: NDArray[np.float64], out: Float32Array) -> None:
    """Add Gaussian images, integrated over each pixel.

    Parameters
    ----------
    points : (n, 4) column, row, light in all, sigma; px of `out`.
    out : (h, w) light.
    """
    height, width = out.shape
    for index in range(points.shape[0]):
        x, y, flux, sigma = points[index, 0], points[index, 1], points[index, 2], points[index, 3]
        reach = _REACH * sigma + 1.0
        left, right = max(math.floor(x - reach), 0), min(math.ceil(x + reach), width - 1)
        top, bottom = max(math.floor(y - reach), 0), min(math.ceil(y + reach), height - 1)
        scale = 1.0 / (math.sqrt(2.0) * sigma)
        for row in range(top, bottom + 1):
            down = 0.5 * (math.erf((row + 0.5 - y) * scale) - math.erf((row - 0.5 - y) * scale))
            for column in range(left, right + 1):
                across = 0.5 * (math.erf((column + 0.5 - x) * scale) - math.erf((column - 0.5 - x) * scale))
                out[row, column] += np.float32(flux * down * across)
