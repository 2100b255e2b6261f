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

from sunarc.array_types import BoolArray, FloatArray
from sunarc.calibration.answers.covariance import Uncertain, direction_covariance, uncertainties
from sunarc.jit import njit
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project_fast
from sunarc.optics.inverse_table import (
    InverseConstants,
    InverseTable,
    calibrated_of,
    decentering_of,
    inverse_table,
    spline_weights,
)

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
        directions = np.empty((pixels.shape[0], 3))
        self.table.write_directions(pixels, directions)
        result = np.empty((pixels.shape[0], len(BACK_PROJECTED)))
        size = (self.camera.width, self.camera.height)
        _write_angles(self.table.constants, self.sigma_deg, self.rings_per_radius, size, pixels, directions, result)
        return result

    def _project(self, directions: FloatArray) -> FloatArray:
        pixels = project_fast(self.camera, directions)
        result = np.empty((pixels.shape[0], len(PROJECTED)))
        size = (self.camera.width, self.camera.height)
        _write_pixels(self.table.constants, self.spread_px, self.rings_per_radius, size, pixels, result)
        return result


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


@njit(nogil=True)
def ring_and_spoke(  # noqa: PLR0917 - compiled functions take positions
    constants: InverseConstants, rings: int, spokes: int, rings_per_radius: float, x: float, y: float
) -> tuple[float, float]:
    """Return the ring and the spoke (real numbers) of a pixel, the decentering taken out to first order."""
    x_hat, y_hat = calibrated_of(constants, x, y)
    shift_x, shift_y = decentering_of(constants, x_hat, y_hat)
    x_hat, y_hat = x_hat - shift_x, y_hat - shift_y
    ring = min(math.sqrt(x_hat * x_hat + y_hat * y_hat) * rings_per_radius, rings - 1.0)
    spoke = math.atan2(y_hat, x_hat) * (spokes / (2.0 * math.pi))
    return ring, spoke + spokes if spoke < 0.0 else spoke


@njit(nogil=True)
def in_image(size: tuple[int, int], x: float, y: float) -> float:
    """Return which pixels are within the image."""
    return 1.0 if -0.5 <= x <= size[0] - 0.5 and -0.5 <= y <= size[1] - 0.5 else 0.0


@njit(nogil=True)
def _write_angles(  # noqa: PLR0917 - compiled functions take positions
    constants: InverseConstants,
    sheet: FloatArray,
    rings_per_radius: float,
    size: tuple[int, int],
    pixels: FloatArray,
    directions: FloatArray,
    result: FloatArray,
) -> None:
    rings, spokes = sheet.shape[0] - 2, sheet.shape[1] - 3
    for i in range(pixels.shape[0]):
        x, y = pixels[i, 0], pixels[i, 1]
        east, north, up = directions[i, 0], directions[i, 1], directions[i, 2]
        if math.isnan(up):
            result[i, :6] = np.nan
            result[i, 6] = 0.0
            continue
        ring, spoke = ring_and_spoke(constants, rings, spokes, rings_per_radius, x, y)
        a, a0, a1, a2, a3 = spline_weights(ring, rings - 2)
        b, b0, b1, b2, b3 = spline_weights(spoke, spokes - 1)
        total = 0.0
        for k, weight in enumerate((a0, a1, a2, a3)):
            row = sheet[a + k]
            total += weight * (b0 * row[b] + b1 * row[b + 1] + b2 * row[b + 2] + b3 * row[b + 3])
        azimuth = math.degrees(math.atan2(east, north))
        result[i, 0] = math.degrees(math.atan2(math.sqrt(east * east + north * north), up))
        result[i, 1] = azimuth if azimuth >= 0.0 else (azimuth + 360.0) % 360.0
        result[i, 2], result[i, 3], result[i, 4] = east, north, up
        result[i, 5], result[i, 6] = max(total, 0.0), in_image(size, x, y)


@njit(nogil=True)
def _write_pixels(  # noqa: PLR0917 - compiled functions take positions
    constants: InverseConstants,
    sheets: FloatArray,
    rings_per_radius: float,
    size: tuple[int, int],
    pixels: FloatArray,
    result: FloatArray,
) -> None:
    rings, spokes = sheets.shape[0] - 2, sheets.shape[1] - 3
    for i in range(pixels.shape[0]):
        x, y = pixels[i, 0], pixels[i, 1]
        if math.isnan(x):
            result[i, :6] = np.nan
            result[i, 6] = 0.0
            continue
        ring, spoke = ring_and_spoke(constants, rings, spokes, rings_per_radius, x, y)
        a, a0, a1, a2, a3 = spline_weights(ring, rings - 2)
        b, b0, b1, b2, b3 = spline_weights(spoke, spokes - 1)
        xx, yx, yy = 0.0, 0.0, 0.0
        for k, along in enumerate((a0, a1, a2, a3)):
            for m, around in enumerate((b0, b1, b2, b3)):
                weight, node = along * around, sheets[a + k, b + m]
                xx, yx, yy = xx + weight * node[0], yx + weight * node[1], yy + weight * node[2]
        result[i, 0], result[i, 1] = x, y
        result[i, 3], result[i, 4], result[i, 5] = xx * xx, xx * yx, yx * yx + yy * yy
        result[i, 2], result[i, 6] = math.sqrt(0.5 * (result[i, 3] + result[i, 5])), in_image(size, x, y)


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
