"""What widens the stated uncertainty of a fit: a pose that differs from day to day, contradictions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from sunarc.calibration.answers.covariance import pose_error, rotation_covariance, sky_sigma_deg, with_covariance
from sunarc.calibration.model.result import Calibration, with_finding
from sunarc.common.array_types import FloatArray
from sunarc.common.findings import Finding
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


def fit_direction_sigma_rms_deg(calibration: Calibration) -> float:
    """Return the stated 1-sigma over the sky without what is allowed for the spread of daily poses, degrees."""
    spread = calibration.evidence.pose_spread_deg
    return calibration.sky_rms_deg if spread is None else _widened(calibration, -1.0, spread).sky_rms_deg


def _widened(calibration: Calibration, sign: float, spread_deg: ArrayLike) -> Calibration:
    enu_covariance = np.diag(np.radians(np.asarray(spread_deg, dtype=np.float64)) ** 2)
    return with_pose_errors(calibration, sign * rotation_covariance(calibration.camera, enu_covariance))


def with_clock(calibration: Calibration, clock_error_s: float | None, *, assumed: bool = False) -> Calibration:
    """Return a calibration whose uncertainty holds an error of the clock that is stated for all of its sightings.

    The sun, the planets and the stars turn about the pole alike: no residual shows a constant error. Where none is
    stated, an accepted verdict says what is assumed.

    Parameters
    ----------
    calibration : as it was fitted; the pose of a known lens has the clock of its sightings.
    clock_error_s : the bound, s; None where none is stated.
    assumed : whether the bound that the sightings carry is a default that nobody stated.
    """
    evidence = calibration.evidence
    if clock_error_s is None:
        if evidence.clock_stated and not assumed:
            return calibration
        unstated = replace(calibration, evidence=replace(evidence, clock_stated=False))
        first = calibration.verdict.accepted and evidence.options.get("free") != "pose"
        return with_finding(unstated, _unbounded(unstated)) if first else unstated
    known_s = evidence.clock_error_s if evidence.clock_stated else 0.0
    beyond_s = math.sqrt(max(clock_error_s**2 - known_s**2, 0.0))
    more = pose_error(calibration.camera, calibration.site, clock_error_s=beyond_s, site_error_m=0.0)
    stated = replace(evidence, clock_error_s=max(clock_error_s, known_s), clock_stated=True, clock_beyond_s=beyond_s)
    return replace(
        with_pose_errors(calibration, more), evidence=stated, sky_rms_without_clock_deg=calibration.sky_rms_deg
    )


def with_whole_minutes(calibration: Calibration, step_s: float) -> Calibration:
    """Return a calibration of which no bound of the clock is stated, its times being on a grid: half a step is assumed.

    Parameters
    ----------
    calibration : as it was fitted.
    step_s : see `time_step_s`; 0 of times on none.
    """
    if step_s == 0.0:
        return calibration
    assumed = with_clock(calibration, 0.5 * step_s)
    assumed = replace(assumed, evidence=replace(assumed.evidence, clock_stated=False))
    if not calibration.verdict.accepted:
        return assumed
    return with_finding(assumed, Finding("times_without_seconds", {"clock_error_s": 0.5 * step_s}))


def _unbounded(calibration: Calibration) -> Finding:
    a_minute_deg = math.degrees(60.0 * EARTH_RATE)
    latitude = math.radians(calibration.site.latitude)
    return Finding(
        "clock_unbounded",
        {
            "clock_error_s": calibration.evidence.clock_error_s,
            "turn_deg_per_minute": a_minute_deg,
            "north_deg_per_minute": a_minute_deg * abs(math.sin(latitude)),
            "tilt_deg_per_minute": a_minute_deg * math.cos(latitude),
        },
    )


def with_pose_errors(calibration: Calibration, more: FloatArray) -> Calibration:
    """Return a calibration whose pose has more covariance (3, 3), with its 1-sigma over the sky."""
    covariance = calibration.covariance.copy()
    covariance[POSE, POSE] += more
    widened = with_covariance(calibration, covariance)
    rms, most = sky_sigma_deg(widened)
    return replace(widened, sky_rms_deg=rms, sky_max_deg=most)
