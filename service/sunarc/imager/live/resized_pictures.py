"""Pictures of another size in a followed folder: how many in a row make them those of the camera."""

from __future__ import annotations

from datetime import datetime
from typing import NamedTuple

from sunarc.imager.archive.archive import Archive
from sunarc.imager.live.camera_record import take_resized
from sunarc.sources.source_files import SourceFile

_IN_A_ROW = 12
"""Pictures of one other size without one of the camera's, from which the picture was resized."""


class _Picture(NamedTuple):
    file: SourceFile
    time: datetime


class ResizedPictures:
    """Pictures of one size that came one after the other and have not the camera's size.

    Parameters
    ----------
    archive, camera : has the camera of this name.
    """

    def __init__(self, archive: Archive, camera: str) -> None:
        self._archive, self._camera = archive, camera
        self._size: tuple[int, int] | None = None
        self._pictures: dict[str, _Picture] = {}

    def clear(self) -> None:
        """Forget them: a picture of the camera's size was used."""
        self._size, self._pictures = None, {}

    def note(self, file: SourceFile, time: datetime, size: tuple[int, int]) -> list[SourceFile]:
        """Take note of a picture of another size (width, height), px.

        Returns
        -------
        The files to be read again, where the camera has this size from now on; else nothing.
        """
        if size != self._size:
            self._size, self._pictures = size, {}
        self._pictures[file.name] = _Picture(file, time)
        if len(self._pictures) < _IN_A_ROW:
            return []
        known = self._archive.cameras.get(self._camera)
        newest = self._archive.sightings.find(self._camera, newest_first=True, limit=1)
        begin = min(one.time for one in self._pictures.values())
        files = [one.file for one in self._pictures.values()]
        self.clear()
        if known is None or (newest and newest[0].time >= begin):
            return []  # pictures from before those of the camera
        take_resized(self._archive, known, size, at=begin)
        return files
