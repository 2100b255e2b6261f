"""What the store knows of the time before the service started, so that a restart hides nothing."""

from __future__ import annotations

import logging
from datetime import datetime

from sunarc.archive import Archive, ImageStore
from sunarc.board import StatusBoard
from sunarc.errors import OutsideError

_log = logging.getLogger(__name__)


def restore_last_known(board: StatusBoard, *, archive: Archive, images: ImageStore, camera: str) -> None:
    """Write on the board when the last frame and the last accepted sighting were, as the store has them.

    Parameters
    ----------
    board : where they are shown until newer ones come.
    archive, images : what was stored; where that cannot be read, nothing is written.
    camera : whose sightings.
    """
    try:
        looks = archive.sun_points(camera, newest_first=True, limit=1)
        sightings = archive.sun_points(camera, accepted=True, newest_first=True, limit=1)
        frames: list[datetime] = [look.time for look in looks]
        if (image_at := images.newest_at(kind="hdr.png")) is not None:
            frames.append(image_at)
    except (OutsideError, OSError) as error:
        _log.warning("the times of the last frame and sighting cannot be read from the store: %s", error)
        return
    if frames:
        board.note(last_frame_at=max(frames))
    if sightings:
        board.note(last_sighting_at=sightings[0].time)
