"""Cubic B-splines on a grid of equal steps: weights of the four nodes about a place."""

from __future__ import annotations

from sunarc.jit import njit


@njit(nogil=True)
def spline_weights(position: float, last: int) -> tuple[int, float, float, float, float]:
    """Return the first of four nodes and the weights of a cubic spline."""
    node = min(int(position), last)
    s = position - node
    t = 1.0 - s
    third = (-3.0 * s * s * s + 3.0 * s * s + 3.0 * s + 1.0) / 6.0
    return node, t * t * t / 6.0, (3.0 * s * s * s - 6.0 * s * s + 4.0) / 6.0, third, s * s * s / 6.0
