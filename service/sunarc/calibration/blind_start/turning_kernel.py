"""The compiled loop of the search: how many detections of one image come onto those of another."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.jit import njit

_CELLS = 128


class Turns(NamedTuple):
    """Poles (k, 3), unit vectors in the camera's frame, and the angles of the turns about them (k,), radians."""

    poles: FloatArray
    angles: FloatArray


@njit()
def _counts(  # noqa: PLR0917 - numba takes no names
    rays: FloatArray, near: FloatArray, half: float, poles: FloatArray, angles: FloatArray, shape: float, largest: float
) -> FloatArray:
    """Return (k,): the share of the mapped rays in the image that fall on marked cells; 0 where few are in it."""
    n = near.shape[0]
    found = np.zeros(poles.shape[0])
    for k in range(poles.shape[0]):
        px, py, pz = poles[k]
        cosine, sine = math.cos(angles[k]), math.sin(angles[k])
        hits, inside = 0.0, 0
        for i in range(rays.shape[0]):
            x, y, z = rays[i]
            along = (px * x + py * y + pz * z) * (1.0 - cosine)
            u = x * cosine + (py * z - pz * y) * sine + px * along
            v = y * cosine + (pz * x - px * z) * sine + py * along
            w = z * cosine + (px * y - py * x) * sine + pz * along
            across = math.hypot(u, v)
            theta = math.atan2(across, w)
            if theta > largest:
                continue
            if shape > 1e-6:
                radius = math.tan(min(shape * theta, 1.5)) / shape
            elif shape < -1e-6:
                radius = math.sin(min(-shape * theta, 0.5 * math.pi)) / -shape
            else:
                radius = theta
            scale = radius / max(across, 1e-12)
            column, row = int((u * scale / half + 1.0) * 0.5 * n), int((v * scale / half + 1.0) * 0.5 * n)
            inside += 1
            if 0 <= column < n and 0 <= row < n:
                hits += near[row, column]
        found[k] = hits / max(inside, rays.shape[0] // 3)
    return found


@njit()
def _marked(onto: FloatArray, half: float, reach: float, n: int) -> tuple[FloatArray, float]:
    """Return (n, n) cells over -half to half, 1 where a detection is near, and the share of those in the disc."""
    near = np.zeros((n, n))
    cell = 2.0 * half / n
    for k in range(onto.shape[0]):
        x, y = onto[k]
        for row in range(max(int((y - reach + half) / cell), 0), min(int((y + reach + half) / cell) + 1, n)):
            for column in range(max(int((x - reach + half) / cell), 0), min(int((x + reach + half) / cell) + 1, n)):
                apart = math.hypot((column + 0.5) * cell - half - x, (row + 0.5) * cell - half - y)
                if apart <= reach:
                    near[row, column] = 1.0
    marked, inside = 0.0, 0
    for row in range(n):
        for column in range(n):
            if math.hypot((column + 0.5) * cell - half, (row + 0.5) * cell - half) <= half:
                marked += near[row, column]
                inside += 1
    return near, marked / inside


def count_on_detections(
    rays: FloatArray,
    onto: FloatArray,
    turns: Turns,
    *,
    shape: float,
    reach: float,
    largest: float,
) -> FloatArray:
    """Return (k,): the share of rays that come near a detection when they turn about a pole, less chance's share.

    Parameters
    ----------
    rays : (n, 3) unit vectors in the camera's frame.
    onto : (m, 2) detections, focal lengths from the axis.
    turns : poles and angles.
    shape : of the lens (`lens_family`).
    reach : what is near, focal lengths.
    largest : angle off the axis to which rays count, radians.
    """
    half = float(np.quantile(np.max(np.abs(onto), axis=-1), 0.98)) + 2.0 * reach
    near, chance = _marked(np.ascontiguousarray(onto), half, reach, _CELLS)
    counts = _counts(
        np.ascontiguousarray(rays), near, half, np.ascontiguousarray(turns.poles), turns.angles, shape, largest
    )
    return np.asarray((counts - chance) / max(1.0 - chance, 0.1))
