"""Eq. 26 in numpy: the paper's penalties as a vector, and the misfit with its derivatives."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sunarc.calibration.model.options import PaperOptions
from sunarc.calibration.model.sightings import Sightings
from sunarc.common.robust_statistics import finite
from sunarc.optics.camera import DECENTERING, RADIAL, RADIAL_ORDERS, Camera, Param
from sunarc.optics.forward import decentering_shift, decentering_slopes, project_with_rows_fast
from sunarc.optics.projections import Projection, ideal_radius, ideal_slope

FloatArray = NDArray[np.float64]

_ANGLES = 181
_AZIMUTHS = 24
_RIGHT_ANGLE = math.pi / 2
_ROUND, _FALLING = slice(1, 1 + _AZIMUTHS), slice(1 + _AZIMUTHS, None)
_U, _V = (of(np.linspace(0.0, 2.0 * math.pi, _AZIMUTHS, endpoint=False)) for of in (np.cos, np.sin))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Penalties:
    """The penalty vector ε_c of Eq. 26, px, (206,), as a function of the 23 parameters.

    c2 is taken as the vector of the radius's deviations over √n, whose square is the paper's and which is smooth at 0.

    Attributes
    ----------
    options : weights and the scope of c2.
    edge : θ_max, radians; edge_radius: the ideal radius there.
    orthogonality (8,): c1 by the radial coefficients.
    ideal_slope (181,), slope_by_radial (181, 8): the radius's slope over the angles.
    """

    options: PaperOptions
    edge: float
    edge_radius: float
    orthogonality: FloatArray
    ideal_slope: FloatArray
    slope_by_radial: FloatArray

    @classmethod
    def of(cls, projection: Projection, options: PaperOptions, *, largest_angle: float) -> Penalties:
        """Return the penalties of cameras of a projection, looked at up to an angle in radians."""
        theta = np.linspace(0.0, largest_angle, _ANGLES)
        orders = np.array(RADIAL_ORDERS)
        powers = (theta / _RIGHT_ANGLE)[:, None] ** orders
        ideal = ideal_radius(projection, theta)
        return cls(
            options=options,
            edge=largest_angle,
            edge_radius=float(ideal[-1]),
            orthogonality=np.trapezoid(ideal[:, None] * powers, theta, axis=0),
            ideal_slope=ideal_slope(projection, theta),
            slope_by_radial=(theta / _RIGHT_ANGLE)[:, None] ** (orders - 1) * orders / _RIGHT_ANGLE,
        )

    def values(self, vector: FloatArray) -> FloatArray:
        """Return ε_c of parameters (23,)."""
        return self.values_and_slopes(vector)[0]

    def values_and_slopes(self, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return ε_c (206,) and its derivatives by the parameters (206, 23)."""
        radial = vector[RADIAL]
        slopes = np.zeros((1 + _AZIMUTHS + _ANGLES, len(Param)))
        slopes[0, RADIAL] = self.options.orthogonality_weight * self.orthogonality
        distance, by_parameters = self._edge_distance(vector)
        weight = self.options.circularity_weight / math.sqrt(_AZIMUTHS)
        slopes[_ROUND] = weight * (by_parameters - by_parameters.mean(axis=0))
        # c3 is one-sided: a radius that rises costs nothing, however fast
        slope = self.ideal_slope + self.slope_by_radial @ radial
        falling = self.options.monotony_weight / math.sqrt(_ANGLES) * (slope < 0.0)
        slopes[_FALLING, RADIAL] = falling[:, None] * self.slope_by_radial
        values = [slopes[:1, RADIAL] @ radial, weight * (distance - distance.mean()), falling * slope]
        return np.concatenate(values), slopes

    def _edge_distance(self, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return how far the edge's image lies from the principal point, px (24,), and its slopes (24, 23)."""
        fx, fy, skew = vector[[Param.FOCAL_LENGTH_X_PX, Param.FOCAL_LENGTH_Y_PX, Param.SKEW_PX]]
        powers = (self.edge / _RIGHT_ANGLE) ** np.array(RADIAL_ORDERS)
        radius = self.edge_radius + float(powers @ vector[RADIAL])
        # by columns: the radius, then p1 … p4
        point, by_shape = np.stack([radius * _U, radius * _V]), np.zeros((2, _AZIMUTHS, 5))
        by_shape[..., 0] = _U, _V
        if self.options.ellipse_scope == "with_decentering":
            shift, by_shift = _decentering(vector[DECENTERING], radius)
            point, by_shape = point + shift, by_shape + by_shift
        x, y = fx * point[0] + skew * point[1], fy * point[1]
        distance = np.hypot(x, y)
        by_x, by_y = x / distance, y / distance
        result = np.zeros((_AZIMUTHS, len(Param)))
        result[:, Param.FOCAL_LENGTH_X_PX] = by_x * point[0]
        result[:, Param.FOCAL_LENGTH_Y_PX] = by_y * point[1]
        result[:, Param.SKEW_PX] = by_x * point[1]
        by_shape_px = by_x[:, None] * (fx * by_shape[0] + skew * by_shape[1]) + by_y[:, None] * fy * by_shape[1]
        result[:, RADIAL] = by_shape_px[:, :1] * powers
        result[:, DECENTERING] = by_shape_px[:, 1:]
        return distance, result


def _decentering(coefficients: FloatArray, radius: float) -> tuple[FloatArray, FloatArray]:
    """Return the shift of Eq. 12 (2, 24) round the axis, and its slopes by the radius and p1 … p4 (2, 24, 5)."""
    p3, p4 = coefficients[2:]
    square = radius**2
    around = np.full(_AZIMUTHS, radius)
    shift = np.stack(decentering_shift(coefficients, around, _U, _V))
    profile = square * (1.0 + p3 * square + p4 * square**2)
    rise = radius * (2.0 + 4.0 * p3 * square + 6.0 * p4 * square**2)
    by_coefficients = np.moveaxis(decentering_slopes(coefficients, around, _U, _V), -2, 0)
    return shift, np.concatenate([(rise / profile * shift)[..., None], by_coefficients], axis=-1)


def penalties(camera: Camera, options: PaperOptions, *, largest_angle: float) -> FloatArray:
    """Return the paper's penalty vector of a camera, px."""
    return Penalties.of(camera.projection, options, largest_angle=largest_angle).values(camera.to_vector())


class Equations(NamedTuple):
    """The misfit of Eq. 26 about some parameters: its vector (n,) and derivatives (n, 23)."""

    misfit: FloatArray
    jacobian: FloatArray


def equations(camera: Camera, observed: Sightings, options: PaperOptions) -> Equations:
    """Return the misfit of a camera that answers at any angle, each sighting weighed by its information."""
    pixels, rows = project_with_rows_fast(camera.at_every_angle(), observed.directions)
    edge = math.radians(60.0) if camera.projection == "perspective" else _RIGHT_ANGLE
    penalties = Penalties.of(camera.projection, options, largest_angle=edge)
    values, slopes = penalties.values_and_slopes(camera.to_vector())
    root = np.sqrt(observed.information)[:, None]
    misfit = np.concatenate([(root * finite(pixels - observed.pixels)).ravel(), values])
    return Equations(misfit, np.concatenate([(root[..., None] * rows).reshape(-1, slopes.shape[1]), slopes]))
