"""Documents of calibrations that a command or a notebook makes."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from datetime import datetime
from typing import Any

import sunarc
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.common.array_types import FloatArray
from sunarc.common.utc import utc_time
from sunarc.formats.calibration_document import from_document, to_document

_ID_DIGITS = 32


def new_document(
    solved: Calibration, unix_s: FloatArray, *, created_at: datetime, camera: str, pose_epoch: str = ""
) -> dict[str, Any]:
    """Return the document of a calibration, valid since the first of its sightings' times (n,).

    Its id is a digest of the camera and its uncertainty: the same sightings and options give the same id, and with it
    the same draws, in a command and in a notebook.
    """
    document = to_document(
        solved,
        id="",
        camera=camera,
        state="candidate" if solved.verdict.accepted or solved.sigma_limit_deg is not None else "refused",
        created_at=created_at,
        valid_from=utc_time(float(unix_s.min())) if unix_s.size else created_at,
        valid_until=None,
        pose_epoch=pose_epoch,
        software_version=sunarc.__version__,
    )
    fitted = json.dumps([document[key] for key in ("image", "model", "uncertainty", "site", "evidence")])
    return document | {"id": hashlib.sha256(fitted.encode()).hexdigest()[:_ID_DIGITS]}


def latest_times(points: Sightings) -> FloatArray:
    """Return the times (n,) of the sightings of the latest pose epoch, seconds since 1970-01-01 UTC."""
    return points.unix_s[points.epoch == points.epoch.max()] if len(points) else points.unix_s


def as_documented(document: dict[str, Any], solved: Calibration) -> Calibration:
    """Return the calibration that a document holds: it rounds some numbers, and answers as all who read it do.

    The rows that were left out and the poses of earlier epochs are those of the fit, which a document does not hold.
    """
    return replace(from_document(document), poses=solved.poses, left_out=solved.left_out)
