"""Cameras that turn steadily through an epoch: their lens, their pose at one time, and the rate of the turn."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sunarc.archives.states import ArchiveCamera
from sunarc.calibration.answers.covariance import rotation_covariance
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.pose_change import PoseChange, SteadyTurn
from sunarc.calibration.model.result import Calibration, add_finding
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.quality.widening import add_pose_errors
from sunarc.calibration.selection import select_sightings
from sunarc.changes.epoch_changes import N_TURN, change_within, drift_finding, drift_within
from sunarc.common.array_types import FloatArray, IntArray
from sunarc.common.findings import Finding
from sunarc.common.robust_statistics import finite
from sunarc.common.utc import DAY_S, rfc3339, utc_time
from sunarc.optics.camera import FOCAL_LENGTH, RADIAL_ORDERS, Camera, Param
from sunarc.optics.forward import project_fast
from sunarc.sky.sun import sun_directions

_ROUNDS = 4
_SETTLED_DEG = 0.005
"""Turn over the whole epoch that another round may add."""
_LEFT = 3.0
"""Powers of e by which sightings without the steady turn may still show a drift: of one that is not steady."""
_FEWEST_DAYS = 5.0
"""Length of an epoch from which a turn is one of the mount: of less, a bump or the day's warmth is another reason."""
_GROSS_SIGMAS = 3.0
"""Residual, in its noise, from which a sighting counts less in the search for the turn."""
_PLAIN = [*range(Param.PRINCIPAL_POINT_X_PX, Param.TRANSLATION_X), *range(Param.K2, Param.K6)]
"""Parameters of a lens that a turn is sought with, and the focal length: too few to follow the sun's declination."""
_STEPS = np.array([*[0.1] * N_TURN, *[1.0] * 2, *[0.01] * N_TURN, *[0.01] * 4, 0.01])
"""Scales of the turn, degrees, of these parameters, and of the focal length as a share."""


class Leaning(NamedTuple):
    """Calibration of a camera that turns, the rows that it was fitted to, and the epoch's pixels as at its time."""

    calibration: Calibration
    rows: IntArray
    pixels: FloatArray


def seen_directions(calibration: Calibration, directions: FloatArray, unix_s: FloatArray) -> FloatArray:
    """Return where the camera sees directions (n, 3) at times (n,), by the pose of its stated time where it turns."""
    turning = calibration.evidence.turning
    return directions if turning is None else turning.as_seen(directions, unix_s)


def leaning_fit(
    seen: Sightings, camera: ArchiveCamera, noise_px: FloatArray, drift: PoseChange, near: Camera
) -> Leaning | None:
    """Return the camera of an epoch through which it turned steadily; None where no steady turn explains it.

    The sightings are fitted as the camera of the middle of the epoch would have had them; what drift is left about the
    fit is added to the turn, since the lens of a fit without a turn is bent by it.

    Parameters
    ----------
    seen : sightings of the sun in the order of time, at the times of a right clock.
    camera : see there.
    noise_px : (n,) see `estimate_daily_noise`.
    drift, near : the drift that they show about a camera.
    """
    days = (drift.bracket[1] - drift.bracket[0]) / DAY_S
    if days < _FEWEST_DAYS:
        return None
    sigma_deg = np.sqrt(np.diag(drift.covariance_deg2))
    turn_deg, near = _turn_with_lens(seen, camera, noise_px, drift, near)
    for _ in range(_ROUNDS):
        turning = _turning(drift, turn_deg, sigma_deg)
        upright = _stand_upright(seen, turning, near, camera)
        selection = select_sightings(upright, site=camera.site, slot_s=1.0)
        quick = _fit(upright.select(selection.index), camera, near=near)
        if quick.evidence.n_used == 0:
            return None
        left, near = drift_within(upright, quick.camera, camera.site, noise_px), quick.camera
        if left is None or float(np.linalg.norm(left.rotation_deg)) < _SETTLED_DEG:
            break
        turn_deg, sigma_deg = turn_deg + left.rotation_deg, np.sqrt(np.diag(left.covariance_deg2))
    solved = _fit(upright.select(selection.index), camera)
    left = drift_within(upright, solved.camera, camera.site, noise_px)
    if left is None or not solved.verdict.accepted or left.gain > _LEFT or drift_finding(left) is not None:
        return None
    if change_within(upright, solved.camera, camera.site, noise_px) is not None:
        return None
    stated = _add_turn(solved, turning, days)
    return Leaning(
        replace(stated, evidence=replace(stated.evidence, selection=selection.counts())),
        selection.index,
        upright.pixels,
    )


def _turn_with_lens(
    seen: Sightings, camera: ArchiveCamera, noise_px: FloatArray, drift: PoseChange, near: Camera
) -> tuple[FloatArray, Camera]:
    """Return the turn (3,) from the first to the last sighting, degrees, and a plain lens that fits best with it.

    The lens is not that of a fit without a turn: the sun's declination changes meanwhile, so that a flexible
    one takes up most of the turn.
    """
    from scipy.optimize import least_squares  # noqa: PLC0415 - an archive that stands still does without it

    directions = sun_directions(seen.unix_s, camera.site)
    begun = replace(near.lens_alone(), radial=(0.0,) * len(RADIAL_ORDERS), decentering=(0.0,) * 4)
    vector = begun.to_vector()

    def camera_at(free: FloatArray) -> Camera:
        moved = vector.copy()
        moved[_PLAIN] += free[N_TURN:-1]
        moved[FOCAL_LENGTH] *= math.exp(free[-1])
        return begun.replace_parameters(moved)

    def misfit(free: FloatArray) -> FloatArray:
        turning = _turning(drift, free[:N_TURN], np.zeros(N_TURN))
        predicted = project_fast(camera_at(free), turning.as_seen(directions, seen.unix_s))
        return np.asarray((finite(seen.pixels - predicted) / noise_px[:, None]).ravel())

    free = np.concatenate([drift.rotation_deg, np.zeros(len(_PLAIN) + 1)])
    free = least_squares(misfit, free, loss="soft_l1", f_scale=_GROSS_SIGMAS, x_scale=_STEPS).x
    return free[:N_TURN], camera_at(free)


def _turning(drift: PoseChange, turn_deg: FloatArray, sigma_deg: FloatArray) -> SteadyTurn:
    """Return a turn of some degrees from the first to the last of a drift's sightings; its pose is of the middle."""
    begin, end = drift.bracket
    days = (end - begin) / DAY_S
    (east, north, up), (s_east, s_north, s_up) = (turn_deg / days).tolist(), (sigma_deg / days).tolist()
    return SteadyTurn(
        at_unix_s=0.5 * (begin + end), deg_per_day=(east, north, up), sigma_deg_per_day=(s_east, s_north, s_up)
    )


def _stand_upright(seen: Sightings, turning: SteadyTurn, near: Camera, camera: ArchiveCamera) -> Sightings:
    """Return sightings as the camera would have had them without a turn, of one epoch."""
    directions = sun_directions(seen.unix_s, camera.site)
    shift = project_fast(near, directions) - project_fast(near, turning.as_seen(directions, seen.unix_s))
    pixels = np.asarray(seen.pixels + np.where(np.isfinite(shift), shift, 0.0))
    return replace(seen, pixels=pixels, epoch=np.zeros(len(seen), dtype=np.int64))


def _fit(points: Sightings, camera: ArchiveCamera, near: Camera | None = None) -> Calibration:
    """Return the camera of sightings; with a camera near it, one of its projection and hand, without tests of parts."""
    options = camera.options
    if near is not None:
        options = replace(options, projection=near.projection, mirrored="yes" if near.mirrored else "no")
    return calibrate(
        points,
        site=camera.site,
        image_size=camera.size,
        options=options,
        circle=camera.circle,
        start=near,
        parts=near is None,
        tilt_known=True,
    )


def _add_turn(solved: Calibration, turning: SteadyTurn, days: float) -> Calibration:
    """Return a calibration that states its turn, with the error of the rate through the epoch in its pose."""
    # root mean square of the time from the middle
    spread = np.radians(np.array(turning.sigma_deg_per_day) * days / math.sqrt(12.0))
    wider = add_pose_errors(solved, rotation_covariance(solved.camera, np.diag(spread**2)))
    rate = float(np.linalg.norm(turning.deg_per_day))
    finding = Finding(
        "mount_leans",
        {
            "deg_per_day": rate,
            "turn_deg": rate * days,
            "days": days,
            "time": rfc3339(utc_time(turning.at_unix_s), timespec="seconds"),
        },
    )
    return add_finding(replace(wider, evidence=replace(wider.evidence, turning=turning)), finding)
