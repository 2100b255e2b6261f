"""A past calibration, solved again from its evidence in the archive."""

from __future__ import annotations

from typing import Any

import sunarc
from sunarc.archive.archive import open_archive
from sunarc.calibration.model.document import from_document, to_document
from sunarc.calibration.quality.acceptance import distance_px
from sunarc.calibration.reproduce import reproduce_calibration
from sunarc.settings.model import Settings
from sunarc.workers.fit_input import points_of

_ROUNDING_PX = 1e-6


def solve_again(settings: Settings, calibration_id: str) -> dict[str, Any]:
    """Return what solving a past calibration again led to: whether it is the same, and its document.

    Raises
    ------
    NotFoundError : there is no such calibration, or nothing was kept with it.
    InputError : its sightings were changed or deleted since.
    """
    with open_archive(settings.archive) as archive:
        record = archive.calibration(calibration_id)
        past = from_document(record.document)
        points = points_of(archive.sightings_of(calibration_id), site=past.site, latest=record.pose_epoch)
    solved = reproduce_calibration(past, points)
    separation_px = distance_px(past, solved)
    document = to_document(
        solved,
        id=f"{calibration_id}-again",
        camera=record.camera,
        state="candidate" if solved.verdict.accepted else "refused",
        created_at=record.created_at,
        valid_from=record.valid_from,
        valid_until=record.valid_until,
        pose_epoch=record.pose_epoch or "",
        software_version=sunarc.__version__,
    )
    return {
        "same": separation_px <= _ROUNDING_PX,
        "apart_px": separation_px,
        "sightings": len(points),
        "calibration": document,
    }
