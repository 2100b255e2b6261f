"""How much a camera turns to and fro from day to day, and what that does to how sure one is of it.

Heat bends masts and time lets them lean: the pose of a single day is not the mean one that a fit gives. What the days'
poses scatter beyond their own errors is allowed for in every direction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from sunarc.calibration.model.covariance import rotation_covariance, sky_sigma_deg
from sunarc.calibration.model.result import Calibration
from sunarc.optics.camera import POSE
from sunarc.robust_statistics import MAD_TO_SIGMA

_FEWEST = 5
"""Days that tell a spread."""


def pose_spread_deg(turns_deg: ArrayLike, sigmas_deg: ArrayLike) -> tuple[float, float, float]:
    """Return the spread of daily poses beyond their own errors, 1-sigma about east, north and up, degrees.

    Parameters
    ----------
    turns_deg : (n, 3) how the camera stood turned on each day.
    sigmas_deg : (n, 3) 1-sigma of each.

    Returns
    -------
    0 where fewer than five days are given, or their errors explain what they scatter.
    """
    turns = np.asarray(turns_deg, dtype=np.float64).reshape(-1, 3)
    if turns.shape[0] < _FEWEST:
        return 0.0, 0.0, 0.0
    sigma = MAD_TO_SIGMA * np.median(np.abs(turns - np.median(turns, axis=0)), axis=0)
    # days differ in how well they tell the pose: the usual one counts, as in the spread
    estimation_variance = np.median(np.asarray(sigmas_deg, dtype=np.float64).reshape(-1, 3) ** 2, axis=0)
    east, north, up = np.sqrt(np.maximum(sigma**2 - estimation_variance, 0.0)).tolist()
    return east, north, up


def with_pose_spread(calibration: Calibration, spread_deg: Sequence[float]) -> Calibration:
    """Return a calibration whose uncertainty allows for a daily spread of the pose, which its provenance states.

    Parameters
    ----------
    calibration : without any spread yet.
    spread_deg : 1-sigma about east, north and up, degrees.
    """
    if not np.any(np.asarray(spread_deg)):
        return calibration
    east, north, up = (float(value) for value in spread_deg)
    evidence = replace(calibration.evidence, pose_spread_deg=(east, north, up))
    return replace(_widened(calibration, 1.0, evidence.pose_spread_deg), evidence=evidence)


def fit_direction_sigma_rms_deg(calibration: Calibration) -> float:
    """Return the stated 1-sigma over the sky without what is allowed for the spread of daily poses, degrees."""
    spread = calibration.evidence.pose_spread_deg
    return calibration.sky_rms_deg if spread is None else _widened(calibration, -1.0, spread).sky_rms_deg


def _widened(calibration: Calibration, sign: float, spread_deg: Sequence[float] | None) -> Calibration:
    enu_covariance = np.diag(np.radians(np.asarray(spread_deg, dtype=np.float64)) ** 2)
    covariance = calibration.covariance.copy()
    covariance[POSE, POSE] += sign * rotation_covariance(calibration.camera, enu_covariance)
    widened = replace(calibration, covariance=covariance)
    rms, most = sky_sigma_deg(widened)
    return replace(widened, sky_rms_deg=rms, sky_max_deg=most)
