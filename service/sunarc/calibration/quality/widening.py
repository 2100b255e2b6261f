"""Enlargement of the stated uncertainty of a fit: spread of daily poses, contradictions, error of the clock."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sunarc.calibration.answers.covariance import pose_error, replace_covariance, rotation_covariance, sky_sigma_deg
from sunarc.calibration.model.result import Calibration
from sunarc.common.array_types import FloatArray
from sunarc.common.findings import Data
from sunarc.optics.camera import POSE
from sunarc.sky.site import EARTH_RATE


def add_pose_spread(calibration: Calibration, spread_deg: Sequence[float]) -> Calibration:
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
    return replace(_add_daily_spread(calibration, 1.0, np.sqrt(larger**2 - before**2)), evidence=evidence)


def scale_errors(calibration: Calibration, factor: float) -> Calibration:
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
    """Return the stated 1-sigma over the sky without the allowance for the spread of daily poses, degrees."""
    spread = calibration.evidence.pose_spread_deg
    return calibration.sky_rms_deg if spread is None else _add_daily_spread(calibration, -1.0, spread).sky_rms_deg


def _add_daily_spread(calibration: Calibration, sign: float, spread_deg: ArrayLike) -> Calibration:
    enu_covariance = np.diag(np.radians(np.asarray(spread_deg, dtype=np.float64)) ** 2)
    return add_pose_errors(calibration, sign * rotation_covariance(calibration.camera, enu_covariance))


class UnboundedClock(NamedTuple):
    """Fit of sightings for whose clock no bound is stated."""

    calibration: Calibration
    step_s: float = 0.0
    """Step of the grid that their times are on, s, see `time_step_s`; 0 of times on none."""


def half_a_step(clock: UnboundedClock) -> Data:
    """Return the error of the clock that is assumed of times on a grid; 0 of times on none."""
    return {"clock_error_s": 0.5 * clock.step_s}


def assumed_clock(clock: UnboundedClock) -> Data | None:
    """Return the error of the clock that is assumed, with its effect; None of the pose of a known lens."""
    if clock.calibration.evidence.options.get("free") == "pose":
        return None
    a_minute_deg, latitude = math.degrees(60.0 * EARTH_RATE), math.radians(clock.calibration.site.latitude)
    return {
        "clock_error_s": clock.calibration.evidence.clock_error_s,
        "turn_deg_per_minute": a_minute_deg,
        "north_deg_per_minute": a_minute_deg * abs(math.sin(latitude)),
        "tilt_deg_per_minute": a_minute_deg * math.cos(latitude),
    }


def add_clock_error(calibration: Calibration, clock_error_s: float) -> Calibration:
    """Return a calibration whose uncertainty holds a bound of the clock, s, for all of its sightings."""
    evidence = calibration.evidence
    known_s = evidence.clock_error_s if evidence.clock_stated else 0.0
    beyond_s = math.sqrt(max(clock_error_s**2 - known_s**2, 0.0))
    more = pose_error(calibration.camera, calibration.site, clock_error_s=beyond_s, site_error_m=0.0)
    stated = replace(evidence, clock_error_s=max(clock_error_s, known_s), clock_stated=True, clock_beyond_s=beyond_s)
    return replace(
        add_pose_errors(calibration, more), evidence=stated, sky_rms_without_clock_deg=calibration.sky_rms_deg
    )


def add_pose_errors(calibration: Calibration, more: FloatArray) -> Calibration:
    """Return a calibration whose pose has more covariance (3, 3), with its 1-sigma over the sky."""
    covariance = calibration.covariance.copy()
    covariance[POSE, POSE] += more
    widened = replace_covariance(calibration, covariance)
    rms, most = sky_sigma_deg(widened)
    return replace(widened, sky_rms_deg=rms, sky_max_deg=most)
