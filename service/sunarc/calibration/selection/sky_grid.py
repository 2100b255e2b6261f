"""Patches of the sky of about equal area, by which one asks how much of it was seen."""

from __future__ import annotations

import math

import numpy as np

from sunarc.array_types import FloatArray, IntArray


def sky_patches(directions: FloatArray, *, width_deg: float) -> IntArray:
    """Return (n,): the patch that each direction lies in.

    The sky is cut into rings about the zenith, `width_deg` high, and each ring into cells of about that width.

    Parameters
    ----------
    directions : (n, 3) unit vectors, east-north-up.
    width_deg : of a patch.
    """
    width = math.radians(width_deg)
    east, north, up = np.moveaxis(directions, -1, 0)
    ring = np.floor(np.arctan2(np.hypot(east, north), up) / width).astype(np.int64)
    rings = math.ceil(math.pi / width)
    middle = (np.arange(rings + 1) + 0.5) * width
    cells = np.maximum(1, np.rint(2.0 * math.pi * np.sin(np.minimum(middle, math.pi)) / width)).astype(np.int64)
    first = np.cumsum(cells) - cells
    # modulo 1, so that north's both sides are the first and the last cell
    fraction = np.arctan2(east, north) / (2.0 * math.pi) % 1.0
    cell = np.minimum((fraction * cells[ring]).astype(np.int64), cells[ring] - 1)
    return np.asarray(first[ring] + cell)


def solid_angle_sr(directions: FloatArray, *, width_deg: float = 2.0) -> float:
    """Return the solid angle of the patches in which at least one direction lies, steradians."""
    return float(np.unique(sky_patches(directions, width_deg=width_deg)).size * math.radians(width_deg) ** 2)
