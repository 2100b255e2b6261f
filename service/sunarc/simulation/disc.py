"""The sun's disc on the sensor: its image under the lens's local stretch, blurred, and integrated over each pixel."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from sunarc.array_types import BoolArray, FloatArray
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project_with_jacobian
from sunarc.optics.stretch import tangent_basis
from sunarc.sky.sun import SOLAR_RADIUS

_RINGS = 16
_SPOKES = 48


class DiscPoints(NamedTuple):
    """The disc as weighted points, exactly symmetric about its centre.

    direction_enu (n, 3) unit vectors; pixel (n, 2); weight_px (n,) area in px² times the limb's darkening.
    """

    direction_enu: FloatArray
    pixel: FloatArray
    weight_px: FloatArray


class Stamp(NamedTuple):
    """A small image (h, w) whose first pixel is (x, y) of the large one."""

    x: int
    y: int
    values: FloatArray


def disc_points(
    camera: Camera, sun_enu: FloatArray, *, limb_darkening: float, radius: float = SOLAR_RADIUS
) -> DiscPoints | None:
    """Return the sun's disc as points, or one of another radius (rad); None where the camera does not see it.

    Gauss-Legendre in mu (the cosine on the sun) and equal steps in angle: the weights of each ring of
    1 - u (1 - mu), so that the middle of the disc has unit brightness.
    """
    centre, _, by_direction = project_with_jacobian(camera, sun_enu)
    if not np.all(np.isfinite(centre)):
        return None
    mu, ring = (
        0.5 * (nodes + shift) for nodes, shift in zip(np.polynomial.legendre.leggauss(_RINGS), (1, 0), strict=True)
    )
    spoke = (np.arange(_SPOKES) + 0.5) * (2.0 * math.pi / _SPOKES)
    offset = radius * np.sqrt(1.0 - mu**2)[:, None, None] * np.stack([np.cos(spoke), np.sin(spoke)], axis=-1)
    offset = offset.reshape(-1, 2)
    brightness = (1.0 - limb_darkening * (1.0 - mu)) * mu * ring
    basis = tangent_basis(sun_enu)
    stretch = by_direction @ basis
    area = abs(np.linalg.det(stretch)) * radius**2 * (2.0 * math.pi / _SPOKES)
    direction = sun_enu + offset @ basis.T
    return DiscPoints(
        direction / np.linalg.norm(direction, axis=-1, keepdims=True),
        centre + offset @ stretch.T,
        np.repeat(brightness * area, _SPOKES),
    )


def is_covered(direction_enu: FloatArray, sun_enu: FloatArray, *, share: float) -> BoolArray:
    """Return (n,) which points of the disc are behind an edge that hides this share of its diameter from the left."""
    rightward = np.array([sun_enu[1], -sun_enu[0], 0.0]) / max(math.hypot(sun_enu[0], sun_enu[1]), 1e-9)
    along = (direction_enu - sun_enu) @ rightward / SOLAR_RADIUS
    return np.asarray(along < -1.0 + 2.0 * share) if share > 0.0 else np.zeros(len(direction_enu), dtype=np.bool_)


def stamp_of(pixel: FloatArray, weight: FloatArray, *, sigma_px: float) -> Stamp:
    """Return weighted points blurred by a Gaussian and integrated over each pixel; the stamp's sum is the weights'."""
    margin = 6.0 * sigma_px + 1.0
    x0, y0 = (int(v) for v in np.floor(pixel.min(axis=0) - margin))
    x1, y1 = (int(v) for v in np.ceil(pixel.max(axis=0) + margin))
    columns = _shares(np.arange(x0, x1 + 2), pixel[:, 0], sigma_px)
    rows = _shares(np.arange(y0, y1 + 2), pixel[:, 1], sigma_px)
    return Stamp(x0, y0, (rows * weight) @ columns.T)


def _shares(first_to_last: NDArray[np.intp], position: FloatArray, sigma_px: float) -> FloatArray:
    """Return (pixels, points): how much of each point's light falls between the pixel's edges, in one axis."""
    edges = (first_to_last[:, None] - 0.5 - position[None, :]) / sigma_px
    return np.asarray(np.diff(ndtr(edges), axis=0))
