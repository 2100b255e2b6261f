"""From what the detector says to what is remembered."""

from __future__ import annotations

from datetime import datetime

from sunarc.archive.values import SunPoint
from sunarc.detection import Detection


def sun_point_of(
    detection: Detection,
    *,
    camera: str,
    pose_epoch: str,
    time: datetime,
    exposure_us: float = 0.0,
    clock_error_s: float | None = None,
) -> SunPoint:
    """Return the sighting that a detection amounts to, accepted or not."""
    return SunPoint(
        camera=camera,
        pose_epoch=pose_epoch,
        time=time,
        method=detection.method,
        accepted=detection.accepted,
        verdict=detection.verdict,
        reason=detection.reason,
        exposure_us=exposure_us,
        x_px=detection.x_px,
        y_px=detection.y_px,
        sigma_px=detection.sigma_px,
        peak_fraction=detection.peak_fraction,
        background_fraction=detection.background_fraction,
        radius_px=detection.radius_px,
        ellipticity=detection.ellipticity,
        residual_chi2=detection.residual_chi2,
        snr=detection.snr,
        saturated_px=detection.saturated_px,
        clock_error_s=clock_error_s,
    )
