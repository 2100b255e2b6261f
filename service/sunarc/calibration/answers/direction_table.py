"""A calibration made ready for many pixels and directions: exact places, and how sure they are from a table; maps.

The 1-sigma and the covariance change slowly over the image. They are computed at nodes in polar coordinates about the
principal point, out to where the field ends, and cubic splines run between them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sunarc import _kernels
from sunarc.array_types import BoolArray, FloatArray
from sunarc.calibration.answers.covariance import Uncertain, direction_covariance, uncertainties
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project_fast
from sunarc.optics.inverse_table import InverseTable, inverse_table

Rows = FloatArray | NDArray[np.float32]

BACK_PROJECTED = ("zenith_deg", "azimuth_deg", "east", "north", "up", "sigma_deg", "inside")
"""Columns of what `Lookup.back_project` returns; `inside` is 1 or 0."""
PROJECTED = ("x_px", "y_px", "sigma_px", "cov_xx_px2", "cov_xy_px2", "cov_yy_px2", "inside")
"""Columns of what `Lookup.project` returns."""

RINGS = 96
SPOKES = 192
_PADDING = 6
_CHUNK = 32_768


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lookup:
    """A calibration, ready for many at once.

    Directions and pixels are those of the camera to 1e-8 px. The 1-sigma differs from the exact one by less than 1e-4
    degrees nearly everywhere, and by at most some percent of itself (docs/studies.md).

    Attributes
    ----------
    camera : the camera.
    table : its inverse.
    sigma_deg : (rings, spokes) spline coefficients of the 1-sigma on the sphere.
    spread_px : (rings, spokes, 3) of the covariance's Cholesky factor: xx, yx, yy.
    rings_per_radius : rings per unit of the radius, in focal lengths.
    """

    camera: Camera
    table: InverseTable
    sigma_deg: FloatArray
    spread_px: FloatArray
    rings_per_radius: float

    def back_project(self, pixels: Rows) -> Rows:
        """Return what pixels (n, 2) look at: (n, 7), the columns `BACK_PROJECTED`, in the precision of the pixels.

        NaN where no direction lands on the pixel.
        """
        return _in_chunks(pixels, self._back_project)

    def project(self, directions: Rows) -> Rows:
        """Return where unit vectors (n, 3) land: (n, 7), the columns `PROJECTED`; NaN beyond the camera's field."""
        return _in_chunks(directions, self._project)

    def direction_covariance(self, directions: FloatArray) -> FloatArray:
        """Return (n, 3, 3): covariances of unit vectors (n, 3), east-north-up; NaN beyond the camera's field."""
        projected = self._project(directions)
        covariance = projected[:, [3, 4, 4, 5]].reshape(-1, 2, 2)
        return direction_covariance(self.camera, directions, covariance)

    def _back_project(self, pixels: FloatArray) -> FloatArray:
        directions = self.table.directions(pixels)
        return _kernels.back_projected(*self._sheet(self.sigma_deg), pixels, directions)

    def _project(self, directions: FloatArray) -> FloatArray:
        return _kernels.projected(*self._sheet(self.spread_px), project_fast(self.camera, directions))

    def _sheet(self, sheet: FloatArray) -> tuple[FloatArray, FloatArray, float, int, int]:
        """Return a sheet as the kernels take it: the camera's numbers, the sheet, its scale, the image's size."""
        camera = self.camera
        return np.array(self.table.constants), sheet, self.rings_per_radius, camera.width, camera.height


def lookup(calibration: Uncertain) -> Lookup:
    """Return a calibration made ready; takes some tenths of a second."""
    camera = calibration.camera
    table = inverse_table(camera)
    radius = np.linspace(0.0, table.constants.limit, RINGS)
    azimuth = np.linspace(0.0, 2.0 * math.pi, SPOKES, endpoint=False)
    covariance, sigma = uncertainties(calibration, polar_directions(table, radius, azimuth))
    # the Cholesky factor is smooth where the covariance is, and any spline of it is positive definite
    xx = np.sqrt(np.maximum(covariance[:, 0, 0], 1e-12))
    yx = covariance[:, 1, 0] / xx
    yy = np.sqrt(np.maximum(covariance[:, 1, 1] - yx**2, 0.0))
    sheets = np.stack([xx, yx, yy, sigma], axis=-1).reshape(RINGS, SPOKES, 4)
    splines = np.stack([polar_spline(sheets[..., k]) for k in range(4)], axis=-1)
    return Lookup(
        camera=camera,
        table=table,
        sigma_deg=np.ascontiguousarray(splines[..., 3]),
        spread_px=np.ascontiguousarray(splines[..., :3]),
        rings_per_radius=float(1.0 / radius[1]),
    )


def polar_directions(table: InverseTable, radius: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Return unit vectors (rings · spokes, 3) that the lens without its decentering brings to these places."""
    position = np.minimum(radius * table.constants.per_radius, len(table.pieces) - 1e-9)
    piece = position.astype(np.int64)
    powers = (position - piece)[:, None] ** np.arange(4)
    scale = np.sum(table.pieces[piece, :4] * powers, axis=-1)
    sine, cosine = scale * radius, np.sum(table.pieces[piece, 4:] * powers, axis=-1)
    across = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    ray = np.empty((len(radius), len(azimuth), 3))
    ray[..., :2] = sine[:, None, None] * across
    ray[..., 2] = cosine[:, None]
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    return np.asarray(ray.reshape(-1, 3) @ table.rotation)


def polar_spline(sheet: FloatArray) -> FloatArray:
    """Return spline coefficients of values (rings, spokes) for rings -1 … rings and spokes -1 … spokes + 1.

    The first ring is the axis, and the spokes go round. Where a value is not finite the largest one stands for it.
    """
    from scipy.ndimage import spline_filter1d  # noqa: PLC0415 - the command line loads without it

    rings, spokes = sheet.shape
    sheet = np.where(np.isfinite(sheet), sheet, np.nanmax(sheet, initial=0.0))
    # through the axis a ray goes on at the opposite azimuth: the spline needs no edge there
    inner = np.roll(sheet[1 : _PADDING + 1], spokes // 2, axis=1)[::-1]  # beyond the axis is the other side
    outer = sheet
    for _ in range(_PADDING):
        # cubic continuation beyond the last ring: a mirrored edge would bend the spline there
        extrapolated = 4.0 * outer[-1] - 6.0 * outer[-2] + 4.0 * outer[-3] - outer[-4]
        outer = np.concatenate([outer, extrapolated[None]])
    along = spline_filter1d(np.concatenate([inner, outer]), order=3, axis=0, mode="mirror")
    around = spline_filter1d(along, order=3, axis=1, mode="grid-wrap")
    inner_part = around[_PADDING - 1 : _PADDING + rings + 1]
    return np.concatenate([inner_part[:, -1:], inner_part, inner_part[:, :2]], axis=1)


def _in_chunks(rows: Rows, answer: Callable[[FloatArray], FloatArray]) -> Rows:
    """Return the answers to rows, a chunk at a time, in the precision of the rows."""
    if rows.shape[0] <= _CHUNK and rows.dtype == np.float64:
        return answer(np.ascontiguousarray(rows, dtype=np.float64))
    result = np.empty((rows.shape[0], 7), dtype=rows.dtype)
    for begin in range(0, rows.shape[0], _CHUNK):
        part = np.ascontiguousarray(rows[begin : begin + _CHUNK], dtype=np.float64)
        result[begin : begin + _CHUNK] = answer(part)
    return result


# What every pixel sees, and how sure that is, at once.

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
