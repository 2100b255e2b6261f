"""The pose of a camera that was never calibrated, from its first sightings: its lens is known, and it is level.

A handful of sightings of one hour say where the sun was and which way it went. With the lens known within the spread
of its type and the camera level within some degrees, that is a pose: poses at all azimuths are tried, the most
probable one is conditioned on the sightings, and its covariance is what the sightings left of tilt, north and lens.
The same is done for the mirrored image: an image of the wrong handedness is said, not served, and so is a second
azimuth that fits as well.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sunarc.calibration.answers.error_model import (
    CameraErrorModel,
    build_error_model,
    joint_covariance,
    moved,
    predicted,
    rotated,
)
from sunarc.calibration.departure import Departure, largest_departure
from sunarc.calibration.evidence import PixelResiduals, false_density, fit_inlier_mixture
from sunarc.calibration.fit.assemble import Job, calibration_from_fit, refused, unseen_field
from sunarc.calibration.lens_library.conditioning import contradicted, lens_finding
from sunarc.calibration.lens_library.lens_type import IN_FREE, LensType
from sunarc.calibration.model.options import CalibrationOptions, FirstPoseOptions
from sunarc.calibration.model.result import Calibration, add_finding, refused_for, state_options
from sunarc.calibration.model.sightings import Sightings, filter_sightings
from sunarc.calibration.pose import (
    MOST,
    PoseFit,
    assign_noise,
    conditioned_pose,
    make_outcome,
    options_about,
    settled,
    stated_calibration,
)
from sunarc.calibration.solve.priors import FREE, LENS_PARTS, N_LENS
from sunarc.calibration.start.initial_guess import ransac_rotation
from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.common.findings import Finding
from sunarc.common.robust_statistics import finite
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project_fast
from sunarc.optics.mounting import top_azimuth_deg
from sunarc.optics.pose import rotation_between, rotation_matrix, rotation_vector, smallest_rotation
from sunarc.sky.directions import wrapped_deg
from sunarc.sky.site import Site

# How a camera stands: level, towards which azimuth, and how sure one is of that.


def level(camera: Camera, azimuth_rad: float) -> Camera:
    """Return a level camera, with the top of its image towards an azimuth (clockwise from north)."""
    sine, cosine = math.sin(azimuth_rad), math.cos(azimuth_rad)
    # rows: image right, down and out of the lens in east, north, up; looking up, east is left of north
    matrix = np.array([[-cosine, sine, 0.0], [-sine, -cosine, 0.0], [0.0, 0.0, 1.0]])
    return replace(camera, rotation_cam_enu=rotation_vector(matrix))


def levelling(camera: Camera) -> FloatArray:
    """Return the smallest rotation (3,) about a camera's own axes, radians, that points it at the zenith."""
    return smallest_rotation(rotation_matrix(camera.rotation_cam_enu)[:, 2], np.array([0.0, 0.0, 1.0]))


def north_sigma_deg(calibration: Calibration) -> float:
    """Return the 1-sigma of the camera's rotation about the vertical, degrees."""
    error_model = build_error_model(calibration)
    about_up = rotation_matrix(calibration.camera.rotation_cam_enu) @ np.array([0.0, 0.0, 1.0])
    covariance = error_model.covariance[np.ix_(error_model.rotation, error_model.rotation)]
    return math.degrees(math.sqrt(max(float(about_up @ covariance @ about_up), 0.0)))


FEWEST_SIGHTINGS = 4
_AZIMUTHS = 48
"""Azimuths tried: 7.5 degrees apart."""
_COARSE = 12
"""Sightings, spread over time, that the azimuths are compared by."""
_REFINED = 6
"""Starts of them that are refined with exact equations."""
_NONLINEAR_PX = 3.0
"""By how much the equations about a level camera are off for one that is tilted by 3 degrees and turned by 4."""
_CELL_RAD = math.radians(6.0)
"""1-sigma about each azimuth tried; neighbours overlap."""
_AZIMUTH_RAD = math.radians(60.0)
"""1-sigma of the azimuth about the best one: as good as unknown."""
_DECIDED = 3.0
"""Log odds by which a pose, and a handedness, must be the more probable one: 20 to 1."""
_SAME_POSE_RAD = math.radians(15.0)
_CLOSE = 6.0
_LENS_PX = 1.0
"""By which a lens of the type images neighbouring places differently, apart from a common shift."""
_LARGEST_SIGMA_DEG = 10.0
"""Direction uncertainty, RMS over the sky, from which on a pose is of no use: clouds of the wrong half of the sky."""


class _FoundPose(NamedTuple):
    """A pose, its prior's camera and error model, the log evidence, and the log odds against other azimuths."""

    fit: PoseFit
    base: Camera
    prior: CameraErrorModel
    log_evidence: float
    log_odds: float


def first_pose(
    points: Sightings, *, lens: LensType, site: Site, options: CalibrationOptions, pose: FirstPoseOptions | None = None
) -> Calibration:
    """Return the most probable camera of a type of lens given its first sightings, from four on.

    Poor or contradictory sightings give a calibration whose verdict is refused and says why; they never raise.

    Parameters
    ----------
    points : sightings of one pose; their sigma is 0.5 px where they do not state it.
    lens : the type.
    site : where the camera stands.
    options : what makes the answer acceptable, but for its uncertainty, which may be 10 degrees.
    pose : what is known of the pose.
    """
    known = FirstPoseOptions() if pose is None else pose
    level_within = max(options.level_within_deg or 0.0, 3.0 * known.tilt_deg)
    options = replace(
        options_about(lens.camera, options), level_within_deg=level_within, max_sky_deg=_LARGEST_SIGMA_DEG
    )
    usable = filter_sightings(replace(points, epoch=np.zeros(len(points), dtype=np.int64)), site=site)
    size = (lens.camera.width, lens.camera.height)
    job = Job(points=points, usable=usable, site=site, image_size=size, options=options, start=lens.camera, free="pose")
    if len(usable) < FEWEST_SIGHTINGS:
        return refused(job, (Finding("too_few_sightings", {"n": len(usable), "least": FEWEST_SIGHTINGS}),))
    covariance = np.zeros((FREE.size, FREE.size))
    covariance[np.ix_(IN_FREE, IN_FREE)] = lens.covariance
    # its pose is free of error here: what is not known of it is added where it is sought
    amplitude_px, length_px = lens.field_px, lens.field_length_px
    field = unseen_field(lens.camera, size=FREE.size, amplitude_px=amplitude_px, length_px=length_px)
    start = stated_calibration(job, lens.camera, covariance=covariance, field=field)
    both = start, replace(start, camera=replace(start.camera, mirrored=not start.camera.mirrored))
    # a false one may be anywhere in the image
    area_px2 = float(lens.camera.width * lens.camera.height)
    anywhere = false_density(np.full(usable.pixels.shape, np.inf), area_px2=area_px2)
    sightings = replace(assign_noise(usable, points, start), false_density=anywhere)
    # the same sightings for both handednesses, or their evidences could not be compared
    close = max((_select_agreeing(one.camera.at_every_angle(), sightings.thinned(MOST)) for one in both), key=np.sum)
    if np.sum(close) < FEWEST_SIGHTINGS:
        close = np.ones(close.size, dtype=bool)
    try:
        found, other = (_most_probable(one, sightings, close, math.radians(known.tilt_deg)) for one in both)
    except np.linalg.LinAlgError:  # no pose is near the sightings: the equations mean nothing
        return refused(job, (Finding("no_camera_fits"),))
    fitted = make_outcome(found.fit, start, usable, wander_rad=0.0)
    result = calibration_from_fit(fitted, job)
    return _judge_pose(state_options(result, lens_prior=lens.as_evidence()), found, other, lens, known)


def _select_agreeing(camera: Camera, thin: Sightings) -> BoolArray:
    """Return which sightings agree on one rotation of a camera, whatever it is."""
    tolerance = np.sqrt(thin.variance + _LENS_PX**2)
    rotation = ransac_rotation(camera, thin.directions, thin.pixels, tolerance)
    off = thin.pixels - project_fast(rotated(camera, rotation), thin.directions)
    return np.asarray(np.linalg.norm(finite(off), axis=-1) < _CLOSE * tolerance)


def _most_probable(start: Calibration, sightings: Sightings, close: BoolArray, tilt_rad: float) -> _FoundPose:
    """Return the most probable pose at any azimuth of a camera that is level within a 1-sigma per axis."""
    error_model, camera = build_error_model(start), start.camera.at_every_angle()
    some = np.flatnonzero(close)
    coarse = sightings.thinned(MOST).select(some[np.unique(np.linspace(0, some.size - 1, _COARSE).astype(int))])
    spread = np.array([tilt_rad, tilt_rad, _CELL_RAD])
    cell = error_model.add_free_rotation(np.zeros(3), sigma_rad=spread)
    bases = [level(camera, azimuth) for azimuth in np.arange(_AZIMUTHS) * (2.0 * math.pi / _AZIMUTHS)]
    order = np.argsort([-_approximate_evidence(cell, base, coarse) for base in bases])
    tried = sorted((_refine_level_pose(cell, bases[k], coarse) for k in order[:_REFINED]), key=lambda one: -one[0])
    evidence, best = tried[0]
    pose = best.rotation_cam_enu
    rivals = [other for other, one in tried if rotation_between(one.rotation_cam_enu, pose) > _SAME_POSE_RAD]
    # about the best pose: the prior is level at its own azimuth, which is as good as unknown
    base = replace(camera, rotation_cam_enu=pose)
    spread[2] = _AZIMUTH_RAD
    prior = error_model.add_free_rotation(levelling(base), sigma_rad=spread)
    fit = conditioned_pose([prior], np.zeros(1), base, sightings, close, inflation=1.0)
    return _FoundPose(fit, base, prior, evidence, evidence - max(rivals, default=-math.inf))


def _approximate_evidence(cell: CameraErrorModel, base: Camera, coarse: Sightings) -> float:
    """Return the log evidence of a level camera, by equations that are good to some px."""
    at = predicted(cell, base, coarse.directions)
    about = PixelResiduals(
        residual=finite(coarse.pixels - at.pixels),
        variance=coarse.variance + _NONLINEAR_PX**2,
        false_density=coarse.false_density,
    )
    everyone = np.ones(len(coarse), dtype=bool)
    return fit_inlier_mixture(np.nan_to_num(joint_covariance(cell, at)), about, everyone).log_evidence


def _refine_level_pose(cell: CameraErrorModel, base: Camera, coarse: Sightings) -> tuple[float, Camera]:
    """Return the log evidence of the poses about a level camera, and the best of them."""
    try:
        after, mixture = settled(cell, base, coarse, np.ones(len(coarse), dtype=bool))
    except np.linalg.LinAlgError:  # so far off that the equations mean nothing
        return -math.inf, base
    return mixture.log_evidence, moved(base, after, after.mean)


def _judge_pose(
    result: Calibration, found: _FoundPose, other: _FoundPose, lens: LensType, known: FirstPoseOptions
) -> Calibration:
    """Return the calibration with a verdict about its pose, and why it is not served."""
    north = {"north_sigma_deg": north_sigma_deg(result), "top_azimuth_deg": top_azimuth_deg(result.camera)}
    against = _find_objections(found, other, known, north)
    departure = _compute_departure_from_prior(found, lens)
    if departure.contradicts and not against:
        return contradicted(result, departure)
    if against:
        return refused_for(result, *against)
    described = add_finding(result, Finding("first_pose", {"n": result.evidence.n_used, **north}))
    return add_finding(described, lens_finding("lens_prior_used", lens))


def _find_objections(
    found: _FoundPose, other: _FoundPose, known: FirstPoseOptions, north: dict[str, float]
) -> list[Finding]:
    """Return the objections to serving a pose."""
    odds = found.log_evidence - other.log_evidence
    if odds < -_DECIDED:
        return [Finding("first_pose_mirrored", {"log10_odds": -odds / math.log(10.0)})]
    if odds < _DECIDED:
        return [Finding("mirroring_ambiguous")]
    if found.log_odds < _DECIDED:
        return [Finding("north_ambiguous", {"log10_odds": found.log_odds / math.log(10.0)})]
    if known.top_azimuth_deg is None:
        return []
    off = abs(float(wrapped_deg(north["top_azimuth_deg"] - known.top_azimuth_deg)))
    if off <= known.top_within_deg + 2.0 * north["north_sigma_deg"]:
        return []
    expected = {"expected_deg": known.top_azimuth_deg, "off_deg": off}
    return [Finding("north_not_as_mounted", {**north, **expected})]


def _compute_departure_from_prior(found: _FoundPose, lens: LensType) -> Departure:
    """Return the departure of lens and tilt from their priors."""
    prior, after = found.prior, found.fit.error_model
    vector = found.fit.camera.to_vector() - found.base.to_vector()
    tilt = prior.rotation[:2]
    to_frame = np.zeros((N_LENS + 2, FREE.size))
    to_frame[:N_LENS, IN_FREE] = np.linalg.inv(lens.frame.basis)
    to_frame[N_LENS + np.arange(2), tilt] = 1.0
    stated = np.diag(np.r_[np.zeros(N_LENS), np.diag(prior.covariance)[tilt]])
    stated[:N_LENS, :N_LENS] = lens.in_frame().covariance
    change = to_frame[:, IN_FREE] @ vector[FREE][IN_FREE]
    change[N_LENS:] = -levelling(found.fit.camera)[:2]
    return largest_departure(
        change,
        stated,
        to_frame @ after.covariance @ to_frame.T,
        parts={**LENS_PARTS, "tilt": np.arange(N_LENS, N_LENS + 2)},
    )
