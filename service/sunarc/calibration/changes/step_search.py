"""Steps of the pose in a long record: daily poses tell where to look, fits of a few days whether and when.

A record of years costs one pose a day, and one search of a few days for every place where the daily poses jump.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve, cholesky

from sunarc.array_types import FloatArray, IntArray
from sunarc.calibration.answers.error_model import (
    CameraErrorModel,
    at_every_angle,
    error_model_of,
    joint_covariance,
    predicted,
)
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.changes.change_points import best_row, calibrate_moved
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle
from sunarc.calibration.model.result import Calibration, Move
from sunarc.calibration.model.sightings import Sightings, filter_sightings
from sunarc.calibration.pose import PredictedSightings, fit_pose, gathered, inflation, noise_px
from sunarc.calibration.robust_loss import finite
from sunarc.optics.camera import Camera
from sunarc.optics.pose import rotation_matrix
from sunarc.sky.site import Site

# By how much a camera stood turned on a day, against its calibration: the slow drift of masts and mounts.

_FEWEST = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseOffset:
    """A small turn of the camera against its calibration.

    Attributes
    ----------
    turn_deg : about the axes to the east, to the north and up, degrees, right-handed: positive about "up" turns the
        camera counter-clockwise as seen from above.
    sigma_deg : 1-sigma of each.
    n : sightings that it rests on.
    """

    turn_deg: tuple[float, float, float]
    sigma_deg: tuple[float, float, float]
    n: int


def daily_pose_offset(points: Sightings, *, calibration: Calibration, site: Site) -> PoseOffset | None:
    """Return the mean rotation of a camera on a day; None with fewer than 20 inliers.

    The lens is the calibration's; what that says of its own errors along the day's track widens the sigmas.

    Parameters
    ----------
    points : sightings of one day and one pose epoch.
    calibration : what they are compared with.
    site : where the camera stands.
    """
    usable = filter_sightings(points, site=site)
    if len(usable) < _FEWEST:
        return None
    sigma_px = noise_px(calibration, points.sigma_px[usable.index])
    inlier = fit_pose(calibration, usable.directions, usable.pixels, sigma_px).inlier
    if inlier.sum() < _FEWEST:
        return None
    sightings = PredictedSightings(
        directions=usable.directions,
        pixels=usable.pixels,
        variance=sigma_px**2,
        false_density=np.zeros(len(usable)),
    )
    camera = at_every_angle(calibration.camera)
    together = gathered(camera, sightings, inlier, inflation=inflation(calibration))
    rotation, covariance = _rotation(error_model_of(calibration), camera, together)
    to_enu = -rotation_matrix(camera.rotation_cam_enu).T  # a camera that turns one way sees the sky turn the other
    sigma = np.sqrt(np.diag(to_enu @ covariance @ to_enu.T))
    (east, north, up), (s_east, s_north, s_up) = np.degrees(to_enu @ rotation).tolist(), np.degrees(sigma).tolist()
    return PoseOffset(turn_deg=(east, north, up), sigma_deg=(s_east, s_north, s_up), n=int(inlier.sum()))


def _rotation(
    error_model: CameraErrorModel, camera: Camera, sightings: PredictedSightings
) -> tuple[FloatArray, FloatArray]:
    """Return the turn (3,) about the camera's axes by generalised least squares, and its covariance (3, 3)."""
    at = predicted(error_model, camera, sightings.directions)
    rows = at.rows[..., error_model.rotation].reshape(-1, 3)
    total = joint_covariance(error_model, at) + np.diag(np.repeat(sightings.variance, 2))
    weighed = cho_solve((cholesky(total, lower=True), True), rows)
    covariance = np.asarray(np.linalg.inv(rows.T @ weighed), dtype=np.float64)
    return covariance @ (weighed.T @ finite(sightings.pixels - at.pixels).ravel()), covariance


_PER_DAY = 150
"""Sightings of a day that the search looks at; the step itself is dated among all."""
_FEWEST_PER_DAY = 20
_LENS_DAYS = 3
_LENS_TRIALS = 4
"""Places of the record that a lens is sought at where none is known: a step may lie in any of them."""
_BESIDE = 3
"""Days on either side whose median pose is compared, and which are fitted where it jumps."""
_SMALLEST_DEG = 0.03
"""Difference of daily poses that is looked at; mounts wander by about a third of it."""
_JUMP_RATIO = 4.0
"""Difference that is looked at, in that of usual days: masts that lean and a lens known from other seasons drift."""
_MOST = 24
"""Places that are looked at in one search; the largest differences come first."""


class PoseStep(NamedTuple):
    """A turn of the camera: between which sightings (seconds since 1970-01-01 UTC), and by which angle, degrees."""

    before_unix_s: float
    after_unix_s: float
    turn_deg: float


class _Daily(NamedTuple):
    """Poses of days against one calibration: (d,) solar days since 1970, (d, 3) turns, degrees."""

    day: IntArray
    turn_deg: FloatArray


def find_pose_steps(
    points: Sightings,
    *,
    site: Site,
    image_size: tuple[int, int],
    options: CalibrationOptions | None = None,
    circle: ImageCircle | None = None,
    lens: Calibration | None = None,
) -> tuple[PoseStep, ...]:
    """Return the steps of the pose within the epochs of a record, in the order of time.

    Parameters
    ----------
    points, site, image_size, options, circle : as `calibrate` takes them; epochs are searched one by one.
    lens : a calibration of the same lens; sought in the record where None.

    Returns
    -------
    None are found by the paper's method, or where no lens fits any few days.
    """
    effective = CalibrationOptions() if options is None else options
    if effective.method != "robust":
        return ()
    search = _StepSearch(site=site, image_size=image_size, options=effective, circle=circle)
    steps: list[PoseStep] = []
    for epoch in np.unique(points.epoch).tolist():
        in_epoch = points.select(points.epoch == epoch)
        steps += search.steps(replace(in_epoch, epoch=np.zeros(len(in_epoch), dtype=np.int64)), lens)
    return tuple(sorted(steps))


class _StepSearch(NamedTuple):
    site: Site
    image_size: tuple[int, int]
    options: CalibrationOptions
    circle: ImageCircle | None

    def steps(self, points: Sightings, lens: Calibration | None) -> list[PoseStep]:
        """Return the steps within one epoch."""
        thin, day = _thinned(points, self.site)
        days = np.unique(day)
        if days.size <= 2 * _BESIDE:
            spans = [(days[0], days[-1])] if days.size else []
        else:
            fitted_lens = self._lens(thin, day, days) if lens is None else lens
            spans = [] if fitted_lens is None else _spans(self._daily(thin, day, fitted_lens))
        found: list[PoseStep] = []
        for first, last in spans:
            found += self._verified(points, thin.select((day >= first) & (day <= last)))
        return _distinct(found)

    def _lens(self, thin: Sightings, day: IntArray, days: IntArray) -> Calibration | None:
        """Return the fit of a few days that scatters least; a step within them makes it scatter."""
        fits = []
        for begin in np.unique(np.linspace(0, days.size - _LENS_DAYS, _LENS_TRIALS).astype(int)):
            some = thin.select(np.isin(day, days[begin : begin + _LENS_DAYS]))
            solved = calibrate(
                some,
                site=self.site,
                image_size=self.image_size,
                options=self.options,
                circle=self.circle,
                parts=False,
            )
            if solved.verdict.accepted:
                fits.append((solved.metrics.rmse_px, solved.evidence.n_rejected, solved))
        return min(fits, key=lambda item: item[:2])[2] if fits else None

    def _daily(self, thin: Sightings, day: IntArray, lens: Calibration) -> _Daily:
        days, rotations = [], []
        for one in np.unique(day):
            offset = daily_pose_offset(thin.select(day == one), calibration=lens, site=self.site)
            if offset is not None:
                days.append(int(one))
                rotations.append(offset.turn_deg)
        return _Daily(np.array(days, dtype=np.int64), np.array(rotations, dtype=np.float64).reshape(-1, 3))

    def _verified(self, points: Sightings, some: Sightings) -> list[PoseStep]:
        """Return the steps that a fit of a few days finds, dated among all sightings."""
        solved, _ = calibrate_moved(
            some, site=self.site, image_size=self.image_size, options=self.options, circle=self.circle, parts=False
        )
        moves = solved.evidence.moves
        poses = [*(move.pose_before for move in moves), solved.camera.rotation_cam_enu]
        return [
            self._dated(move, points, replace(solved, poses=(poses[number], poses[number + 1])))
            for number, move in enumerate(moves)
        ]

    def _dated(self, move: Move, points: Sightings, solved: Calibration) -> PoseStep:
        """Return the step between the sightings of the whole record that it came between."""
        near = (points.unix_s >= move.before_unix_s) & (points.unix_s <= move.after_unix_s)
        usable = filter_sightings(points.select(near), site=self.site)
        cameras = [replace(solved.camera, rotation_cam_enu=pose) for pose in solved.poses]
        row = min(max(best_row(slice(0, len(usable)), usable, cameras), 1), len(usable) - 1)
        return PoseStep(float(usable.unix_s[row - 1]), float(usable.unix_s[row]), move.turn_deg)


def _thinned(points: Sightings, site: Site) -> tuple[Sightings, IntArray]:
    """Return some of each day's usable sightings, in the order of time, and the solar day of each."""
    usable = filter_sightings(points, site=site)
    retained = []
    for day in np.unique(usable.day):
        rows = np.flatnonzero(usable.day == day)
        if rows.size >= _FEWEST_PER_DAY:
            retained.append(rows[:: -(-rows.size // _PER_DAY)])
    rows = np.concatenate(retained) if retained else np.zeros(0, dtype=np.int64)
    return points.select(usable.index[rows]), usable.day[rows]


def _spans(daily: _Daily) -> list[tuple[int, int]]:
    """Return the first and last day about each jump of the daily poses, the largest jumps first."""
    size = np.array([_jump(daily.turn_deg, row) for row in range(1, daily.day.size)])
    if size.size == 0:
        return []
    threshold = max(_SMALLEST_DEG, _JUMP_RATIO * float(np.median(size)))
    found: list[tuple[int, int]] = []
    while len(found) < _MOST and size.max() > threshold:
        row = int(np.argmax(size)) + 1
        first, last = max(row - _BESIDE, 0), min(row + _BESIDE, daily.day.size) - 1
        found.append((int(daily.day[first]), int(daily.day[last])))
        size[max(row - 1 - _BESIDE + 1, 0) : row + _BESIDE - 1] = 0.0
    return found


def _jump(turn_deg: FloatArray, row: int) -> float:
    """Return the angle between the median poses of the days before and from a day on, degrees."""
    before = np.median(turn_deg[max(row - _BESIDE, 0) : row], axis=0)
    after = np.median(turn_deg[row : row + _BESIDE], axis=0)
    return float(np.linalg.norm(after - before))


def _distinct(steps: list[PoseStep]) -> list[PoseStep]:
    """Return the steps without those that overlap one found in another place."""
    retained: list[PoseStep] = []
    for step in sorted(steps):
        if not retained or step.before_unix_s >= retained[-1].after_unix_s:
            retained.append(step)
    return retained
