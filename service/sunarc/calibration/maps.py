"""Every pixel's direction and uncertainty at once."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from sunarc.calibration.covariance import sigma_deg
from sunarc.calibration.result import Calibration
from sunarc.optics import inverse_table

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_NODES = 90
_PULLS = 8
_ROWS = 32


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BackProjectionMap:
    """What every pixel sees.

    Attributes
    ----------
    directions : (height, width, 3) unit vectors, east-north-up; NaN outside the camera's field.
    sigma_deg : (height, width) 1-sigma per axis on the sphere, degrees, single precision; NaN outside the field.
    inside : (height, width) whether the pixel lies within the field.
    """

    directions: FloatArray
    sigma_deg: NDArray[np.float32]
    inside: BoolArray


def back_projection_map(calibration: Calibration) -> BackProjectionMap:
    """Return the directions of all pixels, and their 1-sigma by cubic interpolation between 90 × 90 of them."""
    camera = calibration.camera
    table = inverse_table(camera)
    directions = np.empty((camera.height, camera.width, 3))
    rows = np.empty((_ROWS, camera.width, 2))
    rows[..., 0] = np.arange(camera.width)
    for top in range(0, camera.height, _ROWS):
        count = min(_ROWS, camera.height - top)
        rows[:count, :, 1] = np.arange(top, top + count)[:, None]
        table.write_directions(rows[:count], directions[top : top + count])
    inside = np.isfinite(directions[..., 2])
    sigma = _interpolated(_at_nodes(calibration), width=camera.width, height=camera.height)
    sigma[~inside] = np.nan
    return BackProjectionMap(directions=directions, sigma_deg=sigma, inside=inside)


def _at_nodes(calibration: Calibration) -> FloatArray:
    """Return the 1-sigma at nodes over the image; outside the field that of the field's edge nearby."""
    camera = replace(calibration.camera, mirrored=False)
    table = inverse_table(camera)
    x = np.linspace(0.0, camera.width - 1.0, _NODES)
    y = np.linspace(0.0, camera.height - 1.0, _NODES)
    nodes = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    center = np.array(camera.principal_point_px)
    directions = table.directions(nodes)
    shortest, longest = np.zeros(nodes.shape[0]), np.ones(nodes.shape[0])
    outside = ~np.isfinite(directions[:, 2])
    for _ in range(_PULLS if np.any(outside) else 0):
        middle = 0.5 * (shortest + longest)
        tried = table.directions(center + middle[:, None] * (nodes - center))
        seen = np.isfinite(tried[:, 2])
        shortest, longest = np.where(seen, middle, shortest), np.where(seen, longest, middle)
    pulled = np.where(outside, shortest, 1.0)
    directions = table.directions(center + pulled[:, None] * (nodes - center))
    sigma = sigma_deg(calibration, directions).reshape(_NODES, _NODES)
    return sigma[:, ::-1] if calibration.camera.mirrored else sigma


def _interpolated(nodes: FloatArray, *, width: int, height: int) -> NDArray[np.float32]:
    """Return (height, width) between nodes that reach from the first pixel to the last."""
    filled = np.nan_to_num(nodes, nan=float(np.nanmax(nodes, initial=0.0)))
    across = np.linspace(0.0, _NODES - 1.0, width, dtype=np.float32)
    down = np.linspace(0.0, _NODES - 1.0, height, dtype=np.float32)
    first = cv2.remap(
        filled.astype(np.float32),
        np.broadcast_to(across, (_NODES, width)).copy(),
        np.broadcast_to(np.arange(_NODES, dtype=np.float32)[:, None], (_NODES, width)).copy(),
        cv2.INTER_CUBIC,
        borderMode=cv2.BORDER_REPLICATE,
    )
    low = np.minimum(np.floor(down).astype(np.int64), _NODES - 2)
    share = (down - low)[:, None]
    return np.asarray((1.0 - share) * first[low] + share * first[low + 1], dtype=np.float32)


def largest_sigma_deg(found: BackProjectionMap) -> float:
    """Return the largest 1-sigma within the field, degrees; NaN where there is no field."""
    return float(np.nanmax(found.sigma_deg)) if np.any(found.inside) else math.nan
