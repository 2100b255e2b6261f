"""The two loops over every pixel: the light of the sky, and what the sensor makes of light."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sunarc.array_types import IntArray
from sunarc.jit import njit
from sunarc.simulation.scene_parts import CloudLayer

Float32Array = NDArray[np.float32]

_TEXELS_PER_HEIGHT = 200.0
_FLATTENING = 0.12  # keeps the far rim of the clouds at a finite distance, as the Earth's curvature does


@njit(nogil=True, inline="always")
def transmittance_towards(  # noqa: PLR0917 - numba inlines positional arguments best
    layer: NDArray[np.float32],
    offset_x: np.float32,
    offset_y: np.float32,
    east: np.float32,
    north: np.float32,
    up: np.float32,
) -> np.float32:
    """Return the layer's transmittance in one direction, 1 below the horizon (bilinear, periodic)."""
    if up <= np.float32(0.0) or layer.shape[0] == 1:
        return np.float32(1.0)
    scale = np.float32(_TEXELS_PER_HEIGHT) / (up + np.float32(_FLATTENING))
    x, y = east * scale + offset_x, north * scale + offset_y
    column, row = np.int32(x), np.int32(y)
    fx, fy = x - np.float32(column), y - np.float32(row)
    last, one = np.int32(layer.shape[0] - 1), np.int32(1)
    left, right = np.uint32(column & last), np.uint32((column + one) & last)
    top, bottom = np.uint32(row & last), np.uint32((row + one) & last)
    upper = layer[top, left] + fx * (layer[top, right] - layer[top, left])
    lower = layer[bottom, left] + fx * (layer[bottom, right] - layer[bottom, left])
    return np.float32(upper + fy * (lower - upper))


@njit(nogil=True, error_model="numpy")
def sky_light(
    field: Float32Array, sun: Float32Array, levels: Float32Array, clouds: CloudLayer, out: Float32Array
) -> None:
    """Write the light of sky, clouds, ground and the lens's glare.

    Parameters
    ----------
    field : (h, w, 4) from `pixel_field`.
    sun : (3,) direction of the sun.
    levels : clear zenith, cloud, ground, glare (strength, core), forward scattering in cloud.
    clouds : a layer of size 1 is a clear sky.
    out : (h, w) light in the units of `levels`.
    """
    zenith, cloud, ground, glare, core, forward = levels
    layer, offset_x, offset_y = clouds
    cloudy = layer.shape[0] > 1
    one, half, far = np.float32(1.0), np.float32(0.5), np.float32(0.02)
    steep, base, swing = np.float32(1.5), np.float32(0.8), np.float32(0.4)
    height, width = out.shape
    for row in range(height):
        for column in range(width):
            sees = field[row, column, 3]
            if sees == np.float32(0.0):
                out[row, column] = np.float32(0.0)
                continue
            east, north, up = field[row, column, 0], field[row, column, 1], field[row, column, 2]
            dx, dy, dz = east - sun[0], north - sun[1], up - sun[2]
            chord2 = dx * dx + dy * dy + dz * dz  # the chord's square, exact also close to the sun
            near, wide = chord2 + core, chord2 + far
            halo = np.float32(0.0)
            if sees > np.float32(0.0):
                low, cosine = one - up, one - half * chord2
                light = zenith * (one + steep * low * low * low) * (base + swing * cosine * cosine)
                if cloudy:
                    through = transmittance_towards(layer, offset_x, offset_y, east, north, up)
                    light = light * through + cloud * (half + half * through) * (one - through)
                    halo = forward * through * (one - through)
                light *= sees
            else:
                light = -sees * ground
            # glare / near + halo / wide, with one division
            out[row, column] = light + np.abs(sees) * (glare * wide + halo * near) / (near * wide)


@njit(nogil=True, error_model="numpy")
def count_light(  # noqa: PLR0917 - numba takes arguments by position
    light: Float32Array,
    smear_e: Float32Array,
    noise: Float32Array,
    starts: IntArray,
    sensor: Float32Array,
    out: NDArray[np.uint16],
) -> None:
    """Write the counts of an exposure.

    Parameters
    ----------
    light : (h, w) light.
    smear_e : (w,) electrons that every row of a column gets besides.
    noise : (n,) unit normal numbers; starts (h,) where each row begins in them.
    sensor : electrons per light, most electrons, read noise squared (or less than 0: no noise at all),
        counts per electron, black level, full scale.
    out : (h, w).
    """
    per_light, most, read_square, per_electron, black, full = sensor
    height, width = out.shape
    half, zero = np.float32(0.5), np.float32(0.0)
    shot = np.float32(1.0) if read_square >= zero else zero
    floor = max(read_square, zero)
    for row in range(height):
        start = starts[row]
        for column in range(width):
            electrons = min(light[row, column] * per_light + smear_e[column], most)
            electrons += noise[start + column] * np.sqrt(shot * electrons + floor)
            counts = black + electrons * per_electron + half
            out[row, column] = np.uint16(min(max(counts, zero), full))


_REACH = 4.0
"""Radius of a point's image in units of its sigma."""


@njit(nogil=True, error_model="numpy")
def add_glow(  # noqa: PLR0917 - numba takes arguments by position
    field: Float32Array,
    levels: Float32Array,
    city: Float32Array,
    moon: Float32Array,
    clouds: CloudLayer,
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
    clouds : a layer of size 1 is a clear sky.
    out : (h, w) light.
    """
    airglow, dome, moonlit, glare = levels
    layer, offset_x, offset_y = clouds
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
