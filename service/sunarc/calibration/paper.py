"""The paper's own procedure (Urquhart et al. 2016, section 4), kept as reference and for the studies."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sunarc import _kernels
from sunarc.array_types import FloatArray, IntArray
from sunarc.calibration.fit.assemble import FitOutcome, no_field
from sunarc.calibration.model.options import CalibrationOptions, PaperOptions
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.robust_loss import finite
from sunarc.calibration.solve.problem import Bins, time_bins
from sunarc.calibration.start.initial_guess import as_far_as_it_rises
from sunarc.optics.camera import DECENTERING, PARAMETER_NAMES, RADIAL, RADIAL_ORDERS, TRANSLATION, Camera, Param
from sunarc.optics.forward import (
    decentering_shift,
    decentering_slopes,
    kernel_optics,
    project_fast,
    project_with_rows_fast,
)
from sunarc.optics.inverse import unproject
from sunarc.optics.pose import rotation_vector
from sunarc.optics.projections import Projection, angle_limit, ideal_radius, ideal_slope


class PenaltyArrays(NamedTuple):
    """The penalties c1, c2, c3 as numbers, see `Penalties`; the weights are in them, those of c2 and c3 over √n.

    orthogonality (8,); circularity, edge_radius, edge_powers (8,), cosine and sine (24,) of the edge, and whether its
    shape contains the decentering; monotony, ideal_slope (181,) and slope_by_radial (181, 8).
    """

    orthogonality: FloatArray
    circularity: float
    edge_radius: float
    edge_powers: FloatArray
    cosine: FloatArray
    sine: FloatArray
    with_decentering: bool
    monotony: float
    ideal_slope: FloatArray
    slope_by_radial: FloatArray


class Limits(NamedTuple):
    """When the steps end: how many at most, the share of the cost that a step must gain; and their first damping."""

    most_steps: int
    least_gain: float
    first_damping: float


# The paper's penalties (section 4.2): c1 orthogonality, c2 circularity, c3 monotony.

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

    def weighed(self) -> PenaltyArrays:
        """Return the penalties as the compiled loop takes them."""
        return PenaltyArrays(
            orthogonality=self.options.orthogonality_weight * self.orthogonality,
            circularity=self.options.circularity_weight / math.sqrt(_AZIMUTHS),
            edge_radius=self.edge_radius,
            edge_powers=(self.edge / _RIGHT_ANGLE) ** np.array(RADIAL_ORDERS, dtype=np.float64),
            cosine=_U,
            sine=_V,
            with_decentering=self.options.ellipse_scope == "with_decentering",
            monotony=self.options.monotony_weight / math.sqrt(_ANGLES),
            ideal_slope=np.ascontiguousarray(self.ideal_slope),
            slope_by_radial=np.ascontiguousarray(self.slope_by_radial),
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


_NUDGE = 1e-5
"""p1 and p2 start off 0: at 0 the fit cannot feel p3 and p4."""
_STAGE = Limits(400, 1e-8, 1e-3)
"""Relative gain of the squares below which a stage has converged: as MINPACK's `ftol` by default."""
_LAST_STEPS = Limits(10, 1e-8, 1e-8)
"""From the minimum of the means to that of all sightings, some hundredths of a sigma."""
_PERSPECTIVE_EDGE = math.radians(60.0)


def fit_as_paper(
    observed: Sightings,
    usable: Sightings,
    cameras: list[Camera],
    *,
    options: CalibrationOptions,
    quickly: bool = False,
) -> FitOutcome:
    """Return the paper's fit of the latest pose epoch's sightings: all of them, none weighted.

    Parameters
    ----------
    observed : sightings; those of other epochs are left aside, for the paper knows one pose.
    usable : the same sightings' times.
    cameras : first cameras, one an epoch.
    options : `options.paper` says what the paper leaves open.
    quickly : whether the stages' minima are sought on the means of neighbouring sightings, each as heavy as its members
        together, and only the last one converges on all sightings. Where Eq. 26 has several minima (p3 and p4
        that hardly count), another one may be found.
    """
    last = len(cameras) - 1
    in_epoch = usable.epoch == last
    one = observed.select(in_epoch).weighted(np.ones(int(np.sum(in_epoch))))
    bins = time_bins(usable).select(in_epoch) if quickly else None
    camera = start_camera(cameras[last], one, options)
    last_of_stage = (Param.TRANSLATION_Z, Param.K9, Param.P4)
    for last_moving in last_of_stage:
        moving = np.arange(last_moving + 1)
        if not options.paper.fit_translation:
            moving = np.delete(moving, TRANSLATION)
        if last_moving == Param.P4:
            camera = replace(camera, decentering=(_NUDGE, _NUDGE, 0.0, 0.0))
        sample = one if bins is None else _means(one, bins, camera)
        camera = _minimised(camera, sample, moving, options, _STAGE)
    if bins is not None:
        camera = _minimised(camera, one, moving, options, _LAST_STEPS)
    misfit, jacobian = equations(camera, one, options)
    residual = np.full((len(observed), 2), np.nan)
    residual[in_epoch] = -misfit[: 2 * len(one)].reshape(-1, 2)
    degrees_of_freedom = max(2 * len(one) - moving.size, 1)
    variance = float(np.sum(misfit[: 2 * len(one)] ** 2)) / degrees_of_freedom
    return FitOutcome(
        cameras=[*cameras[:last], camera],
        parameter_names=tuple(PARAMETER_NAMES[i] for i in moving),
        covariance=variance * normal_inverse(jacobian[:, moving]),
        field=no_field(camera, size=moving.size),
        residual=np.nan_to_num(residual),
        used=in_epoch,
        sigma_px=math.sqrt(variance),
        inflation=1.0,
        radial_px=math.nan,
        held_out=None,
    )


def _means(observed: Sightings, bins: Bins, camera: Camera) -> Sightings:
    """Return one observation a bin, its residual by a camera the mean one; all of them where one is not in view."""
    residual = observed.pixels - project_fast(camera, observed.directions)
    if not np.all(np.isfinite(residual)):
        return observed
    gathered, mean = bins.gathered(observed, residual, observed.information)
    return replace(gathered, pixels=project_fast(camera, gathered.directions) + mean)


def normal_inverse(jacobian: FloatArray) -> FloatArray:
    """Return (J'J)⁻¹ with its columns brought to one size first; what nothing determines comes out large."""
    size = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    scaled = jacobian / size
    inverse = np.linalg.inv(scaled.T @ scaled + 1e-14 * np.eye(size.size))
    return np.asarray(inverse / size[:, None] / size, dtype=np.float64)


def start_camera(camera: Camera, observed: Sightings, options: CalibrationOptions) -> Camera:
    """Return K0 with the pose of the chosen start, without distortion."""
    focal = 0.5 * (camera.focal_length_px[0] + camera.focal_length_px[1])
    plain = replace(camera, focal_length_px=(focal, focal), skew_px=0.0, radial=(0.0,) * 8, decentering=(0.0,) * 4)
    if options.paper.pose_start == "wahba":
        return plain
    posed = direct_linear_pose(plain, observed)
    return posed if options.paper.fit_translation else replace(posed, translation=(0.0, 0.0, 0.0))


class Equations(NamedTuple):
    """The misfit of Eq. 26 about some parameters: its vector (n,) and derivatives (n, 23)."""

    misfit: FloatArray
    jacobian: FloatArray


def _minimised(
    camera: Camera, observed: Sightings, moving: IntArray, options: CalibrationOptions, limits: Limits
) -> Camera:
    """Return the camera at the minimum of Eq. 26.

    Levenberg-Marquardt on the normal equations, their columns brought to one size.
    """
    vector, _ = _kernels.paper_fit(
        **kernel_optics(unlimited(camera))._asdict(),
        directions=np.ascontiguousarray(observed.directions),
        pixels=np.ascontiguousarray(observed.pixels),
        information=np.ascontiguousarray(observed.information),
        **penalties_of(camera, options).weighed()._asdict(),
        start=camera.to_vector(),
        moving=moving,
        **limits._asdict(),
    )
    return camera.with_parameters(vector)


def unlimited(camera: Camera) -> Camera:
    """Return a camera with the largest angle that its projection allows."""
    return replace(camera, max_angle=angle_limit(camera.projection) * (1.0 - 1e-6))


def penalties_of(camera: Camera, options: CalibrationOptions) -> Penalties:
    """Return the penalties of the paper's constraints on a camera."""
    edge = _PERSPECTIVE_EDGE if camera.projection == "perspective" else math.pi / 2
    return Penalties.of(camera.projection, options.paper, largest_angle=edge)


def equations(camera: Camera, observed: Sightings, options: CalibrationOptions) -> Equations:
    """Return the misfit of a camera that answers at any angle, each sighting weighed by its information."""
    pixels, rows = project_with_rows_fast(unlimited(camera), observed.directions)
    values, slopes = penalties_of(camera, options).values_and_slopes(camera.to_vector())
    root = np.sqrt(observed.information)[:, None]
    misfit = np.concatenate([(root * finite(pixels - observed.pixels)).ravel(), values])
    return Equations(misfit, np.concatenate([(root[..., None] * rows).reshape(-1, slopes.shape[1]), slopes]))


# The pose by the direct linear transform (Eqs. 23 to 25).


def direct_linear_pose(camera: Camera, observed: Sightings) -> Camera:
    """Return the camera with the pose and translation of the direct linear transform.

    Sun directions of one or two days lie nearly in a plane, and the transform then says next to nothing: that is what
    the paper's procedure does, and why `wahba` is the default.

    Parameters
    ----------
    camera : K0; its own pose does not count.
    observed : sightings of one pose epoch.
    """
    rays = unproject(as_far_as_it_rises(camera), observed.pixels)
    good = np.all(np.isfinite(rays), axis=-1)
    rays, world = rays[good], observed.directions[good]
    # Hartley's normalisation: without it the 12 columns differ by orders of magnitude
    center, spread = world.mean(axis=0), float(np.mean(np.linalg.norm(world - world.mean(axis=0), axis=-1)))
    scale = math.sqrt(3.0) / spread
    normalised = np.concatenate([scale * (world - center), np.ones((world.shape[0], 1))], axis=1)
    blocks = np.einsum("ni,naj->naji", normalised, left_null_spaces(rays)).reshape(-1, 3, 4)
    solution = np.linalg.svd(blocks.reshape(-1, 12), full_matrices=False)[2][-1].reshape(3, 4)
    undo = np.eye(4)
    undo[:3] *= scale
    undo[:3, 3] = -scale * center
    return _posed(camera, solution @ undo, world, rays)


def left_null_spaces(rays: FloatArray) -> FloatArray:
    """Return (n, 2, 3): two unit vectors orthogonal to each ray and to each other."""
    helper = np.where(np.abs(rays[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    first = np.cross(helper, rays)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, np.cross(rays, first)], axis=1)


def _posed(camera: Camera, matrix: FloatArray, world: FloatArray, rays: FloatArray) -> Camera:
    """Take R and t out of P up to its scale and sign, as the paper does after Eq. 25."""
    toward = np.sum((world @ matrix[:, :3].T + matrix[:, 3]) * rays)
    matrix = matrix * (1.0 if toward >= 0.0 else -1.0)
    left, singular, right = np.linalg.svd(matrix[:, :3])
    # P is known up to its sign: a rotation has the determinant +1
    sign = np.sign(np.linalg.det(left @ right))
    rotation = sign * left @ right
    shift = sign * matrix[:, 3] / float(np.mean(singular))
    return replace(
        camera,
        rotation_cam_enu=rotation_vector(rotation),
        translation=(float(shift[0]), float(shift[1]), float(shift[2])),
    )
