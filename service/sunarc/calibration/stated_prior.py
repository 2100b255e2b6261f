"""A camera that another program or another instrument stated, corrected by sightings within stated tolerances."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Annotated

import numpy as np
from annotated_types import Gt, Le

from sunarc.calibration import pose
from sunarc.calibration.answers.error_model import build_error_model
from sunarc.calibration.departure import Departure, largest_departure
from sunarc.calibration.fit.assemble import Job, calibration_from_fit, refused, unseen_field
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle, LensTolerances
from sunarc.calibration.model.result import Calibration, refused_for, state_options
from sunarc.calibration.model.sightings import Sightings, filter_sightings
from sunarc.calibration.solve.priors import FREE, LENS, LENS_PARTS, N_LENS, lens_prior, precisions
from sunarc.common.array_types import FloatArray
from sunarc.common.bounds import require_bounds
from sunarc.common.findings import Finding
from sunarc.common.robust_statistics import finite
from sunarc.optics.camera import POSE, Camera
from sunarc.optics.forward import project_fast
from sunarc.optics.pose import rotation_matrix, rotation_vector
from sunarc.optics.projections import ideal_radius
from sunarc.sky.site import Site

_FURTHEST = 3.0
"""Median distance of the sightings from where the prior images the sun, in sigmas, up to which a fit is tried."""
_DECENTERING_SHARE = 0.35
"""Decentering over residual radial distortion: that of the usual tolerances, `LensTolerances`."""
_RIGHT_ANGLE = math.pi / 2


@dataclass(frozen=True, slots=True, kw_only=True)
class PriorTolerances:
    """Tolerances of a stated camera: 1-sigma of its distance from the true one.

    Attributes
    ----------
    lens_px : by which a direction near the horizon may be imaged elsewhere, px, by the focal length (unless
        `focal_length` says otherwise), the principal point and the residual radial distortion alike; the decentering
        is a third of it.
    pose_deg : of the rotation about each axis; None where the pose is not known: it is then sought at any angle.
    focal_length : relative, of the focal length.
    """

    lens_px: Annotated[float, Gt(0.0), Le(20.0)]
    pose_deg: Annotated[float, Gt(0.0), Le(10.0)] | None = None
    focal_length: Annotated[float, Gt(0.0), Le(0.2)] | None = None

    def __post_init__(self) -> None:
        """Refuse invalid tolerances, and those so wide that the equations about the stated camera do not hold."""
        require_bounds(self, section_path="prior")


def calibrate_with_prior(
    points: Sightings, *, prior: Camera, tolerances: PriorTolerances, site: Site, options: CalibrationOptions
) -> Calibration:
    """Return the most probable camera given a stated one and sightings of one pose, from three sightings on.

    All 20 parameters are estimated; what the sightings do not determine keeps the prior's value and its uncertainty.
    Where they contradict the prior, or are too few, the verdict is refused and says why.

    Parameters
    ----------
    points : sightings; their sigma is 0.5 px where they do not state it.
    prior : the stated camera.
    tolerances : how far it may be off.
    site : where the camera stands.
    options : what makes the answer acceptable; its projection and handedness are the prior's.
    """
    prior = prior.lens_alone()
    options = pose.options_about(prior, options)
    size = (prior.width, prior.height)
    usable = filter_sightings(points, site=site, image_size=size)
    job = Job(points=points, usable=usable, site=site, image_size=size, options=options, start=prior, free="prior")
    job = job._replace(tilt_known=tolerances.pose_deg is not None)  # a stated pose states its tilt
    if len(usable) < pose.FEWEST:
        return refused(job, (Finding("too_few_sightings", {"n": len(usable), "least": pose.FEWEST}),))
    basis = whitened_basis(prior, tolerances)
    # its pose is free of error: `fit_pose` adds what is not known of it
    field = unseen_field(prior, size=FREE.size)
    start = pose.stated_calibration(job, prior, covariance=basis @ basis.T, field=field)
    sightings = pose.assign_noise(usable, points, start)
    turned_rad = None if tolerances.pose_deg is None else math.radians(tolerances.pose_deg)
    distance = _median_distance_from_prior(start, sightings, turned_rad)
    if distance > _FURTHEST:
        return refused(job, (_contradiction_finding(distance, _FURTHEST),))
    fit = pose.fit_pose(start, sightings, turned_rad=turned_rad)
    fitted = pose.make_outcome(fit, start, usable, wander_rad=0.0)
    result = calibration_from_fit(fitted, job)
    result = state_options(result, prior=asdict(tolerances))
    departure = _departure(prior, basis, turned_rad, fit)
    if not departure.contradicts:
        return result
    return refused_for(result, _contradiction_finding(departure.rms, departure.limit))


def _contradiction_finding(departure: float, limit: float) -> Finding:
    return Finding("prior_contradicted", {"departure": departure, "limit": limit})


def whitened_basis(prior: Camera, tolerances: PriorTolerances) -> FloatArray:
    """Return (20, 17): the lens's parameters among `FREE` per 1 sigma of each of its whitened coordinates."""
    focal = float(np.mean(prior.focal_length_px))
    edge = float(ideal_radius(prior.projection, _RIGHT_ANGLE if prior.projection != "perspective" else 1.0))
    relative = tolerances.focal_length or tolerances.lens_px / (focal * edge)
    usual = LensTolerances(circle_center_px=tolerances.lens_px, circle_focal_length_px=relative * focal)
    # the circle has no other use than to make both tolerances absolute
    circle = ImageCircle(x=0.0, y=0.0, radius=focal * edge)
    lens = lens_prior(prior, tolerances=usual, circle=circle, field_angle=_RIGHT_ANGLE)
    scaled = lens.basis / np.sqrt(precisions(tolerances.lens_px, _DECENTERING_SHARE * tolerances.lens_px))
    result = np.zeros((FREE.size, N_LENS))
    result[np.isin(FREE, LENS)] = scaled
    return result


def _median_distance_from_prior(start: Calibration, sightings: Sightings, turned_rad: float | None) -> float:
    """Return the median distance of sightings from where the prior images the sun, in its sigmas and theirs; per axis.

    0 where the pose is not known.
    """
    if turned_rad is None:
        return 0.0
    model, camera, some = build_error_model(start), start.camera.at_every_angle(), sightings.thinned(pose.MOST)
    tolerance = pose.tolerance_px(model.add_free_rotation(np.zeros(3), sigma_rad=turned_rad), camera, some)
    off = np.linalg.norm(finite(some.pixels - project_fast(camera, some.directions)), axis=-1)
    return float(np.median(off / tolerance)) / math.sqrt(2.0)


def _departure(prior: Camera, basis: FloatArray, turned_rad: float | None, fit: pose.PoseFit) -> Departure:
    """Return the departure of a camera from its prior, of the lens alone where the pose was not stated."""
    to_lens, covariance = np.linalg.pinv(basis), fit.error_model.covariance
    change = to_lens @ (fit.camera.to_vector() - prior.to_vector())[FREE]
    if turned_rad is None:
        return largest_departure(change, np.eye(N_LENS), to_lens @ covariance @ to_lens.T, parts=LENS_PARTS)
    turn = rotation_matrix(fit.camera.rotation_cam_enu) @ rotation_matrix(prior.rotation_cam_enu).T
    change = np.r_[change, np.array(rotation_vector(turn)) / turned_rad]
    to_prior = np.concatenate([to_lens, np.eye(FREE.size)[POSE] / turned_rad])
    parts = {**LENS_PARTS, "pose": N_LENS + np.arange(3)}
    return largest_departure(change, np.eye(change.size), to_prior @ covariance @ to_prior.T, parts=parts)
