"""Pictures before and after a move of the camera: kept whatever becomes of the images."""

from __future__ import annotations

from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Literal, get_args

import cv2
import numpy as np

from sunarc.common.foreign_files import read_regular
from sunarc.common.utc import utc_time
from sunarc.imager.archive.images import time_in_name, write_atomically
from sunarc.imager.archive.values import Event
from sunarc.imaging.preview import decoded

Side = Literal["before", "after"]
"""Of a move."""
_STAMP = "%Y%m%dT%H%M%S.%f"
_EVERY = timedelta(minutes=10)
"""Between two pictures that may become the one before a move."""
_LATELY = 24
"""Pictures of the last sightings, among which the one before a move is: it is found a few sightings later."""
_MOST_KEPT = 100
"""Pictures of moves; the oldest go."""
_WIDTH = 1024
"""Of a kept picture at most, px."""
_QUALITY = 85


class MovePictures:
    """Store of small copies of the last sightings' pictures, from which those before and after a move are kept.

    Parameters
    ----------
    folder : where they are; nothing else is in it.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def is_due(self, at: datetime) -> bool:
        """Return whether the last copy is ten minutes old."""
        kept = self._list_recent_pictures()
        return not kept or abs(at - _parse_picture_time(kept[-1])) >= _EVERY

    def remember(self, picture: Path, *, sighted_at: datetime) -> None:
        """Copy the newest picture; one that cannot be read is left out.

        Parameters
        ----------
        picture : a file that a browser shows.
        sighted_at : time of the sighting in it; not used where the file's name has the picture's own time.

        Raises
        ------
        OSError
            The disk refuses.
        """
        time = time_in_name(picture) or sighted_at
        self._copy_small(picture, self.folder / f"lately_{time.astimezone(UTC):{_STAMP}}.jpg")
        for old in self._list_recent_pictures()[:-_LATELY]:
            old.unlink(missing_ok=True)

    def keep(self, event: Event, newest: Path, *, sighted_at: datetime) -> None:
        """Keep the pictures before and after a move that are not kept yet.

        Parameters
        ----------
        event : the move.
        newest : the newest picture, which may be the one after it.
        sighted_at : see `remember`.

        Raises
        ------
        OSError
            The disk refuses.
        """
        earliest = event.details.get("earliest_unix_s")
        until = utc_time(float(earliest)) if isinstance(earliest, int | float) else event.time
        before = [path for path in self._list_recent_pictures() if _parse_picture_time(path) <= until]
        if before and self.path(event, "before") is None:
            self._copy_small(before[-1], self._make_target_path(event, "before", _parse_picture_time(before[-1])))
        time = time_in_name(newest) or sighted_at
        if time >= event.time and self.path(event, "after") is None:
            self._copy_small(newest, self._make_target_path(event, "after", time))
        for old in sorted(self.folder.glob("move_*.jpg"))[:-_MOST_KEPT]:
            old.unlink(missing_ok=True)

    def path(self, event: Event, side: Side) -> Path | None:
        """Return the file of a kept picture; None without one."""
        return next(iter(self.folder.glob(f"{_make_name_prefix(event, side)}*.jpg")), None)

    def time(self, path: Path) -> datetime:
        """Return when a kept picture was taken."""
        return _parse_picture_time(path)

    def is_complete(self, event: Event) -> bool:
        """Return whether both pictures are kept."""
        return all(self.path(event, side) is not None for side in get_args(Side))

    def _make_target_path(self, event: Event, side: Side, time: datetime) -> Path:
        return self.folder / f"{_make_name_prefix(event, side)}{time.astimezone(UTC):{_STAMP}}.jpg"

    def _list_recent_pictures(self) -> list[Path]:
        """Return the pictures of the last sightings, the oldest first."""
        return sorted(self.folder.glob("lately_*.jpg"))

    def _copy_small(self, picture: Path, target: Path) -> None:
        with suppress(FileNotFoundError):
            pixels = decoded(read_regular(picture), cv2.IMREAD_COLOR)
            if pixels is None:
                return
            height, width = pixels.shape[:2]
            if width > _WIDTH:
                size = (_WIDTH, max(1, round(height * _WIDTH / width)))
                pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
            encoded = cv2.imencode(".jpg", np.asarray(pixels, np.uint8), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
            write_atomically(target, encoded.tobytes())


def _make_name_prefix(event: Event, side: Side) -> str:
    return f"move_{event.time.astimezone(UTC):{_STAMP}}_{event.kind}_{side}_"


def _parse_picture_time(path: Path) -> datetime:
    return datetime.strptime(path.stem.rpartition("_")[2], _STAMP).replace(tzinfo=UTC)
