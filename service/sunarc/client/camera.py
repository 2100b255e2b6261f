"""A calibration document evaluated on numpy alone: docs/model.md has the equations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .answers import BackProjection, Projection

FloatArray = NDArray[np.float64]
Curve = Callable[[FloatArray], FloatArray]

_IDEAL: dict[str, tuple[Curve, Curve]] = {  # radius of an angle, angle of a radius (rad): as optics/projections.py
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
_SCHEMAS = ("sunarc.calibration/1", "sunarc.calibration/2", "sunarc.camera/1")
_LEAST_UNKNOWN = 0.02
"""1-sigma of the field, as a share of its amplitude, that always stays unknown."""
_ROUNDS = 6
"""Newton steps from the closed form, which is 0.01 px off: two leave rounding."""
_SAME_PX = 1e-6
_MIXTURE_ROUNDS = 60
_STEP = 1e-6
"""Of a difference quotient: radians on the sphere, or shares of a parameter's sigma times 100."""
_MANY = 4096
"""Points of one call from which on their uncertainty is interpolated: about a quarter of the cost of a table."""
_RINGS, _SPOKES = 96, 192
"""Nodes of that table, in angle from the optical axis and around it."""
_EDGE = 1e-4
"""Radians between the last nodes and the largest angle: difference quotients need both of their sides."""
_CHUNK = 16_384
"""Points at a time: their arrays stay in the processor's cache."""


class CameraModel:
    """A calibration of a camera: directions to pixels and pixels to directions, with their uncertainty.

    Parameters
    ----------
    document : a calibration document (`Imager.calibration`, or a file of `sunarc export`); by one of the camera
        alone (`detail="camera"`) each sigma and covariance is NaN.

    Raises
    ------
    ValueError
        It is no calibration document, or has a version or a projection that this client does not know.
    """

    def __init__(self, document: Mapping[str, Any]) -> None:
        if document.get("schema") not in _SCHEMAS:
            raise ValueError(f"{document.get('schema')!r} is not one of {_SCHEMAS}; use a client of its version")
        model, backward, uncertainty = (document[key] for key in ("model", "backward_model", "uncertainty"))
        self.id: str = document["id"]
        self.width, self.height = int(document["image"]["width"]), int(document["image"]["height"])
        self._mirrored = bool(document["image"]["mirrored"])
        if model["projection"] not in _IDEAL:
            raise ValueError(f"unknown projection {model['projection']!r}; use a newer client")
        self._radius, self._angle = _IDEAL[model["projection"]]
        self._max_angle = float(np.radians(model["max_angle_deg"]))
        self._parameters = np.hstack([np.asarray(model[group], dtype=np.float64) for group in _GROUPS])
        self._backward = tuple(np.asarray(backward[key], dtype=np.float64) for key in ("radial", "decentering"))
        self._fitted = [_NAMES.index(name) for name in uncertainty.get("parameters", [])]
        self._covariance = np.asarray(uncertainty.get("covariance", []), dtype=np.float64)
        self._field = _Field(uncertainty["field"], parameters=len(self._fitted))
        self._mixture = uncertainty.get("mixture")
        self._sheets: FloatArray | None = None

    def project(self, direction: ArrayLike) -> Projection:
        """Return where vectors (..., 3), east-north-up, of any length but 0, land; NaN beyond the camera's field."""
        given = np.asarray(direction, dtype=np.float64)
        unit = (given / np.linalg.norm(given, axis=-1, keepdims=True)).reshape(-1, 3)
        pixels = self._project_with(unit, self._parameters)
        if len(unit) < _MANY:
            covariance = self._compute_pixel_covariance(unit, pixels)
        else:
            xx, yx, yy, _ = _evaluate_in_chunks(
                self._interpolate_uncertainty, np.where(np.isfinite(pixels[:, :1]), unit, np.nan)
            ).T
            covariance = np.stack([xx * xx, xx * yx, xx * yx, yx * yx + yy * yy], axis=-1).reshape(-1, 2, 2)
        shape = given.shape[:-1]
        return Projection(
            pixels=pixels.reshape(*shape, 2),
            sigma_px=np.sqrt(0.5 * np.trace(covariance, axis1=1, axis2=2)).reshape(shape),
            covariance_px2=covariance.reshape(*shape, 2, 2),
            inside=self._is_in_image(pixels).reshape(shape),
            calibration=self.id,
        )

    def back_project(self, pixels: ArrayLike) -> BackProjection:
        """Return the directions of pixels (..., 2); NaN outside the camera's field."""
        given = np.asarray(pixels, dtype=np.float64)
        flat, shape = given.reshape(-1, 2), given.shape[:-1]
        with np.errstate(invalid="ignore"):
            unit = _evaluate_in_chunks(self._solve_directions, flat)
            east, north, up = unit.T
            zenith, azimuth = (
                np.degrees(np.arctan2(np.hypot(east, north), up)),
                np.degrees(np.arctan2(east, north)) % 360.0,
            )
        sigma_deg = (
            _evaluate_in_chunks(self._interpolate_uncertainty, unit)[:, 3]
            if len(unit) >= _MANY
            else self._compute_sigma_deg(unit, self._compute_pixel_covariance(unit, flat))
        )
        return BackProjection(
            zenith_deg=zenith.reshape(shape),
            azimuth_deg=azimuth.reshape(shape),
            direction=unit.reshape(*shape, 3),
            sigma_deg=sigma_deg.reshape(shape),
            inside=(self._is_in_image(flat) & np.isfinite(east)).reshape(shape),
            calibration=self.id,
        )

    def distances(self, pixels: ArrayLike, share: float) -> FloatArray:
        """Return (...): in how many 1-sigmas of pixels (..., 2) a share, below 1, of the errors lies.

        With e the error and S the stated covariance of a pixel, √(eᵀ S⁻¹ e) is smaller than that with this probability.
        """
        given = np.asarray(pixels, dtype=np.float64)
        shares, scales = np.ones(1), np.ones((given.reshape(-1, 2).shape[0], 1))
        if self._mixture is not None:
            places, known = (np.asarray(self._mixture[key], dtype=np.float64) for key in ("pixels_px", "scales"))
            square = np.sum((given.reshape(-1, 1, 2) - places) ** 2, axis=-1)
            weight = (1.0 + square) ** -2.0
            shares, scales = np.asarray(self._mixture["shares"]), weight @ known / weight.sum(axis=1, keepdims=True)
        square, rates = np.zeros(len(scales)), 0.5 / scales**2
        for _ in range(_MIXTURE_ROUNDS):  # Newton's method on a function that is convex and falls
            outside = shares * np.exp(-rates * square[:, None])
            total = outside.sum(axis=1)
            square = square + total * (np.log(total) - np.log1p(-share)) / np.sum(rates * outside, axis=1)
        return np.asarray(np.sqrt(square).reshape(given.shape[:-1]))

    def _is_in_image(self, pixels: FloatArray) -> NDArray[np.bool_]:
        with np.errstate(invalid="ignore"):
            return np.asarray(np.all((pixels >= -0.5) & (pixels <= np.array([self.width, self.height]) - 0.5), axis=-1))

    def _project_with(self, unit: FloatArray, p: FloatArray) -> FloatArray:
        """Return the pixels (n, 2) of unit vectors (n, 3) by parameters (23,)."""
        ray = unit @ _rotation_matrix(p[5:8]).T + p[8:11]
        across = np.hypot(ray[:, 0], ray[:, 1])
        theta = np.arctan2(across, ray[:, 2])
        with np.errstate(all="ignore"):
            radius = self._radius(theta) + (theta[:, None] / (0.5 * np.pi)) ** _ORDERS @ p[11:19]
        point = ray[:, :2] * np.where(across > 0.0, radius / np.where(across > 0.0, across, 1.0), 0.0)[:, None]
        point = point + _compute_decentering(p[19:], radius, point)
        x = p[0] * point[:, 0] + p[2] * point[:, 1] + p[3]
        pixels = np.stack([self.width - 1.0 - x if self._mirrored else x, p[1] * point[:, 1] + p[4]], axis=-1)
        pixels = np.where((theta <= self._max_angle)[:, None], pixels, np.nan)
        return pixels + self._field.mean(pixels)

    def _solve_directions(self, pixels: FloatArray) -> FloatArray:
        """Return unit vectors (n, 3): the closed form, and Newton's method on the sphere from there."""
        unit = self._back_project_closed_form(pixels)
        for _ in range(_ROUNDS):
            off = pixels - self._project_with(unit, self._parameters)
            if np.nanmax(np.abs(off), initial=0.0) < _SAME_PX:
                break
            axes = _make_tangents(unit)
            step = np.linalg.solve(self._derive_by_tangents(unit, axes), np.nan_to_num(off)[..., None])[..., 0]
            unit = unit + np.einsum("nk,nki->ni", step, axes)
            unit = unit / np.linalg.norm(unit, axis=-1, keepdims=True)
        off = np.linalg.norm(pixels - self._project_with(unit, self._parameters), axis=-1)
        return np.where((off < 100.0 * _SAME_PX)[:, None], unit, np.nan)

    def _back_project_closed_form(self, pixels: FloatArray) -> FloatArray:
        p, (radial, decentering) = self._parameters, self._backward
        pixels = pixels - self._field.mean(pixels)
        px = self.width - 1.0 - pixels[:, 0] if self._mirrored else pixels[:, 0]
        y = (pixels[:, 1] - p[4]) / p[1]
        point = np.stack([(px - p[3] - p[2] * y) / p[0], y], axis=-1)
        radius = np.hypot(*point.T)
        point = point - _compute_decentering(decentering, radius, point)
        adjusted = np.maximum(np.hypot(*point.T), np.finfo(float).tiny)
        theta = self._angle(adjusted - radius[:, None] ** _ORDERS @ radial)
        ray = np.column_stack([np.sin(theta)[:, None] * point / adjusted[:, None], np.cos(theta)])
        return np.asarray(ray @ _rotation_matrix(p[5:8]))

    def _derive_by_tangents(self, unit: FloatArray, axes: FloatArray) -> FloatArray:
        """Return (n, 2, 2): px per radian along two tangents (n, 2, 3); the identity where there is no pixel."""
        columns = [
            (
                self._project_with(unit + _STEP * axes[:, k], self._parameters)
                - self._project_with(unit - _STEP * axes[:, k], self._parameters)
            )
            / (2.0 * _STEP)
            for k in (0, 1)
        ]
        found = np.stack(columns, axis=-1)
        valid = np.isfinite(np.sum(found, axis=(1, 2), keepdims=True))
        return np.where(valid, found, np.eye(2))

    def _compute_pixel_covariance(self, unit: FloatArray, pixels: FloatArray) -> FloatArray:
        """Return (n, 2, 2) px²: of the fitted parameters and the field, correlated; NaN without a covariance."""
        if not self._covariance.size:
            return np.full((len(unit), 2, 2), np.nan)
        rows = np.empty((len(unit), 2, len(self._fitted)))
        for column, (index, sigma) in enumerate(zip(self._fitted, np.sqrt(np.diag(self._covariance)), strict=True)):
            step = np.zeros(self._parameters.size)
            step[index] = 100.0 * _STEP * sigma + 1e-12
            up, down = (self._project_with(unit, self._parameters + sign * step) for sign in (1.0, -1.0))
            rows[..., column] = (up - down) / (2.0 * step[index])
        result = rows @ self._covariance @ np.swapaxes(rows, 1, 2)
        return np.asarray(result + self._field.covariance(rows, pixels))

    def _compute_sigma_deg(self, unit: FloatArray, covariance_px2: FloatArray) -> FloatArray:
        """Return (n,): the pixel's covariance taken to the sphere, 1-sigma per axis, degrees."""
        valid = np.isfinite(unit[:, 0])
        result, seen = np.full(len(unit), np.nan), unit[valid]
        inverse = np.linalg.inv(self._derive_by_tangents(seen, _make_tangents(seen)))
        covariance = inverse @ covariance_px2[valid] @ np.swapaxes(inverse, 1, 2)
        result[valid] = np.degrees(np.sqrt(0.5 * np.trace(covariance, axis1=1, axis2=2)))
        return result

    def _interpolate_uncertainty(self, unit: FloatArray) -> FloatArray:
        """Return (n, 4) of unit vectors (n, 3): the pixel covariance's Cholesky factor (xx, yx, yy), the sigma (deg).

        From nodes in polar coordinates about the optical axis, by cubic convolution: within 1 % of the exact ones.
        """
        if self._sheets is None:
            self._sheets = self._compute_nodes()
        result, valid = np.full((len(unit), 4), np.nan), np.isfinite(unit[:, 0])
        x, y, z = (unit[valid] @ _rotation_matrix(self._parameters[5:8]).T).T
        ring = np.arctan2(np.hypot(x, y), z) * ((_RINGS - 1) / (self._max_angle - _EDGE))
        spoke = np.arctan2(y, x) % (2.0 * np.pi) * (_SPOKES / (2.0 * np.pi))
        first, across = np.clip(ring.astype(np.int64), 0, _RINGS - 2), np.minimum(spoke.astype(np.int64), _SPOKES - 1)
        total = np.zeros((len(x), 4))
        for j, along in enumerate(_cubic_weights(ring - first)):
            for k, around in enumerate(_cubic_weights(spoke - across)):
                total += (along * around)[:, None] * self._sheets[first + j, across + k]
        result[valid] = total
        return result

    def _compute_nodes(self) -> FloatArray:
        """Return (rings + 2, spokes + 3, 4): values at the nodes of `_interpolate_uncertainty`, one beyond each end."""
        theta = np.linspace(0.0, self._max_angle - _EDGE, _RINGS)[:, None]
        phi = np.arange(_SPOKES) * (2.0 * np.pi / _SPOKES)
        ray = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0.0 * phi], axis=-1)
        unit = ray.reshape(-1, 3) @ _rotation_matrix(self._parameters[5:8])
        pixels = self._project_with(unit, self._parameters)
        covariance = self._compute_pixel_covariance(unit, pixels)
        xx = np.sqrt(covariance[:, 0, 0])
        yx = covariance[:, 1, 0] / xx
        yy = np.sqrt(np.maximum(covariance[:, 1, 1] - yx**2, 0.0))
        sigma = self._compute_sigma_deg(unit, covariance)
        sheets = np.stack([xx, yx, yy, sigma], axis=-1).reshape(_RINGS, _SPOKES, 4)
        for ring in range(1, _RINGS):  # a node without a pixel has what the next one inwards has
            sheets[ring] = np.where(np.isfinite(sheets[ring]), sheets[ring], sheets[ring - 1])
        inner = np.roll(sheets[1:2], _SPOKES // 2, axis=1)  # beyond the axis is the other side
        rings = np.concatenate([inner, sheets, 2.0 * sheets[-1:] - sheets[-2:-1]])
        return np.concatenate([rings[:, -1:], rings, rings[:, :2]], axis=1)


class _Field:
    """Displacement of the image with respect to the lens, and its uncertainty: sine waves on a box."""

    def __init__(self, document: Mapping[str, Any], *, parameters: int) -> None:
        self._amplitude = float(document.get("amplitude_px", 0.0))
        self._half, self._center = np.asarray(document["half_px"]), np.asarray(document["center_px"])
        self._wave_orders = np.asarray(document["orders"]).reshape(-1, 2)
        waves = len(self._wave_orders)
        self._variances = self._compute_unit_variances(float(document.get("length_px", 1.0)))
        self._mean = np.asarray(document.get("mean", np.zeros((2, waves))), dtype=np.float64).reshape(2, waves)
        cross = document.get("cross", np.zeros((2, parameters, waves)))
        self._cross = np.asarray(cross, dtype=np.float64).reshape(2, parameters, waves)
        self._known = np.asarray(document.get("known", []), dtype=np.float64).reshape(-1, waves or 1)
        self._coupling = np.asarray(document.get("coupling", [[], []]), dtype=np.float64).reshape(2, -1, waves or 1)

    def _compute_unit_variances(self, length: float) -> FloatArray:
        """Return (m,): the variances of the waves' coefficients of a field of amplitude 1 and a length in px."""
        frequency = 0.5 * np.pi * self._wave_orders / self._half
        return np.asarray(2.0 * np.pi * length**2 * np.exp(-0.5 * length**2 * np.sum(frequency**2, axis=-1)))

    def _evaluate_waves(self, pixels: FloatArray) -> FloatArray:
        """Return (n, m): the waves at pixels (n, 2); 0 beyond the box."""
        place = (pixels - self._center) / self._half + 1.0
        inside = np.all((place > 0.0) & (place < 2.0), axis=-1, keepdims=True)
        waves = np.prod(np.sin(0.5 * np.pi * self._wave_orders * place[:, None, :]) / np.sqrt(self._half), axis=-1)
        return np.where(inside, waves, 0.0)

    def mean(self, pixels: FloatArray) -> FloatArray | float:
        """Return the displacement of pixels (n, 2) of the lens alone, (n, 2) px."""
        return self._evaluate_waves(pixels) @ self._mean.T if np.any(self._mean) else 0.0

    def covariance(self, rows: FloatArray, pixels: FloatArray) -> FloatArray | float:
        """Return the field's part (n, 2, 2) of the pixels' covariance, px²; `rows` (n, 2, p) are their derivatives."""
        if self._amplitude == 0.0:
            return 0.0
        waves = self._evaluate_waves(pixels)
        mixed = np.einsum("nip,apm,nm->nia", rows, self._cross, waves, optimize=True)
        own = waves**2 @ self._variances
        reduction = np.sum((waves @ self._known.T) ** 2, axis=-1) / np.where(own > 0.0, own, 1.0)
        unknown = self._amplitude**2 - reduction
        result = mixed + np.swapaxes(mixed, 1, 2)
        result = result + np.maximum(unknown, (_LEAST_UNKNOWN * self._amplitude) ** 2)[..., None, None] * np.eye(2)
        if self._coupling.size:
            coupled = np.stack([waves @ part.T for part in self._coupling], axis=1)
            result = result + coupled @ np.swapaxes(coupled, 1, 2)
        return np.asarray(result)


def _rotation_matrix(vector: FloatArray) -> FloatArray:
    """Return the matrix of a rotation vector, east-north-up to camera (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    cross = np.cross(np.eye(3), vector / (angle or 1.0))
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)


def _compute_decentering(c: FloatArray, radius: FloatArray, point: FloatArray) -> FloatArray:
    """Return the decentering (n, 2) in focal lengths; c = p1 … p4 or q1 … q5."""
    off = radius > 0.0
    u, v = np.where(off, point.T / np.where(off, radius, 1.0), np.array([[1.0], [0.0]]))
    higher = radius[:, None] ** (2.0 * np.arange(1, c.size - 1)) @ c[2:]
    shift = [c[0] * (1.0 + 2.0 * u * u) + 2.0 * c[1] * u * v, 2.0 * c[0] * u * v + c[1] * (1.0 + 2.0 * v * v)]
    return np.asarray((radius**2 * (1.0 + higher) * shift).T)


def _evaluate_in_chunks(answer: Curve, rows: FloatArray) -> FloatArray:
    return np.concatenate([answer(part) for part in np.array_split(rows, 1 + len(rows) // _CHUNK)])


def _cubic_weights(t: FloatArray) -> tuple[FloatArray, ...]:
    """Return the weights of four neighbours at a share t of the way between the inner two (Keys 1981, a = -1/2)."""
    return (
        t * (-0.5 + t * (1.0 - 0.5 * t)),
        1.0 + t * t * (1.5 * t - 2.5),
        t * (0.5 + t * (2.0 - 1.5 * t)),
        t * t * (0.5 * t - 0.5),
    )


def _make_tangents(unit: FloatArray) -> FloatArray:
    """Return two unit vectors (n, 2, 3) across each direction and across one another."""
    helper = np.where(np.abs(unit[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    first = np.cross(unit, helper)
    first = first / np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, np.cross(unit, first)], axis=1)
