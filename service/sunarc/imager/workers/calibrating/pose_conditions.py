"""Conditions of a pose that is provisional, refused, or waited for."""

from __future__ import annotations

from sunarc.calibration.lens_library.first_pose import north_sigma_deg
from sunarc.calibration.model.result import Calibration, Verdict
from sunarc.imager.runtime.status import Reason, condition
from sunarc.imager.workers.calibrating.provisional_pose import (
    FEWEST,
    is_first_pose,
    is_provisional,
)
from sunarc.optics.mounting import top_azimuth_deg


def waiting_condition(n: int, pixel: tuple[float, float]) -> Reason:
    """Return the condition of a first pose that waits for sightings: how many there are, and where the last one is."""
    return condition("first_sun", n=n, least=FEWEST, x_px=pixel[0], y_px=pixel[1])


def pose_condition(current: Calibration) -> Reason | None:
    """Return the condition of a pose that is provisional; None for that of a full fit."""
    if current.sigma_limit_deg is not None:
        return condition("provisional_calibration", limit_deg=current.sigma_limit_deg, n=current.evidence.n_used)
    if not is_provisional(current):
        return None
    if not is_first_pose(current):
        return condition("provisional_pose", n=current.evidence.n_used, sigma_deg=current.sky_rms_deg)
    return condition(
        "first_pose_provisional",
        n=current.evidence.n_used,
        sigma_deg=current.sky_rms_deg,
        north_sigma_deg=north_sigma_deg(current),
        top_azimuth_deg=top_azimuth_deg(current.camera),
    )


def refused_condition(verdict: Verdict) -> Reason:
    """Return the condition of a first pose that is refused."""
    finding = verdict.findings[0]
    return condition("first_pose_refused", reason=finding.text, remedy=finding.remedy)
