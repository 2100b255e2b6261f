"""Sightings from detections."""

from __future__ import annotations

from dataclasses import fields
from datetime import datetime

from sunarc.archive.values import SunPoint
from sunarc.detection.values import Detection

_SHARED = {field.name for field in fields(SunPoint)} & {field.name for field in fields(Detection)} - {"exposure_us"}
"""What both have under the same name; the exposure of a detection may be unknown."""


def sun_point_of(
    detection: Detection,
    *,
    camera: str,
    pose_epoch: str,
    time: datetime,
    exposure_us: float = 0.0,
    clock_error_s: float | None = None,
    file: str = "",
    ingest_pass: int | None = None,
) -> SunPoint:
    """Return the sighting that a detection amounts to, accepted or not."""
    return SunPoint(
        camera=camera,
        pose_epoch=pose_epoch,
        time=time,
        reason=detection.reason,
        exposure_us=exposure_us,
        clock_error_s=clock_error_s,
        file=file,
        ingest_pass=ingest_pass,
        **{name: getattr(detection, name) for name in _SHARED},
    )
