"""The paper's own procedure (Urquhart et al. 2016, section 4), kept as reference and for the studies."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sunarc import _kernels
from sunarc.calibration.fit.assemble import FitOutcome, unseen_field
from sunarc.calibration.model.options import CalibrationOptions, PaperOptions
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.solve.problem import Bins, time_bins
from sunarc.calibration.start.initial_guess import as_far_as_it_rises
from sunarc.common.array_types import FloatArray, IntArray
from sunarc.common.robust_statistics import finite, is_shown
from sunarc.optics.camera import PARAMETER_NAMES, RADIAL_ORDERS, TRANSLATION, Camera, Param
from sunarc.optics.forward import kernel_optics, project_fast, tangent_basis
from sunarc.optics.inverse import unproject
from sunarc.optics.pose import rotation_vector
from sunarc.optics.projections import Projection, ideal_radius, ideal_slope

# The paper's penalties (section 4.2): c1 orthogonality, c2 circularity, c3 monotony.

_ANGLES = 181
_AZIMUTHS = 24
_RIGHT_ANGLE = math.pi / 2
_PERSPECTIVE_EDGE = math.radians(60.0)


class Penalties(NamedTuple):
    """The penalties of Eq. 26 as functions of the parameters, px; the weights are in them, those of c2 and c3 over √n.

    orthogonality (8,): c1 by the radial coefficients. circularity, edge (24, 3), with_decentering: weight of c2, the
    directions whose images' distances from the principal point are compared, and whether the decentering moves them.
    ideal_slope (181,), slope_by_radial (181, 8): c3, where it is negative.

    c2 is taken as the vector of the radius's deviations over √n, whose square is the paper's and which is smooth at 0.
    """

    orthogonality: FloatArray
    circularity: float
    edge: FloatArray
    with_decentering: bool
    ideal_slope: FloatArray
    slope_by_radial: FloatArray


def make_penalties(projection: Projection, options: PaperOptions) -> Penalties:
    """Return the penalties of cameras of a projection."""
    limit = _PERSPECTIVE_EDGE if projection == "perspective" else _RIGHT_ANGLE
    theta, orders = np.linspace(0.0, limit, _ANGLES), np.array(RADIAL_ORDERS)
    tau = (theta / _RIGHT_ANGLE)[:, None]
    azimuth = np.linspace(0.0, 2.0 * math.pi, _AZIMUTHS, endpoint=False)
    sine, cosine = math.sin(limit), np.full(_AZIMUTHS, math.cos(limit))
    monotony = options.monotony_weight / math.sqrt(_ANGLES)
    product = ideal_radius(projection, theta)[:, None] * tau**orders
    return Penalties(
        orthogonality=options.orthogonality_weight * np.trapezoid(product, theta, axis=0),
        circularity=options.circularity_weight / math.sqrt(_AZIMUTHS),
        edge=np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine], axis=-1),
        with_decentering=options.ellipse_scope == "with_decentering",
        ideal_slope=monotony * ideal_slope(projection, theta),
        slope_by_radial=monotony * tau ** (orders - 1) * orders / _RIGHT_ANGLE,
    )


_NUDGE = 1e-5
"""p1 and p2 start off 0: at 0 the fit cannot feel p3 and p4."""
_LEAST_GAIN = 1e-8
"""Relative gain of the squares below which a stage has converged: as MINPACK's `ftol` by default."""
_STAGE, _LAST_STEPS = (400, 1e-3), (10, 1e-8)
"""Most steps, and their first damping. The last steps go from the minimum of the means to that of all sightings, some
hundredths of a sigma."""


def fit_as_paper(
    observed: Sightings, cameras: list[Camera], *, options: CalibrationOptions, quickly: bool = False
) -> FitOutcome:
    """Return the paper's fit of the latest pose epoch's sightings: all that it shows, none weighted.

    Parameters
    ----------
    observed : sightings; those of other epochs are left aside, for the paper knows one pose.
    cameras : first cameras, one an epoch.
    options : `options.paper` says what the paper leaves open.
    quickly : whether the stages' minima are sought on the means of neighbouring sightings, each as heavy as its members
        together, and only the last one converges on all sightings. Where Eq. 26 has several minima (p3 and p4
        that hardly count), another one may be found.
    """
    last = len(cameras) - 1
    in_epoch = observed.epoch == last
    one = replace(observed.select(in_epoch), information=np.ones(1))
    bins = time_bins(observed).select(in_epoch) if quickly else None
    camera = start_camera(cameras[last], one, options)
    last_of_stage = (Param.TRANSLATION_Z, Param.K9, Param.P4)
    for last_moving in last_of_stage:
        moving = np.arange(last_moving + 1)
        if not options.paper.fit_translation:
            moving = np.delete(moving, TRANSLATION)
        if last_moving == Param.P4:
            camera = replace(camera, decentering=(_NUDGE, _NUDGE, 0.0, 0.0))
        sample = one if bins is None else _average_bins(one, bins, camera)
        camera, normal = minimised(camera, sample, moving, options.paper, _STAGE)
    if bins is not None:
        camera, normal = minimised(camera, one, moving, options.paper, _LAST_STEPS)
    residual = np.zeros((len(observed), 2))
    residual[in_epoch] = finite(one.pixels - project_fast(camera.at_every_angle(), one.directions))
    used = in_epoch & is_shown(residual)
    variance = float(np.sum(residual[used] ** 2)) / max(2 * int(np.sum(used)) - moving.size, 1)
    return FitOutcome(
        cameras=[*cameras[:last], camera],
        parameter_names=tuple(PARAMETER_NAMES[i] for i in moving),
        covariance=variance * normal_inverse(normal[np.ix_(moving, moving)]),
        field=unseen_field(camera, size=moving.size),
        residual=residual,
        used=used,
        sigma_px=math.sqrt(variance),
        inflation=1.0,
        radial_px=math.nan,
        held_out=None,
    )


def _average_bins(observed: Sightings, bins: Bins, camera: Camera) -> Sightings:
    """Return one observation a bin, its residual by a camera the mean one; all of them where one is not in view."""
    residual = observed.pixels - project_fast(camera, observed.directions)
    if not np.all(np.isfinite(residual)):
        return observed
    gathered, mean = bins.gathered(observed, residual, observed.information)
    return replace(gathered, pixels=project_fast(camera, gathered.directions) + mean)


def normal_inverse(normal: FloatArray) -> FloatArray:
    """Return (J'J)⁻¹ with J's columns brought to one size first; undetermined directions come out large."""
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    inverse = np.linalg.inv(normal / size[:, None] / size + 1e-14 * np.eye(size.size))
    return np.asarray(inverse / size[:, None] / size, dtype=np.float64)


def start_camera(camera: Camera, observed: Sightings, options: CalibrationOptions) -> Camera:
    """Return K0 with the pose of the chosen start, without distortion."""
    focal = 0.5 * (camera.focal_length_px[0] + camera.focal_length_px[1])
    plain = replace(camera, focal_length_px=(focal, focal), skew_px=0.0, radial=(0.0,) * 8, decentering=(0.0,) * 4)
    if options.paper.pose_start == "wahba":
        return plain
    posed = direct_linear_pose(plain, observed)
    return posed if options.paper.fit_translation else replace(posed, translation=(0.0, 0.0, 0.0))


def minimised(
    camera: Camera, observed: Sightings, moving: IntArray, options: PaperOptions, limits: tuple[int, float]
) -> tuple[Camera, FloatArray]:
    """Return the camera at the minimum of Eq. 26, and the normal equations there by all parameters (23, 23).

    Parameters
    ----------
    moving : places of the parameters that may change.
    limits : most steps of Levenberg-Marquardt, and their first damping.
    """
    most_steps, first_damping = limits
    vector, _, normal = _kernels.paper_fit(
        **kernel_optics(camera.at_every_angle())._asdict(),
        directions=np.ascontiguousarray(observed.directions),
        pixels=np.ascontiguousarray(observed.pixels),
        information=np.ascontiguousarray(observed.information),
        **make_penalties(camera.projection, options)._asdict(),
        start=camera.to_vector(),
        moving=moving,
        most_steps=most_steps,
        least_gain=_LEAST_GAIN,
        first_damping=first_damping,
    )
    return camera.replace_parameters(vector), normal


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
    blocks = np.einsum("ni,nja->naji", normalised, tangent_basis(rays)).reshape(-1, 3, 4)
    solution = np.linalg.svd(blocks.reshape(-1, 12), full_matrices=False)[2][-1].reshape(3, 4)
    undo = np.eye(4)
    undo[:3] *= scale
    undo[:3, 3] = -scale * center
    return _pose_from_projection_matrix(camera, solution @ undo, world, rays)


def _pose_from_projection_matrix(camera: Camera, matrix: FloatArray, world: FloatArray, rays: FloatArray) -> Camera:
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
