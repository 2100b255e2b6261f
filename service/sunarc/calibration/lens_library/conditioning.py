"""Fit with the prior of its type of lens, and its departure from that prior.

The fit of the sightings alone is made first: it decides which sightings count, how noisy they are, and what no lens
model describes. The type then takes the place of the fit's own prior of the lens; pose and field follow by their
regression on the lens. Sightings that contradict the type refuse it, and a type that makes a good fit meet its
sightings worse is left out.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sunarc.calibration.answers.covariance import sky_sigma_deg
from sunarc.calibration.departure import Departure, largest_departure
from sunarc.calibration.fit.assemble import tidied
from sunarc.calibration.lens_library.lens_type import (
    IN_FREE,
    Gaussian,
    LensType,
    lens_gaussian,
    sighting_information,
)
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import (
    Calibration,
    add_finding,
    fit_metrics,
    refused_for,
    residual_angles,
    state_options,
)
from sunarc.calibration.model.sightings import Sightings, filter_sightings
from sunarc.calibration.solve.levenberg_marquardt import most_probable
from sunarc.calibration.solve.priors import FREE, LENS_PARTS, N_LENS, LensPrior
from sunarc.calibration.solve.problem import problem_for
from sunarc.calibration.verdict import fit_verdict
from sunarc.common.array_types import BoolArray, FloatArray
from sunarc.common.findings import Finding
from sunarc.common.robust_statistics import CUT, finite, tukey_loss
from sunarc.optics.backward import fit_backward
from sunarc.optics.camera import Camera
from sunarc.optics.forward import project_fast
from sunarc.optics.pose import pose_angles

_SCALES = (0.7, 1.0, 1.4)
"""The cost is compared at these multiples of the noise: a fit must not win by the choice of its scale."""
LENS_MISFIT_PX = 1.0
"""px per axis; lenses are not as modelled by tenths of px, the paper's own by 0.5 to 1.2. A field that takes more from
the camera has taken over what its parameters explain."""
FIELD_EXCESS = 2.0
"""Root mean square along the sun's way over the amplitude of a field. With a kernel k there are 2 / mean(k²)
independent parts there, both components counted: four of a field of 0.36 of the image, nine of one of 0.16, on a day as
on several. 99 % of the chi-squares of four are below 3.3 times their mean, that is 1.8 times the amplitude, and that is
itself estimated."""
_MEDIAN_OF_SIGMA = math.sqrt(2.0 * math.log(2.0))
"""Median distance of a round Gaussian over its 1-sigma per axis."""


def is_met_as_well(distance: FloatArray, other: FloatArray, *, sigma: float, field_px: float, ratio: float) -> bool:
    """Return whether a camera meets sightings about as well as another one.

    Parameters
    ----------
    distance, other : (n,) between seen and modelled pixels, px, of the camera and of the other one.
    sigma : px, the noise.
    field_px : 1-sigma of the displacement outside the lens, by the data: the camera may miss the sightings by
        `FIELD_EXCESS` times as much, `LENS_MISFIT_PX` of it counted at most.
    ratio : by how much robust cost and median may be larger without a field.
    """
    missed = FIELD_EXCESS * min(field_px, LENS_MISFIT_PX)
    scales = math.hypot(sigma, missed) * np.array(_SCALES)
    counted = float(np.sum(other < CUT * scales[1]))
    most = ratio * _costs(other, scales) + counted * (missed / scales) ** 2
    median = math.hypot(ratio * float(np.median(other)), _MEDIAN_OF_SIGMA * missed)
    return bool(np.all(_costs(distance, scales) <= most) and np.median(distance) <= median)


def _costs(distance: FloatArray, scales: FloatArray) -> FloatArray:
    """Return the robust costs (s,) of distances (n,) at scales (s,), px."""
    return np.array([float(np.sum(tukey_loss(distance, sigma=float(scale)))) for scale in scales])


_COST_RATIO = 1.05
"""Robust cost and median residual over those of the fit alone that the type may cost it: priors and correlated noise
make it 1.04 (decision 0010). Few sightings are met too well by the fit alone: a right type costs half of each of the
17 parameters that it determines, and once in some thousand cases three times that much."""
_LARGE_FIELD = 5.0
"""Amplitude of the field over the noise from which on the field, not the noise, says how closely a lens is known: the
equations that have it integrated out are kept then."""
_COMING_DOWN = (30.0, 5.0, 1.0)
"""PriorScales of the robust loss, in sigmas: the lens of the type is some px off at first."""
_UNKNOWN_POSE = 1e-8
"""Prior precision of a rotation, rad⁻²: none that counts."""


class Conditioned(NamedTuple):
    """A lens given sightings and its type, in the type's frame, and how far it is from the type's mean."""

    lens: Gaussian
    departure: Departure


def apply_lens_prior(
    solved: Calibration, lens: LensType, *, points: Sightings, options: CalibrationOptions
) -> Calibration:
    """Return a fit of sightings with the prior of its type of lens.

    Refused where the sightings contradict the type; unchanged, with a finding, where the type makes an accepted fit
    meet its sightings worse.

    Parameters
    ----------
    solved : the fit of these sightings alone; the pose that it answers for is their last epoch's.
    lens : its type.
    points : the sightings.
    options : what makes the answer acceptable.
    """
    found = conditioned_lens(solved, lens)
    if found.departure.contradicts:
        return contradicted(solved, found.departure)
    seen = filter_sightings(points, site=solved.site, image_size=(solved.camera.width, solved.camera.height))
    used = ~np.isin(seen.index, [] if solved.left_out is None else solved.left_out)
    changed = moved_to_lens(solved, lens, found.lens, options)
    latest = used & (seen.epoch == seen.epoch.max(initial=0))
    field_px = solved.field.amplitude_px
    if solved.camera.displacement is None and field_px < _LARGE_FIELD * solved.evidence.sigma_px:
        field_px, changed = 0.0, _replace_camera(changed, _most_probable(changed, lens, seen, options))
    if solved.verdict.accepted and not _meets_as_well(changed.camera, solved, seen, latest, field_px):
        return add_finding(solved, lens_finding("lens_prior_left_out", lens))
    return _reassess(changed, lens, seen, latest, options)


def conditioned_lens(solved: Calibration, lens: LensType) -> Conditioned:
    """Return the lens of a fit with its type in the place of the fit's own prior."""
    frame, prior = lens.frame, lens.in_frame()
    posterior = lens_gaussian(solved, frame)
    known = sighting_information(posterior, solved.evidence.radial_px)
    inverse = np.linalg.inv(prior.covariance)
    covariance = np.linalg.inv(known.matrix + inverse)
    mean = covariance @ (known.vector + inverse @ prior.mean)
    departure = largest_departure(mean - prior.mean, prior.covariance, covariance, parts=LENS_PARTS)
    return Conditioned(Gaussian(mean, 0.5 * (covariance + covariance.T)), departure)


def moved_to_lens(solved: Calibration, lens: LensType, to: Gaussian, options: CalibrationOptions) -> Calibration:
    """Return a calibration whose lens is another one; pose and field follow by their regression on the lens.

    What the field's own errors lose by that is left as it was: they are stated a little too large.
    """
    frame, before = lens.frame, lens_gaussian(solved, lens.frame)
    from_frame = np.eye(FREE.size)
    from_frame[np.ix_(IN_FREE, IN_FREE)] = frame.basis
    covariance = np.linalg.solve(from_frame, np.linalg.solve(from_frame, solved.covariance).T)
    cross = np.linalg.solve(from_frame, solved.field.cross)
    by_lens = np.linalg.solve(before.covariance, covariance[IN_FREE]).T
    by_lens[IN_FREE] = np.eye(N_LENS)
    taken = before.covariance - to.covariance
    covariance = from_frame @ (covariance - by_lens @ taken @ by_lens.T) @ from_frame.T
    of_field = np.linalg.solve(before.covariance, cross[:, IN_FREE])
    vector = solved.camera.to_vector()
    vector[FREE] += from_frame @ by_lens @ (to.mean - before.mean)
    changed = replace(
        solved,
        covariance=0.5 * (covariance + covariance.T),
        field=replace(solved.field, cross=from_frame @ (cross - by_lens @ taken @ of_field)),
        mixture=None,
    )
    camera = tidied(solved.camera.replace_parameters(vector), options)
    if camera.displacement is not None:
        # the field's mean follows the lens, too
        basis = solved.field.basis
        shift = np.einsum("alm,l->am", of_field, to.mean - before.mean)
        camera = replace(camera, displacement=basis.displacement(basis.fit_coefficients(camera.displacement) + shift))
    return _replace_camera(changed, camera)


def _replace_camera(solved: Calibration, camera: Camera) -> Calibration:
    """Return a calibration of another camera, its uncertainty unchanged."""
    return replace(
        solved,
        camera=camera,
        poses=(*solved.poses[:-1], camera.rotation_cam_enu),
        pose=pose_angles(camera.rotation_cam_enu),
        backward=fit_backward(camera),
    )


def _most_probable(changed: Calibration, lens: LensType, seen: Sightings, options: CalibrationOptions) -> Camera:
    """Return the most probable camera of the latest epoch's sightings and the type, by the robust cost of both.

    The equations about the fit alone are too far off where it followed the noise of a short arc.
    """
    prior = lens.in_frame()
    in_units = LensPrior(
        mean=lens.frame.lens(prior.mean), basis=lens.frame.basis @ np.linalg.cholesky(prior.covariance)
    )
    observed = seen.select(seen.epoch == seen.epoch.max(initial=0))
    observed = replace(observed, epoch=np.zeros(len(observed), dtype=np.int64))
    problem = problem_for(changed.camera, in_units, n_epochs=1)
    precision = np.concatenate([np.ones(N_LENS), np.full(3, _UNKNOWN_POSE)])
    sigma = changed.evidence.sigma_px * math.sqrt(max(changed.evidence.inflation, 1.0))
    unknowns = problem.unknowns([changed.camera])
    for factor in _COMING_DOWN:
        unknowns = most_probable(problem, observed, unknowns, precision=precision, sigma=factor * sigma).unknowns
    return tidied(problem.camera(unknowns), options)


def _meets_as_well(camera: Camera, solved: Calibration, seen: Sightings, used: BoolArray, field_px: float) -> bool:
    """Return whether a camera meets the sightings that count about as well as the fit without the type does.

    `field_px` is what it may miss them by, since no lens model describes it.
    """
    alone, given = (
        np.linalg.norm(finite(seen.pixels - project_fast(one, seen.directions)), axis=-1)[used] / seen.sigma_px[used]
        for one in (solved.camera, camera)
    )
    n = max(int(used.sum()) / max(solved.evidence.inflation, 1.0), 1.0)
    ratio = _COST_RATIO + 1.5 * N_LENS / n
    return is_met_as_well(given, alone, sigma=solved.evidence.sigma_px, field_px=field_px, ratio=ratio)


def _reassess(
    changed: Calibration, lens: LensType, seen: Sightings, used: BoolArray, options: CalibrationOptions
) -> Calibration:
    """Return a calibration with the metrics and the verdict that its camera has."""
    latest = seen.epoch == seen.epoch.max(initial=0)
    residual = finite(seen.pixels - project_fast(changed.camera, seen.directions))[latest]
    angle = residual_angles(changed.camera, seen.pixels[latest], seen.directions[latest])
    rms, most = sky_sigma_deg(changed)
    metrics = fit_metrics(residual, used[latest], angle)
    result = replace(changed, metrics=metrics, sky_rms_deg=rms, sky_max_deg=most)
    result = state_options(result, lens_prior=lens.as_evidence())
    result = replace(result, verdict=fit_verdict(result, seen, options))
    return add_finding(result, lens_finding("lens_prior_used", lens))


def lens_finding(code: str, lens: LensType) -> Finding:
    """Return a finding that names the cameras of a type of lens."""
    return Finding(code, {"n": len(lens.cameras), "cameras": ", ".join(lens.cameras)})


def contradicted(solved: Calibration, found: Departure) -> Calibration:
    """Return a fit refused because its sightings contradict its type of lens."""
    finding = Finding("lens_prior_contradicted", {"part": found.part, "departure": found.rms, "limit": found.limit})
    return refused_for(solved, finding)
