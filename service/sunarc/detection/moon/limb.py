"""The image of the moon's lit part: between the bright limb (a half circle) and the terminator (half an ellipse).

Coordinates of the disc: u towards the middle of the lit limb, v across, in units of the radius; at the phase angle i
the points with -cos(i) sqrt(1 - v²) < u < sqrt(1 - v²) are lit.

Reference: B. Hapke, "Theory of Reflectance and Emittance Spectroscopy" (2012), chapter 8: the laws of Lommel and
Seeliger (a full moon is even) and of Lambert (the terminator is dark); the real moon lies between.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from sunarc.array_types import FloatArray

_ACROSS, _ALONG = 24, 16
"""Nodes of the Gauss-Legendre rule: a moon of 40 px is exact to 1e-3 of its level with a point spread of 0.7 px."""
_LEAST_WIDTH_PX = 0.2


class Surface(NamedTuple):
    """Nodes (n, 2) on the lit part, and the light of each, (k, n).

    The rows: the law of Lommel and Seeliger, of sum 1; Lambert's less that; and the first times polynomials of the
    place to the third degree, of unit rms over the disc: what seas and highlands make of it.
    """

    nodes: FloatArray
    light: FloatArray


def lit_surface(cos_phase: float) -> Surface:
    """Return the lit part of a disc at a phase angle."""
    t, across = np.polynomial.legendre.leggauss(_ACROSS)
    s, along = np.polynomial.legendre.leggauss(_ALONG)
    # v = sin(angle): the ends of the horns are dense, where the chord goes to 0
    angle = 0.5 * np.pi * t
    v, chord = np.sin(angle), np.cos(angle)
    first, last = -cos_phase * chord, chord
    u = 0.5 * ((last - first)[:, None] * s + (last + first)[:, None])
    area = (0.5 * np.pi * across * chord * 0.5 * (last - first))[:, None] * along
    v = np.broadcast_to(v[:, None], u.shape)
    emission = np.sqrt(np.maximum(1.0 - u * u - v * v, 0.0))
    incidence = np.maximum(u * np.sqrt(max(1.0 - cos_phase**2, 0.0)) + emission * cos_phase, 0.0)
    seeliger = incidence / np.maximum(incidence + emission, 1e-9) * area
    lambert = incidence * area
    seeliger, lambert = seeliger / seeliger.sum(), lambert / lambert.sum()
    light = np.stack([seeliger, lambert - seeliger, *(seeliger * one for one in _polynomials(u, v))])
    return Surface(np.stack([u.ravel(), v.ravel()], axis=-1), light.reshape(light.shape[0], -1))


def _polynomials(u: FloatArray, v: FloatArray) -> list[FloatArray]:
    """Return Zernike's polynomials of the first to third degree, of unit rms over the whole disc."""
    square = u * u + v * v
    return [
        2.0 * u,
        2.0 * v,
        np.sqrt(3.0) * (2.0 * square - 1.0),
        np.sqrt(6.0) * (u * u - v * v),
        np.sqrt(6.0) * 2.0 * u * v,
        np.sqrt(8.0) * (3.0 * square - 2.0) * u,
        np.sqrt(8.0) * (3.0 * square - 2.0) * v,
        np.sqrt(8.0) * (u**3 - 3.0 * u * v * v),
        np.sqrt(8.0) * (3.0 * u * u * v - v**3),
    ]


class PointSpread(NamedTuple):
    """1-sigma of a Gaussian along the columns and along the rows, px."""

    x: float
    y: float


def surface_images(
    surface: Surface,
    edges_px: FloatArray,
    centre: FloatArray,
    spread: PointSpread,
    *,
    origin: tuple[int, int],
    side: int,
) -> FloatArray:
    """Return the blurred images (k + 1, side, side) of a surface, each integrated over the pixels.

    The last is what a point spread of covariance xy = `spread.x * spread.y` would add to the first, to first order.

    Parameters
    ----------
    edges_px : (2, 2), of `MoonExpectation`.
    centre : (2,) of the disc, px.
    spread : widths of the point spread.
    origin, side : first pixel and size of the stamp.
    """
    pixels = surface.nodes @ edges_px.T + centre
    shares, slopes = [], []
    for axis, width in enumerate(spread):
        edge = (origin[axis] + np.arange(side + 1)[:, None] - 0.5 - pixels[:, axis]) / max(width, _LEAST_WIDTH_PX)
        shares.append(np.diff(ndtr(edge), axis=0))
        slopes.append(np.diff(np.exp(-0.5 * edge**2), axis=0) / math.sqrt(2.0 * math.pi))
    images = (surface.light[:, None, :] * shares[1]) @ shares[0].T
    skewed = (surface.light[0] * slopes[1]) @ slopes[0].T
    return np.concatenate([images, skewed[None]])
