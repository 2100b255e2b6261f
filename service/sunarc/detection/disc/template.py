"""The sun's image: a limb-darkened disc through a 2×2 stretch and a Gaussian point spread, integrated over pixels.

The disc is a set of point sources (Gauss-Legendre in radius, uniform in angle), each of which lands as a product of
two error functions, so that the image and all its derivatives come from one pass.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.jit import njit

VALUE, BY_X, BY_Y, BY_PSF, SLOPE_U, SLOPE_V, BEND_UU, BEND_UV, BY_S11, BY_S12, BY_S22 = range(11)
"""Planes of `render_disc`."""

_MOST_RINGS = 24
_DENSITIES = 8.0  # steps per unit of radius over point spread in which sources are made and kept
_REACH = 5.0  # point-spread widths beyond which a source is dark


class Sources(NamedTuple):
    """Point sources on the unit disc: positions (k, 2), weights (k,) that sum to 1, mean over central brightness."""

    positions: FloatArray
    weights: FloatArray
    mean_level: float


class SunSources(NamedTuple):
    """The same disc seen through the core of the point spread and through its wings."""

    core: Sources
    wings: Sources


WING_PSF = 3.0
"""The wings' point spread over the core's."""


def sun_sources(*, radius_px: float, psf_px: float, limb_darkening: float) -> SunSources:
    """Return the sources of a disc of this radius for a core of this point spread and its wings."""
    core, wings = (
        disc_sources(radius_px=radius_px, psf_px=psf, limb_darkening=limb_darkening)
        for psf in (psf_px, WING_PSF * psf_px)
    )
    return SunSources(core, wings)


def disc_sources(*, radius_px: float, psf_px: float, limb_darkening: float) -> Sources:
    """Return sources dense enough that a disc of this radius shows no grain through this point spread."""
    return _sources(math.ceil(_DENSITIES * radius_px / psf_px) / _DENSITIES, limb_darkening)


@lru_cache(maxsize=64)
def _sources(radius_in_psf: float, limb_darkening: float) -> Sources:
    # Rings 0.7 of the point spread apart: a coarser disc would show them, a finer one costs time a source.
    rings = min(max(4, math.ceil(1.4 * radius_in_psf)), _MOST_RINGS)
    nodes, node_weights = np.polynomial.legendre.leggauss(rings)
    radii = 0.5 * (nodes + 1.0)
    ring_weights = node_weights * radii * (1.0 - limb_darkening * (1.0 - np.sqrt(1.0 - radii**2)))
    counts = np.maximum(6, np.ceil(2.0 * math.pi * radii * radius_in_psf / 1.1)).astype(int)
    ring = np.repeat(np.arange(rings), counts)
    within = np.arange(ring.size) - np.repeat(np.cumsum(counts) - counts, counts)
    # Every other ring is turned by half a step, so that sources of neighbouring rings do not line up.
    angle = 2.0 * math.pi * (within + 0.5 * (ring % 2)) / counts[ring]
    positions = np.ascontiguousarray(radii[ring, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
    weights = ring_weights[ring] / counts[ring]
    weights /= weights.sum()
    # The cache gives the same arrays to every caller and thread.
    positions.flags.writeable = weights.flags.writeable = False
    return Sources(positions, weights, 1.0 - limb_darkening / 3.0)


@njit(nogil=True)
def _spread(first: int, last: int, center: float, psf: float, out: FloatArray) -> None:
    """Fill out (3, …) for pixels first … last: the share of a source, and its derivatives by center and psf."""
    root = math.sqrt(0.5)
    norm = 1.0 / math.sqrt(2.0 * math.pi)
    z = (first - 0.5 - center) / psf
    below, density = math.erf(z * root), norm * math.exp(-0.5 * z * z)
    for i in range(first, last + 1):
        z_next = (i + 0.5 - center) / psf
        above, density_next = math.erf(z_next * root), norm * math.exp(-0.5 * z_next * z_next)
        out[0, i] = 0.5 * (above - below)
        out[1, i] = (density - density_next) / psf
        out[2, i] = (z * density - z_next * density_next) / psf
        z, below, density = z_next, above, density_next


@njit(nogil=True)
def render_disc(  # noqa: PLR0917 - numba compiles no keyword-only arguments
    shape: tuple[int, int],
    x: float,
    y: float,
    psf: float,
    stretch: FloatArray,
    positions: FloatArray,
    weights: FloatArray,
) -> FloatArray:
    """Return the image of a disc of unit flux and its derivatives.

    Parameters
    ----------
    shape : rows and columns of the window.
    x, y : the disc's centre in the window, px.
    psf : standard deviation of the point spread, px.
    stretch : (2, 2) px, takes the unit disc to the sun's image; the derivatives take it as symmetric.
    positions, weights : the sources on the unit disc.

    Returns
    -------
    (11, rows, columns): the planes named VALUE … BY_S22; SLOPE_… and BEND_… are the image of a disc whose brightness
    is multiplied by u, v, u² - v² and uv, the coordinates on the unit disc.
    """
    rows, columns = shape
    out = np.zeros((11, rows, columns))
    across, down = np.zeros((3, columns)), np.zeros((3, rows))
    # The half pixel keeps a pixel whose near edge is within reach though its centre is not.
    reach = _REACH * psf + 0.5
    for k in range(weights.size):
        u, v, weight = positions[k, 0], positions[k, 1], weights[k]
        uu, uv = u * u - v * v, u * v
        px = x + stretch[0, 0] * u + stretch[0, 1] * v
        py = y + stretch[1, 0] * u + stretch[1, 1] * v
        i0, i1 = max(0, math.ceil(px - reach)), min(columns - 1, math.floor(px + reach))
        j0, j1 = max(0, math.ceil(py - reach)), min(rows - 1, math.floor(py + reach))
        if i1 < i0 or j1 < j0:
            continue
        _spread(i0, i1, px, psf, across)
        _spread(j0, j1, py, psf, down)
        for j in range(j0, j1 + 1):
            d0, d1, d2 = weight * down[0, j], weight * down[1, j], weight * down[2, j]
            for i in range(i0, i1 + 1):
                value, by_x, by_y = d0 * across[0, i], d0 * across[1, i], d1 * across[0, i]
                out[0, j, i] += value
                out[1, j, i] += by_x
                out[2, j, i] += by_y
                out[3, j, i] += d0 * across[2, i] + d2 * across[0, i]
                out[4, j, i] += u * value
                out[5, j, i] += v * value
                out[6, j, i] += uu * value
                out[7, j, i] += uv * value
                out[8, j, i] += u * by_x
                out[9, j, i] += v * by_x + u * by_y
                out[10, j, i] += v * by_y
    return out
