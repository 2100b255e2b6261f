"""Metadata of a composite."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import Any

import sunarc
from sunarc.cameras.frame import Frame
from sunarc.detection.values import bayer_of
from sunarc.imaging.hdr import HdrImage
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles
from sunarc.utc import rfc3339
from sunarc.workers.sightings.sun_prediction import SunPredictor

SCHEMA = "sunarc.image/1"


def image_document(
    frames: Sequence[Frame], composite: HdrImage, *, camera: str, site: Site, predictor: SunPredictor
) -> dict[str, Any]:
    """Return the document of a composite, as docs/operating.md lists it.

    Parameters
    ----------
    frames : what it was merged from, in the order taken.
    composite : the merge.
    camera, site : its name, and where it stands.
    predictor : which calibration is current, and where it puts the sun.
    """
    first = frames[0]
    return {
        "schema": SCHEMA,
        "preview": False,
        "camera": camera,
        "time_utc": rfc3339(first.time, timespec="microseconds"),
        "exposures": [
            {
                "time_utc": rfc3339(frame.time, timespec="microseconds"),
                "exposure_us": frame.exposure_us,
                "gain_db": frame.gain_db,
                "frame_id": frame.frame_id,
            }
            for frame in frames
        ],
        "pixel_format": first.pixel_format,
        "bayer": bayer_of(first.pixel_format),
        "counts_per_us": composite.counts_per_us,
        "saturated_px": composite.saturated_px,
        "calibration": predictor.calibration_id(),
        "sun": _sun(first.time, site, predictor),
        "site": {"latitude": site.latitude, "longitude": site.longitude, "altitude": site.altitude},
        "software": {"name": "sunarc", "version": sunarc.__version__},
    }


def _sun(time: datetime, site: Site, predictor: SunPredictor) -> dict[str, float | None]:
    angles = sun_angles(time.timestamp(), site)
    expected = predictor.expectation(time)
    return {
        "apparent_zenith": round(float(angles.apparent_zenith), 5),
        "azimuth": round(float(angles.azimuth), 5),
        "x_px": None if expected is None else round(expected.x_px, 3),
        "y_px": None if expected is None else round(expected.y_px, 3),
    }
