"""Tables of a calibration for many pixels and directions: exact places, interpolated uncertainty; maps.

The 1-sigma and the covariance change slowly over the sky. They are computed at nodes in polar coordinates about the
optical axis, out to where the field ends, and cubic splines run between them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sunarc import _kernels
from sunarc.calibration.answers.covariance import direction_covariance, uncertainties
from sunarc.calibration.model.result import Calibration
from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project_fast, radius_slope, rising_limit
from sunarc.optics.inverse import largest_angle
from sunarc.optics.inverse_table import (
    InverseTable,
    inverse_table,
)

Rows = FloatArray | NDArray[np.float32]

BACK_PROJECTED = ("zenith_deg", "azimuth_deg", "east", "north", "up", "sigma_deg", "inside")
"""Columns of the answer of `Lookup.back_project`; `inside` is 1 or 0."""
PROJECTED = ("x_px", "y_px", "sigma_px", "cov_xx_px2", "cov_xy_px2", "cov_yy_px2", "inside")
"""Columns of the answer of `Lookup.project`."""

RINGS = 96
SPOKES = 192
_EDGE = 1e-4
"""Radians between the last ring and the largest angle, where a lens may hardly stretch, or without bound."""
_LEAST_FACTOR = 1e-6
_PADDING = 6
_CHUNK = 32_768


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lookup:
    """Calibration with tables for many pixels or directions at once.

    Directions and pixels are those of the camera to 1e-8 px; docs/rest.md says how near the 1-sigma is.

    Attributes
    ----------
    camera : the camera.
    table : its inverse.
    log_sigma : (rings, spokes) spline coefficients of the logarithm of the 1-sigma on the sphere, degrees, times the
        slope of the radius: where a lens hardly stretches, the 1-sigma grows without bound.
    slope : (rings) of the slope of the radius over the angle off the axis, focal lengths per radian.
    log_factor : (rings, spokes, 3) of the pixel covariance's Cholesky factor, px: log xx, yx / xx, log yy.
    rings_per_radian : rings per radian off the axis.
    sigma_limit_deg : what is less sure is answered as beyond the camera's field; None: all is answered.
    """

    camera: Camera
    table: InverseTable
    log_sigma: FloatArray
    slope: FloatArray
    log_factor: FloatArray
    rings_per_radian: float
    sigma_limit_deg: float | None = None

    def back_project(self, pixels: Rows) -> Rows:
        """Return the directions of pixels (n, 2): (n, 7), the columns `BACK_PROJECTED`, in the precision of the pixels.

        NaN where no direction lands on the pixel.
        """
        return _answer_in_chunks(pixels, self._back_project_chunk)

    def project(self, directions: Rows) -> Rows:
        """Return the pixels of unit vectors (n, 3): (n, 7), the columns `PROJECTED`; NaN beyond the camera's field."""
        return _answer_in_chunks(directions, self._project_chunk)

    def direction_covariance(self, directions: FloatArray) -> FloatArray:
        """Return (n, 3, 3): covariances of unit vectors (n, 3), east-north-up; NaN beyond the camera's field."""
        projected = self._project_chunk(directions)
        covariance = projected[:, [3, 4, 4, 5]].reshape(-1, 2, 2)
        return direction_covariance(self.camera, directions, covariance)

    def _back_project_chunk(self, pixels: FloatArray) -> FloatArray:
        found = self._add_uncertainty(pixels, self.table.directions(pixels))
        return found if self.sigma_limit_deg is None else _mask_beyond_limit(found, found, self.sigma_limit_deg)

    def _add_uncertainty(self, pixels: FloatArray, directions: FloatArray) -> FloatArray:
        sheets, camera = (self.log_sigma, self.slope, self.rings_per_radian), self.camera
        return _kernels.back_projected(self.table.rotation, *sheets, camera.width, camera.height, pixels, directions)

    def _project_chunk(self, directions: FloatArray) -> FloatArray:
        pixels, camera, sheets = project_fast(self.camera, directions), self.camera, self.log_factor
        size = (camera.width, camera.height)
        found = _kernels.projected(self.table.rotation, sheets, self.rings_per_radian, *size, pixels, directions)
        if self.sigma_limit_deg is None:
            return found
        return _mask_beyond_limit(found, self._add_uncertainty(pixels, directions), self.sigma_limit_deg)


def _mask_beyond_limit(rows: FloatArray, back_projected: FloatArray, limit_deg: float) -> FloatArray:
    """Return rows (n, 7), the last column of which is `inside`, without those whose 1-sigma is beyond a limit."""
    unsure = ~(back_projected[:, BACK_PROJECTED.index("sigma_deg")] <= limit_deg)
    rows[unsure] = np.r_[np.full(rows.shape[1] - 1, np.nan), 0.0]
    return rows


def lookup(calibration: Calibration) -> Lookup:
    """Return the tables of a calibration; takes some tenths of a second."""
    camera = calibration.camera
    table = inverse_table(camera)
    angle = np.linspace(0.0, rising_limit(camera, up_to=largest_angle(camera)) - _EDGE, RINGS)
    azimuth = np.linspace(0.0, 2.0 * math.pi, SPOKES, endpoint=False)
    covariance, sigma = uncertainties(calibration, _directions_about_axis(table.rotation, angle, azimuth))
    # the Cholesky factor is smooth where the covariance is, and any spline of it is positive definite
    xx = np.sqrt(np.maximum(covariance[:, 0, 0], 1e-12))
    yx = covariance[:, 1, 0] / xx
    yy = np.sqrt(np.maximum(covariance[:, 1, 1] - yx**2, (_LEAST_FACTOR * xx) ** 2))
    slope = radius_slope(camera, angle)
    log_sigma = np.log(np.maximum(sigma * np.repeat(slope, SPOKES), np.finfo(np.float64).tiny))
    sheets = np.stack([np.log(xx), yx / xx, np.log(yy), log_sigma], axis=-1).reshape(RINGS, SPOKES, 4)
    splines = np.stack([polar_spline(sheets[..., k]) for k in range(4)], axis=-1)
    return Lookup(
        camera=camera,
        table=table,
        log_sigma=np.ascontiguousarray(splines[..., 3]),
        slope=polar_spline(np.repeat(slope[:, None], 2, axis=1))[:, 0].copy(),
        log_factor=np.ascontiguousarray(splines[..., :3]),
        rings_per_radian=float(1.0 / angle[1]),
        sigma_limit_deg=calibration.sigma_limit_deg,
    )


def _directions_about_axis(rotation: FloatArray, angle: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Return unit vectors (rings · spokes, 3) at these angles off the optical axis, and azimuths about it."""
    ray = np.empty((len(angle), len(azimuth), 3))
    ray[..., 0] = np.outer(np.sin(angle), np.cos(azimuth))
    ray[..., 1] = np.outer(np.sin(angle), np.sin(azimuth))
    ray[..., 2] = np.cos(angle)[:, None]
    return np.asarray(ray.reshape(-1, 3) @ rotation)


def polar_spline(sheet: FloatArray) -> FloatArray:
    """Return spline coefficients of values (rings, spokes) for rings -1 … rings and spokes -1 … spokes + 1.

    The first ring is the axis, and the spokes go round. For a value that is not finite the next one inwards stands.
    """
    from scipy.ndimage import spline_filter1d  # noqa: PLC0415 - the command line loads without it

    rings, spokes = sheet.shape
    inwards = np.maximum.accumulate(np.where(np.isfinite(sheet), np.arange(rings)[:, None], 0), axis=0)
    sheet = np.nan_to_num(np.take_along_axis(sheet, inwards, axis=0))
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


def _answer_in_chunks(rows: Rows, answer: Callable[[FloatArray], FloatArray]) -> Rows:
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
    """Directions of every pixel, in single precision (1e-5 degrees); NaN outside the camera's field.

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
    """Return the answer of `Lookup.back_project` for every pixel of the image."""
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
