"""What every pixel sees, and how sure that is, at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sunarc.array_types import BoolArray
from sunarc.calibration.model.direction_table import Lookup

_ROWS = 16


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BackProjectionMap:
    """What every pixel sees, in single precision (1e-5 degrees); NaN outside the camera's field.

    Attributes
    ----------
    zenith_deg, azimuth_deg : (height, width) degrees, azimuth clockwise from north.
    directions : (height, width, 3) unit vectors, east-north-up.
    sigma_deg : (height, width) 1-sigma per axis on the sphere, degrees.
    inside : (height, width) whether the pixel lies within the field.
    """

    zenith_deg: NDArray[np.float32]
    azimuth_deg: NDArray[np.float32]
    directions: NDArray[np.float32]
    sigma_deg: NDArray[np.float32]
    inside: BoolArray


def back_projection_map(ready: Lookup) -> BackProjectionMap:
    """Return what `Lookup.back_project` returns for every pixel of the image."""
    height, width = ready.camera.height, ready.camera.width
    zenith, azimuth, sigma = (np.empty((height, width), dtype=np.float32) for _ in range(3))
    directions = np.empty((height, width, 3), dtype=np.float32)
    for top in range(0, height, _ROWS):
        rows = slice(top, min(top + _ROWS, height))
        y, x = np.mgrid[rows, 0:width]
        values = ready.back_project(np.stack([x, y], axis=-1).reshape(-1, 2).astype(np.float64))
        values = values.reshape(rows.stop - top, width, -1)
        zenith[rows], azimuth[rows], sigma[rows] = values[..., 0], values[..., 1], values[..., 5]
        directions[rows] = values[..., 2:5]
    return BackProjectionMap(
        zenith_deg=zenith,
        azimuth_deg=azimuth,
        directions=directions,
        sigma_deg=sigma,
        inside=np.isfinite(zenith),
    )
