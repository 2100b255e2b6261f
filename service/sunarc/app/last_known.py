"""What the store knows of the time before the service started, so that a restart hides nothing."""

from __future__ import annotations

import logging
from datetime import datetime
from typing import TypedDict

from sunarc.archive.archive import Archive
from sunarc.archive.images import ImageStore
from sunarc.calibration.model.sightings import MAX_CLOCK_ERROR_S
from sunarc.errors import OutsideError
from sunarc.runtime.status import StatusRegistry

_log = logging.getLogger(__name__)


class _Filters(TypedDict):
    until: datetime | None
    largest_clock_error_s: float
    newest_first: bool
    limit: int


def restore_last_known(
    board: StatusRegistry,
    *,
    archive: Archive,
    images: ImageStore,
    camera: str,
    until: datetime | None,
) -> None:
    """Write on the board when the last frame and the last accepted sighting were, as the store has them.

    Parameters
    ----------
    board : where they are shown until newer ones come.
    archive, images : what was stored; where that cannot be read, nothing is written.
    camera : whose sightings.
    until : now; later times are of a clock that was ahead. None where times jump by nature (replay, simulation).
    """
    filters: _Filters = {"until": until, "largest_clock_error_s": MAX_CLOCK_ERROR_S, "newest_first": True, "limit": 1}
    try:
        points = archive.sun_points(camera, body=None, **filters)
        sightings = archive.sun_points(camera, accepted=True, **filters)
        frames: list[datetime] = [point.time for point in points]
        if (image_at := images.newest_at(kind="hdr.png", until=until)) is not None:
            frames.append(image_at)
    except (OutsideError, OSError) as error:
        _log.warning("the times of the last frame and sighting cannot be read from the store: %s", error)
        return
    if frames:
        board.note(last_frame_at=max(frames))
    if sightings:
        board.note(last_sighting_at=sightings[0].time)
