"""A calibration document evaluated on numpy alone: docs/model.md has the equations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .answers import BackProjection, Projection

FloatArray = NDArray[np.float64]
Curve = Callable[[FloatArray], FloatArray]

_IDEAL: dict[str, tuple[Curve, Curve]] = {  # radius of an angle, angle of a radius; in focal lengths, rad
    "perspective": (np.tan, np.arctan),
    "equidistant": (lambda angle: angle, lambda radius: radius),
    "equisolid": (lambda angle: 2.0 * np.sin(0.5 * angle), lambda radius: 2.0 * np.arcsin(0.5 * radius)),
    "stereographic": (lambda angle: 2.0 * np.tan(0.5 * angle), lambda radius: 2.0 * np.arctan(0.5 * radius)),
    "orthographic": (np.sin, np.arcsin),
}
_GROUPS = {
    "focal_length_px": ("focal_length_x_px", "focal_length_y_px"),
    "skew_px": ("skew_px",),
    "principal_point_px": ("principal_point_x_px", "principal_point_y_px"),
    "rotation_cam_enu": ("rotation_x", "rotation_y", "rotation_z"),
    "translation": ("translation_x", "translation_y", "translation_z"),
    "radial": tuple(f"k{order}" for order in range(2, 10)),
    "decentering": ("p1", "p2", "p3", "p4"),
}
_NAMES = [name for names in _GROUPS.values() for name in names]
_ORDERS = np.arange(2, 10)
_ROUNDS = 6
"""Newton steps from the closed form, which is 0.01 px off: two leave rounding."""
_SAME_PX = 1e-6
_STEP = 1e-6
"""Of a difference quotient: radians on the sphere, or shares of a parameter's sigma times 100."""


class CameraModel:
    """A calibration of a camera: directions to pixels and pixels to directions, with their uncertainty.

    Parameters
    ----------
    document : a calibration document (`Imager.calibration`, or a file of `sunarc export`).

    Raises
    ------
    ValueError
        It is none, or of a version that this client does not know.
    """

    def __init__(self, document: Mapping[str, Any]) -> None:
        if document.get("schema") != "sunarc.calibration/1":
            raise ValueError(f"{document.get('schema')!r} is no sunarc.calibration/1; use a client of its version")
        model, backward, uncertainty = (document[key] for key in ("model", "backward_model", "uncertainty"))
        self.id: str = document["id"]
        self.width, self.height = int(document["image"]["width"]), int(document["image"]["height"])
        self._mirrored = bool(document["image"]["mirrored"])
        self._radius, self._angle = _IDEAL[model["projection"]]
        self._max_angle = float(np.radians(model["max_angle_deg"]))
        self._parameters = np.hstack([np.asarray(model[group], dtype=np.float64) for group in _GROUPS])
        self._backward = tuple(np.asarray(backward[key], dtype=np.float64) for key in ("radial", "decentering"))
        self._fitted = [_NAMES.index(name) for name in uncertainty["parameters"]]
        self._covariance = np.asarray(uncertainty["covariance"], dtype=np.float64)
        self._field: Mapping[str, Any] = uncertainty["field"]

    def project(self, direction: ArrayLike) -> Projection:
        """Return where vectors (..., 3), east-north-up, of any length but 0, land; NaN beyond the camera's field."""
        given = np.asarray(direction, dtype=np.float64)
        unit = (given / np.linalg.norm(given, axis=-1, keepdims=True)).reshape(-1, 3)
        pixels = self._pixels(unit, self._parameters)
        covariance = self._pixel_covariance(unit, pixels)
        shape = given.shape[:-1]
        return Projection(
            pixels=pixels.reshape(*shape, 2),
            sigma_px=np.sqrt(0.5 * np.trace(covariance, axis1=1, axis2=2)).reshape(shape),
            covariance_px2=covariance.reshape(*shape, 2, 2),
            inside=self._inside(pixels).reshape(shape),
            calibration=self.id,
        )

    def back_project(self, pixels: ArrayLike) -> BackProjection:
        """Return what pixels (..., 2) look at; NaN outside the camera's field."""
        given = np.asarray(pixels, dtype=np.float64)
        flat, shape = given.reshape(-1, 2), given.shape[:-1]
        with np.errstate(invalid="ignore"):
            unit = self._directions(flat)
            east, north, up = unit.T
            zenith, azimuth = (
                np.degrees(np.arctan2(np.hypot(east, north), up)),
                np.degrees(np.arctan2(east, north)) % 360.0,
            )
        return BackProjection(
            zenith_deg=zenith.reshape(shape),
            azimuth_deg=azimuth.reshape(shape),
            direction=unit.reshape(*shape, 3),
            sigma_deg=self._sigma_deg(unit, flat).reshape(shape),
            inside=(self._inside(flat) & np.isfinite(east)).reshape(shape),
            calibration=self.id,
        )

    def _inside(self, pixels: FloatArray) -> NDArray[np.bool_]:
        with np.errstate(invalid="ignore"):
            return np.asarray(np.all((pixels >= -0.5) & (pixels <= np.array([self.width, self.height]) - 0.5), axis=-1))

    def _pixels(self, unit: FloatArray, p: FloatArray) -> FloatArray:
        """Return the pixels (n, 2) of unit vectors (n, 3) by parameters (23,)."""
        ray = unit @ _rotation(p[5:8]).T + p[8:11]
        across = np.hypot(ray[:, 0], ray[:, 1])
        theta = np.arctan2(across, ray[:, 2])
        with np.errstate(all="ignore"):
            radius = self._radius(theta) + (theta[:, None] / (0.5 * np.pi)) ** _ORDERS @ p[11:19]
        point = ray[:, :2] * np.where(across > 0.0, radius / np.where(across > 0.0, across, 1.0), 0.0)[:, None]
        point = point + _shift(p[19:], radius, point)
        x = p[0] * point[:, 0] + p[2] * point[:, 1] + p[3]
        pixels = np.stack([self.width - 1.0 - x if self._mirrored else x, p[1] * point[:, 1] + p[4]], axis=-1)
        return np.where((theta <= self._max_angle)[:, None], pixels, np.nan)

    def _directions(self, pixels: FloatArray) -> FloatArray:
        """Return unit vectors (n, 3): the closed form, and Newton's method on the sphere from there."""
        unit = self._closed_form(pixels)
        for _ in range(_ROUNDS):
            off = pixels - self._pixels(unit, self._parameters)
            if np.nanmax(np.abs(off), initial=0.0) < _SAME_PX:
                break
            axes = _tangents(unit)
            step = np.linalg.solve(self._by_tangents(unit, axes), np.nan_to_num(off)[..., None])[..., 0]
            unit = unit + np.einsum("nk,nki->ni", step, axes)
            unit = unit / np.linalg.norm(unit, axis=-1, keepdims=True)
        off = np.linalg.norm(pixels - self._pixels(unit, self._parameters), axis=-1)
        return np.where((off < 100.0 * _SAME_PX)[:, None], unit, np.nan)

    def _closed_form(self, pixels: FloatArray) -> FloatArray:
        p, (radial, decentering) = self._parameters, self._backward
        px = self.width - 1.0 - pixels[:, 0] if self._mirrored else pixels[:, 0]
        y = (pixels[:, 1] - p[4]) / p[1]
        point = np.stack([(px - p[3] - p[2] * y) / p[0], y], axis=-1)
        radius = np.hypot(*point.T)
        point = point - _shift(decentering, radius, point)
        adjusted = np.maximum(np.hypot(*point.T), np.finfo(float).tiny)
        theta = self._angle(adjusted - radius[:, None] ** _ORDERS @ radial)
        ray = np.column_stack([np.sin(theta)[:, None] * point / adjusted[:, None], np.cos(theta)])
        return np.asarray(ray @ _rotation(p[5:8]))

    def _by_tangents(self, unit: FloatArray, axes: FloatArray) -> FloatArray:
        """Return (n, 2, 2): px per radian along two tangents (n, 2, 3); the identity where there is no pixel."""
        columns = [
            (
                self._pixels(unit + _STEP * axes[:, k], self._parameters)
                - self._pixels(unit - _STEP * axes[:, k], self._parameters)
            )
            / (2.0 * _STEP)
            for k in (0, 1)
        ]
        found = np.stack(columns, axis=-1)
        valid = np.isfinite(np.sum(found, axis=(1, 2), keepdims=True))
        return np.where(valid, found, np.eye(2))

    def _pixel_covariance(self, unit: FloatArray, pixels: FloatArray) -> FloatArray:
        """Return (n, 2, 2) px²: of the fitted parameters and the field, which are correlated."""
        rows = np.empty((len(unit), 2, len(self._fitted)))
        for column, (index, sigma) in enumerate(zip(self._fitted, np.sqrt(np.diag(self._covariance)), strict=True)):
            step = np.zeros(self._parameters.size)
            step[index] = 100.0 * _STEP * sigma + 1e-12
            up, down = (self._pixels(unit, self._parameters + sign * step) for sign in (1.0, -1.0))
            rows[..., column] = (up - down) / (2.0 * step[index])
        result = rows @ self._covariance @ np.swapaxes(rows, 1, 2)
        field = self._field
        if field["amplitude_px"] > 0.0:
            half, center = np.asarray(field["half_px"]), np.asarray(field["center_px"])
            place = np.asarray(field["orders"]).reshape(-1, 2) * ((pixels - center + half) / half)[:, None, :]
            waves = np.prod(np.sin(0.5 * np.pi * place) / np.sqrt(half), axis=-1)
            cross = np.asarray(field["cross"], dtype=np.float64)
            mixed = np.einsum("nip,apm,nm->nia", rows, cross, waves, optimize=True)
            result = result + mixed + np.swapaxes(mixed, 1, 2) + field["amplitude_px"] ** 2 * np.eye(2)
        return np.asarray(result)

    def _sigma_deg(self, unit: FloatArray, pixels: FloatArray) -> FloatArray:
        """Return (n,): the pixel's covariance taken to the sphere, 1-sigma per axis, degrees."""
        valid = np.isfinite(unit[:, 0])
        result, seen = np.full(len(unit), np.nan), unit[valid]
        inverse = np.linalg.inv(self._by_tangents(seen, _tangents(seen)))
        covariance = inverse @ self._pixel_covariance(seen, pixels[valid]) @ np.swapaxes(inverse, 1, 2)
        result[valid] = np.degrees(np.sqrt(0.5 * np.trace(covariance, axis1=1, axis2=2)))
        return result


def _rotation(vector: FloatArray) -> FloatArray:
    """Return the matrix of a rotation vector, east-north-up to camera (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    cross = np.cross(np.eye(3), vector / (angle or 1.0))
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)


def _shift(c: FloatArray, radius: FloatArray, point: FloatArray) -> FloatArray:
    """Return the decentering (n, 2) in focal lengths; c = p1 … p4 or q1 … q5."""
    off = radius > 0.0
    u, v = np.where(off, point.T / np.where(off, radius, 1.0), np.array([[1.0], [0.0]]))
    higher = radius[:, None] ** (2.0 * np.arange(1, c.size - 1)) @ c[2:]
    shift = [c[0] * (1.0 + 2.0 * u * u) + 2.0 * c[1] * u * v, 2.0 * c[0] * u * v + c[1] * (1.0 + 2.0 * v * v)]
    return np.asarray((radius**2 * (1.0 + higher) * shift).T)


def _tangents(unit: FloatArray) -> FloatArray:
    """Return two unit vectors (n, 2, 3) across each direction and across one another."""
    helper = np.where(np.abs(unit[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    first = np.cross(unit, helper)
    first = first / np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, np.cross(unit, first)], axis=1)
