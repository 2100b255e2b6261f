"""What widens the stated uncertainty of a fit: a pose that differs from day to day, contradictions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from sunarc.array_types import FloatArray
from sunarc.calibration.answers.covariance import rotation_covariance, sky_sigma_deg, with_covariance
from sunarc.calibration.model.result import Calibration
from sunarc.optics.camera import POSE


def with_pose_spread(calibration: Calibration, spread_deg: Sequence[float]) -> Calibration:
    """Return a calibration whose uncertainty allows for a daily spread of the pose, which its provenance states.

    Parameters
    ----------
    calibration : a spread that it allows for already counts where it is the larger one.
    spread_deg : 1-sigma about east, north and up, degrees.
    """
    before = np.array(calibration.evidence.pose_spread_deg or (0.0, 0.0, 0.0))
    larger = np.maximum(before, spread_deg)
    if np.array_equal(larger, before):
        return calibration
    east, north, up = larger.tolist()
    evidence = replace(calibration.evidence, pose_spread_deg=(east, north, up))
    return replace(_widened(calibration, 1.0, np.sqrt(larger**2 - before**2)), evidence=evidence)


def with_larger_errors(calibration: Calibration, factor: float) -> Calibration:
    """Return a calibration whose stated errors are larger by a factor, which its provenance states."""
    held_out = {
        **calibration.evidence.held_out,
        "widening": factor * calibration.evidence.held_out.get("widening", 1.0),
    }
    return replace(
        calibration,
        covariance=factor**2 * calibration.covariance,
        field=calibration.field.widened(factor),
        sky_rms_deg=factor * calibration.sky_rms_deg,
        sky_max_deg=factor * calibration.sky_max_deg,
        evidence=replace(calibration.evidence, held_out=held_out),
    )


def fit_direction_sigma_rms_deg(calibration: Calibration) -> float:
    """Return the stated 1-sigma over the sky without what is allowed for the spread of daily poses, degrees."""
    spread = calibration.evidence.pose_spread_deg
    return calibration.sky_rms_deg if spread is None else _widened(calibration, -1.0, spread).sky_rms_deg


def _widened(calibration: Calibration, sign: float, spread_deg: ArrayLike) -> Calibration:
    enu_covariance = np.diag(np.radians(np.asarray(spread_deg, dtype=np.float64)) ** 2)
    return with_pose_errors(calibration, sign * rotation_covariance(calibration.camera, enu_covariance))


def with_pose_errors(calibration: Calibration, more: FloatArray) -> Calibration:
    """Return a calibration whose pose has more covariance (3, 3), with its 1-sigma over the sky."""
    covariance = calibration.covariance.copy()
    covariance[POSE, POSE] += more
    widened = with_covariance(calibration, covariance)
    rms, most = sky_sigma_deg(widened)
    return replace(widened, sky_rms_deg=rms, sky_max_deg=most)
