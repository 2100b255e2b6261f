"""Rotations of a camera on each day against one calibration, and their steps and drifts.

Made for the comparison of days and cameras: a day's rotation says nothing of the calibration's own error, which is the
same on all days, and costs a hundredth of `daily_pose_offset`, which does.

A component's model is a constant, one change, a random walk and white noise in the ratio of the stated variances. The
walk takes what drifts, as a lens whose error changes with the sun's declination. A change has to beat that model with a
walk of its own best size, so that the faster a camera drifts the larger a change must be. A change is a step, or a
turn that goes on for days, as that of a mast that settles.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from sunarc.calibration.answers.error_model import (
    CameraErrorModel,
    build_error_model,
    joint_covariance,
    predicted,
)
from sunarc.calibration.evidence import DAYS, whitened
from sunarc.calibration.model.pose_change import PoseChange, progress
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings, filter_sightings
from sunarc.calibration.pose import assign_noise, fit_pose, gathered, variance_inflation
from sunarc.common.array_types import BoolArray, FloatArray, IntArray, picked
from sunarc.common.robust_statistics import MAD_TO_SIGMA, biweights, finite
from sunarc.optics.camera import Camera
from sunarc.optics.pose import rotation_matrix
from sunarc.sky.days import solar_days
from sunarc.sky.site import Site

FEWEST = 20
"""Sightings of a day that show a rotation: as many as a day's pose offset takes."""
_ROUNDS, _CUT = 8, 5.0
_MEDIAN_DISTANCE = 1.1774
"""Median of a two-dimensional distance over its 1-sigma per axis, (2 ln 2)^½."""
_LEAST_SIGMA = 1e-7
"""Radians; a smaller scatter, a ten-thousandth of a pixel, is that of made-up numbers."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DailyRotations:
    """Rotations of a camera on the days that show the sun, against one calibration.

    Attributes
    ----------
    day : (n,) numbers of days, rising.
    rotation_deg : (n, 3) about east, north and up, right-handed, degrees: positive about "up" turns the camera
        counter-clockwise as seen from above.
    covariance_deg2 : (n, 3, 3) by the scatter of the day's sightings.
    """

    day: FloatArray
    rotation_deg: FloatArray
    covariance_deg2: FloatArray

    @classmethod
    def empty(cls) -> DailyRotations:
        """Return the rotations of no day."""
        return cls(day=np.zeros(0), rotation_deg=np.zeros((0, 3)), covariance_deg2=np.zeros((0, 3, 3)))


def daily_rotations(day: FloatArray, *, observed: FloatArray, expected: FloatArray) -> DailyRotations:
    """Return the rotation of each day with at least 20 sightings that agree.

    Parameters
    ----------
    day : (n,) number of the day of each sighting.
    observed : (n, 3) directions by the calibration's camera, unit vectors east-north-up; NaN where it sees none.
    expected : (n, 3) directions of the sun.
    """
    days, found = [], []
    known = np.isfinite(observed).all(axis=-1) & np.isfinite(expected).all(axis=-1)
    for one in np.unique(day[known]).tolist():
        of_day = known & (day == one)
        rotation = _fit_rotation(observed[of_day], expected[of_day])
        if rotation is not None:
            days.append(one)
            found.append(rotation)
    return DailyRotations(
        day=np.array(days),
        rotation_deg=np.array([rotation for rotation, _ in found]).reshape(-1, 3),
        covariance_deg2=np.array([covariance for _, covariance in found]).reshape(-1, 3, 3),
    )


def _fit_rotation(observed: FloatArray, expected: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return the rotation (3,) that takes `observed` to `expected`, degrees, and its covariance; None of too few.

    Wahba's problem with Tukey's weights, again and again.
    """
    weight = np.ones(len(observed))
    for _ in range(_ROUNDS):
        if np.count_nonzero(weight) < FEWEST:
            return None
        from scipy.spatial.transform import Rotation  # noqa: PLC0415 - a fit of one day loads without scipy

        rotation = Rotation.align_vectors(expected, observed, weights=weight)[0]
        distance = np.linalg.norm(expected - rotation.apply(observed), axis=-1)
        scale = max(float(np.median(distance)) / _MEDIAN_DISTANCE, _LEAST_SIGMA)
        weight = biweights(np.minimum(distance / (_CUT * scale), 1.0))
    variance = max(float(weight @ distance**2 / (2.0 * weight.sum())), _LEAST_SIGMA**2)
    # a small rotation w moves a direction d by w x d, which is (1 - d d^T) of w in size
    information = np.einsum("n,nij->ij", weight, np.eye(3) - expected[:, :, None] * expected[:, None, :]) / variance
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    return np.asarray(rotation.as_rotvec(degrees=True)), np.degrees(np.degrees(covariance))


_WALK = (0.0, 0.003, 0.03, 0.3, 3.0)
"""Variance of the walk in a day over that of a day's rotation, tried each: from none to nothing but a walk."""
_FEWEST_BEFORE, _FEWEST_AFTER = 8, 4
"""Days: a scatter needs some before, and three days of cloud's making are not a step."""
_SETTLING_DAYS = (3.0, 6.0, 12.0, 25.0, np.inf)
"""Time constants of slow turns, tried each: from a step of few days to the length of the compared record;
so near one another that what is left of a turn is not taken for its neighbours'. Infinite: at one rate."""
_NEAR, _OUTLYING = 5, 4.0
"""A day that is further than so many scatters from the median of so many days about it is moved to that limit."""
_WINDOW, _HOP = 30, 15
"""Days of a long record that are compared at once, and from one such window to the next."""


def find_change(days: DailyRotations) -> tuple[PoseChange, bool] | None:
    """Return the step that explains a camera's daily rotations best; None where none does so clearly.

    Where no step does, but a slow turn, that is returned; or a step of the last days, and that it has too few days yet:
    it may be one of cloud, and would pass for a turn that began before it.

    Parameters
    ----------
    days : of at most some 60 days, without what is common to the neighbours.
    """
    n = len(days.day)
    if n < _FEWEST_BEFORE + _FEWEST_AFTER:
        return None
    tried = _list_tried_changes(days.day)
    axes, fits = _fit_changes(days, tried.progress)
    gain = np.sum([fit.gain for fit in fits], axis=0)

    def change(of_kind: BoolArray) -> PoseChange:
        best = int(np.argmax(np.where(of_kind, gain, -np.inf)))
        first, settling = int(tried.first[best]), float(tried.settling_days[best])
        day = float(days.day[first])
        return PoseChange(
            time=day,
            bracket=(float(days.day[first - 1]), day) if settling == 0.0 else (day, float(days.day[-1])),
            settling=settling,
            cause="moved" if settling == 0.0 else "slow_turn",
            **_make_size_fields(axes, fits, best),
        )

    is_step = tried.settling_days == 0.0
    recent = is_step & (tried.first > n - _FEWEST_AFTER)
    step, turn, newest = change(is_step & ~recent), change(~is_step), change(recent)
    if newest.gain > max(DAYS.gain, step.gain, turn.gain):
        return newest, True
    if step.gain >= DAYS.gain:
        return replace(step, slower=turn), False
    return (turn, False) if turn.gain >= DAYS.gain else None


def as_shown(days: DailyRotations, change: PoseChange) -> PoseChange | None:
    """Return a change found elsewhere, with size and gain measured on these days; None where they are too few."""
    n_before = int(np.searchsorted(days.day, change.time))
    if min(n_before, len(days.day) - n_before) < _FEWEST_AFTER:
        return None
    axes, fits = _fit_changes(days, change.progress(days.day)[:, None])
    return replace(change, **_make_size_fields(axes, fits, 0), slower=None)


def step_gains(days: DailyRotations) -> FloatArray:
    """Return (n,): by how many powers of e a step just before each day explains the days about it better than none.

    Parameters
    ----------
    days : any number of them; at most 30 are compared at once.
    """
    n = len(days.day)
    gains = np.full(n, -np.inf)
    for begin in range(0, max(n - _WINDOW, 0) + _HOP, _HOP):
        first = min(begin, max(n - _WINDOW, 0))
        some = picked(days, slice(first, first + _WINDOW))
        if len(some.day) > _FEWEST_AFTER:
            steps = np.asarray(some.day[:, None] >= some.day[1:], dtype=np.float64)
            gain = np.sum([fit.gain for fit in _fit_changes(some, steps)[1]], axis=0)
            rows = slice(first + 1, first + len(some.day))
            gains[rows] = np.maximum(gains[rows], gain)
    return gains


class _TriedChanges(NamedTuple):
    """Changes to be tried: first day and time constant of each, and their progress (n, c)."""

    first: IntArray
    settling_days: FloatArray
    progress: FloatArray


def _list_tried_changes(day: FloatArray) -> _TriedChanges:
    """Return the changes to be tried: steps, and slow turns that begin on every second day."""
    n = len(day)
    steps = [(first, 0.0) for first in range(_FEWEST_BEFORE, n)]
    turns = [(first, tau) for tau in _SETTLING_DAYS for first in range(0, n - _FEWEST_AFTER + 1, 2)]
    first, settling = (np.array(column) for column in zip(*steps, *turns, strict=True))
    shares = [progress(day, float(day[k]), float(day[-1]), tau) for k, tau in (*steps, *turns)]
    return _TriedChanges(first, settling, np.array(shares).T)


class _Fits(NamedTuple):
    """Gain of each tried change, its size and variance."""

    gain: FloatArray
    size: FloatArray
    variance: FloatArray


def _fit_changes(days: DailyRotations, progress: FloatArray) -> tuple[FloatArray, list[_Fits]]:
    """Return the principal axes (3, 3) of the stated covariance, about which components err alone, and their fits."""
    axes = np.linalg.eigh(days.covariance_deg2.mean(axis=0))[1]
    rotations = _limit_outlying_days(days.rotation_deg @ axes)
    variances = np.einsum("ij,nik,kj->nj", axes, days.covariance_deg2, axes)
    return axes, [_fit_component(days.day, rotations[:, j], variances[:, j], progress) for j in range(3)]


def _fit_component(day: FloatArray, rotation: FloatArray, variance: FloatArray, progress: FloatArray) -> _Fits:
    """Return the gain of each change, by generalised least squares for each size of walk."""
    n = len(day)
    walk = np.minimum.outer(day - day[0], day - day[0])
    none, changed, sizes, spreads = [], [], [], []
    for ratio in _WALK:
        covariance = np.diag(variance) + ratio * variance.mean() * walk
        white, half_log = whitened(covariance, np.column_stack([np.ones(n), rotation, progress]))
        constant = white[:, 0] / np.linalg.norm(white[:, 0])
        white = white[:, 1:] - constant[:, None] * (constant @ white[:, 1:])
        values, shape = white[:, 0], white[:, 1:]
        information = np.sum(shape**2, axis=0)
        size = shape.T @ values / information
        left = max(float(values @ values), 1e-12)  # rotations without any scatter are none of a camera
        remaining = np.maximum(left - size**2 * information, 1e-12 * left)
        none.append(-half_log - 0.5 * n * np.log(left))
        changed.append(-half_log - 0.5 * n * np.log(remaining))
        sizes.append(size)
        spreads.append(remaining / (n - 2.0) / information)
    likelihood = np.array(changed)
    best = np.argmax(likelihood, axis=0)
    column = np.arange(progress.shape[1])
    gain = likelihood[best, column] - max(none)
    return _Fits(gain, np.array(sizes)[best, column], np.array(spreads)[best, column])


def _make_size_fields(axes: FloatArray, fits: list[_Fits], number: int) -> dict[str, Any]:
    """Return size, covariance and gain of one of the changes that were fitted, by name."""
    return {
        "rotation_deg": axes @ np.array([fit.size[number] for fit in fits]),
        "covariance_deg2": axes @ np.diag([fit.variance[number] for fit in fits]) @ axes.T,
        "gain": float(sum(fit.gain[number] for fit in fits)),
    }


def _limit_outlying_days(rotations: FloatArray) -> FloatArray:
    """Return (n, 3) with single days that stand off from those about them moved near; a step stays as it is."""
    half = _NEAR // 2
    padded = np.pad(rotations, ((half, half), (0, 0)), mode="edge")
    near = np.lib.stride_tricks.sliding_window_view(padded, _NEAR, axis=0)
    middle = np.asarray(np.median(near, axis=-1), dtype=np.float64)
    off = rotations - middle
    limit = _OUTLYING * MAD_TO_SIGMA * np.asarray(np.median(np.abs(off), axis=0), dtype=np.float64)
    return np.asarray(middle + np.clip(off, -limit, limit))


# The same with what the calibration states of its own errors.


def daily_pose_offset(points: Sightings, *, calibration: Calibration, site: Site) -> DailyRotations | None:
    """Return the mean rotation of a camera on one day; None with fewer than 20 inliers.

    The lens is the calibration's; its own errors along the day's track widen the sigmas.

    Parameters
    ----------
    points : sightings of one day and one pose epoch.
    calibration : what they are compared with.
    site : where the camera stands.
    """
    usable = filter_sightings(points, site=site)
    if len(usable) < FEWEST:
        return None
    sightings = assign_noise(usable, points, calibration)
    inlier = fit_pose(calibration, sightings).inlier
    if inlier.sum() < FEWEST:
        return None
    camera = calibration.camera.at_every_angle()
    together = gathered(camera, sightings, inlier, inflation=variance_inflation(calibration))
    rotation, covariance = _gls_rotation(build_error_model(calibration), camera, together)
    to_enu = -rotation_matrix(camera.rotation_cam_enu).T  # a camera that turns one way sees the sky turn the other
    day = solar_days(usable.unix_s[:1], longitude=site.longitude).astype(np.float64)
    rotation_deg = np.degrees(to_enu @ rotation)[None]
    return DailyRotations(
        day=day, rotation_deg=rotation_deg, covariance_deg2=np.degrees(np.degrees(to_enu @ covariance @ to_enu.T))[None]
    )


def _gls_rotation(error_model: CameraErrorModel, camera: Camera, sightings: Sightings) -> tuple[FloatArray, FloatArray]:
    """Return the turn (3,) about the camera's axes by generalised least squares, and its covariance (3, 3)."""
    at = predicted(error_model, camera, sightings.directions)
    rows = at.rows[..., error_model.rotation].reshape(-1, 3)
    total = joint_covariance(error_model, at) + np.diag(np.repeat(sightings.variance, 2))
    from scipy.linalg import cho_solve, cholesky  # noqa: PLC0415 - a fit of one day loads without scipy

    weighed = cho_solve((cholesky(total, lower=True), True), rows)
    covariance = np.asarray(np.linalg.inv(rows.T @ weighed), dtype=np.float64)
    return covariance @ (weighed.T @ finite(sightings.pixels - at.pixels).ravel()), covariance
