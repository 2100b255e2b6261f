"""The camera of the settings in an archive: written down before a real one has answered."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sunarc.common.errors import InputError
from sunarc.imager.archive.archive import Archive
from sunarc.imager.archive.sightings import require_same_site
from sunarc.imager.archive.values import CameraRecord

if TYPE_CHECKING:
    from sunarc.imager.settings.model import Settings  # with it come all packages


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
