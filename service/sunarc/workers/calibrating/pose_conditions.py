"""Conditions of a pose that is provisional, refused, or waited for."""

from __future__ import annotations

from sunarc.calibration.lens_library.mounting import north_sigma_deg, top_azimuth_deg
from sunarc.calibration.messages import MESSAGES as CHANGES
from sunarc.calibration.model.result import Calibration, Verdict
from sunarc.runtime.status import Reason
from sunarc.workers.calibrating.provisional_pose import FEWEST, is_first_pose, is_provisional
from sunarc.workers.messages import condition


def waiting_condition(n: int, pixel: tuple[float, float]) -> Reason:
    """Return the condition of a first pose that waits for sightings: how many there are, and where the last one is."""
    return condition("first_sun", n=n, least=FEWEST, x_px=pixel[0], y_px=pixel[1])


def pose_condition(current: Calibration) -> Reason | None:
    """Return the condition of a pose that is provisional; None for that of a full fit."""
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
    return condition("first_pose_refused", reason=CHANGES.text_of(finding), remedy=CHANGES.remedy_of(finding))
