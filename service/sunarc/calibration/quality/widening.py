"""What widens the stated uncertainty of a fit: a pose that differs from day to day, contradictions, a clock's error."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from sunarc.array_types import FloatArray
from sunarc.calibration.answers.covariance import pose_error, rotation_covariance, sky_sigma_deg, with_covariance
from sunarc.calibration.model.result import Calibration, refused_for, with_finding
from sunarc.findings import Finding
from sunarc.optics.camera import POSE
from sunarc.sky.site import EARTH_RATE


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


def with_clock_error(calibration: Calibration, clock_error_s: float, *, limit_deg: float) -> Calibration:
    """Return a calibration by stars alone whose uncertainty holds an error of the clock, which its verdict states.

    A clock that is wrong turns the sky about the pole, and the fit the camera: nothing in images tells the two apart.
    One that is then less sure than a limit is refused.

    Parameters
    ----------
    calibration : by sightings without any error of the clock.
    clock_error_s : the bound of the clock's error, s.
    limit_deg : of the 1-sigma over the sky, degrees.
    """
    camera, site = calibration.camera, calibration.site
    wider = _with_pose_errors(calibration, pose_error(camera, site, clock_error_s=clock_error_s, site_error_m=0.0))
    latitude, turn = math.radians(site.latitude), math.degrees(EARTH_RATE * clock_error_s)
    turns = {"turn_deg": turn, "north_deg": turn * abs(math.sin(latitude)), "tilt_deg": turn * math.cos(latitude)}
    wider = replace(wider, evidence=replace(wider.evidence, clock_error_s=clock_error_s))
    clock = Finding("pose_or_clock", {"clock_error_s": clock_error_s, **turns})
    if wider.sky_rms_deg <= limit_deg or not wider.verdict.accepted:
        return with_finding(wider, clock)
    of_sigma = {"sigma_deg": wider.sky_rms_deg, "limit_deg": limit_deg, "scatter_px": wider.evidence.sigma_px}
    counts = {"n": wider.metrics.n, "days": len(wider.evidence.days)}
    return refused_for(wider, Finding("direction_sigma_too_large", {**of_sigma, **counts}), clock)


def fit_direction_sigma_rms_deg(calibration: Calibration) -> float:
    """Return the stated 1-sigma over the sky without what is allowed for the spread of daily poses, degrees."""
    spread = calibration.evidence.pose_spread_deg
    return calibration.sky_rms_deg if spread is None else _widened(calibration, -1.0, spread).sky_rms_deg


def _widened(calibration: Calibration, sign: float, spread_deg: ArrayLike) -> Calibration:
    enu_covariance = np.diag(np.radians(np.asarray(spread_deg, dtype=np.float64)) ** 2)
    return _with_pose_errors(calibration, sign * rotation_covariance(calibration.camera, enu_covariance))


def _with_pose_errors(calibration: Calibration, more: FloatArray) -> Calibration:
    """Return a calibration whose pose has more covariance (3, 3), with its 1-sigma over the sky."""
    covariance = calibration.covariance.copy()
    covariance[POSE, POSE] += more
    widened = with_covariance(calibration, covariance)
    rms, most = sky_sigma_deg(widened)
    return replace(widened, sky_rms_deg=rms, sky_max_deg=most)
