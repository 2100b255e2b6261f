"""The light around a saturated sun: the point about which it is symmetric.

An outline alone is pulled by whatever is bright beside the sun, and by the slope of the sky. The light further out
tells more: around the sun it is any function of the (elliptic) distance plus a plane, and what else is bright there (a
contrail, a cloud, dirt on the dome) stands out from it and is left out.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sunarc.array_types import FloatArray
from sunarc.robust_statistics import biweights, mad_sigma

_INNER, _OUTER = 1.05, 2.6  # of the saturated radius
_MARGIN_PX = 1.5
_SATURATED, _BLACK = 0.985, 0.03
_RINGS, _SECTORS = 12, 24
_ROUNDS = 20
_CUT = 4.0
_LEAST_SCALE = 0.004  # of the top level: the rounding and compression of 8 bits
_LEAST_PIXELS = 150
_LEAST_RING = 12
_LOW = 0.25  # quantile of a ring's light that is its profile: what does not belong there is brighter
_SIGMA_OF_LOW = 2.1  # a normal distribution's sigma over the median distance of what is below that quantile
_SHAPE_SIGMA = 0.25  # of the ellipse's two numbers: a fisheye draws circles out by 1.4 at most


class Halo(NamedTuple):
    """What the light around the sun is symmetric about.

    x, y, sigma_px : px; the sigma is that of leaving sectors out. ellipticity : 1 - minor/major axis. share : of the
    directions around the sun whose light follows. scatter : of the rest about it, over the fall from ring to ring.
    fall : of the light from the first ring to the last, over the top level. edge : the first ring's light: next to the
    sun it is hardly less, next to a white wall it is the sky's.
    """

    x: float
    y: float
    sigma_px: float
    ellipticity: float
    share: float
    scatter: float
    fall: float
    edge: float


class _Pixels(NamedTuple):
    """Places (n, 2) and light (n,) of the pixels that take part."""

    position: FloatArray
    light: FloatArray


class _Rings(NamedTuple):
    """At a state: ring of each pixel and its sector, residual, Jacobian (n, 6), weight, profile (rings,)."""

    ring: NDArray[np.intp]
    sector: NDArray[np.intp]
    residual: FloatArray
    jacobian: FloatArray
    weight: FloatArray
    profile: FloatArray


def halo_about(light: FloatArray, *, center: tuple[float, float], radius: float) -> Halo | None:
    """Return the centre of the light around a saturated blob; None where there is too little to tell.

    Parameters
    ----------
    light : (rows, columns), linear, 1 where saturated.
    center, radius : of the blob's outline, px.
    """
    inner = _INNER * radius + _MARGIN_PX
    state = np.array([center[0], center[1], 0.0, 0.0, 0.0, 0.0])
    pixels = _around(light, state, _OUTER * inner)
    if pixels is None:
        return None
    rings = None
    for step in range(_ROUNDS):
        rings = _ringed(pixels, state, inner, cut=max(_CUT, 12.0 / (step + 1)))
        if rings is None:
            return None
        change = _step(rings, state)
        state += np.clip(change, -0.1 * radius - 0.5, 0.1 * radius + 0.5)
        state[2:4] = np.clip(state[2:4], -0.4, 0.4)
        if max(abs(change[0]), abs(change[1])) < 1e-3:
            break
    return None if rings is None else _summary(rings, state)


def _around(light: FloatArray, state: FloatArray, reach: float) -> _Pixels | None:
    x0, y0 = max(0, math.floor(state[0] - reach)), max(0, math.floor(state[1] - reach))
    part = light[y0 : math.ceil(state[1] + reach) + 1, x0 : math.ceil(state[0] + reach) + 1]
    rows, columns = np.nonzero((part < _SATURATED) & (part > _BLACK))
    if rows.size < _LEAST_PIXELS:
        return None
    values = part[rows, columns].astype(np.float64)
    return _Pixels(np.column_stack([columns + x0, rows + y0]).astype(np.float64), values)


def _ringed(pixels: _Pixels, state: FloatArray, inner: float, *, cut: float) -> _Rings | None:
    """Sort the pixels into rings of equal distance, and say how far each is from its ring's light."""
    shape = np.array([[1.0 + state[2], state[3]], [state[3], 1.0 - state[2]]])
    offset = pixels.position - state[:2]
    transformed = offset @ shape
    distance = np.sqrt(np.maximum(np.sum(transformed * offset, axis=1), 1e-9))
    inside = (distance > inner) & (distance < _OUTER * inner)
    if np.count_nonzero(inside) < _LEAST_PIXELS:
        return None
    offset, transformed, distance, value = offset[inside], transformed[inside], distance[inside], pixels.light[inside]
    # Rings of equal ratio: the glare falls by a power of the distance.
    edges = inner * (_OUTER ** (np.arange(_RINGS + 1) / _RINGS))
    ring = np.clip(np.searchsorted(edges, distance) - 1, 0, _RINGS - 1)
    flat = value - offset @ state[4:] / inner
    middle = np.array([np.median(distance[ring == k]) if np.any(ring == k) else np.nan for k in range(_RINGS)])
    profile = np.array(
        [np.quantile(flat[ring == k], _LOW) if np.sum(ring == k) >= _LEAST_RING else np.nan for k in range(_RINGS)]
    )
    valid = np.isfinite(profile) & np.isfinite(middle)
    if np.count_nonzero(valid) < _RINGS // 2:
        return None
    profile, middle = profile[valid], middle[valid]
    # Where the profile rises (a cloud's rim), its slope says nothing of the centre.
    slope = np.minimum(np.interp(distance, middle, np.gradient(profile, middle)), 0.0)
    residual = flat - np.interp(distance, middle, profile)
    jacobian = np.column_stack(
        [
            -slope * transformed[:, 0] / distance,
            -slope * transformed[:, 1] / distance,
            slope * (offset[:, 0] ** 2 - offset[:, 1] ** 2) / (2.0 * distance),
            slope * offset[:, 0] * offset[:, 1] / distance,
            offset[:, 0] / inner,
            offset[:, 1] / inner,
        ]
    )
    sector = np.floor((np.arctan2(offset[:, 1], offset[:, 0]) / (2.0 * math.pi) + 0.5) * _SECTORS).astype(np.intp)
    weight = _weights(residual, ring, cut)
    return _Rings(ring, np.minimum(sector, _SECTORS - 1), residual, jacobian, weight, profile)


def _weights(residual: FloatArray, ring: NDArray[np.intp], cut: float) -> FloatArray:
    """Return Tukey's weights over each ring's own variance."""
    scale = np.empty(_RINGS)
    for k in range(_RINGS):
        below = residual[(ring == k) & (residual < 0.0)]
        scale[k] = -_SIGMA_OF_LOW * float(np.median(below)) if below.size else 1.0
    each = np.maximum(scale, _LEAST_SCALE)[ring]
    return np.asarray(biweights(residual / (cut * each)) / each**2)


def _normal(rings: _Rings, state: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return each sector's share of the normal equations, (sectors, 6, 6) and (sectors, 6); ring levels are free."""
    total = np.maximum(np.bincount(rings.ring, rings.weight, _RINGS), 1e-12)
    means = np.stack([np.bincount(rings.ring, rings.weight * column, _RINGS) / total for column in rings.jacobian.T])
    offset = np.bincount(rings.ring, rings.weight * rings.residual, _RINGS) / total
    jacobian = rings.jacobian - means[:, rings.ring].T
    residual = rings.residual - offset[rings.ring]
    matrix, gradient = np.zeros((_SECTORS, 6, 6)), np.zeros((_SECTORS, 6))
    for k in range(_SECTORS):
        in_sector = rings.sector == k
        weighted = jacobian[in_sector] * rings.weight[in_sector, None]
        matrix[k], gradient[k] = weighted.T @ jacobian[in_sector], weighted.T @ residual[in_sector]
    # The prior on the ellipse has a fiftieth of the pixels' weight: a short arc cannot trade shape for position.
    prior = np.zeros(6)
    prior[2:4] = _SHAPE_SIGMA**-2 * rings.weight.size / 50.0
    matrix += np.diag(prior) / _SECTORS
    gradient[:, :] -= prior * state / _SECTORS
    return matrix, gradient


def _step(rings: _Rings, state: FloatArray) -> FloatArray:
    matrix, gradient = _normal(rings, state)
    return np.asarray(np.linalg.solve(matrix.sum(axis=0) + 1e-9 * np.eye(6), gradient.sum(axis=0)))


def _summary(rings: _Rings, state: FloatArray) -> Halo:
    matrix, gradient = _normal(rings, state)
    total, slope = matrix.sum(axis=0) + 1e-9 * np.eye(6), gradient.sum(axis=0)
    estimates = np.stack([np.linalg.solve(total - m, slope - g) for m, g in zip(matrix, gradient, strict=True)])
    spread = estimates[:, :2] - estimates[:, :2].mean(axis=0)
    variance = (_SECTORS - 1.0) / _SECTORS * float(np.sum(spread**2)) / 2.0
    used = np.bincount(rings.sector, rings.weight > 0.0, _SECTORS)
    available = np.bincount(rings.sector, minlength=_SECTORS)
    follows = (used > 0.6 * available) & (available > 0.3 * available.mean())
    fall = float(rings.profile[0] - rings.profile[-1])
    scatter = mad_sigma(rings.residual)
    squeeze = math.hypot(float(state[2]), float(state[3]))
    return Halo(
        float(state[0]),
        float(state[1]),
        math.sqrt(variance),
        1.0 - math.sqrt((1.0 - squeeze) / (1.0 + squeeze)),
        float(np.mean(follows)),
        scatter / max(fall, 1e-9),
        fall,
        float(rings.profile[0]),
    )
