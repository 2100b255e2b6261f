"""Record of the settings' camera in an archive: before a real one has answered, and after its picture was resized."""

from __future__ import annotations

import logging
from dataclasses import replace
from datetime import datetime
from typing import TYPE_CHECKING, NamedTuple

from sunarc.common.errors import InputError
from sunarc.common.findings import Finding
from sunarc.imager.archive.archive import Archive
from sunarc.imager.archive.cameras import require_same_site
from sunarc.imager.archive.epochs import LENS_CHANGED
from sunarc.imager.archive.values import CameraRecord, Event

if TYPE_CHECKING:
    from sunarc.imager.settings.model import Settings  # with it come all packages
    from sunarc.sources.source_files import SourceFile

_log = logging.getLogger(__name__)
_IN_A_ROW = 12
"""Pictures of one other size without one of the camera's, from which the picture was resized."""


def known_camera(archive: Archive, settings: Settings) -> CameraRecord | None:
    """Return the archive's record of the settings' camera; None where it has none.

    Raises
    ------
    InputError : it stands at another site.
    """
    found = archive.cameras.get(settings.name)
    if found is not None:
        require_same_site(found, settings.place)
    return found


def register_camera(archive: Archive, settings: Settings, size: tuple[int, int]) -> CameraRecord:
    """Store the settings' camera with its image size (width, height) in px, unless it is stored already.

    Raises
    ------
    InputError : the stored camera makes images of another size, or stands at another site.
    """
    known = known_camera(archive, settings)
    if known is None:
        known = CameraRecord.at(settings.place, name=settings.name, width=size[0], height=size[1])
        archive.cameras.save(known)
    if known.image_size != size:
        raise InputError(
            field="image size",
            problem=f"{size[0]}x{size[1]} px, and camera {settings.name!r} makes {known.width}x{known.height}",
            remedy="correct it, or give this camera another name",
        )
    return known


def begin_with_other_lens(archive: Archive, camera: str, at: datetime) -> str | None:
    """Retire the current calibration, a pinned one too, and open a pose epoch with another lens; return its id.

    Where a wrong clock has opened an epoch later, the one before that is divided.
    """
    current = archive.calibrations.current(camera)
    if current is not None:
        archive.calibrations.retire(current.id, at=max(at, current.valid_from))
    retired = None if current is None else current.id
    if archive.epochs.current(camera) is None:
        return retired
    try:
        if any(epoch.started_at > at for epoch in archive.epochs.find(camera)):
            archive.epochs.split(camera, at=at, reason=LENS_CHANGED)
        else:
            archive.epochs.open(camera, at=at, reason=LENS_CHANGED)
    except InputError as error:
        _log.warning("could not begin a pose epoch with another lens: %s", error)
    return retired


def take_resized(archive: Archive, camera: CameraRecord, size: tuple[int, int], *, at: datetime) -> None:
    """Store a camera's new image size (width, height), px, with another lens from then on, and an event."""
    retired = begin_with_other_lens(archive, camera.name, at)
    archive.cameras.save(replace(camera, width=size[0], height=size[1]))
    resized = Finding(
        "picture_resized",
        {
            "width": size[0],
            "height": size[1],
            "width_before": camera.width,
            "height_before": camera.height,
            "calibration": retired or "none",
        },
    )
    archive.events.add(Event.of(resized, time=at, severity="warning", camera=camera.name))


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
